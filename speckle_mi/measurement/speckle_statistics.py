"""First- and second-order statistics of a speckle image, measured from its pixels.

Images are (rows, columns) arrays of intensity in any unit; lengths are pixels, ``u`` along increasing
column and ``v`` along increasing row. A statistic an image cannot give (too small, or without contrast)
is NaN. Contrast and size are those of the speckle: where the light is uneven (a beam's envelope) they are taken
after the smooth mean is divided out, and pixels that no speckle makes (hot ones) are left out.
Source: J. W. Goodman, Speckle Phenomena in Optics, 2nd ed. (2020), DOI 10.1117/3.2548484; J. D. Briers and S. Webster,
DOI 10.1117/12.231379, for the local contrast.
"""

from __future__ import annotations

import math

import numpy as np

from .covariance import as_image, autocovariance, central_lobe, checked_image, deviation, half_width
from .covariance import in_range, without_noise
from .defects import defects_of, repaired
from .light import FAINTEST, is_uneven, middle, smooth_mean, smoothing_of

LARGEST_PIXEL = 16.0
"""Largest pixel of a speckle image over its mean: exponential intensity has it once in ten million pixels."""

LARGEST_PIECE = 1024
"""Side of the middle piece from which second-order statistics are taken [px]."""


def centre_of_gravity(image: np.ndarray) -> tuple[float, float]:
    """Centre of gravity (u, v) [px] of an intensity (rows, columns), relative to the image's middle.

    NaN for an image without light. Raises InputError for pixels that are not finite.
    """
    light = checked_image(image)
    columns_light, rows_light = (light.sum(axis=axis, dtype=np.float64) for axis in (0, 1))
    total = float(rows_light.sum())
    if total <= 0.0:
        return math.nan, math.nan
    rows, columns = light.shape
    u = np.arange(columns) - (columns - 1) / 2
    v = np.arange(rows) - (rows - 1) / 2
    return float(columns_light @ u) / total, float(rows_light @ v) / total


def _neighbours_size(pattern: np.ndarray) -> float:
    """Speckle size [px] that the covariances at 1 and 2 px alone tell: quick, too large under an envelope.

    pattern: (rows, columns) of mean 0 and rms deviation 1. Of a Gaussian lobe their ratio tells the size whatever the
    noise of the pixels.
    """
    # Every fourth line says enough. Copied once, they lie side by side.
    lines = [np.ascontiguousarray(np.moveaxis(pattern, axis, 0)[:, ::4]) for axis in (0, 1) if pattern.shape[axis] > 2]
    if not lines:
        return math.nan
    one, two = (float(np.mean([np.mean(line[lag:] * line[:-lag]) for line in lines])) for lag in (1, 2))
    if two > 0.02:
        return math.sqrt(12.0 * math.log(2.0) / math.log(max(one / two, 1.0001)))
    return math.sqrt(4.0 * math.log(2.0) / -math.log(min(max(one, 0.05), 0.9999)))


def is_evenly_lit(image: np.ndarray) -> bool:
    """Whether the mean of a finite image (rows, columns) is the same everywhere, as far as its speckles tell."""
    pattern = deviation(image)
    return pattern is None or has_even_light(pattern)


def has_even_light(pattern: np.ndarray) -> bool:
    """`is_evenly_lit` of an image (rows, columns) that was brought to mean 0 and rms deviation 1."""
    return not is_uneven(pattern, _neighbours_size(pattern))


def _speckle(image: np.ndarray) -> np.ndarray:
    """A finite image without hot pixels, and over its smooth mean where the light is uneven."""
    if image.max() > LARGEST_PIXEL * abs(image.mean()) and (found := defects_of(image)).any:
        image = repaired(image, found.pixels)
    if is_evenly_lit(image) or (sigma := smoothing_of(image)) is None:
        return image
    mean = smooth_mean(image, sigma)
    lit = mean > FAINTEST * mean.max()
    # Beyond the light there is no speckle: there the ratio is its mean.
    return np.where(lit, image / np.where(lit, mean, 1.0), 1.0) if lit.all() else _lit_part(image, mean, lit)


def _lit_part(image: np.ndarray, mean: np.ndarray, lit: np.ndarray) -> np.ndarray:
    """Image over mean on the smallest rectangle around the light, 1 outside of it."""
    rows, columns = (np.flatnonzero(lit.any(axis=axis)) for axis in (1, 0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return np.where(lit, image / np.where(lit, mean, 1.0), np.nan)[box]


def contrast(intensity: np.ndarray) -> float:
    """Speckle contrast: rms deviation over mean, 1 for fully developed polarised speckle (Goodman, ch. 3).

    intensity: (rows, columns). Under uneven light the local contrast. NaN for an image without light. Raises
    InputError for pixels that are not finite.
    """
    return _contrast(_speckle_of(intensity))


def speckle_size(intensity: np.ndarray) -> tuple[float, float]:
    """Speckle size (u, v) [px]: full width at half maximum of the normalised intensity autocovariance.

    intensity: (rows, columns). NaN along an axis on which the width exceeds a quarter of the image (there a mere
    slope of brightness would pass for a speckle) and for a constant image. Raises InputError for pixels that are
    not finite.
    """
    return _size(_speckle_of(intensity))


def contrast_and_size(intensity: np.ndarray) -> tuple[float, tuple[float, float]]:
    """`contrast` and `speckle_size` of one image (rows, columns), for little more than the price of one."""
    speckle = _speckle_of(intensity)
    return _contrast(speckle), _size(speckle)


def _speckle_of(intensity: np.ndarray) -> np.ndarray:
    """An image's speckle as `_speckle` leaves it. Raises InputError for pixels that are not finite."""
    image = as_image(intensity, "intensity")
    return _speckle(in_range(image)) if np.any(image) else image


def _contrast(speckle: np.ndarray) -> float:
    mean, deviation_of = float(speckle.mean()), np.std
    if math.isnan(mean):  # beyond the light there is none; where there are no gaps, not to look for them is faster
        mean, deviation_of = float(np.nanmean(speckle)), np.nanstd
    return float(deviation_of(speckle)) / mean if mean > 0.0 else math.nan


def _size(speckle: np.ndarray) -> tuple[float, float]:
    speckle = middle(speckle, LARGEST_PIECE)
    covariance = without_noise(autocovariance(np.where(np.isnan(speckle), np.nanmean(speckle), speckle)))
    rows, columns = (covariance.shape[0] + 1) // 2, (covariance.shape[1] + 1) // 2
    u = 2.0 * half_width(covariance[rows - 1, columns - 1 :])
    v = 2.0 * half_width(covariance[rows - 1 :, columns - 1])
    return u if u <= columns / 4 else math.nan, v if v <= rows / 4 else math.nan


def speckle_count(intensity: np.ndarray) -> float:
    """Effective number of independent speckles: image area over the correlation area sum(c) (Goodman, ch. 4).

    intensity: (rows, columns). The sum is taken over the central lobe, where the covariance is more than chance.
    NaN for a constant image or where the lobe reaches the image's edge, at least 1 otherwise.
    Raises InputError for pixels that are not finite.
    """
    covariance = autocovariance(intensity)
    rows, columns = (covariance.shape[0] + 1) // 2, (covariance.shape[1] + 1) // 2
    if not np.isfinite(covariance[rows - 1, columns - 1]):
        return math.nan
    v, u = central_lobe(covariance)
    if (rows > 1 and v == rows - 1) or (columns > 1 and u == columns - 1) or rows * columns == 1:
        return math.nan
    area = float(covariance[rows - 1 - v : rows + v, columns - 1 - u : columns + u].sum())
    return rows * columns / max(area, 1.0)
