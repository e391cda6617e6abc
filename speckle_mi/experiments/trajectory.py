"""The target's motion in time: samples from a file, or sines, ramps and spins."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation, unit_of

TIME = "time_s"
"""Column of a file's times [s]."""

_SAME_TIME = 1e-9
"""Part of the time between two samples within which a moment is one of them."""


@dataclass(frozen=True)
class SampledMotion:
    """Poses at times, straight lines between; times: (n,) [s], rising; values: (n, 6) [mm, deg] in the order of the
    motions. Before the first and after the last time there is no motion to speak of: InputError."""

    times: np.ndarray
    values: np.ndarray

    @property
    def begin(self) -> float:
        return float(self.times[0])

    @property
    def end(self) -> float:
        return float(self.times[-1])

    def at(self, time: float) -> Pose:
        """The pose at a time [s]: that of a sample exactly where it is one's."""
        place = int(np.clip(np.searchsorted(self.times, time), 1, max(len(self.times) - 1, 1)))
        step = float(np.diff(self.times).min(initial=np.inf))
        for near in range(max(place - 1, 0), min(place + 1, len(self.times))):
            if abs(time - self.times[near]) <= _SAME_TIME * min(step, 1.0):
                return Pose(*map(float, self.values[near]))
        if not self.begin <= time <= self.end:
            raise InputError(f"time {time:g} s: must be from {self.begin:g} to {self.end:g} s, as the motion's samples")
        return Pose(*(float(np.interp(time, self.times, column)) for column in self.values.T))


@dataclass(frozen=True)
class Sine:
    """amplitude [mm or deg], frequency [Hz], phase [deg] of one motion."""

    dof: str
    amplitude: float
    frequency: float
    phase: float = 0.0

    def at(self, time: float) -> float:
        return self.amplitude * math.sin(2 * math.pi * self.frequency * time + math.radians(self.phase))


@dataclass(frozen=True)
class Ramp:
    """speed [mm/s or deg/s] of one motion."""

    dof: str
    speed: float

    def at(self, time: float) -> float:
        return self.speed * time


@dataclass(frozen=True)
class FormulaMotion:
    """A sum of sines and ramps, from the time 0 on without an end."""

    parts: tuple[Sine | Ramp, ...]

    begin = 0.0
    end = math.inf

    def at(self, time: float) -> Pose:
        """The pose at a time [s]."""
        values = dict.fromkeys(DEGREES_OF_FREEDOM, 0.0)
        for part in self.parts:
            values[part.dof] += part.at(time)
        return Pose(**values)


MotionInTime = SampledMotion | FormulaMotion


def formula_of(sines: Sequence[str], ramps: Sequence[str], spins: Sequence[str]) -> FormulaMotion:
    """Motion from texts: sines ``z=0.01,50`` (amplitude, Hz, and perhaps a phase [deg]), ramps ``x=0.1`` (mm/s, deg/s),
    spins ``rz=600`` (turns a minute). Raises InputError."""
    parts: list[Sine | Ramp] = []
    for text in sines:
        dof, values = _named(text, "--sine", "z=0.01,50 (amplitude, Hz)", (2, 3))
        if values[1] < 0:
            raise InputError(f"--sine {text!r}: the frequency {values[1]:g} Hz must not be negative")
        parts.append(Sine(dof, *values))
    for text in ramps:
        dof, values = _named(text, "--ramp", "x=0.1 (mm or deg a second)", (1,))
        parts.append(Ramp(dof, *values))
    for text in spins:
        dof, values = _named(text, "--spin", "rz=600 (turns a minute)", (1,))
        if not is_rotation(dof):
            raise InputError(f"--spin {text!r}: {dof} is no rotation, must be one of rx, ry, rz")
        parts.append(Ramp(dof, 6 * values[0]))
    return FormulaMotion(tuple(parts))


def _named(text: str, flag: str, example: str, counts: tuple[int, ...]) -> tuple[str, list[float]]:
    dof, _, rest = text.partition("=")
    dof = dof.strip()
    if dof not in DEGREES_OF_FREEDOM:
        raise InputError(f"{flag} {text!r}: {dof!r} must be one of {', '.join(DEGREES_OF_FREEDOM)}, as in {example}")
    try:
        values = [float(item) for item in rest.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not all(map(math.isfinite, values)):
        raise InputError(f"{flag} {text!r}: must be finite numbers as in {example}")
    return dof, values


def read_motion(path: str | os.PathLike) -> SampledMotion:
    """Motion from a table with the column ``time_s`` [s] and those of motions, x, y, z [mm], rx, ry, rz [deg].

    Motions that the table has no column for rest. Raises InputError with one line that says what is wrong, OSError.
    """
    with open(path, newline="", encoding="utf-8-sig") as file:
        try:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
        except (csv.Error, UnicodeDecodeError) as error:
            raise InputError(f"{path}: is no table of text ({error})") from None
    names = [name.strip() for name in rows[0]] if rows else []
    if TIME not in names or len(set(names)) != len(names):
        raise InputError(f"{path}: must begin with the names of its columns, {TIME} and each of its motions once")
    for name in names:
        if name not in (TIME, *DEGREES_OF_FREEDOM):
            raise InputError(f"{path}: column {name!r} must be {TIME} or one of {', '.join(DEGREES_OF_FREEDOM)}")
    if len(rows) < 2:
        raise InputError(f"{path}: has no samples, must have a line for each")
    table = np.array([_numbers(path, number, row, names) for number, row in enumerate(rows[1:], 2)])
    times = table[:, names.index(TIME)]
    if np.any(np.diff(times) <= 0):
        first = int(np.argmax(np.diff(times) <= 0)) + 3
        raise InputError(f"{path}: line {first}: {TIME} must rise from line to line")
    values = np.zeros((len(times), len(DEGREES_OF_FREEDOM)))
    for place, dof in enumerate(DEGREES_OF_FREEDOM):
        if dof in names:
            values[:, place] = table[:, names.index(dof)]
    for row in values:
        Pose(*map(float, row))  # raises for places that are too far
    return SampledMotion(times, values)


def _numbers(path: str | os.PathLike, number: int, row: list[str], names: list[str]) -> list[float]:
    if len(row) != len(names):
        raise InputError(f"{path}: line {number}: has {len(row)} cells, must have {len(names)}")
    values = []
    for name, cell in zip(names, row, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            unit = "s" if name == TIME else unit_of(name)
            raise InputError(f"{path}: line {number}: {name} {cell.strip()!r} must be a finite number of {unit}")
        values.append(value)
    return values
