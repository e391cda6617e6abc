"""The peak of a correlation surface: where it is to a fraction of a pixel, and whether chance could have made it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from .covariance import LOBE_REACH, autocovariance_of, central_lobe, deviation, without_noise

FALSE_ALARM = 1e-3
"""Probability that two unrelated patterns are given a shift; each of the two stages gets half."""

RIVAL = 0.9
"""A second peak this high, relative to the first, makes the shift ambiguous."""

PATCH = 2
"""Pixels on each side of the peak in the sub-pixel fit."""

FARTHEST_LAG = 3
"""Quarters of a piece up to which lags are looked at: beyond, few pixels overlap."""

REPEATING = 0.8
"""Autocovariance away from the middle at which a pattern repeats itself."""

FEWEST_SPECKLES = 16
"""Fewest independent speckles that can tell two patterns apart at all."""

ROUNDING = 1e-12
"""Rounding of an NCC of 1; speckle of 100 px moved by 1e-4 px is already further from it."""

SPECKLE_KURTOSIS = 9.0
"""Fourth moment over squared variance of exponentially distributed intensity."""


_TO_POWERS = {
    n: np.linalg.inv(np.vander(np.arange(n) - n // 2.0, increasing=True)) for n in (1, 3, 2 * PATCH + 1)
}
"""What makes coefficients of a polynomial out of its values at so many places about the middle."""


def _log_maximum(patch: np.ndarray) -> tuple[tuple[float, float], float] | None:
    """Offset (v, u) from the middle and height of the maximum of a patch of NCC values, or None.

    A polynomial through the logarithm of all values (a product of degree 4 x 4 for 5 x 5 values), so a Gaussian
    peak of any orientation is exact. Three points an axis would ignore the cross term, which a finite number of
    speckles always has: up to 0.08 px for 40 px speckle in a 256 px window.
    """
    if patch.min() <= 0.0:
        return None
    to_powers = [_TO_POWERS[n] for n in patch.shape]
    coefficients = to_powers[0] @ np.log(patch) @ to_powers[1].T
    place = [0.0, 0.0]
    free_v, free_u = (n > 1 for n in patch.shape)
    if not (free_v or free_u):
        return None
    for _ in range(20):
        in_v, in_u = (_power_derivatives(x, n) for x, n in zip(place, patch.shape))
        (value, gradient_u, curvature_u), (gradient_v, cross, _), (curvature_v, _, _) = (
            (in_v @ coefficients @ in_u.T).tolist()
        )
        # Along an axis of one pixel there is nothing to solve for: its equation is step = 0.
        if not free_v:
            curvature_v, gradient_v, cross = -1.0, 0.0, 0.0
        if not free_u:
            curvature_u, gradient_u, cross = -1.0, 0.0, 0.0
        determinant = curvature_v * curvature_u - cross * cross
        middle = 0.5 * (curvature_v + curvature_u)
        if middle + math.sqrt(max(middle * middle - determinant, 0.0)) >= -1e-12:
            return None
        steps = (
            (cross * gradient_u - curvature_u * gradient_v) / determinant,
            (cross * gradient_v - curvature_v * gradient_u) / determinant,
        )
        place = [x + step for x, step in zip(place, steps)]
        if max(map(abs, place)) > 1.0:
            return None
        if max(map(abs, steps)) < 1e-9:
            return (place[0], place[1]), min(math.exp(value), 1.0)
    return None


def _power_derivatives(x: float, count: int) -> np.ndarray:
    """Powers x^0 ... x^(count-1) and their first and second derivatives, (3, count)."""
    n = np.arange(count)
    powers = float(x) ** n
    table = np.zeros((3, count))
    table[0] = powers
    table[1, 1:] = n[1:] * powers[:-1]
    table[2, 2:] = n[2:] * n[1:-1] * powers[:-2]
    return table


class Texture:
    """What chance can do with a pattern: its speckle area, its lobe, and how many speckles carry its contrast.

    area: integral of the squared normalised autocovariance over the central lobe [px^2], the area on which two
    patterns agree or disagree together. lobe: half extents (v, u) [px]. next: autocovariance of next neighbours without
    noise. top: its height at zero lag over the curve through the other lags. half: lags (v, u) [px] of about half of
    its height, and fall: what it has fallen by there. repeats: whether the pattern is like itself at some distance.
    """

    def __init__(self, piece: np.ndarray) -> None:
        # In single precision: nothing of this is needed to better than a thousandth.
        rows, columns = (FARTHEST_LAG * (n - 1) // 4 + 1 for n in piece.shape)
        covariance = autocovariance_of(deviation(piece).astype(np.float32), (rows - 1, columns - 1))
        # A lobe is never taken wider than this, so that a pattern of parallel stripes is seen to repeat itself.
        self.lobe = tuple(min(reach, n // 3) for reach, n in zip(central_lobe(covariance), piece.shape))
        v, u = self.lobe
        self.area = float(np.sum(np.square(covariance[rows - 1 - v : rows + v, columns - 1 - u : columns + u])))
        clean = without_noise(covariance)
        self.next = _next_neighbour(clean)
        self.top = height_over_neighbours(clean, tuple(n // 2 for n in clean.shape))
        self.half = tuple(max(1, round(reach / LOBE_REACH)) for reach in self.lobe)
        self.fall = fall_beside(clean, tuple(n // 2 for n in clean.shape), self.half)
        self.repeats = _repetition(covariance, self.lobe) >= REPEATING
        squares = np.square(piece - piece.mean())
        # A few bright pixels carry the contrast of an image whose kurtosis is above that of speckle.
        self.carrying = min(1.0, SPECKLE_KURTOSIS * float(squares.mean() ** 2 / np.mean(squares**2)))

    def speckles(self, pixels: np.ndarray | float) -> np.ndarray | float:
        """Number of independent speckles in so many pixels."""
        return pixels * (self.carrying / self.area)


def _next_neighbour(covariance: np.ndarray) -> float:
    row, column = (n // 2 for n in covariance.shape)
    sides = [covariance[row + 1, column]] if covariance.shape[0] > 1 else []
    sides += [covariance[row, column + 1]] if covariance.shape[1] > 1 else []
    return float(np.mean(sides)) if sides else 0.0


def height_over_neighbours(surface: np.ndarray, place: tuple[int, int]) -> float:
    """Height of a surface at a place over the curves through its three neighbours each way, 0 near the edge."""
    heights = []
    for axis, n in enumerate(surface.shape):
        if n == 1:
            continue
        i = place[axis]
        if not 3 <= i < n - 3:
            return 0.0
        line = surface[i - 3 : i + 4, place[1]] if axis == 0 else surface[place[0], i - 3 : i + 4]
        heights.append(float(line[3] - (15 * (line[2] + line[4]) - 6 * (line[1] + line[5]) + line[0] + line[6]) / 20))
    return min(heights, default=0.0)


def fall_beside(surface: np.ndarray, place: tuple[int, int], lags: tuple[int, int]) -> float:
    """Share of its height by which a surface has fallen at ``lags`` (v, u) from a place; NaN if that is all outside."""
    beside = [
        float(surface[tuple(i + side * lag * (a == axis) for a, i in enumerate(place))])
        for axis, (n, lag) in enumerate(zip(surface.shape, lags))
        for side in (-1, 1)
        if 0 <= place[axis] + side * lag < n
    ]
    return 1.0 - float(np.mean(beside)) / float(surface[place]) if beside else math.nan


def _repetition(covariance: np.ndarray, lobe: tuple[int, int]) -> float:
    """Largest autocovariance outside of the lobe."""
    row, column = (n // 2 for n in covariance.shape)
    outside = covariance.copy()
    middle = tuple(slice(max(m - reach, 0), m + reach + 1) for m, reach in zip((row, column), lobe))
    outside[middle] = 0.0
    return float(outside.max())


@dataclass(frozen=True)
class Peak:
    """A maximum of a correlation surface.

    place: its pixel. offset: (v, u) [px] from there, None where the surface has no smooth maximum inside a patch
    or it lies at the edge. significance: its pixel's NCC over the least significant.
    other: place of the next significant peak, None if there is none, and rivals: whether it is about as high.
    """

    place: tuple[int, int]
    offset: tuple[float, float] | None
    ncc: float
    significance: float = math.nan
    other: tuple[int, int] | None = None
    other_significance: float = 0.0
    rivals: bool = False


def peak_at(surface: np.ndarray, place: tuple[int, int]) -> Peak:
    """The maximum of ``surface`` next to the pixel ``place``, by the largest patch that has one."""
    top = float(surface[place])
    if top > 1.0 - ROUNDING:  # only a copy correlates fully (Cauchy-Schwarz), so it lies exactly here
        return Peak(place, (0.0, 0.0), 1.0)
    for radius in (PATCH, 1):
        reach = [radius if n > 1 else 0 for n in surface.shape]
        if all(r <= i < n - r for r, i, n in zip(reach, place, surface.shape)):
            patch = surface[tuple(slice(i - r, i + r + 1) for i, r in zip(place, reach))]
            if (found := _log_maximum(patch)) is not None:
                return Peak(place, found[0], min(max(found[1], top), 1.0))
    return Peak(place, None, min(top, 1.0))


def least_significant(speckles: np.ndarray | float, places: float) -> np.ndarray | float:
    """NCC that the best of ``places`` [speckle areas] of unrelated patterns exceeds with FALSE_ALARM / 2.

    speckles: independent ones under the template. Fisher's z of a Gaussian field with three maxima an area, with the
    skewness 4/sqrt(speckles) that products of exponential intensities have (Cornish-Fisher). Checked by simulation.
    """
    z = -NormalDist().inv_cdf(0.5 * FALSE_ALARM / (3.0 * max(places, 1.0)))
    root = np.sqrt(speckles)
    return np.tanh((z + 4.0 * (z * z - 1.0) / (6.0 * root)) / root)


@dataclass(frozen=True)
class Bar:
    """What correlations must exceed to be significant, on a surface of one shape: the same for all moved images.

    speckles: independent ones that each value rests on, one number or one a displacement; enough: (of the surface's
    shape) where there are enough of them; threshold: least significant NCC.
    """

    speckles: np.ndarray
    enough: np.ndarray
    threshold: np.ndarray | float

    @classmethod
    def of(cls, pixels: np.ndarray | float, texture: Texture, shape: tuple[int, int]) -> Bar:
        """pixels: that each value of the surface rests on."""
        speckles = np.asarray(texture.speckles(pixels))  # one number for stage 1, one a displacement for stage 2
        # With too few speckles everywhere the best of the larger overlaps is still looked up, but proves nothing.
        enough = np.broadcast_to(speckles >= min(FEWEST_SPECKLES, 0.5 * float(speckles.max())), shape)
        threshold = least_significant(np.maximum(speckles, 1.0), np.count_nonzero(enough) / texture.area)
        return cls(speckles, enough, threshold)


def most_significant(surface: np.ndarray, bar: Bar, texture: Texture) -> Peak:
    """The most significant peak of a correlation surface."""
    speckles, enough = bar.speckles, bar.enough
    most = float(speckles.max())
    ratio = np.where(enough, surface / bar.threshold, 0.0)
    place = argmax(ratio)
    peak = peak_at(surface, place)
    # Of the pixel, not interpolated: interpolation raises the peaks of unrelated patterns too.
    significance = float(ratio[place]) if most >= FEWEST_SPECKLES else 0.0
    lobe = tuple(slice(max(i - reach, 0), i + reach + 1) for i, reach in zip(place, texture.lobe))
    ratio[lobe] = 0.0
    other = argmax(ratio)
    if significance >= 1.0 and ratio[other] >= 1.0:
        rivals = peak_at(surface, other).ncc >= RIVAL * peak.ncc
        return Peak(place, peak.offset, peak.ncc, significance, other, float(ratio[other]), rivals)
    # Unrelated patterns scatter by 1/sqrt(speckles); if the rest of this surface scatters more, the bar is higher.
    scatter = np.where(enough, surface * np.sqrt(speckles), 0.0)
    scatter[lobe] = 0.0
    away = np.count_nonzero(enough) - np.count_nonzero(enough[lobe])
    excess = math.sqrt(float(np.sum(np.square(scatter))) / away) if away else 1.0
    return Peak(place, peak.offset, peak.ncc, significance / max(excess, 1.0))


def argmax(surface: np.ndarray) -> tuple[int, int]:
    row, column = np.unravel_index(int(np.argmax(surface)), surface.shape)
    return int(row), int(column)
