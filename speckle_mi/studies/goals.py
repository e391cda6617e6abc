"""What an optimisation is for: which figures are to be small or large, and what a design must keep to.

minimise = ["crosstalk.z"]       # figures as `figures` names them; of several goals the best trade-offs are found
maximise = ["least.rx+ry"]
[extent.x]                       # limits, as a requirement has them
at_most = 80
["decorrelation.x"]
at_least = 0.1
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..errors import InputError
from .figures import Figure, FigureName, figure_named
from .requirements import Requirement, limits_of
from .tolerances import read_toml

MOST_GOALS = 4


@dataclass(frozen=True)
class Goal:
    """One figure that is to be small, or large."""

    figure: FigureName
    is_large: bool

    def cost(self, value: float) -> float:
        """What is to be small."""
        return -value if self.is_large else value

    @property
    def text(self) -> str:
        """In words."""
        return f"{'large' if self.is_large else 'small'} {self.figure.text}"


@dataclass(frozen=True)
class Goals:
    """goals: at least one; limits: what every design must keep to."""

    goals: tuple[Goal, ...]
    limits: tuple[Requirement, ...]

    @property
    def figures(self) -> list[FigureName]:
        """All that a design has to be known of."""
        return [*(goal.figure for goal in self.goals), *(limit.figure for limit in self.limits)]

    def costs(self, found: Mapping[str, Figure]) -> tuple[float, ...]:
        """Of every goal."""
        return tuple(goal.cost(found[goal.figure.text].best) for goal in self.goals)

    def violation(self, found: Mapping[str, Figure]) -> float:
        """Sum of what limits are exceeded by, relative to them; 0 where all are kept to."""
        return sum(limit.shortfall(found[limit.figure.text].best) for limit in self.limits)


def read_goals(path: str, detectors: Sequence[str]) -> Goals:
    """The goals in a file. Raises InputError, OSError."""
    return goals_of(read_toml(path), detectors, path)


def goals_of(tables: Mapping, detectors: Sequence[str], path: str = "goal") -> Goals:
    """The same from what such a file holds; path: how messages call it."""
    content, goals = dict(tables), []
    for word, is_large in (("minimise", False), ("maximise", True)):
        names = content.pop(word, [])
        names = [names] if isinstance(names, str) else names
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InputError(f"{path}: {word} = {names!r}: must be a list of figures, such as ['crosstalk.z']")
        goals += [Goal(figure_named(name, detectors, f"{path}: {word} {name}"), is_large) for name in names]
    if not 1 <= len(goals) <= MOST_GOALS:
        raise InputError(
            f"{path}: has {len(goals)} goals, must have 1 to {MOST_GOALS} in 'minimise' and 'maximise', such as "
            "minimise = ['crosstalk.z']"
        )
    twice = [goal.figure.text for goal in goals if [one.figure for one in goals].count(goal.figure) > 1]
    if twice:
        raise InputError(f"{path}: {twice[0]} is two goals, must be one")
    return Goals(tuple(goals), limits_of(content, detectors, f"{path}: "))


@dataclass(frozen=True)
class Free:
    """A number that may be chosen between two values."""

    name: str
    low: float
    high: float


def free_numbers(text: str) -> list[Free]:
    """From ``theta=20:50,detector_distance=40:90``. Raises InputError."""
    found = []
    for item in text.split(","):
        name, separator, bounds = item.partition("=")
        parts = bounds.split(":")
        try:
            low, high = map(float, parts)
        except ValueError:
            low = high = math.nan
        if not separator or not name.strip() or not low < high or math.isinf(high - low):
            raise InputError(f"--free {item!r}: must be name=low:high, such as laser_angle=20:50, several with commas")
        if any(one.name == name.strip() for one in found):
            raise InputError(f"--free {name.strip()}: is given twice, must be given once")
        found.append(Free(name.strip(), low, high))
    return found
