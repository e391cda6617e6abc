"""Sensitivities from one frame a surface: the pattern's velocity for every motion, on pixels that are sampled.

What a sweep measures from many displaced frames is, in the limit of small displacements, in one frame and its
derivatives. The cost does not grow with the detector: a few pixels a speckle are looked at, or ``MOST_PIXELS``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from ..errors import InputError
from ..field.detectors import Simulations
from ..field.simulation import Simulation
from ..geometry.plane import PlaneGrid
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation, sensitivity_unit
from ..machine.cores import products_on_one_thread
from ..measurement.sensitivity import CONFIDENCE, Sensitivity
from ..measurement.velocity import SPECKLES, Flow, PatternVelocity, half_correlation
from ..scattering.rough_surface import Scatterers
from ..scene.assembly import Assembly
from ..scene.errors import SceneError
from .chief_ray import SeenAxes, axes_as_seen
from .expectation import AXES, CENTRE_AXES, expected_sensitivity, on_all_axes

PIXELS_A_SPECKLE, FEWEST_PIXELS, MOST_PIXELS = 4.0, 1024, 3072
"""Pixels that are looked at: so many a speckle, within these bounds. Four hold nearly all that a speckle tells."""

SAMPLE_SEED = 11
"""Of the pixels' places: they are the same for every surface."""

SURFACES = 8
"""Surfaces that are measured unless asked otherwise."""

RANGE = 0.2
"""Width of the range of displacements [mm or deg] for which scatter is stated unless asked otherwise: a sweep's own."""

CLEARLY = 3.0
"""Standard errors from which a curvature of the velocity over the detector is taken to be there."""

ONE_SURFACE = "one surface: the interval is from its own speckles and leaves out what they share"
CENTRE_BY_SWEEP = "a sweep measures the centre of gravity: that of one frame is lost in its speckle"


@dataclass
class OneFrameResult:
    """Velocities of the patterns of several surfaces, as they are measured.

    linear, curved: of every surface, the velocity without and with curvature over the detector (the same where there
    are too few speckles); seeds: of the surfaces; pixels: how many were looked at; speckles: about how many there are;
    error: relative L2 error that fields and derivatives were computed to.
    """

    linear: list[PatternVelocity] = field(default_factory=list)
    curved: list[PatternVelocity] = field(default_factory=list)
    seeds: list[int] = field(default_factory=list)
    pixels: int = 0
    speckles: float = 0.0
    seconds: float = 0.0
    error: float = 0.0


class OneFrame:
    """The measurement on one simulation: holds which pixels are looked at."""

    def __init__(self, simulation: Simulation, pixels: int | None = None) -> None:
        """pixels: how many are looked at, about; as many as the speckles need unless given."""
        self.simulation = simulation
        self._grid = simulation.assembly.detector
        self._as_needed = pixels is None
        self._pixels = sampled_pixels(self._grid, pixels or FEWEST_PIXELS)
        self.result = OneFrameResult(pixels=len(self._pixels))

    def measure(self, seeds: Iterable[int], done: Callable[[], None] = lambda: None) -> None:
        """Adds surfaces to the result. Raises SceneError where the field cannot be computed as asked, InputError where
        the detector stays dark."""
        for seed in seeds:
            self.add(seed)
            done()

    @products_on_one_thread()
    def add(self, seed: int, lit: tuple[Scatterers, ...] | None = None) -> None:
        """Adds one surface. lit: its scatterers at rest, of :meth:`Simulation.lit`, where they are known."""
        began = time.perf_counter()
        flow = self._flow(seed, lit)
        if not self.result.seeds:
            flow = self._with_enough_pixels(flow, seed, lit)
        degree = max(n for n, fewest in enumerate(SPECKLES) if self.result.speckles >= fewest)
        self.result.linear.append(flow.velocity(min(degree, 1)))
        self.result.curved.append(flow.velocity(degree))
        self.result.seeds.append(seed)
        self.result.seconds += time.perf_counter() - began

    def _flow(self, seed: int, lit: tuple[Scatterers, ...] | None) -> Flow:
        found = self.simulation.derivatives(self._pixels, seed, lit)
        self.result.error = max(self.result.error, found.error)
        rows, columns = np.divmod(self._pixels, self._grid.shape[1])
        middle = (np.array(self._grid.shape) - 1) / 2
        places = self._grid.pitch * np.stack([columns - middle[1], rows - middle[0]], axis=1)
        return Flow.of(found.field, found.by_motion, found.along, places)

    def _with_enough_pixels(self, flow: Flow, seed: int, lit: tuple[Scatterers, ...] | None) -> Flow:
        """The first surface tells how many pixels its speckles need."""
        area = self._grid.size * self._grid.pitch**2
        self.result.speckles = flow.speckles(area)
        wanted = int(np.clip(PIXELS_A_SPECKLE * self.result.speckles, FEWEST_PIXELS, MOST_PIXELS))
        if not self._as_needed or wanted <= len(self._pixels) or len(self._pixels) == self._grid.size:
            return flow
        self._pixels = sampled_pixels(self._grid, wanted)
        self.result.pixels = len(self._pixels)
        return self._flow(seed, lit)


class OneFrameOfEach:
    """The measurement on several detectors, each from the same scatterers."""

    def __init__(self, simulations: Simulations) -> None:
        self._simulations = simulations
        self._measurements = {name: OneFrame(one) for name, one in simulations.by_detector.items()}

    @property
    def results(self) -> dict[str, OneFrameResult]:
        """What was measured, by detector."""
        return {name: one.result for name, one in self._measurements.items()}

    def measure(self, seeds: Iterable[int], done: Callable[[], None] = lambda: None) -> None:
        """Adds surfaces to all results. Raises as :meth:`OneFrame.measure`, an InputError names the detector."""
        for seed in seeds:
            lit = self._simulations.first.lit(Pose(), seed)
            for name, measurement in self._measurements.items():
                try:
                    measurement.add(seed, lit)
                except InputError as error:
                    if len(self._measurements) == 1 or isinstance(error, SceneError):
                        raise
                    raise InputError(f"detector {name!r}: {error}") from None
            done()


def sampled_pixels(grid: PlaneGrid, count: int) -> np.ndarray:
    """Flat indices, about ``count``, of pixels spread evenly: one at a random place in each of as many cells."""
    rows, columns = grid.shape
    across = int(np.clip(np.rint(np.sqrt(count * columns / rows)), 1, columns))
    down = int(np.clip(np.rint(count / across), 1, rows))
    random = np.random.default_rng(SAMPLE_SEED)
    place = random.random((2, down, across))
    column = (np.arange(across) + place[0]) / across * columns
    row = (np.arange(down)[:, None] + place[1]) / down * rows
    return np.unique(row.astype(np.int64) * columns + column.astype(np.int64))


@dataclass(frozen=True)
class OneFrameSensitivity:
    """What one frame a surface tells of a sensor.

    fits: for every motion and axis the sensitivity, with its scatter, to first order, over a range of displacements;
    scatter: standard deviation over surfaces of every sensitivity [mm/mm or mm/deg], NaN of one alone; boiling: share
    of the change that is not motion; decorrelation_length: displacement at which correlation falls to one half [mm or
    deg], by the Gaussian law of the measured curvature; seen: the detector's axes as the target sees them; result: what
    it was made of.
    """

    fits: dict[str, dict[str, Sensitivity]]
    scatter: dict[str, dict[str, float]]
    boiling: dict[str, float]
    decorrelation_length: dict[str, float]
    seen: SeenAxes
    result: OneFrameResult


def sensitivity_of(
    simulation: Simulation, result: OneFrameResult, dofs: tuple[str, ...], width: float = RANGE
) -> OneFrameSensitivity:
    """Sensitivities to some of the six motions from what was measured, beside what theory expects.

    width: of the range of evenly spread displacements [mm or deg] for which the scatter of shifts is stated.
    """
    assembly, plan = simulation.assembly, simulation.plan(Pose())
    seen, expected = axes_as_seen(assembly, plan), expected_sensitivity(assembly, plan)
    fits: dict[str, dict[str, Sensitivity]] = {}
    scatter, boiling, length = {}, {}, {}
    for dof in dofs:
        number = DEGREES_OF_FREEDOM.index(dof)
        scale = np.pi / 180 if is_rotation(dof) else 1.0
        linear, curved = (_of_motion(velocities, dof, assembly, seen) for velocities in (result.linear, result.curved))
        size = np.hypot(*linear.values[:2].mean(axis=1))
        fits[dof], scatter[dof] = {}, {}
        for row, axis in enumerate(AXES):
            theory = None if expected[axis] is None else float(expected[axis][number])
            unit = sensitivity_unit(dof)
            if axis in CENTRE_AXES:
                fits[dof][axis] = _not_measured(theory, unit)
            else:
                fit, spread = _fit(linear.axis(row), curved.axis(row), result.error * size, theory, unit)
                fits[dof][axis] = replace(fit, scatter_um=1e3 * spread * width / np.sqrt(12))
                scatter[dof][axis] = spread
        curvature = np.mean([one.curvature[number] for one in result.curved]) * scale**2
        boiling[dof] = float(np.mean([one.boiling[number] for one in result.curved]))
        length[dof] = float(half_correlation(curvature))
    return OneFrameSensitivity(fits, scatter, boiling, length, seen, result)


def one_frame_sensitivity(
    assembly: Assembly, dofs: tuple[str, ...] = DEGREES_OF_FREEDOM, surfaces: int = SURFACES, width: float = RANGE
) -> OneFrameSensitivity:
    """Sensitivities of an assembly to the target's motions, see :func:`measured_sensitivity`."""
    return measured_sensitivity(Simulation(assembly), dofs, surfaces, width)


def measured_sensitivity(
    simulation: Simulation, dofs: tuple[str, ...] = DEGREES_OF_FREEDOM, surfaces: int = SURFACES, width: float = RANGE
) -> OneFrameSensitivity:
    """Sensitivities to the target's motions from one frame of each of some surfaces, beside theory.

    dofs: which of x, y, z, rx, ry, rz; surfaces: how many, of the scene's seed and those that follow (the user's own
    points are one); width: of the range of displacements [mm or deg] for which the scatter of shifts is stated. Raises
    SceneError where the field cannot be computed as asked, InputError where the detector stays dark.
    """
    assembly, measurement = simulation.assembly, OneFrame(simulation)
    count = surfaces if assembly.target.points is None else 1
    measurement.measure(range(assembly.seed, assembly.seed + count))
    return sensitivity_of(simulation, measurement.result, dofs, width)


@dataclass(frozen=True)
class _Values:
    """Of n surfaces: sensitivities (4, n) along u, v, x, y, and variance (4, n) of each from its own speckles.

    blocks: the fewest independent parts that such a variance rests on.
    """

    values: np.ndarray
    variance: np.ndarray
    blocks: int

    @classmethod
    def of(cls, velocities: list[PatternVelocity], number: int, scale: float, on_axes) -> _Values:
        values = np.array([one.value[number] for one in velocities]).T * scale
        covariance = np.array([one.covariance[number] for one in velocities]) * scale**2
        turn = on_axes(np.eye(2))
        variance = np.einsum("ai,nij,aj->an", turn, covariance, turn)
        return cls(on_axes(values), variance, min(one.blocks for one in velocities))

    def axis(self, row: int) -> _Values:
        return _Values(self.values[row], self.variance[row], self.blocks)

    @property
    def variance_of_mean(self) -> float:
        """By the scatter of surfaces; of a single one by its own speckles."""
        count = self.values.size
        return float(self.values.var(ddof=1) / count if count > 1 else self.variance[0])

    @property
    def freedom(self) -> int:
        return self.values.size - 1 if self.values.size > 1 else self.blocks - 1


def values_of_surfaces(
    result: OneFrameResult, assembly: Assembly, seen: SeenAxes
) -> tuple[np.ndarray, np.ndarray]:
    """Sensitivities (k, 4, 6) along u, v, x, y of each of k surfaces [mm/mm, mm/deg], as :func:`sensitivity_of` takes
    them: with curvature over the detector where the surfaces show it. Besides, (4, 6) the standard uncertainty of their
    mean by curvature that they neither show nor exclude."""
    found = np.empty((len(result.seeds), 4, len(DEGREES_OF_FREEDOM)))
    doubt = np.empty(found.shape[1:])
    for number, dof in enumerate(DEGREES_OF_FREEDOM):
        linear, curved = (_of_motion(velocities, dof, assembly, seen) for velocities in (result.linear, result.curved))
        for row in range(4):
            taken, variance = _taken(linear.axis(row), curved.axis(row))
            found[:, row, number] = taken.values
            doubt[row, number] = np.sqrt(max(variance - taken.variance_of_mean, 0.0))
    return found, doubt


def _of_motion(velocities: list[PatternVelocity], dof: str, assembly: Assembly, seen: SeenAxes) -> _Values:
    scale = np.pi / 180 if is_rotation(dof) else 1.0
    return _Values.of(
        velocities, DEGREES_OF_FREEDOM.index(dof), scale, lambda values: on_all_axes(values, assembly, seen)
    )


def _taken(linear: _Values, curved: _Values) -> tuple[_Values, float]:
    """Which of them counts, and the variance of its mean: that with curvature where the surfaces show it clearly."""
    between = curved.values - linear.values
    by_chance = between.var(ddof=1) / between.size if between.size > 1 else curved.variance[0] - linear.variance[0]
    off = float(np.mean(between)) ** 2
    if off > CLEARLY**2 * by_chance:
        return curved, curved.variance_of_mean
    return linear, linear.variance_of_mean + max(off - by_chance, 0.0)


def _fit(
    linear: _Values, curved: _Values, numerical: float, theory: float | None, unit: str
) -> tuple[Sensitivity, float]:
    """The sensitivity in the middle of the detector, and its standard deviation over surfaces.

    A velocity that is taken to be linear over the detector is known best, but is off by the mean of its curvature; one
    with curvature has twice the scatter, and is taken where the surfaces show the curvature clearly. Else what they
    neither show nor exclude of it stays in the interval, as does the fields' ``numerical`` error.
    """
    taken, error = _taken(linear, curved)
    count, value = taken.values.size, float(taken.values.mean())
    basis, note = ("surfaces", "") if count > 1 else ("residuals", ONE_SURFACE)
    if not np.isfinite(error):
        basis, note, half = "none", "one surface of few speckles has no interval", np.nan
    else:
        quantile = special.stdtrit(max(taken.freedom, 1), 0.5 + CONFIDENCE / 2)
        half = float(np.hypot(quantile * np.sqrt(error), numerical))
    fit = Sensitivity(value, (value - half, value + half), theory, np.nan, unit, basis, count, 0, note)
    return fit, float(taken.values.std(ddof=1)) if count > 1 else np.nan


def _not_measured(theory: float | None, unit: str) -> Sensitivity:
    nothing = (np.nan, np.nan)
    return Sensitivity(np.nan, nothing, theory, np.nan, unit, "none", 0, 0, CENTRE_BY_SWEEP)
