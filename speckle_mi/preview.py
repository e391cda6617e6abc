"""``python -m speckle_mi.preview``: the assembly drawn to scale, with the rays as they really go."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from .command_line import add_detector, command, print_json, say, scene_parser
from .errors import InputError


def main(arguments: Sequence[str] | None = None) -> None:
    parser = scene_parser(
        "preview", "Draws the assembly of a scene: from the side and from above, or in space.",
        "scenes/imaging.xml -o imaging.html --show",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", metavar="F.png|F.svg|F.html", help="picture to write, or page in which it can be turned"
    )
    parser.add_argument("--show", action="store_true", help="open it in the browser (default file: a temporary page)")
    parser.add_argument("--pose", metavar="x=0.02,ry=0.01", help="displacement of the target (mm, deg)")
    add_detector(parser)
    options = parser.parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from dataclasses import replace

    from .geometry.pose import Pose
    from .machine.files import require_distinct, require_picture
    from .scene.load import open_scene

    output = _output(options)
    require_picture(output, pages=True)
    require_distinct(SCENE=options.scene, output=output)
    scene = open_scene(options.scene, options.defaults, options.variant)
    from .experiments.layout import layout_of
    from .scene.read import assemblies_from_scene

    assemblies = assemblies_from_scene(scene, options.detector)
    if options.pose is not None:
        pose = Pose.parse(options.pose)
        assemblies = {name: replace(one, pose=pose) for name, one in assemblies.items()}
    layout, title = layout_of(assemblies), Path(options.scene).name
    if output.lower().endswith(".html"):
        from .experiments.layout_3d import patterns_of, solids_of
        from .report.html_layout import write_space

        patterns, note = patterns_of(assemblies)
        write_space(output, layout, solids_of(assemblies, layout), patterns, title, [note] if note else [])
    else:
        from .report.drawing import draw_layout

        draw_layout(output, layout, title)
    print_json(options, {
        "output": output, "facts": dict(layout.facts), "warnings": list(layout.warnings),
        "problems": [{"place": one.place, "words": one.words} for one in layout.problems if one.words],
        "ways": {way: len(rays) for way, rays in layout.rays.items()},
    })  # fmt: skip
    for what, value in layout.facts:
        say(options, f"{what}: {value}")
    for warning in layout.warnings:
        say(options, f"warning: {warning}")
    say(options, f"{output}: {sum(map(len, layout.rays.values()))} rays over {len(layout.rays)} ways")
    if options.show:
        import webbrowser

        if not webbrowser.open(Path(output).resolve().as_uri()):
            say(options, f"no browser was found to show it, {output} must be opened by hand")


def _output(options) -> str:
    """Where to write; InputError where nothing says it."""
    if options.output is not None:
        return options.output
    if not options.show:
        raise InputError("-o F.png, F.svg or F.html must be given, or --show")
    return str(Path(tempfile.mkdtemp(prefix="speckle_mi_")) / f"{Path(options.scene).stem or 'scene'}.html")


if __name__ == "__main__":
    raise SystemExit(command(main))
