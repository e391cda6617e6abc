"""Work shared out to the processor's cores."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache

import numpy as np

from .around_import import environment_unless_chosen

# It would set this for good, for libraries that a host may load later. Ours need it as little as without it.
with environment_unless_chosen("KMP_DUPLICATE_LIB_OK", "True"):
    from threadpoolctl import ThreadpoolController


def usable_cores() -> int:
    """Processor cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_all_cores(work: Callable, items: Iterable) -> list:
    """``work`` on every item, on all cores (NumPy and FINUFFT let go of the interpreter lock), results in order.

    Products of matrices inside run on one thread each.
    """
    items = list(items)
    others = min(usable_cores(), len(items)) - 1
    if others < 1:
        return [work(item) for item in items]
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

    with products_on_one_thread():
        futures = [_threads().submit(take) for _ in range(others)]
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


def equal_slices(count: int, number: int) -> list[slice]:
    """``number`` slices, equal to within one item, that cover ``count`` of them."""
    edges = np.linspace(0, count, number + 1).astype(int)
    return [slice(first, end) for first, end in zip(edges[:-1], edges[1:], strict=True)]


@contextmanager
def products_on_one_thread() -> Iterator[None]:
    """Inside, or in a function decorated with it, NumPy's products of matrices take one thread, whoever calls them.

    Their own threads spin while they wait for one another: on cores that anything else is using, ours included, a
    product took up to fifty times longer with two of them than with one, and here none is large enough to gain much.
    """
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, usable_cores() - 1))


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()
