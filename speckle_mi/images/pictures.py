"""Any picture as an image of intensity: field images, OpenEXR files of other programs, PNG, TIFF and JPEG files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..machine.memory import excess
from .exr import LUMINANCE, is_exr, read_field
from .field_image import FieldImage, FieldImageError

_BYTES_WHILE_READING = 16
"""Memory of one value while it is read: as it comes, in double precision and as it is kept."""


def read_image(path: str | os.PathLike) -> FieldImage:
    """Reads an image; colours become luminance (Rec. 709). Values are taken as they are stored, as intensities.

    What is not OpenEXR has neither field nor header. Raises FieldImageError with one line that says what is wrong.
    """
    if not os.fspath(path):
        raise FieldImageError("'': must be the name of an image")
    path = Path(path)
    if not path.is_file() or is_exr(path):
        return read_field(path)
    import imageio.v3  # what scikit-image reads with

    try:
        shape = imageio.v3.improps(path).shape
        if too_much := excess(_BYTES_WHILE_READING * float(np.prod(shape, dtype=float))):
            raise FieldImageError(f"{path}: its {shape[1]} x {shape[0]} pixels {too_much}")
        values = np.asarray(imageio.v3.imread(path))
    except FieldImageError:
        raise
    except Exception as error:  # every format's reader raises its own
        raise FieldImageError(f"{path}: is no image or a damaged one, must be OpenEXR, PNG, TIFF or JPEG") from error
    if values.ndim == 3 and values.shape[2] in (2, 4):
        values = values[..., :-1]  # without opacity
    if values.ndim == 3 and values.shape[2] in (1, 3):
        values = values[..., 0] if values.shape[2] == 1 else values @ np.array(list(LUMINANCE.values()))
    if values.ndim != 2 or values.dtype.kind not in "biuf" or values.size == 0:
        raise FieldImageError(f"{path}: has values of shape {values.shape}, must be one picture, grey or in colours")
    return FieldImage(values.astype(np.float32), None)
