"""The ray method against the exact free-space sum, aimed rays through optics, shadows drawn by hand, and at a focus."""

from __future__ import annotations

import numpy as np
import pytest

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.plane import PlaneGrid
from speckle_mi.optics.aim import aim
from speckle_mi.optics.traced_path import TracedPath
from speckle_mi.geometry.outline import Circle
from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.trace import RayStatus
from speckle_mi.propagation.paths import FreeSpace
from speckle_mi.propagation.reference import reference_sum
from speckle_mi.field.ray_method import ray_field

WAVELENGTH = 632.8e-6  # mm
INDEX = 1.5151
ROUNDING = 1e-9  # field; ten times the rounding of a path of 0.1 m, 2 pi 1e-14 m / 0.6 um
LENS_TOLERANCE = 1e-5  # field; ten times the interpolation error measured 1 mm in front of a caustic


def detector(z: float, rows: int, columns: int, pitch: float) -> PlaneGrid:
    u, v = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    origin = np.array([-(columns - 1) / 2 * pitch, -(rows - 1) / 2 * pitch, z])
    return PlaneGrid(origin, u, v, pitch, (rows, columns))


def sources(n: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    position = np.column_stack([rng.uniform(-0.12, 0.12, (n, 2)), rng.normal(0.0, 8e-4, n)])
    return position, rng.normal(size=n) + 1j * rng.normal(size=n)


def surface(z: float, curvature: float = 0.0, rim: Circle | None = None) -> Surface:
    return Surface(Frame(np.array([0.0, 0.0, z]), np.eye(3)), curvature, outline=rim)


def plate_or_lens(z: float, curvature: float, thickness: float) -> tuple[Interaction, ...]:
    return (
        Interaction.refract(surface(z, curvature), 1.0, INDEX),
        Interaction.refract(surface(z + thickness, -curvature), INDEX, 1.0),
    )


def stop(z: float, radius: float) -> Interaction:
    return Interaction.through(surface(z, rim=Circle(radius)))


IMAGING = (stop(98.0, 2.0), *plate_or_lens(100.0, 0.02, 5.0))  # images z = 0 to about z = 199.5


def distance(field: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(field - exact) / np.linalg.norm(exact))


def exact_free_space(grid: PlaneGrid, position: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    return reference_sum(FreeSpace(), position, amplitude, grid.points(), WAVELENGTH).reshape(grid.shape)


def test_error_in_free_space_falls_faster_than_any_power_of_the_number_of_rays():
    grid, (position, amplitude) = detector(60.0, 48, 74, 0.06), sources()
    exact = exact_free_space(grid, position, amplitude)
    fields = {n: ray_field(None, grid, position, amplitude, WAVELENGTH, n).field for n in (16, 64, 400)}
    errors = {n: distance(field, exact) for n, field in fields.items()}
    assert errors[64] < 1e-2 * errors[16]  # linear interpolation: a fourth
    assert errors[400] < 1e-3 * errors[64]


def test_the_papers_1500_rays_give_the_exact_free_space_sum_to_rounding():
    grid, (position, amplitude) = detector(60.0, 48, 74, 0.06), sources()
    result = ray_field(None, grid, position, amplitude, WAVELENGTH, 1500)
    assert distance(result.field, exact_free_space(grid, position, amplitude)) < ROUNDING
    assert result.covered == 1.0 and not result.warnings
    assert 0.9 * 1500 * len(position) < result.rays_traced <= 1500 * len(position)


@pytest.mark.parametrize(("z", "curvature", "detector_z"), [(20.0, 0.0, 60.0), (60.0, 0.02, 100.0)])
def test_field_through_a_plate_and_a_lens_is_that_of_aimed_rays(z, curvature, detector_z):
    grid, (position, amplitude) = detector(detector_z, 24, 37, 0.05), sources()
    sequence = plate_or_lens(z, curvature, 5.0)
    path = TracedPath(Sequence((*sequence, Interaction.through(surface(detector_z)))))
    exact = reference_sum(path, position, amplitude, grid.points(), WAVELENGTH).reshape(grid.shape)
    result = ray_field(Sequence(sequence), grid, position, amplitude, WAVELENGTH, 1500)
    assert distance(result.field, exact) < ROUNDING


@pytest.mark.parametrize(("detector_z", "pitch"), [(185.0, 0.008), (195.0, 0.008), (300.0, 0.04)])
def test_out_of_focus_field_behind_lens_and_stop_is_that_of_aimed_rays_on_both_sides_of_the_image(detector_z, pitch):
    grid, (position, amplitude) = detector(detector_z, 24, 24, pitch), sources(3)
    # Close to the axis: pixels many patches away from a source's light are beyond the caustic of the unstopped lens,
    # where aiming has several rays to choose from.
    position = 0.3 * position
    system = Sequence((*IMAGING, Interaction.through(surface(detector_z))))
    result = ray_field(Sequence(IMAGING), grid, position, amplitude, WAVELENGTH, 1500)
    exact = np.zeros(grid.size, dtype=np.complex128)
    for place, weight in zip(position, amplitude, strict=True):
        # Far outside the stop's shadow there may be no ray at all: dark as well.
        rays = aim(system, np.repeat(place[None], grid.size, axis=0), grid.points())
        free = rays.status == RayStatus.OK
        turns = rays.optical_path_length[free] / WAVELENGTH - 0.25 * rays.caustics[free]
        exact[free] += weight * rays.amplitude[free] * np.exp(2j * np.pi * np.mod(turns, 1.0))
    assert distance(result.field.ravel(), exact) < LENS_TOLERANCE


def test_shadow_of_an_aperture_is_the_central_projection_of_its_rim_to_the_pixel():
    grid = detector(75.0, 240, 372, 0.012)
    source = np.array([[0.1, -0.05, 0.0]])
    result = ray_field(Sequence((stop(41.0, 0.5),)), grid, source, np.ones(1), WAVELENGTH, 1500)
    middle = source[0, :2] * (1.0 - 75.0 / 41.0)
    radius = np.linalg.norm(grid.points()[:, :2] - middle, axis=1).reshape(grid.shape)
    lit = radius < 0.5 * 75.0 / 41.0
    np.testing.assert_array_equal(result.field != 0.0, lit)
    assert result.covered == lit.mean()
    assert distance(result.field, np.where(lit, exact_free_space(grid, source, np.ones(1)), 0.0)) < ROUNDING


def test_source_behind_a_blocked_way_leaves_the_detector_dark_and_says_so():
    away = Interaction.through(Surface(Frame(np.array([8.0, 0.0, 41.0]), np.eye(3)), outline=Circle(0.5)))
    result = ray_field(Sequence((away,)), detector(75.0, 20, 20, 0.05), *sources(2), WAVELENGTH, 100)
    assert not result.field.any() and result.covered == 0.0
    assert any("2 sources" in text for text in result.warnings)


@pytest.mark.parametrize("detector_z", [199.0, 199.5, 200.0])
def test_detector_at_the_focus_is_refused_as_a_caustic(detector_z):
    grid = detector(detector_z, 80, 80, 0.004)
    with pytest.raises(ValueError, match="method 'rays'.*caustic.*diffraction"):
        ray_field(Sequence(IMAGING), grid, *sources(2), WAVELENGTH, 1500)


def test_rays_are_no_random_numbers():
    grid, (position, amplitude) = detector(60.0, 24, 37, 0.1), sources()
    first, second = (ray_field(None, grid, position, amplitude, WAVELENGTH, 400) for _ in range(2))
    np.testing.assert_array_equal(first.field, second.field)


def test_too_few_rays_are_refused():
    with pytest.raises(ValueError, match="rays_per_source = 9: must be at least 16"):
        ray_field(None, detector(60.0, 4, 4, 0.1), *sources(), WAVELENGTH, 9)
