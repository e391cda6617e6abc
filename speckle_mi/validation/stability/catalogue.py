"""The catalogue of stiff and extreme cases, and its table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path

from rich.text import Text

from ...machine.files import write_csv, write_json
from ...machine.progress import progress_bars
from ...report.terminal import print_table, terminal
from .case import BROKEN, LIMIT, OK, Check, checks_of


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


def content(checks: Sequence[Check], identity: dict) -> dict:
    """What stability.json holds."""
    return {"identity": identity, "checks": [asdict(check) for check in checks]}


def write_table(folder: Path, checks: Sequence[Check], identity: dict) -> None:
    """Writes stability.csv and stability.json, each whole or not at all."""
    whole = content(checks, identity)
    write_csv(folder / "stability.csv", [column.name for column in fields(Check)], whole["checks"])
    write_json(folder / "stability.json", whole)


def print_checks(checks: Sequence[Check]) -> None:
    """Prints a row a check, then the limits with the messages that the user gets."""
    console = terminal()
    heads = ("case", "quantity", "value", "reference", "error", "bound", "verdict")
    colours = {OK: "green", LIMIT: "yellow", BROKEN: "bold red"}
    rows = [
        [check.case, check.quantity, _text(check.value), _text(check.reference), _text(check.error, 2),
         _text(check.bound, 2), Text(check.verdict, colours[check.verdict])]
        for check in checks
    ]  # fmt: skip
    print_table(console, heads, rows, left=(0, 1, 6))
    for check in checks:
        if check.message and check.verdict != OK:
            console.print(f"{check.verdict}: {check.case}, {check.quantity}: {check.message}")


def _text(value: float | str, digits: int = 6) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.{digits}g}" if math.isfinite(value) else str(value)
