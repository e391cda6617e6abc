"""How wide tolerances may be for an allowed uncertainty: the inverse of propagation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from .entries import MatrixEntry
from .evaluation import Asked, Evaluation
from .tolerances import Factor, Tolerance, Tolerances
from .uncertainty import UncertaintyResult, UncertaintyStudy

ROWS = 64
"""Rows of either block that a variance is told from on the way."""

Allowance = list[tuple[MatrixEntry, float]]
"""Entries with the standard uncertainty that is allowed of each."""

LEAST = 1e-3
"""Contribution relative to what is allowed below which a tolerance does not matter."""

CLOSE_ENOUGH = 0.005
"""Relative difference of an uncertainty from what is allowed at which it is met."""

ITERATIONS = 14
FARTHEST_SCALE = 1e3
"""Scale of tolerances from which on they are said not to matter; its inverse is that of none."""

NOT_LINEAR = 0.2
"""Relative difference of a contribution by samples from that by derivatives from which it is not linear."""

MOST_AT_ONCE = 8.0
"""Factor by which tolerances are changed at most before it is looked anew."""


@dataclass(frozen=True)
class Widths:
    """Tolerances that use an allowance up, found by sampling: ``uncertainty`` of each allowed entry with them."""

    tolerances: Tolerances
    uncertainty: dict[str, float]


@dataclass(frozen=True)
class AllowedWidths:
    """How wide tolerances may be.

    together: all given ones made wider or narrower by the same ``factor``; equal: such that each has the same part of
    the variance, as the linear budget has it, then scaled by sampling; alone: by number the size that it may have if
    all others stay as given, by the linear budget where that is what samples show, else by sampling, 0 where the others
    use the allowance up, inf where it does not matter; allowed: of the entries that the tolerances matter to.
    """

    factor: float
    together: Widths
    equal: Widths
    alone: dict[str, float]
    allowed: dict[str, float]


def allowed_widths(
    study: UncertaintyStudy, result: UncertaintyResult, advance: Callable[[], None] = lambda: None
) -> AllowedWidths | None:
    """What the study's file allows, None where it allows nothing, or nothing that the tolerances come close to.

    Raises InputError where no tolerance does it.
    """
    binding = []
    for entry, value in study.allowed:
        if entry.name not in result.entries:
            raise InputError(f"allowed {entry.name}: nothing is known of it, there is no first-order theory of it")
        found = result.entries[entry.name]
        if max(found.deviation, found.linear_deviation) > LEAST * value:
            binding.append((entry, value))
    if not binding:
        return None
    together, factor = _scaled(study, binding, study.tolerances, advance)
    equal, _ = _scaled(study, binding, _equal_parts(study, binding, result), advance)
    return AllowedWidths(
        factor,
        together,
        equal,
        _alone(study, binding, result, advance),
        {entry.name: value for entry, value in binding},
    )


def _scaled(
    study: UncertaintyStudy, binding: Allowance, tolerances: Tolerances, advance: Callable[[], None]
) -> tuple[Widths, float]:
    """Tolerances made so wide, in proportion, that the entry which comes closest to its allowance uses it up."""
    factor, found = _scale(study, binding, tolerances.scaled, advance)
    if not math.isfinite(factor):
        raise InputError(f"allowed: tolerances {FARTHEST_SCALE:g} times as wide do not use it up, leave it out")
    return Widths(tolerances.scaled(factor), found), factor


def _scale(
    study: UncertaintyStudy, binding: Allowance, wide: Callable[[float], Tolerances], advance: Callable[[], None]
) -> tuple[float, dict[str, float]]:
    """The scale at which tolerances use the allowance up, inf where none does, and the uncertainties there."""
    factor, low, high, power, before = 1.0, 0.0, math.inf, 1.0, None
    for _ in range(ITERATIONS):
        found = _uncertainties(study, binding, wide(factor))
        advance()
        used = max(found[entry.name] / value for entry, value in binding)
        if abs(used - 1) <= CLOSE_ENOUGH:
            return factor, found
        if used < 1 and factor > FARTHEST_SCALE:
            return math.inf, found
        low, high = (factor, high) if used < 1 else (low, factor)
        if before is not None and 0 < used < math.inf and before[1] != used:
            power = float(np.clip(math.log(used / before[1]) / math.log(factor / before[0]), 0.5, 4.0))
        before = (factor, used) if 0 < used < math.inf else before
        # By the power law of the last two, else between what was too little and too much.
        following = factor / float(np.clip(max(used, 1e-300) ** (1 / power), 1 / MOST_AT_ONCE, MOST_AT_ONCE))
        factor = following if low < following < high else (low + high) / 2
    raise InputError(
        f"allowed: no scale was found for the tolerances (at {factor:.3g} the uncertainty is {used:.3g} times what is "
        "allowed)"
    )


def _uncertainties(study: UncertaintyStudy, binding: Allowance, tolerances: Tolerances) -> dict[str, float]:
    """Standard uncertainty of every allowed entry, from rows of either block."""
    drawn = study.drawn(ROWS)[:2]
    values = study.values_of(tolerances, drawn).reshape(2 * ROWS, -1)
    names, entries = tolerances.parameters, [entry for entry, _ in binding]
    rows = [tuple((name, float(one)) for name, one in zip(names, row, strict=True)) for row in values]
    by_theory = not study.settings.sweep
    found = study.evaluated([Asked(row, () if by_theory else study.seeds) for row in rows])
    table = _column(found, entries, by_theory)
    if by_theory and not np.all(np.isfinite(table)):
        found = study.evaluated([Asked(row, study.seeds) for row in rows])
        table = np.where(np.isfinite(table), table, _column(found, entries, False))
    table = table[:, ~np.isnan(table).any(axis=(0, 2))]
    if table.shape[1] < ROWS:  # most assemblies cannot be with tolerances that wide
        return {entry.name: math.inf for entry in entries}
    centred = table - table.mean(axis=1, keepdims=True)
    count = len(table)
    if count == 1:
        variance = np.mean(centred[0] ** 2, axis=0)
    else:
        whole, own = centred.sum(axis=0) ** 2, (centred**2).sum(axis=0)
        variance = np.mean(whole - own, axis=0) / (count * (count - 1))
    return {entry.name: float(np.sqrt(max(one, 0.0))) for entry, one in zip(entries, variance, strict=True)}


def _column(found: list[Evaluation], entries: list[MatrixEntry], by_theory: bool) -> np.ndarray:
    """(surfaces, rows, entries) values, one "surface" by theory; NaN where a row failed."""
    rows = []
    for one in found:
        values = [one.theory] if by_theory else list(one.measured)
        rows.append([[np.nan if one.failed else value[entry.place] for entry in entries] for value in values or [None]])
    most = max(map(len, rows))
    return np.stack([np.resize(np.array(row, float), (most, len(entries))) for row in rows], axis=1)


def _equal_parts(study: UncertaintyStudy, binding: Allowance, result: UncertaintyResult) -> Tolerances:
    """The tolerances such that every factor has the same part of the variance of the entry that allows it least.

    One that no allowed entry depends on stays as given.
    """
    factors, share = [], 1 / math.sqrt(len(study.tolerances.factors))
    for factor in study.tolerances.factors:
        scales = []
        for entry, value in binding:
            part = np.array([result.entries[entry.name].linear[one.parameter] for one in factor.tolerances])
            own = math.sqrt(float(part @ factor.correlation @ part))
            scales.append(share * value / own if own > LEAST * value else math.inf)
        factors.append(factor.scaled(scale) if math.isfinite(scale := min(scales)) else factor)
    return replace(study.tolerances, factors=tuple(factors))


def _alone(
    study: UncertaintyStudy, binding: Allowance, result: UncertaintyResult, advance: Callable[[], None]
) -> dict[str, float]:
    """By number the size that it may have while all others stay as given."""
    found = {}
    for place, factor in enumerate(study.tolerances.factors):
        if _is_linear(binding, result, factor):
            found |= {one.parameter: _alone_by_budget(binding, result, one) for one in factor.tolerances}
            continue

        def wide(scale: float, place: int = place) -> Tolerances:
            factors = [one.scaled(scale) if k == place else one for k, one in enumerate(study.tolerances.factors)]
            return replace(study.tolerances, factors=tuple(factors))

        kept = _uncertainties(study, binding, wide(1 / FARTHEST_SCALE))
        scale = 0.0
        if all(kept[entry.name] < value for entry, value in binding):
            scale = _scale(study, binding, wide, advance)[0]
        found |= {one.parameter: scale * one.size for one in factor.tolerances}
    return found


def _is_linear(binding: Allowance, result: UncertaintyResult, factor: Factor) -> bool:
    """Whether samples show of a factor what its derivatives say, or it does not matter."""
    for entry, value in binding:
        budget = result.entries[entry.name]
        part = np.array([budget.linear[one.parameter] for one in factor.tolerances])
        linear = math.sqrt(float(part @ factor.correlation @ part))
        share = budget.total[factor.name][0]
        shown = budget.deviation * math.sqrt(max(share, 0.0)) if math.isfinite(share) else 0.0
        if max(linear, shown) > LEAST * value and abs(linear - shown) > NOT_LINEAR * max(linear, shown):
            return False
    return True


def _alone_by_budget(binding: Allowance, result: UncertaintyResult, one: Tolerance) -> float:
    sizes = []
    for entry, value in binding:
        budget = result.entries[entry.name]
        own = abs(budget.linear[one.parameter])
        left = value**2 - (budget.linear_deviation**2 - own**2)
        wide = math.sqrt(max(left, 0.0)) / own * one.size if own > LEAST * value else math.inf
        sizes.append(wide)
    return min(sizes)
