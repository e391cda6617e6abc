"""The ways of the light from one place to the next opening or to the detector, over mirrors and through glasses.

A way is a sequence of faces. Rays are followed from the start towards every face; what they meet makes sequences. From
each sequence every other face, every opening and the detector is *aimed* at, so that a way need not be hit by chance:
what test rays propose is only where the search begins. A ray that has been aimed is followed through all that stands in
the setup again, which alone decides whether its way is free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.pairs import all_pairs
from ..optics.aim import aim, rays_between
from ..optics.placed import with_places
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.surface import Surface
from ..optics.trace import RayStatus, trace
from ..scene.following import Follower, RaySequence, Start, Step
from ..scene.meeting import AIR, Meetings, Place
from .places import on_face, on_pixels, plane_at
from .sight import SPREAD, in_sight
from .unfolding import launch_over_planes

_ACROSS = 7
"""Places a side on a face that rays are sent to."""

SAME_RAY = 1e-6
"""Angle [rad] up to which two rays to one place are the same."""

_SHARED = 3
"""Places of a start that share the places on faces among them."""

_AIMED = 3
"""Rounds in which the middle of a narrow way is closed in on."""


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


class Search(Follower):
    """Everything that light from one start can do up to the next opening or the detector.

    chains: the ways found; stopped: how many rays each element ended; beside: sequences that pass the detector by.
    """

    def __init__(self, meetings: Meetings, start: Start) -> None:
        super().__init__(meetings, start)
        self._grid = meetings.detector
        self._send(start.points, self._first_targets())
        while self._waiting:
            self._aim_from(self._waiting.pop(0))

    @property
    def goes_on(self) -> bool:
        """Whether ways to the detector go on over more surfaces than are looked into."""
        ends = [len(steps) for steps, end, _ in self.arrived if end is None]
        return self.given_up and max(ends, default=0) >= max(map(len, self.sequences)) - 2

    def chains(self) -> list[Chain]:
        """The ways that were found, those of most rays first."""
        found = []
        for (steps, end, side), rays in self.arrived.items():
            sequence = self.sequences[steps]
            starts, launches = (np.concatenate(part) for part in zip(*rays, strict=True))
            interactions = with_places(sequence.interactions, starts, launches)
            found.append(Chain(steps, interactions, end, side, sequence.inside, starts, launches))
        return sorted(found, key=lambda chain: -chain.rays)

    def beside(self) -> list[Chain]:
        """Ways over at least one face on which rays cross the detector's plane beside its area."""
        return [
            Chain(s.steps, with_places(s.interactions, *self._rays_of(s)), None, 0, s.inside, *self._rays_of(s))
            for s in self.sequences.values()
            if s.passes_detector and s.steps
        ]

    def _send(self, points: np.ndarray, targets: np.ndarray) -> None:
        """Follows rays from the first of points (m, 3) towards every target (k, 3), from the others to a part each."""
        starts, ends = all_pairs(points, targets)
        source, target = np.divmod(np.arange(len(starts)), len(targets))
        sent = (source == 0) | ((target + source) % _SHARED == 0)
        self.follow(starts[sent], (ends - starts)[sent])

    # Aiming

    def _first_targets(self) -> np.ndarray:
        """Places (k, 3) on every face, opening and body, and on the detector."""
        side = np.linspace(-0.97, 0.97, _ACROSS)
        share = np.stack([part.ravel() for part in np.meshgrid(side, side)], axis=1)
        places = [on_pixels(self._grid, share)]
        for element in self.meetings.elements:
            places += [on_face(face, element.closed, share) for face in element.faces]
            places.append(element.body.bounds.mean(axis=0, keepdims=True))
        return np.concatenate(places)

    def _aim_from(self, sequence: RaySequence) -> None:
        """Aims at everything that the rays of a sequence have not met by themselves."""
        if not sequence.starts or not sequence.steps or sequence.inside != AIR:
            return  # from the start itself rays have gone to every face
        elements = self.meetings.elements
        wanted = self._seen_from(sequence) - sequence.met - {sequence.left}
        arrived = {end for steps, end, _ in self.arrived if steps == sequence.steps}
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

    def _seen_from(self, sequence: RaySequence) -> set[tuple[int, int] | None]:
        """What is in sight of the face that light over a sequence comes from, where its rays leave it or elsewhere."""
        number, place = sequence.left
        face = self.meetings.elements[number].faces[place]
        traced = trace(Sequence(sequence.interactions), *self._rays_of(sequence))
        some = np.flatnonzero(np.all(np.isfinite(traced.points[-1]), axis=1))
        hits, leaving = traced.points[-1, some], traced.directions[some]
        side = np.sign(np.median(np.sum(face.normals(hits) * leaving, axis=1)))
        hits = hits[:: max(1, len(hits) // len(SPREAD))]
        points = np.concatenate([hits, on_face(face, self.meetings.elements[number].closed, SPREAD)])
        return in_sight(self.meetings, points, side * face.normals(points), sequence.left)

    def _aim_at(self, sequence: RaySequence, plane: Surface, targets: np.ndarray) -> None:
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
                self.follow(np.broadcast_to(starts[0], launches[good].shape), launches[good])
                return
            centre = places[np.nanargmax(margin)]

    def _follow_all(self, sequence: RaySequence, plane: Surface, place: np.ndarray) -> None:
        """Follows all rays to a place (3,): of the parts of a sphere that send light there each may be the free one."""
        starts, known = self._rays_of(sequence)
        launches = rays_between(self._system(sequence, plane), starts[0], place, known, SAME_RAY)
        self.follow(np.broadcast_to(starts[0], launches.shape), launches)

    def _launches(self, sequence: RaySequence, plane: Surface, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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

    def _nearest(self, sequence: RaySequence, system: Sequence, source: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Launch directions (k, 3) of the rays over a sequence that pass closest to places (k, 3)."""
        known = self._rays_of(sequence)[1]
        landed = trace(system, np.broadcast_to(source[0], known.shape), known).points[-1]
        apart = np.linalg.norm(landed[None] - places[:, None], axis=2)
        return known[np.argmin(np.where(np.isnan(apart), np.inf, apart), axis=1)]

    def _system(self, sequence: RaySequence, plane: Surface) -> Sequence:
        """The faces of a sequence, and a plane where its light ends."""
        index = self.meetings.index_in(sequence.inside)
        placed = with_places(sequence.interactions, *self._rays_of(sequence))
        return Sequence((*placed, Interaction.through(plane, index)))

    def _rays_of(self, sequence: RaySequence) -> tuple[np.ndarray, np.ndarray]:
        return np.concatenate(sequence.starts), np.concatenate(sequence.launches)
