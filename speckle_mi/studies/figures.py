"""Figures that assemblies are compared and made better by, by name, each with its interval.

z.u                 how far the pattern moves along u for a motion along z, its size; of several detectors left.z.u
crosstalk.z.u       the same relative to what is wanted along that axis: the motion x for u and x, y for v and y
crosstalk.z         the shift by a motion relative to the least that one in the surface makes
least.x+y           the least shift that a combination of these motions makes, of size 1 together
condition.x+y       largest over least shift of such a combination: 1 where all are seen alike
resolution.x        displacement that one surface's scatter is mistaken for, over the range of motions
decorrelation.x     displacement at which correlation falls to one half
extent.x            size of the box around the assembly along the world's x, y or z
clearance           least gap between the laser's light and the parts
seconds             run time of one surface
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats

from ..errors import InputError
from ..experiments.expectation import AXES
from ..geometry.pose import DEGREES_OF_FREEDOM, is_rotation, unit_of
from ..measurement.sensitivity import CONFIDENCE
from .entries import entries_of
from .evaluation import Evaluation

WANTED = {"u": "x", "x": "x", "v": "y", "y": "y"}
"""The motion that a shift along an axis is for."""

KINDS = ("crosstalk", "least", "condition", "resolution", "decorrelation", "extent")
PLAIN = ("clearance", "seconds")
EXAMPLES = (
    "z.u, crosstalk.z.u, crosstalk.z, least.x+y, condition.x+y, resolution.x, decorrelation.x, extent.x, clearance, "
    "seconds"
)

_U, _V = AXES.index("u"), AXES.index("v")


@dataclass(frozen=True)
class FigureName:
    """kind: an element of ``KINDS`` or ``PLAIN``, or "entry"; motions: that it is about; axis: along which; detector:
    number of it; text: the whole name."""

    text: str
    kind: str
    motions: tuple[str, ...] = ()
    axis: str = ""
    detector: int = 0

    @property
    def unit(self) -> str:
        """In which it is stated."""
        rotates = bool(self.motions) and is_rotation(self.motions[0])
        if self.kind in ("resolution", "decorrelation"):
            return unit_of(self.motions[0])
        if self.kind in ("extent", "clearance"):
            return "mm"
        if self.kind == "crosstalk":
            return "mm/deg" if rotates else ""
        return {"condition": "", "seconds": "s"}.get(self.kind, "mm/deg" if rotates else "mm/mm")

    @property
    def needs_frames(self) -> bool:
        """Whether theory of the sensitivities does not tell it."""
        return self.kind in ("resolution", "decorrelation")


def figure_named(text: str, detectors: Sequence[str], where: str) -> FigureName:
    """The figure of a name. Raises InputError that begins with ``where`` and lists what there is."""
    for entry in entries_of(detectors):
        if entry.name == text:
            return FigureName(text, "entry", (entry.dof,), entry.axis, entry.detector)
    kind, _, rest = text.partition(".")
    if text in PLAIN:
        return FigureName(text, text)
    parts = rest.split(".")
    if kind == "extent" and rest in ("x", "y", "z"):
        return FigureName(text, kind, (), rest)
    motions = tuple(parts[0].split("+"))
    known = (
        kind in KINDS[:5] and all(one in DEGREES_OF_FREEDOM for one in motions) and len(set(motions)) == len(motions)
    )
    if known and len(parts) == 1 and (len(motions) > 1) <= (kind in ("least", "condition")):
        if len({is_rotation(one) for one in motions}) > 1:
            raise InputError(f"{where}: must be of motions of one kind, translations or rotations")
        return FigureName(text, kind, motions)
    if known and kind == "crosstalk" and len(parts) == 2 and parts[1] in WANTED:
        return FigureName(text, kind, motions, parts[1])
    raise InputError(f"{where}: is no figure, must be one such as {EXAMPLES} (motions {', '.join(DEGREES_OF_FREEDOM)})")


@dataclass(frozen=True)
class Figure:
    """value, its 95 % interval by the scatter over surfaces (NaN where it has none), and what theory expects (NaN where
    there is none); pseudo: (k,) jackknife values, one a surface, by which figures on the same surfaces are compared."""

    name: FigureName
    value: float
    interval: tuple[float, float]
    theory: float
    pseudo: np.ndarray

    @property
    def best(self) -> float:
        """What is known best: theory where there is theory, which is the mean over all surfaces."""
        return self.theory if np.isfinite(self.theory) else self.value

    def difference(self, other: Figure) -> tuple[float, float]:
        """95 % interval of self less other on the same surfaces; (0, 0) where neither has scatter."""
        off = self.pseudo - other.pseudo
        if off.size < 2:
            return (self.value - other.value,) * 2
        half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, off.size - 1) * off.std(ddof=1) / np.sqrt(off.size))
        return float(off.mean()) - half, float(off.mean()) + half


@dataclass(frozen=True)
class _Mean:
    """matrix: (d, 6 axes, 6 motions); spread: (d, 6, 6) standard deviation over surfaces; curvature: (d, 6)."""

    matrix: np.ndarray
    spread: np.ndarray
    curvature: np.ndarray

    @classmethod
    def of(cls, measured: np.ndarray, curvature: np.ndarray) -> _Mean:
        spread = measured.std(axis=0, ddof=1) if len(measured) > 1 else np.full(measured.shape[1:], np.nan)
        return cls(measured.mean(axis=0), spread, curvature.mean(axis=0))


class Figures:
    """All figures of one evaluation, for motions over a range of ``width`` [mm or deg]."""

    def __init__(self, found: Evaluation, width: float) -> None:
        self._found, self._width = found, width

    @cached_property
    def _means(self) -> tuple[_Mean, list[_Mean]]:
        """Of all surfaces, and of all but each one."""
        measured, curvature = self._found.measured, self._found.curvature
        count = len(measured)
        less = [np.delete(np.arange(count), one) for one in range(count)] if count > 1 else []
        return _Mean.of(measured, curvature), [_Mean.of(measured[kept], curvature[kept]) for kept in less]

    def of(self, name: FigureName) -> Figure:
        """One figure."""
        found = self._found
        if name.kind in ("extent", *PLAIN):
            fixed = {"clearance": found.clearance, "seconds": found.seconds}
            value = found.extent["xyz".index(name.axis)] if name.kind == "extent" else fixed[name.kind]
            exact = np.nan if name.kind == "seconds" else value
            return Figure(name, float(value), (float(exact),) * 2, float(exact), np.empty(0))
        theory = np.nan
        if not name.needs_frames:
            theory = self._value(
                name, _Mean(found.theory, found.theory * np.nan, np.full(found.theory.shape[::2], np.nan))
            )
        if not len(found.measured):
            return Figure(name, theory, (np.nan, np.nan), theory, np.empty(0))
        whole, less = self._means
        value = self._value(name, whole)
        count = len(less)
        if count < 3:  # the spread of those that are left is needed
            return Figure(name, value, (np.nan, np.nan), theory, np.empty(0))
        pseudo = count * value - (count - 1) * np.array([self._value(name, one) for one in less])
        half = stats.t.ppf(0.5 + CONFIDENCE / 2, count - 1) * pseudo.std(ddof=1) / np.sqrt(count)
        half = float(np.hypot(half, self._common(name, whole, value)))
        # Sizes are not below 0, and no condition below 1, however far the surfaces scatter.
        low = max(value - half, 1.0 if name.kind == "condition" else 0.0)
        return Figure(name, value, (low, value + half), theory, pseudo)

    def _common(self, name: FigureName, mean: _Mean, value: float) -> float:
        """Half width by what is common to all surfaces: that of every entry, carried to the figure."""
        if name.needs_frames:
            return 0.0
        changes = []
        for place in zip(*np.nonzero(self._found.doubt), strict=True):
            matrix = mean.matrix.copy()
            matrix[place] += self._found.doubt[place]
            changes.append(self._value(name, replace(mean, matrix=matrix)) - value)
        return float(np.linalg.norm(changes)) if np.all(np.isfinite(changes)) else 0.0

    def _value(self, name: FigureName, mean: _Mean) -> float:
        columns = [DEGREES_OF_FREEDOM.index(one) for one in name.motions]
        shifts = mean.matrix[:, [_U, _V]][:, :, columns].reshape(-1, len(columns))
        if name.kind == "entry" or name.axis:
            size = abs(float(mean.matrix[name.detector, AXES.index(name.axis), columns[0]]))
            if name.kind == "entry":
                return size
            wanted = DEGREES_OF_FREEDOM.index(WANTED[name.axis])
            return _over(size, abs(float(mean.matrix[name.detector, AXES.index(name.axis), wanted])))
        if name.kind == "decorrelation":
            return float(np.sqrt(np.log(2) / np.maximum(mean.curvature[:, columns[0]].max(), 1e-300)))
        if not np.all(np.isfinite(shifts)):
            return np.nan
        if name.kind == "crosstalk":
            in_surface = mean.matrix[:, [_U, _V], :2].reshape(-1, 2)
            if not np.all(np.isfinite(in_surface)):
                return np.nan
            return _over(float(np.linalg.norm(shifts)), float(np.linalg.svd(in_surface, compute_uv=False)[-1]))
        if name.kind == "resolution":
            noise = mean.spread[:, [_U, _V]][:, :, columns].reshape(-1) * self._width / np.sqrt(12)
            seen = np.abs(shifts[:, 0]) > 0
            return float(1 / np.sqrt(np.sum((shifts[seen, 0] / np.maximum(noise[seen], 1e-300)) ** 2)))
        values = np.linalg.svd(shifts, compute_uv=False)
        least = float(values[-1]) if len(values) == len(columns) else 0.0
        return least if name.kind == "least" else _over(float(values[0]), least)


def _over(one: float, other: float) -> float:
    return one / other if other > 0 else np.inf
