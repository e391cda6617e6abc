"""The chief ray from the spot to the detector, and the detector's axes as they are seen along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..optics.aim import aim
from ..optics.sequence import Sequence, detector_plane
from ..optics.trace import trace
from ..plan.plan import Plan
from ..plan.way import Channel
from ..scene.assembly import Assembly

SEVERAL_WAYS = (
    "light comes by several ways: shifts along x and y are projections of the detector's axes as they stand in the "
    "world"
)
NO_CHIEF_RAY = (
    "no ray leads from the spot to the detector's middle over its curved mirrors: shifts along x and y are projections "
    "of the detector's axes as they stand in the world"
)


@dataclass(frozen=True)
class SeenAxes:
    """The detector's axes u, v (3,) as the target sees them; note: why they are those in the world instead, if so."""

    u: np.ndarray
    v: np.ndarray
    note: str = ""


def axes_as_seen(assembly: Assembly, plan: Plan) -> SeenAxes:
    """The directions in which the pattern moves, seen from the target, when it moves along the detector's u and v.

    Mirrors on the way turn them: plane ones to the axes of the detector's image in them, curved ones as plane ones that
    touch them where the chief ray is reflected. Lenses do not. Behind an odd number of mirrors they are left-handed.
    Where the light comes by several ways, or no chief ray is found, they are the axes in the world, with a note.
    """
    world = assembly.detector
    if len(plan.channels) > 1:
        return SeenAxes(world.u, world.v, SEVERAL_WAYS)
    if not plan.channels:
        return SeenAxes(world.u, world.v)
    channel = plan.channels[0]
    turn = _reflections(assembly, channel)
    if turn is None:
        return SeenAxes(world.u, world.v, NO_CHIEF_RAY)
    return SeenAxes(turn @ channel.grid.u, turn @ channel.grid.v)


def _reflections(assembly: Assembly, channel: Channel) -> np.ndarray | None:
    """(3, 3) product of the reflections of the chief ray at curved mirrors; None where there is no chief ray."""
    if all(interaction.action != "reflect" for interaction in channel.interactions):
        return np.eye(3)
    spot = assembly.spot.point[None]
    launch = launch_to(channel, spot, opening_middle(channel))
    if launch is None:
        return None
    points = trace(Sequence((*channel.interactions, detector_plane(channel.grid))), spot, launch).points[:, 0]
    turn = np.eye(3)
    for interaction, point in zip(channel.interactions, points, strict=False):
        if interaction.action == "reflect":
            frame = interaction.surface.frame
            normal = frame.axes @ interaction.surface.gradient(frame.to_local(point[None]).T)[:, 0]
            turn = turn @ (np.eye(3) - 2 * np.outer(normal, normal) / (normal @ normal))
    return turn if np.all(np.isfinite(turn)) else None


def opening_middle(channel: Channel) -> np.ndarray:
    """(1, 3) the middle of the first opening, or of the detector [mm]."""
    return channel.openings[0].plane.frame.origin[None] if channel.openings else channel.grid.centre[None]


def launch_to(channel: Channel, sources: np.ndarray, places: np.ndarray) -> np.ndarray | None:
    """Directions (n, 3) of the rays from sources to places on the first opening or the detector; one of them repeated.

    None where a place has no ray.
    """
    end = channel.openings[0].end if channel.openings else detector_plane(channel.grid)
    count = max(len(sources), len(places))
    sources, places = (np.broadcast_to(points, (count, 3)) for points in (sources, places))
    aimed = aim(Sequence((*channel.leg(0), end)), sources, places)
    return aimed.launch if np.all(aimed.converged) else None
