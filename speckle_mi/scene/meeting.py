"""What a ray meets next: exact crossings with the analytic faces of all elements, in float64.

The order along a ray is that of its distances, which are exact to a hundredth of a nanometre: gaps of any width count,
none included. Where two crossings coincide, glass comes before air on the way out and air before glass on the way in.
Only opaque shapes and the target, whose forms may be anything, are asked of Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.frames import Frame
from ..geometry.plane import PlaneGrid
from ..optics.edge import edge_crossing
from ..optics.surface import Surface
from .assembly import Target
from .elements import OUTSIDE, Element
from .tracer import TARGET, Tracer

COINCIDENT = 1e-8
"""Distance [mm] up to which two crossings are one."""

NOTHING, DETECTOR, WALL = "nothing", "detector", "wall"
FACE, HOLE, SCREEN, OPAQUE = "face", "hole", "screen", "opaque"

Place = tuple[int, int]
"""What light is in: numbers of an element and of the medium in it."""

AIR: Place = (-1, OUTSIDE)
"""What a ray is in that is in no element."""


@dataclass(frozen=True)
class Met:
    """What n rays meet next.

    distance: (n,) [mm], inf for nothing; thing: (n,) index into ``Meetings.things``; root: (n,) which of the two
    crossings of a closed face it is, 0 the nearer one along the line.
    """

    distance: np.ndarray
    thing: np.ndarray
    root: np.ndarray


@dataclass(frozen=True)
class Thing:
    """Something that a ray can meet: kind, number of its element (``TARGET`` for the target), and which face of it."""

    kind: str
    element: int = -9
    face: int = -1


class Meetings:
    """All that rays can meet. things: in the order in which they are tried where distances are equal."""

    def __init__(
        self, elements: tuple[Element, ...], target: Target, frame: Frame, tracer: Tracer,
        detector: PlaneGrid | None = None,
    ) -> None:  # fmt: skip
        """frame: where the target stands; tracer: of these elements and target; detector: None for light that none
        stops."""
        self.elements, self.detector = elements, detector
        self._target, self._frame, self._tracer = target, frame, tracer
        self.things = [Thing(NOTHING), Thing(DETECTOR), Thing(OPAQUE, TARGET)]
        self._opaque = tuple(n for n, element in enumerate(self.elements) if element.kind == "opaque")
        self.things += [Thing(OPAQUE, number) for number in self._opaque]
        for number, element in enumerate(self.elements):
            if element.kind == "opening":
                self.things += [Thing(HOLE, number, 0), Thing(SCREEN, number, 0)]
            for face in range(len(element.faces) if element.kind in ("mirror", "glass") else 0):
                self.things.append(Thing(FACE, number, face))
            if element.edged:
                self.things.append(Thing(WALL, number))
        self._index = {thing: place for place, thing in enumerate(self.things)}
        self._partners = _coincident_faces(self.elements)

    def name_of(self, thing: Thing) -> str:
        """How messages call a thing."""
        return "target" if thing.element == TARGET else self.elements[thing.element].name

    def partner(self, number: int, face: int) -> tuple[int, int] | None:
        """The face of another glass that touches a face all over, as in a cemented pair."""
        return self._partners.get((number, face))

    def behind(self, face: tuple[int, int]) -> Place:
        """What light from outside comes into through a face of glass."""
        number, place = face
        return number, self.elements[number].beyond(place, OUTSIDE)

    def index_in(self, inside: Place) -> float:
        """Refractive index of what light is in."""
        return index_in(self.elements, inside)

    def passes_detector(self, places: np.ndarray, directions: np.ndarray) -> bool:
        """Whether any ray crosses the detector's plane from its front."""
        if self.detector is None:
            return False
        distance, _ = detector_crossing(self.detector, places, directions)
        return bool(np.any(np.isfinite(distance) & (distance > 0)))

    def next(self, origin: np.ndarray, direction: np.ndarray, inside: Place, left: tuple[int, int] | None) -> Met:
        """What rays from origins (n, 3) along unit directions (n, 3) meet next.

        inside: what all are in; left: element and face that they have just left.
        """
        count = len(origin)
        met = Met(np.full(count, np.inf), np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64))
        if not count:
            return met
        if inside == AIR:
            self._air(met, origin, direction, left)
        else:
            self._glass(met, origin, direction, inside, left)
        return met

    def _glass(self, met: Met, origin, direction, inside: Place, left) -> None:
        """Inside a medium the faces around it come first, then openings that it encloses."""
        number, medium = inside
        for face, sides in enumerate(self.elements[number].sides):
            if medium in sides:
                self._face(met, origin, direction, number, face, left, outside=False)
        for number, element in enumerate(self.elements):
            if element.kind == "opening":
                self._opening(met, origin, direction, number, left, strictly=True)

    def _air(self, met: Met, origin, direction, left) -> None:
        for number, element in enumerate(self.elements):
            if element.kind == "opening":
                self._opening(met, origin, direction, number, left, strictly=False)
        if self.detector is not None:
            self._detector(met, origin, direction)
        for number, element in enumerate(self.elements):
            if element.kind in ("mirror", "glass"):
                for face in range(len(element.faces)):
                    if element.kind == "mirror" or OUTSIDE in element.sides[face]:
                        self._face(met, origin, direction, number, face, left, outside=True)
            if element.edged and (left is None or left[0] != number):
                distance = edge_crossing(element.faces, origin, direction, COINCIDENT)
                self._take(met, distance, Thing(WALL, number))
        if self._opaque:
            numbers, distance = self._tracer.nearest_opaque(origin, direction)
            for number in self._opaque:
                self._take(met, np.where(numbers == number, distance, np.inf), Thing(OPAQUE, number))
        if self._target.points is None:
            distance = self._tracer.nearest_target(origin, direction, self._frame)
            self._take(met, distance, Thing(OPAQUE, TARGET))

    def _take(self, met: Met, distance: np.ndarray, thing: Thing, root: np.ndarray | int = 0) -> None:
        """Notes a thing where it is nearer than everything before, by more than what counts as one place."""
        nearer = distance < met.distance - COINCIDENT
        met.distance[nearer] = distance[nearer]
        met.thing[nearer] = self._index[thing]
        met.root[nearer] = np.broadcast_to(root, nearer.shape)[nearer]

    def _face(self, met: Met, origin, direction, number: int, face: int, left, outside: bool) -> None:
        element = self.elements[number]
        surface = element.faces[face]
        lengths = _crossings(surface, element.closed, origin, direction)
        least = COINCIDENT if left == (number, face) else -COINCIDENT
        leaving = np.zeros(len(origin), dtype=bool)
        if outside and element.kind == "glass" and not element.closed:
            # From a stop that lies on a glass light goes away from it, or into it, whatever the rounding of nothing.
            leaving = direction @ _inward(element, face) <= 0
        for root in range(len(lengths)):
            ahead = lengths[root] > np.where(leaving, COINCIDENT, least)  # NaN is not larger
            distance = np.where(ahead, lengths[root], np.inf)
            self._take(met, distance, Thing(FACE, number, face), root)

    def _opening(self, met: Met, origin, direction, number: int, left, strictly: bool) -> None:
        if left == (number, 0):
            return
        element = self.elements[number]
        distance, in_hole, on_screen = screen_crossing(element, origin, direction)
        # In glass a screen on the face that light leaves by stands in the air behind it.
        limit = met.distance - COINCIDENT if strictly else np.inf
        met_here = (distance > (COINCIDENT if strictly else -COINCIDENT)) & (distance < limit)
        self._take(met, np.where(met_here & in_hole, distance, np.inf), Thing(HOLE, number, 0))
        self._take(met, np.where(met_here & on_screen, distance, np.inf), Thing(SCREEN, number, 0))

    def _detector(self, met: Met, origin, direction) -> None:
        distance, inside = detector_crossing(self.detector, origin, direction)
        self._take(met, np.where(inside & (distance >= -COINCIDENT), distance, np.inf), Thing(DETECTOR))


def screen_crossing(
    element: Element, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance (n,) [mm] to the plane of an opening's screen; whether it is crossed in the hole; or on the screen."""
    face = element.faces[0]
    local, slope = face.frame.to_local(origin), direction @ face.frame.axes
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -local[:, 2] / slope[:, 2]
        x, y = (local[:, k] + distance * slope[:, k] for k in (0, 1))
        hole = np.all(face.outline.margins(x, y) >= 0, axis=0)
        screen = np.hypot(x, y) <= element.screen_radius
    return np.where(np.isfinite(distance), distance, np.inf), hole, screen & ~hole


def detector_crossing(grid: PlaneGrid, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) [mm] to the detector's plane along rays that come from its front, else inf; whether in its area."""
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = direction @ grid.normal
        distance = (grid.centre - origin) @ grid.normal / slope
        hit = origin + distance[:, None] * direction - grid.centre
        half_u, half_v = grid.half_size
        inside = (np.abs(hit @ grid.u) <= half_u) & (np.abs(hit @ grid.v) <= half_v)
    reached = (slope < 0) & np.isfinite(distance)
    return np.where(reached, distance, np.inf), reached & inside


def stands_between(element: Element, start: np.ndarray, direction: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Whether an element with analytic faces is met between the ends of segments, these not included, (n,).

    start, direction: (n, 3), directions of unit length; distance: (n,) [mm] to the other end. A segment through a hole
    counts, too: that is a way of its own.
    """

    def within(length: np.ndarray) -> np.ndarray:
        return (length > COINCIDENT) & (length < distance - COINCIDENT)

    if element.kind == "opening":
        length, in_hole, on_screen = screen_crossing(element, start, direction)
        return within(length) & (in_hole | on_screen)
    between = np.zeros(len(start), dtype=bool)
    for face in element.faces:
        between |= np.any(within(_crossings(face, element.closed, start, direction)), axis=0)
    return between | within(edge_crossing(element.faces, start, direction, COINCIDENT)) if element.edged else between


def _crossings(surface: Surface, closed: bool, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Distances (r, n) [mm] at which lines meet a face inside its rim, rising; NaN where they do not."""
    local, along = surface.frame.to_local(origin).T, (direction @ surface.frame.axes).T
    if not surface.is_plane:
        return surface.crossings(local, along, closed)[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        length = -local[2] / along[2]
        x, y = local[:2] + length * along[:2]
        outside = np.any(surface.outline.margins(x, y) < 0, axis=0) if surface.outline else False
    return np.where(np.isfinite(length) & ~outside, length, np.nan)[None]


def _coincident_faces(elements: tuple[Element, ...]) -> dict[tuple[int, int], tuple[int, int]]:
    """Faces of glasses that are the same surface as a face of another glass, each with that one."""
    faces = [(number, face) for number, element in enumerate(elements) if element.media and not element.closed
             for face in range(len(element.faces)) if OUTSIDE in element.sides[face]]  # fmt: skip
    found = {}
    for one in faces:
        for other in faces:
            if one[0] != other[0] and _same_surface(elements[one[0]].faces[one[1]], elements[other[0]].faces[other[1]]):
                found[one] = other
    return found


def _same_surface(one: Surface, other: Surface) -> bool:
    """Whether two faces lie in each other, whichever way their frames are turned about the axis."""
    offset = other.frame.origin - one.frame.origin
    cosine = float(one.frame.axes[:, 2] @ other.frame.axes[:, 2])
    reach = min(one.outline.reach, other.outline.reach)
    if abs(abs(cosine) - 1) > (COINCIDENT / reach) ** 2 / 2 + 1e-15 or abs(offset @ one.frame.axes[:, 2]) > COINCIDENT:
        return False
    if one.is_plane and other.is_plane:
        return True
    if not one.has_flat_rim and abs(abs(one.frame.axes[:, 0] @ other.frame.axes[:, 0]) - 1) > 1e-15:
        return False
    same_form = one.same_form(other if cosine > 0 else other.turned(), reach, COINCIDENT)
    return same_form and np.linalg.norm(offset) < COINCIDENT


def _inward(element: Element, face: int) -> np.ndarray:
    """(3,) along a face's axis into the glass, which lies between its faces."""
    axis = element.faces[face].frame.axes[:, 2]
    middle = np.mean([one.frame.origin for one in element.faces], axis=0)
    return axis if (middle - element.faces[face].frame.origin) @ axis > 0 else -axis


def index_in(elements: tuple[Element, ...], inside: Place) -> float:
    """Refractive index of what light is in, relative to the medium around everything."""
    return 1.0 if inside == AIR else elements[inside[0]].index_of(inside[1])
