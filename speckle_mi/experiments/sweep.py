"""A sweep: the target moves through its motions, every frame is rendered and correlated with the one at rest."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..field.detectors import Simulations
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, unit_of
from ..images.field_image import FieldImage
from ..machine.cores import usable_cores
from ..machine.journal import Journal
from ..machine.memory import excess
from ..machine.progress import progress_bars
from ..scene.assembly import Assembly
from .execution import WHOLE, Shard
from .frame_measurement import IMAGES, FrameMeasurement, FrameTask, SweptScene, in_single_precision
from .jobs import Executor, InProcess, Job, Work
from .kept_images import ALL, KeptImages
from .slides import Slides
from .sweep_result import REFERENCE, FrameRecord, SweepResult, SweepSettings

MOST_THREADS = 4
"""Frames that are made at a time: what of them is Python takes turns."""

_AT_REST = 0
"""Number of the first surface's frame at rest."""


@dataclass(frozen=True)
class SweptFrame:
    """One frame of a sweep: its number, the motion, how far [mm or deg], what is to be done for it, and the name that
    its images are kept under; is_of_first: of the first surface."""

    number: int
    dof: str
    displacement: float
    task: FrameTask
    name: str
    is_of_first: bool

    def record(self, seconds: float, columns: Mapping[str, object]) -> FrameRecord:
        """The row that it gives."""
        unit = unit_of(self.dof) if self.dof in DEGREES_OF_FREEDOM else "mm"
        return FrameRecord(
            dof=self.dof, displacement=self.displacement, unit=unit, seed=self.task.seed, seconds=seconds, **columns
        )


def frames_of_sweep(settings: SweepSettings) -> Iterator[SweptFrame]:
    """The frames of a sweep: for every surface the one at rest, then those of each motion."""
    number = 0
    for seed in settings.seeds:
        is_first = seed == settings.seeds[0]
        yield SweptFrame(number, REFERENCE, 0.0, FrameTask(Pose(), seed), f"seed{seed}_reference", is_first)
        number += 1
        for dof in settings.dofs:
            for step, displacement in enumerate(map(float, settings.displacements)):
                # At no displacement a camera takes another picture of what it saw at rest.
                shot = 0 if displacement else 1 + DEGREES_OF_FREEDOM.index(dof)
                task = FrameTask(Pose(**{dof: displacement}), seed, shot)
                yield SweptFrame(number, dof, displacement, task, f"seed{seed}_{dof}_{step:03d}", is_first)
                number += 1


def run_sweep(
    assembly: Assembly, settings: SweepSettings, frames: Path, result: SweepResult, quiet: bool = False, **named
) -> None:
    """:func:`run_sweeps` of one detector, whose images have no name of its."""
    run_sweeps({"": assembly}, settings, frames, {"": result}, quiet, **named)


def run_sweeps(
    assemblies: Mapping[str, Assembly],
    settings: SweepSettings,
    frames: Path,
    results: Mapping[str, SweepResult],
    quiet: bool = False,
    executor: Executor | None = None,
    done: Journal | None = None,
    keep: str = ALL,
    pictures: str | None = None,
    shard: Shard = WHOLE,
) -> int:
    """Makes the frames of a sweep of one or several detectors that are not in their ``results`` yet, and adds them.

    Images are written beside the computation: ``NAME.exr``, of several detectors ``NAME.ID.exr``. executor: who makes
    the frames (default: this process). done: an open journal of what earlier runs have finished, which is taken over
    where the images that are to stay are there, too. keep: which of the images stay, one of ``KEPT``. pictures: ``png``
    or ``tiff``, to write what the cameras save of every frame as well. shard: which part of the frames to make; returns
    how many others have not finished yet.
    """
    work = Work(FrameMeasurement, SweptScene.of(assemblies, settings.window))
    measurement = FrameMeasurement(work.given)
    if executor is None:
        executor = InProcess(frames_at_a_time(measurement.simulations))
    if isinstance(executor, InProcess):
        executor.workplace.hold(work, measurement)
    planned = list(frames_of_sweep(settings))
    finished = _Finished(results, measurement, settings, len(planned))
    shown = _Shown(results, measurement)
    with KeptImages(frames, assemblies, keep, pictures) as images, progress_bars(quiet) as progress:
        bar = progress.add_task("frames", total=len(planned), completed=sum(map(finished.has, planned)))

        def take_over(wanted: Iterable[SweptFrame]) -> list[SweptFrame]:
            """Adds those that the journal holds; returns the others."""
            left = []
            for one in wanted:
                if finished.has(one):
                    continue
                key = Job(work, one.task).key
                if done is not None and key in done and images.are_there(one.name, one.task, one.is_of_first):
                    finished.add(one, done[key])
                    progress.advance(bar)
                else:
                    left.append(one)
            return left

        left = take_over(planned)
        own = {Job(work, one.task).key: one for one in left if shard.takes(one.number, len(planned))}
        wanted = {key: IMAGES for key, one in own.items() if shown.wants(one) or images.are_wanted(one.is_of_first)}
        for job, result in executor.results(Job(work, one.task, wanted.get(key)) for key, one in own.items()):
            key, made = job.key, result.pop(IMAGES, None)
            one = own[key]
            shown.see(one, made)

            def finish(one: SweptFrame = one, key: str = key, result: dict = result) -> None:
                finished.add(one, result if done is None else done.add(key, result))
                progress.advance(bar)

            if images.are_wanted(one.is_of_first):
                images.write(one.name, one.is_of_first, made, finish)
            else:
                finish()
        images.settle()
        if done is not None and not shard.is_whole:
            done.read_again()
        if left := take_over(planned):
            return len(left)
        shown.complete(planned, images)
    return 0


class _Finished:
    """Adds what frames gave to the results, each once it is whole."""

    def __init__(
        self, results: Mapping[str, SweepResult], measurement: FrameMeasurement, settings: SweepSettings, count: int
    ) -> None:
        self._results, self._lock = results, threading.Lock()
        for name, seen in measurement.seen.items():
            result = results[name]
            result.axes_as_seen = {"u": seen.u.tolist(), "v": seen.v.tolist()}
            first, share = settings.seeds[0], 1 / len(results)
            result.slides = result.slides or Slides(settings.dofs, settings.displacements, first, share)
            if seen.note:
                result.warnings[seen.note] = count

    def has(self, frame: SweptFrame) -> bool:
        return all(frame.number in result.by_number for result in self._results.values())

    def add(self, frame: SweptFrame, found: Mapping) -> None:
        with self._lock:
            for name, one in found["detectors"].items():
                self._results[name].note(one)
                self._results[name].by_number[frame.number] = frame.record(found["seconds"], one["columns"])


class _Shown:
    """The images of the first surface that a report shows, taken as they pass by, or read or made again at the end."""

    def __init__(self, results: Mapping[str, SweepResult], measurement: FrameMeasurement) -> None:
        self._results, self._measurement = results, measurement
        self._seen: set[int] = set()

    def wants(self, frame: SweptFrame) -> bool:
        slides = next(iter(self._results.values())).slides
        return frame.is_of_first and (frame.number == _AT_REST or frame.displacement in slides.displacements)

    def see(self, frame: SweptFrame, images: Mapping[str, FieldImage] | None) -> None:
        if images is None or not self.wants(frame) or frame.number in self._seen:
            return
        if frame.number != _AT_REST and _AT_REST not in self._seen:  # all others are shown beside the one at rest
            self._add(_AT_REST, frame.task.seed, self._made(FrameTask(Pose(), frame.task.seed)))
        self._add(frame.number, frame.task.seed, images, frame.dof, frame.displacement)

    def complete(self, planned: list[SweptFrame], images: KeptImages) -> None:
        """Those of frames that an earlier run has finished; then brings all in order."""
        for frame in planned:
            if self.wants(frame) and frame.number not in self._seen:
                self.see(frame, images.read(frame.name, frame.task) or self._made(frame.task))
        for result in self._results.values():
            for slides in result.slides.motions.values():
                slides.sort(key=lambda slide: slide.displacement)

    def _made(self, task: FrameTask) -> dict[str, FieldImage]:
        frames = self._measurement.simulations.frames(task.pose, task.seed, task.shot)
        return {name: in_single_precision(frame.image) for name, frame in frames.items()}

    def _add(
        self, number: int, seed: int, images: Mapping[str, FieldImage], dof: str = REFERENCE, displacement: float = 0.0
    ) -> None:
        self._seen.add(number)
        for name, image in images.items():
            result = self._results[name]
            result.slides.add(None if dof == REFERENCE else dof, displacement, seed, image)
            if dof == REFERENCE:
                result.example = image.measured


def frames_at_a_time(simulations: Simulations) -> int:
    """As many as there are cores, and memory for them."""
    threads = min(usable_cores(), MOST_THREADS)
    return threads if not excess(threads * simulations.cost(Pose()).memory) else 1
