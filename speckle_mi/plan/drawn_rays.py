"""Rays that show how light goes over a way: the chief ray through the middles, marginal ones along the rims."""

from __future__ import annotations

import numpy as np

from ..geometry.plane import PlaneGrid
from ..optics.sequence import Sequence, detector_plane
from ..optics.trace import trace
from .places import hole_places
from .shadows import WayPart
from .way import Channel, without_rims

_AROUND = 4
"""Marginal rays of a way: through places of the rim of its openings, or to the middles of the detector's sides."""


def drawn_rays(channel: Channel, spot: np.ndarray, detector: PlaneGrid) -> list[np.ndarray]:
    """World points (p, 3) of rays from the spot (3,) over a way, the chief ray first; of those that there are.

    Over openings they go through places of their rims and end where they go straight on, so that they show what a lens
    makes of the light; else to the detector's middle and the middles of its sides.
    """
    if channel.openings:
        opening = channel.openings[0]
        ends = hole_places(opening.plane, (0.0, 1.0), _AROUND)
        part = WayPart.between(channel, None, opening)
    else:
        half_u, half_v = channel.grid.half_size
        sides = np.array([[0, 0], [half_u, 0], [0, half_v], [-half_u, 0], [0, -half_v]])
        ends = channel.grid.centre + sides @ np.stack([channel.grid.u, channel.grid.v])
        part = WayPart.whole(channel)
    starts = np.broadcast_to(spot, ends.shape)
    first, _ = part.rays(starts, ends)
    found = np.all(np.isfinite(first), axis=(0, 2))
    if not np.any(found):
        return []
    starts, launches = starts[found], (first[1] - first[0])[found]
    sequence = Sequence((*without_rims(channel.interactions), detector_plane(channel.grid)))
    points = np.concatenate([starts[None], trace(sequence, starts, launches).points])
    points = WayPart.whole(channel).folded(detector, points)
    return [ray for ray in np.moveaxis(points, 1, 0) if np.all(np.isfinite(ray))]
