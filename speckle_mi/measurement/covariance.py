"""Images as numbers, and the autocovariance of their intensity: what a pattern's grain is and how far it reaches.

Images are (rows, columns) arrays of intensity in any unit; lengths are pixels, ``u`` along increasing column and
``v`` along increasing row. Source: J. W. Goodman, Speckle Phenomena in Optics, 2nd ed. (2020), DOI 10.1117/3.2548484.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft

from ..errors import InputError
from ..machine.cores import cores_for_transform

FLAT = 1e-6
"""rms deviation, relative to the largest pixel, below which an image is constant: float32 rounding is 3e-8."""

LOBE_REACH = 2.5
"""Central lobe of a correlation, in half widths at half maximum: a Gaussian lobe has fallen to 1.3 % there."""

NOISELESS = 0.98
"""Value at zero lag that the next two continue to, above which there is no noise to speak of."""

LEAST_SEEN = 0.05
"""Covariance at a lag of two pixels below which the pattern is too fine to tell its top from noise."""


_EXPONENT = 1000
"""Largest power of two by which an image is scaled: its own stays in range, and so do squares of what is left."""


def as_image(image: np.ndarray, name: str = "image") -> np.ndarray:
    """``image`` as a float64 (rows, columns) array of finite pixels.

    Raises InputError, naming the image, if it is not two-dimensional, empty, complex or holds NaN or infinity.
    """
    array = np.asarray(image)
    # In float64 before it is looked at: sums of it are then several times as fast.
    return checked_image(array if np.iscomplexobj(array) else array.astype(np.float64), name)


def checked_image(image: np.ndarray, name: str = "image") -> np.ndarray:
    """``image`` as it is, once it has passed the checks of `as_image`."""
    array = np.asarray(image)
    if array.ndim != 2 or array.size == 0:
        raise InputError(f"{name}: shape {array.shape} is not an image, must be (rows, columns)")
    if np.iscomplexobj(array):
        raise InputError(f"{name}: complex pixels, give the intensity abs(field)**2")
    # One sum instead of a test a pixel: any NaN or infinity survives it.
    with np.errstate(invalid="ignore", over="ignore"):  # what is wrong is raised, not warned of as well
        total = array.sum(dtype=np.float64)
    if not np.isfinite(total):
        bad = array.size - int(np.isfinite(array).sum())
        if bad:
            raise InputError(f"{name}: {bad} of {array.size} pixels are NaN or infinite, all must be finite")
        raise InputError(f"{name}: pixels up to {np.abs(array).max():.3g} overflow float64 sums, scale the image down")
    return array


def deviation(image: np.ndarray) -> np.ndarray | None:
    """Finite float64 image minus its mean, divided by its rms deviation; None if the image is constant."""
    return deviation_in_range(in_range(image))


def deviation_in_range(image: np.ndarray) -> np.ndarray | None:
    """`deviation` of an image of which `in_range` has been made."""
    centred = image - image.mean()
    rms = math.sqrt(float(np.einsum("ij,ij->", centred, centred)) / centred.size)
    if rms < FLAT:
        return None
    centred /= rms
    return centred


def in_range(image: np.ndarray) -> np.ndarray:
    """A float64 image over the power of two next above its largest pixel: exact, and its squares stay in range."""
    exponent = math.frexp(max(float(image.max()), -float(image.min())))[1]
    return image * math.ldexp(1.0, -min(max(exponent, -_EXPONENT), _EXPONENT))


def autocovariance(intensity: np.ndarray) -> np.ndarray:
    """Normalised autocovariance c(dv, du), 1 at zero lag; for fully developed speckle an estimate of |mu|^2.

    intensity: (rows, columns). Returns (2 rows - 1, 2 columns - 1), zero lag in the middle. Each lag is the mean
    over the pixels that overlap, so its expectation does not fall off with the lag (it is low by
    1/speckle_count everywhere, because the mean is the image's own). All NaN for a constant image.
    Raises InputError for pixels that are not finite.
    """
    image = as_image(intensity, "intensity")
    rows, columns = image.shape
    pattern = deviation(image)
    if pattern is None:
        return np.full((2 * rows - 1, 2 * columns - 1), np.nan)
    return autocovariance_of(pattern, (rows - 1, columns - 1))


def autocovariance_of(pattern: np.ndarray, lags: tuple[int, int]) -> np.ndarray:
    """`autocovariance` of a pattern (rows, columns) of mean 0 up to so many lags (v, u), in the pattern's precision.

    Returns (2 v + 1, 2 u + 1), zero lag in the middle.
    """
    (rows, columns), (v, u) = pattern.shape, lags
    padded = tuple(fft.next_fast_len(n + lag, real=True) for n, lag in zip(pattern.shape, lags))
    cores = cores_for_transform(*padded)
    spectrum = fft.rfft2(pattern, padded, workers=cores)
    # In place of the spectrum: what is as large as this costs more to get than to fill.
    power = spectrum.real
    power *= power
    power += np.square(spectrum.imag)
    spectrum.imag = 0.0
    sums = fft.irfft2(spectrum, padded, workers=cores, overwrite_x=True)
    # Of a lag and of the one opposite the sums are the same: those of no negative lag along v say all.
    half = np.empty((v + 1, 2 * u + 1), sums.dtype)
    half[:, u:] = sums[: v + 1, : u + 1]
    half[:, :u] = sums[: v + 1, padded[1] - u :]
    overlap_v = (rows - np.arange(v + 1)).astype(sums.dtype)
    overlap_u = (columns - np.abs(np.arange(-u, u + 1))).astype(sums.dtype)
    half /= half[0, u] / (rows * columns) * overlap_v[:, None]
    half /= overlap_u
    return np.concatenate([half[:0:-1, ::-1], half])


def central_lobe(covariance: np.ndarray) -> tuple[int, int]:
    """Half extents (v, u) [px] of the rectangle that holds the lobe around zero lag.

    covariance: (2 rows - 1, 2 columns - 1) as of `autocovariance`. The rectangle that holds everything above
    one half connected to zero lag (also of an oblique lobe) is grown, then widened to `LOBE_REACH` half widths.
    """
    rows, columns = (covariance.shape[0] + 1) // 2, (covariance.shape[1] + 1) // 2
    v = u = 0
    grown = True
    while grown:  # the covariance is even in the lag, so one side of each pair says enough
        grown = False
        if u + 1 < columns and covariance[rows - 1 - v : rows + v, columns + u].max() > 0.5:
            u, grown = u + 1, True
        if v + 1 < rows and covariance[rows + v, columns - 1 - u : columns + u].max() > 0.5:
            v, grown = v + 1, True
    reach_v, reach_u = (math.ceil(LOBE_REACH * (half + 0.5)) for half in (v, u))
    return min(reach_v, rows - 1), min(reach_u, columns - 1)


def half_width(profile: np.ndarray) -> float:
    """Lag [px] at which ``profile`` (lags 0, 1, 2, ..., first value 1) first falls to one half, or NaN."""
    below = np.flatnonzero(~(profile > 0.5))
    if below.size == 0 or not np.isfinite(profile[below[0]]):
        return math.nan
    lag = int(below[0])
    inner, outer = float(profile[lag - 1]), float(profile[lag])
    if outer <= 0.0:
        return lag - 1 + (inner - 0.5) / (inner - outer)
    # log c is linear in the squared lag for a Gaussian lobe, and nearly so near the top of any smooth one.
    fraction = math.log(inner / 0.5) / math.log(inner / outer)
    return math.sqrt((lag - 1) ** 2 + fraction * (lag**2 - (lag - 1) ** 2))


def without_noise(covariance: np.ndarray) -> np.ndarray:
    """An autocovariance less the white noise at zero lag, 1 there again.

    Noise of photons and of read-out correlates with itself alone; the pattern's own value at zero lag is continued
    from the next two, log c being linear in the squared lag near the top of a smooth lobe.
    """
    row, column = (n // 2 for n in covariance.shape)
    continued = []
    for axis, (n, middle) in enumerate(zip(covariance.shape, (row, column))):
        if n < 5:
            continue
        one, two = (float(np.take(covariance[:, column] if axis == 0 else covariance[row], middle + i)) for i in (1, 2))
        if not one > two > LEAST_SEEN:
            return covariance
        continued.append(one * (one / two) ** (1.0 / 3.0))
    if not continued or not max(continued) < NOISELESS:
        return covariance
    corrected = covariance / np.mean(continued)
    corrected[row, column] = 1.0
    return corrected


def texture_size(covariance: np.ndarray) -> float:
    """Size [px] of a texture: geometric mean of the full widths at half maximum along u and v, inf if unbounded."""
    covariance = without_noise(covariance)
    row, column = (n // 2 for n in covariance.shape)
    profiles = covariance[row:, column], covariance[row, column:]
    widths = [2.0 * half_width(profile) for profile in profiles if profile.size > 1]
    return float(np.exp(np.mean(np.log(widths)))) if widths and np.isfinite(widths).all() else math.inf
