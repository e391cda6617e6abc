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


@contextlib.contextmanager
def answered(afterwards_ignored: bool = False) -> Iterator[None]:
    """Inside, Ctrl-C and SIGTERM end the process as a command ends; afterwards they do what they did before.

    afterwards_ignored: instead, nothing: once the process's own command is done, there is nothing to interrupt but
        the tidying up of the interpreter.

    Changes nothing outside the main thread, where Python lets nobody answer signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    wakened = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    # With any function of Python's, the number of a signal arrives at the pipe.
    before = {number: signal.signal(number, _nothing) for number in SIGNALS}
    threading.Thread(target=_watch, args=(reader,), name="interrupt", daemon=True).start()
    try:
        yield
    finally:
        for number, handler in before.items():
            if afterwards_ignored:
                handler = signal.SIG_IGN
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        signal.set_wakeup_fd(wakened)
        os.close(writer)  # the thread reads the end


@contextlib.contextmanager
def raised_as_such() -> Iterator[None]:
    """A KeyboardInterrupt leaves the block as one, also where Dr.Jit, recording a loop, has made another error of it.

    Of code that is called from Python: a command is ended otherwise, see above.
    """
    try:
        yield
    except RuntimeError as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, KeyboardInterrupt):
                raise KeyboardInterrupt from error
            cause = cause.__cause__ or cause.__context__
        raise


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

    from .fragments import fragment_name, remove_abandoned

    remove_abandoned(tempfile.gettempdir())
    with tempfile.TemporaryDirectory(prefix=f"{fragment_name('scratch')}-") as name:
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
