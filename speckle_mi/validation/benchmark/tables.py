"""The benchmark's figures as tables on the terminal."""

from __future__ import annotations

from rich.console import Console

from ...machine.run_times import duration
from ...report.terminal import print_table
from .sums import Entry


def print_sums(console: Console, shape: tuple[int, int], entries: list[Entry]) -> None:
    """Every way of summing; the ratio says how many times longer than ours, ``auto``, it takes."""
    rows, columns = shape
    heads = ("scatterers", "method", "time", "quartiles", "ours faster by", "error", "how")
    ours = {entry.scatterers: entry.seconds for entry in entries if entry.name.startswith("auto")}

    def cells(entry: Entry) -> list[str]:
        mark = "" if entry.share == 1 else "~"
        ratio = "" if entry.name.startswith("auto") else f"{mark}{entry.seconds / ours[entry.scatterers]:,.3g}"
        return [
            f"{entry.scatterers:,}", entry.name, mark + duration(entry.seconds), _between(entry.q1, entry.q3),
            ratio, "" if entry.error is None else f"{entry.error:.1e}", entry.plan.split(" (")[0],
        ]  # fmt: skip

    title = f"Coherent sum on {columns} x {rows} pixels"
    print_table(console, heads, map(cells, entries), title=title, left=(1, 6), group_by=0)
    console.print(
        "~ summed on a part of the pixels and scaled up. Errors: relative L2 against the float64 sum on sampled pixels."
    )


def print_pieces(console: Console, pieces: dict[str, dict]) -> None:
    def cells(name: str, piece: dict) -> list[str]:
        quartiles = _between(piece["q1"], piece["q3"]) if piece["runs"] > 1 else ""
        return [name, duration(piece["median"]), quartiles, duration(piece["first"]), piece["what"]]

    heads = ("what", "median", "quartiles", "first", "")
    print_table(console, heads, (cells(*item) for item in pieces.items()), title="Around the sums", left=(0, 4))


def print_scaling(console: Console, scaling: dict) -> None:
    frames = scaling["frames"]
    before = [None, *(timing["median"] for timing in frames.values())]
    rows = [
        [f"{count:,}", duration(timing["median"]), _between(timing["q1"], timing["q3"]), duration(timing["first"]),
         "" if last is None else f"{timing['median'] / last:.2f}"]
        for (count, timing), last in zip(frames.items(), before, strict=False)
    ]  # fmt: skip
    heads = ("scatterers", "time", "quartiles", "first", "of the one before")
    print_table(console, heads, rows, title="Whole frames: scatterers, sum, intensity", left=())
    base = scaling["seconds"]
    console.print(
        f"four times the pixels, {scaling['scatterers']:,} scatterers: "
        f"{scaling['pixels_x4_finer'] / base:.2f} times the time for "
        f"finer ones, {scaling['pixels_x4_larger'] / base:.2f} for a larger detector"
    )
    rows = [
        [f"{entry['tolerance']:.0e}", "-" if entry["rank"] is None else str(entry["rank"]), duration(entry["seconds"]),
         f"{entry['error']:.1e}", entry["plan"].split(" (")[0]]
        for entry in scaling["rank"]
    ]  # fmt: skip
    title = f"Time against rank, {scaling['scatterers']:,} scatterers"
    print_table(console, ("tolerance", "rank", "time", "error", "how"), rows, title=title, left=(4,))


COSTS = {
    "grid_pair": "a pair of scatterer and pixel, on a grid",
    "point_pair": "the same at scattered points",
    "nufft_point": "a scatterer in a term of a NUFFT",
    "multiply_add": "a multiply-add of a matrix product",
    "pixel": "the common phase of a pixel",
}
"""Names of :class:`speckle_mi.propagation.costs.Costs` in words."""


def print_costs(console: Console, costs: dict[str, dict[str, float]]) -> None:
    rows = [
        [COSTS[name], duration(cost["recorded"]), duration(cost["measured"]),
         f"{cost['measured'] / cost['recorded']:.2f}"]
        for name, cost in costs.items()
    ]  # fmt: skip
    title = "Cost model: the way is chosen from the recorded costs, only their ratios matter"
    print_table(console, ("cost of", "recorded", "measured here", "measured / recorded"), rows, title=title)


def _between(low: float, high: float) -> str:
    return f"{duration(low)} - {duration(high)}"
