"""The ways that light takes from the target to the detector, found by rays through the Mitsuba scene.

Rays leave the middle of the laser's spot in all directions that could matter. Mitsuba says which shape each meets
next; the exact surface of that shape says where and where to. Rays that reach the detector over the same surfaces
in the same order form a route; what happens along it is the sequence of interactions that the field is computed with.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ..geometry.rotation import vectors_across
from ..optics.aim import aim
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.surface import Surface
from ..optics.trace import RayStatus, trace
from .setup import Setup
from .tracer import TARGET
from ..scene.elements import Element

MAX_INTERACTIONS = 32
"""Rays that have not arrived after this many surfaces are given up."""

_GONE = -3
"""What a ray meets next that is no more, besides ``TARGET`` and ``NOTHING``."""

_FAR = 1e30
"""Distance that stands for the detector's plane beside its area: behind every shape."""

_SAME_FACE = 0.02
"""Part of an element's size within which a second hit of the same face is the mesh's facet, not the face again."""

_STRAY_SHARE = 2e-3
"""Share of the most travelled route's rays below which a route may be a leak between facets of a mesh."""

_HEMISPHERE_RAYS = 2048
_DETECTOR_RAYS = 24
_ELEMENT_RAYS = 16

_CLEARANCE = 1e-4
"""Least distance [mm] by which a ray starts off the surface it has just left."""


@dataclass(frozen=True)
class Route:
    """One way from the target to the detector.

    names: the elements' names in order; interactions: what happens at each of their surfaces; rays: how many of the
    test rays took it; steps: (element, face, action) of every interaction.
    """

    names: tuple[str, ...]
    interactions: tuple[Interaction, ...]
    rays: int
    steps: tuple[tuple[int, int, str], ...] = ()

    @property
    def label(self) -> str:
        """The way in words, for example ``target - stop - lens - lens - detector``."""
        return " - ".join(["target", *self.names, "detector"])


@dataclass(frozen=True)
class Arrivals:
    """What became of the test rays.

    routes: the most travelled first; in_area: whether they end in the detector's area or only in its plane;
    stopped: how many rays each element ended.
    """

    routes: tuple[Route, ...]
    in_area: bool
    stopped: Counter


def find_routes(setup: Setup) -> Arrivals:
    """The routes from the spot, with the target where it stands in the scene, to the detector's area.

    A route counts if a test ray takes it to that area, or one that passes the area by can be aimed at it. Where
    there is none, the routes to the detector's plane beside it are given: diffraction may still reach it.
    """
    directions = _test_directions(setup)
    # A little off the middle: rays along an axis of symmetry would meet vertices of meshes, where facets leak.
    clearance, axes = _clearance(setup), setup.frame.axes
    start = setup.spot.point + clearance * (setup.spot.normal + 3.7 * axes[:, 0] + 7.1 * axes[:, 1])
    rays = _follow(setup, start, directions, clearance)
    arrived, passed_by = _routes(setup.assembly.elements, rays.arrived), _routes(setup.assembly.elements, rays.passed_by)
    # Few rays may be a leak between the facets of a mesh, or a narrow way: aiming tells.
    enough = _STRAY_SHARE * max((route.rays for route in arrived), default=0)
    sure = [route for route in arrived if route.rays > enough]
    known = {route.steps for route in sure}
    for route in (*arrived, *passed_by):
        if route.steps not in known and _can_be_aimed(setup, start, clearance, route):
            sure.append(route)
            known.add(route.steps)
    # Of the ways beside the detector the straight one is of no use: nothing on it could diffract its light.
    beside = tuple(route for route in passed_by if route.steps and route.rays > _STRAY_SHARE * passed_by[0].rays)
    return Arrivals(tuple(sure) or beside, bool(sure), rays.stopped)


def _clearance(setup: Setup) -> float:
    """Distance [mm] by which a ray starts off a surface: above what single precision rounds the scene's places by."""
    assembly = setup.assembly
    parts = [element.body.reach for element in assembly.elements]
    largest = max([*parts, *np.abs(assembly.detector.centre), *np.abs(setup.frame.origin), *np.abs(assembly.beam.origin)])
    return max(_CLEARANCE, 16 * float(np.finfo(np.float32).eps) * largest)


def _follow(setup: Setup, start: np.ndarray, directions: np.ndarray, clearance: float) -> _Rays:
    """Rays from one place (3,) along directions (n, 3) to their ends."""
    rays = _Rays(np.broadcast_to(start, directions.shape).copy(), directions.copy(), clearance)
    for _ in range(MAX_INTERACTIONS):
        if not np.any(rays.alive):
            break
        _advance(setup, rays)
    return rays


def _can_be_aimed(setup: Setup, start: np.ndarray, clearance: float, route: Route) -> bool:
    """Whether the middle or a corner of the detector is reached over a route, inside all outlines.

    The aimed ray is followed through the scene again: another element may stand in its way.
    """
    grid = setup.assembly.detector
    half_u, half_v = 0.5 * grid.pitch * (grid.shape[1] - 1), 0.5 * grid.pitch * (grid.shape[0] - 1)
    signs = ((0, 0), (-1, -1), (-1, 1), (1, -1), (1, 1))
    targets = np.array([grid.centre + a * half_u * grid.u + b * half_v * grid.v for a, b in signs])
    if not route.interactions:
        return False  # the straight way needs no aim: a test ray goes to each part of the detector
    sequence = Sequence((*route.interactions, detector_plane(grid)))
    aimed = aim(sequence, np.broadcast_to(start, targets.shape), targets)
    free = aimed.converged & np.all(aimed.margins >= 0, axis=0)
    if not np.any(free):
        return False
    again = _follow(setup, start, aimed.launch[free], clearance)
    return route.steps in again.arrived or route.steps in again.passed_by


def _routes(elements: tuple[Element, ...], arrived: dict) -> tuple[Route, ...]:
    routes = [
        Route(tuple(elements[number].name for number, *_ in steps), interactions, count, steps)
        for steps, (count, interactions) in arrived.items()
    ]
    return tuple(sorted(routes, key=lambda route: -route.rays))


class _Rays:
    """Test rays on their way, and what became of those that have ended.

    origin, direction: (n, 3); clearance: by which they start off a surface [mm]; alive: (n,); inside: (n,) number of
    the glass a ray is in, -1 for none; steps and interactions: what each ray has met; arrived, passed_by: steps ->
    (rays, interactions) of those that ended in the detector's area, and beside it; stopped: rays that each element
    ended.
    """

    def __init__(self, origin: np.ndarray, direction: np.ndarray, clearance: float) -> None:
        count = len(direction)
        self.origin, self.direction, self.clearance = origin, direction, clearance
        self.alive = np.ones(count, dtype=bool)
        self.inside = np.full(count, -1)
        self.steps: list[tuple] = [()] * count
        self.interactions: list[tuple[Interaction, ...]] = [()] * count
        self.arrived: dict[tuple, tuple[int, tuple[Interaction, ...]]] = {}
        self.passed_by: dict[tuple, tuple[int, tuple[Interaction, ...]]] = {}
        self.stopped: Counter = Counter()

    def take(self, index: np.ndarray, step: tuple, interaction: Interaction) -> None:
        """Notes a step of the rays ``index``."""
        for ray in index:
            self.steps[ray] += (step,)
            self.interactions[ray] += (interaction,)

    def end(self, index: np.ndarray, ledger: dict) -> None:
        """Ends the rays ``index`` and counts their routes in ``ledger``."""
        self.alive[index] = False
        for ray in index:
            count, interactions = ledger.get(self.steps[ray], (0, self.interactions[ray]))
            ledger[self.steps[ray]] = (count + 1, interactions)

    def stop(self, index: np.ndarray, name: str) -> None:
        """Ends the rays ``index`` at something opaque."""
        self.alive[index] = False
        self.stopped[name] += len(index)


def _test_directions(setup: Setup) -> np.ndarray:
    """Directions (n, 3): towards the detector, towards every element, and evenly over the hemisphere of the target.

    The user's own scatterers radiate to all sides.
    """
    spot, normal, grid = setup.spot.point, setup.spot.normal, setup.assembly.detector
    half_u, half_v = grid.half_size
    side = (np.arange(_DETECTOR_RAYS) + 0.5) / _DETECTOR_RAYS * 2 - 1
    a, b = (values.ravel() for values in np.meshgrid(side, side))
    targets = [grid.centre[None], grid.centre + a[:, None] * half_u * grid.u + b[:, None] * half_v * grid.v]
    for element in setup.assembly.elements:
        targets += [points_on(face) for face in element.faces]
        targets.append(element.body.bounds.mean(axis=0, keepdims=True))
    towards = np.concatenate(targets) - spot
    all_around = setup.assembly.target.points is not None
    count = (2 if all_around else 1) * _HEMISPHERE_RAYS
    number = np.arange(count) + 0.5
    # Fibonacci lattice: even over the sphere.
    height = 1 - number / _HEMISPHERE_RAYS
    azimuth = np.pi * (1 + 5**0.5) * number
    ring = np.sqrt(1 - height**2)
    first, second = vectors_across(normal)
    around = (
        (ring * np.cos(azimuth))[:, None] * first
        + (ring * np.sin(azimuth))[:, None] * second
        + height[:, None] * normal
    )
    directions = np.concatenate([towards, around])
    length = np.linalg.norm(directions, axis=1)
    directions = directions[length > 0] / length[length > 0, None]
    return directions if all_around else directions[directions @ normal > 1e-6]


def points_on(face: Surface) -> np.ndarray:
    """World points (n, 3) spread over a face inside its rim, or over half of a sphere."""
    number = np.arange(_ELEMENT_RAYS**2) + 0.5
    radius, angle = np.sqrt(number / _ELEMENT_RAYS**2), np.pi * (1 + 5**0.5) * number
    half_x, half_y = face.outline.half_size if face.outline else (1 / face.curvature,) * 2
    x, y = half_x * radius * np.cos(angle), half_y * radius * np.sin(angle)
    return face.frame.to_world(np.stack([x, y, face.sag(x * x + y * y)], axis=1))


def _advance(setup: Setup, rays: _Rays) -> None:
    """Takes every living ray to the next thing it meets."""
    elements = setup.assembly.elements
    index = np.flatnonzero(rays.alive)
    number, reach = _next_shapes(setup, rays, index)
    detector, inside = _distance_to_detector(setup, rays.origin[index], rays.direction[index])
    _pass_openings(elements, rays, index, np.minimum(reach, detector))
    kept = rays.alive[index]
    index, number, reach, detector, inside = index[kept], number[kept], reach[kept], detector[kept], inside[kept]
    at_detector = detector <= reach
    # A ray that grazes the edge of a lens can slip between its facets: in glass without a way out, it ends there.
    slipped = at_detector & (rays.inside[index] >= 0)
    for place, element in enumerate(elements):
        rays.stop(index[slipped & (rays.inside[index] == place)], element.name)
    at_detector &= ~slipped
    number[slipped] = _GONE
    rays.end(index[at_detector & inside], rays.arrived)
    rays.end(index[at_detector & ~inside & np.isfinite(detector)], rays.passed_by)
    rays.stop(index[at_detector & np.isinf(detector)], "nothing")
    rays.stop(index[~at_detector & (number == TARGET)], "target")
    for place, element in enumerate(elements):
        chosen = ~at_detector & (number == place)
        if np.any(chosen):
            _meet(element, place, rays, index[chosen], reach[chosen])


def _pass_openings(elements: tuple[Element, ...], rays: _Rays, index: np.ndarray, end: np.ndarray) -> None:
    """Notes the holes that rays go through before they come to what ends their segment, nearest first."""
    numbers = [number for number, element in enumerate(elements) if element.kind == "opening"]
    if not numbers:
        return
    distance = np.empty((len(numbers), len(index)))
    for row, number in enumerate(numbers):
        distance[row], in_hole, on_screen = screen_crossing(
            elements[number], rays.origin[index], rays.direction[index], rays.clearance
        )
        # The mesh of a screen leaves a sliver around the hole open; the exact outline decides.
        rays.stop(index[on_screen & (distance[row] < end) & rays.alive[index]], elements[number].name)
        distance[row, ~in_hole] = np.inf
    distance[:, ~rays.alive[index]] = np.inf
    order = np.argsort(distance, axis=0)
    for rank in range(len(numbers)):
        which = order[rank]
        passes = np.take_along_axis(distance, order[rank : rank + 1], axis=0)[0] < end
        for place, number in enumerate(numbers):
            chosen = index[passes & (which == place)]
            interaction = Interaction.through(elements[number].faces[0])
            rays.take(chosen, (number, 0, "pass"), interaction)


def _next_shapes(setup: Setup, rays: _Rays, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of the element each ray meets next, or TARGET or NOTHING, and its distance [mm]."""
    return setup.tracer.nearest(rays.origin[index], rays.direction[index], setup.frame)


def _distance_to_detector(
    setup: Setup, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance [mm] to the detector's plane along rays that come from its front, else inf; and whether in its area."""
    grid = setup.assembly.detector
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = direction @ grid.normal
        distance = (grid.centre - origin) @ grid.normal / slope
        hit = origin + distance[:, None] * direction - grid.centre
        half_u, half_v = grid.half_size
        inside = (np.abs(hit @ grid.u) <= half_u) & (np.abs(hit @ grid.v) <= half_v)
    # Outside the area the plane is thin air, where a ray ends only if it meets nothing else: the caller compares.
    reached = (slope < 0) & (distance > 0)
    inside &= reached
    return np.where(inside, distance, np.where(reached, _FAR, np.inf)), inside


def screen_crossing(
    element: Element, origin: np.ndarray, direction: np.ndarray, clearance: float = _CLEARANCE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance (n,) [mm] to the plane of an opening's screen; whether it is crossed in the hole; or on the screen."""
    face = element.faces[0]
    local, slope = face.frame.to_local(origin), direction @ face.frame.axes
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -local[:, 2] / slope[:, 2]
        x, y = (local[:, k] + distance * slope[:, k] for k in (0, 1))
        hole = np.all(face.outline.margins(x, y) >= 0, axis=0)
        screen = np.hypot(x, y) <= element.screen_radius
    met = distance > clearance / 2
    return np.where(met, distance, np.inf), met & hole, met & screen & ~hole


def _meet(element: Element, number: int, rays: _Rays, index: np.ndarray, reach: np.ndarray) -> None:
    """Refraction, reflection or the end of the rays ``index`` at the element's mesh."""
    if element.kind not in ("mirror", "glass"):
        rays.stop(index, element.name)
        return
    hit = rays.origin[index] + reach[:, None] * rays.direction[index]
    face = element.faces_at(hit)
    again = (reach < element.size * _SAME_FACE) & np.array(
        [bool(rays.steps[ray]) and rays.steps[ray][-1][:2] == (number, f) for ray, f in zip(index, face, strict=True)]
    )
    # A facet of a mesh lies a little off the exact surface that the ray has just left.
    rays.origin[index[again]] = hit[again] + rays.clearance * rays.direction[index[again]]
    rays.stop(index[~again & (face < 0)], element.name)
    comes_from_inside = rays.inside[index] == number
    for f in range(len(element.faces)):
        for within in (False, True):
            chosen = index[~again & (face == f) & (comes_from_inside == within)]
            if len(chosen):
                _interact(element, number, f, within, rays, chosen)


def _interact(element: Element, number: int, face: int, within: bool, rays: _Rays, index: np.ndarray) -> None:
    """One face of one element acts on the rays ``index``, which come from inside the glass or from outside."""
    interaction = element.interaction(face, within)
    result = trace(Sequence((interaction,)), rays.origin[index], rays.direction[index])
    total = result.status == RayStatus.TOTAL_INTERNAL_REFLECTION
    if np.any(total):
        mirror = Interaction.reflect(interaction.surface, interaction.index_before, interaction.root)
        _go_on(element, (number, face, "reflect"), mirror, rays, index[total], -2)
        index = index[~total]
    inside = -2 if interaction.action == "reflect" else (-1 if within else number)
    _go_on(element, (number, face, interaction.action), interaction, rays, index, inside)


def _go_on(
    element: Element, step: tuple, interaction: Interaction, rays: _Rays, index: np.ndarray, inside: int
) -> None:
    """Moves rays through an interaction; ``inside`` is the glass they are in afterwards, -2 for the same as before."""
    if not len(index):
        return
    result = trace(Sequence((interaction,)), rays.origin[index], rays.direction[index])
    rays.stop(index[~result.valid], element.name)
    going, valid = index[result.valid], result.valid
    rays.take(going, step, interaction)
    rays.direction[going] = result.directions[valid]
    rays.origin[going] = result.points[0, valid] + rays.clearance * result.directions[valid]
    if inside != -2:
        rays.inside[going] = inside
