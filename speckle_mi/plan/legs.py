"""Legs of a way: from the spot or an opening to a later opening or the detector, and straight light over them.

An end is given as the rim that it lies on; None stands for the spot before a leg, for the detector behind one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.pairs import all_pairs
from ..optics.aim import AimedPaths, aim, chief_ray
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.trace import trace
from ..propagation.chebyshev import tensor_polynomials
from .onward import ORDERS, Onward
from .places import FINE, hole_places
from .setup import Setup
from .way import Channel, Rim, without_rims

_SAME_MIDDLE = 6
"""Digits [mm] to which the middles of two sets of places are the same."""


def leg(channel: Channel, before: Rim | None, after: Rim | None) -> tuple[tuple[Interaction, ...], Interaction]:
    """What refracts and reflects on a leg, as if surfaces went on beyond their rims, and the plane where it ends."""
    first, last = leg_limits(channel, before, after)
    between = without_rims(i for i in channel.interactions[first:last] if i.bends)
    return between, after.end if after else detector_plane(channel.grid)


def leg_limits(channel: Channel, before: Rim | None, after: Rim | None) -> tuple[int, int]:
    """Number of interactions of the way before a leg begins, and before it ends."""
    return before.position if before else 0, after.position if after else len(channel.interactions)


def rays_over(
    channel: Channel, before: Rim | None, after: Rim | None, sources: np.ndarray, targets: np.ndarray,
    rims: bool = False,
) -> AimedPaths:  # fmt: skip
    """The rays of a leg from all of sources (n, 3) to all of targets (m, 3), source by source.

    rims: whether the rims between count, so that rays clear of them are preferred and their clearances told. What
    takes longest is to find a chief ray, which is done once for all places around the same two.
    """
    faces, end = leg(channel, before, after)
    if rims:
        first, last = leg_limits(channel, before, after)
        faces = channel.interactions[first:last]
    sequence = Sequence((*faces, end))
    middles = sources.mean(axis=0), targets.mean(axis=0)
    chief = None
    if any(interaction.bends for interaction in faces):
        place = tuple(np.round(np.concatenate(middles), _SAME_MIDDLE))
        key = (channel.interactions, before, after, rims, place)
        if key not in channel.chiefs:
            channel.chiefs[key] = chief_ray(sequence, *(middle[:, None] for middle in middles))
        chief = channel.chiefs[key]
    return aim(sequence, *all_pairs(sources, targets), chief=chief)


@dataclass(frozen=True)
class LightOver:
    """Light that comes over an opening: places (n, 3) in it and unit directions (n, 3) in which it arrives there."""

    opening: Rim
    places: np.ndarray
    directions: np.ndarray


def light_over(
    channel: Channel, start: Rim | None, sources: np.ndarray, opening: Rim, holes: np.ndarray
) -> LightOver:
    """The light from sources (n, 3) on ``start`` that comes to places (m, 3) of an opening, as far as there is any."""
    aimed = rays_over(channel, start, opening, sources, holes)
    good = aimed.converged
    return LightOver(opening, all_pairs(sources, holes)[1][good], aimed.arrival[good])


def straight_on(channel: Channel, light: LightOver, goal: Rim | None) -> np.ndarray:
    """Where light goes that is not diffracted at the opening: places (k, 3) in the plane of ``goal``.

    Rays that do not get there are left out.
    """
    if not len(light.places):
        return np.empty((0, 3))
    between, end = leg(channel, light.opening, goal)
    hits = trace(Sequence((*between, end)), light.places, light.directions).points[-1]
    return hits[np.all(np.isfinite(hits), axis=1)]


def onward_of(setup: Setup, channel: Channel) -> tuple[Onward | None, ...]:
    """For each opening of a channel, where light from the spot goes on to; None where not every place has a ray."""
    return tuple(_onward(setup, channel, rim) for rim in channel.openings)


def _onward(setup: Setup, channel: Channel, rim: Rim) -> Onward | None:
    places, grid, spots = hole_places(rim.plane, *FINE), channel.grid, setup.spots
    light = light_over(channel, None, spots, rim, places)
    hits = straight_on(channel, light, None)
    if len(hits) < len(spots) * len(places):
        return None
    reach, distance = rim.plane.outline.reach, float(np.linalg.norm(grid.centre - rim.plane.frame.origin))
    polynomials = tensor_polynomials(ORDERS, rim.plane.frame.to_local(places)[:, :2] / reach).T
    offset = ((hits - grid.centre) @ np.stack([grid.u, grid.v], axis=1)).reshape(len(spots), len(places), 2)
    landing = np.array([np.linalg.lstsq(polynomials, one, rcond=None)[0] for one in offset])
    wavelength = setup.assembly.beam.wavelength
    spread = np.sqrt(wavelength * distance) + wavelength * distance / reach
    return Onward(reach, landing, np.array(grid.half_size) + spread)
