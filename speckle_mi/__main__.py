"""``python -m speckle_mi``: lists the commands; ``python -m speckle_mi COMMAND ...`` runs one."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from collections.abc import Sequence
from pathlib import Path

from .command_line import command, parser, print_json
from .errors import InputError

_FIRST_LINE = re.compile(r"``python -m speckle_mi\.(?P<name>\w+)[^`]*``: (?P<does>.*)")
"""Of the documentation of every command."""


def commands() -> dict[str, str]:
    """Names of the commands, and what each does in one line, as their own documentation says."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("*.py")):
        documentation = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        if line := _FIRST_LINE.match(documentation):
            found[line["name"]] = line["does"].rstrip(".")
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    known = commands()
    width = max(map(len, known))
    lines = "\n".join(f"  {name:<{width}}  {does}" for name, does in known.items())
    made = parser("", f"Commands, each with its own --help:\n\n{lines}", "sweep --help")
    made.add_argument("command", nargs="?", metavar="COMMAND ...", help="a command and what it is given")
    options = made.parse_args(arguments)
    name = options.command
    if name is not None:
        raise InputError(f"{name!r}: there is no such command, must be one of {', '.join(known)}")
    print_json(options, known)
    if not options.json:
        made.print_help()


if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1] in commands():
        runpy.run_module(f"{__package__}.{sys.argv.pop(1)}", run_name="__main__", alter_sys=True)
    else:
        raise SystemExit(command(main))
