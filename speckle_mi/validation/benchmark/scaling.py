"""How frames scale: with scatterers, with pixels, with the tolerance; and what the choice between the sums rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial

from ...field.simulation import Simulation
from ...geometry.plane import PlaneGrid
from ...geometry.pose import Pose
from ...machine.run_times import timed
from ...propagation.coherent_sum import coherent_sum
from ...propagation.costs import RECORDED, measured_costs
from ...propagation.paths import FreeSpace
from ...propagation.phasors import active_variant
from .specimen import Specimen
from .sums import TOLERANCE

RANK_TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)

MOST_SCATTERERS = 100_000
"""Scatterers on which pixels and tolerances are varied, if the benchmark goes that far."""


def scaling(specimen: Specimen, counts: Sequence[int]) -> dict:
    """Ours with more scatterers (whole frames), with four times the pixels, and against the expansion's rank."""
    count = min(MOST_SCATTERERS, counts[-1])
    position, amplitude = specimen.scatterers(count)

    def seconds(grid: PlaneGrid, tolerance: float = TOLERANCE) -> tuple[float, object]:
        def work():
            return coherent_sum(FreeSpace(), position, amplitude, grid, specimen.wavelength, "auto", tolerance)

        return timed(work).median, work()

    ranks = []
    for tolerance in RANK_TOLERANCES:
        spent, result = seconds(specimen.grid, tolerance)
        ranks.append({"tolerance": tolerance, "rank": result.how.ranks and result.how.ranks[0], "seconds": spent,
                      "error": result.numerical_error, "plan": str(result.how)})  # fmt: skip
    return {
        "frames": _frames(specimen, counts),
        "scatterers": count,
        "seconds": seconds(specimen.grid)[0],
        "pixels_x4_finer": seconds(_finer(specimen.grid))[0],
        "pixels_x4_larger": seconds(_larger(specimen.grid))[0],
        "rank": ranks,
    }


def _frames(specimen: Specimen, counts: Sequence[int]) -> dict[int, dict]:
    frames = {}
    for count in counts:
        simulation = Simulation(specimen.denser(count))
        frames[count] = asdict(timed(partial(simulation.frame, Pose())))
    return frames


def _finer(grid: PlaneGrid) -> PlaneGrid:
    """The same detector with pixels of half the side."""
    rows, columns = grid.shape
    origin = grid.origin - grid.pitch / 4 * (grid.u + grid.v)
    return replace(grid, pitch=grid.pitch / 2, origin=origin, shape=(2 * rows, 2 * columns))


def _larger(grid: PlaneGrid) -> PlaneGrid:
    """A detector of twice the sides about the same middle."""
    rows, columns = grid.shape
    origin = grid.origin - grid.pitch / 2 * (columns * grid.u + rows * grid.v)
    return replace(grid, origin=origin, shape=(2 * rows, 2 * columns))


def costs() -> dict[str, dict[str, float]]:
    """Name of a cost -> {recorded, measured} [s]: what decides how a field is summed, and what it takes here."""
    recorded, measured = asdict(RECORDED), asdict(measured_costs(active_variant()))
    return {name: {"recorded": recorded[name], "measured": measured[name]} for name in recorded}
