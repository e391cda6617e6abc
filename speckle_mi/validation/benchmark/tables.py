"""The benchmark's figures as tables on the terminal."""

from __future__ import annotations

import os
from collections.abc import Sequence

from ...machine.run_times import duration
from .study import Entry


def new_console(quiet: bool):
    from rich.console import Console

    return Console(width=None if os.isatty(1) else 130, highlight=False, quiet=quiet)


def print_sums(console, shape: tuple[int, int], entries: list[Entry]) -> None:
    console.print(_sums_table(shape, entries))
    console.print(
        "~ summed on a part of the pixels and scaled up. Errors: relative L2 against the float64 sum on sampled pixels."
    )


def print_pieces(console, pieces: dict[str, dict]) -> None:
    table = _table("Around the sums", ("what", "median", "quartiles", "first", ""), left=(0, 4))
    for name, piece in pieces.items():
        quartiles = _between(piece["q1"], piece["q3"]) if piece["runs"] > 1 else ""
        table.add_row(name, duration(piece["median"]), quartiles, duration(piece["first"]), piece["what"])
    console.print(table)


def _sums_table(shape: tuple[int, int], entries: list[Entry]):
    """Every way of summing; the ratio says how many times longer than ours, ``auto``, it takes."""
    rows, columns = shape
    heads = ("scatterers", "method", "time", "quartiles", "ours faster by", "error", "how")
    table = _table(f"Coherent sum on {columns} x {rows} pixels", heads, left=(1, 6))
    ours = {entry.scatterers: entry.seconds for entry in entries if entry.name.startswith("auto")}
    for number, entry in enumerate(entries):
        mark = "" if entry.share == 1 else "~"
        ratio = "" if entry.name.startswith("auto") else f"{mark}{entry.seconds / ours[entry.scatterers]:,.3g}"
        ends = number + 1 == len(entries) or entries[number + 1].scatterers != entry.scatterers
        table.add_row(
            f"{entry.scatterers:,}", entry.name, mark + duration(entry.seconds), _between(entry.q1, entry.q3),
            ratio, "" if entry.error is None else f"{entry.error:.1e}", entry.plan.split(" (")[0], end_section=ends,
        )  # fmt: skip
    return table


def print_scaling(console, scaling: dict) -> None:
    table = _table(
        "Whole frames: scatterers, sum, intensity",
        ("scatterers", "time", "quartiles", "first", "of the one before"),
        left=(),
    )
    before = None
    for count, timing in scaling["frames"].items():
        growth = "" if before is None else f"{timing['median'] / before:.2f}"
        table.add_row(f"{count:,}", duration(timing["median"]), _between(timing["q1"], timing["q3"]),
                      duration(timing["first"]), growth)  # fmt: skip
        before = timing["median"]
    console.print(table)
    base = scaling["seconds"]
    console.print(
        f"four times the pixels, {scaling['scatterers']:,} scatterers: "
        f"{scaling['pixels_x4_finer'] / base:.2f} times the time for "
        f"finer ones, {scaling['pixels_x4_larger'] / base:.2f} for a larger detector"
    )
    table = _table(
        f"Time against rank, {scaling['scatterers']:,} scatterers",
        ("tolerance", "rank", "time", "error", "how"),
        left=(4,),
    )
    for entry in scaling["rank"]:
        rank = "-" if entry["rank"] is None else str(entry["rank"])
        table.add_row(f"{entry['tolerance']:.0e}", rank, duration(entry["seconds"]),
                      f"{entry['error']:.1e}", entry["plan"].split(" (")[0])  # fmt: skip
    console.print(table)


COSTS = {
    "grid_pair": "a pair of scatterer and pixel, on a grid",
    "point_pair": "the same at scattered points",
    "nufft_point": "a scatterer in a term of a NUFFT",
    "multiply_add": "a multiply-add of a matrix product",
    "pixel": "the common phase of a pixel",
}
"""Names of :class:`speckle_mi.propagation.costs.Costs` in words."""


def print_costs(console, costs: dict[str, dict[str, float]]) -> None:
    heads = ("cost of", "recorded", "measured here", "measured / recorded")
    table = _table("Cost model: the way is chosen from the recorded costs, only their ratios matter", heads, left=(0,))
    for name, cost in costs.items():
        recorded, measured = cost["recorded"], cost["measured"]
        table.add_row(COSTS[name], duration(recorded), duration(measured), f"{measured / recorded:.2f}")
    console.print(table)


def _table(title: str, heads: Sequence[str], left: Sequence[int]):
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    for number, head in enumerate(heads):
        table.add_column(head, justify="left" if number in left else "right")
    return table


def _between(low: float, high: float) -> str:
    return f"{duration(low)} - {duration(high)}"
