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
    centre, None where a file has none; header: what the image is (units in the names).
    """

    intensity: np.ndarray
    field: np.ndarray | None
    header: dict = field(default_factory=dict)
