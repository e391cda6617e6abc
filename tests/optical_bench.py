"""A bench built along a real chief ray, at once as Mitsuba XML and as faces and openings of ``reference_optics``.

Every element is put where the chief ray is and turns it as it does in truth, so that a scene's light is known to come
through; :func:`finished` puts the detector at its end and asks the reference for the field. Nothing here imports the
product.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from reference_optics import Opening, Places, Way, edge_field_of, field_of, refracts
from reference_rays import Face, NoReference, ball_faces, chief, frame_along, lens_faces, rays, trace
from stray_light import CLEAR, require_free, seen_through

COLUMNS, ROWS, COMPARED = 24, 18, 12
"""Pixels of every detector, and on how many of them fields are compared."""

WAVELENGTHS = (405.0, 532.0, 632.8, 785.0)
OFF_CENTRE = 0.4
"""How far beside the chief ray a detector stands at most, in half-widths of its light."""

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


def floats(**values):
    return "".join(f'<float name="{k}" value="{float(v)!r}"/>' for k, v in values.items())


def shape(kind, name, origin, axes, inside="", scale=(1.0, 1.0, 1.0), **values):
    placed = _matrix(origin, np.asarray(axes) * np.asarray(scale, float))
    return f'<shape type="{kind}" id="{name}">{placed}{floats(**values)}{inside}</shape>'


CONDUCTOR = '<bsdf type="twosided"><bsdf type="conductor"/></bsdf>'
_OPAQUE = '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>'


def _glass(inside, outside):
    return f'<bsdf type="dielectric">{floats(int_ior=inside, ext_ior=outside)}</bsdf>'


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
    """What has been built so far: the chief ray's end and direction, XML, faces of every leg, openings.

    planes, balls: what light ends at or is reflected by; glass, glass_balls: what it does not pass unchanged;
    path, rims: segments of the chief ray and of rays to the openings' edges; wavelength: in vacuum [mm]; index: of the
    medium around; extra_error: relative, beside [field]: what the reference leaves out; other_ways: whose field is
    added; detector_axes, _half [mm], _tilt [deg]: where they are not the light's.
    """

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
    glass: list = field(default_factory=list)
    glass_balls: list = field(default_factory=list)
    path: list = field(default_factory=list)
    rims: list = field(default_factory=list)
    notes: list = field(default_factory=list)
    extra_error: float = 0.0
    beside: float = 0.0
    other_ways: list = field(default_factory=list)
    detector_axes: np.ndarray | None = None
    detector_half: float | None = None
    detector_tilt: float = 8.0

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

    def axes(self, tilt=0.0, turn=True):
        """Axes whose z is the chief ray's direction, tilted by up to ``tilt`` [deg] and turned about it."""
        base = frame_along(self.d, self.rng.normal(size=3))
        return _rotation(np.radians(tilt) * self.rng.uniform(-1, 1, 3)) @ base

    def meet(self, faces):
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
            size, form = floats(radius=half[0], outer_radius=outer), "circle"
        else:
            size, form = floats(width=2 * half[0], height=2 * half[1], outer_radius=outer), "rectangle"
        self.xml.append(shape("aperture", self.name("stop"), centre, axes,
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
        self.xml.append(shape("rectangle", self.name("mirror"), centre, axes, CONDUCTOR, (half, half, 1)))
        self.planes.append((centre, axes, (half, half), None))
        self.meet([Face(centre, axes, before=self.index, after=None, reach=CLEAR * half)])

    def conductor_sphere(self, d_out, radius):
        """The outside of a sphere of metal."""
        n = (d_out - self.d) / np.linalg.norm(d_out - self.d)
        centre = self.at - radius * n
        self.xml.append(shape("sphere", self.name("sphere"), centre, np.eye(3), CONDUCTOR, (radius,) * 3))
        self.balls.append((centre, radius))
        self.meet([Face(centre + radius * n, frame_along(-n), 1 / radius, 0.0, self.index, None, 0.9 * radius)])

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
        self.xml.append(shape("mirror", self.name("mirror"), vertex, axes, **values))
        face = Face(vertex, axes, sign / radius, conic, self.index, None, CLEAR * diameter / 2, (off_axis, 0.0))
        centre = face.points(np.array([[off_axis, 0.0]]))[0]
        self.planes.append((centre, axes, (diameter / 2,), None))
        self.meet([face])

    def lens(self, r1, r2, t, diameter, index, tilt=0.0, decentre=(0.0, 0.0), axes=None, conic1=0.0, conic2=0.0,
             front=None, meet=True):
        """A lens whose front vertex lies where the chief ray ends, or ``front`` in given axes. Its axes."""
        axes = self.axes(tilt) if axes is None else axes
        vertex = (self.at if front is None else front) + axes[:, :2] @ np.asarray(decentre)
        self.xml.append(shape("lens", self.name("lens"), vertex, axes, radius1=r1, radius2=r2, conic1=conic1,
                               conic2=conic2, thickness=t, diameter=diameter, ior=index))
        self.glass.append((vertex + t / 2 * axes[:, 2], axes, (diameter / 2,), None))
        faces = lens_faces(vertex, axes, r1, r2, t, index, conic1, conic2, reach=CLEAR * diameter / 2)
        _require_lens(r1, r2, t, diameter, conic1, conic2)
        if meet:
            self.meet(faces)
        return vertex, axes, faces

    def ball(self, radius, index, outside, beside=(0.0, 0.0)):
        axes = self.axes()
        centre = self.at + radius * self.d + axes[:, :2] @ np.asarray(beside)
        self.xml.append(shape("sphere", self.name("ball"), centre, np.eye(3), _glass(index, outside), (radius,) * 3))
        self.glass_balls.append((centre, radius))
        self.meet(ball_faces(centre, radius, self.d, index, outside))

    def plate(self, thickness, half, index, tilt=0.0, outside=1.0, axes=None, middle=None):
        """A plane-parallel plate whose front face the chief ray has reached."""
        axes = self.axes(tilt) if axes is None else axes
        front = self.at if middle is None else middle
        centre = front + thickness / 2 * axes[:, 2]
        self.xml.append(shape("cube", self.name("plate"), centre, axes, _glass(index, outside),
                               (half, half, thickness / 2)))
        back = front + thickness * axes[:, 2]
        self.meet([Face(front, axes, 0.0, 0.0, outside, index, CLEAR * half),
                    Face(back, axes, 0.0, 0.0, index, outside, CLEAR * half)])

    def baffle(self, centre, normal, half):
        axes = frame_along(normal)
        self.xml.append(shape("rectangle", self.name("baffle"), centre, axes, _OPAQUE, (half, half, 1)))
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


# The detector at the end


def _light_at(bench, plane):
    """Half-width [mm] of the light at a plane: the least of all openings' geometric shadows, or their diffraction."""
    k = 2 * np.pi / bench.wavelength
    narrow, wide = np.inf, 0.0
    for j, opening in enumerate(bench.openings):
        before = [f for leg in bench.legs[: j + 1] for f in leg]
        behind = [f for leg in bench.legs[j + 1 :] for f in leg]
        rim = opening.samples()
        first = chief(bench.source, before, opening.face)
        found = rays(np.tile(bench.source, (len(rim), 1)), before, opening.face, rim, np.tile(first, (len(rim), 1)))
        middle = [opening.face] if refracts(opening.face) else []
        p, _, length, history = trace(np.tile(bench.source, (len(rim), 1)), found.direction,
                                      [*before, *middle, *behind, plane])
        if not np.isfinite(p).all():
            raise NoReference("light of the rim gets lost")
        corners = [np.tile(bench.source, (len(rim), 1)), *(q for _, q, _ in history)]
        bench.rims += [(a, b) for one, two in zip(corners, corners[1:], strict=False)
                       for a, b in zip(one, two, strict=True)]
        narrow = min(narrow, np.max(np.linalg.norm(p - p[0], axis=1)))
        onward = max(float(length[0] - found.length[0]), 1e-3)
        wide = max(wide, 3.0 / k * onward / min(opening.half))
    return max(narrow, wide)


def finished(number, kind, bench, distance):
    """The scene with its detector ``distance`` on, the pixels compared and the reference's field there."""
    rng = bench.rng
    if distance:
        bench.go(distance)
    axes = bench.detector_axes
    if axes is None:
        axes = bench.axes(bench.detector_tilt) @ np.diag([1.0, -1.0, -1.0])
    plane = Face(bench.at, axes, before=bench.index, after=bench.index)
    half = min(_light_at(bench, plane), WIDEST)
    half = bench.detector_half or half
    require_free(bench)
    pitch = float(f"{half * bench.between(0.7, 1.5) * 2 / COLUMNS:.3g}")
    if not 2e-5 < pitch < 1:
        raise NoReference("pixels too small or too large")
    centre = bench.at + axes[:, :2] @ (OFF_CENTRE * half * rng.uniform(-1, 1, 2))
    plane = replace(plane, vertex=centre)
    chosen = rng.choice(COLUMNS * ROWS, COMPARED, replace=False)
    rows, columns = chosen // COLUMNS, chosen % COLUMNS
    uv = -pitch * np.stack([columns - (COLUMNS - 1) / 2, rows - (ROWS - 1) / 2], -1)
    places = Places(plane, uv)
    ways = [Way(bench.source, bench.legs, bench.openings, places, bench.index),
            *(replace(w, detector=places) for w in bench.other_ways)]
    value, error = _reference(ways, bench)
    tolerance = bench.pick(1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
    return Scene(number, kind, _scene_text(bench, plane, pitch, tolerance), bench.source[None], rows, columns, value,
                 error, tolerance, "; ".join(bench.notes))


def _reference(ways, bench):
    """Field and relative error: of the sums, and of what they leave out."""
    first, single = ways[0], len(ways) == 1 and len(ways[0].openings) == 1 and not any(ways[0].legs)
    try:
        value, error = field_of(ways, bench.wavelength)
    except NoReference:
        if not single or bench.index != 1.0:
            raise
        targets = first.detector.face.points(first.detector.uv)
        value, error = edge_field_of(first.source, first.openings[0], targets, bench.wavelength)
    if not error < OWN_ERROR:
        raise NoReference(f"own error {error:.1e}")
    # A ray over faces leaves out the wave's next order, 1/kL of a leg.
    k = 2 * np.pi / bench.wavelength
    for way in ways:
        ends = [way.source, *(o.face.vertex for o in way.openings), way.detector.face.vertex]
        for leg, p, q in zip(way.legs[1:], ends[1:], ends[2:], strict=False):
            error += 2 / (k * np.linalg.norm(q - p)) if leg else 0.0
    for way in ways:
        if len(way.openings) == 1 and any(face.after is None for face in way.legs[-1]):
            value = value + _thrown_past(way, bench)
    return value, error + bench.extra_error + bench.beside / np.sqrt(np.mean(np.abs(value) ** 2))


def _thrown_past(way, bench):
    """Field (m,) of the light that a stop's edge throws straight to the detector, past the mirror behind the stop."""
    opening, detector = way.openings[0], way.detector.face
    targets, holes = detector.points(way.detector.uv), opening.face.points(opening.samples())
    before_it = np.any((holes - detector.vertex) @ detector.axes[:, 2] > 0)
    if way.legs[0] or not before_it or not np.any(seen := seen_through(bench, holes, targets)):
        return 0.0
    if not np.all(seen):
        raise NoReference("a part of the stop is seen past the mirror")
    return edge_field_of(way.source, opening, targets, bench.wavelength)[0]


def _scene_text(bench, plane, pitch, tolerance):
    light = _matrix([0, 0, 50.0], np.diag([1.0, -1.0, -1.0]))
    parts = [
        f'<integrator type="coherent">{floats(tolerance=tolerance)}<boolean name="diffraction" value="true"/>'
        "</integrator>",
        f'<emitter type="laser" id="laser">{light}{floats(wavelength=round(bench.wavelength * 1e6, 6))}</emitter>',
        f'<shape type="rough_target" id="target">{_matrix([0, 0, 0], np.eye(3))}{floats(width=1, height=1)}'
        '<string name="points" value="points.csv"/></shape>',
        *bench.xml,
        f'<sensor type="detector" id="detector">{_matrix(plane.vertex, plane.axes)}{floats(pixel_pitch=pitch)}'
        f'<film type="hdrfilm"><integer name="width" value="{COLUMNS}"/><integer name="height" value="{ROWS}"/></film>'
        "</sensor>",
    ]
    return '<scene version="3.0.0">\n' + "\n".join(parts) + "\n</scene>\n"
