"""All pairs of two sets of places."""

from __future__ import annotations

import numpy as np


def all_pairs(sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends (n m, 3) of the rays from every source (n, 3) to every target (m, 3), source by source."""
    return np.repeat(sources, len(targets), axis=0), np.tile(targets, (len(sources), 1))
