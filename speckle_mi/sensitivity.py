"""``python -m speckle_mi.sensitivity``: measures how far the pattern moves for every motion, from one frame a surface.

    python -m speckle_mi.sensitivity SCENE [--dof x,y,z,rx,ry,rz] [--seeds 8] [--precision 1%] [--out F.json]

The same tables as a sweep's, at about a sixtieth of its cost: the velocity of the pattern comes from the field and its
derivatives by the motions, and what is not motion is the pattern's boiling.
"""

from __future__ import annotations

from collections.abc import Sequence

from .command_line import (
    add_detector, add_force, add_motions, add_precision, add_range, add_surfaces, command, print_json,
    require_range, scene_parser, surfaces_of,
)  # fmt: skip
from .errors import InputError


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parser().parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .geometry.pose import motions_named
    from .machine.files import identity_in, refuse_other_settings, require_output, write_json

    dofs, precision = motions_named(options.dof), _precision(options)
    if options.seeds is not None and options.seeds < 1:
        raise InputError(f"--seeds {options.seeds}: must be at least 1")
    require_range(options)
    if options.out is not None:
        require_output(options.out, ".json")
    from .scene.load import open_scene

    scene = open_scene(options.scene, options.defaults, options.variant)
    from .experiments.one_frame import sensitivity_of
    from .field.detectors import Simulations
    from .geometry.pose import Pose
    from .plan.cost import require_affordable
    from .report.one_frame_report import print_together, summarise_one_frame, together
    from .scene.read import assemblies_from_scene

    assemblies = assemblies_from_scene(scene, options.detector)
    first = next(iter(assemblies.values()))
    hashes = {name: assembly.fingerprint() for name, assembly in assemblies.items()}
    identity = {
        **({"detectors": hashes} if len(hashes) > 1 else {"scene_hash": first.fingerprint()}),
        "dof": list(dofs), "seeds": surfaces_of(first, options),
        "first_seed": first.seed, "precision": options.precision, "range": options.range,
    }  # fmt: skip
    if options.out is not None:
        refuse_other_settings(options.out, identity_in(options.out), identity, options.force)
    simulations = Simulations(assemblies)
    require_affordable(simulations.cost(Pose()), options.force)
    results = _measured(simulations, dofs, precision, identity["seeds"], options)
    asked = {"scene": options.scene, "defaults": options.defaults, "identity": identity}
    summaries = {}
    for name, simulation in simulations.by_detector.items():
        found = sensitivity_of(simulation, results[name], dofs, options.range)
        summaries[name] = summarise_one_frame(simulation, found) | asked
    content = together(summaries, dofs, options.range)
    if options.out is not None:
        write_json(options.out, content)
    print_json(options, content)
    if not options.quiet:
        print_together(summaries, dofs, options.range)


def _measured(simulations, dofs: tuple[str, ...], precision, count: int, options):
    """The velocities of ``count`` surfaces, or of as many as the precision asked for takes, by detector."""
    from .experiments.one_frame import OneFrameOfEach, sensitivity_of
    from .experiments.precision import MOST_SURFACES
    from .machine.progress import progress_bars

    measurement, first, done = OneFrameOfEach(simulations), simulations.first.assembly.seed, 0
    with progress_bars(options.quiet) as progress:
        bar = progress.add_task("surfaces", total=count)
        while True:
            measurement.measure(range(first + done, first + count), lambda: progress.advance(bar))
            done, results = count, measurement.results
            if precision is None:
                return results
            lacking, where = max(
                precision.lacking(sensitivity_of(one, results[name], dofs).fits)
                for name, one in simulations.by_detector.items()
            )
            if lacking <= 1:
                return results
            if count >= MOST_SURFACES:
                raise InputError(
                    f"--precision {options.precision}: the interval of {where} is still {lacking:.3g} times as wide "
                    f"after {count} surfaces, ask for less"
                )
            count = precision.surfaces(count, lacking)
            progress.update(bar, total=count)


def _precision(options):
    from .experiments.precision import Precision

    return None if options.precision is None else Precision.parse(options.precision)


def _parser():
    made = scene_parser(
        "sensitivity", "Measures sensitivities from one frame a surface.",
        "scenes/tilted_laser.xml --dof x,ry --precision 1% --out tilted.json",
    )  # fmt: skip
    add_motions(made, "motions")
    add_surfaces(made)
    add_precision(made)
    add_range(made, "width of the range of displacements for which scatter is stated")
    made.add_argument("--out", metavar="F.json", help="also write everything as JSON")
    add_detector(made)
    add_force(made)
    return made


if __name__ == "__main__":
    raise SystemExit(command(main))
