"""Where the time of a frame and of a sweep goes, and what the engine costs beside the jobs that it has done."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

from ...experiments.execution import executor_of
from ...experiments.jobs import Job, Work, run
from ...field.simulation import Simulation
from ...geometry.pose import Pose
from ...images.exr import write_field
from ...machine.cores import products_on_one_thread
from ...machine.journal import Journal
from ...machine.run_times import Timing, duration
from ...measurement.correlator import Correlator
from ...measurement.speckle_statistics import centre_of_gravity, contrast
from ...scattering.rough_surface import illuminated_scatterers
from .commands import seconds_and_memory, single
from .specimen import Specimen

JOB_SECONDS = 0.01
"""Of the jobs by which the engine's own time is measured: as long as a frame."""

JOBS, QUICK_JOBS, WORKERS = 2000, 40, 2

RUNS = 15

MANY, FEWER = 164, 17
"""Surfaces of 61 frames each: 10,004 and 1,037."""


def frame_budget(specimen: Specimen, folder: Path) -> dict[str, dict]:
    """Processor time of what a frame of a sweep takes, part by part; what is left of the field is its summation."""
    assembly = specimen.assembly
    simulation, pose = Simulation(assembly), Pose(x=0.012)
    rest, frame = (simulation.frame(one, 0).image for one in (Pose(), pose))
    correlator = Correlator(rest.intensity)
    parts: dict[str, Callable[[], object]] = {
        "frame: field and intensity": lambda: simulation.frame(pose, 0),
        "frame: of it, scatterers": lambda: illuminated_scatterers(
            assembly.target.surface, assembly.beam, assembly.target.frame
        ),
        "frame: shift": lambda: correlator.shift(frame.intensity),
        "frame: contrast, centre": lambda: (contrast(frame.intensity), centre_of_gravity(frame.intensity)),
        "frame: writing, if it stays": lambda: write_field(folder / "budget.exr", frame),
    }
    with products_on_one_thread():
        return {name: asdict(_processor_time(work)) | {"what": "of the processors"} for name, work in parts.items()}


def _processor_time(work: Callable[[], object]) -> Timing:
    times = []
    for _ in range(RUNS + 1):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return Timing.of(times[1:], times[0])


def sweep_budget(folder: Path, scene: Path, quick: bool) -> dict[str, dict]:
    """A sweep from a cold start to its table and pictures, and its stages."""
    asked = ["--dof", "x", "--steps", "2", "--seeds", "2"] if quick else []
    out = folder / "budget"
    seconds, memory = seconds_and_memory(["sweep", str(scene), "--out", str(out), "--quiet", *asked])
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    found = {"sweep: whole": single(seconds, memory, f"{summary['frames']} frames, cold start to report")}
    stages = summary["seconds_by_stage"]
    started = seconds - summary["seconds_total"]
    found["sweep: python, imports, report"] = single(started, None, "before and after what the sweep counts")
    return found | {f"sweep: {name}": single(taken, None, "") for name, taken in stages.items()}


def engine_overhead(folder: Path, quick: bool) -> dict[str, dict]:
    """What is lost beside jobs of ``JOB_SECONDS``, in this process and in workers, a journal of results included."""
    found = {}
    for name, scheduler, workers in (
        ("this process", None, 1), (f"{WORKERS} workers", f"local:{WORKERS}", WORKERS)
    ):  # fmt: skip
        if scheduler is None or find_spec("distributed") is not None:
            count = workers * (QUICK_JOBS if quick else JOBS // 2)
            with executor_of(scheduler) as executor, Journal(folder / f"overhead{workers}") as done:
                list(run(_jobs(2 * workers, "first"), executor))  # processes begin
                began, worked = time.perf_counter(), 0.0
                for _, seconds in run(_jobs(count, "timed"), executor, done):
                    worked += seconds
                whole = time.perf_counter() - began
            lost = 1 - worked / (workers * whole)
            found[f"engine: {name}"] = single(
                whole, None, f"{count:,} jobs of {duration(worked / count)}, {lost:.1%} of the time is lost"
            ) | {"lost": lost}
    return found


def _jobs(count: int, name: str) -> list[Job]:
    work = Work(Waits, JOB_SECONDS)
    return [Job(work, (name, number)) for number in range(count)]


class Waits:
    """A job of known length, that takes nothing from whatever else runs."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def __call__(self, item: object) -> float:
        began = time.perf_counter()
        time.sleep(self._seconds)
        return time.perf_counter() - began


def many_frames(folder: Path, scene: Path) -> dict[str, dict]:
    """A sweep of 10,000 small frames beside one of a tenth of it: seconds a frame, and the memory that both take."""
    found = {}
    for surfaces in (FEWER, MANY):
        asked = ["-D", "width=64", "-D", "height=64", "--seeds", str(surfaces), "--keep", "none", "--quiet"]
        seconds, memory = seconds_and_memory(["sweep", str(scene), "--out", str(folder / f"many{surfaces}"), *asked])
        frames = 61 * surfaces
        what = f"of 64 x 64 pixels, {duration(seconds / frames)} each, cold start"
        found[f"sweep, {frames:,} frames"] = single(seconds, memory, what)
    return found
