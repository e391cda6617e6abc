"""What a study of uncertainty leaves behind: JSON, a table of its samples, tolerances as a file, tables, plots."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..machine.files import replacing, write_csv
from ..machine.system import system_information
from ..studies.entries import entries_of
from ..studies.uncertainty import EntryUncertainty, UncertaintyResult
from ..studies.widths import AllowedWidths, Widths
from .budget_plots import plot_budget, plot_indices
from .terminal import print_table, terminal

PRINTED_AXES = ("u", "v", "cog_u", "cog_v")
LARGEST_SHOWN = 3
"""Factors that a table names of an entry."""

_INTERVALS_NOTE = (
    "tolerances: standard uncertainty of what is expected over all surfaces; surfaces: by which one surface differs "
    "from that; camera: of one measured shift over the range. They are independent."
)


def uncertainty_to_json(result: UncertaintyResult, widths: AllowedWidths | None) -> dict:
    """Everything that was found, as plain data."""
    sensitivities: dict = {}
    for found in result.entries.values():
        entry = found.entry
        place = sensitivities
        if len(result.detectors) > 1:
            place = sensitivities.setdefault(result.detectors[entry.detector], {})
        place.setdefault(entry.dof, {})[entry.axis] = _entry_to_json(found)
    by_detector = len(result.detectors) > 1
    return {
        **({"detectors": {name: {"sensitivity": part} for name, part in sensitivities.items()}} if by_detector
           else {"sensitivity": sensitivities}),
        "tolerances": {
            one.parameter: {
                "kind": one.kind, "middle": one.middle, "size": one.size, "standard_deviation": one.deviation,
            }
            for factor in result.tolerances.factors for one in factor.tolerances
        },
        "factors": [factor.name for factor in result.tolerances.factors],
        "inverse": None if widths is None else _widths_to_json(result, widths),
        "samples": len(result.samples), "rows": result.rows, "failed": result.failed,
        "first_failure": result.reason or None,
        "seeds": list(result.surfaces), "seeds_of_samples": list(result.seeds),
        "note": _INTERVALS_NOTE,
        "system": system_information(),
    }  # fmt: skip


def _entry_to_json(found: EntryUncertainty) -> dict:
    return {
        "unit": found.entry.unit, "nominal": found.nominal, "mean": found.mean,
        "standard_uncertainty": found.deviation, "standard_uncertainty_error": found.deviation_error,
        "ci95": list(found.interval), "basis": found.basis,
        "first_order": {name: value for name, (value, _) in found.first_order.items()},
        "first_order_error": {name: error for name, (_, error) in found.first_order.items()},
        "total": {name: value for name, (value, _) in found.total.items()},
        "total_error": {name: error for name, (_, error) in found.total.items()},
        "linear": {"standard_uncertainty": found.linear_deviation, "contributions": found.linear},
        "tighten_first": found.first_to_tighten,
        "parts": {"tolerances": found.deviation, "surfaces": found.surfaces, "camera": found.camera},
        "combined": found.combined,
        "frames": {"standard_uncertainty": found.frames[0], "error": found.frames[1]},
        "note": found.note,
    }  # fmt: skip


def _widths_to_json(result: UncertaintyResult, widths: AllowedWidths) -> dict:
    def sizes(of: Widths) -> dict:
        tolerances = {one.parameter: one.size for factor in of.tolerances.factors for one in factor.tolerances}
        return {"sizes": tolerances, "uncertainty": of.uncertainty}

    return {
        "allowed": widths.allowed, "factor": widths.factor,
        "together": sizes(widths.together), "equal": sizes(widths.equal),
        "alone": {name: None if math.isinf(size) else size for name, size in widths.alone.items()},
    }  # fmt: skip


def write_samples(path: str | os.PathLike, result: UncertaintyResult) -> None:
    """A row a variant: block, row, numbers, what compensators were set to, and every entry by theory and by frames."""
    adjusted = [one.parameter for one in result.tolerances.adjustments]
    entries = entries_of(result.detectors)
    heads = [f"{kind} {entry.name}" for kind in ("theory", "frames") for entry in entries]
    names = ["block", "row", *result.tolerances.parameters, *adjusted, *heads, "failed"]

    def rows() -> Iterator[dict]:
        for sample in result.samples:
            found = sample.found
            row = {"block": sample.block, "row": sample.row, **sample.values, "failed": found.failed}
            row |= dict(zip(adjusted, found.adjusted, strict=False))
            if not found.failed:
                measured = found.measured.mean(axis=0) if len(found.measured) else np.full_like(found.theory, np.nan)
                for kind, values in (("theory", found.theory), ("frames", measured)):
                    row |= {f"{kind} {entry.name}": _cell(values[entry.place]) for entry in entries}
            yield row

    write_csv(path, names, rows())


def _cell(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def write_allowed(path: str | os.PathLike, widths: AllowedWidths) -> None:
    """The tolerances that use the allowance up, each with the same part of it, as a file that can be read again."""
    with replacing(path) as temporary:
        temporary.write_text(
            "# Tolerances that use the allowed uncertainty up, each the same part of it.\n"
            + widths.equal.tolerances.to_toml(),
            encoding="utf-8",
        )


def write_uncertainty_plots(folder: Path, result: UncertaintyResult) -> list[str]:
    """``budget.png`` and ``sobol.png``; returns the names."""
    shown = [one for one in result.entries.values() if one.entry.axis in PRINTED_AXES and one.first_to_tighten]
    if not shown:
        return []
    plot_budget(folder / "budget.png", shown)
    plot_indices(folder / "sobol.png", shown)
    return ["budget.png", "sobol.png"]


def print_uncertainty(result: UncertaintyResult, widths: AllowedWidths | None) -> None:
    """Prints the budget of every entry on the detector, what to tighten first, and how wide tolerances may be."""
    console, rows = terminal(), []
    shown = [one for one in result.entries.values() if one.entry.axis in PRINTED_AXES]
    for found in shown:
        rows.append([
            found.entry.name, found.entry.unit, f"{_near_zero(found.nominal):+.4f}",
            *_of_tolerances(found),
            _number(found.surfaces), _number(found.camera), _largest(found),
        ])  # fmt: skip
    heads = ["entry", "unit", "nominal", "tolerances", "linear", "one surface", "camera", "first to tighten"]
    print_table(console, heads, rows, title="Standard uncertainties", left=(0, 1, 7))
    if widths is not None:
        _print_widths(console, result, widths)
    for name, value in result.tolerances.allowed:
        if widths is None or name not in widths.allowed:
            console.print(f"allowed {name} {value:g}: these tolerances make less than a thousandth of it")
    for note in dict.fromkeys(found.note for found in shown if found.note):
        console.print(f"{', '.join(found.entry.name for found in shown if found.note == note)}: {note}")
    failed = f", {result.failed} failed (the first: {result.reason})" if result.failed else ""
    console.print(
        f"{len(result.samples)} samples in rows of {result.rows}{failed}; surfaces {_span(result.surfaces)}, samples "
        f"on {_span(result.seeds)}"
    )


def _print_widths(console, result: UncertaintyResult, widths: AllowedWidths) -> None:
    def sizes(of: Widths) -> dict[str, float]:
        return {one.parameter: one.size for factor in of.tolerances.factors for one in factor.tolerances}

    together, equal, rows = sizes(widths.together), sizes(widths.equal), []
    for factor in result.tolerances.factors:
        for one in factor.tolerances:
            alone = widths.alone[one.parameter]
            rows.append([
                one.parameter, "sd" if one.kind == "normal" else "half width", f"{one.size:.3g}",
                f"{together[one.parameter]:.3g}", f"{equal[one.parameter]:.3g}",
                "any" if math.isinf(alone) else f"{alone:.3g}" if alone > 0 else "-",
            ])  # fmt: skip
    allowed = ", ".join(f"{name} {value:g}" for name, value in widths.allowed.items())
    heads = ["number", "size", "given", "all in proportion", "all with equal parts", "alone"]
    print_table(console, heads, rows, title=f"How wide tolerances may be for {allowed}", left=(0, 1))


def _of_tolerances(found: EntryUncertainty) -> tuple[str, str]:
    if not found.first_to_tighten and found.basis == "theory":
        return "0", "0"
    return f"{found.deviation:.2g} ± {found.deviation_error:.1g}", f"{found.linear_deviation:.2g}"


def _largest(found: EntryUncertainty) -> str:
    names = found.first_to_tighten[:LARGEST_SHOWN]
    return (
        ", ".join(f"{name} {min(found.total[name][0], 1):.0%}" for name in names if found.total[name][0] > 0.01) or "-"
    )


def _number(value: float) -> str:
    return f"{value:.2g}" if math.isfinite(value) else "-"


def _near_zero(value: float) -> float:
    return 0.0 if abs(value) < 5e-5 else value


def _span(seeds: tuple[int, ...]) -> str:
    if not seeds:
        return "none"
    return f"{seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else f"{seeds[0]}"
