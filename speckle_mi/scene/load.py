"""Loads a scene file for a command."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path


def load_scene(path: str, defaults: Sequence[str], variant: str):
    """Loads a scene file under a variant; ``defaults`` are ``name=value`` texts. Raises ValueError, RuntimeError."""
    import mitsuba as mi

    from ..machine.backend import set_variant

    if not os.path.isfile(path):
        what = "is not a file" if os.path.exists(path) else "there is no such file"
        raise FileNotFoundError(f"{path or repr(path)}: {what}, must be a Mitsuba XML scene")
    set_variant(variant)
    values = {}
    for text in defaults:
        name, separator, value = text.partition("=")
        if not separator or not name or not value:
            raise ValueError(f"-D {text!r}: must be name=value")
        values[name] = value
    try:
        text = Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise OSError(error.errno, error.strerror, path) from error
    known = set(re.findall(r"<default\s[^>]*name\s*=\s*[\"']([^\"']+)[\"']", text))
    for name in values:
        if name not in known:
            choices = ", ".join(sorted(known)) or "(none)"
            raise ValueError(f"-D {name}: the scene has no such <default>, must be one of {choices}")
    # Mitsuba warns that a monochrome variant makes films monochrome, which is what is wanted here.
    mi.set_log_level(mi.LogLevel.Error)
    scene = mi.load_file(path, **values)
    if not isinstance(scene, mi.Scene):
        raise ValueError(f"{path}: holds a {type(scene).__name__}, must hold a <scene>")
    return scene
