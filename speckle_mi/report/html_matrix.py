"""A page's matrices: sensitivities with their intervals, theory, and how much one motion leaks into another's axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..experiments.expectation import CENTRE_AXES
from ..experiments.sweep_result import SweepSettings
from ..geometry.pose import sensitivity_unit
from ..measurement.sensitivity import Sensitivity
from .console import foot_lines, number, with_interval
from .html import Cell, paragraphs, table

PAIRS = (("On the detector", ("u", "v")), ("Projected on the target's axes", ("x", "y")),
         ("Centre of gravity on the detector", CENTRE_AXES))  # fmt: skip


_ROUNDING = 1e-6
"""Part of the largest shift below which theory's is rounding."""


def sensitivity_tables(summary: dict) -> str:
    """A table a pair of axes: value with its interval, theory, bias and scatter of every motion."""
    fits, parts = summary["fits"], []
    for title, axes in PAIRS:
        if axes == CENTRE_AXES and all(fit[axis].theory is None for fit in fits.values() for axis in axes):
            continue
        heads = ["motion", "unit"]
        for axis in axes:
            heads += [f"{axis} simulated", f"{axis} theory", "bias", "scatter (µm)"]
        rows = [[dof, Cell(sensitivity_unit(dof)), *(cell for axis in axes for cell in _cells(fitted[axis]))]
                for dof, fitted in fits.items()]  # fmt: skip
        caption, name = f"{title}; ± is half the 95 % interval", f"sensitivity {' '.join(axes)}"
        parts.append(table([head.replace("cog_", "") for head in heads], rows, caption, name))
    shown = [axis for _, axes in PAIRS for axis in axes]
    return "\n".join(parts) + paragraphs(foot_lines(fits, shown), "note")


def _cells(fit: Sensitivity) -> list[Cell]:
    if not np.isfinite(fit.value):
        return [Cell("not measured"), Cell(number(fit.theory), fit.theory), *[Cell("–")] * 2]
    return [
        Cell(with_interval(fit), fit.value, interval=fit.ci95),
        Cell(number(fit.theory), fit.theory),
        Cell(number(fit.bias), fit.bias),
        Cell(number(fit.scatter_um, "{:.2f}"), fit.scatter_um),
    ]


def cross_talk(summary: dict, settings: SweepSettings) -> str:
    """Two heat maps: how far a motion over the whole range moves the pattern along each axis, simulated and by theory;
    and what share that is of the largest along the axis."""
    fits: Mapping[str, Mapping[str, Sensitivity]] = summary["fits"]
    width = float(np.ptp(settings.displacements))
    axes, dofs = ("u", "v", "x", "y"), list(fits)
    kinds = {
        "simulated": np.array([[fits[dof][axis].value for axis in axes] for dof in dofs]),
        "theory": np.array([[_known(fits[dof][axis].theory) for axis in axes] for dof in dofs]),
    }
    parts = paragraphs([
        f"Shift of the pattern while the target moves over {width:.4g} mm or {width:.4g} deg, in µm; and below, in "
        "percent of the motion that shifts it most along that axis: what all other motions leak into it. Motions whose "
        "interval holds zero are not taken for the largest; without any there is no share."
    ])  # fmt: skip
    heads = ["motion", *(f"{axis} {kind}" for axis in axes for kind in kinds)]
    shifts = np.stack([1e3 * width * kind for kind in kinds.values()], axis=2)
    sizes = np.nan_to_num(np.abs(shifts))
    strongest = max(float(sizes.max()), 1e-300)
    known = np.stack([[[_differs_from_zero(fits[dof][axis]) for axis in axes] for dof in dofs],
                      sizes[..., 1] > _ROUNDING * strongest], axis=2)  # fmt: skip
    largest = np.max(sizes, axis=0, where=known, initial=0.0, keepdims=True)
    shares = 100 * np.abs(shifts) / np.where(largest > 0, largest, np.nan)
    shades = np.abs(shifts) / strongest, np.minimum(shares, 100) / 100
    parts += _heat_table(heads, dofs, shifts, shades[0], "shift over the range (µm)", "shift", "{:+.1f}")
    return parts + _heat_table(heads, dofs, shares, shades[1], "share of the largest (%)", "cross-talk", "{:.1f}")


def _heat_table(heads: Sequence[str], dofs: Sequence[str], values, shades, caption: str, name: str, form: str) -> str:
    rows = []
    for row, dof in enumerate(dofs):
        cells = zip(values[row].ravel(), np.nan_to_num(shades[row]).ravel(), strict=True)
        rows.append([dof, *(Cell(_shown(value, form), value, float(shade)) for value, shade in cells)])
    return table(heads, rows, caption, name)


def _shown(value: float, form: str) -> str:
    return form.format(value + 0.0) if np.isfinite(value) else "–"


def _differs_from_zero(fit: Sensitivity) -> bool:
    low, high = fit.ci95
    return bool(np.isfinite(fit.value)) and not low <= 0 <= high


def _known(theory: float | None) -> float:
    return np.nan if theory is None else theory


def paper_table(comparison: dict | None) -> str:
    """The published figures of the paper's own set-ups, beside ours; nothing for other scenes."""
    if comparison is None:
        return ""
    rows = [
        (f"{dof} → {entry['axis']}", Cell(entry["unit"]), Cell(f"{entry['paper']:g}", entry["paper"]),
         Cell(number(entry["simulated"], "{:.4f}"), entry["simulated"]),
         Cell(number(entry["theory"], "{:.4f}"), entry["theory"]))
        for dof, entry in comparison["figures"].items()
    ]  # fmt: skip
    heads = ("motion → axis", "unit", "paper", "simulated", "theory")
    title = f"Magnitudes beside the published ones: {comparison['assembly']}"
    notes = [f"{dof}: {note}" for dof, note in (comparison["notes"] or {}).items()]
    return table(heads, rows, title, "paper") + paragraphs(notes, "note")
