"""What a comparison leaves behind: JSON, a table of all figures as CSV, the paper's tables for any scenes, plots."""

from __future__ import annotations

import math
import os
from pathlib import Path

from ..machine.files import write_csv
from ..machine.system import system_information
from ..studies.comparison import GENERAL, TABLES, DesignComparison, Compared
from ..studies.figures import Figure
from .comparison_plots import plot_curves, plot_maps, plot_side_by_side
from .terminal import print_table, terminal

MOST_NAMED = 8
"""Assemblies that a line names."""


def comparison_to_json(found: DesignComparison) -> dict:
    """Everything that was found, as plain data."""
    return {
        "requirement": [
            {"figure": one.figure.text, "unit": one.figure.unit, "at_least": one.at_least, "at_most": one.at_most}
            for one in found.requirements.limits
        ],
        "ranked_by": found.requirements.rank_by.text,
        "ranking": [one.candidate.name for one in found.in_order],
        "candidates": [_candidate_to_json(one) for one in found.compared],
        "conclusions": [
            {
                "use": one.use, "figure": one.figure, "alike": one.alike, "best": one.best, "clear": one.is_clear,
                "order": [found.compared[number].candidate.name for number in one.order],
            }
            for one in found.conclusions
        ],
        "system": system_information(),
    }  # fmt: skip


def _candidate_to_json(one: Compared) -> dict:
    return {
        "scene": one.candidate.scene, "values": dict(one.candidate.values), "rank": one.rank, "shared": one.shared,
        "verdict": one.verdict, "verdicts": list(one.verdicts), "failed": one.failed or None,
        "figures": {
            name: {"value": figure.value, "ci95": list(figure.interval), "theory": figure.theory,
                   "unit": figure.name.unit}
            for name, figure in one.figures.items()
        },
    }  # fmt: skip


def write_comparison(path: str | os.PathLike, found: DesignComparison) -> None:
    """A row a candidate: rank, verdict, and of every figure value, interval and theory."""
    swept = [one.name for one in found.swept]
    figures = list(found.compared[0].figures)
    kinds = ("", " low", " high", " theory")
    names = ["scene", *swept, "rank", "verdict", *(name + kind for name in figures for kind in kinds), "failed"]

    def row(one: Compared) -> dict:
        cells = {"scene": one.candidate.scene, **dict(one.candidate.values), "rank": one.rank, "verdict": one.verdict}
        for name, figure in one.figures.items():
            values = (figure.value, *figure.interval, figure.theory)
            cells |= {name + kind: _cell(value) for kind, value in zip(kinds, values, strict=True)}
        return cells | {"failed": one.failed}

    write_csv(path, names, map(row, found.compared))


def _cell(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def write_comparison_plots(folder: Path, found: DesignComparison) -> list[str]:
    """``comparison.png``, of one swept number curves and of two maps instead; returns the names."""
    shown = [name for name in GENERAL if name != "seconds"]
    limits = [limit.figure.text for limit in found.requirements.limits]
    shown = list(dict.fromkeys([*limits, *shown]))[:9]
    if len(found.swept) == 1:
        plot_curves(folder / "comparison.png", found, shown)
        return ["comparison.png"]
    if len(found.swept) == 2:
        scenes = list(dict.fromkeys(one.candidate.scene for one in found.compared))
        names = ["comparison.png"] if len(scenes) == 1 else [f"comparison.{Path(one).name}.png" for one in scenes]
        for scene, name in zip(scenes, names, strict=True):
            plot_maps(folder / name, found, scene, shown)
        return names
    plot_side_by_side(folder / "comparison.png", found, shown)
    return ["comparison.png"]


def print_comparison(found: DesignComparison) -> None:
    """Prints the paper's tables, the general figures, verdicts, the ranking, and what is best for which use."""
    console = terminal()
    there = [one for one in found.in_order if not one.failed]
    for title, names in [*TABLES.items(), ("Side by side", GENERAL)]:
        if names[0] not in found.compared[0].figures:
            continue
        heads = ["assembly", *(_head(there[0].figures[name]) for name in names)]
        rows = [[one.candidate.name, *(_with_theory(one.figures[name]) for name in names)] for one in there]
        print_table(console, heads, rows, title=title)
    limits = found.requirements.limits
    if limits:
        rows = [
            [str(one.rank), one.candidate.name, one.verdict,
             *(f"{_short(one.figures[limit.figure.text])} {verdict}" for limit, verdict in zip(limits, one.verdicts))]
            for one in found.in_order
        ]  # fmt: skip
        print_table(console, ["rank", "assembly", "requirement", *(limit.text for limit in limits)], rows, left=(1, 2),
                    title="The requirement")  # fmt: skip
    for one in found.compared:
        if one.failed:
            console.print(f"{one.candidate.name}: cannot be ({one.failed})")
    by = found.requirements.rank_by.text
    ranked = [one for one in found.in_order if not one.failed]
    more = f"; and {len(ranked) - MOST_NAMED} more" if len(ranked) > MOST_NAMED else ""
    console.print(f"ranked by {by}: " + "; ".join(map(_ranked, ranked[:MOST_NAMED])) + more)
    for one in found.conclusions if len(found.compared) <= MOST_NAMED else ():
        names = [found.compared[number].candidate.name for number in one.order]
        best, rest = " and ".join(names[: one.best]), ", ".join(names[one.best :])
        if one.alike:
            console.print(f"for {one.use} ({one.figure}) all are alike, within 10 %")
        else:
            how = "" if one.is_clear else " (not told from the next by these surfaces)"
            verb = "is best" if one.best == 1 else "are best and alike"
            console.print(f"for {one.use} ({one.figure}) {best} {verb}{how}, then {rest}")


def _ranked(one: Compared) -> str:
    return f"{one.rank}{' (shared)' if one.shared else ''} {one.candidate.name}"


def _head(figure: Figure) -> str:
    unit = f" ({figure.name.unit})" if figure.name.unit else ""
    return f"{figure.name.text}{unit}"


def _short(figure: Figure) -> str:
    return f"{figure.best:.3g}" if not math.isnan(figure.best) else "-"


def _with_theory(figure: Figure) -> str:
    """Value, half width of its interval, theory in brackets."""
    if math.isnan(figure.value):
        return "-"
    if figure.value == math.inf:
        return "not seen"
    low, high = figure.interval
    if not math.isfinite(low):
        return f"{figure.value:.3g}"
    theory = f" ({figure.theory:.4f})" if math.isfinite(figure.theory) else ""
    return f"{figure.value:.4f} ± {(high - low) / 2:.4f}{theory}"
