"""Even aspheres: conics of revolution with a polynomial in the squared distance from the axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .height_surface import FLAT, HeightSurface
from .surface import Surface


MOST_COEFFICIENTS = 10
"""Coefficients of one surface: up to r^22."""


@dataclass(frozen=True, eq=False)
class EvenAsphere(HeightSurface):
    """z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)) + a1 r^4 + a2 r^6 + ...

    coefficients: a1, a2, ... [mm^-3, mm^-5, ...].
    """

    coefficients: tuple[float, ...] = ()

    @property
    def is_plane(self) -> bool:
        return self.curvature == 0.0 and not any(self.coefficients)

    def _by_square(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Height at squared distances s from the axis, and its first and second derivative by s."""
        c, k = self.curvature, self.conic
        root = np.sqrt(np.maximum(1 - (1 + k) * c * c * s, FLAT))
        height, first, second = c * s / (1 + root), c / (2 * root), (1 + k) * c**3 / (4 * root**3)
        for number, a in enumerate(self.coefficients, start=2):
            power = s ** (number - 2)
            height = height + a * power * s * s
            first = first + number * a * power * s
            second = second + number * (number - 1) * a * power
        return height, first, second

    def _slopes(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        height, first, _ = self._by_square(x * x + y * y)
        return height, 2 * x * first, 2 * y * first

    def _bends(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        _, first, second = self._by_square(x * x + y * y)
        return 2 * first + 4 * x * x * second, 4 * x * y * second, 2 * first + 4 * y * y * second

    @property
    def widest(self) -> float:
        """Short of the conic's equator, where an even asphere turns vertical."""
        return super().widest * (1 - 1e-6)

    def turned(self) -> EvenAsphere:
        return replace(self, curvature=-self.curvature, coefficients=tuple(-a for a in self.coefficients))

    def same_form(self, other: Surface, reach: float, tolerance: float) -> bool:
        if not super().same_form(other, reach, tolerance):
            return False
        size = max(len(self.coefficients), len(other.coefficients))
        mine, its = (np.pad(one.coefficients, (0, size - len(one.coefficients))) for one in (self, other))
        return bool(np.sum(np.abs(mine - its) * reach ** (2 * np.arange(2, size + 2))) < tolerance)
