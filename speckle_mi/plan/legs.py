"""Legs of a way: from the spot or an opening to a later opening or the detector, and straight light over them.

An end is given as the rim that it lies on; None stands for the spot before a leg, for the detector behind one.
"""

from __future__ import annotations

import numpy as np

from ..geometry.pairs import all_pairs
from ..optics.aim import aim
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.trace import trace
from .way import Channel, Rim, without_rims


def leg(channel: Channel, before: Rim | None, after: Rim | None) -> tuple[tuple[Interaction, ...], Interaction]:
    """What refracts and reflects on a leg, as if surfaces went on beyond their rims, and the plane where it ends."""
    first, last = leg_limits(channel, before, after)
    between = without_rims(i for i in channel.interactions[first:last] if i.bends)
    return between, after.end if after else detector_plane(channel.grid)


def leg_limits(channel: Channel, before: Rim | None, after: Rim | None) -> tuple[int, int]:
    """Number of interactions of the way before a leg begins, and before it ends."""
    return before.position if before else 0, after.position if after else len(channel.interactions)


def straight_on(
    channel: Channel, start: Rim | None, sources: np.ndarray, opening: Rim, holes: np.ndarray, goal: Rim | None
) -> np.ndarray:
    """Where light goes that comes over an opening and is not diffracted there: places (k, 3) in the plane of ``goal``.

    sources: (n, 3) on ``start``; holes: (m, 3) on the opening. Rays that do not get there are left out.
    """
    between, end = leg(channel, start, opening)
    starts, over = all_pairs(sources, holes)
    aimed = aim(Sequence((*between, end)), starts, over)
    good = aimed.converged
    if not np.any(good):
        return np.empty((0, 3))
    between, end = leg(channel, opening, goal)
    hits = trace(Sequence((*between, end)), over[good], aimed.arrival[good]).points[-1]
    return hits[np.all(np.isfinite(hits), axis=1)]
