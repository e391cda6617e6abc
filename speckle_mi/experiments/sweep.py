"""A sweep: the target moves through its motions, every frame is rendered and correlated with the one at rest."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ..field.simulation import Simulation, plan_of
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, unit_of
from ..images.exr import read_field, write_field
from ..images.field_image import FieldImage, FieldImageError
from ..machine.progress import progress_bars
from ..measurement.correlator import Correlator
from ..measurement.speckle_statistics import centre_of_gravity, contrast
from ..scene.assembly import Assembly
from ..version import __version__
from .chief_ray import SeenAxes, axes_as_seen
from .executor import Executor, FrameTask, InProcess
from .expectation import on_all_axes
from .sweep_result import REFERENCE, FrameRecord, SweepResult, SweepSettings

_PENDING_WRITES = 8
"""Frames that may wait to be written: bounds the memory they take."""


def tasks_of(settings: SweepSettings) -> list[FrameTask]:
    """The frames of a sweep: for every surface the one at rest, then those of each motion."""
    return [
        FrameTask(Pose(**{dof: float(displacement)} if dof != REFERENCE else {}), seed, name)
        for seed in settings.seeds
        for dof, displacement, name in _frames_of_surface(settings, seed)
    ]


def _frames_of_surface(settings: SweepSettings, seed: int) -> Iterator[tuple[str, float, str]]:
    """Motion, displacement [mm or deg] and name of the frames of one surface."""
    yield REFERENCE, 0.0, f"seed{seed}_reference"
    for dof in settings.dofs:
        for number, displacement in enumerate(settings.displacements):
            yield dof, float(displacement), f"seed{seed}_{dof}_{number:03d}"


def run_sweep(
    assembly: Assembly,
    settings: SweepSettings,
    frames: Path,
    result: SweepResult,
    quiet: bool = False,
    resume: bool = False,
    executor: Executor | None = None,
) -> None:
    """Makes all frames of a sweep, adding to ``result`` as it goes and writing images beside the computation.

    resume: takes the images that an interrupted sweep of the same settings has left; their records have no time.
    executor: who makes the frames (default: this process).
    """
    tasks = tasks_of(settings)
    held = {task.name for task in tasks if resume and _is_finished(frames, task, assembly)}
    seen = axes_as_seen(assembly, plan_of(assembly))
    result.axes_as_seen = {"u": seen.u.tolist(), "v": seen.v.tolist()}
    if seen.note:
        result.warnings[seen.note] = len(tasks)
    made = (executor or InProcess(Simulation(assembly))).results(task for task in tasks if task.name not in held)
    with _Writer(frames, result.writes) as writer, progress_bars(quiet) as progress:
        bar = progress.add_task("frames", total=len(tasks))

        def images() -> Iterator[tuple[np.ndarray, float]]:
            """Intensity of every frame, and when it was begun (NaN for one that was there already)."""
            for task in tasks:
                start = np.nan if task.name in held else time.perf_counter()
                if task.name in held:
                    image = read_field(frames / f"{task.name}.exr")
                    result.writes.append(_done())
                else:
                    image = next(made).image
                    writer.write(task.name, image)
                result.note(image.header)
                progress.advance(bar)
                yield image.intensity, start

        _correlate(assembly, settings, result, images(), seen)


class _Writer:
    """Writes images beside the computation, a few of which may wait."""

    def __init__(self, folder: Path, writes: list[Future]) -> None:
        self._folder, self._writes = folder, writes
        self._pool = ThreadPoolExecutor(max_workers=1)

    def __enter__(self) -> _Writer:
        return self

    def write(self, name: str, image: FieldImage) -> None:
        if len(self._writes) >= _PENDING_WRITES:
            self._writes[-_PENDING_WRITES].result()
        self._writes.append(self._pool.submit(write_field, self._folder / f"{name}.exr", image))

    def __exit__(self, kind, *_: object) -> None:
        try:
            if kind is None:
                for write in self._writes:
                    write.result()
        finally:
            # Where it went wrong, as the disk is full, say, the frames that wait are not tried.
            self._pool.shutdown(cancel_futures=True)


def _done() -> Future:
    future: Future = Future()
    future.set_result(None)
    return future


def _correlate(
    assembly: Assembly,
    settings: SweepSettings,
    result: SweepResult,
    images: Iterator[tuple[np.ndarray, float]],
    seen: SeenAxes,
) -> None:
    """Adds a record of every image to ``result``, measured against the one at rest of its surface.

    seen: the detector's axes as the target sees them.
    """
    for seed in settings.seeds:
        correlator = None
        for (dof, displacement, _), (intensity, start) in zip(_frames_of_surface(settings, seed), images, strict=False):
            if dof == REFERENCE:
                correlator = Correlator(intensity, settings.window)
                result.example = intensity if result.example is None else result.example
            result.records.append(_record(dof, displacement, seed, correlator, intensity, assembly, seen, start))


def _is_finished(frames: Path, task: FrameTask, assembly: Assembly) -> bool:
    """Whether an earlier run of the same version has left the frame's image, whole."""
    wanted = {
        "scene_hash": assembly.fingerprint(),
        "seed": task.seed,
        "pose": str(task.pose),
        "version": __version__,
    }
    try:
        return wanted.items() <= read_field(frames / f"{task.name}.exr").header.items()
    except FieldImageError:
        return False


def _record(
    dof: str,
    displacement: float,
    seed: int,
    correlator: Correlator,
    intensity: np.ndarray,
    assembly: Assembly,
    seen: SeenAxes,
    start: float,
) -> FrameRecord:
    pixel = 1e3 * assembly.detector.pitch
    shift = correlator.shift(intensity)
    u, v, x, y = on_all_axes(np.array([[shift.u_px], [shift.v_px]]) * pixel, assembly, seen)[:, 0]
    cog = np.array(centre_of_gravity(intensity)) * pixel
    return FrameRecord(
        dof=dof,
        displacement=displacement,
        unit=unit_of(dof) if dof in DEGREES_OF_FREEDOM else "mm",
        seed=seed,
        shift_u_um=float(u),
        shift_v_um=float(v),
        shift_x_um=float(x),
        shift_y_um=float(y),
        ncc=shift.ncc,
        cog_u_um=float(cog[0]),
        cog_v_um=float(cog[1]),
        contrast=contrast(intensity),
        seconds=time.perf_counter() - start,
        status=shift.status,
        sigma_u_um=shift.sigma_u_px * pixel,
        sigma_v_um=shift.sigma_v_px * pixel,
    )
