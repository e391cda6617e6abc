"""``python -m speckle_mi.preview``: the assembly drawn to scale, with the rays as they really go."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .command_line import add_detector, command, say, scene_parser


def main(arguments: Sequence[str] | None = None) -> None:
    parser = scene_parser("preview", "Draws the assembly of a scene, from the side and from above.")
    parser.add_argument("-o", "--output", required=True, metavar="F.png|F.svg", help="picture to write")
    parser.add_argument("--pose", metavar="x=0.02,ry=0.01", help="displacement of the target (mm, deg)")
    add_detector(parser)
    options = parser.parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from dataclasses import replace

    from .geometry.pose import Pose
    from .machine.files import require_distinct, require_picture
    from .scene.load import open_scene

    require_picture(options.output)
    require_distinct(SCENE=options.scene, output=options.output)
    scene = open_scene(options.scene, options.defaults, options.variant)
    from .experiments.layout import layout_of
    from .report.drawing import draw_layout
    from .scene.read import assemblies_from_scene

    assemblies = assemblies_from_scene(scene, options.detector)
    if options.pose is not None:
        pose = Pose.parse(options.pose)
        assemblies = {name: replace(one, pose=pose) for name, one in assemblies.items()}
    layout = layout_of(assemblies)
    draw_layout(options.output, layout, Path(options.scene).name)
    for what, value in layout.facts:
        say(options, f"{what}: {value}")
    for warning in layout.warnings:
        say(options, f"warning: {warning}")
    say(options, f"{options.output}: {sum(map(len, layout.rays.values()))} rays over {len(layout.rays)} ways")


if __name__ == "__main__":
    raise SystemExit(command(main))
