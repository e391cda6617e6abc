"""``python -m speckle_mi.converge``: error against run time of every method on a scene, and what chance adds to it.

    python -m speckle_mi.converge SCENE --out DIR [--seconds 240] [--point-sources 10,100] [--quick] [-D k=v]

Every method makes the same frame: at rest, and with the target moved a little along x. Its field is judged on pixels
evenly spread over the detector, against the float64 sum over all scatterers (behind openings: against a sum of its own
to 1e-8 on those pixels); its shift against that of the most exact frames, and against first-order theory. A second
part measures how the sensitivity scatters from surface to surface. What would take longer than its share of the time
is left out, and the table says so.
"""

from __future__ import annotations

import csv
import gc
import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np

from .cli import command, load_scene, one_line, say, scene_parser
from .geometry import PlaneGrid, Pose

POINT_SOURCES = (10, 100, 1_000, 10_000, 100_000, 1_000_000)
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
PAPER_RAYS = 1500
"""Rays a source in Opt. Eng. 61(6) 061410 (2022), doi:10.1117/1.OE.61.6.061410."""
RAYS = (16, 36, 64, 100, 400, PAPER_RAYS, 3000)
METHODS = ("auto", "direct", "fast", "rays")
SHARES = {"exact": 0.12, "auto": 0.22, "direct": 0.08, "fast": 0.16, "rays": 0.22, "surfaces": 0.2}
"""Of the time, in the order in which it is spent; what a part leaves over goes to those after it."""
SHARE_OF_ONE = 2 / 3
"""Of a part's time left that one N1 may take, so that the larger ones, which take longest, get their turn."""
DIRECT_TOLERANCE = 1e-6
"""What ``direct`` is asked for behind openings, where it says how finely they are divided."""

QUICK = {
    "point_sources": (10, 100),
    "tolerances": (1e-1, 1e-3, 1e-5),
    "rays": (16, 64),
    "surfaces": 4,
    "seconds": 30.0,
}
FULL = {"point_sources": POINT_SOURCES, "tolerances": TOLERANCES, "rays": RAYS, "surfaces": 24, "seconds": 240.0}

WARM_RUNS, WARM_SECONDS = 7, 0.6
"""Warm runs of a setting, fewer where they take longer than this together; one is always made."""

SHARE_OF_RADIUS = 0.1
"""Displacement along x relative to the beam's radius: the pattern keeps 99 % of its correlation."""

SAMPLED_PAIRS, SAMPLED_PIXELS = 30_000_000, (12, 300)
"""Pairs spent on the exact sum, as far as fewest and most sampled pixels allow."""

EXACT_TOLERANCES = (1e-7, 1e-6)
"""Of the exact field behind elements; the second where the first would take too long."""
PAIRS_PER_SECOND = 1e9
BRIGHT = 0.1
"""Intensity, relative to the mean, from which the phase of a pixel counts."""

SCATTER_SOURCES = (10, 100, 1_000, 10_000)
SCATTER_TOLERANCE = 1e-3
"""Of the frames that the scatter over surfaces is measured on: a thousandth of what chance does to them."""

MEASURED, LEFT_OUT, DOES_NOT_APPLY = "measured", "left out", "does not apply"


@dataclass(frozen=True)
class Setting:
    """One way of making the frame: method, N1, and its accuracy: tolerance, or rays a source N2."""

    method: str
    point_sources: int
    tolerance: float | None = None
    rays_per_source: int | None = None

    @property
    def accuracy(self) -> str:
        if self.rays_per_source is not None:
            return f"N2 = {self.rays_per_source}" + (" (paper)" if self.rays_per_source == PAPER_RAYS else "")
        return "" if self.tolerance is None else f"{self.tolerance:.0e}"

    def of(self, assembly):
        """The assembly with this method, this N1 and one sample a pixel."""
        asked = {name: value for name in ("tolerance", "rays_per_source") if (value := getattr(self, name)) is not None}
        made = with_point_sources(assembly, self.point_sources).with_options(method=self.method, **asked)
        return replace(made, sub_pixels=1)


@dataclass(frozen=True)
class Row:
    """What one setting gave: a row of converge.csv; None where there is nothing to tell.

    plan: how the field was summed; scatterers: summed, those between once and three times the beam's radius included;
    field_error: relative L2, phase_error_wavelengths: rms where the intensity is above a tenth of its mean, both on the
    sampled pixels; shift_error_um against the most exact frames, shift_theory_error_um against first-order theory;
    seconds_*: of a warm frame, from scatterers to field (quartiles over ``runs``), and of the first one;
    peak_memory_mb: of the process in the first run, added_memory_mb: over what it held before.
    """

    scene: str
    plan: str
    method: str
    point_sources: int
    scatterers: int | None
    rays_per_source: int | None
    tolerance: float | None
    status: str
    note: str = ""
    field_error: float | None = None
    phase_error_wavelengths: float | None = None
    shift_u_um: float | None = None
    shift_v_um: float | None = None
    shift_error_um: float | None = None
    shift_theory_error_um: float | None = None
    seconds_median: float | None = None
    seconds_q1: float | None = None
    seconds_q3: float | None = None
    runs: int | None = None
    seconds_first: float | None = None
    peak_memory_mb: float | None = None
    added_memory_mb: float | None = None
    numerical_error: float | None = None

    @property
    def accuracy(self) -> str:
        return Setting(self.method, self.point_sources, self.tolerance, self.rays_per_source).accuracy


@dataclass(frozen=True)
class Sample:
    """The exact field on evenly spaced pixels: every ``step``-th from ``first``, along rows and columns.

    field: complex (rows, columns) of them; scatterers: summed; origin: how it was made; seconds: it took.
    """

    first: int
    step: int
    field: np.ndarray
    scatterers: int
    origin: str
    seconds: float
    tolerance: float

    def errors(self, field: np.ndarray) -> tuple[float, float]:
        """Relative L2 error of a whole field (rows, columns), and rms error of its phase [wavelengths] where bright."""
        found = field[self.first :: self.step, self.first :: self.step]
        power = np.abs(self.field) ** 2
        relative = float(np.sqrt(np.sum(np.abs(found - self.field) ** 2) / np.sum(power)))
        bright = power > BRIGHT * power.mean()
        turns = np.angle(found[bright] * self.field[bright].conj()) / (2 * np.pi)
        return relative, float(np.sqrt(np.mean(turns**2)))


def main(arguments: Sequence[str] | None = None) -> None:
    start = time.perf_counter()
    options = _parser().parse_args(arguments)
    settings = _settings(options)
    folder = Path(options.out)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"{folder}: is a file, must be a folder or a new name")
    scene = load_scene(options.scene, options.defaults, options.variant)
    from .assembly import assembly_from_scene
    from .report import write_json
    from .sysinfo import system_information

    assembly = assembly_from_scene(scene)
    folder.mkdir(parents=True, exist_ok=True)
    study = Study(assembly, Path(options.scene).stem, settings, Allowance(settings["seconds"]))
    with _progress(options.quiet) as progress:
        rows = study.every_method(progress)
        scatter = study.scatter_over_surfaces(progress)
    write_rows(folder / "converge.csv", rows)
    _plot_convergence(folder / "converge.png", rows, f"{study.name}: {_optics_of(rows)}")
    _plot_scatter(folder / "statistics.png", scatter, study.name)
    system = system_information()
    total = time.perf_counter() - start
    write_json(folder / "converge.json", {
        "scene": options.scene, "defaults": options.defaults, "plan": study.plan_lines,
        "displacement": {"dof": "x", "mm": study.displacement}, "theory_shift_um": study.theory_shift,
        "exact": {n: {"pixels": s.field.size, "scatterers": s.scatterers, "origin": s.origin, "seconds": s.seconds}
                  for n, s in study.samples.items() if s is not None},
        "rows": [asdict(row) for row in rows], "statistics": [asdict(entry) for entry in scatter],
        "system": system, "seconds_total": total,
    })  # fmt: skip
    if not options.quiet:
        _print_report(study, rows, scatter, system)
        say(options, f"{folder}: converge.csv, converge.json, converge.png and statistics.png, {total:.0f} s in all")


def _parser():
    parser = scene_parser("converge", "Measures error against run time of every method on a scene.")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    parser.add_argument(
        "--point-sources", metavar="10,100,...", help="values of N1 (default: 10 to 1000000, quick: 10, 100)"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=None,
        help="what the measurements may take; what would take longer is left out (default: 240, quick: 30)",
    )
    parser.add_argument("--quick", action="store_true", help="few values of everything")
    return parser


def _settings(options) -> dict:
    settings = dict(QUICK if options.quick else FULL)
    if options.seconds is not None:
        if not (np.isfinite(options.seconds) and options.seconds > 0):
            raise ValueError(f"--seconds {options.seconds}: must be above 0")
        settings["seconds"] = options.seconds
    if options.point_sources is not None:
        try:
            values = tuple(sorted({int(float(text)) for text in options.point_sources.split(",")}))
        except (ValueError, OverflowError):
            raise ValueError(
                f"--point-sources {options.point_sources!r}: must be numbers with commas between"
            ) from None
        if values[0] < 1:
            raise ValueError(f"--point-sources {options.point_sources!r}: must be at least 1")
        settings["point_sources"] = values
    return settings


def with_point_sources(assembly, count: int):
    """The assembly with ``count`` scatterers expected inside the beam's 1/e^2 footprint (or on the whole target).

    assembly: as it comes from its scene, whose N1 the density is scaled from. A target made of the user's own points
    keeps them.
    """
    target = assembly.target
    density = target.surface.density * count / target.shape.point_sources
    return replace(assembly, target=replace(target, surface=replace(target.surface, density=density)))


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


@dataclass(frozen=True)
class Scatter:
    """How sensitivities scatter at one N1: slopes (surfaces,) [unit] of a motion along a detector axis.

    step: displacement [mm or deg] forth and back; spread: standard deviation over surfaces; theory: None without one.
    """

    dof: str
    axis: str
    unit: str
    step: float
    point_sources: int
    slopes: list[float]
    mean: float
    spread: float
    theory: float | None

    @property
    def scale(self) -> float:
        """What a relative error is relative to."""
        return abs(self.mean if self.theory is None else self.theory)

    def of_means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers of surfaces averaged, standard deviation of such means, and its own relative error."""
        slopes, sizes = np.array(self.slopes), []
        while not sizes or 2 * sizes[-1] <= len(slopes) // 3:
            sizes.append(2 * sizes[-1] if sizes else 1)
        means = [slopes[: len(slopes) // size * size].reshape(-1, size).mean(axis=1) for size in sizes]
        spread = np.array([np.std(m, ddof=1) if len(m) > 1 else np.nan for m in means])
        return np.array(sizes), spread, np.array([1 / np.sqrt(2 * max(len(m) - 1, 1)) for m in means])


class Study:
    """All measurements on one assembly."""

    def __init__(self, assembly, name: str, settings: dict, allowance: Allowance) -> None:
        from .expectation import expected_sensitivity
        from .simulate import plan_of

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
        rows.sort(key=lambda row: (row.point_sources, METHODS.index(row.method)))
        return self._with_shift_errors(rows)

    def _accuracies(self, method: str) -> list[dict]:
        if method == "rays":
            return [{"rays_per_source": count} for count in self.settings["rays"]]
        if method == "direct":
            return [{"tolerance": DIRECT_TOLERANCE if self.assembly.elements else None}]
        return [{"tolerance": tolerance} for tolerance in self.settings["tolerances"]]

    def _one_method(self, method: str, accuracies: list[dict], advance: Callable[[], None]) -> list[Row]:
        rows: list[Row] = []
        history: dict[int, tuple[int, float]] = {}
        for count in self.point_sources:
            self.allowance.begin_step(1.0 if count == self.point_sources[-1] else SHARE_OF_ONE)
            coarser = 0.0
            for number, accuracy in enumerate(accuracies):
                setting = Setting(method, count, **accuracy)
                # The next accuracy is not faster than the one before, whether that was measured or left out.
                expected = _predicted(setting, history.get(number), self.assembly.detector.size)
                if method == "direct" and not history:
                    expected = self._nodes * self.assembly.detector.size / PAIRS_PER_SECOND
                row = self._one_setting(setting, max(expected, coarser))
                if row.status == MEASURED:
                    history[number], coarser = (count, row.seconds_median), row.seconds_median
                else:
                    coarser = max(expected, coarser)
                rows.append(row)
                advance()
                if row.status == DOES_NOT_APPLY:
                    return rows
        return rows

    def _one_setting(self, setting: Setting, seconds: float) -> Row:
        """One row; ``seconds`` is what a frame should take, 0 if nobody knows."""
        sample = self.samples[setting.point_sources]
        blank = Row(self.name, "", **asdict(setting), scatterers=sample and sample.scatterers, status=LEFT_OUT)
        if sample is None:
            return replace(blank, note="the exact sum to compare with would take too long")
        if 2 * seconds > self.allowance.step_left:
            note = f"would take about {_duration(seconds)} a frame" if seconds else "no time left"
            return replace(blank, note=note)
        try:
            return self._measured(setting, blank, sample)
        except ValueError as error:
            return replace(blank, status=DOES_NOT_APPLY, note=one_line(error))

    def _measured(self, setting: Setting, blank: Row, sample: Sample) -> Row:
        """The row of a setting: a first frame at rest, warm ones in turn moved and at rest."""
        from .correlate import Correlator
        from .simulate import simulate_frame

        assembly = setting.of(self.assembly)
        poses = (Pose(), Pose(x=self.displacement))
        with _memory() as memory:
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
        quartiles = [float(value) for value in np.quantile(times, (0.5, 0.25, 0.75))]
        pixel = 1e3 * assembly.detector.pitch
        along = (shift.u_px * pixel, shift.v_px * pixel) if shift.ok else (None, None)
        return replace(
            blank, status=MEASURED, plan="; ".join(_sums(rest.plan)), scatterers=rest.scatterers.count,
            note="; ".join([*rest.warnings, *([] if shift.ok else [f"shift: {shift.status}"])]),
            field_error=error, phase_error_wavelengths=phase, shift_u_um=along[0], shift_v_um=along[1],
            seconds_median=quartiles[0], seconds_q1=quartiles[1], seconds_q3=quartiles[2], runs=len(times),
            seconds_first=first, peak_memory_mb=memory["peak"], added_memory_mb=memory["added"],
            numerical_error=rest.numerical_error if np.isfinite(rest.numerical_error) else None,
        )  # fmt: skip

    def _exact(self, count: int) -> Sample | None:
        """The exact sample at N1; None where it would take too long."""
        assembly = with_point_sources(self.assembly, count)
        before = [(n, sample) for n, sample in self.samples.items() if sample is not None]
        tolerance = EXACT_TOLERANCES[0]
        if before and self.assembly.elements:
            tolerance = before[-1][1].tolerance
            if before[-1][1].seconds * count / before[-1][0] > self.allowance.left:
                tolerance = EXACT_TOLERANCES[1]
        if self.allowance.left <= 0 and before:
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
        surfaces = self.settings["surfaces"]
        steps = {"x": self.displacement, "ry": self._rotation()}
        slopes: dict[tuple[str, int], list[tuple[float, float]]] = {(dof, n): [] for dof in steps for n in counts}
        task = progress.add_task("surfaces", total=surfaces)
        longest = 0.0
        for number in range(surfaces):
            begin = time.perf_counter()
            if number >= 2 and longest > self.allowance.left:
                break
            for count in counts:
                for dof, slope in self._slopes(count, self.assembly.seed + number, steps).items():
                    slopes[dof, count].append(slope)
            longest = max(longest if number > 1 else 0.0, time.perf_counter() - begin)  # the first one compiles
            progress.advance(task)
        return [self._scatter(dof, count, steps[dof], np.array(values)) for (dof, count), values in slopes.items()]

    def _rotation(self) -> float:
        """Rotation [deg] that moves the pattern about as far as the displacement along x does."""
        if self.theory_shift is None:
            return 0.005
        per_degree = float(np.hypot(self.expected["u"][4], self.expected["v"][4]))
        return float(np.clip(1e-3 * np.hypot(*self.theory_shift) / max(per_degree, 1e-9), 1e-3, 0.1))

    def _slopes(self, count: int, seed: int, steps: dict[str, float]) -> dict[str, tuple[float, float]]:
        """Sensitivities (u, v) [mm/mm, mm/deg] of one surface, from displacements forth and back."""
        from .correlate import Correlator
        from .simulate import simulate

        assembly = Setting("auto", count, SCATTER_TOLERANCE).of(self.assembly).with_seed(seed)
        correlator = Correlator(simulate(assembly, Pose()).intensity)
        found = {}
        for dof, step in steps.items():
            forth, back = (correlator.shift(simulate(assembly, Pose(**{dof: s * step})).intensity) for s in (1, -1))
            scale = assembly.detector.pitch / (2 * step)
            found[dof] = ((forth.u_px - back.u_px) * scale, (forth.v_px - back.v_px) * scale)
        return found

    def _scatter(self, dof: str, count: int, step: float, slopes: np.ndarray) -> Scatter:
        slopes = slopes[np.all(np.isfinite(slopes), axis=1)]
        number = {"x": 0, "ry": 4}[dof]
        expected = [None if values is None else float(values[number]) for values in self.expected.values()]
        size = (
            [abs(value) for value in expected]
            if None not in expected
            else np.abs(slopes.mean(axis=0))
            if len(slopes)
            else [1, 0]
        )
        k = int(np.argmax(size))
        values = slopes[:, k]
        mean = float(values.mean()) if len(values) else np.nan
        spread = float(np.std(values, ddof=1)) if len(values) > 1 else np.nan
        unit = "mm/deg" if dof == "ry" else "mm/mm"
        return Scatter(dof, "uv"[k], unit, step, count, values.tolist(), mean, spread, expected[k])


def exact_sample(assembly, tolerance: float) -> Sample:
    """The exact field of an assembly at rest on evenly spread pixels, by a way of its own.

    In free space the float64 sum over all scatterers as it stands, in NumPy. With elements a sum on those pixels alone
    to ``tolerance``, its openings divided accordingly, each stage checked against its own exact sum on sampled points.
    """
    from .lobe import lobe_towards
    from .propagation import FreeSpace
    from .propagation.reference import reference_sum
    from .simulate import simulate_frame

    begin = time.perf_counter()
    assembly = replace(assembly, sub_pixels=1)
    probe = replace(assembly, detector=_every(assembly.detector, 0, max(assembly.detector.shape)))
    lit = simulate_frame(probe.with_options(method="direct"), Pose()).scatterers if not assembly.elements else None
    pairs = SAMPLED_PAIRS / max(lit.count, 1) if lit else SAMPLED_PIXELS[1]
    step = int(np.ceil(np.sqrt(assembly.detector.size / np.clip(pairs, *SAMPLED_PIXELS))))
    first = min(step, *assembly.detector.shape) // 2
    grid = _every(assembly.detector, first, step)
    if lit is not None:
        points = grid.points()
        field = reference_sum(FreeSpace(), lit.position, lit.amplitude, points, assembly.beam.wavelength)
        if assembly.target.lobe:
            field = field * lobe_towards(assembly, assembly.target.frame, points - assembly.target.spot)
        origin, scatterers = "float64 sum in NumPy", lit.count
    else:
        frame = simulate_frame(
            replace(assembly, detector=grid).with_options(method="auto", tolerance=tolerance), Pose()
        )
        field, scatterers = frame.image.field, frame.scatterers.count
        origin = f"sum on the sampled pixels to {tolerance:.0e}, its own error {frame.numerical_error:.0e}"
    return Sample(first, step, field.reshape(grid.shape), scatterers, origin, time.perf_counter() - begin, tolerance)


def _nodes_behind_openings(rows: list[Row]) -> int:
    """Nodes on the last opening, as the plans of finished rows tell; 0 without an opening."""
    found = [re.findall(r", (\d+) nodes:", row.plan) for row in rows if row.plan]
    return max((int(nodes[-1]) for nodes in found if nodes), default=0)


def _every(grid: PlaneGrid, first: int, step: int) -> PlaneGrid:
    """Every ``step``-th pixel of a grid from ``first`` on, along rows and columns."""
    shape = tuple(len(range(first, n, step)) for n in grid.shape)
    return replace(
        grid, origin=grid.origin + first * grid.pitch * (grid.u + grid.v), pitch=step * grid.pitch, shape=shape
    )


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


def _optics_of(rows: list[Row]) -> str:
    counts = sorted({row.scatterers for row in rows if row.status == MEASURED and row.scatterers})
    return f"{counts[0]:,} to {counts[-1]:,} scatterers summed" if counts else "nothing measured"


@contextmanager
def _memory() -> Iterator[dict[str, float | None]]:
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


def write_rows(path: str | os.PathLike, rows: list[Row]) -> None:
    """Writes a row a setting; what was not measured is empty."""
    from .files import replacing

    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [column.name for column in fields(Row)])
        writer.writeheader()
        for row in rows:
            writer.writerow({name: "" if value is None else value for name, value in asdict(row).items()})


def _progress(quiet: bool):
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<8}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=Console(stderr=True), disable=quiet, transient=True)


# Pictures

LOOKS = {
    "rays": ("#D55E00", "s", "rays (the paper's way), $N_2$ along the line"),
    "direct": ("#009E73", "D", "direct"),
    "fast": ("#56B4E9", "^", "fast, tolerance along the line"),
    "auto": ("#0072B2", "o", "auto, tolerance along the line"),
}
"""Colour (Okabe and Ito), marker and name of a method."""


def _plot_convergence(path: Path, rows: list[Row], title: str) -> None:
    """Error of the field against run time, a panel for every N1, both axes logarithmic."""
    from . import plots

    counts = sorted({row.point_sources for row in rows if row.status == MEASURED})
    columns = min(len(counts), 3) or 1
    lines = -(-len(counts) // columns) or 1
    figure = plots._figure(max(3.0 * columns + 0.6, 5.4), 2.75 * lines + 0.9)
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for panel in panels.flat[len(counts) :]:
        panel.set_visible(False)
    for panel, count in zip(panels.flat, counts, strict=False):
        own = [row for row in rows if row.point_sources == count]
        panel.set(xscale="log", yscale="log")
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(color="0.92", linewidth=0.7)
        panel.tick_params(labelsize=plots.FONT - 1)
        for method in LOOKS:
            _draw_method(panel, [row for row in own if row.method == method and row.status == MEASURED], method)
        summed = max(row.scatterers or 0 for row in own)
        panel.set_title(f"$N_1$ = {_power(count)}  ({summed:,} summed)", loc="left", fontsize=plots.FONT)
        absent = [m for m in LOOKS if not any(r.method == m and r.status == MEASURED for r in own)]
        if absent:
            panel.text(0.02, 0.02, f"too slow or not applicable: {', '.join(absent)}", transform=panel.transAxes,
                       ha="left", va="bottom", fontsize=plots.FONT - 3, color="0.4")  # fmt: skip
    _whole_decades(panels[0, 0])
    for number, panel in enumerate(panels.flat[: len(counts)]):
        if number + columns >= len(counts):
            panel.set_xlabel("run time of a frame (s)")
            panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            panel.tick_params(labelbottom=True)
    for panel in panels[:, 0]:
        panel.set_ylabel("relative error of the field")
    figure.suptitle(title, x=0.01, ha="left", fontsize=plots.FONT + 1)
    _legend_below(figure, *panels.flat, columns=2)
    plots._write(figure, path)


def _whole_decades(axes) -> None:
    """Limits at powers of ten, so that every axis has two labels at least."""
    from matplotlib.ticker import LogLocator, NullFormatter

    for axis, limits in ((axes.xaxis, axes.set_xlim), (axes.yaxis, axes.set_ylim)):
        low, high = axis.get_data_interval()
        if np.isfinite([low, high]).all() and 0 < low <= high:
            limits(10 ** np.floor(np.log10(low / 1.1)), 10 ** np.ceil(np.log10(high * 1.1)))
        axis.set_major_locator(LogLocator(numticks=8))
        axis.set_minor_formatter(NullFormatter())


def _legend_below(figure, *axes, columns: int) -> None:
    """One legend for all axes below them, so that the title has the space above."""
    from .plots import FONT

    entries: dict[str, object] = {}
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        style = {"frameon": False, "fontsize": FONT - 1, "handlelength": 1.8, "columnspacing": 1.6}
        figure.legend(entries.values(), entries.keys(), loc="outside lower left", ncols=columns, **style)


def _draw_method(panel, rows: list[Row], method: str) -> None:
    if not rows:
        return
    colour, marker, name = LOOKS[method]
    x, low, high, y = (np.array([getattr(row, n) for row in rows], float)
                       for n in ("seconds_median", "seconds_q1", "seconds_q3", "field_error"))  # fmt: skip
    # fast and auto often do the same: the open, larger mark of the one shows around the full one of the other.
    face, size = ("none", 7.5) if method == "fast" else (colour, 4.5)
    panel.errorbar(
        x,
        np.maximum(y, 1e-16),
        xerr=np.stack([x - low, high - x]),
        fmt=f"{marker}-",
        color=colour,
        label=name,
        markersize=size,
        markerfacecolor=face,
        linewidth=1.0,
        elinewidth=0.9,
        zorder=3 if method != "fast" else 2,
    )
    for row in rows:
        if row.rays_per_source == PAPER_RAYS:
            panel.plot(row.seconds_median, row.field_error, "o", color="0.15", markersize=10, markerfacecolor="none",
                       label=f"the paper's {PAPER_RAYS} rays", zorder=4)  # fmt: skip


def _power(count: int) -> str:
    exponent = round(np.log10(count)) if count > 0 else 0
    return f"$10^{exponent}$" if count == 10**exponent and exponent > 1 else f"{count:,}"


def _plot_scatter(path: Path, scatter: list[Scatter], name: str) -> None:
    """Left: the mean's statistical error against the number of surfaces. Right: one surface's against N1."""
    from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

    from . import plots

    figure = plots._figure(8.4, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    # Relative to a sensitivity of next to nothing, such as that of a focused image to tilt, no error means anything.
    moved = max((entry.scale * entry.step for entry in scatter if np.isfinite(entry.scale)), default=0.0)
    usable = [entry for entry in scatter if entry.spread > 0 and entry.scale * entry.step > 0.2 * moved]
    shades = ("#E69F00", "#CC79A7", "#56B4E9", "#0072B2")
    markers = "sv^o"
    for axes in (left, right):
        axes.set(xscale="log", yscale="log")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="0.92", linewidth=0.7)
        axes.tick_params(labelsize=plots.FONT - 1)
    for number, entry in enumerate(entry for entry in usable if entry.dof == "x"):
        sizes, spread, own = entry.of_means()
        percent = 100 / entry.scale
        style = {"color": shades[number % 4], "markersize": 5, "capsize": 2.5, "elinewidth": 1}
        left.errorbar(sizes, percent * spread, percent * spread * own, fmt=markers[number % 4],
                      label=f"mean, motion along x, $N_1$ = {_power(entry.point_sources)}", **style)  # fmt: skip
        left.plot(sizes, percent * entry.spread / np.sqrt(sizes), color=shades[number % 4], linewidth=1)
    for dof, colour, marker in (("x", plots.MEAN, "o"), ("ry", plots.THEORY, "s")):
        own = [entry for entry in usable if entry.dof == dof]
        if own:
            value = np.array([100 * e.spread / e.scale for e in own])
            bar = value / np.sqrt(2 * np.array([max(len(e.slopes) - 1, 1) for e in own]))
            label = "motion along x" if dof == "x" else "rotation about y"
            right.errorbar([e.point_sources for e in own], value, bar, fmt=f"{marker}-", color=colour, markersize=5,
                           capsize=2.5, linewidth=1, label=f"{label}, one surface")  # fmt: skip
    if not usable:
        left.text(0.5, 0.5, "no scatter measured", transform=left.transAxes, ha="center", color="0.4")
    _whole_decades(right)
    for axes in (left, right):
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
    counts = [entry.point_sources for entry in usable] or [1]
    right.set_xlim(min(counts) / 2, max(counts) * 2)
    left.xaxis.set_major_locator(FixedLocator(sorted({int(n) for entry in usable for n in entry.of_means()[0]}) or [1]))
    left.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    left.xaxis.set_minor_locator(NullLocator())
    left.set_xlabel("surfaces averaged (lines: $1/\\sqrt{n}$)")
    right.set_xlabel("point sources $N_1$ inside the beam's radius")
    left.set_ylabel("statistical error of the sensitivity (%)")
    surfaces = max((len(entry.slopes) for entry in scatter), default=0)
    figure.suptitle(
        f"{name}: scatter of the sensitivity over {surfaces} surfaces", x=0.01, ha="left", fontsize=plots.FONT + 1
    )
    _legend_below(figure, left, right, columns=3)
    plots._write(figure, path)


# Words


def _print_report(study: Study, rows: list[Row], scatter: list[Scatter], system: dict[str, str]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if os.isatty(1) else 150, highlight=False)
    for line in study.plan_lines:
        console.print(f"plan: {line}", markup=False)
    table = Table(
        title=f"{study.name}: errors of field, phase and shift; warm and first run times; peak memory",
        box=box.SIMPLE_HEAD,
        title_justify="left",
    )
    heads = ("N1", "method", "tol. or N2", "field", "phase (waves)", "shift (um)", "- theory", "frame (ms)",
             "quartiles", "runs", "first", "MB")  # fmt: skip
    for number, head in enumerate(heads):
        table.add_column(head, justify="left" if number in (1, 2) else "right", no_wrap=True)
    shown = [row for row in rows if row.status == MEASURED]
    for number, row in enumerate(shown):
        ends = number + 1 == len(shown) or shown[number + 1].point_sources != row.point_sources
        table.add_row(*_cells(row), end_section=ends)
    console.print(table)
    for words in _notes(rows):
        console.print(words, markup=False)
    _print_exact(console, study)
    _print_scatter(console, scatter)
    names = ("processor", "cores", "system", "speckle_mi", "python", "mitsuba", "drjit", "numpy", "finufft", "LLVM")
    console.print("machine: " + ", ".join(f"{name} {system[name]}" for name in names if name in system), markup=False)


def _cells(row: Row) -> list[str]:
    """The cells of a row that was measured."""
    quartiles = f"{_ms(row.seconds_q1)} - {_ms(row.seconds_q3)}" if row.runs > 1 else ""
    shift = "lost" if row.shift_u_um is None else "exact" if row.shift_error_um is None else _sig(row.shift_error_um)
    return [
        f"{row.point_sources:,}", row.method, row.accuracy, _sig(row.field_error), _sig(row.phase_error_wavelengths),
        shift, _sig(row.shift_theory_error_um), _ms(row.seconds_median), quartiles, str(row.runs),
        _ms(row.seconds_first), "" if row.peak_memory_mb is None else f"{row.peak_memory_mb:.0f}",
    ]  # fmt: skip


def _notes(rows: list[Row]) -> list[str]:
    """What was left out and why, a line for each method and N1; warnings of what was measured, once each."""
    groups: dict[tuple[str, int], list[Row]] = {}
    for row in rows:
        if row.status != MEASURED:
            groups.setdefault((row.method, row.point_sources), []).append(row)
    lines = []
    for (method, count), group in groups.items():
        which = (
            f", {group[0].accuracy}" + (f" to {group[-1].accuracy}" if len(group) > 1 else "")
            if group[0].accuracy
            else ""
        )
        what = method if group[0].status == DOES_NOT_APPLY else f"{method}, N1 = {count:,}{which}"
        lines.append(f"{what}: {group[0].status}, {group[0].note}")
    return lines + sorted({f"{row.method}: {row.note}" for row in rows if row.status == MEASURED and row.note})


def _print_exact(console, study: Study) -> None:
    held = [f"N1 = {n:,}: {s.field.size} pixels, {s.origin}" for n, s in study.samples.items() if s is not None]
    console.print("errors of field and phase against: " + "; ".join(held), markup=False)
    theory = "none" if study.theory_shift is None else "({:.3f}, {:.3f}) um".format(*study.theory_shift)
    moved = f"shift: target moved {1e3 * study.displacement:.3g} um along x, first-order theory {theory}"
    console.print(f'{moved}; errors against the most exact frames of each N1 ("exact"), and from theory, '
                  "which one surface only scatters about", markup=False)  # fmt: skip


def _print_scatter(console, scatter: list[Scatter]) -> None:
    from rich import box
    from rich.table import Table

    if not scatter:
        return
    table = Table(title="Scatter of the sensitivity over surfaces", box=box.SIMPLE_HEAD, title_justify="left")
    for number, head in enumerate(("motion", "axis", "N1", "surfaces", "mean", "theory", "one surface ±", "mean ±")):
        table.add_column(head, justify="left" if number < 2 else "right")
    for e in scatter:
        theory = "-" if e.theory is None else f"{e.theory:+.4f}"
        of_mean = e.spread / np.sqrt(max(len(e.slopes), 1))
        values = (f"{e.mean:+.4f} {e.unit}", theory, f"{e.spread:.4f}", f"{of_mean:.4f}")
        table.add_row(
            e.dof,
            e.axis,
            f"{e.point_sources:,}",
            str(len(e.slopes)),
            *(values if e.slopes else ("not measured", theory)),
        )
    console.print(table)


def _sig(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.1e}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:,.3g}" if seconds < 1 else f"{1e3 * seconds:,.0f}"


def _duration(seconds: float) -> str:
    for unit, size, limit in (("ms", 1e-3, 1.0), ("s", 1.0, 100.0), ("min", 60.0, 6e3), ("h", 3600.0, 2e5)):
        if seconds < limit:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 86400:.3g} days"


if __name__ == "__main__":
    raise SystemExit(command(main))
