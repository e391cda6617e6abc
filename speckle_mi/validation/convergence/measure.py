"""Measures one setting: a first frame at rest, warm ones in turn moved and at rest, their error, shift and memory."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...field.simulation import Simulation
from ...geometry.pose import Pose
from ...machine.run_times import Timing, duration
from ...measurement.correlator import Correlator
from ...plan.stage import RAYS, SUM, Stage
from ...scene.errors import one_line
from .exact import ExactField
from .frame import DOES_NOT_APPLY, LEFT_OUT, MEASURED, Row, Setting
from .subject import Subject

WARM_RUNS, WARM_SECONDS = 7, 0.6
"""Warm runs of a setting, fewer where they take longer than this together; one is always made."""


def row_of(
    subject: Subject, setting: Setting, exact: ExactField | None, seconds: float, time_left: Callable[[], float]
) -> Row:
    """The row of a setting, measured where there is time for it.

    exact: the field to judge it by, None where there is none; seconds: what a frame should take, 0 if nobody knows;
    time_left: tells the time [s] that there still is.
    """
    blank = blank_row(subject, setting, exact)
    if exact is None:
        return replace(blank, note="the exact sum to compare with would take too long")
    if 2 * seconds > time_left():
        note = f"would take about {duration(seconds)} a frame" if seconds else "no time left"
        return replace(blank, note=note)
    try:
        return _measured(subject, setting, blank, exact, time_left)
    except InputError as error:
        return does_not_apply(blank, error)


def blank_row(subject: Subject, setting: Setting, exact: ExactField | None) -> Row:
    """A row that is left out, still without a reason."""
    return Row(subject.name, "", **asdict(setting), scatterers=exact and exact.scatterers, status=LEFT_OUT)


def does_not_apply(blank: Row, error: Exception) -> Row:
    """The row of a method that refuses a scene, with what it says."""
    return replace(blank, status=DOES_NOT_APPLY, note=one_line(error))


def _measured(
    subject: Subject, setting: Setting, blank: Row, exact: ExactField, time_left: Callable[[], float]
) -> Row:
    assembly = setting.of(subject.assembly)
    simulation = Simulation(assembly)
    poses = (Pose(), Pose(x=subject.displacement))
    with peak_memory() as memory:
        begin = time.perf_counter()
        rest = simulation.frame(poses[0])
        first = time.perf_counter() - begin
    times: list[float] = []
    while not times or (len(times) < WARM_RUNS and sum(times) + times[-1] < min(WARM_SECONDS, time_left())):
        begin = time.perf_counter()
        frame = simulation.frame(poses[(len(times) + 1) % 2])
        times.append(time.perf_counter() - begin)
        if len(times) == 1:
            shift = Correlator(rest.image.intensity).shift(frame.image.intensity)
    error, phase = exact.errors(rest.image.field)
    timing = Timing.of(times, first)
    pixel = 1e3 * assembly.detector.pitch
    lost = [] if shift.ok else [f"shift: {shift.status}"]
    along = (shift.u_px * pixel, shift.v_px * pixel) if shift.ok else (None, None)
    return replace(
        blank, status=MEASURED, plan="; ".join(map(str, _sums(rest.stages))), scatterers=rest.scatterers.count,
        note="; ".join([*_shadows(subject, setting), *rest.warnings, *lost]),
        field_error=error, phase_error_wavelengths=phase, shift_u_um=along[0], shift_v_um=along[1],
        seconds_median=timing.median, seconds_q1=timing.q1, seconds_q3=timing.q3, runs=timing.runs,
        seconds_first=timing.first, peak_memory_mb=memory["peak"], added_memory_mb=memory["added"],
        numerical_error=rest.numerical_error if np.isfinite(rest.numerical_error) else None,
        opening_nodes=next((stage.nodes for stage in reversed(rest.stages) if stage.nodes is not None), None),
    )  # fmt: skip


def _shadows(subject: Subject, setting: Setting) -> list[str]:
    """What rays leave out where openings diffract: a note, or nothing."""
    if setting.method != "rays" or not subject.openings:
        return []
    return ["does not apply: openings diffract; rays cast sharp shadows, however many there are"]


def _sums(stages: tuple[Stage, ...]) -> list[Stage]:
    """The stages of a frame that say how the field was summed."""
    return [stage for stage in stages if stage.kind in (SUM, RAYS)]


@contextmanager
def peak_memory() -> Iterator[dict[str, float | None]]:
    """Peak resident memory [MB] of the process while the block runs, and how much above the start that is.

    Needs Linux, whose high-water mark can be reset; None elsewhere.
    """
    import drjit as dr

    found: dict[str, float | None] = {"peak": None, "added": None}
    gc.collect()
    dr.flush_malloc_cache()
    before = None
    try:
        Path("/proc/self/clear_refs").write_text("5")
        before = _status("VmRSS")
    except OSError:
        pass
    yield found
    if before is not None:
        peak = _status("VmHWM")
        found.update(peak=peak, added=max(peak - before, 0.0))


def _status(name: str) -> float:
    """An entry of this process's status [MB]."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) / 1024
    raise OSError(f"/proc/self/status has no {name}")
