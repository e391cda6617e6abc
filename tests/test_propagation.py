"""The exact coherent sum: against sums in higher precision, closed forms of optics, and its own limits."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import mpmath
import numpy as np
import pytest

from speckle_mi.geometry.plane import PlaneGrid, PlanePoints
from speckle_mi.propagation import direct, runs
from speckle_mi.propagation.paths import FreeSpace, RayleighSommerfeld
from speckle_mi.propagation.direct import direct_sum
from speckle_mi.propagation.reference import reference_sum

WAVELENGTH = 632.8e-6

SINGLE = 1e-6
"""Relative L2 error that the float32 parts of the kernel may make (float32 rounds to 6e-8, a few roundings a pair)."""

DOUBLE = 2e-8
"""The same for float64 throughout at 1 m: the path of 1.6e6 turns is rounded to 2e-10 turns, on either side."""


@pytest.fixture(autouse=True, scope="module")
def variant():
    mi.set_variant("llvm_ad_mono")


def rough_spot(count: int, radius: float = 0.12, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    place = np.column_stack([random.normal(size=(count, 2)) * radius / 2, random.normal(size=count) * 1e-3])
    return place, random.random(count) * np.exp(2j * np.pi * random.random(count))


def detector(distance: float, tilt: float, shape: tuple[int, int], pitch: float = 0.006) -> PlaneGrid:
    u = np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    v = np.array([0.0, 1.0, 0.0])
    middle = distance * np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    origin = middle - pitch * ((shape[1] - 1) / 2 * u + (shape[0] - 1) / 2 * v)
    return PlaneGrid(origin, u, v, pitch, shape)


def relative_error(field: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(field.ravel() - exact.ravel()) / np.linalg.norm(exact))


@pytest.mark.parametrize("distance", [1.0, 60.0, 1000.0, 10_000.0])
def test_phase_of_one_scatterer_is_right_to_a_hundred_thousandth_of_a_wavelength(distance):
    source = np.array([[0.1234567, -0.0765432, 0.0007]])
    grid = detector(distance, 0.4, (1, 3))
    field = direct_sum(FreeSpace(), source, np.ones(1, dtype=complex), grid, WAVELENGTH).ravel()
    with mpmath.workdps(40):
        for value, point in zip(field, grid.points(), strict=True):
            r = mpmath.sqrt(sum((mpmath.mpf(d) - mpmath.mpf(p)) ** 2 for d, p in zip(point, source[0], strict=True)))
            exact = complex(mpmath.expjpi(2 * r / mpmath.mpf(WAVELENGTH)) / r)
            assert abs(np.angle(value / exact)) / (2 * np.pi) < 1e-5
            assert abs(value) == pytest.approx(abs(exact), rel=1e-6)


@pytest.mark.parametrize("opening", [False, True], ids=["free space", "opening"])
@pytest.mark.parametrize(("distance", "tilt"), [(2.0, 0.0), (15.0, 0.3), (60.0, 1.2), (1000.0, -0.6)])
@pytest.mark.parametrize(("count", "shape"), [(1, (1, 1)), (33, (1, 7)), (100, (9, 37))])
def test_kernel_equals_numpy_sum_from_near_field_to_far_field(opening, distance, tilt, count, shape):
    path = RayleighSommerfeld(np.array([0.0, 0.0, 1.0]), WAVELENGTH) if opening else FreeSpace()
    sources, weights = rough_spot(count)
    grid = detector(distance, tilt, shape)
    exact = reference_sum(path, sources, weights, grid.points(), WAVELENGTH)
    assert relative_error(direct_sum(path, sources, weights, grid, WAVELENGTH), exact) < SINGLE
    assert relative_error(direct_sum(path, sources, weights, grid, WAVELENGTH, tolerance=1e-8), exact) < DOUBLE
    points = PlanePoints(grid.origin, grid.u, grid.v, np.tile(grid.columns, shape[0]), np.repeat(grid.rows, shape[1]))
    scattered = direct_sum(path, sources, weights, points, WAVELENGTH)
    assert scattered.shape == (grid.size,)
    assert relative_error(scattered, exact) < SINGLE


def test_field_on_the_axis_of_a_circular_opening_is_the_closed_form():
    """Plane wave of unit amplitude on a hole of radius a: U = e^{ikz} - z/s e^{iks}, s^2 = z^2 + a^2.

    The exact first Rayleigh-Sommerfeld integral; Osterberg & Smith, JOSA 51 (1961), doi:10.1364/JOSA.51.001050.
    """
    radius, distance = 0.2, 30.0
    node, weight = np.polynomial.legendre.leggauss(60)
    r = radius * (node + 1) / 2
    angle = 2 * np.pi * np.arange(32) / 32
    x, y = np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))
    places = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    area = np.repeat(weight * radius / 2 * r * 2 * np.pi / 32, 32).astype(complex)
    axis_point = PlanePoints(np.array([0, 0, distance]), np.eye(3)[0], np.eye(3)[1], np.zeros(1), np.zeros(1))
    path = RayleighSommerfeld(np.array([0.0, 0.0, 1.0]), WAVELENGTH)
    field = direct_sum(path, places, area, axis_point, WAVELENGTH)[0]
    slant, k = np.hypot(distance, radius), 2 * np.pi / WAVELENGTH
    exact = np.exp(1j * k * distance) - distance / slant * np.exp(1j * k * slant)
    assert abs(field - exact) < 3e-6  # float32 phasors of 1920 nodes, amplitudes of order one


def test_cubic_along_a_run_is_only_used_where_its_remainder_is_small():
    sources, _ = rough_spot(50)
    extent = [runs.choose_run(runs.Extent.of(sources, g), g, WAVELENGTH, None)
              for g in (detector(d, 0.3, (20, 64)) for d in (0.5, 15.0, 60.0))]  # fmt: skip
    assert extent == [None, 8, 16]


def test_many_pixels_and_many_sources_are_done_in_pieces_with_the_same_result(monkeypatch):
    sources, weights = rough_spot(200)
    grid = detector(60.0, 0.3, (12, 40))
    whole = direct_sum(FreeSpace(), sources, weights, grid, WAVELENGTH)
    monkeypatch.setattr(direct, "LANES_AT_ONCE", 7)
    monkeypatch.setattr(direct, "MINIMUM_LANES", 1)
    assert relative_error(direct_sum(FreeSpace(), sources, weights, grid, WAVELENGTH), whole) < SINGLE


def test_another_size_geometry_or_wavelength_compiles_no_kernel():
    def run(count: int, shape: tuple[int, int], distance: float, wavelength: float) -> None:
        sources, weights = rough_spot(count)
        grid = detector(distance, 0.3, shape)
        points = PlanePoints(grid.origin, grid.u, grid.v, *np.random.default_rng(0).random((2, grid.size)))
        direct_sum(FreeSpace(), sources, weights, grid, wavelength)
        direct_sum(FreeSpace(), sources, weights, points, wavelength)

    for distance in (2.0, 15.0, 60.0):  # every pair, the short run and the long run
        run(100, (20, 64), distance, WAVELENGTH)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        run(333, (31, 50), 75.0, 532e-6)
        run(40, (50, 31), 3.0, WAVELENGTH)
        run(5000, (7, 100), 500.0, 1e-3)
        history = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
    assert history
    assert all(entry["cache_hit"] for entry in history)


def test_path_through_an_opening_wants_a_unit_normal_and_a_wavelength():
    with pytest.raises(ValueError, match="normal"):
        RayleighSommerfeld(np.array([0.0, 0.0, 2.0]), WAVELENGTH)
    with pytest.raises(ValueError, match="wavelength"):
        RayleighSommerfeld(np.array([0.0, 0.0, 1.0]), -1.0)
