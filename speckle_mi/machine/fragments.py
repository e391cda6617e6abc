"""Names of files that are being written, from which a later run sees whether their writer still lives.

A process that is killed cannot tidy up. The next one that writes into the same folder removes what was left there by
processes that are no more: those of this machine (and, among containers, of this one), whose number is free or belongs
to a process that began at another time. What another machine writes into a shared folder is left alone.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import secrets
import shutil
from contextlib import suppress
from pathlib import Path

_WRITER = re.compile(r"-speckle_mi-(?P<place>[0-9a-f]{8})-(?P<process>\d+)-(?P<began>\d+)-[0-9a-f]{8}(\W|$)")


def fragment_name(stem: str, suffix: str = "") -> str:
    """A name, for this process alone, of what is to become ``stem`` + ``suffix``."""
    process = os.getpid()
    return f".{stem[:100]}-speckle_mi-{_place()}-{process}-{_began(process) or 0}-{secrets.token_hex(4)}{suffix}"


def remove_abandoned(folder: str | os.PathLike) -> None:
    """Removes the fragments in a folder whose writers are no more; nothing where there is no such folder."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            writer = _WRITER.search(entry.name) if entry.name.startswith(".") else None
            if writer is None or writer["place"] != _place() or _lives(int(writer["process"]), int(writer["began"])):
                continue
            with suppress(OSError):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path)
                else:
                    os.unlink(entry.path)


def _place() -> str:
    """Where the numbers of processes mean something: this machine and, within it, this container."""
    try:
        numbering = os.readlink("/proc/self/ns/pid")
    except OSError:
        numbering = ""
    return hashlib.sha256(f"{platform.node()} {numbering}".encode()).hexdigest()[:8]


def _lives(process: int, began: int) -> bool:
    """Whether a process that began then is still there; True also where that cannot be told."""
    if os.name != "posix":
        return True  # elsewhere, asking by a signal would end the process
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        pass
    now = _began(process)
    return now is None or now == began


def _began(process: int) -> int | None:
    """When a process began [ticks since the machine did], 0 once it has ended, None where the system does not tell."""
    try:
        state, *fields = Path(f"/proc/{process}/stat").read_text(errors="replace").rpartition(")")[2].split()
        return 0 if state in "ZX" else int(fields[18])
    except (OSError, ValueError, IndexError):
        return None
