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
        self.spectrum = np.conj(self._spectrum(reference))
        counts = [n - np.abs(np.arange(1 - n, n)) for n in self.shape]
        self.pixels = (counts[0][:, None] * counts[1]).astype(np.float64)
        # The reference moves the other way: what overlaps at a lag does so of the moved image at the opposite one.
        sums, energy = self._sums_and_energy(reference)
        self.sums, self.energy = sums[::-1, ::-1].copy(), energy[::-1, ::-1].copy()

    def _spectrum(self, image: np.ndarray) -> np.ndarray:
        """Of the padded image: along rows before those of the padding are added."""
        along_rows = fft.rfft(image, self.padded[1], axis=1, workers=self.cores)
        return fft.fft(along_rows, self.padded[0], axis=0, workers=self.cores, overwrite_x=True)

    def _sums_and_energy(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sum and squared deviation of the pixels of the moved image that overlap with the reference, at every lag."""
        sums, squares = _over_overlap(image), np.square(image)
        energy = _over_overlap(squares)
        less = np.square(sums)
        less /= self.pixels
        energy -= less
        energy[energy <= CONSTANT * squares.sum()] = np.inf
        return sums, energy

    def ncc(self, pattern: np.ndarray) -> np.ndarray:
        """NCC over the overlap, (2 rows - 1, 2 columns - 1), no displacement in the middle."""
        spectrum = self._spectrum(pattern)
        spectrum *= self.spectrum
        products = _from_middle(
            fft.irfft2(spectrum, self.padded, workers=self.cores, overwrite_x=True), self.shape
        )
        # In place of what is not needed any more: what is as large as this costs more to get than to fill.
        sums, energy = self._sums_and_energy(pattern)
        sums *= self.sums
        sums /= self.pixels
        products -= sums
        energy *= self.energy
        products /= np.sqrt(energy, out=energy)
        return products


def _over_overlap(image: np.ndarray) -> np.ndarray:
    """Sum of ``image`` over the pixels that overlap with a fixed image of its shape, at every lag.

    At a lag l below 0 its first n + l pixels do, from 0 on all but its first l: (2 rows - 1, 2 columns - 1).
    """
    for axis in (0, 1):
        n = image.shape[axis]
        running = np.cumsum(image, axis=axis)
        shape = list(image.shape)
        shape[axis] = 2 * n - 1
        lead, sums = (running, np.empty(shape)) if axis == 0 else (running.T, np.empty(shape).T)
        sums[: n - 1] = lead[: n - 1]
        sums[n - 1] = lead[n - 1]
        np.subtract(lead[n - 1], lead[: n - 1], out=sums[n:])
        image = sums if axis == 0 else sums.T
    return image


def _from_middle(cyclic: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Lags -(n - 1) to n - 1 in their order, of a padded array in which negative ones stand at the end."""
    (rows, columns), (height, width) = shape, cyclic.shape
    found = np.empty((2 * rows - 1, 2 * columns - 1), cyclic.dtype)
    found[rows - 1 :, columns - 1 :] = cyclic[:rows, :columns]
    found[: rows - 1, columns - 1 :] = cyclic[height - rows + 1 :, :columns]
    found[rows - 1 :, : columns - 1] = cyclic[:rows, width - columns + 1 :]
    found[: rows - 1, : columns - 1] = cyclic[height - rows + 1 :, width - columns + 1 :]
    return found
