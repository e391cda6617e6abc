"""What the pieces of a coherent sum cost, from which the cheapest way is chosen.

On processors the choice rests on recorded costs, so that the same scene takes the same way, and gives the same bits,
on every machine and at any load: only their ratios matter. ``measured_costs`` is what recorded them, and what the
benchmark prints beside them; on a graphics card a pair costs so much less that they have to be measured.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..geometry.plane import PlaneGrid, PlanePoints
from ..machine.cores import usable_cores
from ..machine.nufft import finufft
from .area import Area
from .bandlimited import NodeGrid, band_limited_sum
from .direct import direct_sum
from .paths import FreeSpace


@dataclass(frozen=True)
class Costs:
    """Seconds: of one pair on a grid and at scattered points, of one source in one NUFFT term, of one multiply-add of a
    matrix product, of one pixel's common phase."""

    grid_pair: float
    point_pair: float
    nufft_point: float
    multiply_add: float
    pixel: float

    def interpolation(self, nodes: tuple[int, int], shape: tuple[int, ...]) -> float:
        """From (along u, along v) nodes to (rows, columns) pixels, or to (n,) scattered points."""
        if len(shape) == 1:  # every point has a weight for every node of its own
            return shape[0] * (2 * nodes[0] * nodes[1] * self.multiply_add + self.pixel)
        rows, columns = shape
        products = 2 * columns * nodes[1] * (nodes[0] + rows)
        return products * self.multiply_add + rows * columns * self.pixel


RECORDED = Costs(grid_pair=3.1e-10, point_pair=7e-10, nufft_point=3e-8, multiply_add=6e-12, pixel=5e-9)
"""Measured on two cores of a server processor with AVX-512."""


def costs_of(variant: str) -> Costs:
    """Costs on the back end of a Mitsuba variant: the recorded ones, or on a graphics card what it measures there.

    That takes a few tenths of a second: whoever makes many sums asks once.
    """
    return measured_costs(variant) if variant.startswith("cuda") else RECORDED


def _seconds(work: Callable[[], object]) -> float:
    """Best of five after a first run that compiles: the least disturbed by whatever else the machine does."""
    work()
    times = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def measured_costs(variant: str) -> Costs:
    """Costs on the back end of the Mitsuba ``variant``, the active one, in a few tenths of a second."""
    random = np.random.default_rng(0)
    sources = np.column_stack([random.normal(size=(512, 2)) * 0.1, np.zeros(512)])
    weights = np.ones(512, dtype=np.complex128)
    u, v, origin = np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0.0, 0, 60])
    grid = PlaneGrid(origin, u, v, 0.006, (128, 128))
    points = PlanePoints(origin, u, v, *random.random((2, 8192)))
    wavelength = 632.8e-6
    grid_time = _seconds(lambda: direct_sum(FreeSpace(), sources, weights, grid, wavelength))
    point_time = _seconds(lambda: direct_sum(FreeSpace(), sources, weights, points, wavelength))
    places = random.uniform(-1, 1, (2, 65536)).astype(np.float32)
    slopes = random.uniform(-100, 100, (2, 1024)).astype(np.float32)
    terms = np.ones((2, 65536), dtype=np.complex64)

    def transform() -> None:
        plan = finufft.Plan(3, 2, n_trans=2, eps=1e-5, isign=1, dtype="complex64", nthreads=usable_cores())
        plan.setpts(places[0], places[1], None, slopes[0], slopes[1])
        plan.execute(terms)

    def phases() -> None:
        nodes = NodeGrid((2, 2), Area.around(whole))  # so few that nothing but the pixels counts
        band_limited_sum(lambda _: np.ones(nodes.size), FreeSpace(), np.zeros(3), nodes, whole, wavelength, 1e-4)

    whole = PlaneGrid(origin, u, v, 0.006, (512, 512))
    matrix = np.ones((512, 512), dtype=np.float32)
    return Costs(
        grid_pair=grid_time / (len(sources) * grid.size),
        point_pair=point_time / (len(sources) * points.size),
        nufft_point=_seconds(transform) / (2 * 65536),
        multiply_add=_seconds(lambda: matrix @ matrix) / 512**3,
        pixel=_seconds(phases) / whole.size,
    )
