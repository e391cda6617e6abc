"""What is wrong with a scene, in one line."""

from __future__ import annotations

import re

from ..errors import InputError


def one_line(error: BaseException) -> str:
    """An error's message in one line, with Mitsuba's location of the fault but without the traceback it wraps."""
    if isinstance(error, MemoryError):
        return f"out of memory: {error}" if str(error) else "out of memory"
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror.lower()}"
    # Mitsuba names the line of its own source, which is of no use to its user.
    text = re.sub(r"\[\w+\.(cpp|h):\d+\]\s*", "", str(error).strip())
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if not lines:
        return type(error).__name__
    if "Traceback" not in text and len(lines) == 1:
        return lines[0]
    place = re.search(r"(At [^:]*?\(line \d+, col \d+\)|While loading .+? \((?:near )?line \d+, col \d+\))", text)
    unknown = re.search(r'Found \d+ unreferenced \w+ in (\w+) plugin of type "(\w+)":\s+- (\w+) "([^"]*)"', text)
    if unknown:
        role, plugin, kind, name = unknown.groups()
        lines.append(
            f"{role} {plugin!r} has no parameter {name!r} of type {kind}, must be one that its documentation names"
        )
    reason = re.sub(r"^(\w+\.)*\w*Error: ", "", lines[-1])
    return f"{place.group(1)}: {reason}" if place else reason


class SceneError(InputError):
    """Something in a scene that cannot be used; the message says what and what would be right."""
