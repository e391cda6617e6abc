"""Sensitivities from one frame a surface against a sweep of the same scene, timed in one run."""

from __future__ import annotations

import time
from dataclasses import asdict

import numpy as np

from ...experiments.one_frame import OneFrame, sensitivity_of
from ...field.simulation import Simulation
from ...geometry.pose import DEGREES_OF_FREEDOM, Pose
from ...machine.run_times import timed
from ...measurement.correlator import Correlator
from ...scene.assembly import Assembly

SURFACES = 8
STEPS = 10
"""Displacements of each motion in the sweep: its own default."""

MOVED = 0.004
"""Displacement [mm or deg] between frames of the sweep that are timed."""


def against_sweep(name: str, assembly: Assembly, surfaces: int = SURFACES, frames: int = 6) -> dict[str, dict]:
    """Name -> {seconds, what} of the six sensitivities of a scene by one frame a surface, and by a sweep.

    A sweep's frames differ in pose alone: ``frames`` of them, one of each motion, are rendered and correlated, and
    stand for all 61 of a surface. Neither writes anything.
    """
    simulation = Simulation(assembly)

    def sensitivities() -> None:
        measurement = OneFrame(simulation)
        measurement.measure(range(surfaces))
        sensitivity_of(simulation, measurement.result, DEGREES_OF_FREEDOM)

    timing = asdict(timed(sensitivities))
    correlator = Correlator(simulation.frame(Pose(), 0).image.intensity)
    seconds = []
    for number in range(frames):
        pose = Pose(**{DEGREES_OF_FREEDOM[number % 6]: MOVED})
        began = time.perf_counter()
        correlator.shift(simulation.frame(pose, 0).image.intensity)
        seconds.append(time.perf_counter() - began)
    whole = surfaces * (1 + 6 * STEPS)
    low, middle, high = (whole * float(value) for value in np.quantile(seconds, (0.25, 0.5, 0.75)))
    sweep = {"median": middle, "q1": low, "q3": high, "first": whole * seconds[0], "runs": frames}
    ratio = middle / timing["median"]
    return {
        f"sensitivities, {name}": timing
        | {"what": f"one frame of {surfaces} surfaces, six motions; a sweep takes {ratio:.0f} times as long",
           "sweep_takes_times": ratio},
        f"sweep, {name}": sweep | {"what": f"~ {whole} frames, {frames} of them timed"},
    }  # fmt: skip
