"""Planes between a place and its image, where a path from the one to the other does not exist.

Where the detector lies near the image of a stop, many rays lead from each point of the stop to one pixel, or none: no
path length is a smooth function of the two. From the stop to the lens between them, and from there to the detector, it
is. The light is summed on a window in the lens's plane first: a diffraction integral like that over an opening, of
nothing that stands in the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.frames import Frame
from ..geometry.outline import Circle
from ..optics.surface import Surface
from .fresnel import fresnel_distance
from .legs import leg, leg_limits, light_over, rays_over, straight_on
from .places import detector_places, hole_places
from .setup import Setup
from .way import Channel, Rim

NEAR_CAUSTIC = 1e-3
"""Cross section of a ray tube, relative to free space, below which geometric optics does not apply."""

NARROWEST, WIDEST = 6.0, 40.0
"""Fresnel parameters at which a window may end beside the straight light."""

_MOST = 4
_RINGS = (0.0, 0.5, 1.0), 8


@dataclass(frozen=True)
class Relayed:
    """openings: with the windows among them, in order; windows: these alone."""

    openings: tuple[Rim, ...]
    windows: tuple[Rim, ...]


def window_parameter(tolerance: float) -> float:
    """Fresnel parameter v at which a window ends beside the straight light.

    There the wave of an opening's edge has fallen to the root of the tolerance. What passes the window by all the same
    is measured when the light has been summed on it: that of a small opening is spread far.
    """
    return float(np.clip(1 / (np.pi * np.sqrt(2 * tolerance)), NARROWEST, WIDEST))


def with_windows(setup: Setup, channel: Channel, openings: list[Rim], spots: np.ndarray) -> Relayed:
    """The openings of a way with windows where a leg between two of them, the spot and the detector has no path.

    spots: (m, 3) places that stand for the spot.
    """
    found, windows = list(openings), []
    while openings and len(windows) < _MOST:
        window = _needed(setup, channel, found, spots)
        if window is None:
            break
        windows.append(window)
        found = sorted([*found, window], key=lambda rim: rim.position)
    return Relayed(tuple(found), tuple(windows))


def _needed(setup: Setup, channel: Channel, openings: list[Rim], spots: np.ndarray) -> Rim | None:
    """A window that mends the first leg that has no path, None where there is none or nothing mends it."""
    for before, after in zip([None, *openings], [*openings, None], strict=True):
        if not _is_singular(channel, before, after, spots):
            continue
        for rim in channel.rims:
            first, last = leg_limits(channel, before, after)
            within = first <= rim.position <= last and rim.number not in {one.number for one in openings}
            if rim.is_screen or not within:
                continue
            window = _window(setup, channel, rim, before, spots)
            if window and not (
                _is_singular(channel, before, window, spots) or _is_singular(channel, window, after, spots)
            ):
                return window
    return None


def _is_singular(channel: Channel, before: Rim | None, after: Rim | None, spots: np.ndarray) -> bool:
    """Whether not every pair of places at the ends of a leg has exactly one ray, clear of a caustic."""
    if not leg(channel, before, after)[0]:
        return False
    sources = hole_places(before.plane, *_RINGS) if before else spots
    targets = hole_places(after.plane, *_RINGS) if after else detector_places(channel.grid)
    aimed = rays_over(channel, before, after, sources, targets)
    if not np.all(aimed.converged):
        return True
    return bool(np.min(aimed.spread) < NEAR_CAUSTIC or np.ptp(aimed.caustics) > 0)


def _window(setup: Setup, channel: Channel, rim: Rim, before: Rim | None, spots: np.ndarray) -> Rim | None:
    """A round window in a rim's plane around the straight light from an opening; for light from the spot, the rim."""
    if before is None:
        return rim
    hits = straight_on(channel, light_over(channel, None, spots, before, hole_places(before.plane, *_RINGS)), rim)
    if not len(hits):
        return None
    local = rim.plane.frame.to_local(hits)[:, :2]
    middle = 0.5 * (local.min(axis=0) + local.max(axis=0))
    length = float(np.linalg.norm(rim.plane.frame.origin - before.plane.frame.origin))
    radius = float(np.max(np.hypot(*(local - middle).T)))
    v = window_parameter(setup.assembly.options.tolerance)
    radius += fresnel_distance(v, length, setup.assembly.beam.wavelength)
    if radius + np.hypot(*middle) >= min(rim.plane.outline.half_size):
        return rim
    centre = rim.plane.frame.to_world(np.array([[*middle, 0.0]]))[0]
    plane = Surface(Frame(centre, rim.plane.frame.axes), outline=Circle(radius))
    return replace(rim, plane=plane, whole=min(rim.plane.outline.half_size))
