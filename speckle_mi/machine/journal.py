"""A journal of finished results: a line a result, appended as it comes, so that a kill at any instant loses none.

A folder may hold several journals, one a process that adds to it at the same time; all are read.
"""

from __future__ import annotations

import base64
import json
import os
import threading
from pathlib import Path

import numpy as np

from ..errors import InputError

SUFFIX = ".jsonl"
"""Ending of a journal's name."""

_ARRAY = "array of dtype, shape, base64"


class Journal:
    """Results by key, as plain data: numbers, texts, None, lists, mappings by text, and arrays of numbers.

    A result comes back equal to the last bit, tuples as lists. Only inside a ``with`` block results can be added; its
    file is then this process's alone. What a killed process has left half-written at its end is cut off. Threads may
    add results.
    """

    def __init__(self, folder: str | os.PathLike, name: str = "jobs") -> None:
        """folder: made when the first block is entered; name: of the file that this process adds to."""
        self._folder, self._path = Path(folder), Path(folder) / f"{name}{SUFFIX}"
        self._file: int | None = None
        self._made: list[Path] = []
        self._lock = threading.Lock()
        # Where each result stands, as (file, first byte, bytes): results may be more than memory holds.
        self._places: dict[str, tuple[Path, int, int]] = {}
        self._read_to: dict[Path, int] = {}
        self.read_again()

    def __enter__(self) -> Journal:
        """Raises InputError where another process adds to the same file, OSError where it cannot be written."""
        self._made = [folder for folder in (self._folder, *self._folder.parents) if not folder.exists()]
        self._folder.mkdir(parents=True, exist_ok=True)
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            _claim(self._file, self._path)
            _cut_fragment(self._file)
        except BaseException:
            os.close(self._file)  # it may be another process's, which has no result yet
            self._file = None
            raise
        self._places.clear()  # a last line without its end has been cut off
        self._read_to.clear()
        self.read_again()
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            if self._file is not None:
                if not os.fstat(self._file).st_size:
                    self._leave_nothing()
                os.close(self._file)
            self._file = None

    def _leave_nothing(self) -> None:
        """Without a result, as where the first job was refused, nothing is left of file and folders."""
        try:
            self._path.unlink()
            for folder in self._made:
                folder.rmdir()
        except OSError:  # somebody else's by now
            pass

    def __contains__(self, key: str) -> bool:
        return key in self._places

    def __getitem__(self, key: str) -> object:
        path, first, size = self._places[key]
        with open(path, "rb") as file:
            file.seek(first)
            return _entry(file.read(size))[1]

    def __len__(self) -> int:
        return len(self._places)

    def add(self, key: str, result: object) -> object:
        """Adds a result and gives it as it will be read; it is there whatever happens to the process afterwards.

        Raises TypeError for what is not plain data.
        """
        line = (json.dumps({"key": key, "result": result}, default=_array, separators=(",", ":")) + "\n").encode()
        with self._lock:
            if self._file is None:
                raise ValueError(f"{self._path}: must be open to be added to")
            first = _write_whole(self._file, line, self._path)
            self._places.setdefault(key, (self._path, first, len(line)))
        return _entry(line)[1]

    def read_again(self) -> None:
        """Takes account of what other processes have added."""
        for path in sorted(self._folder.glob(f"*{SUFFIX}")):
            with open(path, "rb") as file:
                first = file.seek(self._read_to.get(path, 0))
                for line in file:
                    if line.endswith(b"\n") and (entry := _entry(line)) is not None:
                        self._places.setdefault(entry[0], (path, first, len(line)))
                    if line.endswith(b"\n"):
                        first += len(line)
                self._read_to[path] = first


def _entry(line: bytes) -> tuple[str, object] | None:
    """Key and result of a line, None of a damaged one, whose job is done again."""
    try:
        entry = json.loads(line, object_hook=_read_array)
        return entry["key"], entry["result"]
    except (ValueError, KeyError, TypeError):
        return None


def _array(value: object) -> object:
    """What JSON does not know: arrays, and NumPy's numbers."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        return {_ARRAY: [value.dtype.str, value.shape, base64.b64encode(value.tobytes()).decode()]}
    raise TypeError(f"result of {type(value).__name__}: must be plain data")


def _read_array(entry: dict) -> object:
    if _ARRAY not in entry:
        return entry
    dtype, shape, data = entry[_ARRAY]
    return np.frombuffer(base64.b64decode(data), dtype).reshape(shape).copy()


def _claim(file: int, path: Path) -> None:
    """Makes a file this process's alone, until it ends in whatever way."""
    try:
        import fcntl
    except ImportError:  # of another system, where nobody can ask
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path}: another run is adding to it, must end first (or give another --out)") from None
    except OSError:  # a file system without locks
        pass


def _cut_fragment(file: int) -> None:
    """Cuts off an unfinished last line."""
    end = os.fstat(file).st_size
    while end and os.pread(file, 1, end - 1) != b"\n":
        start = max(0, end - 65536)
        end = start + os.pread(file, end - start, start).rfind(b"\n") + 1
    os.ftruncate(file, end)


def _write_whole(file: int, data: bytes, path: Path) -> int:
    """Appends a line whole and tells where it begins, or takes back what of it was written (the disk is full) and
    raises OSError."""
    begin, written = os.fstat(file).st_size, 0
    try:
        while written < len(data):
            written += os.write(file, data[written:])
    except OSError as error:
        os.ftruncate(file, begin)
        raise OSError(error.errno, error.strerror, str(path)) from error
    return begin
