"""Normalised cross-correlation of two images: a piece of one over all of the other, or both over their overlap.

Images are (rows, columns) arrays of intensity; a surface of correlations has a value for every displacement of one
against the other. Eq. (3) of Opt. Eng. 61(6) 061410 (DOI 10.1117/1.OE.61.6.061410); over the overlap D. Padfield,
DOI 10.1109/TIP.2011.2181402, with full masks.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft

from ..machine.cores import cores_for_transform

CONSTANT = 1e-9
"""Variation of a piece of an image, relative to all of the image's, that is taken for rounding."""


def _box_sums(image: np.ndarray, box: tuple[int, int]) -> np.ndarray:
    """Sums of ``image`` (rows, columns) over every (height, width) box that lies inside it."""
    for axis, size in enumerate(box):
        lead = image if axis == 0 else image.T
        sums = np.empty((lead.shape[0] - size + 1, lead.shape[1]))
        sums[0] = lead[:size].sum(axis=0)
        np.subtract(lead[size:], lead[:-size], out=sums[1:])
        np.cumsum(sums, axis=0, out=sums)
        image = sums if axis == 0 else sums.T
    return image


class Template:
    """A piece of the reference, ready to be correlated with every place of images of one shape it fits in."""

    def __init__(self, piece: np.ndarray, shape: tuple[int, int]) -> None:
        self.size, self.shape = piece.shape, shape
        self.padded = tuple(fft.next_fast_len(n, real=True) for n in shape)
        self.cores = cores_for_transform(*self.padded)
        values = piece - piece.mean()
        self.norm = math.sqrt(float(np.sum(np.square(values))))
        self.spectrum = fft.rfft2(values, self.padded, workers=self.cores).conj()

    def ncc(self, pattern: np.ndarray) -> np.ndarray:
        """Eq. (3) at every place (row, column) of the template's corner in ``pattern``; 0 where that is constant."""
        (rows, columns), (height, width) = self.shape, self.size
        spectrum = fft.rfft2(pattern, self.padded, workers=self.cores)
        spectrum *= self.spectrum
        # Places that wrap around the padded image are exactly those cut off here.
        products = fft.irfft2(spectrum, self.padded, workers=self.cores, overwrite_x=True)
        products = products[: rows - height + 1, : columns - width + 1]
        squares = np.square(pattern)
        energy = _box_sums(squares, self.size) - _box_sums(pattern, self.size) ** 2 / (height * width)
        energy[energy <= CONSTANT * squares.sum()] = np.inf
        return products / (self.norm * np.sqrt(energy))


class Overlaps:
    """The whole reference, ready to be correlated with images over their overlap at every displacement."""

    def __init__(self, reference: np.ndarray) -> None:
        self.shape = reference.shape
        self.padded = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in self.shape)
        self.cores = cores_for_transform(*self.padded)
        self.spectrum = fft.rfft2(reference, self.padded, workers=self.cores).conj()
        self.lags = [np.arange(1 - n, n) for n in self.shape]
        counts = [n - np.abs(lag) for n, lag in zip(self.shape, self.lags)]
        self.pixels = (counts[0][:, None] * counts[1]).astype(np.float64)
        self.sums, self.energy = self._sums_and_energy(reference, -1)

    def _sums_and_energy(self, image: np.ndarray, sign: int) -> tuple[np.ndarray, np.ndarray]:
        """Sum and squared deviation of the overlapping pixels of the moved (sign +1) or reference (-1) image."""
        sums = self._over_overlap(image, sign)
        squares = np.square(image)
        energy = self._over_overlap(squares, sign) - sums**2 / self.pixels
        energy[energy <= CONSTANT * squares.sum()] = np.inf
        return sums, energy

    def _over_overlap(self, image: np.ndarray, sign: int) -> np.ndarray:
        """Sum of ``image`` over the pixels that overlap, at every lag."""
        for axis in (0, 1):
            n, lag = self.shape[axis], sign * self.lags[axis]
            running = np.insert(np.cumsum(image, axis=axis), 0, 0.0, axis=axis)
            image = running.take(np.minimum(n, n + lag), axis) - running.take(np.maximum(0, lag), axis)
        return image

    def ncc(self, pattern: np.ndarray) -> np.ndarray:
        """NCC over the overlap, (2 rows - 1, 2 columns - 1), no displacement in the middle."""
        spectrum = fft.rfft2(pattern, self.padded, workers=self.cores)
        spectrum *= self.spectrum
        products = fft.irfft2(spectrum, self.padded, workers=self.cores, overwrite_x=True)
        # Negative lags wrap around, and so do negative indices.
        products = products[self.lags[0]][:, self.lags[1]]
        sums, energy = self._sums_and_energy(pattern, 1)
        return (products - sums * self.sums / self.pixels) / np.sqrt(energy * self.energy)
