"""Which way a laser's light takes over the optics before the target, and what cuts it there.

The beam's axis is followed through all that stands there, and rays around it out to where its light counts. They go
straight through openings, and both ways where a beam splitter divides them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..optics.placed import with_places
from ..optics.sequence import Interaction, Sequence, amplitude_of
from ..optics.trace import trace
from ..scattering.beam import Beam
from .assembly import Target
from .elements import Element
from .errors import SceneError
from .following import Follower, RaySequence, Start
from .light_path import AROUND, RINGS, LightPath
from .meeting import NOTHING, Meetings, Thing
from .tracer import TARGET, Tracer

_NO_WAY = 1e-9
"""Part of the power of the strongest way to the target below which another one is none."""


@dataclass
class _End:
    """Where rays of one sequence ended: starts (n, 3) of those, and what at."""

    sequence: RaySequence
    thing: Thing
    starts: np.ndarray


class _LightFollower(Follower):
    """Follows rays of a laser through openings, to whatever ends them."""

    def __init__(self, meetings: Meetings, start: Start) -> None:
        self.ends: list[_End] = []
        super().__init__(meetings, start)

    def _at_hole(self, sequence: RaySequence, number: int, rays, places, directions, distance) -> Iterator[tuple]:
        face = self.meetings.elements[number].faces[0]
        step = (number, 0, "pass", "vertex")
        through = Interaction.through(face, self.meetings.index_in(sequence.inside))
        longer = self._sequence_of((*sequence.steps, step), (*sequence.interactions, through), sequence.inside,
                                   (number, 0))  # fmt: skip
        if longer is not None:
            yield longer, *rays, places + distance[:, None] * directions, directions

    def _end(self, sequence: RaySequence, thing: Thing, starts: np.ndarray, launches: np.ndarray) -> None:
        self.ends.append(_End(sequence, thing, starts))
        super()._end(sequence, thing, starts, launches)


def light_path(
    beam: Beam, where: str, elements: tuple[Element, ...], target: Target, tracer: Tracer
) -> LightPath:
    """The way of a beam, given where its laser stands, to the target at rest.

    where: how messages call the laser; tracer: of the elements and the target. Raises SceneError where its axis comes
    to the target by no way, which names what blocks it, or by several, and where something beside the way cuts it.
    """
    meetings = Meetings(elements, target, target.frame, tracer)
    arrived = _followed(meetings, beam.origin[None], beam.axis[None])
    reached = [end.sequence for end in arrived if _is_target(end, target)]
    if target.points is not None:
        reached = sorted(reached, key=lambda one: _miss(one, beam, target))[:1]
    if not reached:
        ends = " and ".join(dict.fromkeys(_name(meetings, end.thing) for end in arrived)) or "the surface of a glass"
        raise SceneError(f"{where}: its light comes to the target by no way, its axis ends at {ends}")
    shares = [amplitude_of(one.interactions) ** 2 for one in reached]
    ways = [one for one, share in zip(reached, shares, strict=True) if share > _NO_WAY * max(shares)]
    if len(ways) > 1:
        labels = " and by ".join(_path(beam, elements, one).label for one in ways)
        raise SceneError(
            f"{where}: its light comes to the target by {labels}: must come by one way, block the others"
        )
    if not max(shares) > 0:
        raise SceneError(f"{where}: no light is left on its way to the target, {_path(beam, elements, ways[0]).label}")
    path = _path(beam, elements, ways[0])
    starts, launches, _ = path.rays_around()
    _require_clear(meetings, path, ways[0], _followed(meetings, starts, launches), where)
    return replace(path, cut=_cutting(path, starts, launches))


def _followed(meetings: Meetings, origins: np.ndarray, directions: np.ndarray) -> list[_End]:
    follower = _LightFollower(meetings, Start(origins))
    follower.follow(origins, directions)
    return follower.ends


def _is_target(end: _End, target: Target) -> bool:
    return end.thing.kind == NOTHING if target.points is not None else end.thing.element == TARGET


def _miss(sequence: RaySequence, beam: Beam, target: Target) -> float:
    """Distance [mm] at which the axis passes the user's own points after a sequence."""
    place, direction = beam.origin, beam.axis
    if sequence.interactions:
        traced = trace(Sequence(sequence.interactions), place[None], direction[None])
        place, direction = traced.points[-1, 0], traced.directions[0]
    offset = target.frame.to_world(target.points.points).mean(axis=0) - place
    along = max(float(offset @ direction), 0.0)
    return float(np.linalg.norm(offset - along * direction))


def _path(beam: Beam, elements: tuple[Element, ...], sequence: RaySequence) -> LightPath:
    names = tuple(elements[number].name for number, *_ in sequence.steps)
    return LightPath(beam, names, with_places(sequence.interactions, beam.origin[None], beam.axis[None]))


def drawn_light(path: LightPath) -> list[np.ndarray]:
    """World points (p, 3) of rays that show how light comes over the optics: the axis, four at the beam's radius."""
    starts, launches, _ = path.rays_around()
    ring = RINGS.index(1.0) * AROUND + np.arange(0, AROUND, AROUND // 4)
    traced = trace(Sequence(path.interactions), starts[ring], launches[ring]).points
    around = np.moveaxis(np.concatenate([starts[ring][None], traced]), 1, 0)
    return [path.corners, *(ray for ray in around if np.all(np.isfinite(ray)))]


def _require_clear(meetings: Meetings, path: LightPath, way: RaySequence, ends: list[_End], where: str) -> None:
    """SceneError where something that the light does not go through takes a part of it."""
    rims = {meetings.elements[number].name for number, *_ in way.steps}
    for end in ends:
        gone = way.steps[: len(end.sequence.steps)] != end.sequence.steps or len(end.sequence.steps) == len(way.steps)
        name = meetings.name_of(end.thing) if end.thing.kind != NOTHING else None
        if gone and name not in (None, *rims, "target"):
            raise SceneError(
                f"{where}: {name!r} cuts its light beside the way {path.label}: put an aperture with the free part as "
                "its hole there, or move it out of the light"
            )


def _cutting(path: LightPath, starts: np.ndarray, launches: np.ndarray) -> tuple[int, ...]:
    """Numbers of the interactions whose outlines cut rays of the light (n, 3)."""
    if not path.interactions:
        return ()
    sequence = Sequence(path.interactions)
    outside = np.any(trace(sequence, starts, launches).margins < 0, axis=1)
    return tuple(dict.fromkeys(number for (number, _), cut in zip(sequence.rims, outside, strict=True) if cut))


def _name(meetings: Meetings, thing: Thing) -> str:
    return "nothing, past all that stands there" if thing.kind == NOTHING else repr(meetings.name_of(thing))
