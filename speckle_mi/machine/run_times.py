"""Run times: measured warm, and put into words."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

RUNS, RUN_SECONDS = 9, 2.0
"""Warm runs, fewer (at least three) where they take longer than this together."""


@dataclass(frozen=True)
class Timing:
    """Seconds of warm runs: median and quartiles; first: of the first run, which may compile."""

    median: float
    q1: float
    q3: float
    runs: int
    first: float

    @classmethod
    def of(cls, times: Sequence[float], first: float) -> Timing:
        """Summary of the ``times`` of warm runs."""
        median, q1, q3 = (float(value) for value in np.quantile(times, (0.5, 0.25, 0.75)))
        return cls(median, q1, q3, len(times), first)


def timed(work: Callable[[], object], runs: int = RUNS, seconds: float = RUN_SECONDS) -> Timing:
    """Median and quartiles of warm runs of ``work``."""
    begin = time.perf_counter()
    work()
    first = time.perf_counter() - begin
    times: list[float] = []
    while len(times) < runs and (len(times) < 3 or sum(times) < seconds):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return Timing.of(times, first)


UNITS = (
    ("ps", 1e-12, 1e-9), ("ns", 1e-9, 1e-6), ("us", 1e-6, 1e-3), ("ms", 1e-3, 1.0),
    ("s", 1.0, 100.0), ("min", 60.0, 6e3), ("h", 3600.0, 2e5),
)  # fmt: skip
"""Of durations: name, seconds, and from where on the next one reads better."""


def duration(seconds: float) -> str:
    """A duration in words of three digits, such as ``41.7 ms``."""
    for unit, size, limit in UNITS:
        if seconds < limit:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 86400:.3g} days"
