"""Pictures of an uncertainty: what each tolerance contributes to every sensitivity, and its Sobol indices."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ..studies.uncertainty import EntryUncertainty
from .plots import FONT, MEAN, SURFACE, THEORY, dress, legend_outside, new_figure, write_picture

PANELS_A_ROW = 3


def plot_budget(path: str | os.PathLike, found: Sequence[EntryUncertainty]) -> None:
    """A panel an entry: the linear contribution of every number, and beside them what the samples say of all together,
    one surface and the camera [1e-3 mm/mm or mm/deg]."""
    camera = ["camera"] if any(np.isfinite(one.camera) for one in found) else []
    figure, panels = _panels(len(found), len(found[0].linear) + 2 + len(camera))
    for axes, one in zip(panels, found, strict=True):
        names = [*one.linear, "all tolerances", "one surface", *camera]
        values = [*map(abs, one.linear.values()), one.deviation, one.surfaces, *([one.camera] if camera else [])]
        colours = [*[MEAN] * len(one.linear), THEORY, SURFACE, *[SURFACE] * len(camera)]
        place = np.arange(len(names))
        axes.barh(place, 1e3 * np.nan_to_num(values), color=colours, height=0.7)
        _name_bars(axes, place, names, axes in panels[::PANELS_A_ROW])
        axes.set_xlabel(f"10⁻³ {one.entry.unit}", fontsize=FONT - 1)
        axes.set_title(one.entry.name, loc="left", fontsize=FONT)
        axes.axhline(len(one.linear) - 0.5, color="0.6", linewidth=0.8)
    figure.suptitle("Standard uncertainty: linear part of each tolerance; below, all of them by samples", fontsize=FONT)
    write_picture(figure, path)


def plot_indices(path: str | os.PathLike, found: Sequence[EntryUncertainty]) -> None:
    """A panel an entry: first-order and total Sobol indices of every factor with their standard errors."""
    figure, panels = _panels(len(found), len(found[0].total))
    for axes, one in zip(panels, found, strict=True):
        place = np.arange(len(one.total))
        for shift, indices, colour, name in (
            (-0.2, one.first_order, MEAN, "first order"),
            (0.2, one.total, "0.75", "total"),
        ):
            values, errors = np.array(list(indices.values())).T
            axes.barh(place + shift, np.clip(values, 0, None), xerr=errors, height=0.38, color=colour, label=name,
                      error_kw={"elinewidth": 0.8, "ecolor": "0.2"})  # fmt: skip
        _name_bars(axes, place, list(one.total), axes in panels[::PANELS_A_ROW])
        axes.set_xlim(0, 1.1)
        axes.set_xlabel("share of the variance", fontsize=FONT - 1)
        axes.set_title(one.entry.name, loc="left", fontsize=FONT)
    legend_outside(figure, *panels, columns=2)
    write_picture(figure, path)


def _panels(count: int, bars: int) -> tuple[object, list[Axes]]:
    columns = min(PANELS_A_ROW, count)
    rows = -(-count // columns)
    figure = new_figure(2.2 + 2.6 * columns, 0.6 + rows * (0.9 + 0.21 * bars))
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid[count:]:
        axes.set_visible(False)
    return figure, list(grid[:count])


def _name_bars(axes: Axes, place: np.ndarray, names: list[str], named: bool) -> None:
    dress(axes)
    axes.set_yticks(place, names if named else [])
    axes.set_ylim(place[-1] + 0.6, -0.6)
    axes.grid(visible=False, axis="y")
    axes.locator_params(axis="x", nbins=4)
