"""Outlines of openings and elements: circle, circle off the axis, rectangle, with signed clearances. Lengths are mm.

``centre`` is the middle (x, y) of an outline in the surface's local coordinates, ``half_size`` half its extent along x
and y from there, ``reach`` the distance of its farthest point from the local origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Circle:
    """Rim x^2 + y^2 = radius^2 in the surface's local coordinates [mm]."""

    radius: float
    is_round = True

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
    def centre(self) -> tuple[float, float]:
        """Middle (x, y) [mm]."""
        return 0.0, 0.0

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the extent along x and y [mm]."""
        return self.radius, self.radius

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the local origin [mm]."""
        return self.radius

    def clearance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance [mm] of places (n,) from the rim, (n,), negative outside."""
        return self.radius - np.hypot(x, y)

    def edge(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places x, y (n,) [mm] of the rim, seen from the middle at ``angle`` (n,) [rad]."""
        return self.radius * np.cos(angle), self.radius * np.sin(angle)


@dataclass(frozen=True)
class OffsetCircle:
    """Rim (x - centre x)^2 + (y - centre y)^2 = radius^2 in the surface's local coordinates [mm].

    The rim of a part cut out of a surface of revolution beside its axis. Not a ``Circle``: what holds for rotational
    symmetry about the axis does not hold for it.
    """

    radius: float
    centre: tuple[float, float]
    is_round = True

    def __post_init__(self) -> None:
        if not self.radius > 0.0:
            raise ValueError(f"circle radius = {self.radius} mm: must be positive")
        if not np.all(np.isfinite(self.centre)):
            raise ValueError(f"circle centre = {self.centre} mm: must be finite")

    @property
    def size(self) -> int:
        """Number of margin functions."""
        return 1

    def margins(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Signed clearance 1 - |r - c|^2/R^2, (1, n): positive inside, zero exactly on the rim, smooth everywhere."""
        dx, dy = x - self.centre[0], y - self.centre[1]
        return 1.0 - (dx * dx + dy * dy)[None] / self.radius**2

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the extent along x and y [mm]."""
        return self.radius, self.radius

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the local origin [mm]."""
        return float(np.hypot(*self.centre)) + self.radius

    def clearance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance [mm] of places (n,) from the rim, (n,), negative outside."""
        return self.radius - np.hypot(x - self.centre[0], y - self.centre[1])

    def edge(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places x, y (n,) [mm] of the rim, seen from its centre at ``angle`` (n,) [rad]."""
        return self.centre[0] + self.radius * np.cos(angle), self.centre[1] + self.radius * np.sin(angle)


@dataclass(frozen=True)
class Rectangle:
    """Rim |x| = half_x, |y| = half_y in the surface's local coordinates [mm]."""

    half_x: float
    half_y: float
    is_round = False

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
    def centre(self) -> tuple[float, float]:
        """Middle (x, y) [mm]."""
        return 0.0, 0.0

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the extent along x and y [mm]."""
        return self.half_x, self.half_y

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the local origin [mm]."""
        return float(np.hypot(self.half_x, self.half_y))

    def clearance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Distance [mm] of places (n,) inside from the rim, (n,), negative outside."""
        return np.minimum(self.half_x - np.abs(x), self.half_y - np.abs(y))

    def edge(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places x, y (n,) [mm] of the rim, for angles (n,) [rad] of a square's rim that is stretched to this one."""
        x, y = np.cos(angle), np.sin(angle)
        largest = np.maximum(np.abs(x), np.abs(y))
        return self.half_x * x / largest, self.half_y * y / largest
