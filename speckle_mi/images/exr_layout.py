"""Whether an OpenEXR file of uncompressed scan lines, such as ours, is whole: read from its layout before its pixels.

OpenEXR itself prints what is damaged to the process's standard output and error, besides raising an error. A library
has no business there, and cannot keep it away without taking the output of other threads as well.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

_OTHER_LAYOUTS = 0x200 | 0x800 | 0x1000
"""Flags in the version field of files with tiles, deep pixels or several parts."""

_BYTES = (4, 2, 4)
"""Of one value, by its type: whole number, half and single precision."""

_LONGEST_NAME = 255


def damage(path: Path) -> str | None:
    """What is wrong with a file of uncompressed scan lines in one part, None where it is whole or of another layout."""
    with open(path, "rb") as file:
        (flags,) = struct.unpack("<4xI", file.read(8))
        if flags & _OTHER_LAYOUTS:
            return None
        try:
            attributes = _attributes(file)
            if attributes["compression"] != b"\0" or b"tiled" in attributes.get("type", b""):
                return None
            left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
            row_bytes = (right - left + 1) * _bytes_of_a_pixel(attributes["channels"])
        except (KeyError, IndexError, ValueError, struct.error):
            return "its header is damaged"
        if row_bytes == 0:
            return None  # of sub-sampled channels
        return _damage_of_lines(file, top, bottom - top + 1, row_bytes, path.stat().st_size)


def _attributes(file) -> dict[str, bytes]:
    """Names and contents of a header's attributes; the file then stands at the table of its lines."""
    found: dict[str, bytes] = {}
    while name := _name(file):
        _name(file)  # the type
        (size,) = struct.unpack("<i", file.read(4))
        content = file.read(max(size, 0))
        if len(content) != size:
            raise ValueError("cut short")
        found[name] = content
    return found


def _name(file) -> str:
    text = b""
    while (character := file.read(1)) != b"\0":
        text += character
        if not character or len(text) > _LONGEST_NAME:
            raise ValueError("not a name")
    return text.decode()


def _bytes_of_a_pixel(channels: bytes) -> int:
    """Bytes of all values of a pixel, 0 where some channel is sub-sampled."""
    total, sub_sampled = 0, False
    while channels != b"\0":
        name, _, channels = channels.partition(b"\0")
        name.decode()
        kind, x, y = struct.unpack("<i4x2i", channels[:16])
        total += _BYTES[kind]
        sub_sampled |= (x, y) != (1, 1)
        channels = channels[16:]
    return 0 if sub_sampled else total


def _damage_of_lines(file, top: int, rows: int, row_bytes: int, size: int) -> str | None:
    """Every line begins with its number and how many bytes follow; a table says where."""
    if rows < 1 or 8 * rows > size - file.tell():
        return "the table of its lines is cut short"
    table = np.frombuffer(file.read(8 * rows), dtype="<u8")
    if table.max() > size - 8 - row_bytes:
        return "it is cut short"
    unbuffered = file.raw  # eight bytes from each place
    for number, place in enumerate(table.tolist(), start=top):
        unbuffered.seek(place)
        if struct.unpack("<2i", unbuffered.read(8)) != (number, row_bytes):
            return f"line {number} is damaged"
    return None
