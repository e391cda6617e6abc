"""Files of results: written whole or not at all, and refused before anything is computed for them."""

from __future__ import annotations

import csv
import json
import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path

import numpy as np

from . import interrupt
from .fragments import fragment_name, remove_abandoned

from ..errors import InputError

DRAWINGS = (".png", ".svg")
"""Endings of what is drawn."""

PAGES = (".html",)
"""Endings of pages."""


def require_output(path: str | os.PathLike, suffix: str = "") -> None:
    """Raises OSError when no file can be written at ``path``, InputError when it ends other than in ``suffix``.

    Called before anything is computed for it; fragments in the folder whose writers are no more are removed.
    """
    require_place(path)
    if not str(path).lower().endswith(suffix):
        raise InputError(f"{path}: must be the name of a {suffix} file")
    folder = Path(os.path.realpath(path)).parent
    _require_writable(folder)
    remove_abandoned(folder)


def require_picture(path: str | os.PathLike, pages: bool = False) -> None:
    """Raises InputError where ``path``, that ``-o`` gives, names no drawing, else as :func:`require_output`.

    pages: whether it may be a page, too.
    """
    endings = DRAWINGS + (PAGES if pages else ())
    if Path(path).suffix.lower() not in endings:
        raise InputError(f"-o {path}: must end in {', '.join(endings[:-1])} or {endings[-1]}")
    require_output(path)


def for_part(path: str | os.PathLike, part: str) -> Path:
    """The name that a file ``F.exr`` has for one of several parts of what is written: ``F.<part>.exr``."""
    path = Path(path)
    return path.with_name(f"{path.stem}.{part}{path.suffix}")


def require_distinct(**paths: str | None) -> None:
    """Raises InputError where two of the files that a command reads or writes, by what they are to it, are one."""
    given = [(what, path) for what, path in paths.items() if path]
    for (first, one), (second, other) in combinations(given, 2):
        if os.path.realpath(one) == os.path.realpath(other):
            raise InputError(f"{one}: is given as {first} and as {second}, must be two files")


def require_folder(path: str | os.PathLike) -> Path:
    """The folder for results, still to be made or there; OSError, InputError where it cannot be or be written to.

    Fragments in it whose writers are no more are removed.
    """
    if not os.fspath(path):
        raise InputError("--out '': must be the name of a folder")
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"{folder}: is a file, must be a folder or a new name")
    there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    if not there.is_dir():
        raise NotADirectoryError(f"{folder}: lies below {str(there)!r}, which is no folder")
    _require_writable(there)
    remove_abandoned(folder)
    return folder


def _require_writable(folder: Path) -> None:
    """Raises OSError where no file can be made in ``folder``: only a try tells."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(f"{folder}: no file can be written there ({(error.strerror or str(error)).lower()})") from error


def require_place(path: str | os.PathLike) -> None:
    """Raises OSError, InputError where ``path`` cannot be the name of a file."""
    if not os.fspath(path):
        raise InputError("'': must be the name of a file")
    path = Path(path)
    folder = path.parent
    if not folder.is_dir():
        raise FileNotFoundError(f"{path}: the folder {str(folder)!r} does not exist")
    if not os.access(folder, os.W_OK):
        raise PermissionError(f"{path}: the folder {str(folder)!r} may not be written to")
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder, must be the name of a file")
    if path.exists() and not path.is_file():
        raise OSError(f"{path}: is a device, must be the name of a file")


def refuse_other_settings(path: str | os.PathLike, held: object, wanted: object, force: bool) -> None:
    """Raises InputError where ``path`` exists and holds other settings than those ``wanted`` now, unless forced."""
    if Path(path).exists() and held != wanted and not force:
        raise InputError(f"{path}: holds results of other settings, give another name or --force to overwrite them")


def identity_in(path: str | os.PathLike) -> object:
    """The settings that a result in JSON says it was made with; None where there are none to be read."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))["identity"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well, and vanishes otherwise."""
    require_place(path)
    path = Path(os.path.realpath(path))  # a link stays, and what it points to is replaced
    # The user's mask applies, as to any other file: results may be read by whom the user lets.
    temporary = path.parent / fragment_name(path.stem, path.suffix)
    try:
        with interrupt.begins_file:
            interrupt.fragments.add(str(temporary))
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    except RuntimeError as error:  # of OpenEXR
        reason = str(error).replace(str(temporary), str(path))
        raise OSError(f"{path}: cannot be written ({reason})") from error
    finally:
        temporary.unlink(missing_ok=True)
        interrupt.fragments.discard(str(temporary))


def write_json(path: str | os.PathLike, content: dict) -> None:
    """Writes JSON, whole or not at all; NaN and infinities become null."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(plain(content), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def write_csv(path: str | os.PathLike, names: Sequence[str], rows: Iterable[dict]) -> None:
    """Writes a table with the columns ``names``, whole or not at all; None becomes an empty cell."""
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)


def plain(value: object) -> object:
    """Content that JSON can hold: NumPy values as Python's, non-finite numbers as None."""
    if isinstance(value, dict):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
