"""What a sweep leaves behind: sweep.csv, summary.json, plots, and a table to read."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from itertools import zip_longest
from pathlib import Path

import numpy as np

from ..experiments import published as paper
from ..experiments.expectation import AXES, CENTRE_AXES, PATTERN_AXES, expected_correlation, expected_sensitivity
from ..experiments.sweep_result import FrameRecord, SweepResult, SweepSettings
from ..field.simulation import plan_of
from ..geometry.pose import DEGREES_OF_FREEDOM, sensitivity_unit, unit_of
from ..machine.files import for_part, write_csv, write_json
from ..machine.system import system_information
from ..measurement.resolution import resolution_of
from ..measurement.sensitivity import Sensitivity, fit_sensitivity
from ..plan.plan import Plan
from ..plan.stage import Stage
from ..scene.assembly import Assembly
from .console import print_report
from .plots import plot_decorrelation, plot_shifts, plot_speckle
from .terminal import terminal

_CURVE_POINTS = 101

DRAWN = ("fits", "curves")
"""What a summary has for tables and drawings only."""

SHARED = ("scene", "defaults", "identity", "system", "seconds_total", "seconds_by_stage")
"""What a summary of several detectors says once besides: it is the same for all."""


def write_table(path: str | os.PathLike, records: Mapping[str, Sequence[FrameRecord]]) -> None:
    """Writes a row a frame; of several detectors one for each, named in a column ``detector``.

    Numbers that were not measured are empty.
    """
    names = [column.name for column in fields(FrameRecord)]
    several = len(records) > 1
    frames = zip_longest(*records.values())  # an interrupted sweep has more of the first detectors
    rows = (
        ({"detector": detector} if several else {})
        | {name: None if _is_nan(value) else value for name, value in asdict(record).items()}
        for frame in frames
        for detector, record in zip(records, frame, strict=True)
        if record is not None
    )
    write_csv(path, [*(["detector"] if several else []), *names], rows)


def together(summaries: Mapping[str, dict]) -> dict:
    """The summary without what only the plots need: the only detector's, or under ``detectors`` each one's."""
    plain = {
        detector: {name: value for name, value in summary.items() if name not in DRAWN}
        for detector, summary in summaries.items()
    }
    first = next(iter(plain.values()))
    shared = {name: first[name] for name in SHARED if name in first}
    return first if len(plain) == 1 else shared | {"detectors": plain}


def write_summary(path: str | os.PathLike, summaries: Mapping[str, dict]) -> None:
    """Writes summary.json."""
    write_json(path, together(summaries))


def print_summaries(summaries: Mapping[str, dict]) -> None:
    """Prints the report of each detector."""
    for detector, summary in summaries.items():
        if len(summaries) > 1:
            terminal().print(f"detector {detector}")
        print_report(summary)


def summarise(assembly: Assembly, settings: SweepSettings, result: SweepResult) -> dict:
    """Sensitivities of every motion along every axis, with theory, the paper's figures and the errors kept apart."""
    grid, plan = assembly.detector, plan_of(assembly)
    fits = fits_of(assembly, settings, result, plan)
    published = paper.published_assembly(assembly)
    frames = [record.seconds for record in result.records if not _is_nan(record.seconds)]
    lost = sum(record.status != "ok" for record in result.records)
    return {
        "axes": {"u": grid.u.tolist(), "v": grid.v.tolist()},
        "axes_as_seen": result.axes_as_seen,
        "target_axes": {name: assembly.target.frame.axes[:, k].tolist() for k, name in enumerate("xyz")},
        "plan": [str(Stage.from_json(stage)) for stage in result.stages],
        "stages": result.stages,
        "frames": len(result.records),
        "frames_without_shift": lost,
        "seconds_per_frame": float(np.median(frames)) if frames else math.nan,
        "numerical_error": result.numerical_error,
        "sensitivity": {dof: {axis: fit.to_json() for axis, fit in fitted.items()} for dof, fitted in fits.items()},
        "resolution": {dof: _resolution(settings, result, dof, fitted) for dof, fitted in fits.items()},
        "decorrelation": {dof: _decorrelation(assembly, settings, result, dof, plan) for dof in settings.dofs},
        "paper": None if published is None else paper_comparison(published, fits),
        "warnings": result.warnings,
        "system": system_information(),
        "fits": fits,
        "curves": _correlation_curves(assembly, settings, plan),
    }


def write_plots(
    folder: Path, assembly: Assembly, settings: SweepSettings, result: SweepResult, summary: dict,
    detector: str | None = None,
) -> None:  # fmt: skip
    """Writes the speckle image, the decorrelation curves and, for every motion, the shifts along its main axes.

    detector: its name, where it is one of several.
    """

    def place(name: str) -> Path:
        return folder / name if detector is None else for_part(folder / name, detector)

    plot_speckle(
        place("speckle.png"), result.example, assembly.detector.pitch, f"Surface {settings.seeds[0]} at rest"
    )
    plot_decorrelation(
        place("decorrelation.png"),
        {dof: settings.displacements for dof in settings.dofs},
        {dof: result.values(dof, "ncc", settings) for dof in settings.dofs},
        summary["curves"],
    )
    for dof, fitted in summary["fits"].items():
        for axis in _axes_to_plot(fitted):
            plot_shifts(
                place(f"shift_{dof}_{axis}.png"), settings.displacements,
                result.values(dof, _column(axis), settings), fitted[axis].theory, fitted[axis], dof, axis,
            )


def fits_of(
    assembly: Assembly, settings: SweepSettings, result: SweepResult, plan: Plan
) -> dict[str, dict[str, Sensitivity]]:
    """By motion and axis, the sensitivities that a sweep has measured, beside theory."""
    expected = expected_sensitivity(assembly, plan)
    fits: dict[str, dict[str, Sensitivity]] = {}
    for dof in settings.dofs:
        column = DEGREES_OF_FREEDOM.index(dof)
        ncc = result.values(dof, "ncc", settings)
        sigma = np.hypot(*(result.values(dof, f"sigma_{axis}_um", settings) for axis in "uv"))
        fits[dof], unit = {}, sensitivity_unit(dof)
        for axis in AXES:
            theory = None if expected[axis] is None else float(expected[axis][column])
            shifts = result.values(dof, _column(axis), settings)
            known = (ncc, sigma) if axis in PATTERN_AXES else (None, None)
            fits[dof][axis] = fit_sensitivity(settings.displacements, shifts, known[0], theory, unit, known[1])
    return fits


def _resolution(settings: SweepSettings, result: SweepResult, dof: str, fitted: dict[str, Sensitivity]) -> dict:
    """By axis of the detector, and the smallest displacement that one of them tells from zero."""
    found = {
        axis: resolution_of(
            settings.displacements, result.values(dof, f"shift_{axis}_um", settings),
            result.values(dof, f"sigma_{axis}_um", settings), fitted[axis].value,
        )
        for axis in "uv"
    }  # fmt: skip
    smallest = [one.smallest for one in found.values() if math.isfinite(one.smallest)]
    axes = {axis: asdict(one) for axis, one in found.items()}
    return axes | {"smallest": min(smallest, default=math.nan), "unit": unit_of(dof)}


def _column(axis: str) -> str:
    return f"{axis}_um" if axis in CENTRE_AXES else f"shift_{axis}_um"


def _decorrelation(assembly: Assembly, settings: SweepSettings, result: SweepResult, dof: str, plan: Plan) -> dict:
    measured = result.values(dof, "ncc", settings)
    counted = np.isfinite(measured).any(axis=0)
    mean = np.full(len(settings.displacements), np.nan)
    mean[counted] = np.nanmean(measured[:, counted], axis=0)
    expected = expected_correlation(assembly, dof, settings.displacements, plan)
    return {
        "displacement": settings.displacements.tolist(),
        "ncc": mean.tolist(),
        "theory": None if expected is None else expected.tolist(),
    }


def _correlation_curves(
    assembly: Assembly, settings: SweepSettings, plan: Plan
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By motion, displacements and the correlation that theory expects there."""
    displacements = np.linspace(settings.displacements.min(), settings.displacements.max(), _CURVE_POINTS)
    curves = {dof: expected_correlation(assembly, dof, displacements, plan) for dof in settings.dofs}
    return {dof: (displacements, curve) for dof, curve in curves.items() if curve is not None}


def _axes_to_plot(fitted: dict[str, Sensitivity]) -> list[str]:
    """The detector's two axes, and those of the centre of gravity where theory says something about it."""
    return ["u", "v", *(axis for axis in CENTRE_AXES if fitted[axis].theory is not None)]


def paper_comparison(published: paper.PublishedAssembly, fits: dict[str, dict[str, Sensitivity]]) -> dict:
    figures = {
        dof: {
            "axis": axis,
            "paper": value,
            "simulated": abs(fits[dof][axis].value),
            "theory": None if fits[dof][axis].theory is None else abs(fits[dof][axis].theory),
            "unit": sensitivity_unit(dof),
        }
        for dof, (axis, value) in published.figures.items()
        if dof in fits
    }
    notes = {dof: paper.DOUBTFUL[published.name, dof] for dof in figures if (published.name, dof) in paper.DOUBTFUL}
    return {"assembly": published.name, "figures": figures, "notes": notes}


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)
