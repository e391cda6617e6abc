"""A lens as its drawing describes it: surfaces behind one another on one axis, and the glass between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.frames import Frame
from .glass import Glass
from .surface import Surface

ROUNDING = 1e-12
"""Relative excess of a diameter over a full hemisphere, or of one surface over the next, that is only rounding."""

_GAP_SAMPLES = 4097
"""Radii at which the thickness of the glass is looked at."""

_GAP_ANGLES = 31
"""Angles about the axis, over a quarter, at which that of cylinders is."""


@dataclass(frozen=True, eq=False)
class Prescription:
    """Surfaces of a lens and what is between them.

    surfaces: in the order of the local z axis, each with its round rim, in a frame of its own that is the same for all;
    thicknesses: (n - 1) distances of their vertices [mm]; glasses: (n - 1) media between them.
    """

    surfaces: tuple[Surface, ...]
    thicknesses: tuple[float, ...]
    glasses: tuple[Glass, ...]

    def reversed(self) -> Prescription:
        """The lens turned round: its last surface comes first, with its vertex at the origin."""
        surfaces = tuple(surface.turned() for surface in self.surfaces[::-1])
        return Prescription(surfaces, self.thicknesses[::-1], self.glasses[::-1])

    def placed(self, frame: Frame) -> tuple[Surface, ...]:
        """The surfaces in the world, the first vertex at the frame's origin, the axis along its z."""
        heights = np.concatenate([[0.0], np.cumsum(self.thicknesses)])
        axis = frame.axes[:, 2]
        return tuple(
            replace(surface, frame=Frame(frame.origin + height * axis, frame.axes))
            for surface, height in zip(self.surfaces, heights, strict=True)
        )

    def thinnest(self, number: int) -> tuple[float, float]:
        """Least thickness [mm] of the medium behind surface ``number``, and the distance from the axis [mm] of it.

        Beyond the rim of a surface the glass goes on level with the rim, to the wider rim of the two.
        """
        pair = self.surfaces[number : number + 2]
        reach = max(one.outline.reach for one in pair)
        r = reach * np.sin(np.linspace(0, np.pi / 2, _GAP_SAMPLES))
        angles = [0.0] if all(one.has_flat_rim for one in pair) else np.linspace(0, np.pi / 2, _GAP_ANGLES)
        found = []
        for angle in angles:
            front, back = (_height(one, r, angle) for one in pair)
            glass = self.thicknesses[number] + back - front
            at = int(np.argmin(glass))
            found.append((float(glass[at]), float(r[at])))
        return min(found)


def _height(surface: Surface, r: np.ndarray, angle: float) -> np.ndarray:
    """Height (n,) [mm] of a surface and of the level ring around its rim at distances r (n,) from the axis."""
    r = np.minimum(r, surface.outline.reach)
    return surface.sag(r * np.cos(angle), r * np.sin(angle))
