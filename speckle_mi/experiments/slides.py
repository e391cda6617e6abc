"""Small 8-bit pictures of a sweep's first surface, taken as its frames pass by: what a report turns the pages of."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..images.field_image import FieldImage
from ..images.levels import block_means, root_levels, white_level
_BYTES = 2_000_000
"""Of the pictures of all detectors together, as they are before any compression."""

_MOST_STEPS = 25
"""Displacements of a motion that are kept, evenly spread over its range."""

_LARGEST, _SMALLEST = 192, 48
"""Side of the window that is kept [px]."""

_OVERVIEW = 512
"""Longer side of the whole image at rest [px]."""

_SAME_LIGHT = 0.05
"""Difference from the field's own intensity, over its mean, from which an image is kept besides the field."""


@dataclass(frozen=True)
class Slide:
    """One frame's window, (rows, columns) uint8 each.

    light: root of the image over its white level, 255 at white; phase: of the field, a turn in 256 steps from -pi;
    amplitude: of the field, over its own white level; None where ``light`` is the same, or there is no field.
    """

    displacement: float
    light: np.ndarray
    phase: np.ndarray | None
    amplitude: np.ndarray | None


@dataclass
class Slides:
    """dofs, every displacement (n,) [mm or deg]: of the sweep; seed: of the surface whose pictures are kept; share: of
    several detectors, each one's part of the room.

    rest: the frame at rest; motions: dof -> frames in the order they came; overview: the whole image at rest, root of
    the light as in a slide, (rows, columns) uint8, each pixel the mean of ``reduced`` x ``reduced``; corner: (row,
    column) of the windows' first pixel on the detector; missing: frames that would be here but never passed by.
    """

    dofs: tuple[str, ...]
    every: np.ndarray
    seed: int
    share: float = 1.0
    rest: Slide | None = None
    motions: dict[str, list[Slide]] = field(default_factory=dict)
    overview: np.ndarray | None = None
    reduced: int = 1
    corner: tuple[int, int] = (0, 0)
    _white: tuple[float, float] = (1.0, 1.0)
    _is_apart: bool = False
    _side: tuple[int, int] = (0, 0)

    def add(self, dof: str | None, displacement: float, seed: int, image: FieldImage) -> None:
        """Takes the picture of a frame, the one at rest (``dof`` None) first; of other surfaces, nothing."""
        if seed != self.seed:
            return
        if dof is None:
            self._begin(image)
            self.rest = self._slide(0.0, image)
        elif self.rest is not None and displacement in self.displacements:
            self.motions.setdefault(dof, []).append(self._slide(displacement, image))

    @property
    def displacements(self) -> list[float]:
        """Those that are kept."""
        affordable = int(_BYTES * self.share / (3 * _SMALLEST**2 * len(self.dofs)))
        count = min(len(self.every), max(2, min(_MOST_STEPS, affordable)))
        return [float(self.every[place]) for place in np.linspace(0, len(self.every) - 1, count).round().astype(int)]

    @property
    def missing(self) -> int:
        wanted = len(self.displacements) * len(self.dofs)
        return wanted - sum(map(len, self.motions.values()))

    def _begin(self, image: FieldImage) -> None:
        measured = np.asarray(image.measured, dtype=np.float64)
        amplitude = None if image.field is None else np.abs(image.field)
        self._white = (white_level(measured), 1.0 if amplitude is None else white_level(amplitude))
        self._is_apart = amplitude is not None and (
            image.dn is not None
            or float(np.abs(measured - amplitude**2).mean()) > _SAME_LIGHT * max(float(measured.mean()), 1e-300)
        )
        planes = 1 + (image.field is not None) + self._is_apart
        pictures = 1 + len(self.displacements) * len(self.dofs)
        side = int(np.clip(np.sqrt(_BYTES * self.share / (planes * pictures)), _SMALLEST, _LARGEST))
        rows, columns = measured.shape
        self._side = min(side, rows), min(side, columns)
        self.corner = around_light(measured, self._side)
        self.reduced = max(1, -(-max(rows, columns) // max(int(_OVERVIEW * np.sqrt(self.share)), 64)))
        self.overview = root_levels(block_means(measured, self.reduced), self._white[0])

    def _slide(self, displacement: float, image: FieldImage) -> Slide:
        row, column = self.corner
        cut = np.s_[row : row + self._side[0], column : column + self._side[1]]
        light = root_levels(image.measured[cut], self._white[0])
        if image.field is None:
            return Slide(displacement, light, None, None)
        complex_field = image.field[cut]
        phase = np.round((np.angle(complex_field) + np.pi) * (256 / (2 * np.pi))).astype(np.int64) % 256
        amplitude = None
        if self._is_apart:
            amplitude = np.clip(np.round(255 * np.abs(complex_field) / self._white[1]), 0, 255).astype(np.uint8)
        return Slide(displacement, light, phase.astype(np.uint8), amplitude)


def around_light(measured: np.ndarray, side: tuple[int, int]) -> tuple[int, int]:
    """Corner of the window around the light's centre, within the image."""
    weights = np.nan_to_num(measured)
    total = weights.sum()
    corner = []
    for axis, length in enumerate(side):
        size = measured.shape[axis]
        centre = (size - 1) / 2 if not total > 0 else float(weights.sum(axis=1 - axis) @ np.arange(size) / total)
        corner.append(int(np.clip(round(centre - length / 2), 0, size - length)))
    return corner[0], corner[1]
