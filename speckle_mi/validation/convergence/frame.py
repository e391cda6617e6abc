"""One frame of the convergence study: the way it is made, the exact field it is judged by, and the row it becomes."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...field.lobe import Lobe, facets_of
from ...field.simulation import simulate_frame
from ...geometry.plane import PlaneGrid
from ...geometry.pose import Pose
from ...propagation.paths import FreeSpace
from ...propagation.reference import reference_sum

PAPER_RAYS = 1500
"""Rays a source in Opt. Eng. 61(6) 061410 (2022), doi:10.1117/1.OE.61.6.061410."""

SAMPLED_PAIRS, SAMPLED_PIXELS = 30_000_000, (12, 300)
"""Pairs spent on the exact sum, as far as fewest and most sampled pixels allow."""

BRIGHT = 0.1
"""Intensity, relative to the mean, from which the phase of a pixel counts."""

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


def with_point_sources(assembly, count: int):
    """The assembly with ``count`` scatterers expected inside the beam's 1/e^2 footprint (or on the whole target).

    assembly: as it comes from its scene, whose N1 the density is scaled from. A target made of the user's own points
    keeps them.
    """
    target = assembly.target
    density = target.surface.density * count / target.point_sources
    return replace(assembly, target=replace(target, surface=replace(target.surface, density=density)))


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


def exact_sample(assembly, tolerance: float) -> Sample:
    """The exact field of an assembly at rest on evenly spread pixels, by a way of its own.

    In free space the float64 sum over all scatterers as it stands, in NumPy. With elements a sum on those pixels alone
    to ``tolerance``, its openings divided accordingly, each stage checked against its own exact sum on sampled points.
    """
    begin = time.perf_counter()
    assembly = replace(assembly, sub_pixels=1)
    probe = replace(assembly, detector=every_pixel(assembly.detector, 0, max(assembly.detector.shape)))
    lit = simulate_frame(probe.with_options(method="direct"), Pose()).scatterers if not assembly.elements else None
    count = sampled_pixels(lit.count) if lit else SAMPLED_PIXELS[1]
    step = int(np.ceil(np.sqrt(assembly.detector.size / count)))
    first = min(step, *assembly.detector.shape) // 2
    grid = every_pixel(assembly.detector, first, step)
    if lit is not None:
        field = _summed_in_numpy(assembly, lit, grid.points())
        origin, scatterers = "float64 sum in NumPy", lit.count
    else:
        frame = simulate_frame(
            replace(assembly, detector=grid).with_options(method="auto", tolerance=tolerance), Pose()
        )
        field, scatterers = frame.image.field, frame.scatterers.count
        origin = f"sum on the sampled pixels to {tolerance:.0e}, its own error {frame.numerical_error:.0e}"
    return Sample(first, step, field.reshape(grid.shape), scatterers, origin, time.perf_counter() - begin, tolerance)


def _summed_in_numpy(assembly, lit, places: np.ndarray) -> np.ndarray:
    """Field (m,) of scatterers at places (m, 3) in free space, every facet's lobe as the BSDF has it."""
    wavelength = assembly.beam.wavelength
    if assembly.target.lobe is None:
        return reference_sum(FreeSpace(), lit.position, lit.amplitude, places, wavelength)
    lobe, field = Lobe(assembly.target.lobe, assembly.target.where), np.zeros(len(places), dtype=np.complex128)
    normals, points, facet = facets_of(lit, assembly.spot.point)
    for number in range(len(normals)):
        one, mine = slice(number, number + 1), facet == number
        shape = assembly.beam, assembly.target.frame.axes, normals[one], points[one]
        radiated = lobe.amplitude(*shape, places[None] - points[one, None])[0]
        field += radiated * reference_sum(FreeSpace(), lit.position[mine], lit.amplitude[mine], places, wavelength)
    return field


def sampled_pixels(scatterers: float) -> float:
    """About how many pixels the float64 sum over so many scatterers is made on."""
    return float(np.clip(SAMPLED_PAIRS / max(scatterers, 1), *SAMPLED_PIXELS))


def every_pixel(grid: PlaneGrid, first: int, step: int) -> PlaneGrid:
    """Every ``step``-th pixel of a grid from ``first`` on, along rows and columns."""
    shape = tuple(len(range(first, n, step)) for n in grid.shape)
    return replace(
        grid, origin=grid.origin + first * grid.pitch * (grid.u + grid.v), pitch=step * grid.pitch, shape=shape
    )


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
