"""Any picture as an image of intensity: field images, OpenEXR files of other programs, TIFF, PNG, JPEG and others."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from .exr import is_exr, read_field
from .field_image import FieldImage, FieldImageError
from .raster import read_raster
from .tiff import is_tiff, read_tiff


def read_image(path: str | os.PathLike, page: int | None = None, channel: str | None = None) -> FieldImage:
    """Reads an image; colours become luminance (Rec. 709). Values are taken as they are stored, as intensities.

    page: which one of a file that holds several, from 1. channel: of an OpenEXR file, a channel or a layer by name.
    What is not OpenEXR has neither field nor header. Raises FieldImageError with one line that says what is wrong.
    """
    if not os.fspath(path):
        raise FieldImageError("'': must be the name of an image")
    path = Path(path)
    if not path.is_file() or is_exr(path):
        return read_field(path, channel, page)
    if channel is not None:
        raise FieldImageError(
            f"{path}: is not OpenEXR and has no channels by name, --channel {channel} must be left out"
        )
    with open(path, "rb") as file:
        start = file.read(8)
    values = read_tiff(path, page) if is_tiff(start) else read_raster(path, page)
    if values.ndim != 2 or values.dtype.kind not in "biuf" or values.size == 0:
        raise FieldImageError(f"{path}: has values of shape {values.shape}, must be one picture, grey or in colours")
    return FieldImage(np.ascontiguousarray(values, dtype=np.float32), None)
