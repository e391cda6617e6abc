"""Standard output and error kept from libraries that print; for a process that is all a command's own."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout


@contextmanager
def muted() -> Iterator[None]:
    """Inside, nothing that is printed arrives, by whatever thread: not for use by a library."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    kept = [(number, os.dup(number)) for number in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for number, _ in kept:
            os.dup2(nowhere, number)
        with redirect_stdout(None):  # some print by Python
            yield
    finally:
        if sys.platform != "win32":
            ctypes.CDLL(None).fflush(None)  # what a library has written but not yet sent
        for number, copy in kept:
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)
