"""Rays followed through all that stands in a scene, by the sequences of faces that they take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ..optics.sequence import Interaction, Sequence
from ..optics.trace import RayStatus, trace
from .elements import OUTSIDE
from .meeting import AIR, COINCIDENT, DETECTOR, FACE, HOLE, NOTHING, Meetings, Place, Thing

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


@dataclass
class RaySequence:
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


class Follower:
    """Follows rays from one start to openings, the detector and whatever else ends them.

    sequences: of faces that light has gone over, by their steps; arrived: starts and launches (n, 3) of rays by the
    steps they took, the opening's element that they end at (None for the detector) and the sign of their direction
    along its normal; stopped: how many rays each element ended; given_up: whether ways go on that are not looked into.
    """

    def __init__(self, meetings: Meetings, start: Start) -> None:
        self.meetings, self.start = meetings, start
        self._longest = max(MAX_INTERACTIONS, 2 * sum(len(element.faces) for element in meetings.elements))
        self.stopped: Counter = Counter()
        self.given_up = False
        self.sequences: dict[tuple[Step, ...], RaySequence] = {}
        self.arrived: dict[tuple, list[tuple[np.ndarray, np.ndarray]]] = {}
        self._waiting: list[RaySequence] = []
        self._sequence_of((), (), start.inside, start.left)

    def follow(self, starts: np.ndarray, launches: np.ndarray) -> None:
        """Follows rays to their ends, noting every sequence that they take."""
        length = np.linalg.norm(launches, axis=1)
        keep = length > 0
        if self.start.normal is not None:
            keep &= launches @ self.start.normal > 0
        starts, launches = starts[keep], launches[keep] / length[keep, None]
        root = self.sequences[()]
        waiting = [(root, starts, launches, starts, launches)]
        for _ in range(self._longest):
            waiting = [further for bundle in waiting for further in self._advance(*bundle)]
            if not waiting:
                return

    def _advance(self, sequence: RaySequence, starts, launches, places, directions) -> Iterator[tuple]:
        """Takes rays of one sequence to what they meet next; gives those that go on, by their longer sequences."""
        if not len(starts):
            return
        sequence.note(starts, launches)
        met = self.meetings.next(places, directions, sequence.inside, sequence.left)
        for place in np.unique(met.thing):
            thing, one = self.meetings.things[place], met.thing == place
            rays = starts[one], launches[one]
            if thing.kind == FACE:
                sequence.met.add((thing.element, thing.face))
                for root in np.unique(met.root[one]):
                    some = one & (met.root == root)
                    bundle = starts[some], launches[some], places[some], directions[some], met.distance[some]
                    yield from self._meet(sequence, thing.element, thing.face, int(root), *bundle)
            elif thing.kind == HOLE:
                yield from self._at_hole(sequence, thing.element, rays, places[one], directions[one], met.distance[one])
            elif thing.kind == DETECTOR:
                self._arrive(sequence, None, 0, *rays)
            else:
                if thing.kind == NOTHING:
                    sequence.passes_detector |= self.meetings.passes_detector(places[one], directions[one])
                self._end(sequence, thing, *rays)

    def _at_hole(self, sequence: RaySequence, number: int, rays, places, directions, distance) -> Iterator[tuple]:
        """Rays come to an opening, where their way ends; gives those that go on."""
        slope = directions @ self.meetings.elements[number].faces[0].frame.axes[:, 2]
        for side in (-1, 1):
            chosen = np.sign(slope) == side
            if np.any(chosen):
                self._arrive(sequence, number, side, *(part[chosen] for part in rays))
        yield from ()

    def _end(self, sequence: RaySequence, thing: Thing, starts: np.ndarray, launches: np.ndarray) -> None:
        """Rays of a sequence end at something, or at nothing."""
        self.stopped[NOTHING if thing.kind == NOTHING else self.meetings.name_of(thing)] += len(starts)

    def _meet(self, sequence: RaySequence, number: int, face: int, root: int, starts, launches, places, directions,
              distance) -> Iterator[tuple]:  # fmt: skip
        """One face acts on rays: refraction, reflection, both where it splits the light, or the end."""
        element = self.meetings.elements[number]
        medium = sequence.inside[1] if sequence.inside[0] == number else OUTSIDE
        for interaction in element.interactions(face, medium, root):
            interaction = _as_met(interaction, element.closed, root, places, directions, distance)
            inside, left = sequence.inside, (number, face)
            if interaction.action == "refract":
                interaction, inside, left = self._beyond(interaction, sequence, number, face)
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

    def _beyond(
        self, interaction: Interaction, sequence: RaySequence, number: int, face: int
    ) -> tuple[Interaction, Place, tuple[int, int]]:
        """Refraction with the medium that light really comes into, that medium, and the face that it has then left."""
        within = sequence.inside[0] == number
        beyond = self.meetings.elements[number].beyond(face, sequence.inside[1] if within else OUTSIDE)
        inside = AIR if beyond == OUTSIDE else (number, beyond)
        partner = self.meetings.partner(number, face) if within and beyond == OUTSIDE else None
        if partner is None:
            return interaction, inside, (number, face)
        inside = self.meetings.behind(partner)
        return replace(interaction, index_after=self.meetings.index_in(inside)), inside, partner

    def _sequence_of(self, steps, interactions, inside: Place, left) -> RaySequence | None:
        """The sequence of these steps; None where it is not looked into any more."""
        if steps not in self.sequences:
            if len(self.sequences) >= MOST_SEQUENCES or len(steps) >= self._longest:
                self.given_up = True
                return None
            if self._bounces(steps) or self._is_trapped(interactions):
                return None
            self.sequences[steps] = RaySequence(steps, interactions, inside, left)
            self._waiting.append(self.sequences[steps])
        return self.sequences[steps]

    def _bounces(self, steps: tuple[Step, ...]) -> bool:
        """Whether light goes to and fro inside one closed mirror."""
        if len(steps) <= MOST_REFLECTIONS:
            return False
        number, *_ = steps[-1]
        closed = self.meetings.elements[number].closed and self.meetings.elements[number].kind == "mirror"
        return closed and all(step[0] == number for step in steps[-MOST_REFLECTIONS - 1 :])

    @staticmethod
    def _is_trapped(interactions: tuple[Interaction, ...]) -> bool:
        """Whether light has been totally reflected inside a glass more often than is followed."""
        last = interactions[-MOST_TOTAL - 1 :]
        return len(last) > MOST_TOTAL and all(interaction.reflects_inside for interaction in last)

    def _arrive(self, sequence: RaySequence, end: int | None, side: int, starts, launches) -> None:
        self.arrived.setdefault((sequence.steps, end, side), []).append((starts, launches))


def _as_met(interaction: Interaction, closed: bool, root: int, places, directions, distance) -> Interaction:
    """An interaction with the crossing of its surface at which rays really meet it."""
    surface = interaction.surface
    if closed or surface.is_plane or not surface.is_closed:
        return interaction
    local, along = surface.frame.to_local(places).T, (directions @ surface.frame.axes).T
    length, _ = surface.intersect(local, along, interaction.root)
    agree = np.abs(length - distance) < 1e3 * COINCIDENT
    if 2 * np.count_nonzero(agree) >= len(agree):
        return interaction
    return replace(interaction, root=("near", "far")[root])
