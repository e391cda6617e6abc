"""Pictures of the convergence study: error against run time, and the scatter of the sensitivity over surfaces."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator

from ...report.plots import FONT, MEAN, THEORY, dress, legend_outside, new_figure, write_picture
from .frame import MEASURED, PAPER_RAYS, Row
from .scatter import Scatter

LOOKS = {
    "rays": ("#D55E00", "s", "rays (the paper's way), $N_2$ along the line"),
    "direct": ("#009E73", "D", "direct"),
    "fast": ("#56B4E9", "^", "fast, tolerance along the line"),
    "auto": ("#0072B2", "o", "auto, tolerance along the line"),
}
"""Colour (Okabe and Ito), marker and name of a method."""

SHADES, MARKERS = ("#E69F00", "#CC79A7", "#56B4E9", "#009E73"), "sv^D"
"""Of the values of N1 in the picture of the scatter, from the smallest on."""


def plot_convergence(path: Path, rows: list[Row], name: str) -> None:
    """Error of the field against run time, a panel for every N1, both axes logarithmic."""
    counts = sorted({row.point_sources for row in rows if row.status == MEASURED})
    columns = min(len(counts), 3) or 1
    lines = -(-len(counts) // columns) or 1
    figure = new_figure(max(3.0 * columns + 0.6, 5.6), 2.85 * lines + 1.0)
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for panel in panels.flat[len(counts) :]:
        panel.set_visible(False)
    for panel, count in zip(panels.flat, counts, strict=False):
        own = [row for row in rows if row.point_sources == count]
        dress(panel)
        panel.set(xscale="log", yscale="log")
        for method in LOOKS:
            _draw_method(panel, [row for row in own if row.method == method and row.status == MEASURED], method)
        summed = max(row.scatterers or 0 for row in own)
        remarks = _remarks(rows, own)
        # Two lines are kept free in every panel, so that the panels of a row stay equally high.
        panel.set_title(f"$N_1$ = {_power(count)}  ({summed:,} summed)", loc="left", fontsize=FONT, pad=24)
        panel.annotate("\n".join(remarks), (0, 1), (0, 21), xycoords="axes fraction", textcoords="offset points",
                       ha="left", va="top", fontsize=FONT - 3, color="0.35")  # fmt: skip
    _whole_decades(list(panels.flat[: max(len(counts), 1)]), "xy")
    for number, panel in enumerate(panels.flat[: len(counts)]):
        if number + columns >= len(counts):
            panel.set_xlabel("run time of a frame (s)")
            panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            panel.tick_params(labelbottom=True)
    for panel in panels[:, 0]:
        panel.set_ylabel("relative error of the field")
    figure.suptitle(f"{name}: {_summed(rows)}", x=0.01, ha="left", fontsize=FONT + 1)
    legend_outside(figure, *panels.flat, columns=2, below=True)
    write_picture(figure, path)


def _remarks(rows: list[Row], own: list[Row]) -> list[str]:
    """Up to two lines above the panel of ``own`` rows: which methods do not apply and why, and which were left out."""
    lines, slow = [], []
    for method in LOOKS:
        measured = [row for row in own if row.method == method and row.status == MEASURED]
        reason = next((found for row in rows if row.method == method and (found := _reason(row.note))), None)
        if reason:
            lines.append(f"{method}: does not apply, {reason}")
        elif not measured:
            slow.append(method)
    return [*lines, *([f"left out, too slow: {', '.join(slow)}"] if slow else [])]


def _reason(note: str) -> str | None:
    """Why a method does not apply, in few words; None where its note says nothing of the kind."""
    found = re.search(r"does not apply: ([^(;.]*)", note)
    return found and found.group(1).strip()


def _draw_method(panel, rows: list[Row], method: str) -> None:
    if not rows:
        return
    colour, marker, name = LOOKS[method]
    x, low, high, y = (np.array([getattr(row, n) for row in rows], float)
                       for n in ("seconds_median", "seconds_q1", "seconds_q3", "field_error"))  # fmt: skip
    # fast and auto often do the same: the open, larger mark of the one shows around the full one of the other.
    face, size, order = ("none", 7.5, 2) if method == "fast" else (colour, 4.5, 3)
    looks = {"markersize": size, "markerfacecolor": face, "linewidth": 1.0, "elinewidth": 0.9, "zorder": order}
    spread = np.stack([x - low, high - x])
    panel.errorbar(x, np.maximum(y, 1e-16), xerr=spread, fmt=f"{marker}-", color=colour, label=name, **looks)
    for row in rows:
        if row.rays_per_source == PAPER_RAYS:
            panel.plot(row.seconds_median, row.field_error, "o", color="0.15", markersize=10, markerfacecolor="none",
                       label=f"the paper's {PAPER_RAYS} rays", zorder=4)  # fmt: skip


def plot_scatter(path: Path, scatter: list[Scatter], name: str) -> None:
    """Left: the mean's statistical error against the number of surfaces. Right: one surface's against N1."""
    figure = new_figure(8.4, 4.4)
    left, right = panels = figure.subplots(1, 2, sharey=True)
    for axes in panels:
        dress(axes)
        axes.set(xscale="log", yscale="log")
    usable = _usable(scatter)
    surfaces = max((len(entry.slopes) for entry in usable), default=0)
    for number, entry in enumerate(entry for entry in usable if entry.dof == "x"):
        sizes, spread, own = entry.of_means()
        percent = 100 / entry.scale
        looks = {"color": SHADES[number % 4], "markersize": 5, "capsize": 2.5, "elinewidth": 1}
        left.errorbar(sizes, percent * spread, percent * spread * own, fmt=MARKERS[number % 4],
                      label=f"mean, motion along x, $N_1$ = {_power(entry.point_sources)}", **looks)  # fmt: skip
        whole = np.array([1.0, len(entry.slopes)])
        left.plot(whole, percent * entry.spread / np.sqrt(whole), color=SHADES[number % 4], linewidth=1)
    for dof, colour, marker in (("x", MEAN, "o"), ("ry", THEORY, "s")):
        own = [entry for entry in usable if entry.dof == dof]
        if own:
            value = np.array([100 * e.spread / e.scale for e in own])
            bar = value / np.sqrt(2 * np.array([max(len(e.slopes) - 1, 1) for e in own]))
            label = "motion along x" if dof == "x" else "rotation about y"
            right.errorbar([e.point_sources for e in own], value, bar, fmt=f"{marker}-", color=colour, markersize=5,
                           capsize=2.5, linewidth=1, label=f"{label}, one surface")  # fmt: skip
    if not usable:
        left.text(0.5, 0.5, "no scatter measured", transform=left.transAxes, ha="center", color="0.4")
    _whole_decades(list(panels), "y")
    _whole_decades([right], "x")
    for axes in panels:
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    counts = [entry.point_sources for entry in usable] or [1]
    right.set_xlim(min(counts) / 2, max(counts) * 2)
    left.set_xlim(0.8, 1.25 * max(surfaces, 2))
    left.xaxis.set_major_locator(FixedLocator([2**n for n in range(12) if 2**n <= max(surfaces, 2)]))
    left.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    left.xaxis.set_minor_locator(NullLocator())
    left.set_xlabel("surfaces averaged (lines: $1/\\sqrt{n}$)")
    right.set_xlabel("point sources $N_1$ inside the beam's radius")
    left.set_ylabel("statistical error of the sensitivity (%)")
    title = f"{name}: scatter of the sensitivity over {surfaces} surfaces"
    figure.suptitle(title, x=0.01, ha="left", fontsize=FONT + 1)
    legend_outside(figure, *panels, columns=2, below=True)
    write_picture(figure, path)


def _usable(scatter: list[Scatter]) -> list[Scatter]:
    """Those with a relative error that means something: not of an image in focus, which hardly moves, to tilt."""
    moved = max((entry.scale * entry.step for entry in scatter if np.isfinite(entry.scale)), default=0.0)
    return [entry for entry in scatter if entry.spread > 0 and entry.scale * entry.step > 0.2 * moved]


def _whole_decades(panels: list, names: str) -> None:
    """Limits of the axes ``names`` that panels have in common at powers of ten: every axis has two labels at least."""
    for name in names:
        axes = [getattr(panel, f"{name}axis") for panel in panels]
        ends = np.array([axis.get_data_interval() for axis in axes]).reshape(-1, 2)
        ends = ends[np.isfinite(ends).all(axis=1) & (ends > 0).all(axis=1)]
        low, high = (ends[:, 0].min() / 1.5, ends[:, 1].max() * 1.5) if len(ends) else (2.0, 5.0)
        getattr(panels[0], f"set_{name}lim")(10 ** np.floor(np.log10(low)), 10 ** np.ceil(np.log10(high)))
        for axis in axes:
            axis.set_major_locator(LogLocator(numticks=8))
            axis.set_minor_formatter(NullFormatter())


def _power(count: int) -> str:
    exponent = round(np.log10(count)) if count > 0 else 0
    return f"$10^{exponent}$" if count == 10**exponent and exponent > 1 else f"{count:,}"


def _summed(rows: list[Row]) -> str:
    counts = sorted({row.scatterers for row in rows if row.status == MEASURED and row.scatterers})
    if not counts:
        return "nothing measured"
    return " to ".join(f"{count:,}" for count in sorted({counts[0], counts[-1]})) + " scatterers summed"
