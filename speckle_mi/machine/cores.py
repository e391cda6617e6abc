"""Work shared out to the processor's cores."""

from __future__ import annotations

import math
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import lru_cache
from pathlib import Path

import numpy as np

from . import cgroup
from .around_import import environment_unless_chosen

# It would set this for good, for libraries that a host may load later. Ours need it as little as without it.
with environment_unless_chosen("KMP_DUPLICATE_LIB_OK", "True"):
    from threadpoolctl import OpenBLASController, ThreadpoolController


def usable_cores(process: Path = cgroup.PROCESS) -> int:
    """Processor cores that this process may use: those it may run on, or fewer by a limit of its group."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = _limit(process)
    return there if limit >= there else max(1, math.ceil(limit))


FEWEST_SHARED = 500_000
"""Values from which on the threads of a Fourier transform save more time than they take."""


def cores_for_transform(*shape: int) -> int:
    """Processor cores that a Fourier transform of so many values is to be shared out to."""
    if math.prod(shape) < FEWEST_SHARED:
        return 1
    threads = _current.get()
    return usable_cores() if threads is None else threads.cores


# A process stays in its group, and its frames take milliseconds, of which reading this anew would take a tenth.
_limit = lru_cache(maxsize=1)(cgroup.cpu_limit)


def on_all_cores(work: Callable, items: Iterable) -> list:
    """``work`` on every item, on all cores (NumPy and FINUFFT let go of the interpreter lock), results in order.

    Products of matrices inside run on one thread each.
    """
    items = list(items)
    if len(items) < 2:
        return [work(item) for item in items]
    with products_on_one_thread() as threads:
        others = min(threads.cores, len(items)) - 1
        return threads.run(work, items, others) if others else [work(item) for item in items]


def equal_slices(count: int, number: int) -> list[slice]:
    """``number`` slices, equal to within one item, that cover ``count`` of them."""
    edges = np.linspace(0, count, number + 1).astype(int)
    return [slice(first, end) for first, end in zip(edges[:-1], edges[1:], strict=True)]


@contextmanager
def products_on_one_thread() -> Iterator[_Threads]:
    """Inside, or in a function decorated with it, NumPy's products of matrices take one thread, whoever calls them.

    Their own threads spin while they wait for one another: on cores that anything else is using, ours included, a
    product took up to fifty times longer with two of them than with one, and here none is large enough to gain much.
    The outermost block keeps the threads of :func:`on_all_cores`, which end with it.
    """
    outer = _current.get()
    if outer is not None:
        yield outer
        return
    with _products.on_one_thread(), _Threads() as threads:
        token = _current.set(threads)
        try:
            yield threads
        finally:
            _current.reset(token)


def keep_to_one_core() -> None:
    """From now on this thread shares nothing out: for one of several that work on items of their own."""
    _current.set(_Threads(cores=1))


class _Threads:
    """Threads beside the caller's own, begun when first needed, that end with the block."""

    def __init__(self, cores: int | None = None) -> None:
        self.cores = usable_cores() if cores is None else cores
        self._pool: ThreadPoolExecutor | None = None
        self._begins = threading.Lock()

    def __enter__(self) -> _Threads:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown()

    def run(self, work: Callable, items: list, others: int) -> list:
        """``work`` on every item, by the caller and up to ``others`` threads."""
        results: list = [None] * len(items)
        waiting = deque(enumerate(items))

        def take() -> None:
            while True:
                try:
                    number, item = waiting.popleft()
                except IndexError:
                    return
                try:
                    results[number] = work(item)
                except BaseException:
                    waiting.clear()
                    raise

        with self._begins:
            self._pool = self._pool or ThreadPoolExecutor(self.cores - 1)
        # In the caller's context: what is shared out again in there finds these threads and begins no others.
        futures = [self._pool.submit(copy_context().run, take) for _ in range(others)]
        try:
            take()
        finally:
            # Threads that have not begun, as all are busy elsewhere, have nothing left to do.
            begun = [future for future in futures if not future.cancel()]
            for future in begun:
                future.exception()
        for future in begun:
            future.result()
        return results


_current: ContextVar[_Threads | None] = ContextVar("threads", default=None)
"""Those of the block that the caller is in."""


class _Products:
    """How many threads NumPy's products take, one number for the whole process: the last one out restores it."""

    def __init__(self) -> None:
        self._changes = threading.Lock()
        self._inside = 0
        self._limited = None
        self._libraries: ThreadpoolController | None = None

    @contextmanager
    def on_one_thread(self) -> Iterator[None]:
        with self._changes:
            if self._inside == 0:
                self._libraries = self._libraries or ThreadpoolController()
                self._limited = self._libraries.limit(limits=1, user_api="blas")
                _let_any_thread_set()
            self._inside += 1
        try:
            yield
        finally:
            with self._changes:
                self._inside -= 1
                if self._inside == 0:
                    self._restore()

    def _restore(self) -> None:
        limited, self._limited = self._limited, None
        if limited is not None:
            limited.restore_original_limits()
            _let_any_thread_set()

    def begin_anew(self) -> None:
        """In a forked process, which has none of the threads that were inside, nor the one that may hold the lock."""
        self._changes, self._inside = threading.Lock(), 0
        self._restore()


def _let_any_thread_set() -> None:
    """Newer versions of threadpoolctl let a number be set only by the thread that did so first; ours may be another."""
    if hasattr(OpenBLASController, "clear_controlling_thread"):
        OpenBLASController.clear_controlling_thread()


_products = _Products()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_products.begin_anew)
