"""Reports of studies, each a page made of what its JSON says: budget and Sobol indices, ranking, best designs."""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..machine.files import replacing
from .html import Cell, Section, numbers, page, paragraphs, plot, table, text
from .html_facts import machine


def write_study(
    path: str | os.PathLike, title: str, content: Mapping, command: str, pictures: Sequence[str | os.PathLike]
) -> None:
    """Writes the page of a study, whole or not at all.

    content: what its JSON file holds, of ``uncertainty``, ``compare`` or ``optimise``; command: the line that
    reproduces it; pictures: PNG files that it has drawn.
    """
    kinds = {"tolerances": _uncertainty, "ranking": _comparison, "best": _optimum}
    sections = next(make for name, make in kinds.items() if name in content)(content)
    sections.append(Section("Plots", "".join(map(_picture, pictures)), "plots"))
    reproduced = f"<pre>{text(command)}</pre>" + machine(content["system"])
    sections.append(Section("Versions and command", reproduced, "command"))
    shown = {name: value for name, value in content.items() if name not in ("system", "identity")}
    with replacing(path) as temporary:
        temporary.write_text(page(title, "", sections, {"study": shown}), encoding="utf-8")


def _picture(path: str | os.PathLike) -> str:
    held = base64.b64encode(Path(path).read_bytes()).decode("ascii")
    return f'<figure class="picture"><img alt="{text(Path(path).stem)}" src="data:image/png;base64,{held}"></figure>'


def _cell(value: float | None, form: str = "{:.4g}") -> Cell:
    known = value is not None and math.isfinite(value)
    return Cell(form.format(value) if known else "–", value if known else None)


def _bar(value: float | None) -> Cell:
    known = value is not None and math.isfinite(value)
    return Cell(f"{value:.3f}" if known else "–", value if known else None, bar=max(value, 0.0) if known else None)


# Uncertainty


def _uncertainty(content: Mapping) -> list[Section]:
    entries = dict(_entries(content))
    factors = content["factors"]
    budget = [
        (name, Cell(one["unit"]), _cell(one["nominal"]), _cell(one["mean"]), _cell(one["standard_uncertainty"]),
         *(_cell(one["parts"][part]) for part in ("tolerances", "surfaces", "camera")), _cell(one["combined"]),
         ", ".join(one["tighten_first"]) if isinstance(one["tighten_first"], list) else one["tighten_first"] or "–")
        for name, one in entries.items()
    ]  # fmt: skip
    heads = ("entry", "unit", "nominal", "mean", "standard uncertainty", "by tolerances", "by the surface",
             "by the camera", "combined", "tighten first")  # fmt: skip
    said = f"{content['rows']} variants by first-order theory and frames, {content['failed']} failed."
    whole = table(heads, budget, name="budget") + paragraphs([said, content["note"]], "note")
    sections = [Section("Budget", whole, "budget")]
    tables = ""
    for kind, words in (("first_order", "first order: what a number makes alone"),
                        ("total", "total: with what it makes together with others")):  # fmt: skip
        rows = [(name, *(_bar(one[kind].get(factor)) for factor in factors)) for name, one in entries.items()]
        tables += table(("entry", *factors), rows, f"Sobol indices, {words}", kind)
    sections.append(Section("Sobol indices", tables, "sobol"))
    rows = [(name, one["kind"], *(_cell(one[key], "{:.6g}") for key in ("middle", "size", "standard_deviation")))
            for name, one in content["tolerances"].items()]  # fmt: skip
    heads = ("number", "law", "middle", "size", "standard deviation")
    sections.append(Section("Tolerances", table(heads, rows, name="tolerances"), "tolerances"))
    return sections


def _entries(content: Mapping):
    """Names of all entries of the matrix, and what was found of each."""
    parts = content.get("detectors") or {"": content}
    for detector, part in parts.items():
        for dof, axes in part["sensitivity"].items():
            for axis, one in axes.items():
                yield f"{detector} {dof}\u00a0→\u00a0{axis}".strip(), one


# Comparison


def _comparison(content: Mapping) -> list[Section]:
    candidates = sorted(content["candidates"], key=lambda one: math.inf if one["rank"] is None else one["rank"])
    numbered = list(dict.fromkeys(name for one in candidates for name in one["values"]))
    ranking = [
        (one["scene"], *(_cell(one["values"].get(name), "{:.6g}") for name in numbered), _cell(one["rank"], "{:.0f}"),
         one["verdict"] or "–", "; ".join([*map(str, one["verdicts"]), *([one["failed"]] if one["failed"] else [])]))
        for one in candidates
    ]  # fmt: skip
    heads = ("scene", *numbered, "rank", "verdict", "limit by limit")
    asked = [f"{one['figure']}{_limits(one)}" for one in content["requirement"]]
    said = [f"Ranked by {content['ranked_by']}.", *([f"Required: {', '.join(asked)}."] if asked else [])]
    figures = list(dict.fromkeys(name for one in candidates for name in one["figures"]))
    rows = []
    for name in figures:
        cells = [one["figures"].get(name) for one in candidates]
        unit = next((cell["unit"] for cell in cells if cell), "")
        rows.append((name, Cell(unit), *map(_figure, cells)))
    labels = [" ".join([one["scene"], *(f"{name}={value:g}" for name, value in one["values"].items())])
              for one in candidates]  # fmt: skip
    return [
        Section("Ranking", paragraphs(said) + table(heads, ranking, name="ranking"), "ranking"),
        Section("Figures", table(("figure", "unit", *labels), rows, "with 95 % intervals", "figures"), "figures"),
    ]


def _limits(one: Mapping) -> str:
    ends = (("at least", one["at_least"]), ("at most", one["at_most"]))
    said = [f" {words} {value:g}" for words, value in ends if value is not None and math.isfinite(value)]
    return f"{' and'.join(said)} {one['unit']}".rstrip()


def _value(one: Mapping) -> float:
    """A figure's value, where it is not measured theory's; NaN where neither is known."""
    known = [value for value in (one["value"], one["theory"]) if value is not None and math.isfinite(value)]
    return known[0] if known else math.nan


def _figure(one: Mapping | None) -> Cell:
    """A figure with half its interval."""
    if one is None or not math.isfinite(_value(one)):
        return Cell("–")
    low, high = (math.nan if bound is None else bound for bound in one["ci95"])
    half = f" ± {(high - low) / 2:.2g}" if math.isfinite(high - low) else ""
    return Cell(f"{_value(one):.4g}{half}", _value(one), interval=(low, high))


# Optimum


def _optimum(content: Mapping) -> list[Section]:
    free, goals = list(content["free"]), content["goals"]
    figures = [one["figure"] for one in (*goals, *content["limits"])]
    figures = list(dict.fromkeys(figures))
    rows = []
    for number, one in enumerate(content["best"], 1):
        measured = one["measured"] or {}
        cells = [cell for name in figures for cell in (_figure(one["figures"].get(name)), _figure(measured.get(name)))]
        rows.append((str(number), *(_cell(one["values"].get(name), "{:.6g}") for name in free), *cells))
    heads = ("design", *free, *(f"{name} {kind}" for name in figures for kind in ("by theory", "by frames")))
    bounds = ", ".join(f"{name} from {low:g} to {high:g}" for name, (low, high) in content["free"].items())
    wanted = ", ".join(f"{one['figure']} {'large' if one['large'] else 'small'}" for one in goals)
    limits = ", ".join(f"{one['figure']}{_limits(one)}" for one in content["limits"])
    said = [f"Chosen: {bounds}.", f"Wanted: {wanted}{f'; {limits}' if limits else ''}.",
            f"{content['trials']} designs were tried, {content['failed']} failed."]  # fmt: skip
    sections = [Section("Best designs", paragraphs(said) + table(heads, rows, name="best"), "best")]
    if len(goals) == 2 and len(content["best"]) > 1:
        sections.append(Section("Pareto front", _front(content), "front"))
    return sections


def _front(content: Mapping) -> str:
    """The best designs by their two goals: none is better in both than another."""
    first, second = content["goals"]
    pairs = sorted(tuple(_value(one["figures"][goal["figure"]]) for goal in (first, second)) for one in content["best"])
    marks = {"look": "mean", "hue": 0, "name": "best designs", "short": second["figure"],
             "x": numbers(x for x, _ in pairs), "y": numbers(y for _, y in pairs)}  # fmt: skip
    named = [f"{one['figure']} ({one['unit']})" if one["unit"] else one["figure"] for one in (first, second)]
    panel = {"y": named[1], "height": 260, "series": [marks]}
    return plot({"title": "trade-off", "x": named[0], "symbol": first["figure"], "unit": first["unit"] or "",
                 "views": [{"name": "", "panels": [panel]}]})  # fmt: skip
