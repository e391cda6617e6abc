"""Which part of a variance comes from which input: Sobol indices from a sample that is made for them.

Rows A and B are independent, and rows AB_i are those of A with the columns of factor i from B. Values may be known
only with noise that is independent from one surface to the next; products are then taken of different surfaces, so that
what they average to is free of it.

References: A. Saltelli et al., Comput. Phys. Commun. 181, 259 (2010), DOI 10.1016/j.cpc.2009.09.018;
M. J. W. Jansen, Comput. Phys. Commun. 117, 35 (1999), DOI 10.1016/S0010-4655(98)00154-4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

FEWEST_ROWS = 8
RESAMPLED = 200
"""Bootstrap samples of the rows, from which standard errors come."""

HIGHEST_DEGREE, ROWS_A_TERM = 8, 6
"""Of the polynomials that take off the main effects, and rows for each of their coefficients at least."""

NOTHING = 1e-7
"""Standard deviation relative to the largest value below which nothing varies, but by rounding."""


def base_rows(samples: int, factors: int) -> int:
    """Rows of A such that A, B and every AB_i have about ``samples`` in all: a power of two, at least 8."""
    return max(1 << round(float(np.log2(max(samples / (factors + 2), 1)))), FEWEST_ROWS)


def probabilities(rows: int, columns: Sequence[int], seed: int = 0) -> np.ndarray:
    """(factors + 2, rows, k) by scrambled Sobol sampling: A, B, then A with the columns of one factor from B.

    columns: how many each factor has, k in all. The rows of a larger sample begin with those of a smaller one.
    """
    total = sum(columns)
    drawn = qmc.Sobol(2 * total, scramble=True, rng=seed).random(rows)
    drawn = np.clip(drawn, 1e-12, 1 - 1e-12)
    a, b = drawn[:, :total], drawn[:, total:]
    blocks, first = [a, b], 0
    for count in columns:
        mixed = a.copy()
        mixed[:, first : first + count] = b[:, first : first + count]
        blocks.append(mixed)
        first += count
    return np.stack(blocks)


@dataclass(frozen=True)
class Spread:
    """Of q values: mean (q,), variance (q,), and indices (factors, q) of first order and total.

    *_error: their standard errors. Indices are NaN where nothing varies. Where noise is taken off, the variance that is
    left may come out below 0.
    """

    mean: np.ndarray
    variance: np.ndarray
    first_order: np.ndarray
    total: np.ndarray
    variance_error: np.ndarray
    first_order_error: np.ndarray
    total_error: np.ndarray

    @property
    def deviation(self) -> np.ndarray:
        """(q,) standard deviation."""
        return np.sqrt(np.maximum(self.variance, 0.0))

    @property
    def deviation_error(self) -> np.ndarray:
        """(q,) its standard error; where it is not told from 0, how large it may well be."""
        told = self.variance > self.variance_error
        return np.where(told, self.variance_error / (2 * np.maximum(self.deviation, 1e-300)),
                        np.sqrt(self.variance_error))  # fmt: skip


def spread_of(values: np.ndarray, drawn: np.ndarray, columns: Sequence[int], seed: int = 0) -> Spread:
    """The variance of values (surfaces, factors + 2, rows, q) and its parts, free of the surfaces' noise.

    drawn, columns: what :func:`probabilities` gave and took. The surfaces are the same in all rows; of one alone
    nothing is known of its noise, and none is taken to be there.

    The variance and its first-order parts V_i = <f_B (f_ABi - f_A)> are taken of what a sum of polynomials of single
    columns leaves, whose own parts are known: f = g + h, g = sum g_i, gives for any g_i of mean 0
    V = sum <g_i^2> + <2 g h + h^2> and V_i = <g_i^2> + <g_i(B) dh> + <h_B g_i(B)> + <h_B dh>, dh = h_ABi - h_A. Total
    parts <(f_ABi - f_A)^2>/2 are so <g_i^2> + <(g_i(B) - g_i(A)) dh> + <dh^2>/2. The standard error of the variance
    holds, beside what other rows would give, what other surfaces would: their noise may go as slowly with the inputs as
    the values do, so that rows do not average it.
    """
    values = np.asarray(values, dtype=np.float64)
    rows = values.shape[2]
    # What is common to all rows of a surface is no part of the variance.
    mean = values[:, :2].mean(axis=(1, 2))
    centred = values - mean[:, None, None]
    squares, first, total = _parts(np.where(np.isfinite(centred), centred, 0.0), drawn, columns)
    squares[:, ~np.isfinite(centred[:, :2]).all(axis=(0, 1, 2))] = np.nan
    scale = max(np.nanmax(np.abs(values), initial=0.0), 1e-300)

    def from_rows(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        variance = np.einsum("n,nq->q", weight, squares)
        known = np.where(variance > (NOTHING * scale) ** 2, variance, np.nan)
        return variance, *(np.einsum("n,fnq->fq", weight, one) / known for one in (first, total))

    found = from_rows(np.full(rows, 1 / rows))
    random = np.random.default_rng(seed)
    with np.errstate(invalid="ignore"):
        again = [from_rows(random.multinomial(rows, np.full(rows, 1 / rows)) / rows) for _ in range(RESAMPLED)]
        errors = [np.std([one[k] for one in again], axis=0) for k in range(3)]
    errors[0] = np.hypot(errors[0], _by_noise(centred[:, :2], found[0]))
    return Spread(mean.mean(axis=0), *found, *errors)


def _by_noise(centred: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(q,) standard error of a variance by noise (surfaces, 2, rows, q) that is common to all rows of a surface."""
    count = len(centred)
    if count == 1:
        return np.zeros_like(variance)
    noise = centred.var(axis=0, ddof=1).mean(axis=(0, 1))
    pairs = count * (count - 1) / 2
    return np.sqrt(noise**2 / pairs + 4 * np.maximum(variance, 0.0) * noise / count)


def _parts(centred: np.ndarray, drawn: np.ndarray, columns: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rows, q) and twice (factors, rows, q), whose rows' means are the variance, its first-order and total parts."""
    surfaces, blocks, rows, count = centred.shape
    total = sum(columns)
    degree = int(np.clip(2 * rows // (ROWS_A_TERM * total), 1, HIGHEST_DEGREE))
    terms = _polynomials(drawn[:2], degree)
    design = np.concatenate([np.ones((2 * rows, 1)), terms.reshape(2 * rows, total * degree)], axis=1)
    data = np.moveaxis(centred[:, :2].reshape(surfaces, 2 * rows, count), 0, 1).reshape(2 * rows, surfaces * count)
    solved = np.linalg.lstsq(design, data, rcond=None)[0][1:].reshape(total, degree, surfaces, count)
    of_column = np.einsum("bncd,cdsq->bcsnq", terms, solved)
    # Polynomials are orthonormal, so that the mean of a square is the sum of the coefficients' squares.
    of_columns = [_product(*2 * [np.moveaxis(one, 1, 0)]).sum(axis=0) for one in solved]
    smooth = of_column.sum(axis=1)
    rest = np.moveaxis(centred[:, :2], 1, 0) - smooth
    pairs = [2 * _product(one, other) + _product(other, other) for one, other in zip(smooth, rest, strict=True)]
    whole = np.sum(of_columns, axis=0) + np.mean(pairs, axis=0)
    found, totals, first = [], [], 0
    for number, size in enumerate(columns):
        own = slice(first, first + size)
        at_a, at_b = of_column[0, own].sum(axis=0), of_column[1, own].sum(axis=0)
        change = centred[:, 2 + number] - centred[:, 0] - (at_b - at_a)
        exact = np.sum(of_columns[own], axis=0)
        found.append(exact + _product(at_b, change) + _product(rest[1], at_b) + _product(rest[1], change))
        totals.append(exact + _product(at_b - at_a, change) + _product(change, change) / 2)
        first += size
    return whole, np.array(found), np.array(totals)


def _polynomials(drawn: np.ndarray, degree: int) -> np.ndarray:
    """(..., columns, degree) Legendre polynomials of degree 1 and above, orthonormal over probabilities 0 to 1."""
    values = np.polynomial.legendre.legvander(2 * drawn - 1, degree)[..., 1:]
    return values * np.sqrt(2 * np.arange(1, degree + 1) + 1)


def _product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Mean product of different surfaces, or of the only one; arrays (surfaces, ...)."""
    count = len(one)
    if count == 1:
        return one[0] * other[0]
    return (one.sum(axis=0) * other.sum(axis=0) - (one * other).sum(axis=0)) / (count * (count - 1))
