"""One call for every propagation: chooses how to do the coherent sum, does it, and measures its error.

The error is measured on a random sample of the target's points against the exact float64 sum; a method that misses the
tolerance there is replaced by a better one rather than believed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import InputError
from ..geometry.plane import PlaneGrid, PlanePoints
from ..machine.cores import products_on_one_thread
from .area import Area, points_at
from .bandlimited import NodeGrid, band_limited_sum, node_grid, reach_of
from .costs import RECORDED, Costs
from .direct import SINGLE_PRECISION, direct_sum, supports
from .interpolated import interpolated
from .lowrank import LARGEST_TABLE, SpotPart, expand_in_parts, low_rank_sum
from .paths import Path
from .reference import Sample, reference_sum
from .runs import Extent
from .source_box import SourceBox

METHODS = ("auto", "direct", "fast")

TIGHTEST = 1e-7
"""Tolerance of ``direct`` for a path without closed form."""

EXPANSION_SECONDS = 0.03
"""What finding an expansion costs at least: not tried where the sum without it takes less."""

TABLE_SECONDS = 2e-7
"""Per entry of the expansion's table: one path, one complex exponential, a few complex products."""

LOOK_SECONDS = 1e-7
"""Per source of a part of the spot that an expansion is looked for: its box, its half, its share of the power."""

TYPICAL_RANK = 6
"""Rank that a part of a large spot is taken to have when it is asked how many parts could pay."""

MOST_PARTS = 256
"""Parts of a spot beyond which the search for expansions costs more than it saves."""

POINTS_AT_ONCE = 1 << 20
"""Points of the target for which an expansion is evaluated at once."""

FEW_NODES = 0.7
"""Nodes a point of the target below which the field is summed on nodes and carried from them to the points.

By the recorded costs a sum of rank 6 gains from that up to 0.9 nodes a point, and the sum over all pairs up to 0.4,
as a pair at scattered nodes costs twice one on a grid; between the two either way takes about as long."""

DOUBLE_PRECISION = 3.0
"""Times longer that the sum over pairs takes where its angles have to be float64: for tolerances below float32's."""

SECOND_TRY = 0.03
"""Share of the tolerance that the sums are tried with again, once all have missed it."""

LEAST_ASKED = 1e-9
"""Tolerance that no sum is asked to go below: rounding of paths of 10^6 wavelengths is near."""

SHARE_OF_PATH = 1 / 20
"""Of the tolerance, what a series that stands for a path may add to it: nothing that counts beside the sum's own."""

CERTAINTY = 2.0
"""Factor on an error measured on a few tens of points: the true one is not above it in all but freak cases."""

SAMPLED_PAIRS, SAMPLED_POINTS = 10_000_000, (12, 96)
"""Pairs spent on measuring the error, as far as fewest and most sampled points allow."""

KERNEL_PAIRS = 50_000
"""Pairs of that sample from which the kernel is worth its launch; fewer are summed in NumPy."""


EVERY_PAIR, ON_NODES, NUFFT, DARK = "every pair", "every source on nodes", "NUFFT", "dark"
ALONG_EDGE = "along the edge"
"""Ways of doing a sum; the last one is that of ``edge_integral``."""

ASKED, FASTEST, ONLY, LAST_RESORT = "as asked", "predicted fastest", "nothing else applies", "nothing cheaper"
"""Why one of them was taken."""


@dataclass(frozen=True)
class How:
    """How a sum was done, and why so.

    kind: which way; points: of the target; pairs: of source and point; nodes: (along u, along v) where the field is
    interpolated from nodes; ranks: smallest and largest of the expansions of ``parts`` parts of the spot; why: see
    ``ASKED`` and so on; slower: kinds that were predicted to take longer; missed: kinds that were tried before, each
    with the error it had; tolerance: what had to be kept; predicted_seconds: None where nobody asked.
    """

    kind: str
    points: int
    pairs: float = 0.0
    nodes: tuple[int, int] | None = None
    ranks: tuple[int, int] | None = None
    parts: int = 1
    why: str = ASKED
    slower: tuple[str, ...] = ()
    missed: tuple[tuple[str, float], ...] = ()
    tolerance: float | None = None
    predicted_seconds: float | None = None

    def __str__(self) -> str:
        """In words, one line."""
        if self.kind == DARK:
            return "dark: no source has any weight"
        if self.kind == ALONG_EDGE:
            return f"the light that comes straight through and {self.pairs:.3g} waves of places of the edge"
        missed = "".join(f"; {kind} missed the tolerance with {error:.1e}" for kind, error in self.missed)
        why = {
            FASTEST: f"predicted faster than {' and '.join(self.slower)}",
            LAST_RESORT: f"nothing cheaper keeps {self.tolerance or 0:.0e}",
        }.get(self.why, self.why)
        return f"{self._what} ({why}{missed})"

    @property
    def _what(self) -> str:
        places = f"{self.nodes[0]} x {self.nodes[1]} nodes of {self.points} points" if self.nodes else "all points"
        if self.kind == EVERY_PAIR:
            return f"every one of {self.pairs:.3g} pairs"
        if self.kind == ON_NODES:
            return f"every source on {places}"
        rank = f"NUFFT of rank {self.ranks[0]}"
        if self.parts > 1:
            rank = f"NUFFTs of rank {self.ranks[0]} to {self.ranks[1]} of {self.parts} parts of the spot"
        return f"{rank} on {places}"


@dataclass(frozen=True)
class SumResult:
    """Outcome of a coherent sum.

    field: complex128 of the target's shape; how: what was chosen and why; numerical_error: relative L2 error of the
    field, not below the true one: measured on a sample of points against the exact sum, times ``CERTAINTY``.
    """

    field: np.ndarray
    how: How
    numerical_error: float


@dataclass(frozen=True)
class Candidate:
    """A way of doing the sum: what it is, how long it should take [s], and how to do it."""

    how: How
    seconds: float
    field: Callable[[], np.ndarray]


@products_on_one_thread()
def coherent_sum(
    path: Path,
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    wavelength: float,
    method: str = "auto",
    tolerance: float = 1e-4,
    costs: Costs = RECORDED,
    judged: np.ndarray | None = None,
) -> SumResult:
    """E_m = sum_j c_j A(P_j, D_m) e^{+ikV(P_j, D_m)} on all points of the target.

    sources: (n, 3) [mm]; weights c: (n,) complex; wavelength [mm]. method: ``direct`` takes every pair (for a path
    without closed form: the expansion at its tightest), ``fast`` the cheapest of the others, ``auto`` the cheapest of
    all. tolerance: relative L2 error allowed of ``fast`` and ``auto``, 1e-8 to 1e-1; what misses it is replaced. costs:
    what the choice rests on; who sums on a graphics card measures them there once (``costs_of``) and hands them over.
    judged: (k,) indices of points, as often as they count, on which the field's error is measured, where not on all.
    Raises ValueError for arrays of the wrong shape, values that are not finite, parameters out of range, and a source
    that lies on a point of the target.
    """
    sources, weights = _checked(sources, weights, target, wavelength, method, tolerance)
    lit = weights != 0
    if not lit.any():
        return SumResult(np.zeros(_shape(target), dtype=np.complex128), How(DARK, target.size), 0.0)
    if not lit.all():
        sources, weights = sources[lit], weights[lit]
    if method == "direct":
        tolerance = SINGLE_PRECISION if supports(path) else TIGHTEST
    task = Task(path, sources, weights, target, wavelength, tolerance, judged).with_cheap_path()
    if method == "direct" and supports(path):
        return task.result(task.every_pair(), ASKED)
    return _first_that_holds(task, costs, with_pairs=method == "auto")


def _first_that_holds(task: Task, costs: Costs, with_pairs: bool) -> SumResult:
    """The result of the cheapest candidate that keeps the tolerance; every pair is the last resort."""
    missed: list[tuple[str, float]] = []
    for share in (1.0, SECOND_TRY):
        candidates = replace(task, tolerance=max(share * task.tolerance, LEAST_ASKED)).candidates(costs, with_pairs)
        for i, candidate in enumerate(candidates):
            slower = tuple(other.how.kind for other in candidates[i + 1 :])
            result = task.result(candidate, FASTEST if slower else ONLY, slower, missed)
            if result.numerical_error <= task.tolerance:
                return result
            missed.append((candidate.how.kind, result.numerical_error))
    return task.result(task.every_pair(), LAST_RESORT, (), missed)


@dataclass(frozen=True)
class Task:
    """The arguments of a coherent sum, with what several methods need to know about them.

    path_error: what the path itself, a series, adds to the relative error of any sum over it.
    """

    path: Path
    sources: np.ndarray
    weights: np.ndarray
    target: PlaneGrid | PlanePoints
    wavelength: float
    tolerance: float
    judged: np.ndarray | None = None
    path_error: float = 0.0

    @cached_property
    def box(self) -> SourceBox:
        return SourceBox.around(self.sources, self.target.u)

    def with_cheap_path(self) -> Task:
        """The same with a path without closed form replaced by its series, where it has one."""
        if supports(self.path):
            return self
        series = interpolated(self.path, self.box, self.target, self.wavelength, SHARE_OF_PATH * self.tolerance)
        return self if series is None else replace(self, path=series, path_error=series.error)

    @cached_property
    def nodes(self) -> NodeGrid:
        reach = reach_of(self.path, self.sources, self.weights, self.box, self.target)
        return node_grid(self.path, reach, self.target, self.wavelength, self.tolerance)

    @property
    def touching(self) -> bool:
        """Whether sources may lie on the target: the field is not smooth there, and nodes know nothing of it."""
        rectangle = Area.around(self.target)
        return Extent.of(self.box.corners, self.target).distance_to(rectangle.a, rectangle.b) == 0.0

    def candidates(self, costs: Costs, with_pairs: bool) -> list[Candidate]:
        """The methods that apply, cheapest first; an expansion is only looked for where it can pay."""
        if self.touching:
            return [self.every_pair()]
        found = []
        count, shape = len(self.sources), _shape(self.target)
        interpolation = costs.interpolation(self.nodes.count, shape)
        all_pairs = np.inf
        few_nodes = self.nodes.size < FEW_NODES * self.target.size
        if supports(self.path):
            slow_down = 1.0 if self.tolerance >= SINGLE_PRECISION else DOUBLE_PRECISION
            all_pairs = slow_down * count * self.target.size * costs.grid_pair
            if with_pairs:
                found.append(replace(self.every_pair(), seconds=all_pairs))
            if few_nodes:
                seconds = slow_down * count * self.nodes.size * costs.point_pair + interpolation
                how = How(ON_NODES, self.target.size, nodes=self.nodes.count)
                found.append(Candidate(how, seconds, lambda: self._on_nodes(self._exact)))
        best = min([all_pairs, *(candidate.seconds for candidate in found)])
        least = EXPANSION_SECONDS + 2 * count * costs.nufft_point
        if best > least:
            points = self.nodes.size if few_nodes else self.target.size
            parts = expand_in_parts(
                self.path, self.sources, self.weights, self.target, self.box, self.wavelength, self.tolerance,
                largest_table=int(min(LARGEST_TABLE, (best - least) / TABLE_SECONDS)),
                most_parts=int(np.clip((best - least) / (TYPICAL_RANK * points * costs.nufft_point), 1, MOST_PARTS)),
                most_looked_at=(best - least) / LOOK_SECONDS,
            )  # fmt: skip
            if parts is not None:
                found.append(self._expanded(parts, costs, few_nodes, interpolation))
        return sorted(found, key=lambda candidate: candidate.seconds)

    def _expanded(self, parts: list[SpotPart], costs: Costs, few_nodes: bool, interpolation: float) -> Candidate:
        def low_rank(places: PlanePoints) -> np.ndarray:
            return sum(
                low_rank_sum(part.expansion, self.sources[part.members], self.weights[part.members], places)
                for part in parts
            )

        def seconds_at(points: int) -> float:
            return costs.nufft_point * sum(
                part.expansion.cost_factor * ((part.expansion.rank + 2) * part.count + part.expansion.rank * points)
                for part in parts
            )

        if isinstance(self.target, PlanePoints):
            few_nodes &= seconds_at(self.nodes.size) + interpolation < seconds_at(self.target.size)
        seconds = seconds_at(self.nodes.size if few_nodes else self.target.size)
        ranks = [part.expansion.rank for part in parts]
        how = How(NUFFT, self.target.size, ranks=(min(ranks), max(ranks)), parts=len(parts))
        if few_nodes:
            how, seconds = replace(how, nodes=self.nodes.count), seconds + interpolation
            return Candidate(how, seconds, lambda: self._on_nodes(low_rank))
        return Candidate(how, seconds, lambda: _in_parts(low_rank, self.target))

    def _exact(self, places: PlanePoints) -> np.ndarray:
        return direct_sum(self.path, self.sources, self.weights, places, self.wavelength, self.tolerance)

    def _on_nodes(self, evaluate: Callable[[PlanePoints], np.ndarray]) -> np.ndarray:
        return band_limited_sum(
            evaluate, self.path, self.box.centre, self.nodes, self.target, self.wavelength, self.tolerance
        )

    def every_pair(self) -> Candidate:
        """Every pair of source and point: the kernel for a closed form, NumPy for any other path."""

        def field() -> np.ndarray:
            if supports(self.path):
                return direct_sum(self.path, self.sources, self.weights, self.target, self.wavelength, self.tolerance)
            return self._reference(self.target).reshape(_shape(self.target))

        pairs = float(len(self.sources) * self.target.size)
        return Candidate(How(EVERY_PAIR, self.target.size, pairs), np.inf, field)

    def _reference(self, places: PlaneGrid | PlanePoints) -> np.ndarray:
        return reference_sum(self.path, self.sources, self.weights, places.points(), self.wavelength)

    def result(
        self,
        candidate: Candidate,
        why: str,
        slower: tuple[str, ...] = (),
        missed: Sequence[tuple[str, float]] = (),
    ) -> SumResult:
        """Does the sum and measures its relative L2 error on sampled points, against the exact float64 sum."""
        with np.errstate(divide="ignore", invalid="ignore"):  # told below
            field = candidate.field()
        flat = field.reshape(-1)
        looked_at = flat if self.judged is None else flat[self.judged]
        sample = Sample.of(looked_at, int(np.clip(SAMPLED_PAIRS // len(self.sources), *SAMPLED_POINTS)))
        if not np.isfinite(sample.mean_square if self.judged is None else flat.sum()):
            raise InputError("a source lies on a point of the target: the field is infinite there, move one of the two")
        index = sample.index if self.judged is None else self.judged[sample.index]
        places = points_at(self.target, index)
        if supports(self.path) and places.size * len(self.sources) > KERNEL_PAIRS:
            # In float64 throughout: the float32 angles of the sum that is judged must not judge themselves.
            exact = direct_sum(self.path, self.sources, self.weights, places, self.wavelength, tolerance=0.0)
        else:
            exact = self._reference(places)
        error = sample.error(flat[index], exact)
        seconds = candidate.seconds if np.isfinite(candidate.seconds) else None
        how = replace(candidate.how, why=why, slower=slower, missed=tuple(missed), tolerance=self.tolerance,
                      predicted_seconds=seconds)  # fmt: skip
        return SumResult(field, how, float(CERTAINTY * np.hypot(error, self.path_error)))


def _in_parts(evaluate: Callable[[PlanePoints], np.ndarray], target: PlaneGrid | PlanePoints) -> np.ndarray:
    """``evaluate`` on all points of the target, in parts of bounded memory."""
    field = np.empty(target.size, dtype=np.complex128)
    for first in range(0, target.size, POINTS_AT_ONCE):
        index = np.arange(first, min(first + POINTS_AT_ONCE, target.size))
        field[index] = evaluate(points_at(target, index))
    return field.reshape(_shape(target))


def _shape(target: PlaneGrid | PlanePoints) -> tuple[int, ...]:
    return target.shape if isinstance(target, PlaneGrid) else (target.size,)


def _checked(
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    wavelength: float,
    method: str,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray]:
    if method not in METHODS:
        raise ValueError(f"method = {method!r}: must be one of {', '.join(METHODS)}")
    if not 1e-8 <= tolerance <= 1e-1:
        raise ValueError(f"tolerance = {tolerance}: must be a relative L2 error between 1e-8 and 1e-1")
    if not (np.isfinite(wavelength) and wavelength > 0):
        raise ValueError(f"wavelength = {wavelength}: must be a positive number of mm")
    sources = np.ascontiguousarray(sources, dtype=np.float64)
    weights = np.ascontiguousarray(weights, dtype=np.complex128)
    if sources.ndim != 2 or sources.shape[1] != 3:
        raise ValueError(f"sources of shape {sources.shape}: must be (n, 3) positions in mm")
    if weights.shape != (len(sources),):
        raise ValueError(f"weights of shape {weights.shape}: must be one for each of the {len(sources)} sources")
    # A sum is finite where all its terms are, and costs no array of their answers.
    if not (np.isfinite(sources.sum()) and np.isfinite(weights.sum())):
        raise ValueError("sources and weights must be finite numbers")
    if target.size == 0:
        raise ValueError("target of no points: must have at least one")
    return sources, weights
