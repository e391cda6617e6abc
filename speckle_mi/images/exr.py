"""Field images on disk: OpenEXR files with the channels Y, E.re, E.im and a header that says what they are; a camera's
numbers stand in the channel DN."""

from __future__ import annotations

import json
import os
from pathlib import Path

import OpenEXR
import numpy as np

from ..machine.files import replacing
from ..machine.memory import excess
from .exr_layout import damage
from .colours import LUMINANCE, luminance_weights
from .field_image import FieldImage, FieldImageError
from .pages import first_line, page_number

_DETAILS = "speckle_mi"

_LARGEST_INT = 2**31 - 1

LARGEST_RATIO = 2000
"""Largest ratio of an image's values to the file that holds them, both in bytes."""

_BYTES_WHILE_READING = 8
"""Memory of one value while it is read: as it comes and as it is kept, both single precision."""


def write_field(path: str | os.PathLike, image: FieldImage, layers: dict[str, np.ndarray] | None = None) -> None:
    """Writes a field image, whole or not at all.

    An image without a field is written without it. ``layers`` maps names to further complex fields (rows, columns),
    stored as channels ``name.re`` and ``name.im``.
    Single precision is not compressed: the mantissas of speckle fields are noise, which compresses by 2 percent
    in ten times the time.
    """
    channels = {"Y": np.ascontiguousarray(image.intensity, dtype=np.float32)}
    if image.dn is not None:
        channels["DN"] = np.ascontiguousarray(image.dn, dtype=np.float32)
    for name, values in {"E": image.field, **image.layers, **(layers or {})}.items():
        if values is None:
            continue
        channels[f"{name}.re"] = np.ascontiguousarray(values.real, dtype=np.float32)
        channels[f"{name}.im"] = np.ascontiguousarray(values.imag, dtype=np.float32)
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {name: _attribute(value) for name, value in image.header.items()}
    # OpenEXR stores floating-point attributes in single precision; this one holds every field as it was.
    header[_DETAILS] = json.dumps(image.header)
    with replacing(path) as temporary, OpenEXR.File(header, channels) as file:
        file.write(str(temporary))


def read_field(path: str | os.PathLike, channel: str | None = None, page: int | None = None) -> FieldImage:
    """Reads a field image. Raises FieldImageError with one line that says what is wrong with the file.

    Of a damaged file of compressed pixels, which ours are not, OpenEXR itself prints more to stderr.
    channel: takes this channel for the intensity, or the colours of this layer; page: part of a file of several,
    from 1. The image lies where the header's data window puts it on the display window.
    """
    path = Path(path)
    if not path.is_file():
        what = "is not a file" if path.exists() else "there is no such file"
        raise FieldImageError(f"{path}: {what}, must be an image")
    if not is_exr(path):
        raise FieldImageError(f"{path}: not an OpenEXR file")
    channels, attributes = _read(path, page)
    complex_field = None
    if channel is None and "E.re" in channels and "E.im" in channels:
        complex_field = channels["E.re"].astype(np.complex64)
        complex_field.imag = channels["E.im"]
    intensity = _intensity(path, channels, attributes, channel)
    if intensity is None and complex_field is not None:
        intensity = np.abs(complex_field) ** 2
    if intensity is None:
        raise FieldImageError(
            f"{path}: has the channels {_listed(channels)}, must have Y (intensity), E.re and E.im (field) or R, G and"
            " B, or one of them be named by --channel"
        )
    (left, top), (right, bottom) = _window(attributes["displayWindow"])
    (data_left, data_top), _ = _window(attributes["dataWindow"])
    canvas = (bottom - top + 1, right - left + 1)
    dn = channels["DN"].astype(np.float32) if channel is None and "DN" in channels else None
    return FieldImage(intensity, complex_field, _header(attributes), (data_top - top, data_left - left), canvas, dn)


def _intensity(path: Path, channels: dict, attributes: dict, wanted: str | None) -> np.ndarray | None:
    """Intensity float32 of the channel or layer ``wanted``, or of Y or the colours; None if there are none."""
    prefix = ""
    if wanted is not None:
        if wanted in channels:
            return channels[wanted].astype(np.float32)
        prefix = f"{wanted}."
        if not any(name.startswith(prefix) for name in channels):
            raise FieldImageError(f"{path}: has no channel or layer {wanted}, must be one of {_listed(channels)}")
    if f"{prefix}Y" in channels:
        return channels[f"{prefix}Y"].astype(np.float32)
    colours = {colour: channels.get(prefix + colour) for colour in LUMINANCE}
    if all(values is not None for values in colours.values()):
        try:
            weights = luminance_weights(attributes["chromaticities"]) if "chromaticities" in attributes else LUMINANCE
        except ValueError as error:
            raise FieldImageError(f"{path}: {error}") from None
        return sum(weights[colour] * values.astype(np.float32) for colour, values in colours.items()).astype(np.float32)
    if {f"{prefix}re", f"{prefix}im"} <= set(channels) and prefix:
        return channels[f"{prefix}re"].astype(np.float32) ** 2 + channels[f"{prefix}im"].astype(np.float32) ** 2
    if wanted is not None:
        raise FieldImageError(
            f"{path}: the layer {wanted} has neither Y nor R, G and B, --channel must be one of {_listed(channels)}"
        )
    return None


def _listed(channels: dict) -> str:
    return ", ".join(sorted(channels)) or "none"


def _window(box) -> tuple[tuple[int, int], tuple[int, int]]:
    """((left, top), (right, bottom)) of a window in a header."""
    return tuple(tuple(int(x) for x in corner) for corner in box)


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
        raise FieldImageError(f"{path}: cannot be read, its header is damaged ({first_line(error)})") from None
    return _header(attributes)


def _read(path: Path, page: int | None) -> tuple[dict[str, np.ndarray], dict]:
    """Pixels of every channel of one part, and the attributes of its header."""
    part = _check_size(path, page)
    if what := damage(path):
        raise FieldImageError(f"{path}: cannot be read, {what}")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels(part).items()}
            attributes = dict(file.header(part))  # the file empties its own when it is closed
    except Exception as error:  # the reader raises RuntimeError, ValueError and others of its own
        raise FieldImageError(
            f"{path}: cannot be read, the file is damaged or cut short ({first_line(error)})"
        ) from None
    (left, top), (right, bottom) = _window(attributes["dataWindow"])
    shape = (bottom - top + 1, right - left + 1)
    # A subsampled channel (of a video's colours) is no image of this size.
    return {name: pixels for name, pixels in channels.items() if pixels.shape == shape}, attributes


def _check_size(path: Path, page: int | None) -> int:
    """Index of the part asked for.

    FieldImageError for what is no flat image, and where a header promises more pixels than the file can hold: the
    reader would take the memory.
    """
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            parts = [dict(part.header) for part in file.parts]
    except Exception as error:
        raise FieldImageError(f"{path}: cannot be read, its header is damaged ({first_line(error)})") from None
    number = page_number(path, len(parts), page)
    header = parts[number]
    if header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
        raise FieldImageError(f"{path}: is a deep image, with many samples a pixel; must be flattened first")
    try:
        (left, top), (right, bottom) = _window(header["dataWindow"])
        channels = max(len(part["channels"]) for part in parts)
    except Exception as error:
        raise FieldImageError(f"{path}: cannot be read, its header is damaged ({first_line(error)})") from None
    columns, rows, size = right - left + 1, bottom - top + 1, path.stat().st_size
    # Two bytes a half-precision value, and no codec of OpenEXR packs a thousand of them into one.
    if columns < 1 or rows < 1 or 2 * columns * rows * max(channels, 1) > LARGEST_RATIO * size:
        raise FieldImageError(
            f"{path}: cannot be read, its header says {columns} x {rows} pixels in {channels} channels, "
            f"which {size} bytes cannot hold"
        )
    if too_much := excess(_BYTES_WHILE_READING * columns * rows * channels):
        raise FieldImageError(f"{path}: its {columns} x {rows} pixels in {channels} channels {too_much}")
    return number


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
