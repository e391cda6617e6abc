"""How many scatterers the detector cannot tell apart: below one or so its image is points, and no speckle."""

from __future__ import annotations

import numpy as np

from ..geometry.rotation import vectors_across
from ..optics.aim import aim
from ..optics.sequence import Sequence, detector_plane
from ..optics.trace import trace
from ..plan.cost import expected_scatterers
from ..plan.places import hole_places
from ..plan.setup import Setup
from ..plan.way import Channel, without_rims

_AROUND = 8
"""Rays through the rim of an opening that show how sharp its image is."""

_ASIDE = 0.01
"""Step on the target [mm] that tells the magnification."""

_AIRY = 0.4694
"""Radius of that disc [wavelengths over the sine of half the cone's angle]."""

FEWEST = 1.0
"""Scatterers in a resolution cell below which a warning is due."""


def too_few_scatterers(setup: Setup, channels: tuple[Channel, ...]) -> list[str]:
    """A warning where a resolution cell of the detector holds less than a scatterer or so behind an opening."""
    if setup.assembly.target.points is not None:
        return []
    counts = [scatterers_in_cell(setup, channel) for channel in channels if channel.openings]
    least = min(counts, default=np.inf)
    if least >= FEWEST:
        return []
    return [
        f"a resolution cell of the detector holds about {least:.2g} scatterers: the image is single points rather than "
        f"speckle, of a contrast of about {np.sqrt(1 + 1 / least):.2g} instead of 1: "
        f"set point_sources to {np.ceil(3 / least):.2g} times as many"
    ]


def scatterers_in_cell(setup: Setup, channel: Channel) -> float:
    """Mean number of scatterers whose images behind a way's first opening lie in one another.

    The image of a scatterer is as large as the rays over the opening's rim are apart on the detector, and as the disc
    that stands for Airy's of the cone that they arrive in: of its intensity h of the area (int h)^2/int h^2, of which
    N scatterers have the contrast sqrt(1 + 1/N) whose images are h at random places. The magnification takes it back to
    the target. Infinite where rays tell neither.
    """
    opening, spot = channel.openings[0], setup.spot
    steps = (np.zeros(3), *(_ASIDE * vectors_across(spot.normal)))
    rim = hole_places(opening.plane, (0.0, 1.0), _AROUND)
    starts = np.concatenate([np.tile(spot.point, (len(rim), 1)), [spot.point + step for step in steps[1:]]])
    ends = np.concatenate([rim, rim[[0, 0]]])
    between = without_rims(one for one in channel.interactions[: opening.position] if one.bends)
    aimed = aim(Sequence((*between, opening.end)), starts, ends)
    if not np.all(aimed.converged):
        return np.inf
    whole = without_rims(one for one in channel.interactions if one.bends)
    traced = trace(Sequence((*whole, detector_plane(channel.grid))), starts, aimed.launch)
    landed = (traced.points[-1] - traced.points[-1, 0]) @ np.stack([channel.grid.u, channel.grid.v], axis=1)
    if not np.all(np.isfinite(landed)):
        return np.inf
    around, aside = landed[1 : len(rim)], landed[len(rim) :]
    sine = np.linalg.norm(np.cross(traced.directions[1 : len(rim)], traced.directions[0]), axis=1).mean()
    magnification = abs(np.linalg.det(aside / _ASIDE))
    if not (sine > 0 and magnification > 0):
        return np.inf
    disc = _AIRY * setup.assembly.beam.wavelength / sine
    area = np.pi * (np.mean(np.sum(around**2, axis=1)) + disc**2) / magnification
    density = setup.assembly.target.surface.density
    return float(min(density * area, max(expected_scatterers(setup.assembly), 1e-300)))
