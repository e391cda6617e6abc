"""Rays that show where light ends that does not reach the detector."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..optics.sequence import Sequence
from ..optics.trace import trace
from ..scene.elements import OUTSIDE
from ..scene.meeting import AIR, DETECTOR, FACE, HOLE, NOTHING, Meetings, Place, detector_crossing
from .places import on_pixels
from .setup import Setup

_MOST_STEPS = 64
"""Things met one after the other by a ray that is followed."""

_SIDES = np.array([[0.0, 0.0], [0.9, 0.0], [0.0, 0.9], [-0.9, 0.0], [0.0, -0.9]])
"""Places on the detector that rays are sent to, relative to half its sides."""


@dataclass(frozen=True)
class EndedRay:
    """points: (p, 3) of the ray from the spot [mm], world; end: name of what it ends at, None where it passes the
    detector by, on whose plane it is then drawn to its end."""

    points: np.ndarray
    end: str | None


def ended_rays(setup: Setup) -> list[EndedRay]:
    """Rays from the middle of the spot, sent to the detector and to the middle of every face, that do not arrive.

    Those that go into empty space without crossing the detector's plane from its front are left out.
    """
    meetings = setup.meetings
    start = setup.spot.point
    aims = [*on_pixels(meetings.detector, _SIDES)]
    aims += [face.middle for element in meetings.elements for face in element.faces]
    found = []
    for aim in aims:
        direction = aim - start
        length = np.linalg.norm(direction)
        if length > 0 and (setup.front is None or direction @ setup.front > 0):
            ray = _followed(meetings, start, direction / length)
            if ray is not None:
                found.append(ray)
    return found


def _followed(meetings: Meetings, start: np.ndarray, direction: np.ndarray) -> EndedRay | None:
    """One ray to its end; None where it arrives at the detector, or nowhere."""
    points, place, inside, left = [start], start[None], AIR, None
    direction = direction[None]
    for _ in range(_MOST_STEPS):
        met = meetings.next(place, direction, inside, left)
        thing = meetings.things[int(met.thing[0])]
        if thing.kind == DETECTOR:
            return None
        if thing.kind == NOTHING:
            distance, _ = detector_crossing(meetings.detector, place, direction)
            if not (np.isfinite(distance[0]) and distance[0] > 0):
                return None
            return EndedRay(np.array([*points, place[0] + distance[0] * direction[0]]), None)
        hit = place + met.distance[0] * direction
        points.append(hit[0])
        if thing.kind == HOLE:
            place, left = hit, (thing.element, 0)
            continue
        if thing.kind != FACE:
            return EndedRay(np.array(points), meetings.name_of(thing))
        after = _beyond(meetings, thing.element, thing.face, int(met.root[0]), place, direction, inside)
        if after is None:
            return EndedRay(np.array(points), meetings.name_of(thing))
        direction, inside, left = after
        place = hit
    return None


def _beyond(
    meetings: Meetings, number: int, face: int, root: int, place: np.ndarray, direction: np.ndarray, inside: Place
) -> tuple[np.ndarray, Place, tuple[int, int]] | None:
    """Direction (1, 3) behind a face, what the ray is in then and the face that it has left; None where it ends."""
    element = meetings.elements[number]
    medium = inside[1] if inside[0] == number else OUTSIDE
    interaction, beyond, left = element.interactions(face, medium, root)[0], inside, (number, face)
    if interaction.action == "refract":
        other = element.beyond(face, medium)
        beyond = AIR if other == OUTSIDE else (number, other)
        partner = meetings.partner(number, face) if medium != OUTSIDE and other == OUTSIDE else None
        if partner is not None:
            left, beyond = partner, meetings.behind(partner)
            interaction = replace(interaction, index_after=meetings.index_in(beyond))
    result = trace(Sequence((interaction,)), place, direction)
    return (result.directions, beyond, left) if result.valid[0] else None
