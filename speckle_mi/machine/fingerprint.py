"""One hash for any value made of plain data: numbers, texts, arrays, containers and dataclasses of them."""

from __future__ import annotations

import dataclasses
import hashlib
import struct

import numpy as np

DIGITS = 16
"""Hexadecimal digits of a fingerprint: two of 10^8 scenes share one with a chance of 3e-4."""


def fingerprint(*values: object) -> str:
    """Hash of values, the same in every process; ``DIGITS`` hexadecimal digits.

    Of a dataclass its name and all fields count but those with ``compare=False``; floats count by their bits, so that
    what differs in the last digit differs. Raises TypeError for anything that is not plain data.
    """
    digest = hashlib.sha256()
    for value in values:
        _add(digest, value)
    return digest.hexdigest()[:DIGITS]


def _add(digest, value: object) -> None:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        _head(digest, "dataclass", type(value).__name__)
        for field in dataclasses.fields(value):
            if field.compare:
                _head(digest, "field", field.name)
                _add(digest, getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        _head(digest, "array", f"{value.dtype.str} {value.shape}")
        digest.update(np.ascontiguousarray(value).tobytes())
    elif value is None or isinstance(value, (bool, np.bool_)):
        _head(digest, "constant", str(value))
    elif isinstance(value, (int, np.integer)):
        _head(digest, "integer", str(int(value)))
    elif isinstance(value, (float, np.floating)):
        _head(digest, "float", "")
        digest.update(struct.pack("<d", float(value)))
    elif isinstance(value, (complex, np.complexfloating)):
        _head(digest, "complex", "")
        digest.update(struct.pack("<dd", value.real, value.imag))
    elif isinstance(value, (str, bytes)):
        data = value.encode() if isinstance(value, str) else value
        _head(digest, type(value).__name__, str(len(data)))
        digest.update(data)
    elif isinstance(value, (tuple, list)):
        _head(digest, "sequence", str(len(value)))
        for item in value:
            _add(digest, item)
    elif isinstance(value, dict):
        _head(digest, "mapping", str(len(value)))
        for name in sorted(value):
            _add(digest, name)
            _add(digest, value[name])
    else:
        raise TypeError(f"fingerprint of {type(value).__name__}: must be plain data")


def _head(digest, kind: str, text: str) -> None:
    digest.update(f"{kind}:{text};".encode())
