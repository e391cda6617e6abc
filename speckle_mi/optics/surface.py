"""Optical surfaces and the order in which light meets them.

A surface is a plane or a conic of revolution about the local z axis with its vertex at the frame's origin,

    c (x^2 + y^2) + c (1 + k) z^2 - 2 z = 0,

c the curvature [1/mm] (positive: centre of curvature on the +z side; 0: plane) and k the conic constant (0 sphere, -1
paraboloid, k < -1 hyperboloid). Lengths are mm.

A surface of another form is a subclass with its own ``sag``, ``gradient``, ``bend``, ``intersect``, ``crossings``,
``turned`` and ``same_form``; nothing else of the optics knows what form a surface has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.frames import Frame
from ..geometry.outline import Circle, OffsetCircle, Rectangle

BEHIND_TOLERANCE = 1e-9
"""A surface this far behind the ray's start [mm] still counts as met: a source may lie on it, rounded."""

ORTHONORMAL_TOLERANCE = 1e-6
"""Axes further from orthonormal than this are a mistake; closer ones are rounding and are made exact."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A plane or conic of revolution.

    frame: origin at the vertex, local z along the axis of revolution; curvature: [1/mm]; conic: conic constant;
    outline: rim in local x, y, or None for an unbounded surface.
    Raises ValueError for axes that are not orthonormal or a shape that is not finite.
    """

    frame: Frame
    curvature: float = 0.0
    conic: float = 0.0
    outline: Circle | OffsetCircle | Rectangle | None = None

    def __post_init__(self) -> None:
        axes = np.asarray(self.frame.axes, dtype=np.float64)
        error = np.abs(axes.T @ axes - np.eye(3)).max()
        if not error < ORTHONORMAL_TOLERANCE:
            raise ValueError(
                f"surface axes are not orthonormal (off by {error:.1e}): optics may be rotated, not scaled or sheared"
            )
        if not (np.isfinite(self.curvature) and np.isfinite(self.conic)):
            raise ValueError(
                f"surface curvature = {self.curvature}, conic = {self.conic}: must be finite (a plane has curvature 0)"
            )
        # The nearest rotation: a scale error of 1e-9 in the axes would already be 1e-4 wavelengths over 0.1 m.
        left, _, right = np.linalg.svd(axes)
        object.__setattr__(self, "frame", Frame(np.asarray(self.frame.origin, dtype=np.float64), left @ right))

    @classmethod
    def sphere(cls, centre: np.ndarray, radius: float) -> Surface:
        """Full sphere, to be crossed with the roots "near" and "far" (a ball lens). centre (3,), radius [mm]."""
        if not radius > 0.0:
            raise ValueError(f"sphere radius = {radius} mm: must be positive")
        return cls(Frame(np.asarray(centre, dtype=np.float64) - [0.0, 0.0, radius], np.eye(3)), 1.0 / radius)

    @property
    def is_plane(self) -> bool:
        return self.curvature == 0.0

    @property
    def has_flat_rim(self) -> bool:
        """Whether a round rim about the axis lies in a plane."""
        return True

    @property
    def is_closed(self) -> bool:
        """Whether the whole surface, beyond any rim, is closed: a sphere or spheroid."""
        return self.curvature != 0.0 and self.conic > -1.0

    @property
    def widest(self) -> float:
        """Distance [mm] from the axis up to which the sheet through the vertex reaches, inf where it has no end."""
        bend = (1 + self.conic) * self.curvature**2
        return float(1 / np.sqrt(bend)) if bend > 0 else np.inf

    @property
    def middle(self) -> np.ndarray:
        """World point (3,) of the surface in the middle of its outline: the vertex, but for a part beside the axis."""
        if self.outline is None:
            return self.frame.origin
        x, y = self.outline.centre
        return self.frame.to_world(np.array([[x, y, self.sag(x, y)]]))[0]

    @property
    def centre_of_curvature(self) -> np.ndarray:
        """World point (3,) that the surface is curved about at its vertex; a plane has none."""
        return self.frame.origin + self.frame.axes[:, 2] / self.curvature

    def sag(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height (n,) [mm] above the vertex plane at local x, y (n,) [mm].

        c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)); beyond the equator, where there is no surface, the root counts as 0.
        """
        c, k, squared = self.curvature, self.conic, x * x + y * y
        return c * squared / (1 + np.sqrt(np.maximum(1 - (1 + k) * c * c * squared, 0.0)))

    def gradient(self, point: np.ndarray) -> np.ndarray:
        """Half the gradient of the surface's equation at local points (3, n), (3, n); its length is 1 at the vertex."""
        gradient = self.curvature * point
        if self.conic:
            gradient[2] *= 1.0 + self.conic
        gradient[2] -= 1.0
        return gradient

    def bend(self, point: np.ndarray, tangents: np.ndarray) -> np.ndarray:
        """How the gradient at local points (3, n) changes along tangents (3, T, n): (3, T, n), a new array."""
        change = self.curvature * tangents
        if self.conic:
            change[2] *= 1.0 + self.conic
        return change

    def turned(self) -> Surface:
        """The same surface seen from its other side: turned by 180 degrees about the local y axis."""
        return replace(self, curvature=-self.curvature, conic=self.conic)

    def same_form(self, other: Surface, reach: float, tolerance: float) -> bool:
        """Whether within ``reach`` [mm] of the axis both have one form, up to ``tolerance`` [mm] in height."""
        if type(self) is not type(other):
            return False
        same = abs(self.curvature - other.curvature) * reach**2 / 2 < tolerance
        return bool(same and abs(self.conic - other.conic) < tolerance)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Unit normals (n, 3) at world points (n, 3) of the surface, along local +z at the vertex."""
        gradient = self.gradient(self.frame.to_local(points).T)
        return -(gradient / np.sqrt(dot(gradient, gradient))).T @ self.frame.axes.T

    def intersect(
        self, point: np.ndarray, direction: np.ndarray, root: str = "vertex"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Length (n,) [mm] along local rays to the surface and the hit points (3, n), NaN where there are none.

        point, direction: (3, n), directions of unit length. root: which of the two crossings of the quadric,
        "vertex": the one met on the sheet through the vertex, crossed in the direction the ray has along z, or, where
        that one lies behind the ray, the other if it lies ahead (the wall of a deep bowl, met from inside going up);
        "near", "far": first and second crossing of a closed surface.

        With the ray written from its point closest to the vertex, a t^2 + 2 b t + f = 0, and
        a t + b = +-sqrt(b^2 - a f) is the ray's slope against the surface, so its sign tells the roots apart. Each root
        is taken in the form without cancellation; for c -> 0 it goes over into the plane's without a switch.
        """
        if self.is_plane:
            length = -point[2] / direction[2]
            hit = point + length * direction
            hit[2] = np.where(np.isfinite(length), 0.0, np.nan)
            return length, hit
        cosine = direction[2]
        foot = -dot(point, direction)
        start = point + foot * direction
        a, b, f = self._equation(start, cosine)
        slope = np.sqrt(b * b - a * f)
        if root != "vertex":
            t = _crossing(a, b, f, np.where((a > 0.0) == (root == "near"), -slope, slope))
            return foot + t, start + t * direction
        slope = np.where(cosine > 0.0, -slope, slope)
        t = self._on_sheet(_crossing(a, b, f, slope), start, direction)
        length = foot + t
        behind = ~(length >= -BEHIND_TOLERANCE)
        if behind.any():
            other = self._on_sheet(_crossing(a, b, f, -slope), start, direction)
            t = np.where(behind & (foot + other >= -BEHIND_TOLERANCE), other, t)
            length = foot + t
        # From the near start, so that a source far away does not leave its rounding in the hit point.
        return length, start + t * direction

    def _equation(self, start: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """a, b and f (n,) of a t^2 + 2 b t + f = 0 for local rays from start (3, n) with slopes ``cosine`` along z."""
        c, k = self.curvature, self.conic
        if k == 0.0:
            return np.full_like(cosine, c), -cosine, c * dot(start, start) - 2.0 * start[2]
        a = c * (1.0 + k * cosine * cosine)
        b = (c * k * start[2] - 1.0) * cosine
        return a, b, c * (dot(start, start) + k * start[2] ** 2) - 2.0 * start[2]

    def _on_sheet(self, t: np.ndarray, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Lengths t (n,) of crossings start + t direction, (3, n) local, NaN where one is not of the vertex's sheet.

        Equator of the spheroid, or the gap between the hyperboloid's sheets: beyond it lies the other half.
        """
        if self.conic == -1.0:
            return t
        return np.where((1.0 + self.conic) * self.curvature * (start[2] + t * direction[2]) >= 1.0, np.nan, t)

    def crossings(self, point: np.ndarray, direction: np.ndarray, closed: bool) -> tuple[np.ndarray, np.ndarray]:
        """Lengths (2, n) [mm] along local rays to both crossings, rising, and the places (2, 3, n); NaN where none is.

        point, direction: (3, n), directions of unit length; lengths may be negative. closed: whether the whole quadric
        is meant; else only its sheet through the vertex, inside the outline.
        """
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            foot = -dot(point, direction)
            start = point + foot * direction
            c, k = self.curvature, self.conic
            a, b, f = self._equation(start, direction[2])
            q = -(b + np.copysign(np.sqrt(b * b - a * f), b))
            one, two = f / q, np.where(a == 0.0, np.nan, q / a)
            length = foot + np.stack([np.fmin(one, two), np.maximum(one, two)])  # NaN comes last
            hit = point[None] + length[:, None] * direction
            if not closed:
                beyond = (1.0 + k) * c * hit[:, 2] >= 1.0
                outside = np.zeros_like(beyond)
                if self.outline is not None:
                    outside = np.array([np.any(self.outline.margins(x, y) < 0, axis=0) for x, y, _ in hit])
                length = np.where(beyond | outside, np.nan, length)
        return length, hit


def _crossing(a: np.ndarray, b: np.ndarray, f: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The root t (n,) of a t^2 + 2 b t + f = 0 at which a t + b is ``slope``, without cancellation."""
    return np.where(b * slope >= 0.0, -f / (b + slope), (slope - b) / a)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products of vectors whose components are the first axis, (3, ...)."""
    product = a * b
    return product[0] + product[1] + product[2]
