"""How wide tolerances may be for an allowed uncertainty: the inverse of propagation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from .entries import MatrixEntry
from .evaluation import Asked, Evaluation
from .tolerances import Tolerances
from .uncertainty import UncertaintyResult, UncertaintyStudy

ROWS = 64
"""Rows of either block that a variance is told from on the way."""

CLOSE_ENOUGH = 0.005
"""Relative difference of an uncertainty from what is allowed at which it is met."""

ITERATIONS = 8
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
    all others stay as given, by the linear budget, 0 where the others use the allowance up, inf where it does not
    matter.
    """

    factor: float
    together: Widths
    equal: Widths
    alone: dict[str, float]


def allowed_widths(
    study: UncertaintyStudy, result: UncertaintyResult, advance: Callable[[], None] = lambda: None
) -> AllowedWidths | None:
    """What the study's file allows, None where it allows nothing. Raises InputError where no tolerance does it."""
    if not study.allowed:
        return None
    for entry, _ in study.allowed:
        if entry.name not in result.entries:
            raise InputError(f"allowed {entry.name}: nothing is known of it, there is no first-order theory of it")
        if not any(abs(value) > 0 for value in result.entries[entry.name].linear.values()):
            raise InputError(f"allowed {entry.name}: does not depend on any of the tolerances")
    together, factor = _scaled(study, study.tolerances, advance)
    equal, _ = _scaled(study, _equal_parts(study, result), advance)
    return AllowedWidths(factor, together, equal, _alone(study, result))


def _scaled(study: UncertaintyStudy, tolerances: Tolerances, advance: Callable[[], None]) -> tuple[Widths, float]:
    """Tolerances made so wide, in proportion, that the entry which comes closest to its allowance uses it up."""
    factor, low, high = 1.0, 0.0, math.inf
    for _ in range(ITERATIONS):
        wide = tolerances.scaled(factor)
        found = _uncertainties(study, wide)
        advance()
        used = max(found[entry.name] / value for entry, value in study.allowed)
        if abs(used - 1) <= CLOSE_ENOUGH:
            break
        low, high = (factor, high) if used < 1 else (low, factor)
        # In proportion as long as it is linear, else between what was too little and too much.
        following = factor / float(np.clip(used, 1 / MOST_AT_ONCE, MOST_AT_ONCE))
        factor = following if low < following < high else (low + high) / 2
    else:
        raise InputError(
            f"allowed: no common factor was found for the tolerances (at {factor:.3g} the uncertainty is {used:.3g} "
            "times what is allowed)"
        )
    return Widths(wide, found), factor


def _uncertainties(study: UncertaintyStudy, tolerances: Tolerances) -> dict[str, float]:
    """Standard uncertainty of every allowed entry, from rows of either block."""
    drawn = study.drawn(ROWS)[:2]
    values = study.values_of(tolerances, drawn).reshape(2 * ROWS, -1)
    names, entries = tolerances.parameters, [entry for entry, _ in study.allowed]
    rows = [tuple((name, float(one)) for name, one in zip(names, row, strict=True)) for row in values]
    by_theory = not study.settings.sweep
    found = study.evaluated([Asked(row, () if by_theory else study.seeds) for row in rows])
    table = _column(found, entries, by_theory)
    if by_theory and not np.all(np.isfinite(table)):
        found = study.evaluated([Asked(row, study.seeds) for row in rows])
        table = np.where(np.isfinite(table), table, _column(found, entries, False))
    table = table[:, ~np.isnan(table).any(axis=(0, 2))]
    if table.shape[1] < ROWS:
        reason = next((one.failed for one in found if one.failed), "no light")
        raise InputError(f"allowed: most assemblies cannot be with tolerances that wide: {reason}")
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


def _equal_parts(study: UncertaintyStudy, result: UncertaintyResult) -> Tolerances:
    """The tolerances such that every factor has the same part of the variance of the entry that allows it least.

    One that no allowed entry depends on stays as given.
    """
    factors, share = [], 1 / math.sqrt(len(study.tolerances.factors))
    for factor in study.tolerances.factors:
        scales = []
        for entry, value in study.allowed:
            part = np.array([result.entries[entry.name].linear[one.parameter] for one in factor.tolerances])
            own = math.sqrt(float(part @ factor.correlation @ part))
            scales.append(share * value / own if own > _LEAST * value else math.inf)
        factors.append(factor.scaled(scale) if math.isfinite(scale := min(scales)) else factor)
    return replace(study.tolerances, factors=tuple(factors))


_LEAST = 1e-3
"""Contribution relative to what is allowed below which a tolerance does not matter."""


def _alone(study: UncertaintyStudy, result: UncertaintyResult) -> dict[str, float]:
    found = {}
    for factor in study.tolerances.factors:
        for one in factor.tolerances:
            sizes = []
            for entry, value in study.allowed:
                budget = result.entries[entry.name]
                own = abs(budget.linear[one.parameter])
                left = value**2 - (budget.linear_deviation**2 - own**2)
                wide = math.inf if own <= _LEAST * value else math.sqrt(max(left, 0.0)) / own * one.size
                sizes.append(wide)
            found[one.parameter] = min(sizes)
    return found
