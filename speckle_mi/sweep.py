"""``python -m speckle_mi.sweep``: moves the target, renders, correlates and reports how far the pattern moves.

    python -m speckle_mi.sweep SCENE [--dof x,y,z,rx,ry,rz] [--range 0.2] [--steps 10] [--seeds 8] [--out DIR]
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .command_line import (
    SURFACES, add_detector, add_execution, add_force, add_images, add_motions, add_precision, add_range, add_surfaces,
    command, line_of, print_json, say, scene_parser, surfaces_of,
)  # fmt: skip
from .errors import InputError
from .machine.interrupt import keeping

if TYPE_CHECKING:
    from .experiments.sweep_result import SweepSettings
    from .scene.assembly import Assembly

SMALLEST_RANGE = 1e-9
"""Least range of a sweep [mm or deg]: places hold fewer digits than a smaller one needs."""

STAGES = ("start-up", "frames", "pictures")
"""What the seconds of a sweep are counted for."""

MAX_FRAMES = 1_000_000
"""Most frames of a sweep."""


def main(arguments: Sequence[str] | None = None) -> None:
    marks = [time.perf_counter()]
    options = _parser().parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .experiments.execution import Shard, executor_of, require_scheduler
    from .experiments.precision import Precision
    from .experiments.sweep import frames_at_a_time, run_sweeps
    from .experiments.sweep_result import SweepResult, frame_count
    from .machine.files import require_folder
    from .machine.journal import Journal
    from .scene.load import open_scene

    settings, shard = _settings(options), Shard.parse(options.shard)
    require_scheduler(options.scheduler)
    if options.precision is not None:
        Precision.parse(options.precision)
        if not shard.is_whole:
            raise InputError("--precision: adds surfaces by what all frames tell, must not be given with --shard")
    folder = require_folder(Path("results") / Path(options.scene).stem if options.out is None else options.out)
    scene = open_scene(options.scene, options.defaults, options.variant)
    from .experiments.kept_images import ALL, FIRST, NONE, images_to_keep
    from .field.detectors import Simulations
    from .experiments.layout import layout_of
    from .geometry.pose import Pose
    from .machine.run_times import duration
    from .plan.cost import WORTH_SAYING, require_affordable
    from .report import sweep_report as report
    from .report.html_sweep import SweepReport, write_report
    from .scene.read import assemblies_from_scene

    assemblies = assemblies_from_scene(scene, options.detector)
    settings = _completed(settings, assemblies, options)
    identity = _identity(assemblies, settings, options)
    simulations = Simulations(assemblies)
    cost = simulations.cost(Pose())
    require_affordable(cost, options.force)
    if cost.seconds > WORTH_SAYING:
        count = frame_count(settings)
        say(options, f"expected: {cost}, {count} frames in about {duration(count * cost.seconds)}")
    results = {name: SweepResult() for name in assemblies}
    with executor_of(options.scheduler, frames_at_a_time(simulations)) as executor:
        _claim(folder, identity, options)
        marks.append(time.perf_counter())
        is_repeated = (folder / "summary.json").exists()

        def write_table() -> None:
            # One that is whole already stays so until this one is.
            records = {name: result.records for name, result in results.items()}
            if not is_repeated or all(len(rows) >= frame_count(settings) for rows in records.values()):
                report.write_table(folder / "sweep.csv", records)

        # An interrupted sweep keeps its finished frames and the table of them, and goes on from there the next time.
        with keeping(write_table), Journal(folder / "jobs", shard.journal) as done:
            while True:
                keep = options.keep or images_to_keep(assemblies, settings)
                left = run_sweeps(
                    assemblies, settings, folder / "frames", results, options.quiet, executor, done, keep,
                    options.images, shard,
                )  # fmt: skip
                if left or (more := _more_surfaces(simulations, settings, results, options)) is None:
                    break
                settings = replace(settings, seeds=more)
    if left:
        others = f"{left} of {frame_count(settings)} frames are others' to do"
        say(options, f"{folder}: part {options.shard} is done, {others}")
        return
    marks.append(time.perf_counter())
    asked = {"scene": options.scene, "defaults": options.defaults, "identity": identity}
    found = {name: report.summarise(assembly, settings, results[name]) for name, assembly in assemblies.items()}
    for name, summary in found.items():
        part = name if len(found) > 1 else None
        report.write_plots(folder, assemblies[name], settings, results[name], summary, part)
    marks.append(time.perf_counter())
    seconds = marks[-1] - marks[0]
    stages = {name: end - begin for name, begin, end in zip(STAGES, marks[:-1], marks[1:], strict=True)}
    asked |= {"seconds_by_stage": stages, "seconds_total": seconds}
    summaries = {name: summary | asked for name, summary in found.items()}
    report.write_summary(folder / "summary.json", summaries)
    line = line_of("sweep", arguments)
    text = Path(options.scene).read_text(encoding="utf-8", errors="replace")
    made = SweepReport(assemblies, settings, results, summaries, layout_of(assemblies), line, text)
    write_report(folder / "report.html", made)
    print_json(options, report.together(summaries))
    if not options.quiet:
        report.print_summaries(summaries)
        kept = {ALL: "all frames", FIRST: "frames of the first surface (--keep all: of each)", NONE: "no frames"}[keep]
        say(options, f"{folder}: {kept}, sweep.csv, summary.json, plots and report.html, {seconds:.1f} s in all")


def _parser():
    parser = scene_parser(
        "sweep", "Moves the target, renders, correlates and reports sensitivities.",
        "scenes/tilted_laser.xml --dof x,ry --seeds 4 --out results/tilted",
    )  # fmt: skip
    add_motions(parser, "motions to sweep")
    add_range(parser, "width of the range about rest")
    parser.add_argument("--steps", type=int, default=10, help="displacements in the range (default: %(default)s)")
    add_surfaces(parser)
    add_precision(parser)
    window_help = "side of the correlation window, px (default: 256, less on a small detector; the paper's: 64)"
    parser.add_argument("--window", type=int, default=None, help=window_help)
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/<scene>)")
    parser.add_argument(
        "--keep", choices=("none", "first", "all"),
        help="which field images stay in DIR/frames: none, those of the first surface, all (default: as many as take "
        "up to 0.5 GB; every frame's row is kept, and an interrupted sweep goes on from it)",
    )  # fmt: skip
    add_detector(parser)
    add_images(parser)
    add_execution(parser)
    add_force(parser)
    return parser


def _settings(options) -> SweepSettings:
    import numpy as np

    from .experiments.sweep_result import SweepSettings, frames_of
    from .geometry.pose import Pose, motions_named

    dofs = motions_named(options.dof)
    if not SMALLEST_RANGE <= options.range < math.inf:
        least = f"{SMALLEST_RANGE:g} (mm or deg)"
        raise InputError(f"--range {options.range:g}: must be a finite number of at least {least}")
    if options.steps < 2:
        raise InputError(f"--steps {options.steps}: must be at least 2")
    seeds = SURFACES if options.seeds is None else options.seeds
    if seeds < 1:
        raise InputError(f"--seeds {seeds}: must be at least 1")
    if options.window is not None and options.window < 4:
        raise InputError(f"--window {options.window}: must be at least 4 px")
    frames = frames_of(seeds, len(dofs), options.steps)
    if frames > MAX_FRAMES:
        raise InputError(
            f"--seeds {seeds} --steps {options.steps}: would make {frames:.3g} frames, "
            f"must be at most {MAX_FRAMES:.0e}"
        )
    for dof in dofs:
        try:
            Pose(**{dof: options.range / 2})
        except ValueError as error:
            raise InputError(f"--range {options.range:g}: {error}") from None
    displacements = np.linspace(-options.range / 2, options.range / 2, options.steps)
    return SweepSettings(dofs, displacements, (), options.window)


def _completed(settings: SweepSettings, assemblies: Mapping[str, Assembly], options) -> SweepSettings:
    """The settings with the surfaces that are swept. InputError for what the detectors do not allow."""
    from .images.saved import require_saving

    first = next(iter(assemblies.values()))
    count = surfaces_of(first, options)
    if first.target.points is not None and options.seeds is None:
        say(options, "one surface: the target's own points; intervals rest on the residuals of its frames")
    for name, assembly in assemblies.items():
        which = f"detector {name!r}" if len(assemblies) > 1 else "the detector"
        largest = max(assembly.detector.shape)
        if settings.window is not None and settings.window > largest:
            raise InputError(f"--window {settings.window}: must be at most {largest} px, the longer side of {which}")
        if options.images:
            require_saving(assembly.camera, which)
    return replace(settings, seeds=tuple(range(first.seed, first.seed + count)))


def _more_surfaces(simulations, settings: SweepSettings, results, options) -> tuple[int, ...] | None:
    """The surfaces that the precision asked for takes, None where they are there. InputError for more than can be."""
    if options.precision is None:
        return None
    from .experiments.precision import MOST_SURFACES, Precision
    from .experiments.sweep_result import frames_of
    from .report.sweep_report import fits_of

    precision = Precision.parse(options.precision)
    lacking, where = max(
        precision.lacking(fits_of(one.assembly, settings, results[name], one.plan()))
        for name, one in simulations.by_detector.items()
    )
    if lacking <= 1:
        return None
    count = precision.surfaces(len(settings.seeds), lacking)
    most = min(MOST_SURFACES, MAX_FRAMES // frames_of(1, len(settings.dofs), len(settings.displacements)))
    if len(settings.seeds) >= most:
        raise InputError(
            f"--precision {options.precision}: the interval of {where} is still {lacking:.3g} times as wide "
            f"after {len(settings.seeds)} surfaces, ask for less"
        )
    say(options, f"{len(settings.seeds)} surfaces: the interval of {where} is {lacking:.3g} times as wide as asked for")
    first = settings.seeds[0]
    return tuple(range(first, first + min(count, most)))


def _identity(assemblies: Mapping[str, Assembly], settings: SweepSettings, options) -> dict:
    """Everything that determines a sweep's results, as it is compared with what a folder already holds."""
    hashes = {name: assembly.fingerprint() for name, assembly in assemblies.items()}
    return {
        **({"detectors": hashes} if len(hashes) > 1 else {"scene_hash": next(iter(hashes.values()))}),
        "dof": list(settings.dofs),
        "displacements": settings.displacements.tolist(),
        "seeds": list(settings.seeds),
        "window": settings.window,
    } | ({"precision": options.precision} if options.precision is not None else {})


def _claim(folder: Path, identity: dict, options) -> None:
    """Makes the folder ready; InputError when it holds results of other settings and ``--force`` is not given."""
    from .machine.files import refuse_other_settings, write_json
    from .machine.fragments import remove_abandoned
    from .machine.journal import SUFFIX as JOURNAL

    settings_file, force = folder / "settings.json", options.force
    if options.shard and force:
        raise InputError("--force: would take away what other parts have done, must not be given with --shard")
    folder.mkdir(parents=True, exist_ok=True)
    if options.shard:
        _wait_for_others(folder, settings_file)
    if settings_file.is_file():
        try:
            held = json.loads(settings_file.read_text(encoding="utf-8"))
        except ValueError:
            held = None
        refuse_other_settings(folder, held, identity, force)
    elif any(folder.iterdir()) and not force:
        raise InputError(f"{folder}: is not empty and holds no sweep, give another --out or --force to write there")
    (folder / "frames").mkdir(exist_ok=True)
    remove_abandoned(folder / "frames")
    if force:
        for stale in (
            *(file for kind in ("exr", "png", "tiff") for file in folder.glob(f"frames/*.{kind}")),
            *folder.glob("*.png"),
            *folder.glob(f"jobs/*{JOURNAL}"),
            folder / "report.html",
            folder / "summary.json",
            folder / "sweep.csv",
        ):
            stale.unlink(missing_ok=True)
    write_json(settings_file, identity)


def _wait_for_others(folder: Path, settings_file: Path) -> None:
    """Where another part has just begun in an empty folder, its settings are there in a moment."""
    for _ in range(20):
        if settings_file.is_file() or not any(folder.iterdir()):
            return
        time.sleep(0.1)


if __name__ == "__main__":
    raise SystemExit(command(main))
