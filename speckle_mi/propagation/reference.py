"""The coherent sum written down as it stands, in float64: slow, exact, and the judge of every other method."""

from __future__ import annotations

import numpy as np

from .paths import Path

SAMPLE_SEED = 20220601
"""Seed of the sample of target points on which errors are measured."""

PAIRS_AT_ONCE = 1 << 20
"""Pairs per chunk: a few arrays of 8 to 16 MB, whatever the number of sources and targets."""


def reference_sum(
    path: Path, sources: np.ndarray, weights: np.ndarray, targets: np.ndarray, wavelength: float
) -> np.ndarray:
    """E_m = sum_j c_j A(P_j, D_m) e^{+ikV(P_j, D_m)}, (m,) complex128.

    sources: (n, 3) [mm]; weights c: (n,) complex; targets: (m, 3) [mm]; wavelength [mm].
    """
    field = np.zeros(len(targets), dtype=np.complex128)
    source_step = min(len(sources), 4096) or 1
    target_step = max(1, PAIRS_AT_ONCE // source_step)
    for first_target in range(0, len(targets), target_step):
        chunk = slice(first_target, first_target + target_step)
        for first in range(0, len(sources), source_step):
            some = slice(first, first + source_step)
            length, amplitude = path(sources[some], targets[chunk])
            turns = length / wavelength
            turns -= np.round(turns)
            field[chunk] += weights[some] @ (amplitude * np.exp(2j * np.pi * turns))
    return field


def sample_of(power: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points on which to measure an error: flat indices (count,), and how often each is drawn relative to evenly.

    Half of them evenly, half by ``power`` (m,), the field's square: a focus in a dark field is looked at, and so is the
    dark. Dividing by the second array makes sums over the sample unbiased. Always the same for the same field.
    """
    random = np.random.default_rng(SAMPLE_SEED)
    total = np.cumsum(power)
    if not total[-1] > 0:
        return random.integers(len(power), size=count), np.ones(count)
    half = count // 2
    by_power = np.searchsorted(total, random.random(half) * total[-1], side="right")
    pick = np.concatenate([np.minimum(by_power, len(power) - 1), random.integers(len(power), size=count - half)])
    even = (count - half) / count
    return pick, even + (1 - even) * power[pick] / (total[-1] / len(power))
