"""The judge of random scenes: optics in plain NumPy that shares no code with the product.

A *way* is a chain of legs and openings: source, faces, opening, faces, opening, ..., faces, detector. The ray of a leg
from one point to another over given faces in given order is found by Newton's method on the launch direction (many
starts, complex-step derivatives); its amplitude is that of its tube, sqrt(dOmega/dA), and every focal line that it
crosses turns the phase by -pi/2. A leg without faces is the exact spherical wave. Openings are summed over by
Rayleigh and Sommerfeld's first integral in the medium of index n,

    U(D) = n/(i lambda) sum_Q w_Q U(Q) A(Q, D) e^{ikL(Q, D)} cos(chi) (1 + i/(n k r) in free space),

one after the other, and the whole is done twice, the second time with half as many nodes again and a higher degree:
the difference is the reference's own error. Lengths are mm, the phasor is e^{+ikL}, a mirror reflects with +1.

Convention: opaque things cast geometric shadows; only openings (and rims given as openings) diffract.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from reference_rays import Face, NoReference, dot, length_of, chief, rays
from scipy.special import eval_jacobi, eval_legendre, roots_legendre

MOST_PAIRS = 4e6
"""Pairs of points in one sum that the reference affords (about a second)."""


@dataclass(frozen=True)
class Opening:
    """A hole in a face (its middle at the vertex): a disc of radius half[0], or a rectangle of half sides ``half``.

    A plane face of equal indices is a hole in a screen; a curved, refracting one is the rim of a lens.
    """

    face: Face
    half: tuple[float, ...]

    @property
    def round(self):
        return len(self.half) == 1

    def nodes(self, n1, n2):
        """(uv (n1 n2, 2), weight): Gauss-Legendre in radius and equal angles, or Gauss-Legendre along both sides."""
        t, w = roots_legendre(n1)
        if self.round:
            r, w = self.half[0] * (t + 1) / 2, self.half[0] * w / 2
            angle = 2 * np.pi * (np.arange(n2) + 0.3) / n2
            uv = np.stack([np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel()], -1)
            weight = np.repeat(w * r * 2 * np.pi / n2, n2)
        else:
            s, v = roots_legendre(n2)
            x, y = np.meshgrid(self.half[0] * t, self.half[1] * s, indexing="ij")
            uv = np.stack([x.ravel(), y.ravel()], -1)
            weight = self.half[0] * self.half[1] * np.outer(w, v).ravel()
        normal = self.face.normals(self.face.points(uv))
        return uv, weight / np.abs(normal @ self.face.axes[:, 2])

    def basis(self, uv, degree, grid=None):
        """Polynomials up to ``degree`` at uv (m, 2), (m, terms); grid: the counts that :meth:`nodes` was given."""
        return _polynomials(self.round, uv / (self.half[0] if self.round else np.array(self.half)), degree, grid)

    def coarse(self, degree):
        """Nodes (m, 2) that determine the polynomials, and the matrix (terms, m) from values to coefficients."""
        unit, matrix = _coarse(self.round, degree)
        return unit * (self.half[0] if self.round else np.array(self.half)), matrix

    def samples(self):
        """A few places (m, 2) that span the opening."""
        if self.round:
            angle = np.arange(8) * np.pi / 4
            return np.concatenate([[[0.0, 0.0]], 0.999 * self.half[0] * np.stack([np.cos(angle), np.sin(angle)], -1)])
        x, y = np.meshgrid([-1, 0, 1], [-1, 0, 1])
        return np.stack([x.ravel() * self.half[0], y.ravel() * self.half[1]], -1)


def _polynomials(round_, uv, degree, grid=None):
    """Zernike's polynomials on the unit disc, products of Legendre's on the square, at uv (m, 2): (m, terms)."""
    n1, n2 = grid or (len(uv), 1)
    places = uv.reshape(n1, n2, 2)
    columns = []
    if round_:
        first = places[:, :1] if grid else places
        r = np.minimum(length_of(first), 1.0)
        angle = np.arctan2(places[:1, :, 1], places[:1, :, 0]) if grid else np.arctan2(places[..., 1], places[..., 0])
        for m in range(degree + 1):
            cosine, sine = np.cos(m * angle), np.sin(m * angle)
            for n in range(m, degree + 1, 2):
                radial = r**m * eval_jacobi((n - m) // 2, 0, m, 2 * r * r - 1)
                columns += [(radial, cosine), (radial, sine)][: 2 if m else 1]
    else:
        x, y = (places[:, :1, 0], places[:1, :, 1]) if grid else (places[..., 0], places[..., 1])
        px, py = ([eval_legendre(m, v) for m in range(degree + 1)] for v in (x, y))
        columns = [(px[m], py[n]) for m in range(degree + 1) for n in range(degree + 1 - m)]
    out = np.empty((len(columns), n1, n2))
    for i, (one, two) in enumerate(columns):
        np.multiply(one, two, out=out[i])
    return out.reshape(len(columns), -1).T


@lru_cache(maxsize=8)
def _coarse(round_, degree):
    unit = Opening(Face(np.zeros(3), np.eye(3)), (1.0,) if round_ else (1.0, 1.0))
    uv = unit.nodes(degree // 2 + 3, 2 * degree + 6)[0] if round_ else unit.nodes(degree + 3, degree + 3)[0]
    return uv, np.linalg.pinv(_polynomials(round_, uv, degree))


@dataclass(frozen=True)
class Places:
    """Fixed points: a source or pixel centres, as places uv (m, 2) of a plane face."""

    face: Face
    uv: np.ndarray

    def coarse(self, degree):
        return self.uv, None

    def samples(self):
        return self.uv


class Leg:
    """Length, amplitude times cosine, and focal lines between all pairs of places of two ends."""

    def __init__(self, start, faces, end, degree):
        self.start, self.faces, self.end = start, faces, end
        self.index = faces[0].before if faces else (start.face.after or start.face.before)
        if isinstance(start, Opening) and isinstance(end, Opening):
            degree = degree // 2 + 1  # four coordinates: a smaller degree is both enough and all that can be paid
        self.degree, self.focal_lines, self.mean = degree, 0, 0.0
        if faces or refracts(end.face):
            self._aim()

    def _aim(self):
        a, self.from_a = self.start.coarse(self.degree)
        b, self.from_b = self.end.coarse(self.degree)
        origins = self.start.face.points(a)
        goal = self.end.face
        first = chief(self.start.face.points(a.mean(0)[None])[0], self.faces, goal, b.mean(0))
        pairs_o, pairs_b = np.repeat(origins, len(b), 0), np.tile(b, (len(a), 1))
        found = rays(pairs_o, self.faces, goal, pairs_b, np.tile(first, (len(pairs_o), 1)))
        if np.ptp(found.focal_lines):
            raise NoReference("a focal line lies in an opening or on the detector")
        self.focal_lines = int(found.focal_lines[0])
        normal = np.repeat(self.start.face.normals(origins), len(b), 0)
        cosine = np.abs(dot(found.direction, normal)) if isinstance(self.start, Opening) else 1.0
        shape = (len(a), len(b))
        self.mean = found.length.mean()
        self.length = self._coefficients((found.length - self.mean).reshape(shape))
        self.factor = self._coefficients((found.amplitude * cosine).reshape(shape))

    def _coefficients(self, values):
        values = values if self.from_a is None else self.from_a @ values
        return values if self.from_b is None else values @ self.from_b.T

    def between(self, a, b, grids=(None, None)):
        """Function of a slice of the places ``a``: lengths (na, nb) less ``mean``, factors A cos(chi), 1/r or 0.

        a, b: places (na, 2), (nb, 2) of the two ends; grids: the counts of the nodes that they are, or None.
        """
        if not (self.faces or refracts(self.end.face)):
            p, q = self.start.face.points(a), self.end.face.points(b)
            normal = self.start.face.normals(p) if isinstance(self.start, Opening) else None
            return lambda part: self._free(p[part], q, None if normal is None else normal[part])
        left = None if self.from_a is None else self.start.basis(a, self.degree, grids[0])
        right = None if self.from_b is None else self.end.basis(b, self.degree, grids[1])
        known = [c if right is None else c @ right.T for c in (self.length, self.factor)]

        def block(part):
            length, factor = (c[part] if left is None else left[part] @ c for c in known)
            return length, factor, 0.0

        return block

    def _free(self, p, q, normal):
        v = [q[None, :, i] - p[:, None, i] for i in range(3)]
        r = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        cosine = 1.0 if normal is None else np.abs(sum(v[i] * normal[:, None, i] for i in range(3))) / r
        return self.index * r, cosine / r, 1 / (self.index * r)


def refracts(face):
    """Whether light goes on behind a face in another medium."""
    return face.after is not None and face.after != face.before


@dataclass(frozen=True)
class Way:
    """Source point (3,), legs (faces of each), openings between them, pixel places of a plane, index of the medium."""

    source: np.ndarray
    legs: list[list[Face]]
    openings: list[Opening]
    detector: Places
    index: float = 1.0


def _ends(way):
    source = Places(Face(np.asarray(way.source, float), np.eye(3), before=way.index, after=way.index), np.zeros((1, 2)))
    return [source, *way.openings, way.detector]


def _node_counts(legs, opening, j, k, effort):
    """Nodes of the opening behind leg j that resolve the phase of every pair of ends, (n1, n2)."""
    before, after = legs[j].start.samples(), legs[j + 1].end.samples()
    n1, n2 = (33, 48) if opening.round else (33, 33)
    if opening.round:
        r, angle = np.linspace(1e-3, 1, n1) * opening.half[0], 2 * np.pi * np.arange(n2 + 1) / n2
        uv = np.stack([np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel()], -1)
        n2 += 1
    else:
        x, y = np.meshgrid(*(np.linspace(-h, h, n1) for h in opening.half), indexing="ij")
        uv = np.stack([x.ravel(), y.ravel()], -1)
    one = legs[j].between(before, uv)(slice(None))[0]
    two = legs[j + 1].between(uv, after)(slice(None))[0]
    phase = k * (one[:, :, None] + two[None]).reshape(len(one), n1, n2, -1)
    phase = np.moveaxis(phase, -1, 1).reshape(-1, n1, n2)
    across = np.abs(np.diff(phase, axis=1)).sum(1).max()
    if opening.round:
        turns = np.abs(np.diff(phase, axis=2)).max() * (n2 - 1) / (2 * np.pi)
        return int(effort * (0.5 * across + 14)), int(effort * (1.15 * turns + 24))
    along = np.abs(np.diff(phase, axis=2)).sum(2).max()
    return int(effort * (0.5 * across + 14)), int(effort * (0.5 * along + 14))


def _once(way, wavelength, degree, effort, most):
    k, ends = 2 * np.pi / wavelength, _ends(way)
    legs = [Leg(ends[i], way.legs[i], ends[i + 1], degree) for i in range(len(way.legs))]
    places, grid, weights, values = ends[0].uv, None, np.ones(1), np.ones(1, complex)
    for j, leg in enumerate(legs):
        if j < len(way.openings):
            counts = _node_counts(legs, way.openings[j], j, k, effort)
            if counts[0] * counts[1] > min(effort**4 * most / len(places), effort**2 * most / 40):
                raise NoReference(f"too many nodes: {len(places)} x {counts}")
            goal, goal_weights = way.openings[j].nodes(*counts)
        else:
            counts, goal, goal_weights = None, way.detector.uv, np.ones(len(way.detector.uv))
        block, across = leg.between(places, goal, (grid, counts)), max(1, int(1e6) // len(goal))
        new = np.zeros(len(goal), complex)
        for i in range(0, len(places), across):
            part = slice(i, i + across)
            length, factor, inverse = block(part)
            wave = factor * np.exp(1j * k * length)
            if j:
                wave = wave * (1 + 1j * inverse / k) * (leg.index / (1j * wavelength))
            new += (weights[part] * values[part]) @ wave
        values = new * np.exp(1j * ((k * leg.mean) % (2 * np.pi))) * (-1j) ** leg.focal_lines
        places, grid, weights = goal, counts, goal_weights
    return values


def field_of(ways, wavelength, degree=10, most=MOST_PAIRS):
    """Field (m,) that ways add up to, and its own relative error: against fewer nodes and a lower degree."""
    rough = sum(_once(way, wavelength, degree, 1.0, most) for way in ways)
    fine = sum(_once(way, wavelength, degree + 4, 1.4, most) for way in ways)
    return fine, float(np.linalg.norm(fine - rough) / np.linalg.norm(fine))


# One opening in free space by a line, however large


def edge_field(source, opening, targets, wavelength, count):
    """Rayleigh and Sommerfeld's first integral over a plane hole as the geometric field and a line along the edge.

    The integral is Kirchhoff's at the target less Kirchhoff's at its image in the screen (the normal derivative of the
    field falls out); each is, for a spherical wave, geometric light and Maggi and Rubinowicz's line integral
    (Born & Wolf, section 8.9). Same (m,) field as the area's sum, at the cost of ``count`` points.
    """
    k, face = 2 * np.pi / wavelength, opening.face
    n = face.axes[:, 2]
    q, dl = _edge(opening, count)
    total = np.zeros(len(targets), complex)
    for sign, places in ((1.0, targets), (-1.0, targets - 2 * ((targets - face.vertex) @ n)[:, None] * n)):
        r = q - source
        rl = length_of(r)
        for i, place in enumerate(places):
            s = q - place
            sl = length_of(s)
            triple = dot(np.cross(s, r), dl)
            kernel = np.exp(1j * k * (rl + sl)) / (rl * sl) * triple / (rl * sl + dot(s, r))
            value = kernel.sum() / (4 * np.pi)
            total[i] += sign * (_orientation(source, face) * value + _geometric(source, opening, place, k))
    return total


def _geometric(source, opening, place, k):
    """The source's spherical wave where it comes straight through the hole, otherwise 0."""
    face = opening.face
    before, behind = ((p - face.vertex) @ face.axes for p in (source, place))
    if before[2] * behind[2] >= 0:
        return 0.0
    hit = (before + before[2] / (before[2] - behind[2]) * (behind - before))[:2]
    inside = length_of(hit) < opening.half[0] if opening.round else np.all(np.abs(hit) < opening.half)
    distance = np.linalg.norm(place - source)
    return inside * np.exp(1j * k * distance) / distance


def _orientation(source, face):
    """The edge runs right-handed about +z; the line's sign is that of the light's sense through the screen."""
    return 1.0 if (face.vertex - source) @ face.axes[:, 2] > 0 else -1.0


def _edge(opening, count):
    """Points (m, 3) along the edge and their line elements (m, 3)."""
    face = opening.face
    if opening.round:
        angle = 2 * np.pi * (np.arange(count) + 0.5) / count
        local = opening.half[0] * np.stack([np.cos(angle), np.sin(angle)], -1)
        step = opening.half[0] * 2 * np.pi / count * np.stack([-np.sin(angle), np.cos(angle)], -1)
    else:
        # np.polynomial's nodes cost count^3; composite panels of 16 nodes each do as well.
        t, w = roots_legendre(16)
        panels = max(count // 64, 1)
        x = ((np.arange(panels)[:, None] + (t + 1) / 2) / panels * 2 - 1).ravel()
        w = np.tile(w, panels) / panels
        hx, hy = opening.half
        one, zero = np.ones_like(x), np.zeros_like(x)
        local = np.concatenate([np.stack(s, -1) for s in (
            (hx * x, -hy * one), (hx * one, hy * x), (-hx * x, hy * one), (-hx * one, -hy * x))])
        step = np.concatenate([np.stack(s, -1) for s in (
            (hx * w, zero), (zero, hy * w), (-hx * w, zero), (zero, -hy * w))])
    return face.vertex + local @ face.axes[:, :2].T, step @ face.axes[:, :2].T


def edge_field_of(source, opening, targets, wavelength):
    """:func:`edge_field` with enough points, and its own relative error against two thirds of them."""
    k = 2 * np.pi / wavelength
    q, _ = _edge(opening, 512)
    path = length_of(q - source)[:, None] + length_of(q[:, None] - targets[None])
    image = targets - 2 * ((targets - opening.face.vertex) @ opening.face.axes[:, 2])[:, None] * opening.face.axes[:, 2]
    path = np.concatenate([path, length_of(q - source)[:, None] + length_of(q[:, None] - image[None])], 1)
    speed = np.abs(np.diff(path, axis=0)).max() * 512 * k / (2 * np.pi)
    previous = None
    count = 64 * (int(1.3 * speed + 256) // 64)
    while count < 3e6:
        now = edge_field(source, opening, targets, wavelength, count)
        if previous is not None:
            error = float(np.linalg.norm(now - previous) / np.linalg.norm(now))
            if error < 1e-8:
                return now, error
        previous, count = now, 64 * (int(1.5 * count) // 64)
    raise NoReference("too many points along the edge")
