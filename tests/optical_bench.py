"""Scenes with elements that are built along a real chief ray, at once as Mitsuba XML and for ``reference_optics``.

A scene is a pure function of its number: ``scene(number)`` for 0 to 299. It is built along a real chief ray, element by
element, at once as Mitsuba XML and as faces and openings of ``reference_optics``; what the reference cannot tell (a focal
line in an opening, several rays, too many nodes) is drawn again. Nothing here imports the product.

Sizes run from 1 um to 100 mm, distances from 0.1 mm to 10 m. All light that reaches the detector goes the ways that the
scene states: baffles are put where there would be others, or the scene is drawn again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from reference_optics import (
    Face,
    NoReference,
    Opening,
    Places,
    Way,
    ball_faces,
    chief,
    edge_field_of,
    field_of,
    frame_along,
    lens_faces,
    rays,
    trace,
)

SEED = 20240611
"""Of all scenes; another one gives 300 other scenes of the same kinds."""

COUNT = 300
COLUMNS, ROWS, COMPARED = 24, 18, 12
"""Pixels of every detector, and on how many of them fields are compared."""

WAVELENGTHS = (405.0, 532.0, 632.8, 785.0)
CLEAR = 0.8
"""Part of a face's half-width within which the light has to stay."""

WIDEST = 10.0
"""Half-width [mm] of a detector at most, however wide the light is."""

OWN_ERROR = 1e-6
"""Largest error of the reference's sums for a scene to be used."""


@dataclass(frozen=True)
class Scene:
    """A scene file's text, its scatterers (n, 3) [mm], the pixels compared, the field there and its relative error."""

    number: int
    kind: str
    xml: str
    points: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    field: np.ndarray
    error: float
    tolerance: float
    note: str

    def write(self, folder):
        """Writes scene.xml and points.csv into a folder (a Path); the path of the scene."""
        np.savetxt(folder / "points.csv", self.points, delimiter=",", fmt="%.17g")
        path = folder / "scene.xml"
        path.write_text(self.xml)
        return path


# XML


def _matrix(origin, axes):
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = axes, origin
    numbers = " ".join(repr(float(x)) for x in m.ravel())
    return f'<transform name="to_world"><matrix value="{numbers}"/></transform>'


def _floats(**values):
    return "".join(f'<float name="{k}" value="{float(v)!r}"/>' for k, v in values.items())


def _shape(kind, name, origin, axes, inside="", scale=(1.0, 1.0, 1.0), **values):
    placed = _matrix(origin, np.asarray(axes) * np.asarray(scale, float))
    return f'<shape type="{kind}" id="{name}">{placed}{_floats(**values)}{inside}</shape>'


_CONDUCTOR = '<bsdf type="twosided"><bsdf type="conductor"/></bsdf>'
_OPAQUE = '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>'


def _glass(inside, outside):
    return f'<bsdf type="dielectric">{_floats(int_ior=inside, ext_ior=outside)}</bsdf>'


# Building along the chief ray


def _rotation(vector):
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


@dataclass
class Bench:
    """What has been built so far: the chief ray's end and direction, XML, faces of every leg, openings, blockers."""

    rng: np.random.Generator
    source: np.ndarray
    at: np.ndarray
    d: np.ndarray
    wavelength: float
    index: float = 1.0
    xml: list = field(default_factory=list)
    legs: list = field(default_factory=lambda: [[]])
    openings: list = field(default_factory=list)
    planes: list = field(default_factory=list)
    balls: list = field(default_factory=list)
    path: list = field(default_factory=list)
    notes: list = field(default_factory=list)
    distance: float = 0.0
    extra_error: float = 0.0
    beside: float = 0.0

    def name(self, kind):
        return f"{kind}{len(self.xml)}"

    def log(self, low, high):
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def between(self, low, high):
        return float(self.rng.uniform(low, high))

    def pick(self, *choices):
        return choices[int(self.rng.integers(len(choices)))]

    def go(self, distance):
        self.path.append((self.at, self.at + distance * self.d))
        self.at = self.at + distance * self.d
        self.distance += distance

    def axes(self, tilt=0.0, turn=True):
        """Axes whose z is the chief ray's direction, tilted by up to ``tilt`` [deg] and turned about it."""
        base = frame_along(self.d, self.rng.normal(size=3))
        return _rotation(np.radians(tilt) * self.rng.uniform(-1, 1, 3)) @ base

    def _meet(self, faces):
        """The chief ray goes on over faces."""
        start = self.at - 1e-9 * self.d
        p, d, _, history = trace(start[None], self.d[None], faces)
        if not np.isfinite(p).all():
            raise NoReference("the chief ray misses a face")
        for _, q, _ in history:
            self.path.append((self.path[-1][1] if self.path else self.at, q[0]))
        self.at, self.d = p[0], d[0]
        self.legs[-1] += faces

    def opening(self, half, tilt=0.0, decentre=0.0, outer=None, axes=None):
        """A hole whose middle lies ``decentre`` half-widths beside the chief ray."""
        axes = self.axes(tilt) if axes is None else axes
        shift = decentre * min(half) * self.rng.uniform(-1, 1, 2) / np.sqrt(2)
        centre = self.at + axes[:, :2] @ shift
        outer = max(10.0, 10 * float(np.hypot(*half) if len(half) > 1 else half[0])) if outer is None else outer
        if len(half) == 1:
            size, form = _floats(radius=half[0], outer_radius=outer), "circle"
        else:
            size, form = _floats(width=2 * half[0], height=2 * half[1], outer_radius=outer), "rectangle"
        self.xml.append(_shape("aperture", self.name("stop"), centre, axes,
                               f'<string name="shape" value="{form}"/>{size}'))
        face = Face(centre, axes, before=self.index, after=self.index)
        self.openings.append(Opening(face, tuple(half)))
        self.planes.append((centre, axes, (outer,), tuple(half)))
        self.legs.append([])
        # Onwards from the middle of the hole, as the light that comes through it does.
        if self.legs[-2]:
            first = chief(self.source, self.legs[-2], face) if len(self.openings) == 1 else None
            if first is not None:
                _, self.d, _, _ = (x[0] if i < 2 else x for i, x in enumerate(
                    trace(self.source[None], first[None], [*self.legs[-2], face])))
        elif len(self.openings) == 1:
            self.d = (centre - self.source) / np.linalg.norm(centre - self.source)
        self.at = centre

    def plane_mirror(self, d_out, half, off):
        """A plane mirror that turns the chief ray to ``d_out``; its middle lies ``off`` (2,) beside where it is hit."""
        n = d_out - self.d
        axes = frame_along(n, self.rng.normal(size=3))
        centre = self.at + axes[:, :2] @ np.asarray(off)
        self.xml.append(_shape("rectangle", self.name("mirror"), centre, axes, _CONDUCTOR, (half, half, 1)))
        self.planes.append((centre, axes, (half, half), None))
        self._meet([Face(centre, axes, before=self.index, after=None, reach=CLEAR * half)])

    def conductor_sphere(self, d_out, radius):
        """The outside of a sphere of metal."""
        n = (d_out - self.d) / np.linalg.norm(d_out - self.d)
        centre = self.at - radius * n
        self.xml.append(_shape("sphere", self.name("sphere"), centre, np.eye(3), _CONDUCTOR, (radius,) * 3))
        self.balls.append((centre, radius))
        self._meet([Face(centre + radius * n, frame_along(-n), 1 / radius, 0.0, self.index, None, 0.9 * radius)])

    def curved_mirror(self, d_out, radius, conic, diameter, off_axis=0.0, decentre=(0.0, 0.0), flip=False):
        """A `mirror` that is met at ``off_axis`` (+ decentre) of its parent and turns the chief ray to ``d_out``."""
        n = (d_out - self.d) / np.linalg.norm(d_out - self.d)
        place = np.array([off_axis + decentre[0], decentre[1]])
        local = Face(np.zeros(3), np.eye(3), 1 / radius, conic)
        x = local.points(place[None])[0]
        if not np.isfinite(x).all():
            raise NoReference("the mirror does not reach so far")
        m = local.normals(x[None])[0]
        axes = frame_along(n, self.rng.normal(size=3)) @ frame_along(m).T
        vertex = self.at - axes @ x
        sign = 1.0
        if flip:
            axes, sign = axes @ np.diag([1.0, -1.0, -1.0]), -1.0
        values = {"radius": sign * radius, "conic": conic, "diameter": diameter}
        if off_axis:
            values["off_axis"] = off_axis
        self.xml.append(_shape("mirror", self.name("mirror"), vertex, axes, **values))
        face = Face(vertex, axes, sign / radius, conic, self.index, None, CLEAR * diameter / 2, (off_axis, 0.0))
        centre = face.points(np.array([[off_axis, 0.0]]))[0]
        self.planes.append((centre, axes, (diameter / 2,), None))
        self._meet([face])

    def lens(self, r1, r2, t, diameter, index, tilt=0.0, decentre=(0.0, 0.0), axes=None, conic1=0.0, conic2=0.0,
             front=None, meet=True):
        """A lens whose front vertex lies where the chief ray ends, or ``front`` in given axes. Its axes."""
        axes = self.axes(tilt) if axes is None else axes
        vertex = (self.at if front is None else front) + axes[:, :2] @ np.asarray(decentre)
        self.xml.append(_shape("lens", self.name("lens"), vertex, axes, radius1=r1, radius2=r2, conic1=conic1,
                               conic2=conic2, thickness=t, diameter=diameter, ior=index))
        self.planes.append((vertex + t / 2 * axes[:, 2], axes, (diameter / 2,), None))
        faces = lens_faces(vertex, axes, r1, r2, t, index, conic1, conic2, reach=CLEAR * diameter / 2)
        _require_lens(r1, r2, t, diameter, conic1, conic2)
        if meet:
            self._meet(faces)
        return vertex, axes, faces

    def ball(self, radius, index, outside, beside=(0.0, 0.0)):
        axes = self.axes()
        centre = self.at + radius * self.d + axes[:, :2] @ np.asarray(beside)
        self.xml.append(_shape("sphere", self.name("ball"), centre, np.eye(3), _glass(index, outside), (radius,) * 3))
        self.balls.append((centre, radius))
        self._meet(ball_faces(centre, radius, self.d, index, outside))

    def plate(self, thickness, half, index, tilt=0.0, outside=1.0, axes=None, middle=None):
        """A plane-parallel plate whose front face the chief ray has reached."""
        axes = self.axes(tilt) if axes is None else axes
        front = self.at if middle is None else middle
        centre = front + thickness / 2 * axes[:, 2]
        self.xml.append(_shape("cube", self.name("plate"), centre, axes, _glass(index, outside),
                               (half, half, thickness / 2)))
        back = front + thickness * axes[:, 2]
        self._meet([Face(front, axes, 0.0, 0.0, outside, index, CLEAR * half),
                    Face(back, axes, 0.0, 0.0, index, outside, CLEAR * half)])

    def baffle(self, centre, normal, half):
        axes = frame_along(normal)
        self.xml.append(_shape("rectangle", self.name("baffle"), centre, axes, _OPAQUE, (half, half, 1)))
        self.planes.append((np.asarray(centre, float), axes, (half, half), None))

    def turned(self, low, high):
        """A direction at ``low`` to ``high`` [deg] from the chief ray."""
        angle, azimuth = np.radians(self.between(low, high)), self.between(0, 2 * np.pi)
        axes = frame_along(self.d)
        return axes @ [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]


def _require_lens(r1, r2, t, diameter, conic1, conic2):
    """NoReference where the two faces of a lens meet within its diameter."""
    a = diameter / 2

    def sag(r, k):
        if not r:
            return 0.0
        square = 1 - (1 + k) * a * a / (r * r)
        if square <= 0.05:
            raise NoReference("the lens is wider than its face")
        return a * a / r / (1 + np.sqrt(square))

    if t + sag(r2, conic2) - sag(r1, conic1) < 0.05 * t:
        raise NoReference("the lens has no edge")


# Blockers


def _crosses(p, q, plane):
    """Whether the open segments p to q (3,) meet a screen (centre, axes, outer half, hole)."""
    centre, axes, outer, hole = plane
    a, b = (p - centre) @ axes, (q - centre) @ axes
    if a[2] * b[2] >= 0 or min(abs(a[2]), abs(b[2])) < 1e-6 * max(abs(a[2]), abs(b[2])):
        return False
    s = a[2] / (a[2] - b[2])
    x = (a + s * (b - a))[:2]
    inside = np.hypot(*x) < outer[0] if len(outer) == 1 else np.all(np.abs(x) < outer)
    if hole is not None:
        inside = inside and not (np.hypot(*x) < hole[0] if len(hole) == 1 else np.all(np.abs(x) < hole))
    return bool(inside)


def _through_ball(p, q, ball):
    centre, radius = ball
    along = q - p
    s = np.clip((centre - p) @ along / (along @ along), 0, 1)
    nearest = np.linalg.norm(p + s * along - centre)
    return nearest < 0.999 * radius


def _blocked(bench, p, q):
    return any(_crosses(p, q, plane) for plane in bench.planes) or any(_through_ball(p, q, b) for b in bench.balls)


def _spread(targets):
    return np.max(np.linalg.norm(targets - targets.mean(0), axis=1))


def _shield(bench, targets, room):
    """A baffle between the source and places (m, 3) that the source must not see, clear of the chief path by ``room``."""
    middle = targets.mean(0)
    for f in bench.rng.permutation(np.linspace(0.2, 0.85, 12)):
        centre = bench.source + f * (middle - bench.source)
        normal = middle - bench.source
        half = 1.3 * f * _spread(targets) + bench.between(1.0, 1.5) * room
        screen = (centre, frame_along(normal), (half + room, half + room), None)
        if any(_crosses(p, q, screen) for p, q in bench.path if np.linalg.norm(q - p) > 0):
            continue
        if centre[2] < 1.5 * half * np.linalg.norm(normal[:2]) / np.linalg.norm(normal):
            continue
        bench.baffle(centre, normal, half)
        return
    raise NoReference("no room for a baffle")


def _stray(bench, targets, room):
    """Shields places from the source's direct light where nothing else does."""
    if not all(_blocked(bench, bench.source, t) for t in targets):
        _shield(bench, targets, room)
        if not all(_blocked(bench, bench.source, t) for t in targets):
            raise NoReference("direct light")


def _image_ray(source, faces, place):
    """Corners (k + 1, 3) of the ray over plane mirrors from a source to a place, by images. NoReference: there is none."""
    images = [source]
    for face in faces:
        n = face.axes[:, 2]
        images.append(images[-1] - 2 * ((images[-1] - face.vertex) @ n) * n)
    corners, at = [place], place
    for face, image in zip(faces[::-1], images[:0:-1], strict=True):
        local, seen = (at - face.vertex) @ face.axes, (image - face.vertex) @ face.axes
        if local[2] * seen[2] >= 0:
            raise NoReference("no ray over these mirrors")
        hit = local + local[2] / (local[2] - seen[2]) * (seen - local)
        if np.max(np.abs(hit[:2])) > face.reach:
            raise NoReference("the ray misses a mirror")
        at = face.vertex + face.axes @ [*hit[:2], 0.0]
        corners.append(at)
    return [source, *corners[:0:-1], place] if faces else [source, place]


def _corners(source, faces, place):
    if all(face.curvature == 0 for face in faces):
        return _image_ray(source, faces, place)
    goal = Face(place, frame_along(place - source))
    d = chief(source, faces, goal)
    return [source, *(h[1][0] for h in trace(source[None], d[None], [*faces, goal])[3])]


def _sequences(mirrors):
    """Orders in which light can meet one or two mirrors, up to four times (a curved one: once)."""
    if len(mirrors) < 2:
        return [mirrors]
    one, two = mirrors
    return [[one, two, one, two][i : i + n] for i in range(2) for n in range(1, 5) if i + n <= 4] + [[two, one, two, one]]


def _other_ways(bench, mirrors, wanted, places):
    """NoReference where a sequence of mirror faces other than the ``wanted`` lights one of the places."""
    for faces in _sequences(mirrors):
        if len(faces) == len(wanted) and all(a is b for a, b in zip(faces, wanted, strict=True)):
            continue
        wide = [replace(f, reach=f.reach / CLEAR * 1.1) for f in faces]
        for place in places:
            try:
                corners = _corners(bench.source, wide, place)
            except NoReference as reason:
                if "several" in str(reason):
                    raise
                continue
            if not any(_blocked(bench, p, q) for p, q in zip(corners, corners[1:], strict=False)):
                raise NoReference("another way")


# The detector at the end


def _light_at(bench, faces_after, plane):
    """Half-width [mm] of the light at a plane: the least of all openings' geometric shadows, or their diffraction."""
    k = 2 * np.pi / bench.wavelength
    narrow, wide = np.inf, 0.0
    for j, opening in enumerate(bench.openings):
        before = [f for leg in bench.legs[: j + 1] for f in leg]
        behind = [f for leg in bench.legs[j + 1 :] for f in leg]
        rim = opening.samples()
        refracting = opening.face.after is not None and opening.face.after != opening.face.before
        first = chief(bench.source, before, opening.face)
        found = rays(np.tile(bench.source, (len(rim), 1)), before, opening.face, rim, np.tile(first, (len(rim), 1)))
        middle = [opening.face] if refracting else []
        p, _, length, _ = trace(np.tile(bench.source, (len(rim), 1)), found.direction,
                                [*before, *middle, *behind, plane])
        if not np.isfinite(p).all():
            raise NoReference("light of the rim gets lost")
        narrow = min(narrow, np.max(np.linalg.norm(p - p[0], axis=1)))
        onward = max(float(length[0] - found.length[0]), 1e-3)
        wide = max(wide, 3.0 / k * onward / min(opening.half))
    return max(narrow, wide)


def _finish(number, kind, bench, distance, spread=None, tilt=8.0, axes=None, shift=0.4, extra_ways=(), pitch=None):
    """The detector ``distance`` on, the pixels, the reference field, the scene."""
    rng = bench.rng
    if distance:
        bench.go(distance)
    axes = bench.axes(tilt) @ np.diag([1.0, -1.0, -1.0]) if axes is None else axes
    plane = Face(bench.at, axes, before=bench.index, after=bench.index)
    half = _light_at(bench, bench.legs[-1], plane) if spread is None else spread
    half = min(half, WIDEST)
    if pitch is None:
        pitch = float(f"{half * bench.between(0.7, 1.5) * 2 / COLUMNS:.3g}")
    if not 2e-5 < pitch < 1:
        raise NoReference("pixels too small or too large")
    centre = bench.at + axes[:, :2] @ (shift * half * rng.uniform(-1, 1, 2))
    plane = replace(plane, vertex=centre)
    chosen = rng.choice(COLUMNS * ROWS, COMPARED, replace=False)
    rows, columns = chosen // COLUMNS, chosen % COLUMNS
    uv = -pitch * np.stack([columns - (COLUMNS - 1) / 2, rows - (ROWS - 1) / 2], -1)
    places = Places(plane, uv)
    ways = [Way(bench.source, bench.legs, bench.openings, places, bench.index),
            *(replace(w, detector=places) for w in extra_ways)]
    value, error = _reference(ways, bench)
    tolerance = bench.pick(1e-3, 1e-4, 1e-5)
    return Scene(number, kind, _scene_text(bench, plane, pitch, tolerance), bench.source[None], rows, columns, value,
                 error, tolerance, "; ".join(bench.notes))


def _reference(ways, bench):
    simple = len(ways) == 1 and len(ways[0].openings) == 1 and not any(ways[0].legs) and ways[0].index == 1.0
    try:
        value, error = field_of(ways, bench.wavelength)
    except NoReference:
        if not simple:
            raise
        way = ways[0]
        targets = way.detector.face.points(way.detector.uv)
        value, error = edge_field_of(way.source, way.openings[0], targets, bench.wavelength)
    if not error < OWN_ERROR:
        raise NoReference(f"own error {error:.1e}")
    # Rays over faces leave out the field's next order, 1/kL of each leg.
    k = 2 * np.pi * bench.index / bench.wavelength
    for way in ways:
        error += sum(2 / (k * max(bench.distance, 1e-3)) for leg in way.legs[1:] if leg)
    return value, error + bench.extra_error + bench.beside / np.sqrt(np.mean(np.abs(value) ** 2))


def _scene_text(bench, plane, pitch, tolerance):
    light = _matrix([0, 0, 50.0], np.diag([1.0, -1.0, -1.0]))
    parts = [
        f'<integrator type="coherent">{_floats(tolerance=tolerance)}<boolean name="diffraction" value="true"/>'
        "</integrator>",
        f'<emitter type="laser" id="laser">{light}{_floats(wavelength=round(bench.wavelength * 1e6, 6))}</emitter>',
        f'<shape type="rough_target" id="target">{_matrix([0, 0, 0], np.eye(3))}{_floats(width=1, height=1)}'
        '<string name="points" value="points.csv"/></shape>',
        *bench.xml,
        f'<sensor type="detector" id="detector">{_matrix(plane.vertex, plane.axes)}{_floats(pixel_pitch=pitch)}'
        f'<film type="hdrfilm"><integer name="width" value="{COLUMNS}"/><integer name="height" value="{ROWS}"/></film>'
        "</sensor>",
    ]
    return '<scene version="3.0.0">\n' + "\n".join(parts) + "\n</scene>\n"
