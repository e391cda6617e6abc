"""Pictures of the convergence study: error against run time, and the scatter of the sensitivity over surfaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .convergence_frame import MEASURED, PAPER_RAYS, Row
from .convergence_scatter import Scatter

LOOKS = {
    "rays": ("#D55E00", "s", "rays (the paper's way), $N_2$ along the line"),
    "direct": ("#009E73", "D", "direct"),
    "fast": ("#56B4E9", "^", "fast, tolerance along the line"),
    "auto": ("#0072B2", "o", "auto, tolerance along the line"),
}
"""Colour (Okabe and Ito), marker and name of a method."""


def plot_convergence(path: Path, rows: list[Row], name: str) -> None:
    """Error of the field against run time, a panel for every N1, both axes logarithmic."""
    from . import plots

    counts = sorted({row.point_sources for row in rows if row.status == MEASURED})
    columns = min(len(counts), 3) or 1
    lines = -(-len(counts) // columns) or 1
    figure = plots._figure(max(3.0 * columns + 0.6, 5.4), 2.75 * lines + 0.9)
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for panel in panels.flat[len(counts) :]:
        panel.set_visible(False)
    for panel, count in zip(panels.flat, counts, strict=False):
        own = [row for row in rows if row.point_sources == count]
        panel.set(xscale="log", yscale="log")
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(color="0.92", linewidth=0.7)
        panel.tick_params(labelsize=plots.FONT - 1)
        for method in LOOKS:
            _draw_method(panel, [row for row in own if row.method == method and row.status == MEASURED], method)
        summed = max(row.scatterers or 0 for row in own)
        panel.set_title(f"$N_1$ = {_power(count)}  ({summed:,} summed)", loc="left", fontsize=plots.FONT)
        absent = [m for m in LOOKS if not any(r.method == m and r.status == MEASURED for r in own)]
        if absent:
            panel.text(0.02, 0.02, f"too slow or not applicable: {', '.join(absent)}", transform=panel.transAxes,
                       ha="left", va="bottom", fontsize=plots.FONT - 3, color="0.4")  # fmt: skip
    _whole_decades(panels[0, 0])
    for number, panel in enumerate(panels.flat[: len(counts)]):
        if number + columns >= len(counts):
            panel.set_xlabel("run time of a frame (s)")
            panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            panel.tick_params(labelbottom=True)
    for panel in panels[:, 0]:
        panel.set_ylabel("relative error of the field")
    figure.suptitle(f"{name}: {_optics_of(rows)}", x=0.01, ha="left", fontsize=plots.FONT + 1)
    _legend_below(figure, *panels.flat, columns=2)
    plots._write(figure, path)


def _draw_method(panel, rows: list[Row], method: str) -> None:
    if not rows:
        return
    colour, marker, name = LOOKS[method]
    x, low, high, y = (np.array([getattr(row, n) for row in rows], float)
                       for n in ("seconds_median", "seconds_q1", "seconds_q3", "field_error"))  # fmt: skip
    # fast and auto often do the same: the open, larger mark of the one shows around the full one of the other.
    face, size = ("none", 7.5) if method == "fast" else (colour, 4.5)
    panel.errorbar(
        x,
        np.maximum(y, 1e-16),
        xerr=np.stack([x - low, high - x]),
        fmt=f"{marker}-",
        color=colour,
        label=name,
        markersize=size,
        markerfacecolor=face,
        linewidth=1.0,
        elinewidth=0.9,
        zorder=3 if method != "fast" else 2,
    )
    for row in rows:
        if row.rays_per_source == PAPER_RAYS:
            panel.plot(row.seconds_median, row.field_error, "o", color="0.15", markersize=10, markerfacecolor="none",
                       label=f"the paper's {PAPER_RAYS} rays", zorder=4)  # fmt: skip


def plot_scatter(path: Path, scatter: list[Scatter], name: str) -> None:
    """Left: the mean's statistical error against the number of surfaces. Right: one surface's against N1."""
    from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

    from . import plots

    figure = plots._figure(8.4, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    # Relative to a sensitivity of next to nothing, such as that of a focused image to tilt, no error means anything.
    moved = max((entry.scale * entry.step for entry in scatter if np.isfinite(entry.scale)), default=0.0)
    usable = [entry for entry in scatter if entry.spread > 0 and entry.scale * entry.step > 0.2 * moved]
    shades = ("#E69F00", "#CC79A7", "#56B4E9", "#0072B2")
    markers = "sv^o"
    for axes in (left, right):
        axes.set(xscale="log", yscale="log")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="0.92", linewidth=0.7)
        axes.tick_params(labelsize=plots.FONT - 1)
    for number, entry in enumerate(entry for entry in usable if entry.dof == "x"):
        sizes, spread, own = entry.of_means()
        percent = 100 / entry.scale
        style = {"color": shades[number % 4], "markersize": 5, "capsize": 2.5, "elinewidth": 1}
        left.errorbar(sizes, percent * spread, percent * spread * own, fmt=markers[number % 4],
                      label=f"mean, motion along x, $N_1$ = {_power(entry.point_sources)}", **style)  # fmt: skip
        left.plot(sizes, percent * entry.spread / np.sqrt(sizes), color=shades[number % 4], linewidth=1)
    for dof, colour, marker in (("x", plots.MEAN, "o"), ("ry", plots.THEORY, "s")):
        own = [entry for entry in usable if entry.dof == dof]
        if own:
            value = np.array([100 * e.spread / e.scale for e in own])
            bar = value / np.sqrt(2 * np.array([max(len(e.slopes) - 1, 1) for e in own]))
            label = "motion along x" if dof == "x" else "rotation about y"
            right.errorbar([e.point_sources for e in own], value, bar, fmt=f"{marker}-", color=colour, markersize=5,
                           capsize=2.5, linewidth=1, label=f"{label}, one surface")  # fmt: skip
    if not usable:
        left.text(0.5, 0.5, "no scatter measured", transform=left.transAxes, ha="center", color="0.4")
    _whole_decades(right)
    for axes in (left, right):
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
    counts = [entry.point_sources for entry in usable] or [1]
    right.set_xlim(min(counts) / 2, max(counts) * 2)
    left.xaxis.set_major_locator(FixedLocator(sorted({int(n) for entry in usable for n in entry.of_means()[0]}) or [1]))
    left.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    left.xaxis.set_minor_locator(NullLocator())
    left.set_xlabel("surfaces averaged (lines: $1/\\sqrt{n}$)")
    right.set_xlabel("point sources $N_1$ inside the beam's radius")
    left.set_ylabel("statistical error of the sensitivity (%)")
    surfaces = max((len(entry.slopes) for entry in scatter), default=0)
    figure.suptitle(
        f"{name}: scatter of the sensitivity over {surfaces} surfaces", x=0.01, ha="left", fontsize=plots.FONT + 1
    )
    _legend_below(figure, left, right, columns=3)
    plots._write(figure, path)


def _whole_decades(axes) -> None:
    """Limits at powers of ten, so that every axis has two labels at least."""
    from matplotlib.ticker import LogLocator, NullFormatter

    for axis, limits in ((axes.xaxis, axes.set_xlim), (axes.yaxis, axes.set_ylim)):
        low, high = axis.get_data_interval()
        if np.isfinite([low, high]).all() and 0 < low <= high:
            limits(10 ** np.floor(np.log10(low / 1.1)), 10 ** np.ceil(np.log10(high * 1.1)))
        axis.set_major_locator(LogLocator(numticks=8))
        axis.set_minor_formatter(NullFormatter())


def _legend_below(figure, *axes, columns: int) -> None:
    """One legend for all axes below them, so that the title has the space above."""
    from .plots import FONT

    entries: dict[str, object] = {}
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        style = {"frameon": False, "fontsize": FONT - 1, "handlelength": 1.8, "columnspacing": 1.6}
        figure.legend(entries.values(), entries.keys(), loc="outside lower left", ncols=columns, **style)


def _power(count: int) -> str:
    exponent = round(np.log10(count)) if count > 0 else 0
    return f"$10^{exponent}$" if count == 10**exponent and exponent > 1 else f"{count:,}"


def _optics_of(rows: list[Row]) -> str:
    counts = sorted({row.scatterers for row in rows if row.status == MEASURED and row.scatterers})
    return f"{counts[0]:,} to {counts[-1]:,} scatterers summed" if counts else "nothing measured"
