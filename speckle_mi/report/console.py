"""The table that a sweep prints."""

from __future__ import annotations

import math

from ..experiments.expectation import CENTRE_AXES
from ..geometry.pose import sensitivity_unit
from ..measurement.sensitivity import Sensitivity
from .terminal import print_table, terminal

_ROUNDS_TO_ZERO = 5e-5

RESIDUALS = "†"
"""Marks an interval that rests on the residuals of one surface, and the line below the tables that says so."""


def print_report(summary: dict) -> None:
    """Prints the plan, the sensitivities on the detector and on the target's axes, and the errors."""
    console = terminal()
    for line in summary["plan"]:
        console.print(f"plan: {line}")
    tables = [("On the detector", ("u", "v")), ("Projected on the target's axes", ("x", "y"))]
    if any(fit[axis].theory is not None for fit in summary["fits"].values() for axis in CENTRE_AXES):
        tables.append(("Centre of gravity on the detector", CENTRE_AXES))
    for title, axes in tables:
        heads, rows = sensitivity_table(axes, summary)
        print_table(console, heads, rows, title=title, left=(0, 1))
    print_table(console, *resolution_table(summary), title="Resolution of one surface", left=(0, 1))
    for line in foot_lines(summary["fits"], [axis for _, axes in tables for axis in axes]):
        console.print(line)
    console.print(f"numerical error of the field {_numerical_error(summary['numerical_error'])}; "
                  f"{summary['seconds_per_frame'] * 1e3:.3g} ms a frame (median); "
                  f"{summary['frames_without_shift']} of {summary['frames']} frames without a significant shift")
    for dof, fitted in summary["fits"].items():
        for note in dict.fromkeys(fitted[axis].note for axis in ("u", "v") if fitted[axis].note):
            console.print(f"{dof}: {note}", markup=False)
    for warning, count in summary["warnings"].items():
        console.print(f"warning: {warning} ({count} frames)")
    for dof, note in ((summary["paper"] or {}).get("notes") or {}).items():
        console.print(f"paper, {dof}: {note}")


def sensitivity_table(axes: tuple[str, str], summary: dict) -> tuple[list[str], list[list[str]]]:
    """Heads and a row a motion: simulated and theoretical sensitivity along two axes, scatter, the paper's if any."""
    comparison = summary["paper"]
    published = comparison is not None and any(entry["axis"] in axes for entry in comparison["figures"].values())
    heads = ["motion", "unit", *(f"{axis} {kind}" for axis in axes for kind in ("simulated", "theory")), "scatter (um)"]
    rows = []
    for dof, fitted in summary["fits"].items():
        row = [dof, sensitivity_unit(dof)]
        for axis in axes:
            row += [with_interval(fitted[axis]), number(fitted[axis].theory)]
        row.append(" / ".join(number(fitted[axis].scatter_um, "{:.1f}") for axis in axes))
        rows.append([*row, _paper_cell(comparison, dof, axes)] if published else row)
    return [*heads, *(["paper"] if published else [])], rows


def resolution_table(summary: dict) -> tuple[list[str], list[list[str]]]:
    """Heads and a row a motion: scatter of a shift, what images state of it, the least displacement that is seen."""
    heads = ["motion", "unit", "scatter u / v (um)", "stated u / v (um)", "noise u / v (um)", "told from zero from"]
    rows = []
    for dof, found in summary["resolution"].items():
        pairs = (
            " / ".join(number(found[axis][kind], "{:.2g}", 0.0) for axis in "uv")
            for kind in ("scatter_um", "predicted_um", "noise_um")
        )
        smallest = "any" if found["smallest"] == 0 else number(found["smallest"], "{:.2g}", 0.0)
        rows.append([dof, found["unit"], *pairs, smallest])
    return heads, rows


def foot_lines(fits: dict[str, dict[str, Sensitivity]], axes: list[str]) -> list[str]:
    """What has to be known of the sensitivities along ``axes``, a line for each note with the cells it belongs to."""
    cells: dict[tuple[str, str], list[str]] = {}
    for dof, fitted in fits.items():
        for axis in axes:
            if fitted[axis].note:
                mark = RESIDUALS if fitted[axis].basis == "residuals" else f"{dof} along"
                cells.setdefault((mark, fitted[axis].note), []).append(axis)
    return [f"{mark} {note}" if mark == RESIDUALS else f"{mark} {', '.join(where)}: {note}"
            for (mark, note), where in cells.items()]  # fmt: skip


def _numerical_error(error: float) -> str:
    return f"{error:.1e} (relative L2, estimated)" if math.isfinite(error) else "not known"


def _paper_cell(comparison: dict, dof: str, axes: tuple[str, ...]) -> str:
    entry = comparison["figures"].get(dof)
    if entry is None or entry["axis"] not in axes:
        return ""
    return f"|{entry['axis']}| {entry['paper']:g}" + ("?" if dof in comparison["notes"] else "")


def with_interval(fit: Sensitivity) -> str:
    """A sensitivity with half its interval, in words."""
    if not math.isfinite(fit.value):
        return "not measured"
    low, high = fit.ci95
    if not math.isfinite(low):
        return f"{fit.value:+.4f}"
    return f"{fit.value:+.4f} ± {(high - low) / 2:.4f}" + (RESIDUALS if fit.basis == "residuals" else "")


def number(value: float | None, form: str = "{:+.4f}", rounds_to_zero: float = _ROUNDS_TO_ZERO) -> str:
    if value is None or not math.isfinite(value):
        return "-"
    return form.format(0.0 if abs(value) < rounds_to_zero else value)  # without the sign of a rounded zero
