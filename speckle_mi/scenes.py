"""``python -m speckle_mi.scenes``: where the example scenes are, what each shows, and a copy of one to start from.

    python -m speckle_mi.scenes [NAME [--to DIR]]
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .command_line import command, parser, print_json, say
from .errors import InputError


def main(arguments: Sequence[str] | None = None) -> None:
    made = parser(
        "scenes", "Says where the example scenes are and what each shows, or copies one.", "imaging --to my_sensor"
    )
    made.add_argument("name", nargs="?", metavar="NAME", help="scene to copy (default: list them)")
    made.add_argument("--to", metavar="DIR", help="folder to copy it to (default: the current one)")
    made.add_argument("--force", action="store_true", help="overwrite a file of that name")
    options = made.parse_args(arguments)
    if options.name is not None:
        _copy(options)
    elif options.to is not None or options.force:
        raise InputError("--to and --force: need the NAME of a scene to copy")
    else:
        _list(options)


def _list(options) -> None:
    import shutil
    import textwrap

    from .scene.shipped import folder, scenes, summary

    known = scenes()
    print_json(options, {"folder": str(folder()), "scenes": {name: summary(path) for name, path in known.items()}})
    if options.json:
        return
    width, columns = max(map(len, known)), shutil.get_terminal_size().columns
    print(folder())
    for name, path in known.items():
        print(f"  {name:<{width}}  {textwrap.shorten(summary(path), max(columns - width - 4, 60), placeholder=' ...')}")


def _copy(options) -> None:
    import shutil

    from .machine.files import replacing, require_folder
    from .scene.shipped import scenes

    known = scenes()
    name = options.name.removesuffix(".xml")
    if name not in known:
        raise InputError(f"{options.name!r}: there is no such scene, must be one of {', '.join(known)}")
    folder = require_folder("." if options.to is None else options.to)
    target: Path = folder / known[name].name
    if target.exists() and not options.force:
        raise InputError(f"{target}: is there already, give another --to or --force to overwrite it")
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(target) as temporary:
        shutil.copyfile(known[name], temporary)
    print_json(options, {"written": str(target)})
    say(options, str(target))


if __name__ == "__main__":
    raise SystemExit(command(main))
