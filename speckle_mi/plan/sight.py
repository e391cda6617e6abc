"""What sees what: the faces, openings and the detector that straight light from given places comes to first."""

from __future__ import annotations

import numpy as np

from ..geometry.pairs import all_pairs
from ..scene.meeting import AIR, DETECTOR, FACE, HOLE, Meetings
from .places import on_face, on_pixels

SPREAD = np.array(
    [[0, 0], [0.7, 0], [-0.7, 0], [0, 0.7], [0, -0.7], [0.5, 0.5], [-0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]
)
"""Places on a face, in half sizes, that stand for it."""


_ALONG = -1e-6
"""Sine of the angle to a face from which on a line leaves it: what touches the face may lie in its plane, rounded."""


def in_sight(
    meetings: Meetings, points: np.ndarray, normals: np.ndarray, left: tuple[int, int]
) -> set[tuple[int, int] | None]:
    """(element, face) of all faces and openings, and None for the detector, that places (n, 3) in air look at.

    left: element and face that the places lie on; normals: (n, 3) unit, of that face, on the side that light leaves to.
    Lines run to ``SPREAD`` on everything that there is.
    """
    targets = [on_pixels(meetings.detector, SPREAD)]
    targets += [on_face(face, element.closed, SPREAD) for element in meetings.elements for face in element.faces]
    starts, ends = all_pairs(points, np.concatenate(targets))
    across, _ = all_pairs(normals, np.concatenate(targets))
    length = np.linalg.norm(ends - starts, axis=1)
    some = (length > 0) & (np.sum((ends - starts) * across, axis=1) >= _ALONG * length)
    met = meetings.next(starts[some], (ends - starts)[some] / length[some, None], AIR, left)
    things = (meetings.things[place] for place in np.unique(met.thing))
    return {
        None if thing.kind == DETECTOR else (thing.element, thing.face)
        for thing in things
        if thing.kind in (DETECTOR, FACE, HOLE)
    }
