"""Pairs of speckle images that were shifted exactly, with the noise of a camera."""

from __future__ import annotations

import numpy as np
from scipy import fft

AIRY = 0.5145
"""Radius of a circular pupil's band [cycles/px] times the full width at half maximum of its speckle [px]."""

_MARGIN = 4.0
"""Speckles cut off around the images, so that nothing re-enters what was periodic."""


def shifted_pair(
    shape: tuple[int, int], size: float, shift: tuple[float, float], seed: int, correlation: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Fully developed speckle behind a circular pupil before and after a shift (u, v) [px], mean 1.

    size: full width at half maximum [px]. The field is band-limited, so a phase ramp shifts it exactly, and for sizes
    above 2.06 px so is the intensity. correlation: of the two intensities, by a share of an independent field.
    """
    margins = [int(_MARGIN * size + abs(s)) for s in shift[::-1]]
    period = tuple(fft.next_fast_len(n + 2 * margin) for n, margin in zip(shape, margins, strict=True))
    v, u = fft.fftfreq(period[0])[:, None], fft.fftfreq(period[1])
    pupil = np.hypot(v, u) <= AIRY / size
    random = np.random.default_rng(seed)

    def spectrum() -> np.ndarray:
        return pupil * (random.standard_normal(period) + 1j * random.standard_normal(period))

    before = spectrum()
    after = before * np.exp(-2j * np.pi * (u * shift[0] + v * shift[1]))
    if correlation < 1.0:
        after = np.sqrt(correlation) * after + np.sqrt(1.0 - correlation) * spectrum()
    inside = tuple(slice(margin, margin + n) for n, margin in zip(shape, margins, strict=True))
    mean = 2.0 * np.count_nonzero(pupil) / (period[0] * period[1]) ** 2
    return tuple(np.abs(fft.ifft2(field)[inside]) ** 2 / mean for field in (before, after))


def with_photons(image: np.ndarray, photons: float | None, random: np.random.Generator) -> np.ndarray:
    """An image of mean 1 as counts of photons, ``photons`` a pixel in the mean; None: as it is."""
    return image if photons is None else random.poisson(photons * image).astype(float)
