"""``python -m speckle_mi.stability [--out DIR] [--quick]``: runs the catalogue of extreme cases and prints a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .command_line import add_force, command, parser, print_json, say
from .machine.interrupt import keeping

BOUND_BROKEN = 1
"""Exit status when a case breaks its bound."""


def main(arguments: Sequence[str] | None = None) -> int:
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .machine.backend import DEFAULT_VARIANT

    options_of = parser(
        "stability", "Runs stiff and extreme cases against independent references.", "--quick --out results/stability"
    )
    options_of.add_argument("--out", metavar="DIR", help="folder for stability.csv and stability.json")
    options_of.add_argument("--quick", action="store_true", help="the shorter catalogue that the tests run")
    options_of.add_argument("--variant", default=DEFAULT_VARIANT, help="Mitsuba variant (default: %(default)s)")
    add_force(options_of)
    options = options_of.parse_args(arguments)
    identity = {"catalogue": "quick" if options.quick else "whole", "variant": options.variant}
    _set_variant(options.variant)
    from .validation.stability import catalogue as cases
    from .validation.stability.case import BROKEN, LIMIT, Check

    folder = None if options.out is None else _folder(options.out, identity, options.force)
    checks: list[Check] = []

    def keep() -> None:
        if folder is not None:
            cases.write_table(folder, checks, identity)

    with keeping(keep):  # an interrupted run keeps what it has found
        for check in cases.catalogue(options.quick, progress=not options.quiet):
            checks.append(check)
    print_json(options, cases.content(checks, identity))
    if not options.quiet:
        cases.print_checks(checks)
    broken = sum(check.verdict == BROKEN for check in checks)
    limits = sum(check.verdict == LIMIT for check in checks)
    say(options, f"{len(checks)} checks: {len(checks) - broken - limits} ok, {limits} limits, {broken} broken")
    return BOUND_BROKEN if broken else 0


def _set_variant(name: str) -> None:
    import mitsuba as mi

    from .machine.backend import set_variant

    set_variant(name)
    mi.set_log_level(mi.LogLevel.Error)


def _folder(name: str, identity: dict, force: bool) -> Path:
    from .machine.files import identity_in, refuse_other_settings, require_folder

    folder = require_folder(name)
    for result in ("stability.json", "stability.csv"):
        refuse_other_settings(folder / result, identity_in(folder / "stability.json"), identity, force)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


if __name__ == "__main__":
    raise SystemExit(command(main))
