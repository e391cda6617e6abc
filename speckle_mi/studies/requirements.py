"""What a sensor must do: limits on figures, read from a TOML file.

A table a figure, named as :mod:`.figures` names them, with ``at_most``, ``at_least`` or both:

    rank_by = "crosstalk.z"      # what those that meet the requirement are ranked by; unless given, this
    ["crosstalk.z"]
    at_most = 0.1
    [ry.u]
    at_least = 1.8
    at_most = 2.2
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .figures import Figure, FigureName, figure_named
from .tolerances import flat, read_toml, says_something

LIMITS = ("at_most", "at_least")
MEETS, OPEN, FAILS = "meets", "open", "fails"
"""Verdicts: an interval that a limit lies in leaves it open."""

RANKED_BY = "crosstalk.z"

LARGER_IS_BETTER = {"least", "decorrelation", "clearance"}
"""Kinds of figures of which more is better; of sensitivities too, unless they are cross-talk."""


@dataclass(frozen=True)
class Requirement:
    """One figure between limits."""

    figure: FigureName
    at_least: float = -math.inf
    at_most: float = math.inf

    def verdict(self, found: Figure) -> str:
        """Whether a figure keeps to the limits: by theory where there is theory, else by its interval."""
        value, (low, high) = found.best, found.interval
        if math.isfinite(found.theory) or not math.isfinite(low):
            low = high = value
        if math.isnan(value) or low > self.at_most or high < self.at_least:
            return FAILS
        return MEETS if self.at_least <= low and high <= self.at_most else OPEN

    def shortfall(self, value: float) -> float:
        """By how much of the limit a value is beyond it, 0 where it keeps to both."""
        if math.isnan(value):
            return math.inf
        over = (value - self.at_most) / max(abs(self.at_most), 1e-12) if value > self.at_most else 0.0
        under = (self.at_least - value) / max(abs(self.at_least), 1e-12) if value < self.at_least else 0.0
        return max(over, under)

    @property
    def text(self) -> str:
        """In words."""
        least = [f"at least {self.at_least:g}"] if math.isfinite(self.at_least) else []
        most = [f"at most {self.at_most:g}"] if math.isfinite(self.at_most) else []
        return f"{self.figure.text} {' and '.join(least + most)} {self.figure.unit}".rstrip()


@dataclass(frozen=True)
class Requirements:
    """All that is asked for, and what is ranked by."""

    limits: tuple[Requirement, ...]
    rank_by: FigureName


def read_requirements(path: str | None, detectors: Sequence[str]) -> Requirements:
    """The requirements in a file, none without. Raises InputError, OSError."""
    content = {} if path is None else read_toml(path)
    ranked = content.pop("rank_by", RANKED_BY)
    if not isinstance(ranked, str):
        raise InputError(f"{path}: rank_by = {ranked!r}: must be the name of a figure, such as {RANKED_BY!r}")
    limits = limits_of(content, detectors, f"{path}: ")
    if path is not None and not limits:
        raise InputError(f"{path}: asks for nothing, must have a table a figure, such as ['crosstalk.z'] at_most = 0.1")
    return Requirements(limits, figure_named(ranked, detectors, f"{path}: rank_by {ranked}"))


def limits_of(tables: Mapping, detectors: Sequence[str], where: str) -> tuple[Requirement, ...]:
    """Limits by figure, as a file has them. Raises InputError."""
    return tuple(
        _requirement(f"{where}[{name}]", name, table, detectors) for name, table in flat(tables, says_something).items()
    )


def _requirement(where: str, name: str, table: object, detectors: Sequence[str]) -> Requirement:
    figure = figure_named(name, detectors, where)
    if not isinstance(table, dict) or not table or not table.keys() <= {*LIMITS}:
        said = ", ".join(table) if isinstance(table, dict) and table else repr(table)
        raise InputError(f"{where}: says {said}, must say {' or '.join(LIMITS)}")
    for limit, value in table.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise InputError(f"{where}: {limit} = {value!r}: must be a number")
    made = Requirement(figure, **{limit: float(value) for limit, value in table.items()})
    if made.at_least > made.at_most:
        raise InputError(f"{where}: at_least = {made.at_least:g} is above at_most = {made.at_most:g}: nothing meets it")
    if made.at_most < 0:
        raise InputError(f"{where}: at_most = {made.at_most:g}: figures are sizes, nothing is below 0")
    return made


def smaller_is_better(figure: FigureName) -> bool:
    """Whether less of a figure is better."""
    return figure.kind not in LARGER_IS_BETTER and figure.kind != "entry"


def in_order(values: Sequence[float], figure: FigureName) -> np.ndarray:
    """Numbers of values from best to worst; what is not known comes last."""
    values = np.asarray(values, dtype=np.float64)
    return np.argsort(
        np.where(np.isnan(values), np.inf, values if smaller_is_better(figure) else -values), kind="stable"
    )
