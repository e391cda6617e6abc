"""A sweep: the target moves through its motions, every frame is rendered and correlated with the one at rest."""

from __future__ import annotations

import time
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation
from ..images.exr import read_field, write_field
from ..images.field_image import FieldImage, FieldImageError
from ..machine.progress import progress_bars
from ..measurement.correlator import Correlator
from ..measurement.speckle_statistics import centre_of_gravity, contrast
from ..version import __version__

_PENDING_WRITES = 8
"""Frames that may wait to be written: bounds the memory they take."""

REFERENCE = "reference"
"""``dof`` of the frames at rest in sweep.csv."""


@dataclass(frozen=True)
class SweepSettings:
    """dofs: which motions; displacements: (n,) [mm or deg]; seeds: which surfaces; window: of the correlation [px]."""

    dofs: tuple[str, ...]
    displacements: np.ndarray
    seeds: tuple[int, ...]
    window: int | None


@dataclass(frozen=True)
class FrameRecord:
    """What one frame gave: a row of sweep.csv. Shifts and centres of gravity [um], NaN where not measured.

    sigma_u_um, sigma_v_um: standard uncertainties of the shifts, from the two images alone [um].
    """

    dof: str
    displacement: float
    unit: str
    seed: int
    shift_u_um: float
    shift_v_um: float
    shift_x_um: float
    shift_y_um: float
    ncc: float
    cog_u_um: float
    cog_v_um: float
    contrast: float
    seconds: float
    status: str
    sigma_u_um: float
    sigma_v_um: float


@dataclass
class SweepResult:
    """All frames of a sweep in the order they were made, and what was noticed on the way."""

    records: list[FrameRecord] = field(default_factory=list)
    plan: list[str] = field(default_factory=list)
    numerical_error: float = 0.0
    warnings: dict[str, int] = field(default_factory=dict)
    example: np.ndarray | None = None
    writes: list[Future] = field(default_factory=list)

    def note(self, numerical_error: float, warnings: Iterable[str]) -> None:
        """Takes account of what was noticed at one frame."""
        self.numerical_error = max(self.numerical_error, numerical_error)
        for warning in warnings:
            self.warnings[warning] = self.warnings.get(warning, 0) + 1

    def finished(self) -> list[FrameRecord]:
        """The records whose images are on disk: the others are lost when the sweep ends here."""
        whole = (write.done() and not write.cancelled() and write.exception() is None for write in self.writes)
        return [record for record, is_whole in zip(self.records, whole) if is_whole]

    def values(self, dof: str, name: str, settings: SweepSettings) -> np.ndarray:
        """Column ``name`` of a motion's frames as (seeds, displacements), less the reference's for cog columns."""
        seeds = {seed: row for row, seed in enumerate(settings.seeds)}
        places = {displacement: column for column, displacement in enumerate(settings.displacements)}
        table = np.full((len(seeds), len(places)), np.nan)
        origin = np.zeros((len(seeds), 1))
        for record in self.records:
            row = seeds[record.seed]
            if record.dof == dof:
                table[row, places[record.displacement]] = getattr(record, name)
            elif record.dof == REFERENCE and name.startswith("cog_"):
                origin[row] = getattr(record, name)
        return table - origin


def frame_count(settings: SweepSettings) -> int:
    """Frames of a sweep, references included."""
    return frames_of(len(settings.seeds), len(settings.dofs), len(settings.displacements))


def frames_of(seeds: int, dofs: int, steps: int) -> int:
    return seeds * (1 + dofs * steps)


def run_sweep(
    assembly, settings: SweepSettings, frames: Path, result: SweepResult, quiet: bool = False, resume: bool = False
) -> None:
    """Makes all frames of a sweep, adding to ``result`` as it goes and writing images beside the computation.

    resume: takes the images that an interrupted sweep of the same settings has left; their records have no time.
    """
    with ThreadPoolExecutor(max_workers=1) as writer, progress_bars(quiet) as progress:
        task = progress.add_task("frames", total=frame_count(settings))
        writes = result.writes

        def make(surface, pose: Pose, name: str) -> tuple[np.ndarray, float]:
            """Intensity of a frame, and when it was begun (NaN for one that was there already)."""
            start, path = time.perf_counter(), frames / f"{name}.exr"
            image = _finished_image(path, surface, pose) if resume else None
            if image is not None:
                result.plan = result.plan or image.header["plan"].split("; ")
                result.note(image.header["numerical_error"], filter(None, image.header["warnings"].split("; ")))
                writes.append(Future())
                writes[-1].set_result(None)
                progress.advance(task)
                return image.intensity, np.nan
            frame = _simulated(surface, pose, result)
            if len(writes) >= _PENDING_WRITES:
                writes[-_PENDING_WRITES].result()
            writes.append(writer.submit(write_field, path, frame.image))
            progress.advance(task)
            return frame.image.intensity, start

        try:
            for seed in settings.seeds:
                _sweep_surface(assembly.with_seed(seed), seed, settings, result, make)
            for write in writes:
                write.result()
        except BaseException:
            # The disk is full, say: the frames that wait are not tried.
            writer.shutdown(cancel_futures=True)
            raise


def _sweep_surface(assembly, seed: int, settings: SweepSettings, result: SweepResult, make) -> None:
    """The reference and every displaced frame of one surface."""
    reference, start = make(assembly, Pose(), f"seed{seed}_reference")
    if result.example is None:
        result.example = reference
    correlator = Correlator(reference, settings.window)
    result.records.append(_record(REFERENCE, 0.0, seed, correlator, reference, assembly, start))
    for dof in settings.dofs:
        for number, displacement in enumerate(settings.displacements):
            image, start = make(assembly, Pose(**{dof: float(displacement)}), f"seed{seed}_{dof}_{number:03d}")
            result.records.append(_record(dof, float(displacement), seed, correlator, image, assembly, start))


def _finished_image(path: Path, assembly, pose: Pose) -> FieldImage | None:
    """The image that an earlier run of the same version has left at ``path``; None where there is none that fits."""
    wanted = {
        "scene_hash": assembly.fingerprint(),
        "seed": assembly.seed,
        "pose": str(pose),
        "version": __version__,
    }
    try:
        image = read_field(path)
    except FieldImageError:
        return None
    return image if wanted.items() <= image.header.items() else None


def _simulated(assembly, pose: Pose, result: SweepResult):
    from ..field.simulate import simulate_frame

    frame = simulate_frame(assembly, pose)
    result.plan = result.plan or frame.plan
    result.note(frame.numerical_error, frame.warnings)
    return frame


def _record(
    dof: str, displacement: float, seed: int, correlator: Correlator, intensity: np.ndarray, assembly, start: float
) -> FrameRecord:
    from ..theory.displacement import project_on_target

    grid = assembly.detector
    pixel = 1e3 * grid.pitch
    shift = correlator.shift(intensity)
    along = np.array([[shift.u_px], [shift.v_px]]) * pixel
    x, y = project_on_target(along, grid.u, grid.v, assembly.target.frame.axes)[:, 0]
    cog = np.array(centre_of_gravity(intensity)) * pixel
    return FrameRecord(
        dof=dof,
        displacement=displacement,
        unit="deg" if dof in DEGREES_OF_FREEDOM and is_rotation(dof) else "mm",
        seed=seed,
        shift_u_um=float(along[0, 0]),
        shift_v_um=float(along[1, 0]),
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
