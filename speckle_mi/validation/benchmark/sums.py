"""Sums beside their peers: the same scatterers on the same pixels, in one run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.plane import PlaneGrid
from ...machine.run_times import Timing, timed
from ...propagation.coherent_sum import coherent_sum
from ...propagation.direct import direct_sum
from ...propagation.paths import FreeSpace
from ...propagation.reference import reference_sum
from .peers import fresnel_sum, numba_sum, numpy_sum
from .specimen import Specimen

TOLERANCE = 1e-4
"""Asked of ``auto``: the scenes' default."""

JUDGED_PAIRS, JUDGED_PIXELS = 20_000_000, (16, 512)
"""Pairs of the exact sum that errors are judged by, as far as fewest and most sampled pixels allow."""

DIRECT_PAIRS = 4_000_000_000
"""Pairs that ``direct`` sums at most, in some seconds; of more, it sums a part of the rows."""

PEER_RUNS = 3
"""Runs of a peer, each as long as it may take."""


@dataclass(frozen=True)
class Entry:
    """One way of summing: seconds (scaled where ``share`` of the pixels, below 1, was summed) and relative L2 error."""

    name: str
    scatterers: int
    seconds: float
    q1: float
    q3: float
    runs: int
    share: float
    error: float | None
    plan: str = ""


@dataclass(frozen=True)
class Judged:
    """The scatterers summed, and the exact field of some pixels, (flat indices (m,), field (m,)), to judge sums by."""

    position: np.ndarray
    amplitude: np.ndarray
    grid: PlaneGrid
    wavelength: float
    pixels: np.ndarray
    exact: np.ndarray

    @classmethod
    def of(cls, specimen: Specimen, count: int) -> Judged:
        position, amplitude = specimen.scatterers(count)
        number = int(np.clip(JUDGED_PAIRS // count, *JUDGED_PIXELS))
        pixels = np.random.default_rng(1).integers(specimen.grid.size, size=number)
        places = specimen.grid.points()[pixels]
        exact = reference_sum(FreeSpace(), position, amplitude, places, specimen.wavelength)
        return cls(position, amplitude, specimen.grid, specimen.wavelength, pixels, exact)

    def error(self, field: np.ndarray) -> float:
        """Relative L2 error of a whole field (rows, columns) on the sampled pixels."""
        return self.error_of_some(field.reshape(-1)[self.pixels])

    def error_of_some(self, field: np.ndarray) -> float:
        """The same of a field (m,) on those pixels alone."""
        return float(np.linalg.norm(field - self.exact) / np.linalg.norm(self.exact))

    def entry(self, name: str, timing: Timing, error: float | None, share: float = 1.0, plan: str = "") -> Entry:
        """A row, its times scaled up from the share of the pixels that was summed."""
        times = (timing.median / share, timing.q1 / share, timing.q3 / share)
        return Entry(name, len(self.position), *times, timing.runs, share, error, plan)


def sums(specimen: Specimen, count: int, peer_seconds: float) -> list[Entry]:
    """Ours and the peers' on the same ``count`` scatterers; ours first.

    peer_seconds: a peer sums as many pixels as it manages in about this time, and is scaled to all.
    """
    judged = Judged.of(specimen, count)
    entries = [_ours(judged), _direct(judged), _on_a_part(judged, "NumPy float64", numpy_sum, peer_seconds)]
    compiled = numba_sum()
    if compiled is not None:
        compiled(judged.position[:2], judged.amplitude[:2], judged.grid.points()[:2], judged.wavelength)
        entries.append(_on_a_part(judged, "numba float64", compiled, peer_seconds))

    def fresnel() -> np.ndarray:
        return fresnel_sum(judged.position, judged.amplitude, judged.grid, judged.wavelength)

    return [*entries, judged.entry("FINUFFT, Fresnel", timed(fresnel), judged.error(fresnel()))]


def _ours(judged: Judged) -> Entry:
    def work():
        scatterers = (judged.position, judged.amplitude)
        return coherent_sum(FreeSpace(), *scatterers, judged.grid, judged.wavelength, "auto", TOLERANCE)

    result = work()
    return judged.entry(f"auto {TOLERANCE:.0e}", timed(work), judged.error(result.field), plan=str(result.how))


def _direct(judged: Judged) -> Entry:
    """The direct kernel, on a part of the rows where all of them would take long (its error is then not judged)."""
    rows, columns = judged.grid.shape
    some = int(np.clip(DIRECT_PAIRS // (len(judged.position) * columns), 1, rows))
    part = replace(judged.grid, shape=(some, columns))

    def work() -> np.ndarray:
        return direct_sum(FreeSpace(), judged.position, judged.amplitude, part, judged.wavelength)

    timing = timed(work)
    return judged.entry("direct", timing, judged.error(work()) if some == rows else None, some / rows)


def _on_a_part(judged: Judged, name: str, work: Callable[..., np.ndarray], seconds: float) -> Entry:
    """A peer on as many pixels as it manages in its time, scaled to all of them."""
    points, count = judged.grid.points(), len(judged.pixels)
    begin = time.perf_counter()
    found = work(judged.position, judged.amplitude, points[judged.pixels], judged.wavelength)
    rate = count / (time.perf_counter() - begin)
    number = int(np.clip(rate * seconds, count, len(points)))
    some = points if number == len(points) else points[:: max(1, len(points) // number)]
    if len(some) < 2 * count:
        some = points[judged.pixels]

    def part() -> np.ndarray:
        return work(judged.position, judged.amplitude, some, judged.wavelength)

    timing = timed(part, runs=PEER_RUNS, seconds=seconds)
    return judged.entry(name, timing, judged.error_of_some(found), len(some) / len(points))
