"""Field images on disk: OpenEXR files with the channels Y, E.re and E.im and a header that says what they are."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import OpenEXR

from .files import replacing

_DETAILS = "speckle_mi"
_LARGEST_INT = 2**31 - 1


class FieldImageError(ValueError):
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


def write_field(path: str | os.PathLike, image: FieldImage, layers: dict[str, np.ndarray] | None = None) -> None:
    """Writes a field image, whole or not at all.

    ``layers`` maps names to further complex fields (rows, columns), stored as channels ``name.re`` and ``name.im``.
    Single precision is not compressed: the mantissas of speckle fields are noise, which compresses by 2 percent
    in ten times the time.
    """
    channels = {"Y": np.ascontiguousarray(image.intensity, dtype=np.float32)}
    for name, values in {"E": image.field, **(layers or {})}.items():
        channels[f"{name}.re"] = np.ascontiguousarray(values.real, dtype=np.float32)
        channels[f"{name}.im"] = np.ascontiguousarray(values.imag, dtype=np.float32)
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {name: _attribute(value) for name, value in image.header.items()}
    # OpenEXR stores floating-point attributes in single precision; this one holds every field as it was.
    header[_DETAILS] = json.dumps(image.header)
    with replacing(path) as temporary, OpenEXR.File(header, channels) as file:
        file.write(str(temporary))


def read_field(path: str | os.PathLike) -> FieldImage:
    """Reads a field image. Raises FieldImageError with one line that says what is wrong with the file."""
    path = Path(path)
    if not path.is_file():
        raise FieldImageError(f"{path}: there is no such file")
    if not OpenEXR.isOpenExrFile(str(path)):
        raise FieldImageError(f"{path}: not an OpenEXR file")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
            attributes = dict(file.header())  # the file empties its own when it is closed
    except Exception as error:  # the reader raises RuntimeError, ValueError and others of its own
        raise FieldImageError(f"{path}: cannot be read, the file is damaged or cut short ({error})") from None
    complex_field = None
    if "E.re" in channels and "E.im" in channels:
        complex_field = channels["E.re"].astype(np.complex64)
        complex_field.imag = channels["E.im"]
    if "Y" in channels:
        intensity = channels["Y"].astype(np.float32)
    elif complex_field is not None:
        intensity = np.abs(complex_field) ** 2
    else:
        names = ", ".join(sorted(channels)) or "none"
        raise FieldImageError(f"{path}: has the channels {names}, must have Y (intensity) or E.re and E.im (field)")
    return FieldImage(intensity, complex_field, _header(attributes))


def _attribute(value: object) -> object:
    """A header value in a type that OpenEXR and its viewers know."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return value if abs(value) <= _LARGEST_INT else str(value)
    if isinstance(value, (float, str)):
        return value
    return json.dumps(value)


def _header(attributes: dict) -> dict:
    """The exact header if the file is ours, else its plain attributes."""
    try:
        details = json.loads(attributes.get(_DETAILS, ""))
        if isinstance(details, dict):
            return details
    except (TypeError, ValueError):
        pass
    return {name: value for name, value in attributes.items() if isinstance(value, (int, float, str))}
