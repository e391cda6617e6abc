"""``python -m speckle_mi.converge``: error against run time of every method on a scene, and what chance adds to it.

    python -m speckle_mi.converge SCENE --out DIR [--seconds 240] [--point-sources 10,100] [--quick] [-D k=v]

Every method makes the same frame: at rest, and with the target moved a little along x. Its field is judged on pixels
evenly spread over the detector, against the float64 sum over all scatterers (behind openings: against a sum of its own
to 1e-7 on those pixels); its shift against that of the most exact frames, and against first-order theory. A second
part measures how the sensitivity scatters from surface to surface. What would take longer than its share of the time
is left out, and the table says so.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from pathlib import Path

from .command_line import add_detector, add_force, command, print_json, say, scene_parser
from .errors import InputError

POINT_SOURCES = (10, 100, 1_000, 10_000, 100_000, 1_000_000)
MAX_POINT_SOURCES = 10**15
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)

RAYS = (16, 36, 64, 100, 400, 1500, 3000)
"""N2; 1500 is the paper's."""

QUICK = {
    "point_sources": (10, 100),
    "tolerances": (1e-1, 1e-3, 1e-5),
    "rays": (16, 64),
    "surfaces": 6,
    "seconds": 60.0,
}
FULL = {"point_sources": POINT_SOURCES, "tolerances": TOLERANCES, "rays": RAYS, "surfaces": 24, "seconds": 240.0}


def main(arguments: Sequence[str] | None = None) -> None:
    start = time.perf_counter()
    options = _parser().parse_args(arguments)
    settings = _settings(options)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .machine.files import identity_in, refuse_other_settings, require_folder
    from .scene.load import open_scene

    folder = require_folder(options.out)
    scene = open_scene(options.scene, options.defaults, options.variant)
    # Not before the arguments are known to be good: these bring matplotlib with them.
    from .machine.progress import progress_bars
    from .machine.system import system_information
    from .scene.read import assembly_from_scene
    from .validation.convergence.plots import plot_convergence, plot_scatter
    from .validation.convergence.report import print_report, write_findings, write_rows
    from .validation.convergence.study import study
    from .validation.convergence.subject import Subject

    assembly = assembly_from_scene(scene, options.detector)
    identity = json.loads(json.dumps({"scene_hash": assembly.fingerprint(), "seed": assembly.seed} | settings))
    for name in ("converge.json", "converge.csv"):
        refuse_other_settings(folder / name, identity_in(folder / "converge.json"), identity, options.force)
    subject = Subject.of(assembly, Path(options.scene).stem, settings["point_sources"])
    with progress_bars(options.quiet, predicts=False) as progress:
        found = study(subject, settings, progress)
    folder.mkdir(parents=True, exist_ok=True)
    write_rows(folder / "converge.csv", found.rows)
    plot_convergence(folder / "converge.png", found.rows, subject.name)
    plot_scatter(folder / "statistics.png", found.scatter, subject.name)
    system = system_information()
    total = time.perf_counter() - start
    asked = {"scene": options.scene, "defaults": options.defaults, "identity": identity}
    write_findings(folder / "converge.json", asked, found, {"system": system, "seconds_total": total})
    print_json(options, json.loads((folder / "converge.json").read_text(encoding="utf-8")))
    if not options.quiet:
        print_report(found, system)
        say(options, f"{folder}: converge.csv, converge.json, converge.png and statistics.png, {total:.0f} s in all")


def _parser():
    parser = scene_parser(
        "converge", "Measures error against run time of every method on a scene.",
        "scenes/tilted_laser.xml --quick --out results/convergence",
    )  # fmt: skip
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    parser.add_argument(
        "--point-sources", metavar="10,100,...", help="values of N1 (default: 10 to 1000000, quick: 10, 100)"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=None,
        help="what the measurements may take; what would take longer is left out (default: 240, quick: 60)",
    )
    parser.add_argument("--quick", action="store_true", help="few values of everything")
    add_detector(parser, "must be given where there are several")
    add_force(parser)
    return parser


def _settings(options) -> dict:
    settings = dict(QUICK if options.quick else FULL)
    if options.seconds is not None:
        if not (math.isfinite(options.seconds) and options.seconds > 0):
            raise InputError(f"--seconds {options.seconds:g}: must be a finite number above 0")
        settings["seconds"] = options.seconds
    if options.point_sources is not None:
        try:
            values = sorted({float(text) for text in options.point_sources.split(",")})
        except ValueError:
            values = [math.nan]
        if not all(1 <= value <= MAX_POINT_SOURCES and value == int(value) for value in values):
            raise InputError(
                f"--point-sources {options.point_sources!r}: must be whole numbers with commas between, "
                f"each 1 to {MAX_POINT_SOURCES:g}"
            )
        settings["point_sources"] = tuple(map(int, values))
    return settings


if __name__ == "__main__":
    raise SystemExit(command(main))
