"""The coherent sum written down as it stands, in float64: slow, exact, and the judge of every other method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..machine.cores import on_all_cores
from .paths import Path

SAMPLE_SEED = 20220601
"""Seed of the sample of target points on which errors are measured."""

POWER_BLOCK = 256
"""Points of a field whose power is taken together before single ones are drawn."""

PAIRS_AT_ONCE, TARGETS_AT_ONCE = 1 << 16, 1 << 10
"""Pairs per chunk, and targets: a few arrays of half a megabyte, which stay in the processor's cache."""


def reference_sum(
    path: Path, sources: np.ndarray, weights: np.ndarray, targets: np.ndarray, wavelength: float
) -> np.ndarray:
    """E_m = sum_j c_j A(P_j, D_m) e^{+ikV(P_j, D_m)}, (m,) complex128.

    sources: (n, 3) [mm]; weights c: (n,) complex; targets: (m, 3) [mm]; wavelength [mm].
    """
    field = np.zeros(len(targets), dtype=np.complex128)
    parts = np.stack([weights.real, weights.imag])

    def share(piece: tuple[slice, slice]) -> np.ndarray:
        some, there = piece
        length, amplitude = path(sources[some], targets[there])
        angle = length / wavelength
        angle -= np.round(angle)
        angle *= 2 * np.pi
        # Twice as fast as the exponential of complex numbers.
        in_phase = parts[:, some] @ (amplitude * np.cos(angle))
        in_quadrature = parts[:, some] @ (amplitude * np.sin(angle, out=angle))
        return in_phase[0] - in_quadrature[1] + 1j * (in_phase[1] + in_quadrature[0])

    # Pieces of a size of their own, whatever the number of cores: the same bits on every machine.
    target_step = min(len(targets), TARGETS_AT_ONCE) or 1
    source_step = max(1, PAIRS_AT_ONCE // target_step)
    for first_target in range(0, len(targets), target_step):
        there = slice(first_target, first_target + target_step)
        pieces = [(slice(first, first + source_step), there) for first in range(0, len(sources), source_step)]
        for part in on_all_cores(share, pieces):
            field[there] += part
    return field


@dataclass(frozen=True)
class Sample:
    """Points on which to measure a field's error: half of them drawn evenly, half by the field's square.

    So a focus in a dark field is looked at, and so is the dark. index: (count,) flat; share: (count,) how often each is
    drawn relative to evenly, by which sums over the sample are to be divided; mean_square: of the whole field. Always
    the same for the same field.
    """

    index: np.ndarray
    share: np.ndarray
    mean_square: float

    def error(self, found: np.ndarray, exact: np.ndarray) -> float:
        """Relative L2 error of the field, from its values (count,) on the sample and the exact ones."""
        # The scale is the whole field's: a few points of a speckle pattern do not know it.
        scale = self.mean_square or float(np.mean(_power(exact))) or 1.0
        return float(np.sqrt(np.mean(np.abs(found - exact) ** 2 / self.share) / scale))

    @classmethod
    def of(cls, field: np.ndarray, count: int) -> Sample:
        """From a field (m,) complex128."""
        random = np.random.default_rng(SAMPLE_SEED)
        size = field.size
        # The power of blocks first, then of the points of the blocks drawn: one pass without a second array.
        block = min(POWER_BLOCK, size)
        whole = size // block * block
        parts = field[:whole].view(np.float64).reshape(-1, 2 * block)
        total = np.cumsum(np.append(np.einsum("ij,ij->i", parts, parts), np.sum(_power(field[whole:]))))
        mean_square = float(total[-1]) / size
        if not (np.isfinite(mean_square) and mean_square > 0):
            return cls(random.integers(size, size=count), np.ones(count), mean_square)
        half = count // 2
        drawn = np.searchsorted(total, random.random(half) * total[-1], side="right")
        inside = np.minimum(drawn * block, size - 1)[:, None] + np.arange(block)
        powers = np.cumsum(np.where(inside < size, _power(field[np.minimum(inside, size - 1)]), 0.0), axis=1)
        step = np.count_nonzero(powers <= random.random((half, 1)) * powers[:, -1:], axis=1)
        by_power = np.minimum(inside[:, 0] + np.minimum(step, block - 1), size - 1)
        index = np.concatenate([by_power, random.integers(size, size=count - half)])
        even = (count - half) / count
        return cls(index, even + (1 - even) * _power(field[index]) / mean_square, mean_square)


def _power(values: np.ndarray) -> np.ndarray:
    return values.real**2 + values.imag**2
