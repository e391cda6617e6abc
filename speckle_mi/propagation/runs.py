"""How long runs of pixels the direct sum may take: the error of a cubic along them, bounded beforehand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.plane import PlaneGrid, PlanePoints
from .source_box import for_chunks

RUN_LENGTHS = (16, 8)
"""Pixels a lane owns along a row, preferred first (even numbers)."""

RUN_TOLERANCE = 3e-7
"""Largest relative L2 remainder of the cubic along a run; keeps the whole field within 1e-6."""


@dataclass(frozen=True)
class Extent:
    """Box of the sources in the target plane's coordinates: low, high (3,) [mm] along u, v, normal."""

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, sources: np.ndarray, target: PlaneGrid | PlanePoints) -> Extent:
        axes = np.array([target.u, target.v, target.normal])

        def ends(chunk: slice) -> np.ndarray:
            place = axes @ sources[chunk].T
            return np.stack([place.min(axis=1), -place.max(axis=1)])

        low, high = np.min(for_chunks(ends, len(sources)), axis=0) * [[1.0], [-1.0]]
        return cls(low - axes @ target.origin, high - axes @ target.origin)

    def distance_to(self, a: tuple[float, float], b: tuple[float, float]) -> float:
        """Smallest distance [mm] from the box to the rectangle a[0]..a[1] x b[0]..b[1] of the plane."""
        gaps = [
            max(0.0, self.low[0] - a[1], a[0] - self.high[0]),
            max(0.0, self.low[1] - b[1], b[0] - self.high[1]),
            max(0.0, self.low[2], -self.high[2]),
        ]
        return float(np.linalg.norm(gaps))


def run_remainder(distance: float, half_run: float, wavelength: float, obliquity: float) -> float:
    """Relative L2 error of the cubic along runs of ``2 half_run`` [mm] at least ``distance`` [mm] from every source.

    Phase: the fourth-order term of the distance, k s^4/(8 r^3) at most; amplitude: the fourth of its logarithm, at most
    2 (s/r)^4 for 1/r^2 and (s/q)^4/4 for the obliquity's numerator, q [mm] its smallest value per unit slope.
    Root mean squares over the run, with the geometric series of the higher orders.
    """
    if not distance > 2 * half_run:
        return np.inf
    ratio = half_run / distance
    phase = 2 * np.pi / wavelength * half_run * ratio**3 / 8
    amplitude = 2 * ratio**4
    if obliquity < np.inf:
        if not obliquity > 2 * half_run:
            return np.inf
        amplitude += (half_run / obliquity) ** 4 / 2
    return (phase + amplitude) / 3 / (1 - ratio)


def choose_run(extent: Extent, grid: PlaneGrid, wavelength: float, normal: np.ndarray | None) -> int | None:
    """Longest allowed run of the grid for sources within ``extent``, or None where every pair needs its own path.

    normal: (3,) of a Rayleigh-Sommerfeld opening in the grid's coordinates, None in free space.
    """
    a, b = (0.0, grid.columns[-1]), (0.0, grid.rows[-1])
    for run in RUN_LENGTHS:
        half_run = run / 2 * grid.pitch
        # A run at the end of a row reaches past the grid.
        wide = (a[0] - 2 * half_run, a[1] + 2 * half_run)
        obliquity = np.inf
        if normal is not None and abs(normal[0]) > 1e-12:
            corners = np.array([[x, y, 0.0] for x in wide for y in b])
            hull = np.array([[x, y, z] for x in (extent.low[0], extent.high[0]) for y in (extent.low[1], extent.high[1])
                             for z in (extent.low[2], extent.high[2])])
            obliquity = max(0.0, float((corners @ normal).min() - (hull @ normal).max())) / abs(normal[0])
        if run_remainder(extent.distance_to(wide, b), half_run, wavelength, obliquity) <= RUN_TOLERANCE:
            return run
    return None
