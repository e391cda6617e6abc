"""Motions from shifts: summaries of detectors and tables of shifts read, motions told with their uncertainty."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.pose import unit_of
from ..measurement.observability import MotionEstimate, Observability
from .terminal import print_table, terminal

AXES = ("u", "v")
SHIFTS = ("shift_u_um", "shift_v_um")
SIGMAS = ("sigma_u_um", "sigma_v_um")


@dataclass(frozen=True)
class DetectorSensitivity:
    """Sensitivities (2, k) along u, v to k motions and their scatter over surfaces [mm/mm, mm/deg], by a name."""

    name: str
    matrix: np.ndarray
    scatter: np.ndarray


def read_detectors(path: str, dofs: tuple[str, ...]) -> list[DetectorSensitivity]:
    """From the JSON of the commands sensitivity or sweep: its detector by the file's name, several by their ids.

    Raises InputError where a motion is missing.
    """
    try:
        summary = json.loads(Path(path).read_text(encoding="utf-8"))
        several = dict(summary.get("detectors") or {})
    except (ValueError, TypeError, AttributeError):
        raise _no_summary(path) from None
    return [_detector(path, *one, dofs) for one in (several or {Path(path).stem: summary}).items()]


def _no_summary(path: str) -> InputError:
    return InputError(f"{path}: is no summary with sensitivities, as the command sensitivity writes it")


def _detector(path: str, name: str, summary: dict, dofs: tuple[str, ...]) -> DetectorSensitivity:
    try:
        entries = summary["sensitivity"]
        missing = [dof for dof in dofs if dof not in entries]
        if missing:
            raise InputError(f"{path}: holds no sensitivity to {', '.join(missing)}: leave it out of --dof")
        matrix = np.array([[float(entries[dof][axis]["value"]) for dof in dofs] for axis in AXES])
        scatter = np.array([[_scatter(summary, dof, axis) for dof in dofs] for axis in AXES])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise _no_summary(path) from None
    return DetectorSensitivity(name, matrix, scatter)


def _scatter(summary: dict, dof: str, axis: str) -> float:
    """Of one surface; from a sweep, which states none, what its interval of a mean over surfaces tells."""
    stated = summary.get("scatter", {}).get(dof, {}).get(axis)
    if stated is not None:
        return float(stated)
    low, high = summary["sensitivity"][dof][axis]["ci95"]
    if low is None or high is None:
        return 0.0
    surfaces = len(summary.get("seeds") or summary.get("identity", {}).get("seeds") or [0])
    return (high - low) / 4 * math.sqrt(surfaces)


def read_shifts(path: str, names: list[str]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Shifts and uncertainties (2d,) [mm] of every motion in a table as the command correlate prints it.

    Its rows are one for each detector, in the order of the summaries, motion after motion; or a column ``detector``
    names each row's. Raises InputError where a column or row is missing.
    """
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        raise InputError(f"{path}: holds no shifts, must have a row for each detector")
    for column in SHIFTS:
        if column not in rows[0]:
            raise InputError(f"{path}: has no column {column}, must have {', '.join((*SHIFTS, *SIGMAS))}")
    if len(rows) % len(names):
        raise InputError(f"{path}: has {len(rows)} rows, must have one for each of {len(names)} detectors a motion")
    if "detector" in rows[0] and len(set(names)) != len(names):
        raise InputError(f"{path}: names its rows' detectors, which must have different names: {', '.join(names)}")
    found = []
    for first in range(0, len(rows), len(names)):
        group = rows[first : first + len(names)]
        if "detector" in rows[0]:
            by_name = {row["detector"]: row for row in group}
            if set(by_name) != set(names):
                raise InputError(
                    f"{path}, row {first + 2}: detectors {', '.join(sorted(by_name))}, must be {', '.join(names)}"
                )
            group = [by_name[name] for name in names]
        values = [[_number(path, row, column) for row in group for column in columns] for columns in (SHIFTS, SIGMAS)]
        found.append((1e-3 * np.array(values[0]), 1e-3 * np.array(values[1])))
    return found


def _number(path: str, row: dict, column: str) -> float:
    text = row.get(column)
    if column in SIGMAS and not text:
        return 0.0
    try:
        value = float(text)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}: {column} {text!r} must be a number of um")
    return value


def observability_to_json(dofs: tuple[str, ...], seen: Observability) -> dict:
    """What can be told apart; ``scale`` [mm or deg] are the displacements that singular values [mm] are for."""
    return {
        "dof": list(dofs),
        "scale": dict(zip(dofs, seen.scale.tolist(), strict=True)),
        "singular_values": seen.singular_values.tolist(),
        "condition": seen.condition,
        "unseen": [dict(zip(dofs, row.tolist(), strict=True)) for row in seen.unseen],
    }


def to_json(dofs: tuple[str, ...], seen: Observability, estimates: list[MotionEstimate]) -> dict:
    """Everything that was found."""
    return observability_to_json(dofs, seen) | {
        "motions": [
            {
                "motion": dict(zip(dofs, one.motion.tolist(), strict=True)),
                "sigma": dict(zip(dofs, np.sqrt(np.diag(one.covariance)).tolist(), strict=True)),
                "covariance": one.covariance.tolist(),
                "misfit": one.misfit,
                "freedom": one.freedom,
            }
            for one in estimates
        ],
    }


def print_observability(dofs: tuple[str, ...], seen: Observability) -> None:
    """Prints what can be told apart."""
    console = terminal()
    values = ", ".join(f"{1e3 * value:.3g}" for value in seen.singular_values)
    sizes = ", ".join(f"{dof} {size:g} {unit_of(dof)}" for dof, size in zip(dofs, seen.scale, strict=True))
    condition = f"{seen.condition:.3g}" if math.isfinite(seen.condition) else "infinite"
    console.print(f"singular values {values} um for motions of {sizes}; condition number {condition}")
    for row in seen.unseen:
        parts = [f"{share:+.2f} {dof}" for dof, share in zip(dofs, row, strict=True) if abs(share) >= 0.01]
        console.print(f"not seen: {' '.join(parts)} (in these units)")


def print_motions(dofs: tuple[str, ...], seen: Observability, estimates: list[MotionEstimate]) -> None:
    """Prints what can be told apart, and a row for each motion."""
    print_observability(dofs, seen)
    heads = ["motion", *(f"{dof} ({unit_of(dof)})" for dof in dofs), "misfit / freedom"]
    rows = []
    for number, one in enumerate(estimates, start=1):
        sigma = np.sqrt(np.diag(one.covariance))
        cells = [
            f"{value:+.6f} ± {error:.6f}" if math.isfinite(value) else "not seen"
            for value, error in zip(one.motion, sigma, strict=True)
        ]
        rows.append([str(number), *cells, f"{one.misfit:.2f} / {one.freedom}"])
    print_table(terminal(), heads, rows, title="Motions, with one standard uncertainty")
