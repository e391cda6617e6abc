"""How much of the light a way brings straight to the detector, and how much its edges alone throw there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.pairs import all_pairs
from ..geometry.plane import PlaneGrid
from ..optics.aim import aim
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.surface import Surface
from ..optics.trace import trace
from .fresnel import edge_wave, fresnel_parameter
from .places import detector_places, hole_places
from .routes import Route
from .setup import Setup
from .way import Channel

_HOLE_SHARES, _HOLE_ANGLES = (0.0, 0.5, 0.98), 8

_SHARE_SIDE = 9
"""Places a side on the detector at which is looked whether a way reaches them."""


@dataclass(frozen=True)
class Strength:
    """Of a way's light on the detector.

    lit: whether straight light arrives in its area; share: amplitude of what arrives relative to straight light, 1
    where lit; amplitude: of straight light over its length [1/mm].
    """

    lit: bool
    share: float
    amplitude: float


def strength_of(setup: Setup, route: Route, interactions: tuple[Interaction, ...], grid: PlaneGrid, spots) -> Strength:
    """How strong a way's light is; interactions, grid: the way with plane mirrors unfolded.

    From one place to the next (spot, openings, detector) rays go straight on. Where they miss the next, the edge of the
    opening before throws its wave there.
    """
    stops = [n for n, step in enumerate(route.steps) if step[2] == "pass"]
    share, places, start = 1.0, spots, 0
    directions = None
    length = 0.0
    for stop in (*stops, None):
        last = len(interactions) if stop is None else stop
        between = tuple(i for i in interactions[start:last] if i.action != "pass")
        if stop is None:
            end, goals = detector_plane(grid), detector_places(grid)
            size = grid.half_size
        else:
            plane = interactions[stop].surface
            end, goals = Interaction.through(Surface(plane.frame), interactions[stop].index_before), _hole(plane)
            size = plane.outline.half_size
        if directions is not None:
            share *= _arriving(setup, between, end, places, directions, goals, size)
        starts, ends = all_pairs(places, goals)
        aimed = aim(Sequence((*between, end)), starts, ends)
        good = aimed.converged
        if np.any(good):
            length += float(np.mean(aimed.optical_path_length[good]))
        places, directions, start = ends[good], aimed.arrival[good], last
        if not len(places):
            places, directions = goals, None
    return Strength(share == 1.0, share, 1 / max(length, 1e-300))


def reached_share(channel: Channel, spots: np.ndarray) -> float:
    """Amplitude of a way's straight light on the whole detector, relative to light that reaches all of it.

    spots: (m, 3) places that stand for the spot. The root of the share of the detector that it reaches.
    """
    places = detector_places(channel.grid, _SHARE_SIDE)
    aimed = aim(Sequence((*channel.interactions, detector_plane(channel.grid))), *all_pairs(spots, places))
    reached = aimed.converged & np.all(aimed.margins >= 0, axis=0)
    return float(np.sqrt(max(np.mean(reached), 0.5 / len(places))))


def _hole(plane: Surface) -> np.ndarray:
    return hole_places(plane, _HOLE_SHARES, _HOLE_ANGLES)


def _arriving(setup: Setup, between, end: Interaction, places, directions, goals: np.ndarray, size) -> float:
    """What of the light that goes straight on from an opening arrives within the next one, or on the detector."""
    on = trace(Sequence((*between, end)), places, directions).points[-1]
    on = on[np.all(np.isfinite(on), axis=1)]
    middle = goals.mean(axis=0)
    length = float(np.linalg.norm(middle - places.mean(axis=0)))
    aside = length
    if len(on):
        local = end.surface.frame.to_local(on)[:, :2] - end.surface.frame.to_local(middle[None])[0, :2]
        aside = float(np.min(np.hypot(*(np.maximum(np.abs(local) - np.array(size), 0.0)).T)))
    return float(edge_wave(fresnel_parameter(aside, length, setup.assembly.beam.wavelength)))
