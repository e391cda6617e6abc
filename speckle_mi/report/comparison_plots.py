"""Pictures of a comparison: assemblies side by side, figures along one swept number, maps over two."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ..studies.comparison import DesignComparison
from ..studies.figures import Figure
from .plots import FONT, MEAN, SURFACE, THEORY, dress, legend_outside, new_figure, write_picture

PANELS_A_ROW = 3
MARKS = ("o", "s", "^", "D", "v", "P", "X")
COLOURS = (MEAN, THEORY, "#009E73", "#CC79A7", "#56B4E9", "#E69F00", SURFACE)


def plot_side_by_side(path: str | os.PathLike, found: DesignComparison, figures: Sequence[str]) -> None:
    """A panel a figure: each assembly's value with its 95 % interval, and theory as a line across."""
    there = [one for one in found.in_order if not one.failed]
    figure, panels = _panels(len(figures), 0.9 + 0.26 * len(there), 3.1)
    for axes, name in zip(panels, figures, strict=True):
        _dressed(axes, there[0].figures[name])
        for place, one in enumerate(there):
            value = one.figures[name]
            if not np.isfinite(value.value):
                continue
            if np.all(np.isfinite(value.interval)):
                axes.plot(value.interval, [place, place], color=MEAN, linewidth=1.6)
            axes.plot(value.value, place, "o", color=MEAN, markersize=4.5,
                      label="measured, 95 % interval over surfaces" if place == 0 else None)  # fmt: skip
            if np.isfinite(value.theory):
                axes.plot(value.theory, place, "|", color=THEORY, markersize=13, markeredgewidth=1.8, label="theory")
        names = [one.candidate.name for one in there]
        axes.set_yticks(range(len(there)), names if axes in panels[::PANELS_A_ROW] else [])
        axes.set_ylim(len(there) - 0.4, -0.6)
        low, high = axes.get_xlim()
        axes.set_xlim(min(low, 0), high + 0.03 * (high - min(low, 0)))
        _limits(axes.axvline, found, name)
    legend_outside(figure, *panels, columns=3)
    write_picture(figure, path)


def plot_curves(path: str | os.PathLike, found: DesignComparison, figures: Sequence[str]) -> None:
    """A panel a figure along the swept number: bands are 95 % intervals, lines theory."""
    (swept,) = found.swept
    figure, panels = _panels(len(figures), 2.5, 3.2)
    scenes = list(dict.fromkeys(one.candidate.scene for one in found.compared))
    for axes, name in zip(panels, figures, strict=True):
        _dressed(axes, found.compared[0].figures[name])
        for number, scene in enumerate(scenes):
            points = [one.figures[name] for one in found.compared if one.candidate.scene == scene]
            colour, mark = COLOURS[number % len(COLOURS)], MARKS[number % len(MARKS)]
            low, high = np.array([point.interval for point in points]).T
            axes.fill_between(swept.values, low, high, color=colour, alpha=0.25, linewidth=0)
            own = f"{scene}: " if len(scenes) > 1 else ""
            axes.plot(swept.values, [point.value for point in points], mark, color=colour, markersize=4,
                      label=f"{own}measured, 95 % interval over surfaces")  # fmt: skip
            axes.plot(
                swept.values, [point.theory for point in points], color=colour, linewidth=1.3, label=f"{own}theory"
            )
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, 0), high)
        axes.set_xlabel(swept.name, fontsize=FONT - 1)
        _limits(axes.axhline, found, name)
    legend_outside(figure, *panels, columns=2)
    write_picture(figure, path)


def plot_maps(path: str | os.PathLike, found: DesignComparison, scene: str, figures: Sequence[str]) -> None:
    """A map a figure over two swept numbers: theory where there is theory, else what was measured."""
    down, across = found.swept
    figure, panels = _panels(len(figures), 2.6, 3.4)
    own = [one for one in found.compared if one.candidate.scene == scene]
    for axes, name in zip(panels, figures, strict=True):
        values = np.array([one.figures[name].best for one in own]).reshape(len(down.values), len(across.values))
        shown = np.ma.masked_invalid(values)
        mesh = axes.pcolormesh(across.values, down.values, shown, cmap="cividis", shading="nearest")
        axes.set_title(_title(own[0].figures[name]), loc="left", fontsize=FONT)
        axes.set_xlabel(across.name, fontsize=FONT - 1)
        if axes in panels[::PANELS_A_ROW]:
            axes.set_ylabel(down.name, fontsize=FONT - 1)
        axes.tick_params(labelsize=FONT - 1)
        figure.colorbar(mesh, ax=axes).ax.tick_params(labelsize=FONT - 2)
        for limit in found.requirements.limits:
            edges = [edge for edge in (limit.at_least, limit.at_most) if np.isfinite(edge)]
            if limit.figure.text == name and shown.count() and min(shown.shape) > 1:
                axes.contour(across.values, down.values, shown, levels=sorted(edges), colors="white", linewidths=1.4)
    write_picture(figure, path)


def _limits(line, found: DesignComparison, name: str) -> None:
    for limit in found.requirements.limits:
        for edge in (limit.at_least, limit.at_most):
            if limit.figure.text == name and np.isfinite(edge):
                line(edge, color="0.2", linewidth=1.0, linestyle=":", label="required")


def _panels(count: int, height: float, width: float) -> tuple[object, list[Axes]]:
    columns = min(PANELS_A_ROW, count)
    rows = -(-count // columns)
    figure = new_figure(1.2 + width * columns, 0.5 + rows * height)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid[count:]:
        axes.set_visible(False)
    return figure, list(grid[:count])


def _dressed(axes: Axes, figure: Figure) -> None:
    dress(axes)
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(_title(figure), loc="left", fontsize=FONT)


def _title(figure: Figure) -> str:
    unit = f" ({figure.name.unit})" if figure.name.unit else ""
    return f"{figure.name.text}{unit}"
