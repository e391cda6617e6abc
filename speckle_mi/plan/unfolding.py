"""Straight rays over plane mirrors: the source seen through them."""

from __future__ import annotations

import numpy as np

from ..optics.sequence import Interaction


def launch_over_planes(interactions: tuple[Interaction, ...], sources: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Launch directions (n, 3), not of unit length, from sources over plane mirrors to targets, (n, 3) each.

    A ray over mirrors is straight to the image of its target in the last, that in the last but one, and so on.
    """
    images = np.array(targets, dtype=np.float64)
    for interaction in reversed(interactions):
        if interaction.action == "reflect":
            frame = interaction.surface.frame
            normal = frame.axes[:, 2]
            images = images - 2 * ((images - frame.origin) @ normal)[:, None] * normal
    return images - sources
