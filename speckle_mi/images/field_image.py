"""A speckle image and the field behind it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError


class FieldImageError(InputError):
    """A file that is not a readable field image; the message says why."""


@dataclass(frozen=True)
class FieldImage:
    """A speckle image and the field behind it.

    intensity: (rows, columns) float32, averaged over the pixel; field: (rows, columns) complex, at the pixel's
    centre, None where a file has none; header: what the image is (units in the names). origin: (row, column) of the
    first pixel on the canvas, which has ``canvas`` (rows, columns) pixels; None where the image is all of it.
    """

    intensity: np.ndarray
    field: np.ndarray | None
    header: dict = field(default_factory=dict)
    origin: tuple[int, int] = (0, 0)
    canvas: tuple[int, int] | None = None
