"""Which spatial frequencies of a pattern say where it is: the weight of each, from the pattern's own spectrum.

Two images of one pattern with white noise N [power] in each tell its shift best when both are filtered by H with
|H|^2 = S/(S + N/2), S the power of the pattern: the weight S^2/(N (N + 2 S)) of the phase of their cross spectrum
(E. J. Hannan and P. J. Thomson, DOI 10.1093/biomet/60.3.469; C. H. Knapp and G. C. Carter, DOI
10.1109/TASSP.1976.1162830). Frequencies that sampling has folded back move the other way round and do not average
out, so they count as more than noise.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft, ndimage

TILE = 32
"""Side of the tiles whose spectra are averaged [px]."""

MOST_TILES = 256
"""Tiles beyond this many make the spectrum no smoother than is needed."""

FOLDED = 50.0
"""What folded power counts for, relative to noise of the same power: it is a bias and not a scatter."""

FLOOR_SHARE = 1 / 16
"""Share of the frequency plane, the weakest, whose power is taken for the noise."""

LEAST_PATTERN = 1e-4
"""Smallest share of the power at a frequency that is taken for pattern, so that no frequency is cut off hard."""


def power_spectrum(pattern: np.ndarray) -> np.ndarray:
    """Smooth power spectrum of a pattern (rows, columns) on the frequencies of a tile: Welch's method, half overlap."""
    sides = tuple(min(TILE, n) for n in pattern.shape)
    tapers = [np.hanning(n + 2)[1:-1] if n > 1 else np.ones(1) for n in sides]
    taper = tapers[0][:, None] * tapers[1]
    steps = [max(side // 2, 1) for side in sides]
    tiles = sliding_window_view(pattern, sides)[:: steps[0], :: steps[1]].reshape(-1, *sides)
    tiles = tiles[:: max(1, len(tiles) // MOST_TILES)]
    # In single precision, whose rounding is far below what the taper leaks.
    tiles = tiles.astype(np.float32)
    tiles -= tiles.mean(axis=(1, 2), keepdims=True)
    tiles *= taper.astype(np.float32)
    spectra = fft.rfft2(tiles).view(np.float32).reshape(len(tiles), sides[0], -1, 2)
    half = np.einsum("tvuc,tvuc->vu", spectra, spectra).astype(np.float64) / len(tiles)
    opposite = np.roll(half[::-1], 1, axis=0)  # of v as of -v
    power = np.concatenate([half, opposite[:, (sides[1] - 1) // 2 : 0 : -1]], axis=1)
    return ndimage.uniform_filter(power, [3 if n > 3 else 1 for n in sides], mode="wrap")


def _folded(power: np.ndarray, floor: float) -> np.ndarray:
    """Power that sampling has folded back to each frequency.

    For a Gaussian spectrum S the power beyond the Nyquist frequency b, mirrored at it, is about (S(b)/2)^2/S(f).
    """
    folded = np.zeros_like(power)
    for axis, n in enumerate(power.shape):
        if n > 1:
            edge = np.maximum(np.take(power, [n // 2], axis) - floor, 0.0)
            folded += 0.5 * edge**2 / power
    return folded


def band_weight(pattern: np.ndarray) -> np.ndarray:
    """H (real, at most 1) on the frequencies of a tile, in the order of an FFT.

    pattern: (rows, columns), not constant.
    """
    power = power_spectrum(pattern)
    power = np.maximum(power, np.finfo(float).eps * power.max())
    weakest = np.sort(power, axis=None)
    floor = float(weakest[: max(1, int(FLOOR_SHARE * weakest.size))].mean())
    folded = _folded(power, floor)
    signal = np.maximum(power - floor - folded, LEAST_PATTERN * power)
    return np.sqrt(signal / (signal + 0.5 * floor + FOLDED * folded))


def weight_at(weight: np.ndarray, frequencies: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The weight of `band_weight` at frequencies (v, u) [cycles/px], interpolated."""
    across, along = (_between(n, n * f) for n, f in zip(weight.shape, frequencies))
    return across @ weight @ along.T


def _between(count: int, places: np.ndarray) -> np.ndarray:
    """(places, count): what linear interpolation takes of each of so many values that repeat."""
    below = np.floor(places).astype(int)
    share, row = places - below, np.arange(len(places))
    taken = np.zeros((len(places), count))
    taken[row, below % count] = 1.0 - share
    taken[row, (below + 1) % count] += share
    return taken
