"""``python -m speckle_mi.compare``: puts assemblies side by side, says which meet a requirement, and ranks them.

    python -m speckle_mi.compare SCENE... [--require R.toml] [-D laser_angle=20:50:7] --out DIR

R.toml has a table a figure with at_most, at_least or both. -D name=first:last:count sweeps a number of the scenes, a
<default> or one of a part as `uncertainty` names them; two of these make maps. Results: comparison.json,
comparison.csv, results.nc, comparison.png.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .command_line import (
    add_detector, add_execution, add_force, add_range, add_surfaces, command, line_of, parser, print_json,
    require_range, say,
)  # fmt: skip
from .errors import InputError

MOST_SWEPT = 2

EXAMPLE = """example of R.toml:
  rank_by = "crosstalk.z"
  ["crosstalk.z"]         # shift by a motion along z, relative to the least that one in the surface makes
  at_most = 0.1
  [ry.u]
  at_least = 1.8          # mm/deg
figures: """


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parser().parse_args(arguments)
    if options.seeds is not None and options.seeds < 3:
        raise InputError(f"--seeds {options.seeds}: must be at least 3, from which figures have intervals")
    require_range(options)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .experiments.execution import Shard, require_scheduler
    from .machine.files import identity_in, refuse_other_settings, require_folder, write_json

    shard = Shard.parse(options.shard)
    require_scheduler(options.scheduler)
    folder = require_folder(options.out)
    from .scene.load import split_defaults
    from .studies.comparison import SURFACES, ComparisonStudy, Swept, candidates_of, scene_names
    from .studies.design import Design

    fixed, swept = [], {}
    for name, text in split_defaults(options.defaults):
        if (found := Swept.parse(name, text)) is not None:
            swept[name] = found
        else:
            fixed.append((name, text))
    if len(swept) > MOST_SWEPT:
        raise InputError(f"-D: {', '.join(swept)} are swept, must be at most {MOST_SWEPT}")
    if len(set(map(_real, options.scenes))) < len(options.scenes):
        raise InputError("SCENE: one is given twice, must be given once")
    designs = {
        name: Design.of(path, fixed, options.variant, options.detector)
        for name, path in zip(scene_names(options.scenes), options.scenes, strict=True)
    }
    from .report import comparison_report as report
    from .report.html_study import write_study
    from .report.study_arrays import write_comparison_arrays
    from .studies.together import LeftToOthers, hands_at_work

    candidates = candidates_of(designs, list(swept.values()))
    surfaces = options.seeds or SURFACES
    identity = {
        "scenes": {name: design.content for name, design in designs.items()}, "defaults": options.defaults,
        "detector": options.detector, "seeds": surfaces, "range": options.range,
        "requirement": None if options.require is None else _text(options.require),
    }  # fmt: skip
    target = folder / "comparison.json"
    refuse_other_settings(target, identity_in(target), identity, options.force)
    with hands_at_work(options.scheduler, folder, shard, options.quiet) as (hands, progress):
        study = ComparisonStudy(candidates, options.require, surfaces, options.range, list(swept.values()), hands)
        bar = progress.add_task("assemblies", total=len(candidates))
        try:
            found = study.result(lambda: progress.advance(bar))
        except LeftToOthers as left:
            say(options, f"{folder}: part {options.shard} is done, {left}")
            return
    report.write_comparison(folder / "comparison.csv", found)
    pictures = report.write_comparison_plots(folder, found)
    write_comparison_arrays(folder / "results.nc", found)
    content = report.comparison_to_json(found) | {"identity": identity}
    write_json(target, content)
    plots = [folder / name for name in pictures]
    write_study(folder / "report.html", "Assemblies compared", content, line_of("compare", arguments), plots)
    print_json(options, content)
    if not options.quiet:
        report.print_comparison(found)
        say(options, f"{folder}: report.html, comparison.json, comparison.csv, results.nc, {', '.join(pictures)}")


def _real(path: str) -> Path:
    return Path(path).resolve()


def _text(path: str) -> str:
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: there is no such file, must be a TOML file")
    return Path(path).read_text(encoding="utf-8", errors="replace")


def _parser():
    from .machine.backend import DEFAULT_VARIANT

    made = parser(
        "compare", "Puts assemblies side by side and ranks them.",
        "scenes/tilted_laser.xml scenes/both_tilted.xml --require R.toml --out results/compared\n" + EXAMPLE
        + "z.u, crosstalk.z.u, crosstalk.z, least.x+y, condition.x+y, resolution.x,\n"
        "  decorrelation.x, extent.x, clearance, seconds",
    )  # fmt: skip
    made.add_argument("scenes", metavar="SCENE", nargs="+", help="Mitsuba XML scene files")
    made.add_argument(
        "-D", dest="defaults", metavar="NAME=VALUE", action="append", default=[],
        help="value of a <default> of all scenes, or first:last:count to sweep a number",
    )  # fmt: skip
    made.add_argument("--variant", default=DEFAULT_VARIANT, help="Mitsuba variant (default: %(default)s)")
    made.add_argument("--require", metavar="R.toml", help="limits on figures that an assembly must keep to")
    add_surfaces(made)
    add_range(made, "range of motions that the resolution is for")
    made.add_argument("--out", metavar="DIR", required=True, help="folder for the results")
    add_detector(made)
    add_execution(made)
    add_force(made)
    return made


if __name__ == "__main__":
    raise SystemExit(command(main))
