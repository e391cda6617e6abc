"""Cylinders: conics curved along one local axis only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .height_surface import FLAT, HeightSurface
from .surface import Surface


@dataclass(frozen=True, eq=False)
class Cylinder(HeightSurface):
    """z = c s^2 / (1 + sqrt(1 - (1 + k) c^2 s^2)) with s the local x (``axis`` 0) or y (1)."""

    axis: int = 0

    @property
    def has_flat_rim(self) -> bool:
        return False

    def _slopes(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s = (x, y)[self.axis]
        c, root = self.curvature, self._root_at(s)
        slope, none = c * s / root, np.zeros_like(x + y)
        height = c * s * s / (1 + root) + none
        return (height, slope + none, none) if self.axis == 0 else (height, none, slope + none)

    def _bends(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        none = np.zeros_like(x)
        bend = self.curvature / self._root_at((x, y)[self.axis]) ** 3
        return (bend, none, none) if self.axis == 0 else (none, none, bend)

    def _root_at(self, s: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(1 - (1 + self.conic) * (self.curvature * s) ** 2, FLAT))

    def turned(self) -> Cylinder:
        return replace(self, curvature=-self.curvature)

    def same_form(self, other: Surface, reach: float, tolerance: float) -> bool:
        return super().same_form(other, reach, tolerance) and self.axis == other.axis
