"""How often the intervals of one-frame sensitivities hold first-order theory.

``python tests/interval_coverage.py [scene ...]`` repeats the measurement of four surfaces 200 times for each of some
shipped scenes and prints, for each motion and axis, how often theory lies in the 95 % interval.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

REPETITIONS, SURFACES = 200, 4
LEAST, MOST = 0.90, 0.99
"""Shares of 200 repetitions, of 95 % intervals, that are allowed for every entry."""

SCENES = ("tilted_laser", "tilted_detector", "folded")


def coverage(simulation, repetitions: int) -> dict[tuple[str, str], float]:
    """Share of repetitions in whose interval theory lies, for every motion and both axes of the detector."""
    from speckle_mi.experiments.one_frame import OneFrame, sensitivity_of
    from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM

    measurement = OneFrame(simulation)
    measurement.measure(range(repetitions * SURFACES))
    whole, inside = measurement.result, {}
    for first in range(0, repetitions * SURFACES, SURFACES):
        some = slice(first, first + SURFACES)
        part = replace(whole, linear=whole.linear[some], curved=whole.curved[some], seeds=whole.seeds[some])
        for dof, fitted in sensitivity_of(simulation, part, DEGREES_OF_FREEDOM).fits.items():
            for axis in "uv":
                fit = fitted[axis]
                inside.setdefault((dof, axis), []).append(fit.ci95[0] <= fit.theory <= fit.ci95[1])
    return {entry: float(np.mean(held)) for entry, held in inside.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=SCENES, help="names of shipped scenes")
    parser.add_argument("--repetitions", type=int, default=REPETITIONS)
    options = parser.parse_args()
    import mitsuba as mi

    from speckle_mi.field.simulation import Simulation
    from speckle_mi.machine.backend import set_variant
    from speckle_mi.scene.read import assembly_from_scene

    set_variant()
    mi.set_log_level(mi.LogLevel.Error)
    failed = 0
    for name in options.scenes:
        path = Path(__file__).resolve().parent.parent / "scenes" / f"{name}.xml"
        found = coverage(Simulation(assembly_from_scene(mi.load_file(str(path)))), options.repetitions)
        print(f"{name}, {options.repetitions} repetitions of {SURFACES} surfaces, all {np.mean(list(found.values())):.3f}")
        for (dof, axis), share in found.items():
            bad = not LEAST <= share <= MOST
            failed += bad
            print(f"  {dof:>2} -> {axis}  {share:.3f}{'  outside' if bad else ''}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
