"""What a stability case is and what it finds: a value, an independent reference, an error and its bound."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ...scene.errors import one_line

OK, BROKEN, LIMIT = "ok", "broken", "limit"


@dataclass(frozen=True)
class Check:
    """A row of the table.

    case: which extreme; quantity: what is looked at, with its unit; value, reference: numbers, or words; error: of the
    value against the reference; bound: the largest error allowed; verdict: "ok", "broken", or "limit" where the program
    declines and says so; message: what the user gets, for a limit, or what went wrong.
    """

    case: str
    quantity: str
    value: float | str
    reference: float | str
    error: float
    bound: float
    verdict: str
    message: str = ""


@dataclass(frozen=True)
class Case:
    """A function that yields the checks of one extreme. in_quick: whether the quick catalogue holds it too."""

    run: Callable[[bool], Iterable[Check]]
    in_quick: bool = True

    @property
    def name(self) -> str:
        return self.run.__name__.replace("_", " ")


def compared(case: str, quantity: str, value: float, reference: float, bound: float, relative: bool = False) -> Check:
    """A number against its reference; the error is absolute, or relative to the reference. NaN is broken."""
    error = abs(value - reference) / (abs(reference) if relative else 1.0)
    return within(case, quantity, value, reference, error, bound)


def within(case: str, quantity: str, value: float | str, reference: float | str, error: float, bound: float) -> Check:
    """An error that was measured against a bound. NaN is broken."""
    return Check(case, quantity, value, reference, float(error), float(bound), OK if error <= bound else BROKEN)


def same_field(case: str, quantity: str, field: np.ndarray, reference: np.ndarray, bound: float) -> Check:
    """A complex field against its reference; the error is the relative L2 norm of their difference."""
    field, reference = np.ravel(field), np.ravel(reference)
    norm = float(np.linalg.norm(reference))
    error = float(np.linalg.norm(field - reference)) / norm
    return within(case, quantity, float(np.linalg.norm(field)), norm, error, bound)


def said(case: str, quantity: str, value: str, wanted: str, message: str = "") -> Check:
    """Words against the words that must come."""
    fits = wanted in value
    return Check(case, quantity, value, wanted, 0.0 if fits else math.inf, 0.0, OK if fits else BROKEN, message)


def declined(case: str, quantity: str, work: Callable[[], object], *words: str) -> Check:
    """A limit: ``work`` must refuse with one line that holds all ``words``."""
    try:
        work()
    except (ValueError, RuntimeError) as error:
        message = one_line(error)
        clear = all(word in message for word in words) and "\n" not in message
        verdict = LIMIT if clear else BROKEN
        return Check(case, quantity, "refused", "refused", 0.0 if clear else math.inf, 0.0, verdict, message)
    return Check(case, quantity, "accepted", "refused", math.inf, 0.0, BROKEN, "went through without a word")


def warned(case: str, quantity: str, frame, *words: str) -> Check:
    """A limit: a frame without light whose warnings hold all ``words``."""
    message = "; ".join(frame.warnings)
    light = float(np.abs(frame.image.field).max())
    clear = light == 0.0 and all(word in message for word in words)
    return Check(case, quantity, light, 0.0, light, 0.0, LIMIT if clear else BROKEN, message or "no warning")


def checks_of(case: Case, quick: bool) -> Iterator[Check]:
    """The checks of a case; an error that it does not expect becomes a broken one."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # an overflow or a NaN on the way is a fault as well
            yield from case.run(quick)
    except Exception as error:  # whatever happens, the rest of the catalogue goes on
        message = f"{type(error).__name__}: {one_line(error)}"
        yield Check(case.name, "runs to its end", "failed", "done", math.inf, 0.0, BROKEN, message)
