"""What chance does to a sensitivity: how it scatters from surface to surface, for one N1 after another."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from ...field.simulation import Simulation
from ...geometry.pose import Pose
from ...measurement.correlator import Correlator
from .frame import Setting

SCATTER_SOURCES = (10, 100, 1_000, 10_000)

SCATTER_TOLERANCE = 1e-3
"""Of the frames that the scatter over surfaces is measured on: a thousandth of what chance does to them."""

UNLIKELY = 0.01
"""Chance at which a difference from theory is no longer put down to chance (Student's t, both sides)."""

NUMBER = {"x": 0, "ry": 4}
"""Of the motions measured, among the six of a pose."""


@dataclass(frozen=True)
class Scatter:
    """How sensitivities scatter at one N1: slopes (surfaces,) [unit] of a motion along a detector axis.

    step: displacement [mm or deg] forth and back; spread: standard deviation over surfaces; theory: None without one.
    """

    dof: str
    axis: str
    unit: str
    step: float
    point_sources: int
    slopes: list[float]
    mean: float
    spread: float
    theory: float | None

    @property
    def scale(self) -> float:
        """What a relative error is relative to."""
        return abs(self.mean if self.theory is None else self.theory)

    @property
    def error_of_mean(self) -> float:
        """Standard error of the mean over surfaces, in ``unit``."""
        return self.spread / np.sqrt(max(len(self.slopes), 1))

    @property
    def off_theory(self) -> float | None:
        """Mean less theory, where chance alone would do that once in a hundred times; None otherwise."""
        if self.theory is None or len(self.slopes) < 2:
            return None
        off = self.mean - self.theory
        return off if abs(off) > stdtrit(len(self.slopes) - 1, 1 - UNLIKELY / 2) * self.error_of_mean else None

    def of_means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers of surfaces averaged, standard deviation of such means, and its own relative error."""
        slopes, sizes = np.array(self.slopes), []
        while not sizes or 2 * sizes[-1] <= len(slopes) // 3:
            sizes.append(2 * sizes[-1] if sizes else 1)
        means = [slopes[: len(slopes) // size * size].reshape(-1, size).mean(axis=1) for size in sizes]
        spread = np.array([np.std(m, ddof=1) if len(m) > 1 else np.nan for m in means])
        return np.array(sizes), spread, np.array([1 / np.sqrt(2 * max(len(m) - 1, 1)) for m in means])


def slopes_of_surfaces(
    assembly,
    counts: list[int],
    steps: dict[str, float],
    surfaces: int,
    time_left: Callable[[], float],
    advance: Callable[[], None],
) -> dict[tuple[str, int], list[tuple[float, float]]]:
    """Sensitivities (u, v) [mm/mm, mm/deg] of every motion at every N1, one for each surface.

    counts: values of N1, rising; steps: displacement [mm or deg] of each motion; surfaces: at most, at least two are
    made for the smallest N1; time_left: tells the time [s] that there still is; advance: called after each surface.
    A larger N1 for which the time does not last to measure two surfaces is left out.
    """
    slopes: dict[tuple[str, int], list[tuple[float, float]]] = {(dof, n): [] for dof in steps for n in counts}
    spent = dict.fromkeys(counts, 0.0)
    waiting = list(counts)
    for number in range(surfaces):
        for count in list(waiting):
            begin = time.perf_counter()
            # The next larger N1 takes at least as long as the one before did, and needs two surfaces to tell anything.
            least = max(spent[n] for n in counts if n <= count) * (2 if number == 0 else 1)
            if least > time_left() and not (number < 2 and count == counts[0]):
                waiting = [n for n in waiting if n < count]
                break
            for dof, slope in _slopes(assembly, count, assembly.seed + number, steps).items():
                slopes[dof, count].append(slope)
            spent[count] = time.perf_counter() - begin
        advance()
    return {(dof, n): found for (dof, n), found in slopes.items() if len(found) > 1}


def _slopes(assembly, count: int, seed: int, steps: dict[str, float]) -> dict[str, tuple[float, float]]:
    """Sensitivities (u, v) [mm/mm, mm/deg] of one surface, from displacements forth and back."""
    assembly = Setting("auto", count, SCATTER_TOLERANCE).of(assembly).with_seed(seed)
    simulation = Simulation(assembly)
    correlator = Correlator(simulation.frame(Pose()).image.intensity)
    found = {}
    for dof, step in steps.items():
        forth, back = (correlator.shift(simulation.frame(Pose(**{dof: s * step})).image.intensity) for s in (1, -1))
        scale = assembly.detector.pitch / (2 * step)
        found[dof] = ((forth.u_px - back.u_px) * scale, (forth.v_px - back.v_px) * scale)
    return found


def rotation_as_far(theory_shift: list[float] | None, expected: dict[str, np.ndarray | None]) -> float:
    """Rotation [deg] about y that moves the pattern about as far as the displacement along x does.

    theory_shift: (u, v) [um] of that displacement; expected: sensitivities of each detector axis [mm/mm, mm/deg].
    """
    if theory_shift is None:
        return 0.005
    per_degree = float(np.hypot(*(expected[axis][NUMBER["ry"]] for axis in ("u", "v"))))
    return float(np.clip(1e-3 * np.hypot(*theory_shift) / max(per_degree, 1e-9), 1e-3, 0.1))


def scatter_of(
    dof: str, count: int, step: float, slopes: np.ndarray, expected: dict[str, np.ndarray | None]
) -> Scatter:
    """The scatter of slopes (surfaces, 2), those along the detector axis that moves most; NaN is left out.

    step: displacement [mm or deg]; expected: sensitivities of each detector axis [mm/mm, mm/deg], None without theory.
    """
    slopes = slopes[np.all(np.isfinite(slopes), axis=1)]
    theory = [None if values is None else float(values[NUMBER[dof]]) for values in expected.values()]
    size = (
        [abs(value) for value in theory]
        if None not in theory
        else np.abs(slopes.mean(axis=0))
        if len(slopes)
        else [1, 0]
    )
    k = int(np.argmax(size))
    values = slopes[:, k]
    mean = float(values.mean()) if len(values) else np.nan
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else np.nan
    unit = "mm/deg" if dof == "ry" else "mm/mm"
    return Scatter(dof, "uv"[k], unit, step, count, values.tolist(), mean, spread, theory[k])
