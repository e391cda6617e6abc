"""A sweep: the target moves through its motions, every frame is rendered and correlated with the one at rest."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..field.detectors import Simulations
from ..field.simulation import plan_of
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, unit_of
from ..images.exr import read_field, read_header, write_field
from ..images.field_image import FieldImage, FieldImageError
from ..images.saved import write_picture
from ..machine.files import for_part
from ..machine.progress import progress_bars
from ..measurement.correlator import Correlator
from ..measurement.speckle_statistics import centre_of_gravity, contrast
from ..scene.assembly import Assembly
from ..version import __version__
from .chief_ray import axes_as_seen
from .executor import FrameExecutor, FrameTask, FramesInProcess
from .expectation import on_all_axes
from .slides import Slides
from .sweep_result import REFERENCE, FrameRecord, SweepResult, SweepSettings

_PENDING_WRITES = 8
"""Frames that may wait to be written: bounds the memory they take."""


@dataclass(frozen=True)
class SweptFrame:
    """One frame of a sweep: the motion, how far [mm or deg], and what is to be done for it."""

    dof: str
    displacement: float
    task: FrameTask


def frames_of_sweep(settings: SweepSettings) -> Iterator[SweptFrame]:
    """The frames of a sweep: for every surface the one at rest, then those of each motion."""
    for seed in settings.seeds:
        yield SweptFrame(REFERENCE, 0.0, FrameTask(Pose(), seed, f"seed{seed}_reference"))
        for dof in settings.dofs:
            for number, displacement in enumerate(map(float, settings.displacements)):
                # At no displacement a camera takes another picture of what it saw at rest.
                shot = 0 if displacement else 1 + DEGREES_OF_FREEDOM.index(dof)
                task = FrameTask(Pose(**{dof: displacement}), seed, f"seed{seed}_{dof}_{number:03d}", shot)
                yield SweptFrame(dof, displacement, task)


def run_sweep(
    assembly: Assembly,
    settings: SweepSettings,
    frames: Path,
    result: SweepResult,
    quiet: bool = False,
    resume: bool = False,
    executor: FrameExecutor | None = None,
) -> None:
    """:func:`run_sweeps` of one detector, whose images have no name of its."""
    run_sweeps({"": assembly}, settings, frames, {"": result}, quiet, resume, executor)


def run_sweeps(
    assemblies: Mapping[str, Assembly],
    settings: SweepSettings,
    frames: Path,
    results: Mapping[str, SweepResult],
    quiet: bool = False,
    resume: bool = False,
    executor: FrameExecutor | None = None,
    pictures: str | None = None,
) -> None:
    """Makes all frames of a sweep of one or several detectors, adding to their ``results`` as it goes.

    Images are written beside the computation: ``NAME.exr``, of several detectors ``NAME.ID.exr``. resume: takes the
    images that an interrupted sweep of the same settings has left; their records have no time. executor: who makes the
    frames (default: this process). pictures: ``png`` or ``tiff``, to write what the cameras save as well.
    """
    planned = list(frames_of_sweep(settings))
    images = _Images(frames, assemblies, pictures)
    held = {one.task.name for one in planned if resume and images.are_finished(one.task)}
    tables = {
        name: _Measurement(assembly, settings, results[name], len(planned), 1 / len(assemblies))
        for name, assembly in assemblies.items()
    }
    executor = executor or FramesInProcess(Simulations(assemblies))
    made = executor.results(one.task for one in planned if one.task.name not in held)
    with images, progress_bars(quiet) as progress:
        bar = progress.add_task("frames", total=len(planned))
        for one in planned:
            found = images.read(one.task) if one.task.name in held else None
            if found is None and one.task.name in held:  # whole by its header, but damaged
                found = images.written(one.task, next(iter(executor.results([one.task]))))
            elif found is None:
                found = images.written(one.task, next(made))
            for name, image in found.items():
                results[name].writes.append(image.write)
                results[name].note(image.image.header)
                tables[name].add(one, image.image, image.seconds)
            progress.advance(bar)


@dataclass(frozen=True)
class _Kept:
    """An image, when it is on disk, and the seconds that it took (NaN for one that was there already)."""

    image: FieldImage
    write: Future
    seconds: float


class _Images:
    """The images of a sweep's folder: which are there, and writing beside the computation, where a few may wait."""

    def __init__(self, folder: Path, assemblies: Mapping[str, Assembly], pictures: str | None) -> None:
        self._folder, self._pictures = folder, pictures
        self._hashes = {name: assembly.fingerprint() for name, assembly in assemblies.items()}
        self._waiting: deque[Future] = deque()
        self._pool = ThreadPoolExecutor(max_workers=1)

    def __enter__(self) -> _Images:
        return self

    def __exit__(self, kind, *_: object) -> None:
        try:
            while kind is None and self._waiting:
                self._waiting.popleft().result()
        finally:
            # Where it went wrong, as the disk is full, say, the frames that wait are not tried.
            self._pool.shutdown(cancel_futures=True)

    def _path(self, task: FrameTask, name: str) -> Path:
        path = self._folder / f"{task.name}.exr"
        return path if len(self._hashes) == 1 else for_part(path, name)

    def are_finished(self, task: FrameTask) -> bool:
        """Whether an earlier run of the same version has left the images of all detectors, by their headers."""
        for name, scene_hash in self._hashes.items():
            wanted = {"scene_hash": scene_hash, "seed": task.seed, "pose": str(task.pose), "version": __version__}
            try:
                if not wanted.items() <= read_header(self._path(task, name)).items():
                    return False
            except FieldImageError:
                return False
        return True

    def read(self, task: FrameTask) -> dict[str, _Kept] | None:
        """The images of a finished frame, None where one of them cannot be read."""
        found = {}
        for name in self._hashes:
            path = self._path(task, name)
            try:
                image = read_field(path)
            except FieldImageError:
                return None
            write: Future = Future()
            write.set_result(None)
            if self._pictures and not path.with_suffix(f".{self._pictures}").is_file():
                self._later(_write_picture, path, image, self._pictures)
            found[name] = _Kept(image, write, np.nan)
        return found

    def written(self, task: FrameTask, made: Mapping) -> dict[str, _Kept]:
        """The images of a frame that was made, which are being written."""
        found = {}
        for name, frame in made.items():
            write = self._later(_write, self._path(task, name), frame.image, self._pictures)
            found[name] = _Kept(frame.image, write, frame.seconds)
        return found

    def _later(self, function, *arguments: object) -> Future:
        while len(self._waiting) >= _PENDING_WRITES:
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(function, *arguments))
        return self._waiting[-1]


def _write(path: Path, image: FieldImage, pictures: str | None) -> None:
    if pictures:  # first, so that a frame that counts as finished has its picture
        _write_picture(path, image, pictures)
    write_field(path, image)


def _write_picture(path: Path, image: FieldImage, kind: str) -> None:
    write_picture(path.with_name(f"{path.stem}.{kind}"), image)


class _Measurement:
    """Shifts of one detector's images against the one at rest of their surface, a record of each."""

    def __init__(
        self, assembly: Assembly, settings: SweepSettings, result: SweepResult, count: int, share: float
    ) -> None:
        self._assembly, self._settings, self._result = assembly, settings, result
        self._seen = axes_as_seen(assembly, plan_of(assembly))
        self._correlator: Correlator | None = None
        result.slides = Slides(settings.dofs, settings.displacements, settings.seeds[0], share)
        result.axes_as_seen = {"u": self._seen.u.tolist(), "v": self._seen.v.tolist()}
        if self._seen.note:
            result.warnings[self._seen.note] = count

    def add(self, frame: SweptFrame, image: FieldImage, seconds: float) -> None:
        """seconds: that the image took; the record's are those of its measurement, too."""
        start, measured = time.perf_counter(), image.measured
        if frame.dof == REFERENCE:
            self._correlator = Correlator(measured, self._settings.window)
            self._result.example = measured if self._result.example is None else self._result.example
        dof = None if frame.dof == REFERENCE else frame.dof
        self._result.slides.add(dof, frame.displacement, frame.task.seed, image)
        pixel = 1e3 * self._assembly.detector.pitch
        shift = self._correlator.shift(measured)
        along = on_all_axes(np.array([[shift.u_px], [shift.v_px]]) * pixel, self._assembly, self._seen)[:, 0]
        u, v, x, y = map(float, along)
        cog = np.array(centre_of_gravity(measured)) * pixel
        record = FrameRecord(
            dof=frame.dof,
            displacement=frame.displacement,
            unit=unit_of(frame.dof) if frame.dof in DEGREES_OF_FREEDOM else "mm",
            seed=frame.task.seed,
            shift_u_um=u,
            shift_v_um=v,
            shift_x_um=x,
            shift_y_um=y,
            ncc=shift.ncc,
            cog_u_um=float(cog[0]),
            cog_v_um=float(cog[1]),
            contrast=contrast(measured),
            seconds=seconds + time.perf_counter() - start,
            status=shift.status,
            sigma_u_um=shift.sigma_u_px * pixel,
            sigma_v_um=shift.sigma_v_px * pixel,
        )
        self._result.records.append(record)
