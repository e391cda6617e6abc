"""Assemblies side by side: the same surfaces, the same figures, which meet a requirement, and their order."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..experiments.jobs import Job, Work
from ..experiments.one_frame import RANGE, SURFACES
from .design import Design
from .evaluation import Asked, Evaluation, Evaluator, Variants
from .figures import Figure, Figures, figure_named
from .requirements import FAILS, MEETS, OPEN, Requirements, in_order, read_requirements
from .together import ALONE, Hands

ALIKE = 0.1
"""Relative difference up to which assemblies are said to be alike."""

USES = {
    "translation in the surface's plane": "crosstalk.z",
    "translation out of it": "least.z",
    "tilt": "least.rx+ry",
    "rotation in the plane": "least.rz",
}
"""What a sensor may be for, and the figure that tells how good it is at it."""

TABLES = {
    "Table 1, translations": ("x.x", "y.y", "z.x"),
    "Table 2, rotations": ("rx.y", "ry.x", "rz.y"),
}
"""The sensitivities that the paper's tables hold, on the target's axes."""

GENERAL = ("crosstalk.z", "least.x+y", "condition.x+y", "resolution.x", "decorrelation.x", "least.rx+ry", "seconds")
"""Figures that are told of any assembly."""


@dataclass(frozen=True)
class Swept:
    """One number that goes through evenly spaced values."""

    name: str
    values: tuple[float, ...]

    @classmethod
    def parse(cls, name: str, text: str) -> Swept | None:
        """From ``20:50:7``, first, last and how many; None where it is no such text. Raises InputError."""
        parts = text.split(":")
        if len(parts) < 2 or not _is_number(parts[0]):  # as in a path
            return None
        if len(parts) != 3 or not _is_number(parts[1]) or not parts[2].isdigit():
            raise InputError(f"-D {name}={text}: must be first:last:count, such as {name}=20:50:7")
        first, last, count = float(parts[0]), float(parts[1]), int(parts[2])
        if not (np.isfinite([first, last]).all() and first != last and 2 <= count <= 1000):
            raise InputError(f"-D {name}={text}: must go from one number to another in 2 to 1000 values")
        return cls(name, tuple(np.linspace(first, last, count).tolist()))


@dataclass(frozen=True)
class DesignCandidate:
    """One assembly: the scene's name, and what is changed in it."""

    scene: str
    design: Design
    values: tuple[tuple[str, float], ...] = ()

    @property
    def name(self) -> str:
        """In tables."""
        changed = ", ".join(f"{name} {value:g}" for name, value in self.values)
        return f"{self.scene} {changed}".rstrip()


@dataclass(frozen=True)
class Compared:
    """A candidate with its figures by name, a verdict for each limit, its rank from 1, and why there is nothing of it.

    shared: whether it is not told apart from the one that ranks before it.
    """

    candidate: DesignCandidate
    figures: dict[str, Figure]
    verdicts: tuple[str, ...]
    rank: int
    shared: bool
    failed: str = ""

    @property
    def verdict(self) -> str:
        """Of all limits together."""
        if self.failed or FAILS in self.verdicts:
            return FAILS
        return OPEN if OPEN in self.verdicts else MEETS


@dataclass(frozen=True)
class Conclusion:
    """What is best for one use: candidates' numbers from best to worst, how many of the first are alike, whether all
    are, and whether frames tell those from the next."""

    use: str
    figure: str
    order: tuple[int, ...]
    best: int
    alike: bool
    is_clear: bool


@dataclass(frozen=True)
class DesignComparison:
    """compared: in the order that they were given in; conclusions: of every use that all tell something of;
    evaluations: what was found of each."""

    requirements: Requirements
    compared: list[Compared]
    conclusions: list[Conclusion]
    evaluations: list[Evaluation]
    swept: tuple[Swept, ...]
    detectors: list[str]

    @property
    def in_order(self) -> list[Compared]:
        """From first to last."""
        return sorted(self.compared, key=lambda one: one.rank)


def candidates_of(designs: Mapping[str, Design], swept: Sequence[Swept] = ()) -> list[DesignCandidate]:
    """Every scene with every combination of the swept values. Raises InputError for names that a scene has not."""
    for name, design in designs.items():
        design.require([one.name for one in swept], f"-D, {name}: ")
    grid = list(itertools.product(*[[(one.name, value) for value in one.values] for one in swept]))
    return [DesignCandidate(name, design, values) for name, design in designs.items() for values in grid]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def scene_names(paths: Sequence[str]) -> list[str]:
    """What scenes are called: their files' names, with their folders where these are alike."""
    stems = [Path(path).stem for path in paths]
    return [stem if stems.count(stem) == 1 else str(Path(path).with_suffix("")) for stem, path in zip(stems, paths)]


class ComparisonStudy:
    """Compares candidates on the same surfaces."""

    def __init__(
        self, candidates: Sequence[DesignCandidate], requirements: str | None = None, surfaces: int = SURFACES,
        width: float = RANGE, swept: Sequence[Swept] = (), hands: Hands = ALONE,
    ) -> None:  # fmt: skip
        """requirements: path of a file; surfaces, width: as of ``sensitivity``. Raises InputError."""
        self._candidates, self._surfaces, self._width, self._swept = list(candidates), surfaces, width, tuple(swept)
        self._hands = hands
        held = {one.scene: one.design.assemblies({}) for one in candidates}
        self.detectors = list(next(iter(held.values())))
        if any(len(one) != len(self.detectors) for one in held.values()):
            counts = ", ".join(f"{name} {len(one)}" for name, one in held.items())
            raise InputError(f"scenes of different numbers of detectors ({counts}): choose one by --detector")
        self.requirements = read_requirements(requirements, self.detectors)
        self._first = {name: next(iter(one.values())) for name, one in held.items()}
        named = [*GENERAL, *(name for part in TABLES.values() for name in part), *USES.values()]
        if len(self.detectors) > 1:
            named = [*named[: len(GENERAL)], *USES.values()]
        self._names = {name: figure_named(name, self.detectors, name) for name in named}
        for one in (*(limit.figure for limit in self.requirements.limits), self.requirements.rank_by):
            self._names[one.text] = one

    def _asked(self, candidate: DesignCandidate) -> Asked:
        first = self._first[candidate.scene]
        count = self._surfaces if first.target.points is None else 1
        return Asked(candidate.values, tuple(range(first.seed, first.seed + count)))

    def result(self, advance: Callable[[], None] = lambda: None) -> DesignComparison:
        """Evaluates all candidates. Raises InputError where none of them can be, LeftToOthers."""
        works = {name: Work(Evaluator, Variants(design, pixels=None)) for name, design in self._designs()}
        jobs = [Job(works[one.scene], self._asked(one)) for one in self._candidates]
        evaluations = self._hands.evaluated(jobs, advance, shared=True)
        if all(one.failed for one in evaluations):
            raise InputError(f"none of {len(jobs)} assemblies can be, the first: {evaluations[0].failed}")
        figures = [self._figures(one) for one in evaluations]
        return DesignComparison(
            self.requirements,
            self._ranked(evaluations, figures),
            _conclusions(figures),
            evaluations,
            self._swept,
            self.detectors,
        )

    def _designs(self) -> Iterator[tuple[str, Design]]:
        return iter({one.scene: one.design for one in self._candidates}.items())

    def _figures(self, found: Evaluation) -> dict[str, Figure]:
        if found.failed:
            nothing = (np.nan, np.nan)
            return {text: Figure(name, np.nan, nothing, np.nan, np.empty(0)) for text, name in self._names.items()}
        every = Figures(found, self._width)
        return {text: every.of(name) for text, name in self._names.items()}

    def _ranked(self, evaluations: list[Evaluation], figures: list[dict[str, Figure]]) -> list[Compared]:
        """Those that meet the requirement first, then those that may, each by the figure that is ranked by."""
        by, limits = self.requirements.rank_by, self.requirements.limits
        verdicts = [tuple(limit.verdict(one[limit.figure.text]) for limit in limits) for one in figures]
        classes = [FAILS if found.failed or FAILS in one else OPEN if OPEN in one else MEETS
                   for found, one in zip(evaluations, verdicts, strict=True)]  # fmt: skip
        order = [
            int(number)
            for wanted in (MEETS, OPEN, FAILS)
            for number in in_order([one[by.text].best for one in figures], by)
            if classes[number] == wanted
        ]
        found = []
        for number, candidate in enumerate(self._candidates):
            rank = order.index(number)
            before = order[rank - 1] if rank else None
            shared = (
                before is not None
                and classes[before] == classes[number]
                and not _told_apart(figures[before][by.text], figures[number][by.text])
            )
            failed = evaluations[number].failed
            found.append(Compared(candidate, figures[number], verdicts[number], rank + 1, shared, failed))
        return found


def compare_scenes(
    scenes: Sequence[str], requirements: str | None = None, surfaces: int = SURFACES, **defaults: object
) -> DesignComparison:
    """Scenes side by side, all in this process.

    scenes: paths; requirements: path of a file; defaults: values of the scenes' ``<default>``s. Raises SceneError,
    InputError, OSError.
    """
    values = [(name, str(value)) for name, value in defaults.items()]
    designs = {name: Design.of(path, values) for name, path in zip(scene_names(scenes), scenes, strict=True)}
    return ComparisonStudy(candidates_of(designs), requirements, surfaces).result()


def _told_apart(one: Figure, other: Figure) -> bool:
    if np.isfinite(one.theory) and np.isfinite(other.theory):
        return abs(one.theory - other.theory) > 1e-6 * max(abs(one.theory), abs(other.theory))
    if one.pseudo.size != other.pseudo.size or one.pseudo.size < 2:
        return one.best != other.best
    low, high = one.difference(other)
    return low > 0 or high < 0


def _conclusions(figures: list[dict[str, Figure]]) -> list[Conclusion]:
    found = []
    for use, text in USES.items():
        values = np.array([one[text].best for one in figures])
        if len(values) < 2 or np.any(np.isnan(values)):
            continue
        order = in_order(values, figures[0][text].name)
        ordered = values[order]
        alike = np.abs(ordered - ordered[0]) <= ALIKE * np.maximum(np.abs(ordered), abs(ordered[0]))
        best = int(np.argmin(alike)) or len(order)
        told = best < len(order) and all(
            _apart_by_frames(figures[number][text], figures[order[best]][text]) for number in order[:best]
        )
        found.append(Conclusion(use, text, tuple(map(int, order)), best, best == len(order), told))
    return found


def _apart_by_frames(one: Figure, other: Figure) -> bool:
    """Whether what was measured tells them apart, on the surfaces that they share."""
    if one.pseudo.size != other.pseudo.size or one.pseudo.size < 2:
        return _told_apart(one, other)
    low, high = one.difference(other)
    return low > 0 or high < 0
