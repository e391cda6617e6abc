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
from ..measurement.observability import MotionEstimate, Observability, estimated_motion
from .terminal import print_table, terminal

AXES, CENTRE_AXES = ("u", "v"), ("cog_u", "cog_v")
SHIFTS = ("shift_u_um", "shift_v_um")
SIGMAS = ("sigma_u_um", "sigma_v_um")
CENTRE_SHIFTS = ("cog_shift_u_um", "cog_shift_v_um")


@dataclass(frozen=True)
class DetectorSensitivity:
    """Sensitivities (2, k) along u, v to k motions and their scatter over surfaces [mm/mm, mm/deg], by a name.

    centre: the same of the light's centre of gravity, None where an aperture does not make it mean something;
    centre_sigma: (2,) by which its shift scatters from surface to surface [mm].
    """

    name: str
    matrix: np.ndarray
    scatter: np.ndarray
    centre: np.ndarray | None = None
    centre_sigma: np.ndarray | None = None


@dataclass(frozen=True)
class Measured:
    """Sensitivities (n, k) [mm/mm, mm/deg], their scatter (n, k) and, of every motion, what was measured (n,) and its
    standard uncertainty (n,) [mm]: shifts of d detectors, two each, then centres of gravity. NaN: not measured."""

    matrix: np.ndarray
    scatter: np.ndarray
    motions: list[tuple[np.ndarray, np.ndarray]]

    def estimates(self, scale: np.ndarray) -> list[MotionEstimate]:
        """Of every motion, from what was measured of it. scale: (k,) as in :func:`observability`."""
        found = []
        for values, sigma in self.motions:
            known = np.isfinite(values)
            found.append(
                estimated_motion(self.matrix[known], self.scatter[known], values[known], sigma[known], scale)
            )
        return found


def read_measured(path: str, detectors: list[DetectorSensitivity]) -> Measured:
    """A table of shifts as the command correlate prints it, with centres of gravity where it has columns for them.

    Its rows are one for each detector, in their order, motion after motion; or a column ``detector`` names each row's.
    Raises InputError where a column or row is missing.
    """
    motions = _motions(path, [one.name for one in detectors])
    matrix, scatter = (np.concatenate([getattr(one, name) for one in detectors]) for name in ("matrix", "scatter"))
    found = [(_values(path, rows, SHIFTS), _values(path, rows, SIGMAS)) for rows in motions]
    centred = [number for number, one in enumerate(detectors) if one.centre is not None]
    if not centred or any(column not in motions[0][0] for column in CENTRE_SHIFTS):
        return _measured(path, matrix, scatter, found)
    centres = [_values(path, [rows[number] for number in centred], CENTRE_SHIFTS) for rows in motions]
    sigma = np.concatenate([detectors[number].centre_sigma for number in centred])
    still = np.zeros((len(sigma), matrix.shape[1]))  # all of the scatter is in the uncertainty
    return _measured(
        path,
        np.concatenate([matrix, *(detectors[number].centre for number in centred)]),
        np.concatenate([scatter, still]),
        [
            (np.concatenate([shift, centre]), np.concatenate([uncertain, sigma]))
            for (shift, uncertain), centre in zip(found, centres, strict=True)
        ],
    )


def _measured(path: str, matrix: np.ndarray, scatter: np.ndarray, motions: list) -> Measured:
    for number, (values, _) in enumerate(motions, start=1):
        if not np.any(np.isfinite(values)):
            raise InputError(f"{path}: of motion {number} no shift was measured (see the column status)")
    return Measured(matrix, scatter, motions)


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
        centre = _centre(entries, dofs)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise _no_summary(path) from None
    return DetectorSensitivity(name, matrix, scatter, *centre)


def _centre(entries: dict, dofs: tuple[str, ...]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Sensitivities of the centre of gravity as theory has them, and how much it scatters over a sweep's surfaces [mm].

    Theory, since what a sweep of small range measures of it is mostly the noise of speckle. None without either.
    """
    found = [[(entries[dof].get(axis) or {}) for dof in dofs] for axis in CENTRE_AXES]
    theory = [[one.get("theory") for one in row] for row in found]
    scatter = [[one.get("scatter_um") for one in row] for row in found]
    if any(value is None for rows in (theory, scatter) for row in rows for value in row):
        return None, None
    return np.array(theory, dtype=float), 1e-3 * np.max(np.array(scatter, dtype=float), axis=1)


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


def _motions(path: str, names: list[str]) -> list[list[dict]]:
    """The rows of a table, those of each motion together in the order of the detectors."""
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
        found.append(group)
    return found


def _values(path: str, rows: list[dict], columns: tuple[str, str]) -> np.ndarray:
    """What two columns say of d detectors, (2d,) [mm]."""
    return 1e-3 * np.array([_number(path, row, column) for row in rows for column in columns])


def _number(path: str, row: dict, column: str) -> float:
    """A cell [um]; NaN of a shift that has a status and no value, which was not measured."""
    text = row.get(column)
    if column in SIGMAS and not text:
        return 0.0
    if not text and row.get("status", "ok") != "ok":
        return math.nan
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
