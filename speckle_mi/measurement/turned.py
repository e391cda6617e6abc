"""Whether a pattern that is not found was turned: by more than the window can follow, but not by more than can be seen.

The modulus of a spectrum does not know of a shift and turns with its image; in polar coordinates a turn is a shift
along the angle, which scikit-image's registration finds (B. S. Reddy and B. N. Chatterji, DOI 10.1109/83.506761).
"""

from __future__ import annotations

import numpy as np
from skimage.registration import phase_cross_correlation
from skimage.transform import rotate, warp_polar

from .light import middle

SMALLEST, LARGEST = 48, 512
"""Side of the middle pieces that are compared: smallest of any use, and largest that is taken [px]."""

NOISE = 0.03
"""Modulus, relative to the largest mean of a radius, below which there is noise and no grain of the pattern."""

ANGLES = 360
"""Directions that a half turn is divided into."""


def _polar_spectrum(image: np.ndarray) -> np.ndarray:
    """Modulus of the spectrum of a square image over angle (rows, half a turn) and radius."""
    taper = np.hanning(image.shape[0] + 2)[1:-1]
    modulus = np.abs(np.fft.fftshift(np.fft.fft2((image - image.mean()) * taper[:, None] * taper)))
    side = image.shape[0]
    centre = (side // 2, side // 2)
    polar = warp_polar(modulus, centre, radius=side // 2, output_shape=(2 * ANGLES, side // 2))[:ANGLES, side // 16 :]
    # Speckle's spectrum falls off with the radius and has its grain on top: the grain is what turns.
    level = polar.mean(axis=0)
    return (polar - level) / np.maximum(level, NOISE * level.max())


def turns(reference: np.ndarray, moved: np.ndarray) -> list[float]:
    """The two angles [deg], from u toward v, by which the spectra say that a pattern may have been turned."""
    side = min(*reference.shape, LARGEST)
    if side < SMALLEST:
        return []
    one, other = (_polar_spectrum(middle(image, side)) for image in (reference, moved))
    shift, _, _ = phase_cross_correlation(one, other, upsample_factor=5, normalization=None)
    angle = (-float(shift[0]) * 180.0 / ANGLES + 90.0) % 180.0 - 90.0
    return [angle, angle - 180.0 if angle > 0.0 else angle + 180.0]


def turned_back(image: np.ndarray, angle: float) -> np.ndarray:
    """``image`` turned about its middle by minus ``angle`` [deg, from u toward v]."""
    return rotate(image, angle, order=3, mode="reflect")
