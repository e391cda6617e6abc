"""Branches of a way: several rays that lead over the same faces from one place to one pixel.

Two parts of a hollow sphere send light to the same pixel, each over a point of its own. Where every pair of places has
the same rays, each clear of a caustic, every one of them is a way of its own: its interactions know where its light is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..optics.aim import aim, rays_between
from ..optics.placed import with_places
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.trace import trace
from .places import points_on
from .search import SAME_RAY
from .setup import Setup
from .way import Channel

def branches_of(setup: Setup, channel: Channel) -> list[Channel]:
    """A way for each of the rays over its faces from the spot's middle to the detector's, next to one that is free.

    Where rims limit the light the way is one: diffraction there adds up all that comes over it.
    """
    if channel.rims or not channel.has_power:
        return [channel]
    spot, sequence = setup.spots[0], Sequence((*channel.interactions, detector_plane(channel.grid)))
    launches = rays_between(sequence, spot, channel.grid.centre, channel.route.launches, SAME_RAY)
    if not len(launches):
        return [channel]
    placed = [with_places(channel.interactions, spot[None], one[None]) for one in launches]
    return [replace(channel, interactions=one, branches=tuple(placed)) for one in placed]


def has_other_rays(setup: Setup, channel: Channel) -> bool:
    """Whether there is another ray from the spot's middle to a pixel than those of the way and its branches.

    Looked for among the rays of a fan; in a hollow sphere, where what stands around hides most of them, among those
    that are known to be free.
    """
    spot, grid = setup.spots[0], channel.grid
    first = channel.interactions[0]
    hollow = first.action == "reflect" and first.root != "vertex"
    fan = channel.route.launches if hollow else _fan_over(channel.interactions, spot)
    traced = trace(Sequence((*channel.interactions, detector_plane(grid))), np.broadcast_to(spot, fan.shape), fan)
    end = traced.points[-1] - grid.centre
    half_u, half_v = grid.half_size
    lands = traced.valid & (np.abs(end @ grid.u) <= half_u) & (np.abs(end @ grid.v) <= half_v)
    if not np.any(lands):
        return False
    places, fan = traced.points[-1, lands], fan[lands]
    known = np.zeros(len(places), dtype=bool)
    for interactions in channel.branches or (channel.interactions,):
        sequence = Sequence((*interactions, detector_plane(grid)))
        aimed = aim(sequence, np.broadcast_to(spot, places.shape), places)
        known |= ~aimed.converged | (np.linalg.norm(aimed.launch - fan, axis=1) <= SAME_RAY)
    return not np.all(known)


def _fan_over(interactions: tuple[Interaction, ...], spot: np.ndarray) -> np.ndarray:
    """Unit directions (n, 3) from a place (3,) to all over the first face."""
    fan = points_on(interactions[0].surface) - spot
    return fan / np.linalg.norm(fan, axis=1, keepdims=True)
