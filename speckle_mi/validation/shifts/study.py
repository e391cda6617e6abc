"""Every way to measure a shift on the same pairs: rms error and time a pair."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...machine.cores import products_on_one_thread
from ...measurement.correlator import Correlator
from .peers import installed
from .speckle import shifted_pair, with_photons

WINDOWS, SIZES = (64, 256), (2.0, 2.5, 4.0, 6.0, 8.0)
PHOTONS = (None, 1000.0, 100.0, 30.0, 10.0)
"""Mean of a pixel; None: no noise."""

LARGEST_SHIFT = 40.0
"""Shifts are evenly spread up to this [px]."""

ROOM = 16
"""Pixels left around the window wherever it goes, so that no method looks beyond the image's edge."""

PAIRS = {64: 60, 256: 20}
"""Pairs a row; of a large window a few say as much, since its error is smaller than what the rows differ by."""

QUICK_SIZES, QUICK_PAIRS = (4.0,), {64: 2, 256: 1}
"""Does it work, not how good is it."""

OURS = "speckle_mi"


@dataclass(frozen=True)
class ShiftRow:
    """rms: error over pairs and both directions [px] by method; milliseconds: median time a pair by method; stated: rms
    of the uncertainties that ours states [px]."""

    window: int
    size: float
    photons: float | None
    rms: dict[str, float]
    milliseconds: dict[str, float]
    stated: float


def compare_shifts(
    windows=WINDOWS, sizes=SIZES, photons=PHOTONS, pairs: dict[int, int] = PAIRS, peers: dict | None = None
) -> Iterator[ShiftRow]:
    """A row for each window, speckle size [px] and noise."""
    peers = installed() if peers is None else peers
    for window in windows:
        for size in sizes:
            for noise in photons:
                yield _row(window, size, noise, pairs[window], peers)


@products_on_one_thread()  # else threads that wait for a product of one method take the time of the next
def _row(window: int, size: float, photons: float | None, pairs: int, peers: dict) -> ShiftRow:
    errors: dict[str, list] = {name: [] for name in (OURS, *peers)}
    times: dict[str, list] = {name: [] for name in errors}
    stated = []
    side = window + 2 * (int(LARGEST_SHIFT) + ROOM)
    for seed in range(pairs):
        random = np.random.default_rng([seed, window])
        shift = tuple(random.uniform(-LARGEST_SHIFT, LARGEST_SHIFT, 2))
        reference, moved = (
            with_photons(image, photons, random) for image in shifted_pair((side, side), size, shift, seed)
        )
        correlator = Correlator(reference, window)
        correlator.shift(moved)  # the reference's transforms are made once and serve every moved image
        start = time.perf_counter()
        found = correlator.shift(moved)
        times[OURS].append(time.perf_counter() - start)
        errors[OURS].append(np.subtract((found.u_px, found.v_px), shift))
        stated.append((found.sigma_u_px, found.sigma_v_px))
        for name, measure in peers.items():
            start = time.perf_counter()
            place = measure(reference, moved, window)
            times[name].append(time.perf_counter() - start)
            errors[name].append(np.subtract(place, shift))
    return ShiftRow(
        window,
        size,
        photons,
        {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors.items()},
        {name: 1e3 * float(np.median(values)) for name, values in times.items()},
        float(np.sqrt(np.mean(np.square(stated)))),
    )


def table(rows: list[ShiftRow]) -> tuple[list[str], list[list[str]]]:
    """Heads and cells of the comparison: rms errors in thousandths of a pixel, then times; windows between slashes."""
    methods = list(rows[0].rms)
    windows = sorted({row.window for row in rows})
    kinds = list(dict.fromkeys((row.size, row.photons) for row in rows))
    at = {(row.window, row.size, row.photons): row for row in rows}

    def beside(of: Callable[[int], float | None]) -> str:
        return " / ".join("-" if value is None else _number(value) for value in map(of, windows))

    def errors(kind: tuple, of: Callable[[ShiftRow], float]) -> str:
        return beside(lambda window: 1e3 * of(at[window, *kind]) if (window, *kind) in at else None)

    def milliseconds(name: str) -> str:
        return beside(lambda window: float(np.median([r.milliseconds[name] for r in rows if r.window == window])))

    cells = [
        [
            f"{kind[0]:g}",
            "no noise" if kind[1] is None else f"{kind[1]:g}",
            *(errors(kind, lambda row: row.rms[name]) for name in methods),
            errors(kind, lambda row: row.stated),
        ]
        for kind in kinds
    ]
    cells.append(["ms a pair", "", *map(milliseconds, methods), ""])
    return ["speckle (px)", "photons", *methods, "ours states"], cells


def _number(value: float) -> str:
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


def title(rows: list[ShiftRow]) -> str:
    windows = " / ".join(str(window) for window in sorted({row.window for row in rows}))
    return f"Shifts: rms error (thousandths of a pixel) in windows of {windows} px"
