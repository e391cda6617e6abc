"""Tensor Chebyshev interpolation against the functions themselves."""

from __future__ import annotations

import numpy as np
import pytest

from speckle_mi.geometry import Frame
from speckle_mi.optics.chebyshev import Interpolant, adapt, fit, node_grid, nodes
from speckle_mi.optics.path import TracedPath
from speckle_mi.optics.surfaces import Circle, Interaction, Sequence, Surface

ROUNDING = 1e-13  # some hundred roundings of values of order one
WAVELENGTH = 632.8e-6  # mm


def interpolate(function, orders, lower, upper) -> Interpolant:
    values = function(node_grid(orders, lower, upper))
    return fit(values.reshape(*orders, *values.shape[1:]), lower, upper)


def inside(rng: np.random.Generator, n: int, lower, upper) -> np.ndarray:
    return rng.uniform(lower, upper, (n, len(lower)))


@pytest.mark.parametrize("orders", [(5,), (4, 7), (3, 4, 5), (3, 2, 4, 3)])
def test_polynomials_below_the_order_are_reproduced(orders):
    rng = np.random.default_rng(1)
    d = len(orders)
    lower, upper = rng.uniform(-2, 0, d), rng.uniform(1, 3, d)
    powers = [np.stack([rng.integers(0, n) for n in orders]) for _ in range(6)]
    weights = rng.normal(size=(6, 2)) + 1j * rng.normal(size=(6, 2))
    function = lambda x: sum(np.prod(x**p, axis=1)[:, None] * w for p, w in zip(powers, weights))  # noqa: E731
    points = inside(rng, 50, lower, upper)
    exact = function(points)
    got = interpolate(function, orders, lower, upper)(points)
    assert got.shape == exact.shape == (50, 2)
    np.testing.assert_allclose(got, exact, rtol=0, atol=ROUNDING * max(1.0, np.abs(exact).max() * 10))


def test_interpolant_equals_the_function_at_its_nodes():
    lower, upper = np.array([-1.0, 2.0]), np.array([0.5, 7.0])
    function = lambda x: np.cos(9 * x[:, 0]) * np.abs(x[:, 1] - 4.0)  # noqa: E731
    grid = node_grid((6, 9), lower, upper)
    np.testing.assert_allclose(interpolate(function, (6, 9), lower, upper)(grid), function(grid), rtol=0, atol=ROUNDING)


def test_nodes_are_the_zeros_of_the_chebyshev_polynomial_inside_the_interval():
    x = nodes(7, 2.0, 5.0)
    assert np.all((x > 2.0) & (x < 5.0)) and np.all(np.diff(x) < 0)
    np.testing.assert_allclose(np.cos(7 * np.arccos((x - 3.5) / 1.5)), 0.0, atol=1e-14)
    assert nodes(1, 2.0, 2.0)[0] == 2.0


def test_grid_evaluation_equals_scattered_evaluation():
    rng = np.random.default_rng(2)
    lower, upper = np.array([-1.0, 0.0, 3.0]), np.array([1.0, 2.0, 3.0])
    function = lambda x: np.stack([np.exp(1j * x[:, 0] * x[:, 1]), x[:, 2] + 0j], axis=1)  # noqa: E731
    series = interpolate(function, (9, 8, 1), lower, upper)
    coordinates = [rng.uniform(-1, 1, 5), rng.uniform(0, 2, 6), np.array([3.0])]
    mesh = np.stack([m.ravel() for m in np.meshgrid(*coordinates, indexing="ij")], axis=1)
    np.testing.assert_allclose(series.on_grid(coordinates).reshape(-1, 2), series(mesh), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(series(mesh), function(mesh), rtol=0, atol=1e-4)


def test_long_lists_of_points_are_evaluated_in_chunks_without_a_seam(monkeypatch):
    lower, upper = np.zeros(2), np.ones(2)
    series = interpolate(lambda x: np.sin(x[:, 0] + 2 * x[:, 1]), (10, 10), lower, upper)
    points = inside(np.random.default_rng(3), 1000, lower, upper)
    whole = series(points)
    monkeypatch.setattr("speckle_mi.optics.chebyshev.CHUNK", 70)
    np.testing.assert_allclose(series(points), whole, rtol=0, atol=ROUNDING)


def test_error_falls_geometrically_and_the_tail_bounds_it():
    lower, upper = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    function = lambda x: 1.0 / (3.0 + x[:, 0] + 0.5 * x[:, 1])  # noqa: E731
    points = inside(np.random.default_rng(4), 400, lower, upper)
    for order in (5, 8, 12, 16):
        series = interpolate(function, (order, order), lower, upper)
        error = np.abs(series(points) - function(points)).max()
        assert error < series.tails().sum() < 1e3 * error


@pytest.mark.parametrize("tolerance", [1e-3, 1e-7, 1e-11])
def test_adapted_interpolant_meets_its_tolerance_everywhere(tolerance):
    lower, upper = np.array([-1.0, 0.0, 2.0, 0.5]), np.array([1.0, 3.0, 2.0, 1.0])
    function = lambda x: np.stack(  # noqa: E731
        [np.sqrt(25.0 + (x[:, 0] - x[:, 1]) ** 2 + x[:, 2]), np.exp(0.3j * x[:, 0] * x[:, 3])], axis=1
    )
    series, error = adapt(function, lower, upper, tolerance)
    points = inside(np.random.default_rng(5), 1000, lower, upper)
    assert series.orders[2] == 1
    assert np.all(error <= tolerance)
    assert np.abs(series(points) - function(points)).max() <= tolerance


def test_each_value_has_its_own_tolerance_and_a_looser_one_is_cheaper():
    lower, upper = np.array([0.0]), np.array([4.0])
    function = lambda x: np.concatenate([np.sin(x), 1e3 * np.sin(3 * x)], axis=1)  # noqa: E731
    loose, _ = adapt(function, lower, upper, np.array([1e-6, 1e-2]))
    tight, _ = adapt(function, lower, upper, 1e-6)
    points = inside(np.random.default_rng(6), 500, lower, upper)
    assert np.all(np.abs(loose(points) - function(points)).max(axis=0) <= [1e-6, 1e-2])
    assert loose.orders < tight.orders


def test_mixed_terms_that_no_line_shows_are_caught_on_the_grid():
    # Vanishes on every line through a probing point only by accident; wiggles along the diagonal.
    lower, upper = -np.ones(2), np.ones(2)
    function = lambda x: np.cos(8 * x[:, 0] * x[:, 1])  # noqa: E731
    series, _ = adapt(function, lower, upper, 1e-8)
    points = inside(np.random.default_rng(7), 2000, lower, upper)
    assert np.abs(series(points) - function(points)).max() <= 1e-8


def test_what_cannot_be_interpolated_is_refused():
    with pytest.raises(ValueError, match="not smooth"):
        adapt(lambda x: np.abs(x[:, 0] - 0.3), np.array([-1.0]), np.array([1.0]), 1e-8)
    with pytest.raises(ValueError, match="not finite"), np.errstate(invalid="ignore"):
        adapt(lambda x: np.sqrt(x[:, 0]), np.array([-1.0]), np.array([1.0]), 1e-8)
    with pytest.raises(ValueError, match="divide the box"):
        adapt(lambda x: np.cos(20 * x.sum(axis=1)), -np.ones(4), np.ones(4), 1e-8, maximum_nodes=1000)
    with pytest.raises(ValueError, match="box from"):
        fit(np.zeros((3, 3)), np.array([0.0, 1.0]), np.array([1.0, 0.0]))
    with pytest.raises(ValueError, match="tolerance"):
        adapt(lambda x: x, np.array([0.0]), np.array([1.0]), 0.0)


# --- traced paths
# ------------------------------------------------------------------------------------------------------


def imaging_lens(target_z: float) -> TracedPath:
    """Biconvex lens, f = 49.4 mm, 100 mm behind the sources."""
    plane = lambda z: Frame(np.array([0.0, 0.0, z]), np.eye(3))  # noqa: E731
    return TracedPath(
        Sequence(
            (
                Interaction.refract(Surface(plane(100.0), 0.02, outline=Circle(10.0)), 1.0, 1.5151),
                Interaction.refract(Surface(plane(105.0), -0.02, outline=Circle(10.0)), 1.5151, 1.0),
                Interaction.through(Surface(plane(target_z))),
            )
        )
    )


def test_traced_path_through_a_lens_is_interpolated_to_a_hundred_thousandth_of_a_wavelength():
    path = imaging_lens(106.0)
    nodes_p = node_grid((4, 4, 3), np.array([-0.2, -0.2, -0.02]), np.array([0.2, 0.2, 0.02]))
    nodes_d = node_grid((8, 8, 1), np.array([-2.0, -2.0, 106.0]), np.array([2.0, 2.0, 106.0]))
    length, _ = path(nodes_p, nodes_d)
    lower, upper = np.array([-0.2, -0.2, -0.02, -2.0, -2.0]), np.array([0.2, 0.2, 0.02, 2.0, 2.0])
    series = fit(length.reshape(4, 4, 3, 8, 8), lower, upper)
    points = inside(np.random.default_rng(8), 200, lower, upper)
    p, d = points[:, :3], np.column_stack([points[:, 3:], np.full(200, 106.0)])
    exact = np.array([path(p[i : i + 1], d[i : i + 1])[0][0, 0] for i in range(0, 200, 10)])
    assert np.abs(series(points)[::10] - exact).max() < 1e-5 * WAVELENGTH


def test_traced_amplitude_turns_by_minus_one_through_a_point_focus():
    p, d = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.0], [0.3, 0.1, 0.0]])
    before = imaging_lens(120.0)(p, d + [0, 0, 120.0])[1]
    beyond = imaging_lens(300.0)(p, d + [0, 0, 300.0])[1]
    assert before.shape == (2, 2)
    assert np.all(before.real > 0) and np.all(before.imag == 0)
    assert np.all(beyond.real < 0) and np.all(beyond.imag == 0)


def test_traced_path_gives_margins_of_all_rims_and_refuses_unreachable_pairs():
    path = imaging_lens(106.0)
    p, d = np.zeros((1, 3)), np.array([[0.0, 0.0, 106.0], [9.9, 0.0, 106.0], [11.0, 0.0, 106.0]])
    margins = path.margins(p, d)
    assert margins.shape == (2, 1, 3)
    assert np.all(margins[:, 0, 0] == 1.0) and np.all(margins[:, 0, 2] < 0.0)
    with pytest.raises(ValueError, match="1 of 3 pairs .* no ray"):
        path(p, np.array([[0.0, 0.0, 106.0], [1.0, 0.0, 106.0], [500.0, 0.0, 106.0]]))
