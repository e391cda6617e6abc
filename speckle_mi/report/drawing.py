"""The layout drawing of an assembly: to scale, from the side and from above, with the rays as they really go."""

from __future__ import annotations

import io
import os
import re

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.text import Text

from ..experiments.layout import Layout, Part
from .plots import FONT, new_figure, write_picture

WAYS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
"""Colours of ways (Okabe and Ito), used anew from the seventh on."""

BEAM = "#C00000"
FILLS = {"glass": "#CFE6F5", "detector": "#444444", "target": "#B5B5B5", "opaque": "#8C8C8C", "laser": BEAM}
EDGES = {"mirror": "#777777", "opening": "#000000", "glass": "#4A7FA7"}
VIEWS = ("from the side: target's x upwards [mm]", "from above: target's y upwards [mm]")

_METADATA = ("Creator", "Date", "Format", "Type")
"""What matplotlib says of a file unless asked not to."""

_WIDTH, _LEAST_WIDTH, _LEAST_HEIGHT, _MOST_HEIGHT = 9.0, 7.0, 2.2, 6.5
"""Of the figure, and of one view [inch]."""

_NAMES = 0.3
"""Room for names above everything [inch]."""

_LABEL = 1.35
"""Distance of the lines of labels that would overlap, in heights of letters."""


def draw_layout(path: str | os.PathLike, layout: Layout, title: str) -> None:
    """Writes the drawing as PNG or SVG, by the ending of ``path``."""
    write_picture(_drawn(layout, title), path)


def layout_svg(layout: Layout, title: str) -> str:
    """The drawing as an SVG element to stand in a page: it names no file and no address."""
    held = io.StringIO()
    _drawn(layout, title).savefig(held, format="svg", metadata=dict.fromkeys(_METADATA))
    drawing = held.getvalue()
    drawing = re.sub(r"<metadata>.*?</metadata>", "", drawing[drawing.index("<svg") :], flags=re.DOTALL)
    return re.sub(r' xmlns(:xlink)?="[^"]*"', "", drawing).replace("xlink:href", "href")


def _drawn(layout: Layout, title: str) -> Figure:
    lows, highs = (np.array(corners) for corners in zip(*(_extent(layout, view) for view in (0, 1)), strict=True))
    left, right = lows[:, 0].min(), highs[:, 0].max()
    # One scale for both views: as wide as there is room, but not too high.
    scale = min(_WIDTH / (right - left), _MOST_HEIGHT / np.max(highs[:, 1] - lows[:, 1]))
    highs[:, 1] += _NAMES / scale
    heights = np.maximum(scale * (highs[:, 1] - lows[:, 1]), _LEAST_HEIGHT)
    words = [title, *(f"{what}: {value}" for what, value in layout.facts), *(f"! {one}" for one in layout.warnings)]
    figure = new_figure(max(scale * (right - left), _LEAST_WIDTH) + 1.0, float(sum(heights)) + 1.2 + 0.2 * len(words))
    panels = figure.subplots(3, 1, gridspec_kw={"height_ratios": [*heights, 0.2 * len(words) + 0.1]})
    for view, axes in enumerate(panels[:2]):
        middle = (lows[view, 1] + highs[view, 1]) / 2
        _draw_view(axes, layout, view, (left, right), middle + heights[view] / scale * np.array([-0.5, 0.5]))
    panels[2].axis("off")
    for line, word in enumerate(words):
        looks = {"color": BEAM if word.startswith("!") else "0.1", "weight": "bold" if line == 0 else "normal"}
        panels[2].annotate(_shortened(word), (0, 1), (0, -1.45 * FONT * line), xycoords="axes fraction",
                           textcoords="offset points", fontsize=FONT - 1.5, va="top", **looks)  # fmt: skip
    figure.canvas.draw()
    figure.set_layout_engine("none")  # names are set where things now are
    for view, axes in enumerate(panels[:2]):
        _label(figure, axes, layout, view)
    return figure


def _shortened(text: str, most: int = 128) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def _flat(layout: Layout, points: np.ndarray, view: int) -> np.ndarray:
    """(n, 2) across and up in a view, from the target's origin [mm]."""
    offset = points - layout.origin
    return np.stack([offset @ layout.axes[:, 0], offset @ layout.axes[:, 1 + view]], axis=1)


def _extent(layout: Layout, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of all that is drawn, with a margin."""
    lines = [line.points for part in layout.parts for line in part.lines[view]]
    lines += [line.points for beam in layout.beams for line in beam]
    lines += [ray for rays in layout.rays.values() for ray in rays]
    lines += [problem.place[None] for problem in layout.problems]
    points = np.concatenate([_flat(layout, one, view) for one in lines])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.06 * np.max(high - low)
    return low - margin, high + margin


def _draw_view(axes: Axes, layout: Layout, view: int, across, up) -> None:
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlim(*across)
    axes.set_ylim(*up)
    axes.tick_params(labelsize=FONT - 2)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.94", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_title(VIEWS[view], loc="left", fontsize=FONT)
    if view == 1:
        axes.set_xlabel("along the target's normal [mm]", fontsize=FONT - 1)
    for number, rays in enumerate(layout.rays.values()):
        for place, ray in enumerate(rays):
            flat = _flat(layout, ray, view)
            axes.plot(*flat.T, color=WAYS[number % len(WAYS)], linewidth=1.3 if place == 0 else 0.7,
                      linestyle="-" if place == 0 else (0, (5, 2)), zorder=3)  # fmt: skip
    for problem in layout.problems:
        if problem.ray is not None:
            axes.plot(*_flat(layout, problem.ray, view).T, color=BEAM, linewidth=0.9, linestyle=":", zorder=5)
        place = _flat(layout, problem.place[None], view)
        axes.plot(*place.T, "x", color=BEAM, markersize=7, markeredgewidth=2, zorder=7)
    for lines in layout.beams:
        for place, line in enumerate(lines):
            axes.plot(*_flat(layout, line.points, view).T, color=BEAM, linewidth=1.2 if place == 0 else 0.8,
                      linestyle="-." if place == 0 else "-", zorder=2)  # fmt: skip
    for part in layout.parts:
        for line in part.lines[view]:
            flat = _flat(layout, line.points, view)
            edge = EDGES.get(part.kind, "#000000")
            if line.closed and len(flat) > 2:
                axes.add_patch(Polygon(flat, facecolor=FILLS.get(part.kind, "none"), edgecolor=edge, linewidth=1.0,
                                       alpha=0.4 if part.kind == "opaque" else 0.9, zorder=1))  # fmt: skip
            else:
                axes.plot(*flat.T, color=edge, linewidth=2.4 if part.kind != "glass" else 1.0, zorder=4)


def _label(figure: Figure, axes: Axes, layout: Layout, view: int) -> None:
    """Names above what they belong to; those that would lie on one another go up a line, with a thin leader."""
    renderer, taken = figure.canvas.get_renderer(), []
    background = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    for name, anchor, lift, colour in _names(layout, view):
        while True:
            text = axes.annotate(
                name, anchor, (0, lift * FONT), textcoords="offset points", fontsize=FONT - 1.5, ha="center",
                va="bottom", zorder=8, bbox=background, color=colour,
                arrowprops={"arrowstyle": "-", "color": "0.55", "linewidth": 0.5} if lift > 1 else None,
            )  # fmt: skip
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer).expanded(1.04, 1.02)  # without its leader
            if not any(box.overlaps(other) for other in taken):
                taken.append(box)
                break
            text.remove()
            lift += _LABEL


def _names(layout: Layout, view: int) -> list[tuple[str, np.ndarray, float, str]]:
    """What stands at which place (2,) of a view, how high above it [heights of letters], and its colour."""
    found = []
    for part in sorted(layout.parts, key=lambda one: float((one.place - layout.origin) @ layout.axes[:, 0])):
        found.append((part.name, _anchor(layout, part, view), 0.5 if part.lines[view] else -0.6, "black"))
    for problem in layout.problems:
        if problem.words:
            found.append((problem.words, _flat(layout, problem.place[None], view)[0], 0.6, BEAM))
    return found


def _anchor(layout: Layout, part: Part, view: int) -> np.ndarray:
    """The highest place (2,) of a part in a view, in the middle of those that are as high."""
    lines = [_flat(layout, line.points, view) for line in part.lines[view]]
    points = np.concatenate(lines) if lines else _flat(layout, part.place[None], view)
    top = points[:, 1].max()
    return points[points[:, 1] > top - 0.02 * max(float(np.ptp(points[:, 1])), 1e-9)].mean(axis=0)
