"""What the text of a scene says before anything of it is loaded: the plugins it names and its ``<default>`` values."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
"""Mitsuba allows two hyphens in one, as in the flag of a command, XML does not."""

DEEPEST = 15
"""Files included in one another, as many as Mitsuba follows."""


class NotReadable(Exception):
    """A source that Mitsuba may read but that cannot be looked through here."""


@dataclass
class SceneSource:
    """types: of all elements, as plugins are named; defaults: names and values of ``<default>``, those given first."""

    types: set[str] = field(default_factory=set)
    defaults: dict[str, str] = field(default_factory=dict)


def source_of_file(path: str | os.PathLike, values: Mapping[str, str]) -> SceneSource:
    """Looks through a scene file and what it includes, ``values`` given for its defaults. Raises NotReadable."""
    path = Path(path)
    source = SceneSource(defaults=dict(values))
    try:
        _look_through(path.read_bytes(), [path.parent], source, DEEPEST)
    except OSError as error:
        raise NotReadable(str(error)) from error
    return source


def source_of_string(text: str, values: Mapping[str, str]) -> SceneSource:
    """Looks through a scene given as text. Raises NotReadable."""
    source = SceneSource(defaults=dict(values))
    _look_through(text.encode(), [], source, DEEPEST)
    return source


def types_in_dict(description: Mapping) -> Iterator[str]:
    """The plugins that a scene given as nested dictionaries names."""
    for name, value in description.items():
        if isinstance(value, Mapping):
            yield from types_in_dict(value)
        elif name == "type" and isinstance(value, str):
            yield value


def _look_through(text: bytes, folders: list[Path], source: SceneSource, depth: int) -> None:
    def element(name: str, attributes: dict[str, str]) -> None:
        if name == "default" and "name" in attributes:
            source.defaults.setdefault(attributes["name"], _filled_in(attributes.get("value", ""), source.defaults))
        elif name == "include" and "filename" in attributes:
            _look_into(_filled_in(attributes["filename"], source.defaults), folders, source, depth - 1)
        elif name == "path" and "value" in attributes:
            folders.append(_beside(Path(_filled_in(attributes["value"], source.defaults)), folders))
        elif "type" in attributes:
            source.types.add(_filled_in(attributes["type"], source.defaults))

    parser = expat.ParserCreate()
    parser.StartElementHandler = element
    try:
        parser.Parse(_COMMENT.sub(b"", text), True)
    except expat.ExpatError as error:
        raise NotReadable(str(error)) from error


def _look_into(name: str, folders: list[Path], source: SceneSource, depth: int) -> None:
    path = _beside(Path(name), folders)
    if depth < 0 or not path.is_file():
        raise NotReadable(f"{name}: not found or included too deep")
    _look_through(path.read_bytes(), [*folders, path.parent], source, depth)


def _beside(path: Path, folders: list[Path]) -> Path:
    """Where a file or folder that a scene names lies: in the folder latest added that has it."""
    return next((folder / path for folder in reversed(folders) if (folder / path).exists()), path)


def _filled_in(text: str, defaults: Mapping[str, str]) -> str:
    """A text with every ``$name`` replaced, longer names first, as Mitsuba does."""
    if "$" in text:
        for name in sorted(defaults, key=len, reverse=True):
            text = text.replace(f"${name}", defaults[name])
    return text
