"""``python -m speckle_mi.optimise``: finds the best designs within bounds, and the best trade-offs of several goals.

    python -m speckle_mi.optimise SCENE --free laser_angle=20:50,detector_distance=40:90 --goal G.toml --out DIR

G.toml says which figures (as `compare` names them) are to be small or large, and has a table for each limit. An
interrupted run goes on where it was. Results: optimum.json, trials.csv, results.nc, optimum.png.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .command_line import (
    SURFACES, add_detector, add_force, add_range, add_scheduler, command, line_of, print_json, require_range, say,
    scene_parser,
)  # fmt: skip
from .errors import InputError

SAMPLERS = ("scipy", "optuna")

MOST_TRIALS = 1_000_000

EXAMPLE = """G.toml:
  minimise = ["crosstalk.z"]
  maximise = ["least.rx+ry"]   # of several goals the best trade-offs are found
  ["extent.x"]                 # build volume: size of the box around everything, mm
  at_most = 80
  [clearance]                  # between the laser's light and the parts, mm
  at_least = 5
  ["decorrelation.x"]
  at_least = 0.1"""


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parser().parse_args(arguments)
    if not 8 <= options.trials <= MOST_TRIALS:
        raise InputError(f"--trials {options.trials}: must be 8 to {MOST_TRIALS}")
    if options.seeds < 3:
        raise InputError(f"--seeds {options.seeds}: must be at least 3, from which figures have intervals")
    require_range(options)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .experiments.execution import WHOLE, require_scheduler
    from .machine.files import identity_in, refuse_other_settings, require_folder, write_json
    from .studies.goals import free_numbers, read_goals

    free = free_numbers(options.free)
    require_scheduler(options.scheduler)
    folder = require_folder(options.out)
    from .report import optimisation_report as report
    from .report.html_study import write_study
    from .report.study_arrays import write_optimum_arrays
    from .scene.load import split_defaults
    from .studies.design import Design
    from .studies.optimisation import OptimisationStudy
    from .studies.together import hands_at_work

    design = Design.of(options.scene, split_defaults(options.defaults), options.variant, options.detector)
    goals = read_goals(options.goal, list(design.assemblies({})))
    identity = {
        "scene": design.content, "defaults": dict(design.defaults), "detector": design.detector, "free": options.free,
        "goal": Path(options.goal).read_text(encoding="utf-8"), "trials": options.trials, "seeds": options.seeds,
        "range": options.range, "sampler": options.sampler,
    }  # fmt: skip
    target = folder / "optimum.json"
    refuse_other_settings(target, identity_in(target), identity, options.force)
    with hands_at_work(options.scheduler, folder, WHOLE, options.quiet) as (hands, progress):
        study = OptimisationStudy(
            design, free, goals, options.trials, options.seeds, options.range, options.sampler, hands
        )
        bar = progress.add_task("trials", total=options.trials)
        found = study.result(lambda: progress.advance(bar))
    report.write_trials(folder / "trials.csv", found)
    write_optimum_arrays(folder / "results.nc", found, design)
    report.plot_optimum(folder / "optimum.png", found)
    asked = {"scene": options.scene, "defaults": options.defaults, "identity": identity}
    content = report.optimum_to_json(found) | asked
    write_json(target, content)
    write_study(folder / "report.html", f"{Path(options.scene).name}: best designs", content,
                line_of("optimise", arguments), [folder / "optimum.png"])  # fmt: skip
    print_json(options, content)
    if not options.quiet:
        report.print_optimum(found)
        say(options, f"{folder}: report.html, optimum.json, trials.csv, results.nc, optimum.png")


def _parser():
    made = scene_parser(
        "optimise", "Finds the best designs within bounds.",
        f"scenes/tilted_laser.xml --free laser_angle=20:50 --goal G.toml --out results/best\n{EXAMPLE}",
    )  # fmt: skip
    made.add_argument(
        "--free", metavar="K=A:B,...", required=True, help="numbers of the scene that are chosen, with bounds"
    )
    made.add_argument("--goal", metavar="G.toml", required=True, help="what is to be small or large, and limits")
    made.add_argument("--trials", type=int, default=400, help="designs that are tried at most (default: %(default)s)")
    made.add_argument("--sampler", choices=SAMPLERS,
                      help="who proposes them (default: scipy, of more than 6 numbers optuna)")  # fmt: skip
    made.add_argument("--seeds", type=int, default=SURFACES,
                      help="surfaces that the best are measured on, and trials where theory does not tell "
                      "(default: %(default)s)")  # fmt: skip
    add_range(made, "range of motions that the resolution is for")
    add_scheduler(made)
    made.add_argument("--out", metavar="DIR", required=True, help="folder for the results")
    add_detector(made)
    add_force(made)
    return made


if __name__ == "__main__":
    raise SystemExit(command(main))
