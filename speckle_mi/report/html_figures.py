"""A page's figures of a sweep: shifts with residuals, and decorrelation, a figure a motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..experiments.expectation import CENTRE_AXES
from ..experiments.sweep_result import SweepResult, SweepSettings
from ..geometry.pose import is_rotation, unit_of
from ..measurement.sensitivity import Sensitivity
from .html import numbers, paragraphs, plot, text
from .html_matrix import PAIRS

_MOST_SURFACES = 24
"""Surfaces that are drawn one by one; the mean is that of all."""

_MOST_PLACES = 300
"""Displacements that are drawn, evenly chosen."""


def shift_figures(
    fits: Mapping[str, Mapping[str, Sensitivity]], settings: SweepSettings, result: SweepResult
) -> str:
    """A figure a motion, of shift and residual along two axes; the axes are chosen for all figures at once."""
    pairs = [(title, axes) for title, axes in PAIRS if axes != CENTRE_AXES or _has_theory(fits)]
    figures = []
    for dof, fitted in fits.items():
        views = [{"name": title, "panels": _panels(dof, axes, fitted, settings, result)} for title, axes in pairs]
        figures.append(plot(_frame(dof) | {"views": views}))
    options = "".join(f'<option value="{k}">{text(title)}</option>' for k, (title, _) in enumerate(pairs))
    return (
        f'<div class="controls"><label>axes <select class="views">{options}</select></label></div>'
        + _said(settings)
        + f'<div class="figures">{"".join(figures)}</div>'
    )


def decorrelation_figures(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]], settings: SweepSettings, result: SweepResult
) -> str:
    """A figure a motion, of the correlation's peak against displacement. curves: by motion, what theory expects."""
    figures = []
    for dof in settings.dofs:
        places = _chosen(settings)
        values = result.values(dof, "ncc", settings)[:, places]
        series = _measured(settings.displacements[places], values, 0, "correlation", True)
        if dof in curves:
            x, y = curves[dof]
            series.append({"look": "curve", "hue": 1, "name": "theory", "x": numbers(x), "y": numbers(y)})
        panel = {"y": "peak correlation", "height": 190, "series": series, "from": 0, "to": 1}
        figures.append(plot(_frame(dof) | {"views": [{"name": "", "panels": [panel]}]}))
    return f'<div class="figures">{"".join(figures)}</div>'


def _said(settings: SweepSettings) -> str:
    count = len(settings.seeds)
    some = f" {_MOST_SURFACES} of them are drawn." if count > _MOST_SURFACES else ""
    lines = ["Drag over a part of a figure to see it larger; point at it to read values. Lines are theory, or the "
             "fitted slope where there is none; below are the shifts less that line."]  # fmt: skip
    if count > 1:
        lines.append(f"Marks are means with standard deviations over {count} surfaces, faint lines the surfaces.{some}")
    return paragraphs(lines, "note")


def _frame(dof: str) -> dict:
    """What all figures of a motion share."""
    what = f"rotation of the target about {dof[1:]}" if is_rotation(dof) else f"motion of the target along {dof}"
    return {"title": dof, "x": f"{what} ({unit_of(dof)})", "symbol": dof, "unit": unit_of(dof)}


def _has_theory(fits: Mapping[str, Mapping[str, Sensitivity]]) -> bool:
    return any(fitted[axis].theory is not None for fitted in fits.values() for axis in CENTRE_AXES)


def _chosen(settings: SweepSettings) -> np.ndarray:
    """Indices of the displacements that are drawn, in their order."""
    order = np.argsort(settings.displacements)
    count = min(len(order), _MOST_PLACES)
    return order[np.linspace(0, len(order) - 1, count).round().astype(int)]


def _panels(
    dof: str, axes: tuple[str, str], fitted: Mapping[str, Sensitivity], settings: SweepSettings, result: SweepResult
) -> list[dict]:
    """Shift above, residual below, for two axes in two colours."""
    places, above, below = _chosen(settings), [], []
    x = settings.displacements[places]
    for hue, axis in enumerate(axes):
        column = f"{axis}_um" if axis in CENTRE_AXES else f"shift_{axis}_um"
        shifts = result.values(dof, column, settings)[:, places]
        name, fit = axis.removeprefix("cog_"), fitted[axis]
        slope = fit.value if fit.theory is None else fit.theory
        above += _measured(x, shifts, hue, name, False)
        ends = np.array([x.min(), x.max()])
        if np.isfinite(slope):
            line = {"look": "curve", "hue": hue, "x": numbers(ends)}
            kind = "fit" if fit.theory is None else "theory"
            above.append(line | {"name": f"{name}, {kind}", "y": numbers(1e3 * slope * ends)})
            below.append(line | {"y": [0.0, 0.0]})
            below += _measured(x, shifts - 1e3 * slope * x, hue, f"{name} residual", True)
    panels = [{"y": "shift (µm)", "height": 180, "series": above}]
    return [*panels, {"y": "residual (µm)", "height": 120, "series": below}] if below else panels


def _measured(x: np.ndarray, values: np.ndarray, hue: int, name: str, is_repeated: bool) -> list[dict]:
    """Series of (surfaces, n) values: faint lines of the surfaces, means with their spread, crosses where some failed.

    is_repeated: without names in the key, which another panel's have.
    """
    places, series = numbers(x), []
    known = np.isfinite(values)
    count = known.sum(axis=0)
    filled = np.where(known, values, 0.0)
    mean = np.where(count > 0, filled.sum(axis=0) / np.maximum(count, 1), np.nan)
    spread = np.sqrt(np.sum(np.where(known, values - mean, 0.0) ** 2, axis=0) / np.maximum(count - 1, 1))
    if len(values) > 1:
        some = [numbers(one) for one in values[:_MOST_SURFACES]]
        series.append({"look": "thin", "hue": hue, "x": places, "ys": some})
    errors = numbers(np.where(count > 1, spread, np.nan)) if len(values) > 1 else None
    marks = {"look": "mean", "hue": hue, "x": places, "y": numbers(mean), "e": errors, "short": name}
    series.append(marks if is_repeated else marks | {"name": name})
    if np.any(count < len(values)):
        lost = x[count < len(values)]
        series.append({"look": "lost", "hue": hue, "x": numbers(lost), "y": [0.0] * len(lost),
                       "name": "frames not measured"})  # fmt: skip
    return series
