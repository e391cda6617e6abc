"""A speckle image and the field behind it."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field

import numpy as np

from ..errors import InputError


class FieldImageError(InputError):
    """A file that is not a readable field image; the message says why."""


@dataclass(frozen=True)
class FieldImage:
    """A speckle image and the field behind it.

    intensity: (rows, columns) float32, averaged over the pixel; field: (rows, columns) complex, at the pixel's
    centre, None where a file has none; header: what the image is (units in the names). origin: (row, column) of the
    first pixel on the canvas, which has ``canvas`` (rows, columns) pixels; None where the image is all of it. dn:
    (rows, columns) float32, the numbers that a camera hands out; None where none is described. layers: further complex
    fields (rows, columns) by name, of every laser or line where there are several.
    """

    intensity: np.ndarray
    field: np.ndarray | None
    header: dict = dataclass_field(default_factory=dict)
    origin: tuple[int, int] = (0, 0)
    canvas: tuple[int, int] | None = None
    dn: np.ndarray | None = None
    layers: dict[str, np.ndarray] = dataclass_field(default_factory=dict)

    @property
    def measured(self) -> np.ndarray:
        """(rows, columns) float32, what there is to look at: the camera's numbers, without one the intensity."""
        return self.intensity if self.dn is None else self.dn
