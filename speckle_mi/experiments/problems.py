"""What is wrong with an assembly, at the place where it is wrong: for drawings."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ..plan.ended_rays import EndedRay, ended_rays
from ..plan.plan import Plan
from ..plan.setup import Setup
from ..plan.stage import BESIDE, NO_WAY
from ..scene.assembly import Assembly

_RAYS_SHOWN = 6
"""Rays that are drawn to where they end."""


@dataclass(frozen=True)
class Problem:
    """place: (3,) world [mm]; words: what is wrong there; ray: (p, 3) of the light that comes there, None without."""

    place: np.ndarray
    words: str
    ray: np.ndarray | None = None


def missed_beams(setup: Setup) -> list[Problem]:
    """The beams whose axes do not meet the target."""
    return [problem for part in setup.assembly.named_parts if (problem := _missed(part, setup))]


def dark_ways(setup: Setup, plan: Plan) -> list[Problem]:
    """Where light ends, when none reaches the detector."""
    centre = setup.assembly.detector.centre
    if not setup.assembly.elements:
        return [Problem(centre, words) for words in _turned_away(setup)]
    if not any(stage.kind in (NO_WAY, BESIDE) for stage in plan.stages):
        return []
    rays = [Problem(ray.points[-1], words, ray.points) for ray, words in _worded(ended_rays(setup))]
    return [*rays, Problem(centre, "no light reaches the detector")]


def _turned_away(setup: Setup) -> list[str]:
    """Why a detector with nothing before it sees no light."""
    grid, spot = setup.assembly.detector, setup.spot.point
    sight = grid.centre - spot
    found = []
    if sight @ grid.normal >= 0:
        found.append("the detector looks away from the target")
    if setup.front is not None and sight @ setup.front <= 0:
        found.append("the detector stands behind the target")
    return found


def _missed(part: Assembly, setup: Setup) -> Problem | None:
    """That the axis of a beam does not meet the target; points of the user's own are no surface to meet."""
    if part.target.points is not None or part.beam.is_uniform:
        return None
    if part.target.surface.facets.first_met(setup.frame, part.beam.origin, part.beam.axis) is not None:
        return None
    return Problem(part.spot_at(setup.frame).point, f"the beam's axis ({part.light}) misses the target")


def _worded(rays: list[EndedRay]) -> list[tuple[EndedRay, str]]:
    """A few rays, each end named once."""
    shown, said = [], Counter()
    for ray in rays:
        name = "passes the detector by" if ray.end is None else f"light ends at {ray.end}"
        if len(shown) < _RAYS_SHOWN:
            shown.append((ray, "" if said[name] else name))
        said[name] += 1
    return shown
