"""The convergence study: every method at every N1 and accuracy that the time allows, the smallest N1 first."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial

import numpy as np

from ...errors import InputError
from ...experiments.expectation import expected_sensitivity
from ...field.simulation import plan_of, simulate_frame
from ...geometry.pose import Pose
from ...machine.run_times import Timing, duration
from ...measurement.correlator import Correlator
from ...scene.errors import one_line
from .frame import (
    DOES_NOT_APPLY,
    LEFT_OUT,
    MEASURED,
    PAPER_RAYS,
    Row,
    Sample,
    Setting,
    exact_sample,
    peak_memory,
    sampled_pixels,
    with_point_sources,
)
from .scatter import SCATTER_SOURCES, Scatter, rotation_as_far, scatter_of, slopes_of_surfaces

METHODS = ("auto", "direct", "fast", "rays")

SHARES = {"exact": 0.15, "auto": 0.15, "direct": 0.05, "fast": 0.1, "rays": 0.4, "surfaces": 0.15}
"""Of the time, in the order in which it is spent; what a part leaves over goes to those after it."""

SHARE_OF_STEP = 2 / 3
"""Of a part's time left that one step of it may take, so that those after it, which take longest, get their turn."""

DIRECT_TOLERANCE = 1e-6
"""What ``direct`` is asked for behind openings, where it says how finely they are divided."""

WARM_RUNS, WARM_SECONDS = 7, 0.6
"""Warm runs of a setting, fewer where they take longer than this together; one is always made."""

SHARE_OF_RADIUS = 0.1
"""Displacement along x relative to the beam's radius: the pattern keeps 99 % of its correlation."""

EXACT_TOLERANCES = (1e-7, 1e-6)
"""Of the exact field behind elements; the second where the first would take too long."""

PAIRS_PER_SECOND = 1e9
EDGES = (
    "behind an opening: light diffracted at its edge stands still while the speckles move and holds the peak of the "
    "correlation back, most at small displacements; theory leaves it out"
)

LONE = (
    "through a lens: a tilt moves the speckles of scatterers that share a resolution cell; those that few scatterers "
    "make, seen one by one, stay where they are"
)
"""Why simulated shifts are not those of first-order theory."""

PROBE_SOURCES = 0.5
"""N1 of the frame that tells what the rays of one source cost, and whether the method applies: about five sources."""


class Allowance:
    """Time [s] in parts: each may take its share, as in :data:`SHARES`, of what the parts before it have left."""

    def __init__(self, seconds: float) -> None:
        self.end, self.waiting = time.perf_counter() + seconds, dict(SHARES)

    def begin_part(self, name: str) -> None:
        """Starts a part; whatever it may take is ``left``, and a step of it ``step_left``."""
        share = self.waiting[name] / sum(self.waiting.values())
        del self.waiting[name]
        now = time.perf_counter()
        self.part_end = self.step_end = now + share * max(self.end - now, 0.0)

    def begin_step(self, share: float) -> None:
        """Starts a step of the part, which may take ``share`` of what is left of it."""
        self.step_end = time.perf_counter() + share * max(self.left, 0.0)

    @property
    def left(self) -> float:
        return self.part_end - time.perf_counter()

    @property
    def step_left(self) -> float:
        return self.step_end - time.perf_counter()


class Study:
    """All measurements on one assembly."""

    def __init__(self, assembly, name: str, settings: dict, allowance: Allowance) -> None:
        self.assembly, self.name, self.settings, self.allowance = assembly, name, settings, allowance
        self.plan_lines = list(plan_of(assembly).lines)
        radius = assembly.beam.radius
        self.displacement = float(SHARE_OF_RADIUS * radius if np.isfinite(radius) else 2 * assembly.detector.pitch)
        expected = expected_sensitivity(assembly)
        self.expected = {axis: expected[axis] for axis in ("u", "v")}
        along = [
            None if values is None else 1e3 * self.displacement * float(values[0]) for values in self.expected.values()
        ]
        self.theory_shift = None if None in along else along
        self.samples: dict[int, Sample | None] = {}
        points = assembly.target.points
        self.point_sources = settings["point_sources"] if points is None else (len(points.points),)

    def why_off_theory(self, off: list[Scatter]) -> list[str]:
        """What is known to set the means ``off`` apart from first-order theory, a sentence each."""
        channels = plan_of(self.assembly).channels
        edges = off and any(channel.openings and not channel.has_power for channel in channels)
        lone = any(entry.dof == "ry" for entry in off) and any(channel.has_power for channel in channels)
        return [*([EDGES] if edges else []), *([LONE] if lone else [])]

    # Error against run time

    def every_method(self, progress) -> list[Row]:
        """Rows of all methods, ordered by N1 and method; shift errors filled in."""
        rows: list[Row] = []
        self.allowance.begin_part("exact")
        task = progress.add_task("exact", total=len(self.point_sources))
        for count in self.point_sources:
            self.samples[count] = self._exact(count)
            progress.advance(task)
        for method in METHODS:
            accuracies = self._accuracies(method)
            task = progress.add_task(method, total=len(self.point_sources) * len(accuracies))
            self.allowance.begin_part(method)
            if method == "direct":
                self._nodes = _nodes_behind_openings(rows)
            rows += self._one_method(method, accuracies, partial(progress.advance, task))
        rows.sort(key=lambda row: (row.point_sources, METHODS.index(row.method), row.rays_per_source or 0))
        return self._with_shift_errors(rows)

    def _accuracies(self, method: str) -> list[dict]:
        if method == "rays":
            # The paper's comes first, so that it is there if only one is.
            return [{"rays_per_source": n} for n in sorted(self.settings["rays"], key=lambda n: n != PAPER_RAYS)]
        if method == "direct":
            return [{"tolerance": DIRECT_TOLERANCE if self.assembly.elements else None}]
        return [{"tolerance": tolerance} for tolerance in self.settings["tolerances"]]

    def _one_method(self, method: str, accuracies: list[dict], advance: Callable[[], None]) -> list[Row]:
        rows: list[Row] = []
        history: dict[int, tuple[int, float]] = {}
        if method == "direct":
            history[0] = (self.point_sources[0], self._nodes * self.assembly.detector.size / PAIRS_PER_SECOND)
        coarser = dict.fromkeys(self.point_sources, 0.0)
        for step in self._steps(method, len(accuracies)):
            for count, number in step:
                setting = Setting(method, count, **accuracies[number])
                if method == "rays" and number not in history:
                    try:
                        history[number] = (count, self._seconds_of_rays(setting))
                    except InputError as error:
                        return [*rows, replace(self._blank(setting), status=DOES_NOT_APPLY, note=one_line(error))]
                expected = _predicted(setting, history.get(number), self.assembly.detector.size)
                row = self._one_setting(setting, max(expected, coarser[count]))
                if row.status == MEASURED:
                    history[number] = (count, row.seconds_median)
                if method != "rays":
                    # The next accuracy is not faster than the one before, whether that was measured or left out.
                    coarser[count] = row.seconds_median if row.status == MEASURED else max(expected, coarser[count])
                rows.append(row)
                advance()
                if row.status == DOES_NOT_APPLY:
                    return rows
        return rows

    def _steps(self, method: str, accuracies: int) -> Iterator[list[tuple[int, int]]]:
        """(N1, number of the accuracy) of the settings to measure, in steps that each have their share of the time.

        The tightest tolerances take longest, so each tolerance goes through all N1 before the next; rays take longest
        with the most sources, so each N1 goes through all N2 first.
        """
        counts, numbers = self.point_sources, range(accuracies)
        by_count = [[(count, number) for number in numbers] for count in counts]
        steps = by_count if method == "rays" else [list(step) for step in zip(*by_count, strict=True)]
        for step in steps:
            self.allowance.begin_step(1.0 if step is steps[-1] else SHARE_OF_STEP)
            yield step

    def _one_setting(self, setting: Setting, seconds: float) -> Row:
        """One row; ``seconds`` is what a frame should take, 0 if nobody knows."""
        sample, blank = self.samples[setting.point_sources], self._blank(setting)
        if sample is None:
            return replace(blank, note="the exact sum to compare with would take too long")
        if 2 * seconds > self.allowance.step_left:
            note = f"would take about {duration(seconds)} a frame" if seconds else "no time left"
            return replace(blank, note=note)
        try:
            return self._measured(setting, blank, sample)
        except InputError as error:
            return replace(blank, status=DOES_NOT_APPLY, note=one_line(error))

    def _blank(self, setting: Setting) -> Row:
        sample = self.samples[setting.point_sources]
        return Row(self.name, "", **asdict(setting), scatterers=sample and sample.scatterers, status=LEFT_OUT)

    def _seconds_of_rays(self, setting: Setting) -> float:
        """What a frame of rays should take, from one with few sources. Raises ValueError where rays do not apply."""
        probe = replace(setting, point_sources=min(PROBE_SOURCES, setting.point_sources)).of(self.assembly)
        begin = time.perf_counter()
        traced = simulate_frame(probe, Pose()).scatterers.count
        seconds, sample = time.perf_counter() - begin, self.samples[setting.point_sources]
        return seconds / max(traced, 1) * (sample.scatterers if sample else traced)

    def _measured(self, setting: Setting, blank: Row, sample: Sample) -> Row:
        """The row of a setting: a first frame at rest, warm ones in turn moved and at rest."""
        assembly = setting.of(self.assembly)
        poses = (Pose(), Pose(x=self.displacement))
        with peak_memory() as memory:
            begin = time.perf_counter()
            rest = simulate_frame(assembly, poses[0])
            first = time.perf_counter() - begin
        times: list[float] = []
        while not times or (
            len(times) < WARM_RUNS and sum(times) + times[-1] < min(WARM_SECONDS, self.allowance.step_left)
        ):
            begin = time.perf_counter()
            frame = simulate_frame(assembly, poses[(len(times) + 1) % 2])
            times.append(time.perf_counter() - begin)
            if len(times) == 1:
                shift = Correlator(rest.image.intensity).shift(frame.image.intensity)
        error, phase = sample.errors(rest.image.field)
        timing = Timing.of(times, first)
        pixel = 1e3 * assembly.detector.pitch
        lost = [] if shift.ok else [f"shift: {shift.status}"]
        along = (shift.u_px * pixel, shift.v_px * pixel) if shift.ok else (None, None)
        return replace(
            blank, status=MEASURED, plan="; ".join(_sums(rest.plan)), scatterers=rest.scatterers.count,
            note="; ".join([*self._shadows(setting), *rest.warnings, *lost]),
            field_error=error, phase_error_wavelengths=phase, shift_u_um=along[0], shift_v_um=along[1],
            seconds_median=timing.median, seconds_q1=timing.q1, seconds_q3=timing.q3, runs=timing.runs,
            seconds_first=timing.first, peak_memory_mb=memory["peak"], added_memory_mb=memory["added"],
            numerical_error=rest.numerical_error if np.isfinite(rest.numerical_error) else None,
        )  # fmt: skip

    def _shadows(self, setting: Setting) -> list[str]:
        """What rays leave out where openings diffract: a note, or nothing."""
        openings = sum(len(channel.openings) for channel in plan_of(self.assembly).channels)
        if setting.method != "rays" or not openings:
            return []
        return ["does not apply: openings diffract; rays cast sharp shadows, however many there are"]

    def _exact(self, count: int) -> Sample | None:
        """The exact sample at N1; None where it would take too long."""
        assembly = with_point_sources(self.assembly, count)
        before = [(n, sample) for n, sample in self.samples.items() if sample is not None]
        tolerance = EXACT_TOLERANCES[0]
        if before:
            last, sample = before[-1]
            expected = sample.seconds
            if self.assembly.elements:
                # Few scatterers cost little beside what every frame takes: the growth so far goes on.
                expected *= max(sample.seconds / before[-2][1].seconds, 1.0) if len(before) > 1 else 1.0
                tolerance = sample.tolerance if expected < SHARE_OF_STEP * self.allowance.left else EXACT_TOLERANCES[1]
            else:
                grown = sample.scatterers * count / last
                expected *= grown * sampled_pixels(grown) / (sample.scatterers * sampled_pixels(sample.scatterers))
            if expected > self.allowance.left:
                return None
        return exact_sample(assembly, tolerance)

    def _with_shift_errors(self, rows: list[Row]) -> list[Row]:
        """Rows with the errors of their shifts, the best field of every N1 taken for exact."""
        done = []
        for row in rows:
            if row.shift_u_um is None:
                done.append(row)
                continue
            peers = [r for r in rows if r.point_sources == row.point_sources and r.shift_u_um is not None]
            best = min(peers, key=lambda r: r.field_error)
            errors = {"shift_error_um": None if row is best else _apart(row, (best.shift_u_um, best.shift_v_um))}
            if self.theory_shift is not None:
                errors["shift_theory_error_um"] = _apart(row, self.theory_shift)
            done.append(replace(row, **errors))
        return done

    # Scatter over surfaces

    def scatter_over_surfaces(self, progress) -> list[Scatter]:
        """Slopes of a translation and a rotation, on as many surfaces as there is time for (at least two)."""
        self.allowance.begin_part("surfaces")
        if self.assembly.target.points is not None:
            return []  # the user's own scatterers are one surface
        counts = [n for n in SCATTER_SOURCES if n <= max(self.point_sources)] or [self.point_sources[0]]
        steps = {"x": self.displacement, "ry": rotation_as_far(self.theory_shift, self.expected)}
        surfaces = self.settings["surfaces"]
        task = progress.add_task("surfaces", total=surfaces)
        slopes = slopes_of_surfaces(
            self.assembly, counts, steps, surfaces, lambda: self.allowance.left, partial(progress.advance, task)
        )
        return [scatter_of(dof, n, steps[dof], np.array(found), self.expected) for (dof, n), found in slopes.items()]


def _nodes_behind_openings(rows: list[Row]) -> int:
    """Nodes on the last opening, as the plans of finished rows tell; 0 without an opening."""
    found = [re.findall(r", (\d+) nodes:", row.plan) for row in rows if row.plan]
    return max((int(nodes[-1]) for nodes in found if nodes), default=0)


def _predicted(setting: Setting, before: tuple[int, float] | None, pixels: int) -> float:
    """Seconds that a frame should take, from (N1, seconds) of an earlier one; 0 where nothing is known.

    Pairs grow like N1, and so does a fast sum once there are more scatterers than pixels; before, less than that.
    """
    if before is None:
        return 0.0
    count, seconds = before
    growth = 1.0 if setting.method in ("direct", "rays") or count > pixels / 10 else 0.5
    return seconds * (setting.point_sources / count) ** growth


def _apart(row: Row, shift: Sequence[float]) -> float:
    return float(np.hypot(row.shift_u_um - shift[0], row.shift_v_um - shift[1]))


def _sums(plan: list[str]) -> list[str]:
    """The lines of a frame's plan that say how the field was summed."""
    return [line for line in plan if line.startswith(("sum to", "rays:"))]
