"""Something done around the import of another package, whenever that comes and whoever asks for it."""

from __future__ import annotations

import importlib.abc
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import ModuleType


def around_import(name: str, around: Callable[[], AbstractContextManager]) -> None:
    """Lets the code of module ``name``, which must not be imported yet, run inside ``around()``.

    Looking for the module changes nothing (``importlib.util.find_spec``), and neither does an import that fails.
    """
    sys.meta_path.insert(0, _Finder(name, around))


@contextmanager
def environment_unless_chosen(name: str, value: str) -> Iterator[None]:
    """Inside, the environment variable ``name`` has the user's value or else ``value``; nothing of it is left."""
    if name in os.environ:
        yield
        return
    os.environ[name] = value
    try:
        yield
    finally:
        os.environ.pop(name, None)


class _Finder(importlib.abc.MetaPathFinder):
    """Finds one module as everyone else does, and has it executed inside a context, once.

    It stays where it is when that is done: other threads may be walking through the list of finders.
    """

    def __init__(self, name: str, around: Callable[[], AbstractContextManager]) -> None:
        self._name, self._around = name, around
        self._asking = threading.local()
        self._done = False

    def find_spec(self, name, path=None, target=None):
        if name != self._name or self._done or getattr(self._asking, "others", False):
            return None
        self._asking.others = True  # one of them may ask us again
        try:
            found = (
                finder.find_spec(name, path, target)
                for finder in list(sys.meta_path)
                if finder is not self and hasattr(finder, "find_spec")
            )
            spec = next((spec for spec in found if spec is not None), None)
        finally:
            self._asking.others = False
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module = self._inside(spec.loader.exec_module)
        return spec

    def _inside(self, execute: Callable[[ModuleType], None]) -> Callable[[ModuleType], None]:
        def execute_inside(module: ModuleType) -> None:
            if self._done:
                execute(module)
                return
            with self._around():
                execute(module)
                self._done = True

        return execute_inside
