"""How far a long computation has come: told where it loops, shown on stderr where a command listens.

On a terminal as bars, elsewhere as a line from time to time.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

SHOWN_AFTER = 1.0
"""Seconds after which a computation that goes on gets a bar of its own."""

SECONDS_A_LINE = 30.0
"""Where stderr is no terminal."""

_bars: list[_Bars] = []


def tell(what: str, done: int, total: int) -> None:
    """Says that ``done`` of ``total`` steps of a loop are done; nothing happens unless a command shows it."""
    if _bars:
        _bars[-1].tell(what, done, total)


@contextmanager
def progress_bars(quiet: bool, predicts: bool = True) -> Iterator[object]:
    """Bars that are gone when the block ends: the block's own, as tasks of what is given, and those of :func:`tell`.

    predicts: whether steps take as long as each other, so that the time left can be told.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeElapsedColumn, TimeRemainingColumn

    columns = [TextColumn("{task.description:<8}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()]
    if predicts:
        columns += [TextColumn("left"), TimeRemainingColumn()]
    console, ended = Console(stderr=True), threading.Event()
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, disable=hidden, transient=True) as progress:
        if hidden and not quiet:
            threading.Thread(target=_lines, args=(progress, ended), name="progress", daemon=True).start()
        _bars.append(_Bars(progress))
        try:
            yield progress
        finally:
            ended.set()
            _bars.pop()


def _lines(progress, ended: threading.Event) -> None:
    """Says every now and then on stderr how far the tasks are, until ``ended``."""
    began = time.perf_counter()
    while not ended.wait(SECONDS_A_LINE):
        tasks = ", ".join(f"{task.description} {task.completed:g} of {task.total:g}" for task in progress.tasks)
        print(f"{time.perf_counter() - began:.0f} s: {tasks or 'at work'}", file=sys.stderr, flush=True)


class _Bars:
    """The bars of what is being told: one a loop, from when it has taken long until it ends."""

    def __init__(self, progress) -> None:
        self._progress = progress
        self._began: dict[str, float] = {}
        self._tasks: dict[str, int] = {}

    def tell(self, what: str, done: int, total: int) -> None:
        if done >= total:
            self._began.pop(what, None)
            if what in self._tasks:
                self._progress.remove_task(self._tasks.pop(what))
            return
        began = self._began.setdefault(what, time.perf_counter())
        if what in self._tasks:
            self._progress.update(self._tasks[what], completed=done, total=total)
        elif time.perf_counter() - began > SHOWN_AFTER:
            self._tasks[what] = self._progress.add_task(what, completed=done, total=total)
