"""Loads scenes: for a command as Mitsuba's, for a program as the assembly that they describe."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ..errors import InputError
from .errors import SceneError, one_line
from .source import NotReadable, source_of_file

if TYPE_CHECKING:
    from .assembly import Assembly


def load_scene(path: str | os.PathLike, variant: str | None = None, **defaults: object) -> Assembly:
    """What a scene file of one detector describes: laser, target, optics and detector, lengths in mm, float64.

    variant: the Mitsuba variant that reads it (default: the active one where it serves, else ``llvm_ad_mono``), which
    is active afterwards; defaults: values of the scene's ``<default>`` parameters, in the units of the scene.
    Raises SceneError (a ValueError) for a scene that cannot be used, InputError (its base) for an unknown variant,
    OSError for a file that cannot be read.
    """
    scene = _loaded(path, variant, defaults)
    from .read import assembly_from_scene

    return assembly_from_scene(scene)


def load_detectors(path: str | os.PathLike, variant: str | None = None, **defaults: object) -> dict[str, Assembly]:
    """What a scene file describes as each of its detectors sees it, by their ids: all but the detector is shared.

    Arguments and errors as of :func:`load_scene`.
    """
    scene = _loaded(path, variant, defaults)
    from .read import assemblies_from_scene

    return assemblies_from_scene(scene)


def _loaded(path: str | os.PathLike, variant: str | None, defaults: Mapping[str, object]):
    """The scene in a file, for a program, whose log level stays as it is."""
    import mitsuba as mi

    from ..machine.backend import DEFAULT_VARIANT, is_usable, set_variant

    if variant is None:
        variant = mi.variant() if is_usable(mi.variant() or "") else DEFAULT_VARIANT
    set_variant(variant)
    path = os.fspath(path)
    _require_file(path)
    level = mi.log_level()
    try:
        return _opened(path, {name: str(value) for name, value in defaults.items()}, "")
    finally:
        mi.set_log_level(level)


def open_scene(path: str, defaults: Sequence[str], variant: str):
    """The Mitsuba scene in a file, for a command; ``defaults`` are ``name=value`` texts of its flag ``-D``.

    Raises SceneError, InputError, OSError. From then on Mitsuba logs errors only.
    """
    from ..machine.backend import set_variant

    _require_file(path)
    set_variant(variant)
    return _opened(path, dict(split_defaults(defaults)), "-D ")


def split_defaults(texts: Sequence[str]) -> list[tuple[str, str]]:
    """Names and values of the flag ``-D``. Raises InputError for what is not ``name=value``."""
    pairs = []
    for text in texts:
        name, separator, value = text.partition("=")
        if not separator or not name or not value:
            raise InputError(f"-D {text!r}: must be name=value")
        pairs.append((name, value))
    return pairs


def _require_file(path: str) -> None:
    if not os.path.isfile(path):
        what = "is not a file" if os.path.exists(path) else "there is no such file"
        raise FileNotFoundError(f"{path or repr(path)}: {what}, must be a Mitsuba XML scene")
    try:
        with open(path, "rb"):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, path) from error


def _opened(path: str, values: Mapping[str, str], flag: str):
    """The scene in a file that is there, ``values`` given to its defaults by ``flag``."""
    import mitsuba as mi

    try:
        known = source_of_file(path, {}).defaults
    except NotReadable:
        known = None  # Mitsuba says best what is wrong with it
    for name in values if known is not None else ():
        if name not in known:
            choices = ", ".join(sorted(known)) or "(none)"
            raise InputError(f"{flag}{name}: the scene has no such <default>, must be one of {choices}")
    # Mitsuba warns that a monochrome variant makes films monochrome, which is what is wanted here.
    mi.set_log_level(mi.LogLevel.Error)
    try:
        scene = mi.load_file(path, **values)
    except RuntimeError as error:
        raise SceneError(one_line(error)) from error
    if not isinstance(scene, mi.Scene):
        raise SceneError(f"{path}: holds a {type(scene).__name__}, must hold a <scene>")
    return scene
