"""The best designs within bounds: one for one goal, for several the trade-offs that no other design beats in all.

Trials are jobs of variants on the same surfaces, so that noise cancels between them; where goals and limits are known
by theory no frames are made until designs are chosen. First bounds are filled evenly by scrambled Sobol points, then
the best is refined, for one goal by the simplex method of Nelder and Mead, for several by evolution of what no other
beats. With optuna, for many numbers, its samplers propose the trials. All propose the same trials again for the same
results, so that an interrupted study goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from ..errors import InputError
from ..experiments.jobs import Job, Work
from ..experiments.one_frame import RANGE, SURFACES
from .design import Design
from .evaluation import Asked, Evaluation, Evaluator, Variants
from .figures import Figure, Figures
from .goals import Free, Goals, free_numbers, goals_of, read_goals
from .together import ALONE, Hands

TRIALS = 400
"""Trials unless asked otherwise."""

FEW = 6
"""Numbers up to which the simplex method serves."""

FIRST_SHARE = 0.3
"""Part of the trials that fill the bounds evenly at first."""

BATCH = 16
"""Trials that are proposed at a time for several goals, and can be made at the same time."""

LARGEST_STEP, SMALLEST_STEP = 0.1, 0.003
"""Random steps of offspring, relative to the bounds, at first and at last."""

PRICES = (1.0, 10.0, 100.0)
"""Of limits that are exceeded by as much as they are, relative to the range of costs, from one simplex to the next."""

MOST_RESTARTS = 4
"""Times that the simplex is begun anew, smaller, about what is best by one goal."""

SHOWN = 12
"""Trade-offs at most that are measured on surfaces at the end, spread evenly over all that were found."""

_ENDS = 1e-7
"""Size of a simplex, relative to the bounds, at which it has converged."""

_SAME = 2e-3
"""Difference of costs, relative to the front's extent, below which two trade-offs count as one."""

_BEYOND = 1e6
"""Cost of a design that exceeds a limit: more than any that does not."""


@dataclass(frozen=True)
class Trial:
    """values of the free numbers; figures: by name; costs: of the goals; violation: 0 where all limits are kept to."""

    values: dict[str, float]
    figures: dict[str, Figure]
    costs: tuple[float, ...]
    violation: float
    failed: str = ""

    @property
    def is_feasible(self) -> bool:
        """Whether it keeps to all limits and can be."""
        return self.violation == 0 and bool(np.all(np.isfinite(self.costs)))


@dataclass(frozen=True)
class Optimum:
    """trials: all, in their order; front: those that no other beats in all goals, by their first cost, one of them for
    one goal; measured: figures with intervals of some of these, by their number in ``front``."""

    goals: Goals
    free: tuple[Free, ...]
    trials: list[Trial]
    front: list[Trial]
    measured: dict[int, dict[str, Figure]]


class OptimisationStudy:
    """Looks for the best designs of one scene."""

    def __init__(
        self, design: Design, free: Sequence[Free], goals: Goals, trials: int = TRIALS, surfaces: int = SURFACES,
        width: float = RANGE, sampler: str | None = None, hands: Hands = ALONE,
    ) -> None:  # fmt: skip
        """trials: at most; surfaces: that trials are measured on where goals need frames, and the chosen designs;
        sampler: None by the number of free numbers, ``scipy`` or ``optuna``. Raises InputError."""
        nominal = design.require([one.name for one in free], "--free ")
        self._free, self._goals, self._count, self._width = tuple(free), goals, trials, width
        self._hands, self._sampler = hands, sampler or ("scipy" if len(free) <= FEW else "optuna")
        if self._sampler == "optuna":
            require_optuna()
        assembly = next(iter(design.assemblies({}).values()))
        count = surfaces if assembly.target.points is None else 1
        self._seeds = tuple(range(assembly.seed, assembly.seed + count))
        self._work = Work(Evaluator, Variants(design))
        self._chosen = Work(Evaluator, Variants(design, pixels=None))
        self._nominal, self._trials, self._known = nominal, [], {}
        self._with_frames = any(figure.needs_frames or figure.kind == "seconds" for figure in goals.figures)
        self._advance: Callable[[], None] = lambda: None

    def result(self, advance: Callable[[], None] = lambda: None) -> Optimum:
        """Makes trials. Raises InputError where no design keeps to the limits."""
        self._advance = advance
        start = np.clip([self._share(one, self._nominal[one.name]) for one in self._free], 0, 1)
        first = qmc.Sobol(len(self._free), rng=0).random(self._first)
        self._tried(np.concatenate([start[None], first]))
        if not any(np.all(np.isfinite(one.costs)) for one in self._trials):
            reason = next((one.failed for one in self._trials if one.failed), "there is no theory of the goals")
            raise InputError(f"none of {len(self._trials)} designs within the bounds can be judged: {reason}")
        if self._sampler == "optuna":
            by_optuna(self)
        elif len(self._goals.goals) > 1:
            self._by_evolution()
        else:
            self._by_simplices()
        feasible = [one for one in self._trials if one.is_feasible]
        if not feasible:
            raise InputError(self._why_none())
        front = _front(feasible)
        chosen = sorted({round(one) for one in np.linspace(0, len(front) - 1, min(SHOWN, len(front)))})
        return Optimum(self._goals, self._free, self._trials, front, self._measured(front, chosen))

    @property
    def _first(self) -> int:
        return 1 << max(2, int(np.log2(max(FIRST_SHARE * self._count, 1))))

    @property
    def left(self) -> int:
        """Trials that may still be made."""
        return self._count - len(self._trials)

    @property
    def free(self) -> tuple[Free, ...]:
        """The numbers that are chosen."""
        return self._free

    @property
    def goals(self) -> Goals:
        """What for."""
        return self._goals

    def tried(self, values: Sequence[float]) -> Trial:
        """The trial of one design, by its numbers' values."""
        shares = [self._share(one, value) for one, value in zip(self._free, values, strict=True)]
        return self._tried(np.array([shares]))[0]

    def _share(self, one: Free, value: float) -> float:
        return (value - one.low) / (one.high - one.low)

    def _tried(self, shares: np.ndarray) -> list[Trial]:
        """Trials of designs (n, free) given in shares of the bounds, each made once."""
        keys = [tuple(float(one.low + share * (one.high - one.low)) for one, share in zip(self._free, row, strict=True))
                for row in np.clip(shares, 0, 1)]  # fmt: skip
        new = list(dict.fromkeys(key for key in keys if key not in self._known))
        for key, found in zip(new, self._evaluated(new, self._work, self._seeds if self._with_frames else ())):
            self._known[key] = self._trial(dict(zip([one.name for one in self._free], key, strict=True)), found)
            self._trials.append(self._known[key])
        return [self._known[key] for key in keys]

    def _evaluated(self, keys: Sequence[tuple[float, ...]], work: Work, seeds: tuple[int, ...]) -> list[Evaluation]:
        names = [one.name for one in self._free]
        jobs = [Job(work, Asked(tuple(zip(names, key, strict=True)), seeds)) for key in keys]
        found = self._hands.evaluated(jobs, self._advance)
        if not seeds and self._needs_frames(found):
            # Of this scene theory does not tell: from now on all trials are measured.
            self._with_frames = True
            return self._evaluated(keys, work, self._seeds)
        return found

    def _needs_frames(self, found: Sequence[Evaluation]) -> bool:
        known = [one for one in found if not one.failed]
        return bool(known) and not any(
            np.isfinite(Figures(one, self._width).of(figure).best)
            for one in known for figure in self._goals.figures
        )  # fmt: skip

    def _trial(self, values: dict[str, float], found: Evaluation) -> Trial:
        if found.failed:
            return Trial(values, {}, (np.nan,) * len(self._goals.goals), np.inf, found.failed)
        every = Figures(found, self._width)
        figures = {name.text: every.of(name) for name in self._goals.figures}
        return Trial(values, figures, self._goals.costs(figures), self._goals.violation(figures))

    def _by_simplices(self) -> None:
        """Refines the best of the first trials for one goal, begun anew while trials are left.

        At first limits may be exceeded at a price, which leads to the best of several regions that keep to them.
        """
        known = np.array([one.costs[0] for one in self._trials if np.all(np.isfinite(one.costs))])
        low, span = known.min(), max(np.ptp(known), 1e-12 * np.abs(known).max() + 1e-300)
        size = 0.5 / self._first ** (1 / len(self._free))
        prices = PRICES if self._goals.limits else ()
        for number, price in enumerate((*prices, *[None] * MOST_RESTARTS)):
            left = self.left // (len(prices) - number + 1) if number < len(prices) else self.left

            def scalar(trial: Trial, price: float | None = price) -> float:
                if price is None or not np.all(np.isfinite(trial.costs)):
                    return _scalar(trial)
                return (trial.costs[0] - low) / span + price * trial.violation

            if left < len(self._free) + 2:
                continue
            best = min(self._trials, key=scalar)
            self._simplex(scalar, np.array([self._share(one, best.values[one.name]) for one in self._free]), size, left)
            if number >= len(prices):
                size = max(size / 4, 10 * _ENDS)

    def _by_evolution(self) -> None:
        """Refines the trade-offs of several goals: what no other beats has offspring, closer to it as trials run out.

        A child differs from its parent by a part of what two others differ by, and at random, in all numbers or in one.
        """
        random, began, free = np.random.default_rng(0), self.left, len(self._free)
        while self.left > 0:
            parents = _nondominated([one for one in self._trials if one.is_feasible])
            if len(parents) < BATCH // 2:
                parents = sorted(self._trials, key=_scalar)[:BATCH]
            places = np.array([[self._share(one, trial.values[one.name]) for one in self._free] for trial in parents])
            size = LARGEST_STEP * (SMALLEST_STEP / LARGEST_STEP) ** (1 - self.left / began)
            chosen = random.integers(len(places), size=(3, min(BATCH, self.left)))
            step = random.uniform(0, 1, (chosen.shape[1], 1)) * (places[chosen[1]] - places[chosen[2]])
            step += size * random.normal(size=step.shape)
            single = random.random(len(step)) < 0.5
            step[single] *= np.eye(free)[random.integers(free, size=np.count_nonzero(single))]
            before = len(self._trials)
            self._tried(places[chosen[0]] + step)
            if len(self._trials) == before:  # all were made already
                return

    def _simplex(self, scalar: Callable[[Trial], float], start: np.ndarray, size: float, most: int) -> None:
        turn, ends = np.where(start < 0.5, 1.0, -1.0), self.left - most
        corners = np.clip([start, *(start + size * np.diag(turn))], 0, 1)

        def cost(shares: np.ndarray) -> float:
            if self.left <= ends:
                raise StopIteration
            return scalar(self._tried(shares[None])[0])

        options = {"initial_simplex": corners, "xatol": _ENDS, "fatol": np.inf, "maxfev": 60 * (start.size + 1)}
        try:
            minimize(cost, start, method="Nelder-Mead", bounds=[(0, 1)] * start.size, options=options)
        except StopIteration:
            pass

    def _measured(self, front: list[Trial], chosen: Sequence[int]) -> dict[int, dict[str, Figure]]:
        keys = [tuple(front[number].values.values()) for number in chosen]
        found = {}
        for number, one in zip(chosen, self._evaluated(keys, self._chosen, self._seeds), strict=True):
            every = Figures(one, self._width)
            found[number] = {} if one.failed else {name.text: every.of(name) for name in self._goals.figures}
        return found

    def _why_none(self) -> str:
        known = [one for one in self._trials if not one.failed]
        closest = min(known, key=lambda one: one.violation)
        limits = "; ".join(
            f"{limit.text}, closest {closest.figures[limit.figure.text].best:.4g}" for limit in self._goals.limits
        )
        values = ", ".join(f"{name} {value:.4g}" for name, value in closest.values.items())
        return f"none of {len(self._trials)} designs within the bounds keeps to all limits ({limits}, at {values})"


def optimise_scene(
    scene: str, free: str | Sequence[Free], goal: Mapping | str, trials: int = TRIALS, **defaults: object
) -> Optimum:
    """The best designs of a scene, all in this process.

    scene: path; free: ``"laser_angle=20:50,detector_distance=40:90"`` or the same as values; goal: path of a file, or
    what it holds, as ``{"minimise": ["crosstalk.z"]}``; defaults: values of the scene's ``<default>``s. Raises
    SceneError, InputError, OSError.
    """
    design = Design.of(scene, [(name, str(value)) for name, value in defaults.items()])
    detectors = list(design.assemblies({}))
    goals = read_goals(goal, detectors) if isinstance(goal, str) else goals_of(goal, detectors)
    return OptimisationStudy(design, free_numbers(free) if isinstance(free, str) else free, goals, trials).result()


def require_optuna() -> None:
    """InputError where it is not installed."""
    from importlib.util import find_spec

    if find_spec("optuna") is None:
        raise InputError("more than 6 free numbers, or --sampler optuna: pip install 'speckle_mi[optimise]' brings it")


def by_optuna(study: OptimisationStudy) -> None:
    """Trials that optuna's samplers propose: by tree-structured Parzen estimators, of several goals by NSGA-II."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    several = len(study.goals.goals) > 1

    def constraints(trial) -> tuple[float]:
        return (trial.user_attrs["violation"],)

    samplers = optuna.samplers
    sampler = (
        samplers.NSGAIISampler(seed=0, population_size=32, constraints_func=constraints) if several
        else samplers.TPESampler(seed=0, multivariate=True, constraints_func=constraints)
    )  # fmt: skip
    made = optuna.create_study(directions=["minimize"] * len(study.goals.goals), sampler=sampler)
    for _ in range(2 * study.left):
        if study.left <= 0:
            return
        asked = made.ask({one.name: optuna.distributions.FloatDistribution(one.low, one.high) for one in study.free})
        trial = study.tried([asked.params[one.name] for one in study.free])
        asked.set_user_attr("violation", float(min(trial.violation, 1e6)))
        if np.all(np.isfinite(trial.costs)):
            made.tell(asked, list(trial.costs))
        else:
            made.tell(asked, state=optuna.trial.TrialState.FAIL)


def _scalar(trial: Trial) -> float:
    """What is to be small for one goal: its cost where all limits are kept to, else what they are exceeded by."""
    if not np.all(np.isfinite(trial.costs)):
        return 3 * _BEYOND
    return trial.costs[0] if trial.is_feasible else _BEYOND * (1 + min(trial.violation, 1.0))


def _nondominated(trials: list[Trial]) -> list[Trial]:
    """Those that no other is as good as in all goals and better in one, by their first cost."""
    front: list[Trial] = []
    for one in sorted(trials, key=lambda one: one.costs):
        if not any(all(a <= b for a, b in zip(other.costs, one.costs, strict=True)) for other in front):
            front.append(one)
    return front


def _front(trials: list[Trial]) -> list[Trial]:
    """Those that no other beats, alike ones once; the best for one goal."""
    front = _nondominated(trials)
    span = np.maximum(np.ptp([one.costs for one in front], axis=0), 1e-300)
    kept = front[:1]
    for one in front[1:-1]:
        apart = [np.abs(np.subtract(one.costs, other.costs) / span).max() for other in (*kept, front[-1])]
        if min(apart) > _SAME:
            kept.append(one)
    return [*kept, *front[-1:]] if len(front) > 1 else kept
