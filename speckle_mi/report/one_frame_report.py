"""What sensitivities from one frame leave behind: a JSON file with the names of a sweep's summary, and two tables."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..experiments import published as paper
from ..experiments.expectation import expected_by_way
from ..experiments.one_frame import OneFrameSensitivity
from ..field.simulation import Simulation
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, sensitivity_unit, unit_of
from ..machine.system import system_information
from ..measurement.observability import Observability, observability
from .console import foot_lines, number, sensitivity_table
from .pose_report import observability_to_json, print_observability
from .sweep_report import SHARED, paper_comparison
from .terminal import print_table, terminal


def summarise_one_frame(simulation: Simulation, found: OneFrameSensitivity) -> dict:
    """Everything that was found, under the names of a sweep's summary.json.

    ``fits`` is for the tables only. ``decorrelation_length`` [mm or deg] is the displacement at which correlation has
    fallen to one half, ``scatter`` [mm/mm or mm/deg] what one surface's sensitivity differs from the mean by.
    """
    assembly, plan, result = simulation.assembly, simulation.plan(Pose()), found.result
    published = paper.published_assembly(assembly)
    return {
        "axes": {"u": assembly.detector.u.tolist(), "v": assembly.detector.v.tolist()},
        "axes_as_seen": {"u": found.seen.u.tolist(), "v": found.seen.v.tolist()},
        "target_axes": {name: assembly.target.frame.axes[:, k].tolist() for k, name in enumerate("xyz")},
        "pixel_pitch": assembly.detector.pitch,
        "plan": list(plan.lines),
        "seeds": result.seeds,
        "pixels": result.pixels,
        "speckles": result.speckles,
        "sensitivity": {
            dof: {axis: fit.to_json() for axis, fit in fitted.items()} for dof, fitted in found.fits.items()
        },
        "theory_by_way": _theory_by_way(simulation, list(found.fits)),
        "scatter": found.scatter,
        "boiling": found.boiling,
        "decorrelation_length": found.decorrelation_length,
        "paper": None if published is None else paper_comparison(published, found.fits),
        "warnings": [*plan.warnings, *([found.seen.note] if found.seen.note else [])],
        "seconds": result.seconds,
        "system": system_information(),
        "fits": found.fits,
    }


def _theory_by_way(simulation: Simulation, dofs: list[str]) -> dict | None:
    """sensitivity[dof][axis] that theory expects of each way's light alone; None where there are not several."""
    plan = simulation.plan(Pose())
    if len(plan.channels) < 2:
        return None
    return {
        way: {
            dof: {
                axis: None if values is None else float(values[DEGREES_OF_FREEDOM.index(dof)])
                for axis, values in expected.items()
            }
            for dof in dofs
        }
        for way, expected in expected_by_way(simulation.assembly, plan).items()
    }


def together(summaries: Mapping[str, dict], dofs: tuple[str, ...], width: float) -> dict:
    """What is written of one or several detectors: of several each one's under ``detectors``, and ``observability``.

    ``observability`` is what their shifts together tell apart, for displacements of half a range of ``width`` [mm or
    deg]: singular values [mm], condition number and the combinations of motions that none of them sees.
    """
    plain = {
        detector: {name: value for name, value in summary.items() if name != "fits"}
        for detector, summary in summaries.items()
    }
    if len(plain) == 1:
        return next(iter(plain.values()))
    first = next(iter(plain.values()))
    seen = _seen(summaries, dofs, width)
    return {name: first[name] for name in SHARED if name in first} | {
        "observability": None if seen is None else observability_to_json(dofs, seen),
        "detectors": plain,
    }


def print_together(summaries: Mapping[str, dict], dofs: tuple[str, ...], width: float) -> None:
    """Prints what was found of each detector, and of several what they tell apart together."""
    for detector, summary in summaries.items():
        if len(summaries) > 1:
            terminal().print(f"detector {detector}")
        print_one_frame(summary)
    if len(summaries) > 1 and (seen := _seen(summaries, dofs, width)) is not None:
        terminal().print(f"all {len(summaries)} detectors together:")
        print_observability(dofs, seen)


def _seen(summaries: Mapping[str, dict], dofs: tuple[str, ...], width: float) -> Observability | None:
    """None where a sensitivity is not known."""
    matrix = np.array([[one["fits"][dof][axis].value for dof in dofs] for one in summaries.values() for axis in "uv"])
    return observability(matrix, np.full(len(dofs), width / 2)) if np.all(np.isfinite(matrix)) else None


def print_one_frame(summary: dict) -> None:
    """Prints the plan, both tables, and how each motion makes the pattern boil."""
    console = terminal()
    for line in summary["plan"]:
        console.print(f"plan: {line}")
    tables = [("On the detector", ("u", "v")), ("Projected on the target's axes", ("x", "y"))]
    for title, axes in tables:
        heads, rows = sensitivity_table(axes, summary)
        print_table(console, heads, rows, title=title, left=(0, 1))
    rows = []
    for dof, length in summary["decorrelation_length"].items():
        spread = " / ".join(number(summary["scatter"][dof][axis], "{:.4f}") for axis in ("u", "v"))
        rows.append([dof, sensitivity_unit(dof), spread, f"{summary['boiling'][dof]:.2%}", _length(length, dof)])
    heads = ["motion", "unit", "scatter of one surface, u / v", "boiling", "correlation 1/2 after"]
    print_table(console, heads, rows, title="How the pattern changes", left=(0, 1))
    for line in foot_lines(summary["fits"], [axis for _, axes in tables for axis in axes]):
        console.print(line)
    console.print(
        f"{len(summary['seeds'])} surfaces, {summary['pixels']} pixels of about {summary['speckles']:.0f} speckles, "
        f"{summary['seconds']:.2f} s"
    )
    for warning in summary["warnings"]:
        console.print(f"warning: {warning}")
    for dof, note in ((summary["paper"] or {}).get("notes") or {}).items():
        console.print(f"paper, {dof}: {note}")


def _length(length: float, dof: str) -> str:
    return f"{length:.3g} {unit_of(dof)}" if math.isfinite(length) else "-"
