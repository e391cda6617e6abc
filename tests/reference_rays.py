"""Rays over conic faces in given order, aimed by Newton's method: the geometric half of ``reference_optics``.

Shares no code with the product. Derivatives are complex steps; lengths are mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STEP = 1e-30
"""Of a complex step: derivatives to the last place."""


class NoReference(ValueError):
    """The reference cannot tell: no ray or several, a focal line in an opening, or too many nodes."""


@dataclass(frozen=True)
class Face:
    """Conic of revolution c (x^2 + y^2 + (1 + k) z^2)/2 = z, the sheet at its vertex; axes' columns are local x, y, z.

    before, after: indices along the light, after None: a mirror. reach: half-width [mm] within which light may hit.
    """

    vertex: np.ndarray
    axes: np.ndarray
    curvature: float = 0.0
    conic: float = 0.0
    before: float = 1.0
    after: float | None = 1.0
    reach: float = 1e9
    middle: tuple[float, float] = (0.0, 0.0)

    def points(self, uv):
        """World points (m, 3) at local x, y (m, 2)."""
        c, square = self.curvature, (uv**2).sum(-1)
        z = c * square / (1 + np.sqrt(1 - (1 + self.conic) * c * c * square))
        return self.vertex + np.concatenate([uv, z[:, None]], -1) @ self.axes.T

    def normals(self, points):
        """Unit normals (m, 3), along the local +z at the vertex."""
        q = (points - self.vertex) @ self.axes
        c = self.curvature
        g = np.stack([-c * q[..., 0], -c * q[..., 1], 1 - c * (1 + self.conic) * q[..., 2]], -1)
        return (g / length_of(g)[..., None]) @ self.axes.T


def lens_faces(vertex, axes, radius1, radius2, thickness, index, conic1=0.0, conic2=0.0, outside=1.0, reach=1e9):
    """Front and back of a lens whose axis is axes[:, 2], from its front vertex; the light comes along the axis."""
    axes, vertex = np.asarray(axes, float), np.asarray(vertex, float)
    c1, c2 = (1 / r if r else 0.0 for r in (radius1, radius2))
    back = vertex + thickness * axes[:, 2]
    return [
        Face(vertex, axes, c1, conic1, outside, index, reach),
        Face(back, axes, c2, conic2, index, outside, reach),
    ]


def ball_faces(centre, radius, along, index, outside=1.0):
    """Front and back half of a ball that light crosses roughly ``along``."""
    axes, centre = frame_along(along), np.asarray(centre, float)
    return [
        Face(centre - radius * axes[:, 2], axes, 1 / radius, 0.0, outside, index, 0.98 * radius),
        Face(centre + radius * axes[:, 2], axes, -1 / radius, 0.0, index, outside, 0.98 * radius),
    ]


def frame_along(z, x_hint=(1.0, 0.0, 0.0)):
    """(3, 3) right-handed axes whose third column is ``z``."""
    z = np.asarray(z, float) / np.linalg.norm(z)
    x = np.asarray(x_hint, float) - np.dot(x_hint, z) * z
    if np.linalg.norm(x) < 0.1:
        x = np.cross([0.0, 1.0, 0.0], z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], 1)


# Rays


def length_of(v):
    return np.sqrt((v * v).sum(-1))


def dot(a, b):
    return (a * b).sum(-1)


def _hit(face, p, d):
    """Distance (m,) along rays to the sheet at the vertex; complex allowed."""
    q, e = (p - face.vertex) @ face.axes, d @ face.axes
    c, g = face.curvature, 1 + face.conic
    if c == 0:
        return -q[..., 2] / e[..., 2]
    a = 0.5 * c * (e[..., 0] ** 2 + e[..., 1] ** 2 + g * e[..., 2] ** 2)
    b = c * (q[..., 0] * e[..., 0] + q[..., 1] * e[..., 1] + g * q[..., 2] * e[..., 2]) - e[..., 2]
    k = 0.5 * c * (q[..., 0] ** 2 + q[..., 1] ** 2 + g * q[..., 2] ** 2) - q[..., 2]
    disc = b * b - 4 * a * k
    root = np.sqrt(np.where(disc.real < 0, np.nan, disc))
    s = -0.5 * (b + np.where(b.real > 0, 1.0, -1.0) * root)
    one, two = k / s, np.where(np.abs(a) > 1e-300, s / np.where(a == 0, 1, a), np.inf)
    two = np.where(np.isfinite(two.real), two, 1e30)
    z1, z2 = (q[..., 2] + one * e[..., 2]).real, (q[..., 2] + two * e[..., 2]).real
    ok1, ok2 = 1 - g * c * z1 > 0, 1 - g * c * z2 > 0
    first = np.where(ok1 & ok2, np.abs(z1) <= np.abs(z2), ok1)
    return np.where(ok1 | ok2, np.where(first, one, two), np.nan)


def trace(p, d, faces):
    """Last point, last direction, optical length, and (distance, point, direction after) of every face."""
    length, history = 0 * d[..., 0], []
    for face in faces:
        t = _hit(face, p, d)
        p = p + t[..., None] * d
        length = length + face.before * t
        n = face.normals(p)
        cosine = dot(d, n)
        if face.after is None:
            d = d - 2 * cosine[..., None] * n
        elif face.after != face.before:
            eta = face.before / face.after
            square = 1 - eta * eta * (1 - cosine * cosine)
            out = np.sqrt(np.where(square.real < 0, np.nan, square)) * np.where(cosine.real > 0, 1.0, -1.0)
            d = eta * d + (out - eta * cosine)[..., None] * n
        history.append((t, p, d))
    return p, d, length, history


def _across(d):
    hint = np.where(np.abs(d[..., :1]) < 0.7, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
    a = hint - d * dot(hint, d)[..., None]
    a = a / length_of(a)[..., None]
    return a, np.cross(d, a)


def turned(d, a, b, x, y):
    moved = d + x[..., None] * a + y[..., None] * b
    return moved / length_of(moved)[..., None]


def _arrival(origin, d, faces, goal):
    p = trace(origin, d, [*faces, goal])[0]
    return ((p - goal.vertex) @ goal.axes)[..., :2]


def _newton(origin, faces, goal, uv, d, steps=60):
    """Launch directions (m, 3) of rays from origins (m, 3) that reach local places uv (m, 2) of ``goal``; residual."""
    with np.errstate(all="ignore"):
        miss = np.nan_to_num(length_of(_arrival(origin, d, faces, goal) - uv), nan=np.inf, posinf=np.inf)
        for _ in range(steps):
            a, b = _across(d)
            h = 1j * STEP
            one = _arrival(origin + 0j, turned(d + 0j, a, b, h + 0 * d[:, 0], 0j * d[:, 0]), faces, goal)
            two = _arrival(origin + 0j, turned(d + 0j, a, b, 0j * d[:, 0], h + 0 * d[:, 0]), faces, goal)
            jacobian = np.nan_to_num(np.stack([one.imag, two.imag], -1) / STEP, nan=0.0, posinf=0, neginf=0)
            residual = np.nan_to_num(one.real - uv, nan=0.0, posinf=0, neginf=0)
            det = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
            x = -(jacobian[:, 1, 1] * residual[:, 0] - jacobian[:, 0, 1] * residual[:, 1])
            y = -(jacobian[:, 0, 0] * residual[:, 1] - jacobian[:, 1, 0] * residual[:, 0])
            step = np.nan_to_num(np.stack([x, y], -1) / det[:, None], nan=0.0, posinf=0, neginf=0)
            step = step * np.minimum(1, 0.3 / np.maximum(length_of(step), 1e-300))[:, None]
            open_ = np.ones(len(d), bool)
            for scale in (1.0, 0.4, 0.1, 0.02):
                trial = turned(d, a, b, scale * step[:, 0], scale * step[:, 1])
                value = np.nan_to_num(length_of(_arrival(origin, trial, faces, goal) - uv), nan=np.inf, posinf=np.inf)
                better = open_ & (value < miss)
                d, miss = np.where(better[:, None], trial, d), np.where(better, value, miss)
                open_ &= ~better
                if not open_.any() or np.max(miss[open_]) < 1e-10:
                    break
            if not (~open_ & (miss > 1e-13)).any():
                break
    return d, miss


@dataclass(frozen=True)
class Rays:
    """Rays of pairs: optical length, amplitude sqrt(dOmega/dA), focal lines, cosine at the start, least margin."""

    length: np.ndarray
    amplitude: np.ndarray
    focal_lines: np.ndarray
    direction: np.ndarray


def _roots(a, b, c, t):
    """How many zeros of a s^2 + b s + c (whose zeros are real) lie in (0, t)."""
    disc = np.maximum(b * b - 4 * a * c, 0)
    q = -0.5 * (b + np.where(b > 0, 1.0, -1.0) * np.sqrt(disc))
    one, two = np.where(a == 0, np.inf, q / a), np.where(q == 0, np.inf, c / q)
    low = 1e-9 * np.maximum(t, 1e-6)
    return ((one > low) & (one < t)).astype(int) + ((two > low) & (two < t)).astype(int)


def rays(origin, faces, goal, uv, start):
    """Rays from origins (m, 3) over faces to places uv (m, 2) of ``goal``, from directions ``start`` (m, 3)."""
    d, miss = _newton(origin, faces, goal, uv, start)
    allowed = 1e-8 * np.maximum(1, np.abs(uv).max())
    if np.max(miss) > allowed:
        raise NoReference(f"no ray: missed by {np.max(miss):.2g} mm")
    sequence = [*faces, goal]
    p, out, length, history = trace(origin, d, sequence)
    a, b = _across(d)
    h, zero = 1j * STEP + 0 * d[:, 0], 0j * d[:, 0]
    moved = [trace(origin + 0j, turned(d + 0j, a, b, *xy), sequence) for xy in ((h, zero), (zero, h))]
    count, sign = np.zeros(len(d), int), 1.0
    dp = [0 * a, 0 * b]
    dd, along = [a, b], d
    for i, face in enumerate(sequence):
        t = history[i][0]
        qa = dot(along, np.cross(dd[0], dd[1]))
        qb = dot(along, np.cross(dp[0], dd[1]) + np.cross(dd[0], dp[1]))
        qc = dot(along, np.cross(dp[0], dp[1]))
        with np.errstate(all="ignore"):
            count += _roots(qa, qb, qc, t)
        dp = [m[3][i][1].imag / STEP for m in moved]
        dd = [m[3][i][2].imag / STEP for m in moved]
        along = history[i][2]
        margin = np.abs(((history[i][1] - face.vertex) @ face.axes)[:, :2] - np.array(face.middle))
        if np.any(t < -1e-7) or np.any(length_of(margin) > face.reach):
            raise NoReference("a ray leaves a face's reach, or would run backwards")
        sign *= -1 if face.after is None else 1
    area = np.abs(dot(out, np.cross(dp[0], dp[1])))
    hit = (p - goal.vertex) @ goal.axes
    tangents = goal.axes.T
    index = goal.before if goal.after is None else goal.after
    # The last hit is off by the residual: to first order the length there is corrected by the arrival's slope.
    if goal.curvature == 0:
        off = uv - hit[:, :2]
        length = length + index * (off[:, 0] * dot(out, tangents[0]) + off[:, 1] * dot(out, tangents[1]))
    return Rays(length, 1 / np.sqrt(area), count, d)


def chief(origin, faces, goal, uv=(0.0, 0.0)):
    """The direction (3,) from a point over the faces to a place of ``goal``. NoReference: there is none, or several."""
    uv = np.array(uv, float)
    if faces:
        face = faces[0]
        grid = np.linspace(-0.95, 0.95, 11) * min(face.reach, 60.0)
        if face.curvature and (1 + face.conic) > 0:
            grid = grid * min(1.0, 0.9 / abs(face.curvature) / np.sqrt(1 + face.conic) / max(abs(grid).max(), 1e-9))
        x, y = np.meshgrid(grid, grid)
        local = np.stack([x.ravel(), y.ravel()], -1) + np.array(face.middle)
        with np.errstate(all="ignore"):
            starts = face.points(local) - origin
        starts = starts[np.isfinite(starts).all(-1)]
    else:
        starts = (goal.points(uv[None]) - origin)
    touching = faces and abs(_hit(faces[0], origin[None], faces[0].axes[:, 2][None])[0]) < 1e-6
    if touching or np.min(length_of(starts)) < 1e-6:
        # The source touches the first face: directions instead of places on it.
        x, y = (g.ravel() for g in np.meshgrid(np.linspace(-0.9, 0.9, 9), np.linspace(-0.9, 0.9, 9)))
        axis = np.tile(faces[0].axes[:, 2], (len(x), 1))
        starts = turned(axis, *_across(axis), x, y)
    starts = starts / length_of(starts)[:, None]
    m = len(starts)
    origins, places = np.tile(origin, (m, 1)), np.tile(uv, (m, 1))
    d, miss = _newton(origins, faces, goal, places, starts, steps=40)
    with np.errstate(all="ignore"):
        _, _, _, history = trace(origins, d, [*faces, goal])
        good = miss < 1e-8
        for face, (t, p, _) in zip([*faces, goal], history, strict=True):
            off = ((p - face.vertex) @ face.axes)[:, :2] - np.array(face.middle)
            good &= (t >= -1e-7) & (length_of(off) <= face.reach)
    found = d[good]
    if not len(found):
        raise NoReference("no ray over these faces")
    if np.max(length_of(found - found[0])) > 1e-5:
        raise NoReference("several rays over these faces")
    return found[0]
