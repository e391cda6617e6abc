"""``python -m speckle_mi.sweep``: moves the target, renders, correlates and reports how far the pattern moves.

    python -m speckle_mi.sweep SCENE [--dof x,y,z,rx,ry,rz] [--range 0.2] [--steps 10] [--seeds 8] [--out DIR]
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from . import __version__
from .cli import add_force, command, load_scene, say, scene_parser
from .correlator import Correlator
from .exr import FieldImage, FieldImageError, read_field, write_field
from .files import refuse_other_settings, require_folder, write_json
from .geometry import DEGREES_OF_FREEDOM, Pose, is_rotation
from .interrupt import keeping
from .progress import progress_bars
from .statistics import centre_of_gravity, contrast

_PENDING_WRITES = 8
"""Frames that may wait to be written: bounds the memory they take."""

SMALLEST_RANGE = 1e-9
"""Least range of a sweep [mm or deg]: places hold fewer digits than a smaller one needs."""

MAX_FRAMES = 1_000_000
"""Most frames of a sweep."""

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
    """What one frame gave: a row of sweep.csv. Shifts and centres of gravity [um], NaN where not measured."""

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


def main(arguments: Sequence[str] | None = None) -> None:
    start = time.perf_counter()
    options = _parser().parse_args(arguments)
    settings = _settings(options)
    folder = require_folder(Path("results") / Path(options.scene).stem if options.out is None else options.out)
    scene = load_scene(options.scene, options.defaults, options.variant)
    from . import report
    from .assembly import assembly_from_scene

    assembly = assembly_from_scene(scene)
    settings = _with_seeds(settings, assembly.seed, options.seeds)
    largest = max(assembly.detector.shape)
    if settings.window is not None and settings.window > largest:
        raise ValueError(f"--window {settings.window}: must be at most {largest} px, the detector's longer side")
    identity = _identity(assembly, settings)
    _claim(folder, identity, options.force)
    result = SweepResult()
    table, is_repeated = folder / "sweep.csv", (folder / "summary.json").exists()

    def keep() -> None:
        # A sweep that is done again has a whole table already.
        if not is_repeated or len(result.finished()) == frame_count(settings):
            report.write_table(table, result.finished())

    # An interrupted sweep keeps its finished frames and the table of them, and goes on from there the next time.
    with keeping(keep):
        run_sweep(assembly, settings, folder / "frames", result, options.quiet, resume=not is_repeated)
    summary = report.summarise(assembly, settings, result)
    summary["scene"] = options.scene
    summary["defaults"] = options.defaults
    summary["identity"] = identity
    report.write_plots(folder, assembly, settings, result, summary)
    summary["seconds_total"] = time.perf_counter() - start
    report.write_summary(folder / "summary.json", summary)
    if not options.quiet:
        report.print_report(summary)
        say(options, f"{folder}: frames, sweep.csv, summary.json and plots, {summary['seconds_total']:.1f} s in all")


def _parser():
    parser = scene_parser("sweep", "Moves the target, renders, correlates and reports sensitivities.")
    everything = ",".join(DEGREES_OF_FREEDOM)
    parser.add_argument("--dof", default=everything, metavar=everything, help="motions to sweep (default: all six)")
    parser.add_argument(
        "--range", type=float, default=0.2, help="width of the range about rest, mm or deg (default: %(default)s)"
    )
    parser.add_argument("--steps", type=int, default=10, help="displacements in the range (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=8, help="number of surfaces (default: %(default)s)")
    window_help = "side of the correlation window, px (default: 256, less on a small detector; the paper's: 64)"
    parser.add_argument("--window", type=int, default=None, help=window_help)
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/<scene>)")
    add_force(parser)
    return parser


def _settings(options) -> SweepSettings:
    dofs = tuple(name.strip() for name in options.dof.split(","))
    for name in dofs:
        if name not in DEGREES_OF_FREEDOM:
            raise ValueError(f"--dof {name!r}: must be one of {', '.join(DEGREES_OF_FREEDOM)}")
    if len(set(dofs)) != len(dofs):
        raise ValueError(f"--dof {options.dof!r}: must name each motion once")
    if not SMALLEST_RANGE <= options.range < np.inf:
        least = f"{SMALLEST_RANGE:g} (mm or deg)"
        raise ValueError(f"--range {options.range:g}: must be a finite number of at least {least}")
    if options.steps < 2:
        raise ValueError(f"--steps {options.steps}: must be at least 2")
    if options.seeds < 1:
        raise ValueError(f"--seeds {options.seeds}: must be at least 1")
    if options.window is not None and options.window < 4:
        raise ValueError(f"--window {options.window}: must be at least 4 px")
    frames = _frame_count(options.seeds, len(dofs), options.steps)
    if frames > MAX_FRAMES:
        raise ValueError(
            f"--seeds {options.seeds} --steps {options.steps}: would make {frames:.3g} frames, "
            f"must be at most {MAX_FRAMES:.0e}"
        )
    for dof in dofs:
        try:
            Pose(**{dof: options.range / 2})
        except ValueError as error:
            raise ValueError(f"--range {options.range:g}: {error}") from None
    displacements = np.linspace(-options.range / 2, options.range / 2, options.steps)
    return SweepSettings(dofs, displacements, (), options.window)


def _with_seeds(settings: SweepSettings, first: int, count: int) -> SweepSettings:
    return SweepSettings(settings.dofs, settings.displacements, tuple(range(first, first + count)), settings.window)


def _identity(assembly, settings: SweepSettings) -> dict:
    """Everything that determines a sweep's results, as it is compared with what a folder already holds."""
    return {
        "scene_hash": assembly.fingerprint(),
        "dof": list(settings.dofs),
        "displacements": settings.displacements.tolist(),
        "seeds": list(settings.seeds),
        "window": settings.window,
    }


def _claim(folder: Path, identity: dict, force: bool) -> None:
    """Makes the folder ready; ValueError when it holds results of other settings and ``force`` is not given."""
    settings_file = folder / "settings.json"
    if settings_file.is_file():
        try:
            held = json.loads(settings_file.read_text(encoding="utf-8"))
        except ValueError:
            held = None
        refuse_other_settings(folder, held, identity, force)
    elif folder.is_dir() and any(folder.iterdir()) and not force:
        raise ValueError(f"{folder}: is not empty and holds no sweep, give another --out or --force to write there")
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    if force:
        for stale in (
            *folder.glob("frames/*.exr"),
            *folder.glob("*.png"),
            folder / "summary.json",
            folder / "sweep.csv",
        ):
            stale.unlink(missing_ok=True)
    write_json(settings_file, identity)


def frame_count(settings: SweepSettings) -> int:
    """Frames of a sweep, references included."""
    return _frame_count(len(settings.seeds), len(settings.dofs), len(settings.displacements))


def _frame_count(seeds: int, dofs: int, steps: int) -> int:
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
    from .simulate import simulate_frame

    frame = simulate_frame(assembly, pose)
    result.plan = result.plan or frame.plan
    result.note(frame.numerical_error, frame.warnings)
    return frame


def _record(
    dof: str, displacement: float, seed: int, correlator: Correlator, intensity: np.ndarray, assembly, start: float
) -> FrameRecord:
    from .theory import project_on_target

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
    )


if __name__ == "__main__":
    raise SystemExit(command(main))
