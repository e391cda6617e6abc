"""Images as few levels of grey: what is shown white, roots in which dark regions are kept, larger pixels."""

from __future__ import annotations

import numpy as np

WHITE = 0.995
"""Quantile of an image that is shown white."""


def white_level(values: np.ndarray) -> float:
    """The level of an image that is shown white; 1 for an image without light."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, WHITE)) or 1.0 if finite.size and finite.max() > 0 else 1.0


def root_levels(values: np.ndarray, white: float) -> np.ndarray:
    """uint8 roots of intensities over ``white``: dark regions of speckle are better kept than in equal steps."""
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.round(255 * np.sqrt(np.clip(values / white, 0, 1)))).astype(np.uint8)


def block_means(values: np.ndarray, block: int) -> np.ndarray:
    """Means of squares of ``block`` pixels, at the far sides of what is left over."""
    for axis in (0, 1):
        starts = np.arange(0, values.shape[axis], block)
        counts = np.diff(np.append(starts, values.shape[axis]))
        values = np.add.reduceat(values, starts, axis=axis) / np.expand_dims(counts, 1 - axis)
    return values
