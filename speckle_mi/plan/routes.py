"""The ways that light takes from the target to the detector: sequences of faces and openings.

Between the spot, the openings and the detector :mod:`speckle_mi.plan.search` finds the ways over faces; a route is a
path over them from the spot to the detector.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ..optics.sequence import Interaction
from ..scene.following import Start, Step
from ..scene.meeting import Meetings, Place, index_in
from .places import hole_places
from .search import Chain, Search
from .setup import Setup

MOST_ROUTES = 64
"""Routes that are looked into."""

_HOLE_SHARES = (0.0, 0.5, 0.95)
"""Rings on an opening, relative to its rim, from which light goes on."""

_HOLE_ANGLES = 6


@dataclass(frozen=True)
class Route:
    """One way from the target to the detector.

    names: the elements' names in order; interactions: what happens at each of their surfaces; rays: how many of the
    test rays took it, at its narrowest; steps: (element, face, action, root) of every interaction; launches: (n, 3)
    unit, of the test rays that took it, or its first part up to an opening.
    """

    names: tuple[str, ...]
    interactions: tuple[Interaction, ...]
    rays: int
    steps: tuple[Step, ...] = ()
    launches: np.ndarray = field(default_factory=lambda: np.empty((0, 3)), compare=False, repr=False)

    @property
    def label(self) -> str:
        """The way in words, for example ``target - stop - lens - lens - detector``."""
        return " - ".join(["target", *self.names, "detector"])


@dataclass(frozen=True)
class Arrivals:
    """What became of the light.

    routes: those of most rays first; in_area: whether they end in the detector's area or only in its plane; stopped:
    how many test rays each element ended; goes_on: whether there are more routes than were looked into.
    """

    routes: tuple[Route, ...]
    in_area: bool
    stopped: Counter
    goes_on: bool = False


def find_routes(setup: Setup, spots: np.ndarray) -> Arrivals:
    """The routes from the spot to the detector's area.

    spots: (m, 3) places that stand for all that scatters, the middle first. Where there is no route, those that pass
    the detector's area by are given: diffraction at the rims on them may still reach it.
    """
    paths = _Paths(setup.meetings, spots, setup.front)
    routes = [_route(setup, path) for path in paths.to_detector()]
    routes = sorted(_distinct(routes), key=lambda route: -route.rays)
    if routes:
        return Arrivals(tuple(routes), True, paths.stopped, paths.goes_on)
    beside = [_route(setup, (chain,)) for chain in paths.beside()]
    return Arrivals(tuple(beside), False, paths.stopped)


class _Paths:
    """Paths over openings from the spot to the detector."""

    def __init__(self, meetings: Meetings, spots: np.ndarray, front: np.ndarray | None) -> None:
        self._meetings = meetings
        self._first = Search(meetings, Start(spots, normal=front))
        self._searches: dict[tuple[int, int, Place], Search] = {}
        self.stopped, self.goes_on = self._first.stopped, False

    def to_detector(self) -> list[tuple[Chain, ...]]:
        """All paths, each a chain from the spot to an opening, from there to the next, and to the detector."""
        found = []
        for path in self._longer((), self._first):
            found.append(path)
            if len(found) >= MOST_ROUTES:
                self.goes_on = True
                break
        self.goes_on |= any(search.goes_on for search in (self._first, *self._searches.values()))
        return found

    def beside(self) -> list[Chain]:
        return self._first.beside()

    def _longer(self, path: tuple[Chain, ...], search: Search) -> Iterator[tuple[Chain, ...]]:
        passed = {chain.end for chain in path}
        for chain in search.chains():
            if chain.end is None:
                yield (*path, chain)
            elif chain.end not in passed:
                yield from self._longer((*path, chain), self._from_opening(chain.end, chain.side, chain.inside))

    def _from_opening(self, number: int, side: int, inside: Place) -> Search:
        key = number, side, inside
        if key not in self._searches:
            face = self._meetings.elements[number].faces[0]
            points = hole_places(face, _HOLE_SHARES, _HOLE_ANGLES)
            normal = side * face.frame.axes[:, 2]
            self._searches[key] = Search(self._meetings, Start(points, inside, normal, (number, 0)))
        return self._searches[key]


def _route(setup: Setup, path: tuple[Chain, ...]) -> Route:
    """The route of a path, its openings among the interactions."""
    elements = setup.assembly.elements
    steps: list[Step] = []
    interactions: list[Interaction] = []
    for chain in path:
        steps += chain.steps
        interactions += chain.interactions
        if chain.end is not None:
            index = index_in(elements, chain.inside)
            steps.append((chain.end, 0, "pass", "vertex"))
            interactions.append(Interaction.through(elements[chain.end].faces[0], index))
    names = tuple(elements[number].name for number, *_ in steps)
    rays = min(chain.rays for chain in path)
    return Route(names, tuple(_with_slack(interactions)), rays, tuple(steps), path[0].launches)


def _with_slack(interactions: list[Interaction]) -> list[Interaction]:
    """Interactions of which an opening and the curved face beside it may come in either order, as far as they cross."""
    done = list(interactions)
    for first in range(len(done) - 1):
        pair = done[first : first + 2]
        opening, other = (pair if pair[0].action == "pass" else pair[::-1]) if "pass" in (
            pair[0].action, pair[1].action) else (None, None)  # fmt: skip
        if opening is None or other.action == "pass" or other.surface.is_plane:
            continue
        places = hole_places(opening.surface, (0.0, 0.5, 1.0), 12)
        x, y, z = other.surface.frame.to_local(places).T
        height = z - other.surface.sag(x, y)
        if height.min() < 0 < height.max():
            slack = 2 * float(np.abs(height).max())
            done[first], done[first + 1] = (replace(one, slack=max(one.slack, slack)) for one in pair)
    return done


def _distinct(routes: list[Route]) -> list[Route]:
    """Routes without those that differ only by whether an opening stands before or behind a face that it cuts."""
    best: dict[tuple, Route] = {}
    for route in routes:
        key = (
            tuple(step for step in route.steps if step[2] != "pass"),
            tuple(step[0] for step in route.steps if step[2] == "pass"),
            _gaps_of_openings(route) if not _cut(route) else None,
        )
        if key not in best or route.rays > best[key].rays:
            best[key] = route
    return list(best.values())


def _gaps_of_openings(route: Route) -> tuple[int, ...]:
    return tuple(place for place, step in enumerate(route.steps) if step[2] == "pass")


def _cut(route: Route) -> bool:
    """Whether an opening of the route cuts through a face beside it, or touches it."""
    return any(interaction.slack > 0 for interaction in route.interactions)
