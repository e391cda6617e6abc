"""``python -m speckle_mi.pose``: turns the shifts of one or several detectors into the target's motion.

    python -m speckle_mi.pose SUMMARY.json [SUMMARY.json ...] SHIFTS.csv [--dof x,y,z,rx,ry,rz] [--range 0.2]

Summaries are those of the commands sensitivity and sweep, of one detector each or of all of a scene; the shifts are as
the command correlate prints them, in the detectors' order or with their names in a column ``detector``: the summary's,
or their ids in the scene. Each motion has an uncertainty from that of the shifts and from what one surface's
sensitivities differ from the mean by. Behind an aperture the light's centre of gravity counts, too, where the table has
it and the summary is a sweep's, which tells by how much it scatters over surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence

from .command_line import add_motions, add_range, command, parser, print_json, require_range
from .errors import InputError


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parser().parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    import numpy as np

    from .geometry.pose import motions_named
    from .machine.files import require_output, write_json
    from .measurement.observability import observability
    from .report.pose_report import print_motions, read_detectors, read_measured, to_json

    *summaries, shifts = options.files
    if not summaries:
        raise InputError(f"{shifts}: there must be a summary and a table of shifts (see --help)")
    dofs = motions_named(options.dof)
    require_range(options)
    if options.out is not None:
        require_output(options.out, ".json")
    detectors = [one for path in summaries for one in read_detectors(path, dofs)]
    measured = read_measured(shifts, detectors)
    scale = np.full(len(dofs), options.range / 2)
    seen = observability(measured.matrix, scale)
    estimates = measured.estimates(scale)
    content = to_json(dofs, seen, estimates)
    if options.out is not None:
        write_json(options.out, content)
    print_json(options, content)
    if not options.quiet:
        print_motions(dofs, seen, estimates)


def _parser():
    made = parser(
        "pose", "Turns shifts of one or several detectors into the target's motion.",
        "left.json right.json top.json shifts.csv --out motion.json",
    )  # fmt: skip
    files = "SUMMARY.json ... SHIFTS.csv"
    made.add_argument("files", nargs="+", metavar=files, help="sensitivities of each detector, and the shifts")
    add_motions(made, "motions that there are")
    add_range(made, "width of the range of motions by which what is seen is judged")
    made.add_argument("--out", metavar="F.json", help="also write everything as JSON")
    return made


if __name__ == "__main__":
    raise SystemExit(command(main))
