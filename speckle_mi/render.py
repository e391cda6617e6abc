"""``python -m speckle_mi.render``: one field image of a scene."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from .command_line import add_force, command, say, scene_parser
from .errors import InputError

if TYPE_CHECKING:
    from .geometry.pose import Pose

MAX_LAYERS = 1_000_000
"""Most fields of single scatterers in a file."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = scene_parser("render", "Renders one field image of a scene.")
    parser.add_argument("-o", "--output", required=True, metavar="F.exr", help="EXR file to write")
    parser.add_argument("--pose", metavar="x=0.02,ry=0.01", help="displacement of the target (mm, deg)")
    parser.add_argument("--sources", metavar="F.npz", help="also write what the sum was made of")
    parser.add_argument(
        "--per-source",
        type=int,
        default=0,
        metavar="K",
        help="also write the fields of the first K scatterers, as layers",
    )
    spp_help = "sub-pixels a pixel that the intensity is averaged over (default: the scene's, else 1)"
    parser.add_argument("--spp", type=int, default=0, help=spp_help)
    add_force(parser)
    options = parser.parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .machine.files import refuse_other_settings, require_distinct, require_output
    from .scene.load import open_scene

    pose = None if options.pose is None else _pose(options.pose)
    for flag, value in (("--per-source", options.per_source), ("--spp", options.spp)):
        if value < 0:
            raise InputError(f"{flag} {value}: must not be negative")
    if options.per_source > MAX_LAYERS:
        raise InputError(f"--per-source {options.per_source}: must be at most {MAX_LAYERS} (layers of a file)")
    require_output(options.output, ".exr")
    if options.sources is not None:
        require_output(options.sources, ".npz")
    require_distinct(SCENE=options.scene, output=options.output, sources=options.sources)

    scene = open_scene(options.scene, options.defaults, options.variant)
    from .field.simulation import Simulation
    from .field.sources import settings_of_sources, source_layers, write_sources
    from .images.exr import write_field
    from .machine.progress import progress_bars
    from .plan.cost import WORTH_SAYING, require_affordable
    from .scene.read import assembly_from_scene

    assembly = assembly_from_scene(scene, spp=options.spp)
    settings = {
        "scene_hash": assembly.fingerprint(),
        "seed": assembly.seed,
        "pose": str(pose or assembly.pose),
        "per_source": options.per_source,
    }
    refuse_other_settings(options.output, settings_of_image(options.output, settings), settings, options.force)
    if options.sources:
        refuse_other_settings(options.sources, settings_of_sources(options.sources), settings, options.force)
    simulation = Simulation(assembly)
    cost = simulation.cost(pose)
    require_affordable(cost, options.force)
    if cost.seconds > WORTH_SAYING:
        say(options, f"expected: {cost}")
    with progress_bars(options.quiet):
        start = time.perf_counter()
        frame = simulation.frame(pose)
        seconds = time.perf_counter() - start
        layers = source_layers(assembly, frame.scatterers, pose, options.per_source)
    image = replace(frame.image, header=frame.image.header | settings)
    write_field(options.output, image, layers)
    if options.sources:
        write_sources(options.sources, assembly, frame.scatterers, settings)
    for line in frame.plan:
        say(options, f"plan: {line}")
    for warning in frame.warnings:
        say(options, f"warning: {warning}")
    rows, columns = assembly.detector.shape
    say(options, f"{options.output}: {columns} x {rows} pixels, {frame.scatterers.count} scatterers, {seconds:.3g} s, "
                 f"numerical error {frame.numerical_error:.1e}")


def _pose(text: str) -> Pose:
    """The displacement that ``--pose`` gives, which must name one."""
    from .geometry.pose import Pose

    if not text.strip():
        raise InputError(f"--pose {text!r}: must name a displacement, for example x=0.02,ry=0.01")
    return Pose.parse(text)


def settings_of_image(path: str | os.PathLike, wanted: Iterable[str]) -> dict | None:
    """What an image says of the ``wanted`` settings; None where it is none of ours."""
    from .images.exr import read_header

    try:
        header = read_header(path)
    except ValueError:
        return None
    return {name: header.get(name) for name in wanted}


if __name__ == "__main__":
    raise SystemExit(command(main))
