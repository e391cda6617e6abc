"""What belongs to the light and not to the pattern: envelopes, slopes of ambient light, taken off before measuring.

A beam's envelope and stray light stand still when the pattern moves. The smooth mean of an image over several speckles
holds both; what is left, in units of its local rms, is the pattern under even light. The smoothing goes by the finest
texture there is, so that speckle on top of a wide beam is not taken for a part of it.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage, special

from .covariance import autocovariance, deviation, texture_size

SPECKLES = 4.0
"""Standard deviation of the smoothing in speckle sizes: some 200 speckles make up the mean, whose scatter is 7 %."""

ROOM = 2.5
"""Least smoothing, in sizes of the texture found with it, that has not itself shaped that texture."""

NOISE_SIZE = 1.5
"""Size below which a texture is the noise of the pixels [px]."""

FIRST, LAST_SHARE = 8.0, 0.25
"""Smoothing first tried [px], and the last as a share of the image's shorter side."""

BLOCK = 4.0
"""Side of the blocks whose means are compared, in speckle sizes."""

UNEVEN = 4.0
"""Variance of the blocks' means over what their speckles cause at which light counts as uneven."""

CHANCE = 1e-4
"""Probability that even light is called uneven."""

FAINTEST = 0.05
"""Local rms, relative to the largest, below which there is no pattern that could be made as strong as the rest."""

SEEN = 512
"""Side of the middle piece in which the texture is looked at [px]."""


def middle(image: np.ndarray, side: int) -> np.ndarray:
    """The middle of an image, at most ``side`` pixels high and wide."""
    top, left = (max(0, (n - side) // 2) for n in image.shape)
    return image[top : top + side, left : left + side]


def _smoothed(image: np.ndarray, sigma: float) -> np.ndarray:
    side = 2 * round(0.5 * math.sqrt(4.0 * sigma**2 + 1.0) - 0.5) + 1  # three boxes have its variance
    for _ in range(3):
        image = ndimage.uniform_filter(image, [min(side, 2 * n - 1) for n in image.shape], mode="reflect")
    return image


def high_pass(image: np.ndarray, sigma: float) -> np.ndarray:
    """``image`` (rows, columns) less its smooth mean: structure larger than about ``sigma`` [px] is gone."""
    rest = image - _smoothed(image, sigma)
    return rest - _smoothed(rest, sigma)  # what the first smoothing took off the top of a narrow beam too little


def smooth_mean(image: np.ndarray, sigma: float) -> np.ndarray:
    """``image`` without its structure smaller than about ``sigma`` [px], never below 0 for an image that is not."""
    mean = image - high_pass(image, sigma)
    return np.maximum(mean, 0.0) if image.min() >= 0.0 else mean


def _size_of_texture(image: np.ndarray) -> float:
    """Size [px] of the texture of an image as it stands; NaN without any, inf if unbounded."""
    pattern = deviation(image)
    return math.nan if pattern is None else texture_size(autocovariance(pattern))


def texture_scale(image: np.ndarray) -> float:
    """Size [px] of the finest texture of an image: the speckle size, whatever the envelope. NaN without any."""
    piece = middle(image, SEEN)
    sides = [n for n in piece.shape if n > 1]
    sigma, limit = FIRST, LAST_SHARE * min(sides, default=0)
    while sigma <= limit:
        size = _size_of_texture(high_pass(piece, sigma))
        if size > NOISE_SIZE and ROOM * size <= sigma:
            return size
        sigma *= 2.0
    return _size_of_texture(piece)


def is_uneven(image: np.ndarray, size: float) -> bool:
    """Whether the mean of the light differs from place to place by more than speckles of ``size`` [px] make it."""
    side = max(8, math.ceil(BLOCK * size)) if math.isfinite(size) else max(image.shape)
    sides = [min(side, n) if n > 1 else 1 for n in image.shape]
    rows, columns = (n // s for n, s in zip(image.shape, sides))
    if rows * columns < 4:
        return False
    blocks = image[: rows * sides[0], : columns * sides[1]].reshape(rows, sides[0], columns, sides[1])
    means = blocks.sum(axis=1).sum(axis=2) / (sides[0] * sides[1])
    squares = float(np.einsum("ijkl,ijkl->", blocks, blocks)) / blocks.size
    within = squares - float(np.mean(np.square(means)))
    if within <= np.finfo(float).eps * squares:
        return False
    speckles = math.prod(max(1.0, s / (1.06 * max(size, 1.0))) for s in sides if s > 1)
    excess = float(means.var()) * speckles / within
    return excess > UNEVEN and excess * (means.size - 1) > special.chdtri(means.size - 1, CHANCE)


def smoothing_of(image: np.ndarray) -> float | None:
    """Standard deviation [px] of the smoothing that takes the light off an image, None if it is even or too small."""
    size = texture_scale(image)
    if not is_uneven(image, size):
        return None
    sigma = max(FIRST, SPECKLES * size)
    return sigma if sigma <= LAST_SHARE * max(image.shape) else None


def flatten(image: np.ndarray, sigma: float) -> np.ndarray:
    """The pattern under even light: ``image`` less its smooth mean, over its local rms deviation [1]."""
    pattern = high_pass(image, sigma)
    rms = np.sqrt(np.maximum(smooth_mean(np.square(pattern), sigma), 0.0))
    return pattern / np.maximum(rms, max(FAINTEST * float(rms.max()), np.finfo(float).tiny))
