"""A large image seen in means of blocks: where its pattern went roughly, and which pieces of two images both show it.

A shift of thousands of pixels need not be looked for pixel by pixel: a mean of k x k pixels keeps of speckle what is
coarser than that, which still is the pattern's own, on k^2 times fewer pixels.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .covariance import deviation

AS_GOOD = 0.5
"""Contrast at the middle, relative to the best there is, at which the middle is taken [in variances]."""


def block_means(image: np.ndarray, side: int) -> np.ndarray:
    """Means (float64) of the blocks of ``side`` x ``side`` pixels that an image (rows, columns) holds whole."""
    rows, columns = (n // side for n in image.shape)
    sums = image[: rows * side, : columns * side].reshape(rows, side, columns * side).sum(axis=1, dtype=np.float64)
    return sums.reshape(rows, columns, side).sum(axis=2) / side**2


def matching_pieces(
    shape: tuple[int, int], displacement: tuple[int, int], side: int, means: np.ndarray, block: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Pieces of an image and of one moved by ``displacement`` (v, u) [px] that show the same, up to ``side`` px large.

    They lie evenly about the middle of ``shape``, or where the contrast is if it is not there. means: of `block_means`
    of the image, with blocks of ``block`` px.
    """
    size = tuple(min(side, n - abs(d)) for n, d in zip(shape, displacement))
    first = tuple((n - s - d) // 2 for n, s, d in zip(shape, size, displacement))
    lowest = tuple(max(0, -d) for d in displacement)
    highest = tuple(min(n, n - d) - s for n, s, d in zip(shape, size, displacement))
    pattern = deviation(means)
    if pattern is not None:
        contrast = ndimage.uniform_filter(np.square(pattern), [max(1, s // block) for s in size], mode="constant")
        places = [np.arange(n) * block + block // 2 - s // 2 for n, s in zip(contrast.shape, size)]
        allowed = [(low <= p) & (p <= high) for p, low, high in zip(places, lowest, highest)]
        contrast = np.where(allowed[0][:, None] & allowed[1], contrast, 0.0)
        here = tuple(min(max((f + s // 2) // block, 0), n - 1) for f, s, n in zip(first, size, contrast.shape))
        best = np.unravel_index(int(np.argmax(contrast)), contrast.shape)
        if contrast[here] < AS_GOOD * contrast[best]:
            first = tuple(int(p[i]) for p, i in zip(places, best))
    one = tuple(slice(f, f + s) for f, s in zip(first, size))
    return one, tuple(slice(p.start + d, p.stop + d) for p, d in zip(one, displacement))
