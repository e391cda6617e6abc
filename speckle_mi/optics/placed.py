"""Interactions that know where on their surfaces light is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .sequence import Interaction, Sequence
from .trace import trace


def with_places(
    interactions: tuple[Interaction, ...], starts: np.ndarray, launches: np.ndarray
) -> tuple[Interaction, ...]:
    """Interactions that know where on their surfaces rays of their own meet them."""
    if not interactions:
        return ()
    points = trace(Sequence(interactions), starts, launches).points
    placed = []
    for interaction, hits in zip(interactions, points, strict=True):
        local = interaction.surface.frame.to_local(hits[np.all(np.isfinite(hits), axis=1)])
        if len(local):
            middle = local.mean(axis=0)
            near = local[np.argmin(np.linalg.norm(local - middle, axis=1))]
            interaction = replace(interaction, near=near)
        placed.append(interaction)
    return tuple(placed)
