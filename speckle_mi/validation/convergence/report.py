"""The convergence study in numbers: its table as CSV, everything as JSON, and what the terminal shows."""

from __future__ import annotations

import os
from dataclasses import asdict, fields

import numpy as np

from ...machine.files import write_csv, write_json
from ...report.terminal import print_machine, print_table, terminal
from .frame import DOES_NOT_APPLY, LEFT_OUT, MEASURED, Row
from .scatter import Scatter
from .study import Findings
from .subject import Subject


def write_rows(path: str | os.PathLike, rows: list[Row]) -> None:
    """Writes a row a setting; what was not measured is empty."""
    write_csv(path, [column.name for column in fields(Row)], map(asdict, rows))


def write_findings(path: str | os.PathLike, asked: dict, found: Findings, run: dict) -> None:
    """Writes as JSON what was ``asked`` (scene, defaults), all that was measured, and its ``run`` (machine, time)."""
    subject = found.subject
    write_json(path, {
        **asked, "plan": list(subject.plan.lines),
        "displacement": {"dof": "x", "mm": subject.displacement}, "theory_shift_um": subject.theory_shift,
        "exact": {n: {"pixels": e.field.size, "scatterers": e.scatterers, "origin": e.origin, "seconds": e.seconds}
                  for n, e in found.exact.items() if e is not None},
        "rows": [asdict(row) for row in found.rows], "statistics": [asdict(entry) for entry in found.scatter],
        **run,
    })  # fmt: skip


def print_report(found: Findings, system: dict[str, str]) -> None:
    """Prints the table of what was measured, what was left out, the scatter over surfaces, and the machine."""
    console, subject = terminal(), found.subject
    for line in subject.plan.lines:
        console.print(f"plan: {line}")
    heads = ("N1", "method", "tol. or N2", "field", "phase (waves)", "shift (um)", "- theory", "frame (ms)",
             "quartiles", "runs", "first", "MB")  # fmt: skip
    title = f"{subject.name}: errors of field, phase and shift; warm and first run times; peak memory"
    shown = [_cells(row) for row in found.rows if row.status == MEASURED]
    print_table(console, heads, shown, title=title, left=(1, 2), group_by=0)
    for words in _notes(found.rows):
        console.print(words)
    _print_exact(console, found)
    _print_scatter(console, found.scatter, subject)
    print_machine(console, system)


def _cells(row: Row) -> list[str]:
    """The cells of a row that was measured."""
    quartiles = f"{_ms(row.seconds_q1)} - {_ms(row.seconds_q3)}" if row.runs > 1 else ""
    shift = "lost" if row.shift_u_um is None else "exact" if row.shift_error_um is None else _sig(row.shift_error_um)
    return [
        f"{row.point_sources:,}", row.method, row.accuracy, _sig(row.field_error), _sig(row.phase_error_wavelengths),
        shift, _sig(row.shift_theory_error_um), _ms(row.seconds_median), quartiles, str(row.runs),
        _ms(row.seconds_first), "" if row.peak_memory_mb is None else f"{row.peak_memory_mb:.0f}",
    ]  # fmt: skip


def _notes(rows: list[Row]) -> list[str]:
    """What was left out and why, a line for each method and N1; warnings of what was measured, once each."""
    groups: dict[tuple[str, int], list[Row]] = {}
    for row in rows:
        if row.status != MEASURED:
            groups.setdefault((row.method, row.point_sources), []).append(row)
    lines = []
    for (method, count), group in groups.items():
        which = (
            f", {group[0].accuracy}" + (f" to {group[-1].accuracy}" if len(group) > 1 else "")
            if group[0].accuracy
            else ""
        )
        applies = group[0].status != DOES_NOT_APPLY
        where = f"{method}, N1 = {count:,}{which}: {group[0].status}, " if applies else ""
        lines.append(where + group[0].note)
    if any(row.status == LEFT_OUT for row in rows):
        lines.append("more of what was left out is measured with more --seconds")
    return lines + sorted({f"{row.method}: {row.note}" for row in rows if row.status == MEASURED and row.note})


def _print_exact(console, found: Findings) -> None:
    subject = found.subject
    held = [f"N1 = {n:,}: {e.field.size} pixels, {e.origin}" for n, e in found.exact.items() if e is not None]
    console.print("errors of field and phase against: " + "; ".join(held))
    theory = "none" if subject.theory_shift is None else "({:.3f}, {:.3f}) um".format(*subject.theory_shift)
    moved = f"shift: target moved {1e3 * subject.displacement:.3g} um along x, first-order theory {theory}"
    console.print(f'{moved}; errors against the most exact frames of each N1 ("exact"), and from theory, '
                  "which one surface only scatters about")  # fmt: skip


def _print_scatter(console, scatter: list[Scatter], subject: Subject) -> None:
    if not scatter:
        return
    heads = ("motion", "axis", "N1", "surfaces", "mean", "theory", "one surface ±", "mean ±")
    rows = []
    for e in scatter:
        theory = "-" if e.theory is None else f"{e.theory:+.4f}"
        values = (f"{e.mean:+.4f} {e.unit}", theory, f"{e.spread:.4f}", f"{e.error_of_mean:.4f}")
        found = values if e.slopes else ("not measured", theory)
        rows.append([e.dof, e.axis, f"{e.point_sources:,}", str(len(e.slopes)), *found])
    print_table(console, heads, rows, title="Scatter of the sensitivity over surfaces", left=(0, 1))
    off = [e for e in scatter if e.off_theory is not None]
    for e in off:
        times = abs(e.off_theory) / e.error_of_mean
        words = f"off theory by {e.off_theory:+.2g} {e.unit}, {times:.1f} standard errors, more than chance explains"
        console.print(f"{e.dof}, N1 = {e.point_sources:,}: {words}")
    for sentence in subject.why_off_theory({e.dof for e in off}):
        console.print(sentence)


def _sig(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.1e}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:,.3g}" if seconds < 1 else f"{1e3 * seconds:,.0f}"
