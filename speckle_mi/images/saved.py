"""A camera's picture as it saves it: PNG or TIFF of 8 bits, or of 16 for a converter of more than 8."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..machine.files import replacing
from .camera import Camera
from .field_image import FieldImage

KINDS = ("png", "tiff")


def require_saving(camera: Camera | None, where: str = "the detector") -> None:
    """InputError for a detector that saves no picture: one without a camera, or without a converter."""
    if camera is None:
        raise InputError(f"--images: {where} has no camera, must be given a bit_depth (8 or 12, say)")
    if not camera.bit_depth:
        raise InputError(f"--images: {where} has a camera of no bit_depth, must be given one (8 or 12, say)")


def write_picture(path: str | os.PathLike, image: FieldImage) -> None:
    """Writes the numbers of an image, whole or not at all: as they are, those of 9 to 16 bits as 16 bits.

    The name's end tells the format. Raises ValueError for an image without numbers of so many bits.
    """
    if image.dn is None or not 0 <= image.dn.min() <= image.dn.max() < 1 << 16:
        raise ValueError("image: must have a camera's numbers of at most 16 bits")
    bits = image.header.get("camera", {}).get("bit_depth") or 16
    numbers = image.dn.astype(np.uint8 if bits <= 8 else np.uint16)
    with replacing(path) as temporary:
        if Path(path).suffix == ".png":
            from PIL import Image

            Image.fromarray(numbers).save(temporary, format="png")
        else:
            import tifffile

            tifffile.imwrite(temporary, numbers, photometric="minisblack")
