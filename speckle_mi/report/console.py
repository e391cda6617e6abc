"""The table that a sweep prints."""

from __future__ import annotations

import math
import os

from rich import box
from rich.console import Console
from rich.table import Table

from ..experiments.expectation import CENTRE_AXES
from ..measurement.sensitivity import Sensitivity
from .sweep_report import unit_of

_ROUNDS_TO_ZERO = 5e-5


def print_report(summary: dict) -> None:
    """Prints the plan, the sensitivities on the detector and on the target's axes, and the errors."""
    console = Console(width=None if os.isatty(1) else 120, highlight=False)
    for line in summary["plan"]:
        console.print(f"plan: {line}", markup=False)
    tables = [("On the detector", ("u", "v")), ("Projected on the target's axes", ("x", "y"))]
    if any(fit[axis].theory is not None for fit in summary["fits"].values() for axis in CENTRE_AXES):
        tables.append(("Centre of gravity on the detector", CENTRE_AXES))
    for title, axes in tables:
        console.print(_sensitivity_table(title, axes, summary))
    console.print(f"numerical error of the field {summary['numerical_error']:.1e} (relative L2, estimated); "
                  f"{summary['seconds_per_frame'] * 1e3:.3g} ms a frame (median); "
                  f"{summary['frames_without_shift']} of {summary['frames']} frames without a significant shift")
    for dof, fitted in summary["fits"].items():
        for note in dict.fromkeys(fitted[axis].note for axis in ("u", "v") if fitted[axis].note):
            console.print(f"{dof}: {note}", markup=False)
    for warning, count in summary["warnings"].items():
        console.print(f"warning: {warning} ({count} frames)", markup=False)
    for dof, note in ((summary["paper"] or {}).get("notes") or {}).items():
        console.print(f"paper, {dof}: {note}", markup=False)


def _sensitivity_table(title: str, axes: tuple[str, str], summary: dict) -> Table:
    """A row a motion: simulated and theoretical sensitivity along two axes, scatter, and the paper's figure if any."""
    comparison = summary["paper"]
    published = comparison is not None and any(entry["axis"] in axes for entry in comparison["figures"].values())
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    heads = ["motion", "unit", *(f"{axis} {kind}" for axis in axes for kind in ("simulated", "theory")), "scatter (um)"]
    for number, head in enumerate([*heads, *(["paper"] if published else [])]):
        table.add_column(head, justify="left" if number < 2 else "right")
    for dof, fitted in summary["fits"].items():
        row = [dof, unit_of(dof)]
        for axis in axes:
            row += [_with_interval(fitted[axis]), number(fitted[axis].theory)]
        row.append(" / ".join(number(fitted[axis].scatter_um, "{:.1f}") for axis in axes))
        if published:
            row.append(_paper_cell(comparison, dof, axes))
        table.add_row(*row)
    return table


def _paper_cell(comparison: dict, dof: str, axes: tuple[str, ...]) -> str:
    entry = comparison["figures"].get(dof)
    if entry is None or entry["axis"] not in axes:
        return ""
    return f"|{entry['axis']}| {entry['paper']:g}" + ("?" if dof in comparison["notes"] else "")


def _with_interval(fit: Sensitivity) -> str:
    if not math.isfinite(fit.value):
        return "not measured"
    low, high = fit.ci95
    return f"{fit.value:+.4f} ± {(high - low) / 2:.4f}" if math.isfinite(low) else f"{fit.value:+.4f}"


def number(value: float | None, form: str = "{:+.4f}") -> str:
    if value is None or not math.isfinite(value):
        return "-"
    return form.format(0.0 if abs(value) < _ROUNDS_TO_ZERO else value)  # without the sign of a rounded zero
