"""Optical surfaces and the order in which light meets them.

A surface is a plane or a conic of revolution about the local z axis with its vertex at the frame's origin,

    c (x^2 + y^2) + c (1 + k) z^2 - 2 z = 0,

c the curvature [1/mm] (positive: centre of curvature on the +z side; 0: plane) and k the conic constant (0 sphere, -1
paraboloid, k < -1 hyperboloid). Lengths are mm.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from speckle_mi.geometry import Frame, PlaneGrid

ORTHONORMAL_TOLERANCE = 1e-6
"""Axes further from orthonormal than this are a mistake; closer ones are rounding and are made exact."""


@dataclass(frozen=True)
class Circle:
    """Rim x^2 + y^2 = radius^2 in the surface's local coordinates [mm]."""

    radius: float

    def __post_init__(self) -> None:
        if not self.radius > 0.0:
            raise ValueError(f"circle radius = {self.radius} mm: must be positive")

    @property
    def size(self) -> int:
        """Number of margin functions."""
        return 1

    def margins(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Signed clearance 1 - r^2/R^2, (1, n): positive inside, zero exactly on the rim, smooth everywhere."""
        return 1.0 - (x * x + y * y)[None] / self.radius**2

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the extent along x and y [mm]."""
        return self.radius, self.radius

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the middle [mm]."""
        return self.radius

    def clearance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance [mm] of places (n,) from the rim, (n,), negative outside."""
        return self.radius - np.hypot(x, y)

    def edge(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places x, y (n,) [mm] of the rim, seen from the middle at ``angle`` (n,) [rad]."""
        return self.radius * np.cos(angle), self.radius * np.sin(angle)


@dataclass(frozen=True)
class Rectangle:
    """Rim |x| = half_x, |y| = half_y in the surface's local coordinates [mm]."""

    half_x: float
    half_y: float

    def __post_init__(self) -> None:
        if not (self.half_x > 0.0 and self.half_y > 0.0):
            raise ValueError(f"rectangle half widths = ({self.half_x}, {self.half_y}) mm: both must be positive")

    @property
    def size(self) -> int:
        """Number of margin functions."""
        return 2

    def margins(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Signed clearances 1 - (x/half_x)^2 and 1 - (y/half_y)^2, (2, n).

        Two functions, not their minimum, which has kinks, nor their product, which is positive again outside a corner.
        """
        return np.stack([1.0 - (x / self.half_x) ** 2, 1.0 - (y / self.half_y) ** 2])

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the extent along x and y [mm]."""
        return self.half_x, self.half_y

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the middle [mm]."""
        return float(np.hypot(self.half_x, self.half_y))

    def clearance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance [mm] of places (n,) inside from the rim, (n,), negative outside."""
        return np.minimum(self.half_x - np.abs(x), self.half_y - np.abs(y))

    def edge(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places x, y (n,) [mm] of the rim, for angles (n,) [rad] of a square's rim that is stretched to this one."""
        x, y = np.cos(angle), np.sin(angle)
        largest = np.maximum(np.abs(x), np.abs(y))
        return self.half_x * x / largest, self.half_y * y / largest


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
    outline: Circle | Rectangle | None = None

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

    def sag(self, squared: np.ndarray) -> np.ndarray:
        """Height (n,) [mm] above the vertex plane at squared distances (n,) [mm^2] from the axis.

        c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)); beyond the equator, where there is no surface, the root counts as 0.
        """
        c, k = self.curvature, self.conic
        return c * squared / (1 + np.sqrt(np.maximum(1 - (1 + k) * c * c * squared, 0.0)))

    def gradient(self, point: np.ndarray) -> np.ndarray:
        """Half the gradient of the surface's equation at local points (3, n), (3, n); its length is 1 at the vertex."""
        c = self.curvature
        return np.stack([c * point[0], c * point[1], c * (1.0 + self.conic) * point[2] - 1.0])

    def intersect(
        self, point: np.ndarray, direction: np.ndarray, root: str = "vertex"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Length (n,) [mm] along local rays to the surface and the hit points (3, n), NaN where there are none.

        point, direction: (3, n), directions of unit length. root: which of the two crossings of the quadric,
        "vertex": the one met on the sheet through the vertex, crossed in the direction the ray has along z;
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
        c, k, cosine = self.curvature, self.conic, direction[2]
        foot = -dot(point, direction)
        start = point + foot * direction
        a = c * (1.0 + k * cosine * cosine)
        b = (c * k * start[2] - 1.0) * cosine
        f = c * (dot(start, start) + k * start[2] ** 2) - 2.0 * start[2]
        slope = np.sqrt(b * b - a * f)
        if root == "vertex":
            slope = np.where(cosine > 0.0, -slope, slope)
        else:
            slope = np.where((a > 0.0) == (root == "near"), -slope, slope)
        t = np.where(b * slope >= 0.0, -f / (b + slope), (slope - b) / a)
        if root == "vertex" and k != -1.0:
            # Equator of the spheroid, or the gap between the hyperboloid's sheets: beyond it lies the other half.
            beyond = (1.0 + k) * c * (start[2] + t * cosine) >= 1.0
            t = np.where(beyond, np.nan, t)
        # From the near start, so that a source far away does not leave its rounding in the hit point.
        return foot + t, start + t * direction


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products of vectors whose components are the first axis, (3, ...)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True, eq=False)
class Interaction:
    """What happens to light at a surface.

    action: "refract" (Snell's law), "reflect" (mirror), "pass" (a place the light goes straight through: an aperture, a
    reference plane, the detector); index_before, index_after: refractive indices of the segments on its way in and out;
    root: which crossing of the surface is meant, see ``Surface.intersect``.
    Build with ``Interaction.refract``, ``.reflect``, ``.through``.
    """

    surface: Surface
    action: Literal["refract", "reflect", "pass"]
    index_before: float = 1.0
    index_after: float = 1.0
    root: Literal["vertex", "near", "far"] = "vertex"

    def __post_init__(self) -> None:
        if self.action not in ("refract", "reflect", "pass"):
            raise ValueError(f"interaction {self.action!r}: must be one of refract, reflect, pass")
        if self.root not in ("vertex", "near", "far"):
            raise ValueError(f"root {self.root!r}: must be one of vertex, near, far")
        if not (self.index_before > 0.0 and self.index_after > 0.0):
            raise ValueError(
                f"refractive indices {self.index_before}, {self.index_after}: must be positive (a mirror is 'reflect')"
            )
        if self.action != "refract" and self.index_before != self.index_after:
            raise ValueError(
                f"{self.action} with indices {self.index_before}, {self.index_after}: "
                "the medium changes only by refraction"
            )
        if self.root != "vertex" and not (self.surface.curvature != 0.0 and self.surface.conic > -1.0):
            raise ValueError(
                f"root {self.root!r} needs a closed surface: a sphere or spheroid (curvature not 0, conic > -1)"
            )

    @classmethod
    def refract(cls, surface: Surface, index_before: float, index_after: float, root: str = "vertex") -> Interaction:
        """Refraction from ``index_before`` into ``index_after``."""
        return cls(surface, "refract", index_before, index_after, root)

    @classmethod
    def reflect(cls, surface: Surface, index: float = 1.0, root: str = "vertex") -> Interaction:
        """Mirror inside a medium of ``index``. The mirror's own phase, the same for all rays, is left out."""
        return cls(surface, "reflect", index, index, root)

    @classmethod
    def through(cls, surface: Surface, index: float = 1.0) -> Interaction:
        """A surface that changes nothing: an opening, a reference plane, the detector."""
        return cls(surface, "pass", index, index)


def detector_plane(grid: PlaneGrid) -> Interaction:
    """The detector's plane as the end of a sequence."""
    return Interaction.through(Surface(Frame(grid.centre, np.stack([grid.u, grid.v, grid.normal], axis=1))))


@dataclass(frozen=True, eq=False)
class Sequence:
    """Interactions in the order in which light meets them.

    Raises ValueError when empty or when one interaction's medium is not the next one's.
    """

    interactions: tuple[Interaction, ...]
    rims: tuple[tuple[int, int], ...] = field(init=False)
    """One (interaction, component) per row of every ``margins`` array; a circle has one, a rectangle two (x, y)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "interactions", tuple(self.interactions))
        if not self.interactions:
            raise ValueError("optical sequence is empty: it must at least hold the plane where the light ends")
        for i, (one, two) in enumerate(zip(self.interactions, self.interactions[1:], strict=False)):
            if one.index_after != two.index_before:
                raise ValueError(
                    f"optical sequence: index {one.index_after} after interaction {i} "
                    f"but {two.index_before} before interaction {i + 1}"
                )
        rims = [
            (i, j)
            for i, one in enumerate(self.interactions)
            if one.surface.outline
            for j in range(one.surface.outline.size)
        ]
        object.__setattr__(self, "rims", tuple(rims))

    @property
    def size(self) -> int:
        return len(self.interactions)

    @property
    def last(self) -> Interaction:
        return self.interactions[-1]
