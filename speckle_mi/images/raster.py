"""PNG, JPEG and whatever else Pillow opens, with all the bits and in the orientation that the file gives."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np

from ..machine.memory import excess
from .colours import luminance
from .field_image import FieldImageError
from .pages import BYTES_WHILE_READING, damaged, oriented, page_number

_PNG = b"\x89PNG\r\n\x1a\n"

_ORIENTATION = 274

_COLOURLESS = ("1", "L", "I", "F")
"""Modes of Pillow that are numbers already; "I;16" and its like too."""


def read_raster(path: Path, page: int | None) -> np.ndarray:
    """Intensity (rows, columns) of a picture, in the file's unit. Raises FieldImageError."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Pillow's own limit on pixels: the memory there is decides
            with Image.open(path) as picture:
                picture.seek(page_number(path, getattr(picture, "n_frames", 1), page))
                if too_much := excess(
                    BYTES_WHILE_READING * float(picture.width) * picture.height * len(picture.getbands())
                ):
                    raise FieldImageError(f"{path}: its {picture.width} x {picture.height} pixels {too_much}")
                orientation = int(picture.getexif().get(_ORIENTATION, 1) or 1)
                values = _deep_colours(path) if _is_deep_colour_png(path) else _values(picture)
    except FieldImageError:
        raise
    except Exception as error:  # every format's reader raises its own
        raise damaged(path, error) from error
    return oriented(values, orientation)


def _values(picture) -> np.ndarray:
    mode = picture.mode
    if mode in _COLOURLESS or mode.startswith("I;16"):
        return np.asarray(picture)
    if mode in ("LA", "La"):
        return np.asarray(picture)[..., 0]
    if mode == "PA" or (mode == "P" and "transparency" in picture.info):
        picture = picture.convert("RGBA")
    return luminance(np.asarray(picture.convert("RGB")))


def _is_deep_colour_png(path: Path) -> bool:
    """Whether a file is a PNG of colours, or of grey with opacity, of 16 bits, of which Pillow keeps 8."""
    with open(path, "rb") as file:
        start = file.read(26)
    if len(start) < 26 or not start.startswith(_PNG):
        return False
    depth, colour = struct.unpack(">BB", start[24:26])
    return depth == 16 and colour in (2, 4, 6)


def _deep_colours(path: Path) -> np.ndarray:
    import imagecodecs

    values = imagecodecs.png_decode(path.read_bytes())
    if values.ndim == 2:
        return values
    return values[..., 0] if values.shape[2] < 3 else luminance(values[..., :3])
