"""How far the shifts of a study's rows are from the exact ones, and from first-order theory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .frame import Row


def with_shift_errors(rows: list[Row], theory_shift: Sequence[float] | None) -> list[Row]:
    """Rows with the errors [um] of their shifts, those of the best field at every N1 taken for exact.

    theory_shift: along u and v [um], None without theory.
    """
    moved = [row for row in rows if row.shift_u_um is not None]
    best: dict[int, Row] = {}
    for row in moved:
        held = best.get(row.point_sources)
        best[row.point_sources] = row if held is None or row.field_error < held.field_error else held
    return [row if row.shift_u_um is None else _judged(row, best[row.point_sources], theory_shift) for row in rows]


def _judged(row: Row, best: Row, theory_shift: Sequence[float] | None) -> Row:
    exact = (best.shift_u_um, best.shift_v_um)
    return replace(
        row,
        shift_error_um=None if row is best else _apart(row, exact),
        shift_theory_error_um=None if theory_shift is None else _apart(row, theory_shift),
    )


def _apart(row: Row, shift: Sequence[float]) -> float:
    return float(np.hypot(row.shift_u_um - shift[0], row.shift_v_um - shift[1]))
