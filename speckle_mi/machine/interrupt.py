"""Ctrl-C and SIGTERM: a command ends at once, with one line and status 130, keeps what is finished, leaves no fragment.

No exception is raised for it. One that reaches compiled code, while that is imported or calls back, ends there as a
crash, an error of another kind, or nothing at all; and code that computes for long outside Python would not hear of it.
A thread waits for the signals instead, and ends the process.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

INTERRUPTED = 130
"""Exit status of an interrupted command."""

SIGNALS = (signal.SIGINT, signal.SIGTERM)

fragments: set[str] = set()
"""Files being written under another name, and scratch folders: they go when the process ends before they are whole."""

begins_file = threading.Lock()
"""Held while a fragment is begun; for good once the process ends, so that no other thread begins a new one."""

_keepers: list[Callable[[], None]] = []
_listening: list[int] = []


def is_command(arguments: list[str], original: list[str]) -> bool:
    """Whether Python is about to run one of the package's commands, by ``sys.argv`` and ``sys.orig_argv`` then."""
    return arguments[:1] == ["-m"] and any(a.removeprefix("-m").startswith("speckle_mi.") for a in original)


def listen() -> bool:
    """Answers interrupts from now on; False where that is so already."""
    if _listening:
        return False
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for number in SIGNALS:
        signal.signal(number, _nothing)  # with any function of Python's, the number of a signal arrives at the pipe
    _listening.append(writer)
    threading.Thread(target=_watch, args=(reader,), name="interrupt", daemon=True).start()
    return True


def stop_listening() -> None:
    """Undoes :func:`listen`."""
    signal.set_wakeup_fd(-1)
    for number in SIGNALS:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    os.close(_listening.pop())  # the thread reads the end


def ignore() -> None:
    """Once a command is done there is nothing to interrupt but the tidying up of the interpreter."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def keeping(keep: Callable[[], None]) -> Iterator[None]:
    """Calls ``keep`` when the block is left in whatever way: at its end, by an error, or by the end of the process.

    When interrupted it is called from another thread, beside the block.
    """
    _keepers.append(keep)
    try:
        yield
    finally:
        _keepers.remove(keep)
        keep()


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder that vanishes with the block, or with the process."""
    import tempfile

    with tempfile.TemporaryDirectory(prefix="speckle_mi-") as name:
        fragments.add(name)
        try:
            yield Path(name)
        finally:
            fragments.discard(name)


def _nothing(*_: object) -> None:
    """What Python itself does at a signal."""


def _watch(reader: int) -> None:
    wanted = {int(number) for number in SIGNALS}
    while (came := os.read(reader, 64)) and wanted.isdisjoint(came):
        pass
    if came:
        _end()
    os.close(reader)


def _end() -> None:
    try:
        for keep in _keepers:
            keep()
        line = "interrupted: what is finished has been kept"
    except Exception as error:
        line = f"interrupted: what is finished could not be kept ({error})"
    begins_file.acquire()
    _remove_fragments()
    with contextlib.suppress(OSError):
        os.write(2, f"{line}\n".encode())
    _remove_fragments()  # a library that was just opening a file it was to write has made it anew
    os._exit(INTERRUPTED)


def _remove_fragments() -> None:
    for name in list(fragments):
        with contextlib.suppress(OSError):
            if os.path.isdir(name):
                import shutil

                shutil.rmtree(name)
            else:
                os.unlink(name)
