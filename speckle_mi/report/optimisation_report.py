"""What an optimisation leaves behind: JSON of the best designs, all trials as CSV, a table, a picture."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator

import numpy as np

from ..machine.files import write_csv
from ..machine.system import system_information
from ..studies.figures import Figure
from ..studies.optimisation import Optimum, Trial
from .plots import FONT, MEAN, SURFACE, THEORY, dress, legend_outside, new_figure, write_picture
from .terminal import print_table, terminal


def optimum_to_json(found: Optimum) -> dict:
    """The best designs with what theory and frames say of them, and what was asked for."""
    return {
        "goals": [{"figure": one.figure.text, "unit": one.figure.unit, "large": one.is_large}
                  for one in found.goals.goals],
        "limits": [{"figure": one.figure.text, "unit": one.figure.unit, "at_least": one.at_least,
                    "at_most": one.at_most} for one in found.goals.limits],
        "free": {one.name: [one.low, one.high] for one in found.free},
        "trials": len(found.trials),
        "failed": sum(bool(one.failed) for one in found.trials),
        "best": [
            {"values": trial.values, "figures": _figures(trial.figures),
             "measured": _figures(found.measured[number]) if number in found.measured else None}
            for number, trial in enumerate(found.front)
        ],
        "system": system_information(),
    }  # fmt: skip


def _figures(figures: dict[str, Figure]) -> dict:
    return {
        name: {"value": one.value, "ci95": list(one.interval), "theory": one.theory, "unit": one.name.unit}
        for name, one in figures.items()
    }


def write_trials(path: str | os.PathLike, found: Optimum) -> None:
    """A row a trial, in their order: numbers, figures, by how much limits are exceeded, whether it is of the best."""
    numbers = [one.name for one in found.free]
    figures = list(dict.fromkeys(one.text for one in found.goals.figures))
    best = {id(one) for one in found.front}

    def rows() -> Iterator[dict]:
        for number, trial in enumerate(found.trials):
            row = {"trial": number, **trial.values, "exceeds": _cell(trial.violation), "failed": trial.failed}
            row |= {name: _cell(one.best) for name, one in trial.figures.items()}
            yield row | {"best": int(id(trial) in best)}

    write_csv(path, ["trial", *numbers, *figures, "exceeds", "best", "failed"], rows())


def _cell(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def plot_optimum(path: str | os.PathLike, found: Optimum) -> None:
    """For one goal the trials along each number; for several the trade-offs, a panel a pair of goals."""
    goals, free = found.goals.goals, found.free
    pairs = [(a, b) for a in range(len(goals)) for b in range(a + 1, len(goals))]
    count = len(pairs) or len(free)
    columns = min(3, count)
    figure = new_figure(1.0 + 3.6 * columns, 0.6 + 3.2 * -(-count // columns))
    panels = figure.subplots(-(-count // columns), columns, squeeze=False).ravel()
    kept = [one for one in found.trials if one.is_feasible]
    beyond = [one for one in found.trials if not one.is_feasible and np.all(np.isfinite(one.costs))]
    for number, axes in enumerate(panels):
        if number >= count:
            axes.set_visible(False)
            continue
        dress(axes)
        along, across = (_goal(found, one) for one in pairs[number]) if pairs else (
            _number(found, number), _goal(found, 0)
        )  # fmt: skip
        for trials, colour, mark, name in (
            (beyond, SURFACE, "x", "exceeds a limit"), (kept, MEAN, ".", "trial"), (found.front, THEORY, "o", "best"),
        ):  # fmt: skip
            if trials:
                x, y = ([value(one) for one in trials] for _, value in (along, across))
                line = "-" if pairs and name == "best" and len(goals) == 2 else ""
                axes.plot(x, y, mark + line, color=colour, markersize=4, linewidth=1.0, label=name)
        axes.set_xlabel(along[0], fontsize=FONT - 1)
        axes.set_ylabel(across[0], fontsize=FONT - 1)
        if kept and not pairs:
            _look_at(axes, [across[1](one) for one in kept])
    legend_outside(figure, *panels[:count], columns=3)
    write_picture(figure, path)


def _look_at(axes, values: list[float]) -> None:
    """What keeps to the limits is looked at, however far off others are."""
    room = 0.08 * max(np.ptp(values), 1e-300)
    axes.set_ylim(min(values) - room, max(values) + room)


def _goal(found: Optimum, number: int):
    goal = found.goals.goals[number]
    unit = f" ({goal.figure.unit})" if goal.figure.unit else ""
    return f"{goal.figure.text}{unit}", lambda trial: trial.figures[goal.figure.text].best


def _number(found: Optimum, number: int):
    name = found.free[number].name
    return name, lambda trial: trial.values[name]


MOST_PRINTED = 12


def print_optimum(found: Optimum) -> None:
    """Prints the best designs, spread evenly where there are many, with what surfaces show of them."""
    console, rows = terminal(), []
    figures = list(dict.fromkeys(one.text for one in found.goals.figures))
    for number in list(found.measured)[:MOST_PRINTED]:
        trial = found.front[number]
        cells = [f"{value:.6g}" for value in trial.values.values()]
        rows.append([*cells, *(_with_interval(trial, found.measured[number].get(name), name) for name in figures)])
    units = {one.text: one.unit for one in found.goals.figures}
    heads = [
        *(one.name for one in found.free),
        *(f"{name} ({units[name]})" if units[name] else name for name in figures),
    ]
    title = "The best design" if len(found.front) == 1 else f"{len(rows)} of {len(found.front)} best trade-offs"
    print_table(console, heads, rows, title=f"{title}: {', '.join(one.text for one in found.goals.goals)}", left=())
    failed = sum(bool(one.failed) for one in found.trials)
    console.print(f"{len(found.trials)} trials" + (f", {failed} of them cannot be" if failed else ""))
    for one in found.free:
        edge = [value for value in (one.low, one.high) if len(found.front) == 1
                and abs(found.front[0].values[one.name] - value) <= 1e-6 * (one.high - one.low)]  # fmt: skip
        if edge:
            console.print(f"{one.name}: the best is at the bound {edge[0]:g}, it may be better beyond")


def _with_interval(trial: Trial, measured: Figure | None, name: str) -> str:
    known = trial.figures[name].best
    if measured is None or not math.isfinite(measured.interval[0]) or measured.interval[0] == measured.interval[1]:
        return f"{known:.5g}"
    low, high = measured.interval
    return f"{known:.5g} [{low:.4g}, {high:.4g}]"
