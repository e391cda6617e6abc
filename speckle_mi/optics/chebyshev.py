"""Tensor Chebyshev interpolation of smooth functions on boxes in d dimensions.

f(x) = sum c_{j1..jd} T_{j1}(t_1) ... T_{jd}(t_d), t the coordinates scaled to [-1, 1], through the zeros of T_n. For a
function that is analytic around the box the error falls geometrically with the order, and so do the coefficients, which
is how the error is known (L. N. Trefethen, "Approximation Theory and Approximation Practice", SIAM 2013, ch. 2 to 8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.fft import dct
from scipy.stats import qmc

CHUNK = 2**22
"""Numbers held at once in an evaluation at scattered points."""
LINES = 4
"""Lines per axis, at different places in the box, that the first choice of orders is made from."""
CHECK_POINTS = 32
"""Points between the nodes at which an adapted interpolant is compared with the function."""
MAXIMUM_ORDER = 128
DECAY_SAFETY = 4.0
"""Coefficients do not fall evenly; what the last ones predict for the rest is taken this many times."""


@dataclass(frozen=True, eq=False)
class Interpolant:
    """Chebyshev series on the box ``lower`` (d,) to ``upper`` (d,); ``coefficients`` (n_1, ..., n_d, *value shape).

    A side of length zero is allowed and has one node.
    """

    lower: np.ndarray
    upper: np.ndarray
    coefficients: np.ndarray

    @property
    def dimension(self) -> int:
        return self.lower.size

    @property
    def orders(self) -> tuple[int, ...]:
        """Nodes per axis."""
        return self.coefficients.shape[: self.dimension]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Values (n, *value shape) at scattered ``points`` (n, d)."""
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != self.dimension:
            raise ValueError(f"points {points.shape}: must be (n, {self.dimension}), a row a point")
        out = np.empty((points.shape[0], *self.coefficients.shape[self.dimension :]), dtype=self.coefficients.dtype)
        rows = max(1, CHUNK // max(1, self.coefficients[0].size))
        for start in range(0, points.shape[0], rows):
            part = points[start : start + rows]
            value = np.tensordot(self.basis(0, part[:, 0]), self.coefficients, axes=1)
            for axis in range(1, self.dimension):
                value = np.einsum("nj,nj...->n...", self.basis(axis, part[:, axis]), value)
            out[start : start + rows] = value
        return out

    def on_grid(self, coordinates: Sequence[np.ndarray]) -> np.ndarray:
        """Values (m_1, ..., m_d, *value shape) on the tensor grid of ``coordinates``, d arrays (m_i,).

        One matrix product an axis, far cheaper than as many scattered points.
        """
        if len(coordinates) != self.dimension:
            raise ValueError(f"{len(coordinates)} coordinate arrays for a box in {self.dimension} dimensions")
        value = self.coefficients
        for axis, x in enumerate(coordinates):
            value = np.moveaxis(
                np.tensordot(self.basis(axis, np.asarray(x, dtype=np.float64)), value, axes=(1, axis)), 0, axis
            )
        return value

    def tails(self) -> np.ndarray:
        """Error estimate per axis and value (d, *value shape), from the decay of the coefficients.

        e, the root sum of squares of the last two coefficients along the axis (two, because an even or odd function has
        every other coefficient zero), and f, that of the two before, predict e^2/f for the next two, and a geometric
        series of them for all that is left out. Taken ``DECAY_SAFETY`` times, at most e. An axis with fewer than three
        nodes tells nothing and gives inf, unless its side has no length.
        """
        d = self.dimension
        squares = np.abs(self.coefficients) ** 2
        tails = []
        for axis in range(d):
            along = np.sqrt(np.moveaxis(squares, axis, 0).sum(axis=tuple(range(1, d))))
            last = np.sqrt((along[-2:] ** 2).sum(axis=0))
            if self.lower[axis] == self.upper[axis]:
                last = np.zeros_like(last)
            elif self.orders[axis] < 3:
                last = np.full_like(last, np.inf)
            else:
                before = np.sqrt((along[1:][-4:-2] ** 2).sum(axis=0))  # without the mean, which is no part of the decay
                ratio = np.divide(last, before, out=np.full_like(last, 0.5), where=before > 2.0 * last)
                last = last * np.minimum(1.0, DECAY_SAFETY * ratio / (1.0 - ratio))
            tails.append(last)
        return np.stack(tails)

    def basis(self, axis: int, x: np.ndarray) -> np.ndarray:
        """T_j(t), (m, n_axis)."""
        half = 0.5 * (self.upper[axis] - self.lower[axis])
        t = (x - 0.5 * (self.lower[axis] + self.upper[axis])) / half if half else np.zeros_like(x)
        return chebvander(t, self.orders[axis] - 1)


def nodes(order: int, lower: float, upper: float) -> np.ndarray:
    """Zeros of T_order scaled to (lower, upper), (order,), falling: the nodes that ``fit`` expects along an axis."""
    # cos in the form of a sine is exactly antisymmetric about the middle.
    t = np.sin(0.5 * np.pi * np.arange(order - 1, -order, -2) / order)
    return 0.5 * (lower + upper) + 0.5 * (upper - lower) * t


def node_grid(orders: Sequence[int], lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """All nodes of a box, (n_1 * ... * n_d, d), row-major (last axis fastest)."""
    axes = [nodes(n, a, b) for n, a, b in zip(orders, lower, upper, strict=True)]
    return np.stack([mesh.ravel() for mesh in np.meshgrid(*axes, indexing="ij")], axis=1)


def fit(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Interpolant:
    """Interpolant of ``values`` (n_1, ..., n_d, *value shape), real or complex, given at ``nodes`` along every axis.

    Raises ValueError when the box is not one (lower > upper, unequal lengths) or a value is not finite.
    """
    lower, upper = _box(lower, upper)
    coefficients = np.asarray(values)
    if coefficients.ndim < lower.size:
        raise ValueError(f"values {coefficients.shape}: a box in {lower.size} dimensions needs as many axes")
    if not np.isfinite(coefficients).all():
        raise ValueError(
            f"{np.count_nonzero(~np.isfinite(coefficients))} of {coefficients.size} values at the nodes are not finite"
        )
    for axis in range(lower.size):
        coefficients = _transform(coefficients, axis)
    return Interpolant(lower, upper, coefficients)


def adapt(
    function: Callable[[np.ndarray], np.ndarray],
    lower: np.ndarray,
    upper: np.ndarray,
    tolerance: float | np.ndarray,
    maximum_nodes: int = 200_000,
) -> tuple[Interpolant, np.ndarray]:
    """Interpolant of ``function`` to an absolute ``tolerance``, and its error estimate (*value shape).

    function: points (n, d) -> values (n, *value shape), real or complex; tolerance: scalar or broadcastable to the
    value shape, positive. Orders are chosen per axis from a few lines through the box, then proven on the full grid by
    the decay of the coefficients and by comparison between the nodes; axes that fail get more nodes.
    Raises ValueError when the tolerance is not met with ``maximum_nodes`` nodes or ``MAXIMUM_ORDER`` an axis.
    """
    lower, upper = _box(lower, upper)
    if not np.all(np.asarray(tolerance) > 0.0):
        raise ValueError(f"tolerance = {tolerance}: must be positive")
    scatter = qmc.Halton(lower.size, scramble=False).random(CHECK_POINTS + LINES + 1)[1:]
    scatter = lower + scatter * (upper - lower)
    lines, checks = scatter[:LINES], scatter[LINES:]
    share = np.asarray(tolerance) / lower.size
    orders = [_line_order(function, lower, upper, axis, lines, share) for axis in range(lower.size)]
    exact = np.asarray(function(checks))
    while True:
        size = int(np.prod(orders))
        if size > maximum_nodes or max(orders) > MAXIMUM_ORDER:
            raise ValueError(
                f"Chebyshev interpolation to {np.min(tolerance):.3g} would need {' x '.join(map(str, orders))} nodes, "
                f"more than {maximum_nodes} in all or {MAXIMUM_ORDER} an axis: divide the box, or ask for less"
            )
        values = np.asarray(function(node_grid(orders, lower, upper)))
        interpolant = fit(values.reshape(*orders, *values.shape[1:]), lower, upper)
        tails = interpolant.tails()
        found = np.abs(interpolant(checks) - exact).max(axis=0)
        error = np.maximum(tails.sum(axis=0), found)
        if np.all(error <= tolerance):
            return interpolant, error
        excess = (tails / share).reshape(lower.size, -1).max(axis=1)
        for axis in np.flatnonzero((excess > 1.0) | (excess == excess.max())):
            orders[axis] += max(2, orders[axis] // 4)


def _line_order(
    function, lower: np.ndarray, upper: np.ndarray, axis: int, through: np.ndarray, tolerance: np.ndarray
) -> int:
    """Nodes that bring what is left out along one axis below ``tolerance``, judged on lines through points (l, d)."""
    if lower[axis] == upper[axis]:
        return 1
    order = 8
    while True:
        points = np.repeat(through[:, None], order, axis=1)
        points[:, :, axis] = nodes(order, lower[axis], upper[axis])
        values = np.asarray(function(points.reshape(-1, lower.size)))
        if not np.isfinite(values).all():
            raise ValueError(
                f"{np.count_nonzero(~np.isfinite(values))} of {values.size} values in the box are not finite"
            )
        sizes = np.abs(_transform(values.reshape(len(through), order, *values.shape[1:]), 1)).max(axis=0)
        # left[j], in tolerances: the coefficients from j on, twice, since those left out also alias into those kept.
        left = 2.0 * (np.cumsum(sizes[::-1], axis=0)[::-1] / tolerance).reshape(order, -1).max(axis=1)
        if left[-2] <= 1.0:
            return max(3, int(np.argmax(left <= 1.0)))
        if order >= MAXIMUM_ORDER:
            raise ValueError(
                f"Chebyshev interpolation to {np.min(tolerance):.3g}: axis {axis} is not resolved by {order} nodes "
                f"(left over: {left[-2]:.3g} tolerances); the function is not smooth or the tolerance is below rounding"
            )
        order *= 2


def _transform(values: np.ndarray, axis: int) -> np.ndarray:
    """Chebyshev coefficients along one axis from values at ``nodes``: a cosine transform of type II."""
    order = values.shape[axis]
    coefficients = dct(values, type=2, axis=axis) / order
    first = np.moveaxis(coefficients, axis, 0)
    first[0] *= 0.5
    return coefficients


def _box(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = (np.atleast_1d(np.asarray(side, dtype=np.float64)) for side in (lower, upper))
    if lower.ndim != 1 or lower.shape != upper.shape or not np.all(lower <= upper):
        raise ValueError(f"box from {lower} to {upper}: needs as many lower as upper limits, lower <= upper")
    return lower, upper
