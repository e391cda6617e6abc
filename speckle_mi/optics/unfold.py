"""Plane mirrors taken out of a system: what lies behind a mirror is replaced by its image in the mirror."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.frames import Frame
from ..geometry.plane import PlaneGrid
from .sequence import Interaction


def unfold(interactions: tuple[Interaction, ...], grid: PlaneGrid) -> tuple[tuple[Interaction, ...], PlaneGrid]:
    """The same paths without plane mirrors: interactions and detector behind each mirror are mirrored in it.

    A mirror becomes an opening with the mirror's outline and factor of the amplitude. Path lengths are unchanged, since
    reflection is an isometry; axes behind an odd number of mirrors are left-handed. The mirrors' own phase is left out.
    """
    turn, shift = np.eye(3), np.zeros(3)
    unfolded = []
    for interaction in interactions:
        surface = interaction.surface
        frame = Frame(turn @ surface.frame.origin + shift, turn @ surface.frame.axes)
        image = replace(surface, frame=frame)
        if interaction.action == "reflect" and surface.is_plane:
            unfolded.append(replace(interaction, surface=image, action="pass", root="vertex"))
            normal = frame.axes[:, 2]
            mirror = np.eye(3) - 2 * np.outer(normal, normal)
            turn, shift = mirror @ turn, mirror @ shift + 2 * (frame.origin @ normal) * normal
        else:
            unfolded.append(replace(interaction, surface=image))
    return tuple(unfolded), replace(grid, origin=turn @ grid.origin + shift, u=turn @ grid.u, v=turn @ grid.v)
