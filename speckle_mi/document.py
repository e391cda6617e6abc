"""``python -m speckle_mi.document``: makes the reference of the plugins and the gallery of the scenes.

    python -m speckle_mi.document [--plugins F.md] [--gallery DIR [--scenes tilted_laser,folded]]
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .command_line import SURFACES, command, parser, print_json, say
from .errors import InputError


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parser().parse_args(arguments)
    if options.plugins is None and options.gallery is None:
        raise InputError("--plugins F.md, --gallery DIR or both must be given")
    written: list[Path] = []
    if options.plugins is not None:
        written.append(_write_reference(options.plugins))
    if options.gallery is not None:
        written += _write_gallery(options)
    print_json(options, {"written": [str(path) for path in written]})
    for path in written:
        say(options, str(path))


def _parser():
    from .machine.backend import DEFAULT_VARIANT

    made = parser(
        "document", "Makes the reference of the plugins and the gallery of the scenes.",
        "--plugins plugins/README.md --gallery scenes/gallery",
    )  # fmt: skip
    made.add_argument("--plugins", metavar="F.md", help="file for the plugins' documentation")
    made.add_argument("--gallery", metavar="DIR", help="folder for the gallery: README.md and pictures")
    made.add_argument("--scenes", metavar="NAME,...", help="example scenes of the gallery (default: all)")
    made.add_argument("--seeds", type=int, default=SURFACES, help="surfaces (default: %(default)s)")
    made.add_argument("--variant", default=DEFAULT_VARIANT, help="Mitsuba variant (default: %(default)s)")
    return made


def _write_reference(name: str) -> Path:
    from .machine.files import replacing, require_output
    from .report.plugin_reference import plugin_reference

    require_output(name, ".md")
    with replacing(name) as temporary:
        temporary.write_text(plugin_reference(), encoding="utf-8")
    return Path(name)


def _write_gallery(options) -> list[Path]:
    from .machine.files import require_folder
    from .machine.progress import progress_bars
    from .scene.load import open_scene
    from .scene.shipped import scenes, summary

    known = {name: path for name, path in scenes().items() if "/" not in name}
    names = list(known) if options.scenes is None else [name.strip() for name in options.scenes.split(",")]
    for name in names:
        if name not in known:
            raise InputError(f"--scenes {name!r}: there is no such scene, must be one of {', '.join(known)}")
    if options.seeds < 2:
        raise InputError(f"--seeds {options.seeds}: must be at least 2, from which there are intervals")
    folder = require_folder(options.gallery)
    opened = {name: open_scene(str(known[name]), [], options.variant) for name in names}
    from .report.gallery import make_entry, write_gallery
    from .scene.read import assemblies_from_scene

    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    with progress_bars(options.quiet) as progress:
        bar = progress.add_task("scenes", total=len(names))
        for name in names:
            assemblies = assemblies_from_scene(opened[name])
            entries.append(make_entry(folder, name, summary(known[name]), assemblies, options.seeds))
            progress.advance(bar)
    write_gallery(folder / "README.md", entries, "python -m speckle_mi.document --gallery scenes/gallery")
    pictures = [folder / f"{name}{end}" for name in names for end in (".png", "_speckle.png")]
    return [folder / "README.md", *pictures]


if __name__ == "__main__":
    raise SystemExit(command(main))
