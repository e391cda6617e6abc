"""Chebyshev interpolation on boxes: nodes, barycentric matrices, and pruned tensor series at scattered places.

Source of the barycentric formula: Berrut & Trefethen, SIAM Review 46 (2004), doi:10.1137/S0036144502417715.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PLACES_AT_ONCE = 1 << 12
"""Places at which few functions are summed at once: their arrays stay in the processor's cache."""


def chebyshev_nodes(count: int) -> np.ndarray:
    """(count,) Chebyshev points of the first kind on [-1, 1], ascending."""
    return -np.cos((np.arange(count) + 0.5) * np.pi / count)


def interpolation_matrix(count: int, places: np.ndarray) -> np.ndarray:
    """(m, count) matrix from values at ``chebyshev_nodes(count)`` to the places (m,) in [-1, 1], barycentric."""
    if count == 1:
        return np.ones((len(places), 1))
    nodes = chebyshev_nodes(count)
    signs = np.where(np.arange(count) % 2, -1.0, 1.0) * np.sin((np.arange(count) + 0.5) * np.pi / count)
    matrix = np.subtract.outer(places, nodes)
    with np.errstate(divide="ignore", invalid="ignore"):  # a place on a node, mended below
        np.divide(signs, matrix, out=matrix)
        total = matrix.sum(axis=1)
        matrix /= total[:, None]
    on_node = np.isinf(total)
    matrix[on_node] = places[on_node, None] == nodes
    return matrix


def coefficient_matrix(count: int) -> np.ndarray:
    """(count, count) matrix from values at ``chebyshev_nodes(count)`` to coefficients of T_0 ... T_{count-1}."""
    angle = (np.arange(count) + 0.5) * np.pi / count
    # Ascending nodes are cos(pi - angle): T_n(node) = (-1)^n cos(n angle).
    matrix = 2 / count * np.cos(np.outer(np.arange(count), np.pi - angle))
    matrix[0] /= 2
    return matrix


def tensor_nodes(orders: tuple[int, ...]) -> np.ndarray:
    """(product of orders, dimensions) tensor Chebyshev nodes on [-1, 1]^d, last dimension fastest."""
    axes = np.meshgrid(*(chebyshev_nodes(order) for order in orders), indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)


def tensor_coefficients(values: np.ndarray, orders: tuple[int, ...]) -> np.ndarray:
    """Coefficients (*orders, k) of values (product of orders, k) on ``tensor_nodes(orders)``."""
    tensor = values.reshape(*orders, -1)
    for axis, order in enumerate(orders):
        tensor = np.moveaxis(np.tensordot(coefficient_matrix(order), tensor, axes=(1, axis)), 0, axis)
    return tensor


def axis_tails(coefficients: np.ndarray, last: int = 2) -> np.ndarray:
    """For each dimension but the last one: norm of the ``last`` coefficient slices relative to the whole.

    Zero for a dimension of one node: it has no extent.
    """
    total = np.linalg.norm(coefficients) or 1.0
    tails = []
    for axis, order in enumerate(coefficients.shape[:-1]):
        end = np.take(coefficients, range(max(1, order - last), order), axis=axis) if order > 1 else np.zeros(1)
        tails.append(np.linalg.norm(end) / total)
    return np.array(tails)


def tensor_polynomials(index: np.ndarray, places: np.ndarray, dtype: type = np.float64) -> np.ndarray:
    """T_{index[q,0]}(x) T_{index[q,1]}(y) ...: (q, n) at places (n, d) in [-1, 1]^d, for index (q, d)."""
    powers = [_ladder(int(row.max(initial=0)) + 1, x, dtype) for row, x in zip(index.T, places.T, strict=True)]
    basis = np.empty((len(index), len(places)), dtype=dtype)
    for row, term in zip(basis, index, strict=True):
        factors = [powers[axis][n] for axis, n in enumerate(term) if n > 0]
        if not factors:
            row[:] = 1.0
        elif len(factors) == 1:
            row[:] = factors[0]
        else:
            np.multiply(factors[0], factors[1], out=row)
            for factor in factors[2:]:
                row *= factor
    return basis


def _ladder(order: int, places: np.ndarray, dtype: type) -> np.ndarray:
    """T_0 ... T_{order-1} (order, n) at places (n,)."""
    x = np.ascontiguousarray(places, dtype=dtype)
    ladder = np.ones((order, len(x)), dtype=dtype)
    if order > 1:
        ladder[1] = x
    for n in range(2, order):
        np.multiply(x, ladder[n - 1], out=ladder[n])
        ladder[n] *= 2
        ladder[n] -= ladder[n - 2]
    return ladder


@dataclass(frozen=True)
class TensorSeries:
    """sum_q coefficients[q] T_{index[q,0]}(x) T_{index[q,1]}(y) ...: k functions with only the terms that matter.

    index: (q, d) int; coefficients: (q, k) real.
    """

    index: np.ndarray
    coefficients: np.ndarray

    @classmethod
    def pruned(cls, coefficients: np.ndarray, tolerance: float) -> TensorSeries:
        """From real coefficients (*orders, k), without the smallest terms: together ``tolerance`` of the L2 norm."""
        orders, functions = coefficients.shape[:-1], coefficients.shape[-1]
        flat = coefficients.reshape(-1, functions)
        size = np.linalg.norm(flat, axis=1)
        order = np.argsort(size)
        dropped = np.sqrt(np.cumsum(size[order] ** 2)) <= tolerance * np.linalg.norm(size)
        keep = np.sort(order[~dropped])
        return cls(np.stack(np.unravel_index(keep, orders), axis=1), flat[keep])

    def __call__(self, places: np.ndarray, dtype: type = np.float64) -> np.ndarray:
        """Values (n, k) at places (n, d) in [-1, 1]^d."""
        orders = self.index.max(axis=0, initial=0) + 1
        long = np.flatnonzero(orders > 1)
        if len(long) == 2 and self.coefficients.shape[1] < orders[long[1]]:
            return self._side_by_side(places, long, orders[long], dtype)
        basis = tensor_polynomials(self.index, places, dtype)
        return (self.coefficients.T.astype(dtype, copy=False) @ basis).T

    def _side_by_side(self, places: np.ndarray, axes: np.ndarray, orders: np.ndarray, dtype: type) -> np.ndarray:
        """The same for few functions of the two coordinates ``axes``: summed along one, then along the other.

        The products of polynomials, which would take longer than the sums, are never formed.
        """
        dense = np.zeros((self.coefficients.shape[1], *orders), dtype=dtype)
        dense[:, self.index[:, axes[0]], self.index[:, axes[1]]] = self.coefficients.T
        found = np.empty((len(places), len(dense)), dtype=dtype)
        for first in range(0, len(places), PLACES_AT_ONCE):
            some = places[first : first + PLACES_AT_ONCE]
            one, other = (_ladder(order, some[:, axis], dtype) for axis, order in zip(axes, orders, strict=True))
            rows = (dense.reshape(-1, orders[1]) @ other).reshape(len(dense), orders[0], -1)
            found[first : first + PLACES_AT_ONCE] = np.einsum("kan,an->nk", rows, one)
        return found
