"""The ways of the light from one place to the next opening or to the detector, over mirrors and through glasses.

A way is a sequence of faces. Rays are followed from the start towards every face; what they meet makes sequences. From
each sequence every other face, every opening and the detector is *aimed* at, so that a way need not be hit by chance:
what test rays propose is only where the search begins. A ray that has been aimed is followed through all that stands in
the setup again, which alone decides whether its way is free.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ..geometry.pairs import all_pairs
from ..optics.aim import aim, rays_between
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.surface import Surface
from ..optics.trace import RayStatus, trace
from ..scene.elements import OUTSIDE
from .meeting import AIR, COINCIDENT, DETECTOR, FACE, HOLE, NOTHING, Meetings, Place
from .places import on_face, on_pixels, plane_at, with_places
from .sight import SPREAD, in_sight
from .unfolding import launch_over_planes

MAX_INTERACTIONS = 32
"""Rays that have not arrived after this many surfaces, or twice as many as there are, are given up."""

MOST_SEQUENCES = 400
"""Sequences of faces from one start that are looked into: facing mirrors have no end of them."""

MOST_REFLECTIONS = 2
"""Reflections one after the other at the inside of one closed mirror that are followed."""

MOST_TOTAL = 3
"""Total reflections one after the other inside a glass that are followed."""

RAYS_KEPT = 64
"""Rays of a sequence that are kept to aim from."""

_ACROSS = 7
"""Places a side on a face that rays are sent to."""

SAME_RAY = 1e-6
"""Angle [rad] up to which two rays to one place are the same."""

_SHARED = 3
"""Places of a start that share the places on faces among them."""

_AIMED = 3
"""Rounds in which the middle of a narrow way is closed in on."""

Step = tuple[int, int, str, str]
"""(element, face, action, root) of an interaction."""


@dataclass(frozen=True)
class Start:
    """Where rays begin: points (m, 3) [mm], in the medium ``inside`` or in ``AIR``.

    normal: rays go only to its side, (3,), or to all sides (None); left: element and face that the points lie on.
    """

    points: np.ndarray
    inside: Place = AIR
    normal: np.ndarray | None = None
    left: tuple[int, int] | None = None


@dataclass(frozen=True)
class Chain:
    """A way from a start to an opening or the detector.

    steps, interactions: at the faces between, in order; end: number of the opening's element, or None for the detector;
    side: sign of the light's direction along the opening's normal; inside: medium that the end lies in, or ``AIR``;
    starts, launches: (n, 3) of the rays that take it.
    """

    steps: tuple[Step, ...]
    interactions: tuple[Interaction, ...]
    end: int | None
    side: int
    inside: Place
    starts: np.ndarray
    launches: np.ndarray

    @property
    def rays(self) -> int:
        return len(self.starts)


@dataclass
class _Sequence:
    """Faces that light has gone over, and rays that are known to do so."""

    steps: tuple[Step, ...]
    interactions: tuple[Interaction, ...]
    inside: Place
    left: tuple[int, int] | None
    starts: list[np.ndarray] = field(default_factory=list)
    launches: list[np.ndarray] = field(default_factory=list)
    met: set[tuple[int, int]] = field(default_factory=set)
    passes_detector: bool = False

    def note(self, starts: np.ndarray, launches: np.ndarray) -> None:
        held = sum(map(len, self.starts))
        if held < RAYS_KEPT:
            some = slice(None, None, max(1, len(starts) // (RAYS_KEPT - held)))
            self.starts.append(starts[some])
            self.launches.append(launches[some])

    @property
    def last_place(self) -> np.ndarray:
        """(3,) where its light comes from."""
        return self.interactions[-1].place

    @property
    def is_closed(self) -> bool:
        return any(interaction.root != "vertex" for interaction in self.interactions)

    @property
    def has_power(self) -> bool:
        return any(i.action == "refract" or not i.surface.is_plane for i in self.interactions)


class Search:
    """Everything that light from one start can do up to the next opening or the detector.

    chains: the ways found; stopped: how many rays each element ended; beside: sequences that pass the detector by.
    """

    def __init__(self, meetings: Meetings, start: Start) -> None:
        self._meetings, self._start = meetings, start
        self._grid = meetings.detector
        self._longest = max(MAX_INTERACTIONS, 2 * sum(len(element.faces) for element in meetings.elements))
        self.stopped: Counter = Counter()
        self._given_up = False
        self._sequences: dict[tuple[Step, ...], _Sequence] = {}
        self._arrived: dict[tuple, list[tuple[np.ndarray, np.ndarray]]] = {}
        self._waiting: list[_Sequence] = []
        self._sequence_of((), (), start.inside, start.left)
        self._send(start.points, self._first_targets())
        while self._waiting:
            self._aim_from(self._waiting.pop(0))

    @property
    def goes_on(self) -> bool:
        """Whether ways to the detector go on over more surfaces than are looked into."""
        ends = [len(steps) for steps, end, _ in self._arrived if end is None]
        return self._given_up and max(ends, default=0) >= max(map(len, self._sequences)) - 2

    def chains(self) -> list[Chain]:
        """The ways that were found, those of most rays first."""
        found = []
        for (steps, end, side), rays in self._arrived.items():
            sequence = self._sequences[steps]
            starts, launches = (np.concatenate(part) for part in zip(*rays, strict=True))
            interactions = with_places(sequence.interactions, starts, launches)
            found.append(Chain(steps, interactions, end, side, sequence.inside, starts, launches))
        return sorted(found, key=lambda chain: -chain.rays)

    def beside(self) -> list[Chain]:
        """Ways over at least one face on which rays cross the detector's plane beside its area."""
        return [
            Chain(s.steps, with_places(s.interactions, *self._rays_of(s)), None, 0, s.inside, *self._rays_of(s))
            for s in self._sequences.values()
            if s.passes_detector and s.steps
        ]

    # Following

    def _send(self, points: np.ndarray, targets: np.ndarray) -> None:
        """Follows rays from the first of points (m, 3) towards every target (k, 3), from the others to a part each."""
        starts, ends = all_pairs(points, targets)
        source, target = np.divmod(np.arange(len(starts)), len(targets))
        sent = (source == 0) | ((target + source) % _SHARED == 0)
        self._follow(starts[sent], (ends - starts)[sent])

    def _follow(self, starts: np.ndarray, launches: np.ndarray) -> None:
        """Follows rays to their ends, noting every sequence that they take."""
        length = np.linalg.norm(launches, axis=1)
        keep = length > 0
        if self._start.normal is not None:
            keep &= launches @ self._start.normal > 0
        starts, launches = starts[keep], launches[keep] / length[keep, None]
        root = self._sequences[()]
        waiting = [(root, starts, launches, starts, launches)]
        for _ in range(self._longest):
            waiting = [further for bundle in waiting for further in self._advance(*bundle)]
            if not waiting:
                return

    def _advance(self, sequence: _Sequence, starts, launches, places, directions) -> Iterator[tuple]:
        """Takes rays of one sequence to what they meet next; gives those that go on, by their longer sequences."""
        if not len(starts):
            return
        sequence.note(starts, launches)
        met = self._meetings.next(places, directions, sequence.inside, sequence.left)
        for place in np.unique(met.thing):
            thing, one = self._meetings.things[place], met.thing == place
            rays = starts[one], launches[one]
            if thing.kind == FACE:
                sequence.met.add((thing.element, thing.face))
                for root in np.unique(met.root[one]):
                    some = one & (met.root == root)
                    bundle = starts[some], launches[some], places[some], directions[some], met.distance[some]
                    yield from self._meet(sequence, thing.element, thing.face, int(root), *bundle)
            elif thing.kind == HOLE:
                normal = self._meetings.elements[thing.element].faces[0].frame.axes[:, 2]
                slope = directions[one] @ normal
                for side in (-1, 1):
                    chosen = np.sign(slope) == side
                    if np.any(chosen):
                        self._arrive(sequence, thing.element, side, *(part[chosen] for part in rays))
            elif thing.kind == DETECTOR:
                self._arrive(sequence, None, 0, *rays)
            elif thing.kind == NOTHING:
                sequence.passes_detector |= self._meetings.passes_detector(places[one], directions[one])
                self.stopped[NOTHING] += int(np.count_nonzero(one))
            else:
                self.stopped[self._meetings.name_of(thing)] += int(np.count_nonzero(one))

    def _meet(self, sequence: _Sequence, number: int, face: int, root: int, starts, launches, places, directions,
              distance) -> Iterator[tuple]:  # fmt: skip
        """One face acts on rays: refraction, reflection, or the end."""
        element = self._meetings.elements[number]
        within = sequence.inside[0] == number
        interaction = self._interaction(
            element, face, sequence.inside[1] if within else OUTSIDE, root, places, directions, distance
        )
        inside, left = sequence.inside, (number, face)
        if interaction.action == "refract":
            beyond = element.beyond(face, sequence.inside[1] if within else OUTSIDE)
            inside = AIR if beyond == OUTSIDE else (number, beyond)
            partner = self._meetings.partner(number, face) if within and beyond == OUTSIDE else None
            if partner is not None:
                left, inside = partner, self._meetings.behind(partner)
                interaction = replace(interaction, index_after=self._meetings.index_in(inside))
        result = trace(Sequence((interaction,)), places, directions)
        total = result.status == RayStatus.TOTAL_INTERNAL_REFLECTION
        good = result.valid & (
            np.abs(result.optical_path_length / interaction.index_before - distance) < 1e3 * COINCIDENT
        )
        self.stopped[element.name] += int(np.count_nonzero(~good & ~total))
        mirrored = Interaction.reflect(interaction.surface, interaction.index_before, interaction.root)
        for chosen, what, to in ((good, interaction, inside), (total, mirrored, sequence.inside)):
            if not np.any(chosen):
                continue
            step = (number, face, what.action, what.root)
            after = result if what is interaction else trace(Sequence((what,)), places, directions)
            longer = self._sequence_of((*sequence.steps, step), (*sequence.interactions, what), to,
                                       left if what is interaction else (number, face))  # fmt: skip
            if longer is not None:
                yield longer, starts[chosen], launches[chosen], after.points[0, chosen], after.directions[chosen]

    def _interaction(self, element, face: int, medium: int, root: int, places, directions, distance) -> Interaction:
        """A face's interaction with the crossing at which rays really meet it."""
        interaction = element.interaction(face, medium, root)
        surface = interaction.surface
        if element.closed or surface.is_plane or not surface.is_closed:
            return interaction
        local, along = surface.frame.to_local(places).T, (directions @ surface.frame.axes).T
        length, _ = surface.intersect(local, along, interaction.root)
        agree = np.abs(length - distance) < 1e3 * COINCIDENT
        return (
            interaction
            if 2 * np.count_nonzero(agree) >= len(agree)
            else replace(interaction, root=("near", "far")[root])
        )

    def _sequence_of(self, steps, interactions, inside: Place, left) -> _Sequence | None:
        """The sequence of these steps; None where it is not looked into any more."""
        if steps not in self._sequences:
            if len(self._sequences) >= MOST_SEQUENCES or len(steps) >= self._longest:
                self._given_up = True
                return None
            if self._bounces(steps) or self._is_trapped(interactions):
                return None
            self._sequences[steps] = _Sequence(steps, interactions, inside, left)
            self._waiting.append(self._sequences[steps])
        return self._sequences[steps]

    def _bounces(self, steps: tuple[Step, ...]) -> bool:
        """Whether light goes to and fro inside one closed mirror."""
        if len(steps) <= MOST_REFLECTIONS:
            return False
        number, *_ = steps[-1]
        closed = self._meetings.elements[number].closed and self._meetings.elements[number].kind == "mirror"
        return closed and all(step[0] == number for step in steps[-MOST_REFLECTIONS - 1 :])

    @staticmethod
    def _is_trapped(interactions: tuple[Interaction, ...]) -> bool:
        """Whether light has been totally reflected inside a glass more often than is followed."""
        last = interactions[-MOST_TOTAL - 1 :]
        return len(last) > MOST_TOTAL and all(interaction.reflects_inside for interaction in last)

    def _arrive(self, sequence: _Sequence, end: int | None, side: int, starts, launches) -> None:
        self._arrived.setdefault((sequence.steps, end, side), []).append((starts, launches))

    # Aiming

    def _first_targets(self) -> np.ndarray:
        """Places (k, 3) on every face, opening and body, and on the detector."""
        side = np.linspace(-0.97, 0.97, _ACROSS)
        share = np.stack([part.ravel() for part in np.meshgrid(side, side)], axis=1)
        places = [on_pixels(self._grid, share)]
        for element in self._meetings.elements:
            places += [on_face(face, element.closed, share) for face in element.faces]
            places.append(element.body.bounds.mean(axis=0, keepdims=True))
        return np.concatenate(places)

    def _aim_from(self, sequence: _Sequence) -> None:
        """Aims at everything that the rays of a sequence have not met by themselves."""
        if not sequence.starts or not sequence.steps or sequence.inside != AIR:
            return  # from the start itself rays have gone to every face
        elements = self._meetings.elements
        wanted = self._seen_from(sequence) - sequence.met - {sequence.left}
        arrived = {end for steps, end, _ in self._arrived if steps == sequence.steps}
        if None not in arrived and None in wanted:
            self._aim_at(sequence, detector_plane(self._grid).surface, on_pixels(self._grid, SPREAD))
        for number, element in enumerate(elements):
            if element.kind == "opening" and number not in arrived and (number, 0) in wanted:
                face = element.faces[0]
                self._aim_at(sequence, face, on_face(face, False, SPREAD))
        for number, element in enumerate(elements):
            for place, face in enumerate(element.faces if element.kind in ("mirror", "glass") else ()):
                if (number, place) in wanted:
                    self._aim_at(sequence, *plane_at(face, element.closed, sequence.last_place, SPREAD))

    def _seen_from(self, sequence: _Sequence) -> set[tuple[int, int] | None]:
        """What is in sight of the face that light over a sequence comes from, where its rays leave it or elsewhere."""
        number, place = sequence.left
        face = self._meetings.elements[number].faces[place]
        traced = trace(Sequence(sequence.interactions), *self._rays_of(sequence))
        some = np.flatnonzero(np.all(np.isfinite(traced.points[-1]), axis=1))
        hits, leaving = traced.points[-1, some], traced.directions[some]
        side = np.sign(np.median(np.sum(face.normals(hits) * leaving, axis=1)))
        hits = hits[:: max(1, len(hits) // len(SPREAD))]
        points = np.concatenate([hits, on_face(face, self._meetings.elements[number].closed, SPREAD)])
        return in_sight(self._meetings, points, side * face.normals(points), sequence.left)

    def _aim_at(self, sequence: _Sequence, plane: Surface, targets: np.ndarray) -> None:
        """Follows the rays over a sequence that are aimed at targets (k, 3) in a plane, closing in on a narrow way."""
        frame = plane.frame
        centre, spread = targets[0], targets - targets[0]
        if sequence.is_closed:
            self._follow_all(sequence, plane, centre)
        for round_ in range(_AIMED):
            places = centre + spread * 0.5**round_
            launches, margin = self._launches(sequence, Surface(frame), places)
            found = np.isfinite(margin)
            if not np.any(found):
                return
            if np.any(margin[found] >= 0):
                starts, _ = self._rays_of(sequence)
                good = found & (margin >= 0)
                self._follow(np.broadcast_to(starts[0], launches[good].shape), launches[good])
                return
            centre = places[np.nanargmax(margin)]

    def _follow_all(self, sequence: _Sequence, plane: Surface, place: np.ndarray) -> None:
        """Follows all rays to a place (3,): of the parts of a sphere that send light there each may be the free one."""
        starts, known = self._rays_of(sequence)
        launches = rays_between(self._system(sequence, plane), starts[0], place, known, SAME_RAY)
        self._follow(np.broadcast_to(starts[0], launches.shape), launches)

    def _launches(self, sequence: _Sequence, plane: Surface, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Launch directions (k, 3) over a sequence to places (k, 3), and the least clearance of rims, NaN: no ray."""
        starts, _ = self._rays_of(sequence)
        source = np.broadcast_to(starts[0], places.shape)
        margin = np.full(len(places), np.nan)
        system = self._system(sequence, plane)
        if sequence.has_power:
            aimed = aim(system, source, places, self._nearest(sequence, system, source, places))
            good = aimed.converged
            margin[good] = aimed.margins[:, good].min(axis=0) if len(aimed.margins) else 1.0
            return np.nan_to_num(aimed.launch), margin
        launches = launch_over_planes(sequence.interactions, source, places)
        traced = trace(system, source, launches)
        good = traced.status <= RayStatus.OUTSIDE_OUTLINE
        margin[good] = traced.margins[:, good].min(axis=0) if len(traced.margins) else 1.0
        return launches, margin

    def _nearest(self, sequence: _Sequence, system: Sequence, source: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Launch directions (k, 3) of the rays over a sequence that pass closest to places (k, 3)."""
        known = self._rays_of(sequence)[1]
        landed = trace(system, np.broadcast_to(source[0], known.shape), known).points[-1]
        apart = np.linalg.norm(landed[None] - places[:, None], axis=2)
        return known[np.argmin(np.where(np.isnan(apart), np.inf, apart), axis=1)]

    def _system(self, sequence: _Sequence, plane: Surface) -> Sequence:
        """The faces of a sequence, and a plane where its light ends."""
        index = self._meetings.index_in(sequence.inside)
        placed = with_places(sequence.interactions, *self._rays_of(sequence))
        return Sequence((*placed, Interaction.through(plane, index)))

    def _rays_of(self, sequence: _Sequence) -> tuple[np.ndarray, np.ndarray]:
        return np.concatenate(sequence.starts), np.concatenate(sequence.launches)
