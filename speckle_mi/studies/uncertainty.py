"""What tolerances do to the sensitivities of an assembly, apart from what surfaces and the camera do.

Each sample is a variant of the scene. What is propagated is what sensitivities are over all surfaces: first-order
theory of every sample, exact in its rays, where there is theory; elsewhere the frames of a few surfaces that all
samples share, with products of different surfaces, so that their scatter is no part of the result. Where there is
theory the frames are its check, sample by sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..experiments.jobs import Job, Work
from ..experiments.one_frame import RANGE, SURFACES
from .camera_part import camera_uncertainty
from .design import Design
from .entries import MatrixEntry, entries_of, entry_named
from .evaluation import Asked, Compensator, Evaluation, Evaluator, Variants, theory_of
from .together import ALONE, Hands
from .tolerances import Tolerances, read_tolerances, tolerances_of
from .variance import FEWEST_ROWS, Spread, base_rows, probabilities, spread_of

SAMPLES = 1024
"""Variants unless asked otherwise."""

SURFACES_A_SAMPLE = 2
"""Surfaces that every variant is measured on: two are the fewest that tell noise from what tolerances do."""

STEPS = 4
"""Displacements of a sweep, half of them to either side."""

CLEARLY = 3.0
"""Standard errors from which frames are said to show something else than theory."""

WORTH_SAYING = 0.25
"""Relative difference of an uncertainty below which it is not said: few surfaces tell their own scatter badly."""

QUANTILES = (0.025, 0.975)


@dataclass(frozen=True)
class UncertaintySettings:
    """samples: variants at most, in all; sweep: whether they are measured by sweeps; surfaces: of the scene as it is,
    from which the scatter of one is told; on_samples: of them that every sample is measured on, 0 for theory alone;
    width: of the range of displacements [mm or deg] that scatter, camera and sweeps are for; steps: displacements of a
    sweep."""

    samples: int = SAMPLES
    sweep: bool = False
    surfaces: int = SURFACES
    on_samples: int = SURFACES_A_SAMPLE
    width: float = RANGE
    steps: int = STEPS

    @property
    def displacements(self) -> tuple[float, ...] | None:
        """Of a sweep [mm or deg], None without."""
        return tuple(np.linspace(-self.width / 2, self.width / 2, self.steps).tolist()) if self.sweep else None


@dataclass(frozen=True)
class EntryUncertainty:
    """One sensitivity and what it is uncertain by [mm/mm or mm/deg].

    nominal: of the scene as it is; mean, deviation: mean and standard uncertainty by the tolerances, with its standard
    error; interval: (low, high) that 95 % of assemblies lie in; linear: contribution of each number, a standard
    deviation of it times the derivative, signed; linear_deviation: combined from these; first_order, total: Sobol
    indices by factor with their standard errors; surfaces: standard deviation of one surface about the mean; camera: of
    one measured by a shift over the range, NaN without; basis: "theory" or "frames"; frames: standard uncertainty that
    frames show, and its standard error, NaN where none were made; note: empty if there is nothing to say.
    """

    entry: MatrixEntry
    nominal: float
    mean: float
    deviation: float
    deviation_error: float
    interval: tuple[float, float]
    linear: dict[str, float]
    linear_deviation: float
    first_order: dict[str, tuple[float, float]]
    total: dict[str, tuple[float, float]]
    surfaces: float
    camera: float
    basis: str
    frames: tuple[float, float]
    note: str = ""

    @property
    def combined(self) -> float:
        """Of tolerances, one surface and the camera together; what is not known is left out."""
        return float(np.sqrt(np.nansum(np.square([self.deviation, self.surfaces, self.camera]))))

    @property
    def first_to_tighten(self) -> list[str]:
        """The factors by what they have of the variance, largest first; none where nothing varies."""
        known = {name: value for name, (value, _) in self.total.items() if np.isfinite(value)}
        return sorted(known, key=lambda name: -known[name])


@dataclass(frozen=True)
class SampledVariant:
    """One variant: its block (``A``, ``B`` or a factor's name), its row, its numbers and what was found."""

    block: str
    row: int
    values: dict[str, float]
    found: Evaluation


@dataclass(frozen=True)
class UncertaintyResult:
    """entries: by name; samples: all that were evaluated; failed: how many of them could not be, and reason: of the
    first; rows: of each block; detectors: their names; seeds: of the surfaces that samples share."""

    tolerances: Tolerances
    entries: dict[str, EntryUncertainty]
    samples: list[SampledVariant]
    failed: int
    reason: str
    rows: int
    detectors: list[str]
    seeds: tuple[int, ...]
    surfaces: tuple[int, ...]


def propagate_tolerances(
    scene: str, tolerances: Mapping | str, settings: UncertaintySettings | None = None, **defaults: object
) -> UncertaintyResult:
    """What tolerances do to the sensitivities of a scene, all in this process.

    scene: path of a scene file; tolerances: path of a file, or what it holds, as ``{"laser_angle": {"normal": 0.5}}``;
    defaults: values of the scene's ``<default>``s. Raises SceneError, InputError, OSError.
    """
    design = Design.of(scene, [(name, str(value)) for name, value in defaults.items()])
    of = read_tolerances if isinstance(tolerances, str) else tolerances_of
    return UncertaintyStudy(design, of(tolerances, design.nominal()), settings).result()


class UncertaintyStudy:
    """The study on one scene: its jobs, and what is made of their results."""

    def __init__(
        self, design: Design, tolerances: Tolerances, settings: UncertaintySettings | None = None,
        hands: Hands = ALONE,
    ) -> None:  # fmt: skip
        """hands: who does its jobs. Raises InputError for names that the scene has not."""
        self.tolerances, self.settings = tolerances, settings or UncertaintySettings()
        self._hands = hands
        self.nominal = design.require(tolerances.parameters, "tolerance of ")
        self._held = design.assemblies({})
        self.detectors = list(self._held)
        self.allowed = [
            (entry_named(name, self.detectors, f"allowed {name}"), value) for name, value in tolerances.allowed
        ]
        first = next(iter(self._held.values()))
        own_points = first.target.points is not None
        seeds = range(first.seed, first.seed + (1 if own_points else self.settings.surfaces))
        self.surfaces, self.seeds = tuple(seeds), tuple(seeds[: self.settings.on_samples])
        self.variants = Variants(
            design, first.target.surface.density, tuple(self._compensators()), self.settings.displacements
        )
        self._work = Work(Evaluator, self.variants)
        self.entries = entries_of(self.detectors)

    def _compensators(self):
        for one in self.tolerances.adjustments:
            where = f"compensator {one.parameter}: condition {one.condition!r}"
            place = entry_named(one.condition, self.detectors, where).place
            value = one.value
            if value is None:
                value = float(np.stack([theory_of(assembly) for assembly in self._held.values()])[place])
                if not np.isfinite(value):
                    raise InputError(f"{where}: there is no first-order theory of it")
            yield Compensator(one.parameter, one.bounds, place, value)

    @property
    def count(self) -> int:
        """Variants that are evaluated, apart from those of the inverse."""
        factors = len(self.tolerances.factors)
        return base_rows(self.settings.samples, factors) * (factors + 2) + 2 * len(self.nominal) + 1

    def evaluated(
        self, asked: list[Asked], advance: Callable[[], None] = lambda: None, shared: bool = False
    ) -> list[Evaluation]:
        """What is asked for, in that order; advance is called for each. Shared as in :class:`Hands`."""
        return self._hands.evaluated([Job(self._work, one) for one in asked], advance, shared)

    def result(self, advance: Callable[[], None] = lambda: None) -> UncertaintyResult:
        """Evaluates all variants. Raises InputError where too few of them can be, LeftToOthers."""
        parameters, factors = self.tolerances.parameters, self.tolerances.factors
        middles = {one.parameter: one.middle for factor in factors for one in factor.tolerances}
        steps = [
            {**middles, one.parameter: one.middle + sign * one.deviation}
            for factor in factors for one in factor.tolerances for sign in (1, -1)
        ]  # fmt: skip
        centre, *stepped = self.evaluated(
            [_asked(middles, self.surfaces), *(_asked(values, self.seeds) for values in steps)], advance
        )
        if centre.failed:
            raise InputError(f"without any deviation the assembly cannot be: {centre.failed}")
        drawn = self.drawn(base_rows(self.settings.samples, len(factors)))
        rows = [
            dict(zip(parameters, row, strict=True)) for block in self.values_of(self.tolerances, drawn) for row in block
        ]
        measured = np.isfinite(centre.measured).all(axis=0)
        with_theory = np.isfinite(centre.theory) & (not self.settings.sweep)
        blocks = 2 if np.all(with_theory[measured]) else len(drawn)
        while True:
            # Where all has theory, frames are its check, for which A and B are enough.
            with_frames = blocks * drawn.shape[1]
            asked = [_asked(one, self.seeds if number < with_frames else ()) for number, one in enumerate(rows)]
            found = _Found(self.evaluated(asked, advance, shared=True), drawn.shape[:2], len(self.seeds))
            if np.count_nonzero(found.kept) < FEWEST_ROWS:
                raise InputError(f"{found.failed} of {len(rows)} samples cannot be, the first: {found.reason}")
            is_known = with_theory & np.isfinite(found.theory).all(axis=(0, 1))
            if blocks == len(drawn) or np.array_equal(is_known, with_theory):
                break
            blocks = len(drawn)
        names = ["A", "B", *(factor.name for factor in factors)]
        samples = [
            SampledVariant(names[number // drawn.shape[1]], number % drawn.shape[1], values, one)
            for number, (values, one) in enumerate(zip(rows, found.evaluations, strict=True))
        ]
        entries = self._entries(centre, stepped, found, is_known, drawn)
        return UncertaintyResult(
            self.tolerances, entries, samples, found.failed, found.reason, drawn.shape[1], self.detectors, self.seeds,
            self.surfaces,
        )  # fmt: skip

    def drawn(self, rows: int) -> np.ndarray:
        """The probabilities of :func:`probabilities` for this study's factors."""
        return probabilities(rows, [factor.size for factor in self.tolerances.factors])

    def values_of(self, tolerances: Tolerances, drawn: np.ndarray) -> np.ndarray:
        """(blocks, rows, numbers) values that tolerances have with probabilities of :meth:`drawn`."""
        parts, first = [], 0
        for factor in tolerances.factors:
            own = drawn[..., first : first + factor.size]
            parts.append(factor.values(own.reshape(-1, factor.size)).reshape(own.shape))
            first += factor.size
        return np.concatenate(parts, axis=-1)

    def _entries(
        self, centre: Evaluation, steps: list[Evaluation], found: _Found, is_known: np.ndarray, drawn: np.ndarray
    ) -> dict[str, EntryUncertainty]:
        sizes = [factor.size for factor in self.tolerances.factors]
        shape = len(found.measured), *drawn[:, found.kept].shape[:2], -1
        table = np.where(is_known, found.theory, found.measured).reshape(shape)
        spread = spread_of(table, drawn[:, found.kept], sizes)
        frames = spread_of(found.measured.reshape(shape), drawn[:, found.kept], sizes)
        several = len(self.surfaces) > 1
        scatter = np.std(centre.measured, axis=0, ddof=1) if several else np.full(is_known.shape, np.nan)
        camera = camera_uncertainty(self._held, self.settings.width)
        at_middle = np.where(is_known, centre.theory, centre.measured.mean(axis=0))
        slopes = self._slopes(steps, is_known)
        names, entries = [factor.name for factor in self.tolerances.factors], {}
        for entry in self.entries:
            place = entry.place
            column = int(np.ravel_multi_index(place, is_known.shape))
            if not np.isfinite(spread.variance[column]):
                continue
            linear = {name: float(slopes[number][place]) for number, name in enumerate(self.nominal)}
            entries[entry.name] = EntryUncertainty(
                entry, float(at_middle[place]), float(spread.mean[column]), float(spread.deviation[column]),
                float(spread.deviation_error[column]),
                _interval(table[..., column], spread, column, bool(is_known[place])),
                linear, self._combined(linear),
                _by_factor(names, spread.first_order[:, column], spread.first_order_error[:, column]),
                _by_factor(names, spread.total[:, column], spread.total_error[:, column]),
                float(scatter[place]), float(camera[place]), "theory" if is_known[place] else "frames",
                (float(frames.deviation[column]), float(frames.deviation_error[column])),
                _note(spread, frames, column, bool(is_known[place])),
            )  # fmt: skip
        return entries

    def _slopes(self, steps: list[Evaluation], theory_counts: np.ndarray) -> list[np.ndarray]:
        """By number the change (d, 6, 6) of every entry for one standard deviation of it, by central differences."""
        found = []
        for above, below in zip(steps[::2], steps[1::2], strict=True):
            if above.failed or below.failed:
                found.append(np.full(theory_counts.shape, np.nan))
                continue
            by_frames = (above.measured - below.measured).sum(axis=0) / (2 * len(above.measured) or np.nan)
            found.append(np.where(theory_counts, (above.theory - below.theory) / 2, by_frames))
        return found

    def _combined(self, linear: Mapping[str, float]) -> float:
        """Standard uncertainty by the law of propagation, correlations included."""
        variance = 0.0
        for factor in self.tolerances.factors:
            part = np.array([linear[one.parameter] for one in factor.tolerances])
            variance += float(part @ factor.correlation @ part)
        return float(np.sqrt(variance))


class _Found:
    """What was found of all blocks (b) and rows (n): evaluations in that order, failed ones counted, and arrays.

    kept: (n,) rows of which none failed, m of them; theory: (b, m, d, 6, 6); measured: (surfaces, b, m, d, 6, 6), NaN
    where no frames were made.
    """

    def __init__(self, evaluations: list[Evaluation], shape: tuple[int, int], surfaces: int) -> None:
        self.evaluations = evaluations
        failed = np.array([bool(one.failed) for one in evaluations]).reshape(shape)
        self.failed, self.kept = int(failed.sum()), ~failed.any(axis=0)
        self.reason = next((one.failed for one in evaluations if one.failed), "")
        kept = [one for one, is_kept in zip(evaluations, np.tile(self.kept, shape[0]), strict=True) if is_kept]
        if kept:
            theory = np.stack([one.theory for one in kept])
            blank = np.full((max(surfaces, 1), *theory.shape[1:]), np.nan)
            measured = np.stack([one.measured if len(one.measured) else blank for one in kept], axis=1)
            self.theory = theory.reshape(shape[0], -1, *theory.shape[1:])
            self.measured = measured.reshape(len(blank), *self.theory.shape)


def _interval(values: np.ndarray, spread: Spread, column: int, is_theory: bool) -> tuple[float, float]:
    """What 95 % of the samples lie in; the spread of what frames show is first reduced to that of the tolerances, as
    large as it may be."""
    error = 0.0 if is_theory else spread.deviation_error[column]
    deviation = np.hypot(spread.deviation[column], error)
    mean = values[:, :2].mean(axis=0).ravel()
    shown = mean.std()
    share = min(deviation / shown, 1.0) if shown > 0 else 0.0
    low, high = np.quantile(mean.mean() + share * (mean - mean.mean()), QUANTILES)
    return float(low), float(high)


def _note(spread: Spread, frames: Spread, column: int, is_theory: bool) -> str:
    variance, error = spread.variance[column], spread.variance_error[column]
    if not is_theory:
        told = variance > CLEARLY * error
        return "" if told else "not told from the surfaces' scatter: take more samples, or wider tolerances"
    beside, shown = np.hypot(frames.variance_error[column], error), frames.deviation[column]
    if not abs(frames.variance[column] - variance) > CLEARLY * beside:  # or nothing was measured
        return ""
    if abs(shown - spread.deviation[column]) < WORTH_SAYING * max(shown, spread.deviation[column]):
        return ""
    return f"frames show {shown:.3g} instead: first-order theory leaves something out"


def _asked(values: Mapping[str, float], seeds: tuple[int, ...]) -> Asked:
    return Asked(tuple((name, float(value)) for name, value in values.items()), seeds)


def _by_factor(names: list[str], values: np.ndarray, errors: np.ndarray) -> dict[str, tuple[float, float]]:
    return {name: (float(a), float(b)) for name, a, b in zip(names, values, errors, strict=True)}
