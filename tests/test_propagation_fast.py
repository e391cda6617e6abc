"""The fast coherent sums keep the tolerance asked for, against the exact sum, whatever the geometry."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from speckle_mi.geometry.plane import PlaneGrid, PlanePoints
from speckle_mi.propagation.coherent_sum import coherent_sum
from speckle_mi.propagation.paths import FreeSpace
from speckle_mi.propagation.bandlimited import REACH_BINS, node_grid, nodes_for, reach_of
from speckle_mi.propagation.chebyshev import (
    TensorSeries,
    chebyshev_nodes,
    interpolation_matrix,
    tensor_coefficients,
    tensor_nodes,
)
from speckle_mi.propagation.interpolated import interpolated
from speckle_mi.propagation.lowrank import expand, low_rank_sum
from speckle_mi.propagation.reference import reference_sum
from speckle_mi.propagation.source_box import SourceBox

WAVELENGTH = 632.8e-6
CHECKED_POINTS = 60


@pytest.fixture(autouse=True, scope="module")
def variant():
    mi.set_variant("llvm_ad_mono")


def spot(count: int, radius: float, roughness: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Gaussian spot of ``radius`` [mm] cut at three radii, heights of rms ``roughness`` [mm], random phases."""
    random = np.random.default_rng(seed)
    place = np.column_stack([random.normal(size=(count, 2)) * radius / 2, random.normal(size=count) * roughness])
    place = place[np.hypot(place[:, 0], place[:, 1]) < 3 * radius]
    weights = np.exp(-(place[:, 0] ** 2 + place[:, 1] ** 2) / (2 * radius**2) + 2j * np.pi * random.random(len(place)))
    return place, weights


def detector(distance: float, tilt: float = 0.3, shape: tuple[int, int] = (120, 160), pitch: float = 0.02) -> PlaneGrid:
    u = np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    v = np.array([0.0, 1.0, 0.0])
    middle = distance * np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    return PlaneGrid(middle - pitch * ((shape[1] - 1) / 2 * u + (shape[0] - 1) / 2 * v), u, v, pitch, shape)


def error_at_random_points(path, sources, weights, target, field, wavelength=WAVELENGTH) -> float:
    pick = np.random.default_rng(99).integers(target.size, size=CHECKED_POINTS)
    exact = reference_sum(path, sources, weights, target.points()[pick], wavelength)
    return float(np.linalg.norm(field.ravel()[pick] - exact) / np.linalg.norm(exact))


class AberratedPath:
    """Smooth path without closed form, with a complex amplitude: what a traced lens looks like from outside."""

    pairs = 0

    def __call__(self, sources, targets):
        self.pairs += len(sources) * len(targets)
        r = np.linalg.norm(sources[:, None] - targets[None], axis=2)
        x = sources[:, None, 0] + 0.5 * targets[None, :, 0]
        y = sources[:, None, 1] + 0.4 * targets[None, :, 1]
        return r + 2e-3 * (x**2 + y**2) + 1e-4 * x**3, (1 + 0.01j * x) / r


def test_chebyshev_matrix_is_exact_for_polynomials():
    x = np.concatenate([np.linspace(-1, 1, 17), chebyshev_nodes(9)[2:4]])
    assert np.allclose(interpolation_matrix(9, x) @ chebyshev_nodes(9) ** 8, x**8, atol=1e-13)


def test_tensor_series_is_exact_for_polynomials():
    nodes = tensor_nodes((5, 4, 1))
    values = np.stack([nodes[:, 0] ** 4 * nodes[:, 1] ** 3, nodes[:, 0] - nodes[:, 1]], axis=1)
    series = TensorSeries.pruned(tensor_coefficients(values, (5, 4, 1)), 1e-12)
    x = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    assert np.allclose(series(x), np.stack([x[:, 0] ** 4 * x[:, 1] ** 3, x[:, 0] - x[:, 1]], axis=1), atol=1e-12)
    assert len(series.index) < 20


def test_flat_spot_has_a_flat_box_whatever_its_tilt():
    sources, _ = spot(500, 0.12, 0.0)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    box = SourceBox.around(sources @ turn.T + 5.0, np.array([1.0, 0, 0]))
    assert box.half[2] == 0.0
    places = box.to_local(sources @ turn.T + 5.0)
    assert np.abs(places).max() <= 1 + 1e-12
    assert np.allclose(box.to_world(places), sources @ turn.T + 5.0, atol=1e-12)


def test_field_of_a_small_spot_needs_far_fewer_nodes_than_pixels():
    sources, weights = spot(1000, 0.12, 1e-3)
    grid = detector(60.0, shape=(480, 744), pitch=0.006)
    box = SourceBox.around(sources, grid.u)
    reach = reach_of(FreeSpace(), sources, weights, box, grid)
    nodes = node_grid(FreeSpace(), reach, grid, WAVELENGTH, 1e-4)
    assert nodes.size * 20 < grid.size


@pytest.mark.parametrize("half_turns", [0.0, 1e-3, 0.4, 7.0, 60.0, 400.0])
@pytest.mark.parametrize("tolerance", [1e-1, 1e-4, 1e-9])
def test_nodes_are_as_many_as_a_plane_wave_needs_and_few_more(half_turns, tolerance):
    """All power in the outermost bin: the wave itself, interpolated from the nodes and looked at between them."""
    power = np.zeros(REACH_BINS)
    power[-1] = 1.0
    count = nodes_for(half_turns, power, tolerance)
    places = np.random.default_rng(1).uniform(-1, 1, 300)

    def error(nodes: int) -> float:
        wave = np.exp(2j * np.pi * half_turns * chebyshev_nodes(nodes))
        exact = np.exp(2j * np.pi * half_turns * places)
        return float(np.sqrt(np.mean(np.abs(interpolation_matrix(nodes, places) @ wave - exact) ** 2)))

    assert error(count) < tolerance
    # Two for the amplitude; beyond the bandwidth c the coefficients fall within some c^(1/3) orders.
    spare = 4 + int(np.cbrt(2 * np.pi * half_turns))
    assert count <= spare or error(count - spare) > tolerance


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-5, 1e-8])
@pytest.mark.parametrize("method", ["auto", "fast"])
def test_requested_tolerance_is_kept_and_the_reported_error_is_honest(method, tolerance):
    sources, weights = spot(400, 0.12, 1e-3)
    grid = detector(60.0)
    result = coherent_sum(FreeSpace(), sources, weights, grid, WAVELENGTH, method, tolerance)
    error = error_at_random_points(FreeSpace(), sources, weights, grid, result.field)
    assert error <= tolerance
    assert result.numerical_error <= tolerance
    assert error <= 3 * result.numerical_error + 1e-9  # both are estimates from some tens of random points
    assert result.field.shape == grid.shape


@pytest.mark.parametrize(("tilt", "roughness", "dimensions"), [(0.0, 1e-3, 2), (1.2, 20e-3, 3)])
def test_low_rank_sum_equals_the_exact_sum(tilt, roughness, dimensions):
    sources, weights = spot(3000, 0.12, roughness)
    grid = detector(60.0, tilt)
    for tolerance in (1e-2, 1e-4, 1e-6):
        box = SourceBox.around(sources, grid.u)
        expansion = expand(FreeSpace(), sources, weights, grid, box, WAVELENGTH, tolerance)
        assert len(expansion.linear) == dimensions
        a, b = np.random.default_rng(2).random((2, 40)) * [[grid.columns[-1]], [grid.rows[-1]]]
        points = PlanePoints(grid.origin, grid.u, grid.v, a, b)
        field = low_rank_sum(expansion, sources, weights, points)
        exact = reference_sum(FreeSpace(), sources, weights, points.points(), WAVELENGTH)
        assert np.linalg.norm(field - exact) <= tolerance * np.linalg.norm(exact)


def test_expansion_says_when_it_would_not_pay():
    sources, weights = spot(200, 5.0, 0.0)
    grid = detector(4.0, 0.0)
    box = SourceBox.around(sources, grid.u)
    assert expand(FreeSpace(), sources, weights, grid, box, WAVELENGTH, 1e-4) is None


@pytest.mark.parametrize("method", ["auto", "direct"])
def test_any_smooth_path_will_do(method):
    sources, weights = spot(300, 0.12, 1e-3)
    grid = detector(60.0)
    path = AberratedPath()
    result = coherent_sum(path, sources, weights, grid, WAVELENGTH, method, 1e-4)
    assert path.pairs < 0.01 * len(sources) * grid.size  # the slow path is asked for on few nodes only
    tolerance = 1e-4 if method == "auto" else 1e-6
    assert error_at_random_points(AberratedPath(), sources, weights, grid, result.field) <= tolerance


def test_series_of_a_path_has_its_phase():
    sources, _ = spot(100, 0.12, 1e-3)
    grid = detector(60.0)
    box = SourceBox.around(sources, grid.u)
    series = interpolated(AberratedPath(), box, grid, WAVELENGTH, 1e-6)
    places = grid.points()[::997]
    length, amplitude = AberratedPath()(sources, places)
    found_length, found_amplitude = series(sources, places)
    assert 2 * np.pi / WAVELENGTH * np.abs(found_length - length).max() < 1e-5
    assert np.allclose(found_amplitude, amplitude, rtol=1e-5)


def test_scattered_points_of_an_opening_are_a_target_too():
    sources, weights = spot(2000, 0.12, 1e-3)
    r, angle = np.meshgrid(np.linspace(0.01, 0.5, 60), np.linspace(0, 2 * np.pi, 100, endpoint=False))
    opening = PlanePoints(
        np.array([0.0, 0, 41]), np.eye(3)[0], np.eye(3)[1], (r * np.cos(angle)).ravel(), (r * np.sin(angle)).ravel()
    )
    for method in ("direct", "fast", "auto"):
        result = coherent_sum(FreeSpace(), sources, weights, opening, WAVELENGTH, method, 1e-4)
        assert result.field.shape == (opening.size,)
        assert error_at_random_points(FreeSpace(), sources, weights, opening, result.field) <= 1e-4


def test_result_is_linear_in_the_weights_and_zero_without_light():
    sources, weights = spot(50, 0.12, 1e-3)
    grid = detector(60.0)
    one = coherent_sum(FreeSpace(), sources, weights, grid, WAVELENGTH)
    large = coherent_sum(FreeSpace(), sources, 1e30 * weights, grid, WAVELENGTH)
    assert np.allclose(large.field, 1e30 * one.field, rtol=1e-5, atol=1e-6 * np.abs(large.field).max())
    assert not coherent_sum(FreeSpace(), sources, 0 * weights, grid, WAVELENGTH).field.any()
    assert not coherent_sum(FreeSpace(), sources[:0], weights[:0], grid, WAVELENGTH).field.any()


def test_target_that_cuts_through_the_sources_is_summed_pair_by_pair():
    sources, weights = spot(50, 0.12, 1e-3)
    grid = detector(0.0, shape=(30, 40), pitch=0.005)
    result = coherent_sum(FreeSpace(), sources, weights, grid, WAVELENGTH, "fast")
    assert "every one" in str(result.how)
    assert error_at_random_points(FreeSpace(), sources, weights, grid, result.field) < 1e-4


def test_error_of_a_focus_in_a_dark_field_is_measured_in_the_focus():
    """Sources phased for one pixel: nearly all light falls on a few of 19,200."""
    random = np.random.default_rng(4)
    sources = np.column_stack([random.uniform(-2, 2, (3000, 2)), np.zeros(3000)])
    grid = detector(60.0, pitch=0.01)
    focus = grid.points()[60 * 160 + 80]
    weights = np.exp(-2j * np.pi / WAVELENGTH * np.linalg.norm(focus - sources, axis=1))
    result = coherent_sum(FreeSpace(), sources, weights, grid, WAVELENGTH, "fast", 1e-3)
    near = (np.arange(57, 64)[:, None] * 160 + np.arange(77, 84)).ravel()
    exact = reference_sum(FreeSpace(), sources, weights, grid.points()[near], WAVELENGTH)
    assert np.linalg.norm(result.field.ravel()[near] - exact) <= 1e-3 * np.linalg.norm(exact)
    assert result.numerical_error <= 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "quick"}, "auto, direct, fast"),
        ({"tolerance": 1.0}, "tolerance"),
        ({"wavelength": 0.0}, "wavelength"),
        ({"weights": np.ones(3)}, "weights"),
        ({"sources": np.ones((4, 2))}, "sources"),
        ({"sources": np.full((4, 3), np.nan)}, "finite"),
    ],
)
def test_bad_input_is_refused_by_name(change, message):
    arguments = {"path": FreeSpace(), "sources": np.ones((4, 3)), "weights": np.ones(4), "target": detector(60.0),
                 "wavelength": WAVELENGTH, "method": "auto", "tolerance": 1e-4}  # fmt: skip
    with pytest.raises(ValueError, match=message):
        coherent_sum(**(arguments | change))
