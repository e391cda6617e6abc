"""The chief ray from the spot to the detector, its neighbours, and the detector's axes as they are seen along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.outline import Circle
from ..optics.aim import aim
from ..optics.sequence import Sequence, detector_plane
from ..optics.trace import trace
from ..plan.plan import Plan
from ..plan.way import Channel
from ..scene.assembly import Assembly

_ZONES = 6
"""Rings, and half the rays a ring, over which a system's lever is averaged."""

STEP = 1e-4
"""Step [mm, rad] of the difference quotients along a chief ray."""

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


@dataclass(frozen=True)
class Zones:
    """Places that stand for equal areas of the first opening, and how much the ray through each moves the pattern.

    places: (n, 3) [mm]; weights: (n, 2), for phase slopes along the opening's x and y; axes: (2, 3) these.

    What moves the pattern is the straight line that fits a phase over the opening best. Its slope along x is the mean
    of the local slopes, the motions of rays' ends, weighted by x_edge^2 - x^2, x_edge the rim at that y: integration
    by parts of the mean of phase times x.
    """

    places: np.ndarray
    weights: np.ndarray
    axes: np.ndarray

    @classmethod
    def middle(cls, channel: Channel) -> Zones:
        """The opening's middle alone."""
        return cls(opening_middle(channel), np.ones((1, 2)), np.eye(3)[:2])

    @classmethod
    def over_opening(cls, channel: Channel) -> Zones:
        """All over the opening; the middle where light is not diffracted."""
        if not channel.openings:
            return cls.middle(channel)
        plane = channel.openings[0].plane
        if isinstance(plane.outline, Circle):
            share = np.sqrt((np.arange(_ZONES) + 0.5) / _ZONES)
            angle = 2 * np.pi * np.arange(2 * _ZONES) / (2 * _ZONES)
            x, y = (plane.outline.radius * np.outer(share, f(angle)).ravel() for f in (np.cos, np.sin))
            # x_edge^2 = R^2 - y^2, so that both weights are R^2 - r^2.
            weight_x = weight_y = np.repeat(1 - share**2, 2 * _ZONES)
        else:
            side = (np.arange(_ZONES) + 0.5) / _ZONES * 2 - 1
            a, b = (values.ravel() for values in np.meshgrid(side, side))
            x, y, weight_x, weight_y = plane.outline.half_x * a, plane.outline.half_y * b, 1 - a**2, 1 - b**2
        weights = np.stack([weight_x, weight_y], axis=1)
        places = plane.frame.to_world(np.stack([x, y, np.zeros_like(x)], axis=1))
        return cls(places, weights / weights.mean(axis=0), plane.frame.axes[:, :2].T)

    def mean(self, motion: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """The pattern's motion (k, 2) along the columns of ``plane`` (3, 2) from that of the rays' ends (n, k, 2)."""
        if len(self.places) == 1:
            return motion[0]
        turn = self.axes @ plane  # from the opening's axes to the detector's, which need not be parallel
        local = motion @ np.linalg.inv(turn)
        return np.mean(local * self.weights[:, None, :], axis=0) @ turn


@dataclass(frozen=True)
class ChiefRay:
    """The ray from the spot through the opening's middle, and what its neighbours do, taken together over the opening.

    sight: (3,) its direction at the spot; across: (2, 3) unit vectors across it; magnification, lever: (2, 2) motion of
    a ray's end on the detector per shift [mm/mm] and per tilt [mm/rad] of its beginning; distance: to the opening [mm].
    With aberrations both are those of the part of a phase change that is linear over the opening, see :class:`Zones`:
    a tilt shifts the light across the pupil, so that the lever is the straight line fitted to the rays' ends.
    """

    sight: np.ndarray
    across: np.ndarray
    magnification: np.ndarray
    lever: np.ndarray
    distance: float


def chief_ray(
    assembly: Assembly, channel: Channel, system: Sequence, u: np.ndarray, v: np.ndarray, over: Zones
) -> ChiefRay | None:
    """The chief ray through ``system``, its end measured along u and v, with the rays over zones of the opening."""
    spot = assembly.spot.point
    launch = launch_to(channel, spot[None], opening_middle(channel))
    zones = launch_to(channel, spot[None], over.places)
    if launch is None or zones is None:
        return None
    sight = launch[0]
    first = np.cross(sight, assembly.target.frame.axes[:, 1])
    if np.linalg.norm(first) < 1e-3:
        first = np.cross(sight, assembly.target.frame.axes[:, 0])
    first /= -np.linalg.norm(first)
    across = np.stack([first, np.cross(sight, first)])
    shifts = np.concatenate([np.outer([1.0, -1.0], a) for a in across]) * STEP
    moved = trace(system, np.tile(spot + shifts, (len(zones), 1)), np.repeat(zones, 4, axis=0)).points[-1]
    tilted = trace(system, np.broadcast_to(spot, zones.shape), zones).points[-1]
    if not (np.all(np.isfinite(moved)) and np.all(np.isfinite(tilted))):
        return None
    plane = np.stack([u, v], axis=1)
    ends = (moved @ plane).reshape(len(zones), 4, 2)
    magnification = over.mean((ends[:, 0::2] - ends[:, 1::2]) / (2 * STEP), plane).T
    # Slopes at the spot: the transverse part of a direction over its part along the chief ray.
    slopes = (zones @ across.T) / (zones @ sight)[:, None]
    lever = _line(slopes, tilted @ plane) if len(zones) > 1 else _lever_of_one(system, spot, sight, across, plane)
    distance = float(np.linalg.norm(opening_middle(channel) - spot))
    return ChiefRay(sight, across, magnification, lever, distance)


def _line(slopes: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(2, 2) matrix of the straight line that fits ends (n, 2) against slopes (n, 2) best."""
    fitted, *_ = np.linalg.lstsq(np.column_stack([slopes, np.ones(len(slopes))]), ends, rcond=None)
    return fitted[:2].T


def _lever_of_one(
    system: Sequence, spot: np.ndarray, sight: np.ndarray, across: np.ndarray, plane: np.ndarray
) -> np.ndarray:
    """(2, 2) motion of one ray's end per tilt [mm/rad], where no opening limits the light."""
    tilts = np.concatenate([np.outer([1.0, -1.0], a) for a in across]) * STEP
    ends = trace(system, np.broadcast_to(spot, tilts.shape), sight + tilts).points[-1] @ plane
    return ((ends[0::2] - ends[1::2]) / (2 * STEP)).T


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
