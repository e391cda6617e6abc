"""What results look like on the terminal: one console, one way to print a table, one line about the machine."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

WIDTH = 150
"""Characters a line where the output goes into a file or a pipe, which have no width of their own."""

MACHINE = ("processor", "cores", "system", "speckle_mi", "python", "mitsuba", "drjit", "numpy", "finufft", "numba",
           "LLVM")  # fmt: skip
"""What run times depend on, by its name in :func:`speckle_mi.machine.system.system_information`."""


def terminal(quiet: bool = False) -> Console:
    """The console that tables and lines are printed on; text is printed as it stands, brackets included."""
    return Console(width=None if os.isatty(1) else WIDTH, highlight=False, markup=False, quiet=quiet)


def print_table(
    console: Console,
    heads: Sequence[str],
    rows: Iterable[Sequence[str | Text]],
    *,
    title: str | None = None,
    left: Collection[int] = (0,),
    group_by: int | None = None,
) -> None:
    """Prints rows of cells under their heads, never cut off; a short row is filled up with empty cells.

    left: columns with words in them, the others hold numbers and stand flush right; group_by: a column, rows
    stand apart wherever its cell changes. A cell in colour is a ``Text``.
    """
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    for number, head in enumerate(heads):
        table.add_column(head, justify="left" if number in left else "right", overflow="fold")
    rows = [list(row) for row in rows]
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        ends = group_by is not None and (following is None or following[group_by] != row[group_by])
        table.add_row(*row, end_section=ends)
    console.print(table)


def print_machine(console: Console, system: dict[str, str]) -> None:
    """Prints the line that says on what machine and with which versions run times were measured."""
    console.print("machine: " + ", ".join(f"{name} {system[name]}" for name in MACHINE if name in system))
