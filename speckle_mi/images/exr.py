"""Field images on disk: OpenEXR files with the channels Y, E.re and E.im and a header that says what they are."""

from __future__ import annotations

import json
import os
from pathlib import Path

import OpenEXR
import numpy as np

from ..machine.files import replacing
from ..machine.memory import excess
from .exr_layout import damage
from .field_image import FieldImage, FieldImageError

_DETAILS = "speckle_mi"

LUMINANCE = {"R": 0.2126, "G": 0.7152, "B": 0.0722}
"""Weights of the colours in an image's intensity, for the primaries that OpenEXR assumes (Rec. 709)."""

_LARGEST_INT = 2**31 - 1

LARGEST_RATIO = 2000
"""Largest ratio of an image's values to the file that holds them, both in bytes."""

_BYTES_WHILE_READING = 8
"""Memory of one value while it is read: as it comes and as it is kept, both single precision."""


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
    """Reads a field image. Raises FieldImageError with one line that says what is wrong with the file.

    Of a damaged file of compressed pixels, which ours are not, OpenEXR itself prints more to stderr.
    """
    path = Path(path)
    if not path.is_file():
        what = "is not a file" if path.exists() else "there is no such file"
        raise FieldImageError(f"{path}: {what}, must be an image")
    if not is_exr(path):
        raise FieldImageError(f"{path}: not an OpenEXR file")
    channels, attributes = _read(path)
    complex_field = None
    if "E.re" in channels and "E.im" in channels:
        complex_field = channels["E.re"].astype(np.complex64)
        complex_field.imag = channels["E.im"]
    if "Y" in channels:
        intensity = channels["Y"].astype(np.float32)
    elif complex_field is not None:
        intensity = np.abs(complex_field) ** 2
    elif {"R", "G", "B"} <= set(channels):
        intensity = sum(weight * channels[name].astype(np.float32) for name, weight in LUMINANCE.items())
    else:
        names = ", ".join(sorted(channels)) or "none"
        raise FieldImageError(
            f"{path}: has the channels {names}, must have Y (intensity), E.re and E.im (field) or R, G and B"
        )
    return FieldImage(intensity, complex_field, _header(attributes))


def is_exr(path: str | os.PathLike) -> bool:
    """Whether a file begins as OpenEXR files do."""
    return OpenEXR.isOpenExrFile(str(path))


def read_header(path: str | os.PathLike) -> dict:
    """What the header of a field image says, without its pixels. Raises FieldImageError."""
    path = Path(path)
    if not path.is_file() or not is_exr(path):
        raise FieldImageError(f"{path}: not an OpenEXR file")
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            attributes = dict(file.header())
    except Exception as error:
        raise FieldImageError(f"{path}: cannot be read, its header is damaged ({_first_line(error)})") from None
    return _header(attributes)


def _read(path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """Pixels of every channel, and the attributes of the header."""
    _check_size(path)
    if what := damage(path):
        raise FieldImageError(f"{path}: cannot be read, {what}")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
            return channels, dict(file.header())  # the file empties its own when it is closed
    except Exception as error:  # the reader raises RuntimeError, ValueError and others of its own
        raise FieldImageError(
            f"{path}: cannot be read, the file is damaged or cut short ({_first_line(error)})"
        ) from None


def _check_size(path: Path) -> None:
    """FieldImageError where a header promises more pixels than the file can hold: the reader would take the memory."""
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            (left, top), (right, bottom) = (tuple(int(x) for x in corner) for corner in file.header()["dataWindow"])
            channels = len(file.header()["channels"])
    except Exception as error:
        raise FieldImageError(f"{path}: cannot be read, its header is damaged ({_first_line(error)})") from None
    columns, rows, size = right - left + 1, bottom - top + 1, path.stat().st_size
    # Two bytes a half-precision value, and no codec of OpenEXR packs a thousand of them into one.
    if columns < 1 or rows < 1 or 2 * columns * rows * max(channels, 1) > LARGEST_RATIO * size:
        raise FieldImageError(
            f"{path}: cannot be read, its header says {columns} x {rows} pixels in {channels} channels, "
            f"which {size} bytes cannot hold"
        )
    if too_much := excess(_BYTES_WHILE_READING * columns * rows * channels):
        raise FieldImageError(f"{path}: its {columns} x {rows} pixels in {channels} channels {too_much}")


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


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
