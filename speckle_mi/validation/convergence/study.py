"""The convergence study: every method at every N1 and accuracy that the time allows, the smallest N1 first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from ...errors import InputError

from .allowance import SHARE_OF_STEP, Allowance
from .exact import ExactField, exact_fields
from .frame import DOES_NOT_APPLY, PAPER_RAYS, Row, Setting
from .measure import blank_row, does_not_apply, row_of
from .prediction import Predictor, seconds_behind_openings, seconds_of_rays
from .scatter import SCATTER_SOURCES, Scatter, rotation_as_far, scatter_of, slopes_of_surfaces
from .shift_errors import with_shift_errors
from .subject import Subject

METHODS = ("auto", "direct", "fast", "rays")

DIRECT_TOLERANCE = 1e-6
"""What ``direct`` is asked for behind openings, where it says how finely they are divided."""


@dataclass(frozen=True)
class Findings:
    """What a study has found: the exact field at every N1 (None where there is none), a row a setting, the scatter."""

    subject: Subject
    exact: dict[int, ExactField | None]
    rows: list[Row]
    scatter: list[Scatter]


def study(subject: Subject, settings: dict, progress) -> Findings:
    """Everything on one assembly in the time that ``settings`` allow: seconds, tolerances, rays, surfaces."""
    allowance = Allowance(settings["seconds"])
    exact = _exact_fields(subject, allowance, progress)
    rows: list[Row] = []
    for method in METHODS:
        accuracies = accuracies_of(method, settings, bool(subject.assembly.elements))
        task = progress.add_task(method, total=len(subject.point_sources) * len(accuracies))
        allowance.begin_part(method)
        predictor = Predictor(method, subject.assembly.detector.size)
        if method == "direct":
            predictor.assume(0, subject.point_sources[0], seconds_behind_openings(subject, rows))
        rows += rows_of_method(subject, accuracies, exact, predictor, allowance, partial(progress.advance, task))
    rows.sort(key=lambda row: (row.point_sources, METHODS.index(row.method), row.rays_per_source or 0))
    scatter = _scatter_over_surfaces(subject, settings["surfaces"], allowance, progress)
    return Findings(subject, exact, with_shift_errors(rows, subject.theory_shift), scatter)


def _exact_fields(subject: Subject, allowance: Allowance, progress) -> dict[int, ExactField | None]:
    allowance.begin_part("exact")
    task = progress.add_task("exact", total=len(subject.point_sources))
    return exact_fields(subject, allowance, partial(progress.advance, task))


def accuracies_of(method: str, settings: dict, has_elements: bool) -> list[dict]:
    """The accuracies that a method is asked for, in the order in which they are tried."""
    if method == "rays":
        # The paper's comes first, so that it is there if only one is.
        return [{"rays_per_source": n} for n in sorted(settings["rays"], key=lambda n: n != PAPER_RAYS)]
    if method == "direct":
        return [{"tolerance": DIRECT_TOLERANCE if has_elements else None}]
    return [{"tolerance": tolerance} for tolerance in settings["tolerances"]]


def rows_of_method(
    subject: Subject,
    accuracies: list[dict],
    exact: dict[int, ExactField | None],
    predictor: Predictor,
    allowance: Allowance,
    advance: Callable[[], None],
) -> list[Row]:
    """A row a setting of one method; one alone from where it turns out not to apply to the scene."""
    rows: list[Row] = []
    for step in _steps(predictor.method, subject.point_sources, len(accuracies), allowance):
        for count, number in step:
            setting = Setting(predictor.method, count, **accuracies[number])
            if predictor.method == "rays" and not predictor.knows(number):
                try:
                    predictor.assume(number, count, seconds_of_rays(subject, setting, exact[count]))
                except InputError as error:
                    return [*rows, does_not_apply(blank_row(subject, setting, exact[count]), error)]
            seconds = predictor.seconds(number, count)
            row = row_of(subject, setting, exact[count], seconds, lambda: allowance.step_left)
            predictor.learn(number, row)
            rows.append(row)
            advance()
            if row.status == DOES_NOT_APPLY:
                return rows
    return rows


def _steps(
    method: str, counts: tuple[int, ...], accuracies: int, allowance: Allowance
) -> Iterator[list[tuple[int, int]]]:
    """(N1, number of the accuracy) of the settings to measure, in steps that each have their share of the time.

    The tightest tolerances take longest, so each tolerance goes through all N1 before the next; rays take longest
    with the most sources, so each N1 goes through all N2 first.
    """
    by_count = [[(count, number) for number in range(accuracies)] for count in counts]
    steps = by_count if method == "rays" else [list(step) for step in zip(*by_count, strict=True)]
    for step in steps:
        allowance.begin_step(1.0 if step is steps[-1] else SHARE_OF_STEP)
        yield step


def _scatter_over_surfaces(subject: Subject, surfaces: int, allowance: Allowance, progress) -> list[Scatter]:
    """Slopes of a translation and a rotation, on as many surfaces as there is time for (at least two)."""
    allowance.begin_part("surfaces")
    if subject.assembly.target.points is not None:
        return []  # the user's own scatterers are one surface
    counts = [n for n in SCATTER_SOURCES if n <= max(subject.point_sources)] or [subject.point_sources[0]]
    steps = {"x": subject.displacement, "ry": rotation_as_far(subject.theory_shift, subject.expected)}
    task = progress.add_task("surfaces", total=surfaces)
    slopes = slopes_of_surfaces(
        subject.assembly, counts, steps, surfaces, lambda: allowance.left, partial(progress.advance, task)
    )
    return [scatter_of(dof, n, steps[dof], np.array(found), subject.expected) for (dof, n), found in slopes.items()]
