"""``python -m speckle_mi.stability [--out DIR] [--quick]``: runs the catalogue of extreme cases and prints a table."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path

from ..cli import add_force, command, parser, say
from ..files import identity_in, refuse_other_settings, replacing, require_folder, write_json
from ..interrupt import keeping
from ..progress import progress_bars
from .case import BROKEN, LIMIT, OK, Check, checks_of

BOUND_BROKEN = 1
"""Exit status when a case breaks its bound."""


def main(arguments: Sequence[str] | None = None) -> int:
    from ..backend import DEFAULT_VARIANT

    options_of = parser("stability", "Runs stiff and extreme cases against independent references.")
    options_of.add_argument("--out", metavar="DIR", help="folder for stability.csv and stability.json")
    options_of.add_argument("--quick", action="store_true", help="the shorter catalogue that the tests run")
    options_of.add_argument("--variant", default=DEFAULT_VARIANT, help="Mitsuba variant (default: %(default)s)")
    add_force(options_of)
    options = options_of.parse_args(arguments)
    identity = {"catalogue": "quick" if options.quick else "whole", "variant": options.variant}
    _set_variant(options.variant)
    folder = None if options.out is None else _folder(options.out, identity, options.force)
    checks: list[Check] = []

    def keep() -> None:
        if folder is not None:
            write_table(folder, checks, identity)

    with keeping(keep):  # an interrupted run keeps what it has found
        for check in catalogue(options.quick, progress=not options.quiet):
            checks.append(check)
    if not options.quiet:
        print_table(checks)
    broken = sum(check.verdict == BROKEN for check in checks)
    limits = sum(check.verdict == LIMIT for check in checks)
    say(options, f"{len(checks)} checks: {len(checks) - broken - limits} ok, {limits} limits, {broken} broken")
    return BOUND_BROKEN if broken else 0


def catalogue(quick: bool = False, progress: bool = False) -> Iterator[Check]:
    """Every check of the catalogue, one after the other; ``quick`` leaves out what takes long."""
    from . import correlator, illumination, motion, optics, precision, scale, surfaces

    groups = {
        "scale": scale,
        "surfaces": surfaces,
        "motion": motion,
        "illumination": illumination,
        "optics": optics,
        "precision": precision,
        "correlator": correlator,
    }
    cases = [(name, case) for name, group in groups.items() for case in group.CASES if case.in_quick or not quick]
    with progress_bars(not progress, predicts=False) as bar:
        task = bar.add_task("cases", total=len(cases))
        for name, case in cases:
            bar.update(task, description=f"{name}: {case.name}")
            yield from checks_of(case, quick)
            bar.advance(task)


def write_table(folder: Path, checks: Sequence[Check], identity: dict) -> None:
    """Writes stability.csv and stability.json, each whole or not at all."""
    names = [column.name for column in fields(Check)]
    with replacing(folder / "stability.csv") as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(asdict(check) for check in checks)
    write_json(folder / "stability.json", {"identity": identity, "checks": [asdict(check) for check in checks]})


def print_table(checks: Sequence[Check]) -> None:
    """Prints a row a check, then the limits with the messages that the user gets."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(width=None if os.isatty(1) else 150, highlight=False)
    table = Table(box=box.SIMPLE_HEAD)
    for head in ("case", "quantity", "value", "reference", "error", "bound", "verdict"):
        table.add_column(head, justify="right" if head in ("value", "reference", "error", "bound") else "left")
    colours = {OK: "green", LIMIT: "yellow", BROKEN: "bold red"}
    for check in checks:
        numbers = (_text(check.value), _text(check.reference), _text(check.error, 2), _text(check.bound, 2))
        table.add_row(
            escape(check.case),
            escape(check.quantity),
            *map(escape, numbers),
            f"[{colours[check.verdict]}]{check.verdict}[/]",
        )
    console.print(table)
    for check in checks:
        if check.message and check.verdict != OK:
            console.print(f"{check.verdict}: {check.case}, {check.quantity}: {check.message}", markup=False)


def _text(value: float | str, digits: int = 6) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.{digits}g}" if math.isfinite(value) else str(value)


def _set_variant(name: str) -> None:
    import mitsuba as mi

    from ..backend import set_variant

    set_variant(name)
    mi.set_log_level(mi.LogLevel.Error)


def _folder(name: str, identity: dict, force: bool) -> Path:
    folder = require_folder(name)
    for result in ("stability.json", "stability.csv"):
        refuse_other_settings(folder / result, identity_in(folder / "stability.json"), identity, force)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


if __name__ == "__main__":
    raise SystemExit(command(main))
