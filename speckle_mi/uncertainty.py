"""``python -m speckle_mi.uncertainty``: propagates tolerances to the sensitivities, and says what to tighten first.

    python -m speckle_mi.uncertainty SCENE --tolerances T.toml [--samples N] [--method sensitivity|sweep] --out DIR

T.toml has a table for each number that varies: a <default> of the scene, a number of one of its parts
(lens.radius1), or a part's displacement (lens.x ... lens.rz), each with normal = sd, uniform = half width, triangular =
half width or bounds = [a, b]. Results: uncertainty.json, samples.csv, results.nc, budget.png, sobol.png.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .command_line import (
    SURFACES, add_detector, add_execution, add_force, add_range, command, line_of, print_json, require_range, say,
    scene_parser,
)  # fmt: skip
from .errors import InputError

METHODS = ("sensitivity", "sweep")

MOST_SAMPLES = 1_000_000

EXAMPLE = """example of T.toml:
  [laser_angle]
  normal = 0.5          # standard deviation, in the scene's unit
  [lens.x]
  uniform = 0.05        # half width, mm
  [[correlated]]
  parameters = ["laser_angle", "lens.x"]
  coefficient = 0.5
  [[compensator]]       # adjusted until theory has the entry at the value
  parameter = "detector_distance"
  bounds = [190, 210]
  condition = "ry.u"
  value = 0
  [allowed]             # how wide may tolerances be for this standard uncertainty?
  "z.u" = 0.001"""


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parser().parse_args(arguments)
    if not 1 <= options.samples <= MOST_SAMPLES:
        raise InputError(f"--samples {options.samples}: must be 1 to {MOST_SAMPLES}")
    if options.seeds < 2:
        raise InputError(f"--seeds {options.seeds}: must be at least 2, from which the scatter of one is told")
    least = 1 if options.method == "sweep" else 0
    if not least <= options.frames <= options.seeds:
        raise InputError(f"--frames {options.frames}: must be {least} to {options.seeds}, the surfaces of --seeds")
    if options.steps < 2:
        raise InputError(f"--steps {options.steps}: must be at least 2")
    require_range(options)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .experiments.execution import Shard, require_scheduler
    from .machine.files import identity_in, refuse_other_settings, require_folder, write_json

    shard = Shard.parse(options.shard)
    require_scheduler(options.scheduler)
    folder = require_folder(options.out)
    from .scene.load import split_defaults
    from .studies.design import Design
    from .studies.tolerances import read_tolerances

    design = Design.of(options.scene, split_defaults(options.defaults), options.variant, options.detector)
    tolerances = read_tolerances(options.tolerances, design.nominal())
    from .report import uncertainty_report as report
    from .report.html_study import write_study
    from .report.study_arrays import write_uncertainty_arrays
    from .studies.together import LeftToOthers, hands_at_work
    from .studies.uncertainty import UncertaintySettings, UncertaintyStudy
    from .studies.widths import ITERATIONS, allowed_widths

    settings = UncertaintySettings(
        options.samples, options.method == "sweep", options.seeds, options.frames, options.range, options.steps
    )
    identity = {
        "scene": design.content, "defaults": dict(design.defaults), "detector": design.detector,
        "tolerances": Path(options.tolerances).read_text(encoding="utf-8"), "samples": options.samples,
        "method": options.method, "seeds": options.seeds, "frames": options.frames,
        "range": options.range, "steps": options.steps,
    }  # fmt: skip
    target = folder / "uncertainty.json"
    refuse_other_settings(target, identity_in(target), identity, options.force)
    with hands_at_work(options.scheduler, folder, shard, options.quiet) as (hands, progress):
        study = UncertaintyStudy(design, tolerances, settings, hands)
        bar = progress.add_task("samples", total=study.count)
        try:
            result = study.result(lambda: progress.advance(bar))
        except LeftToOthers as left:
            say(options, f"{folder}: part {options.shard} is done, {left}")
            return
        if study.allowed:
            bar = progress.add_task("widths", total=2 * ITERATIONS)
        widths = allowed_widths(study, result, lambda: progress.advance(bar))
    folder.mkdir(parents=True, exist_ok=True)
    report.write_samples(folder / "samples.csv", result)
    write_uncertainty_arrays(folder / "results.nc", result, design)
    pictures = report.write_uncertainty_plots(folder, result)
    written = ["samples.csv", "results.nc", *pictures]
    if widths is not None:
        report.write_allowed(folder / "allowed.toml", widths)
        written.append("allowed.toml")
    found = report.uncertainty_to_json(result, widths)
    content = found | {"scene": options.scene, "defaults": options.defaults, "identity": identity}
    write_json(target, content)
    plots = [folder / name for name in pictures]
    write_study(folder / "report.html", f"{Path(options.scene).name}: uncertainty", content,
                line_of("uncertainty", arguments), plots)  # fmt: skip
    print_json(options, content)
    if not options.quiet:
        report.print_uncertainty(result, widths)
        say(options, f"{folder}: report.html, uncertainty.json, {', '.join(written)}")


def _parser():
    made = scene_parser(
        "uncertainty", "Propagates tolerances to sensitivities.",
        f"scenes/tilted_laser.xml --tolerances T.toml --out results/budget\n{EXAMPLE}",
    )  # fmt: skip
    made.add_argument("--tolerances", metavar="T.toml", required=True, help="what varies, and how")
    made.add_argument("--samples", type=int, default=1024, help="variants of the scene, about (default: %(default)s)")
    made.add_argument("--method", choices=METHODS, default=METHODS[0],
                      help="one frame of each surface beside theory, or sweeps (default: %(default)s)")  # fmt: skip
    made.add_argument("--seeds", type=int, default=SURFACES,
                      help="surfaces from which the scatter of one is told (default: %(default)s)")  # fmt: skip
    made.add_argument("--frames", type=int, default=2,
                      help="surfaces that samples are measured on; 0: theory alone (default: %(default)s)")  # fmt: skip
    add_range(made, "width of the range of motions")
    made.add_argument("--steps", type=int, default=4, help="displacements of a sweep (default: %(default)s)")
    made.add_argument("--out", metavar="DIR", required=True, help="folder for the results")
    add_detector(made)
    add_execution(made)
    add_force(made)
    return made


if __name__ == "__main__":
    raise SystemExit(command(main))
