"""The exact field that frames of the study are judged by, on some pixels, by a way of its own."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...field.lobe import Lobe, facets_of
from ...field.simulation import simulate_frame
from ...geometry.plane import PlaneGrid
from ...geometry.pose import Pose
from ...propagation.paths import FreeSpace
from ...propagation.reference import reference_sum
from .allowance import SHARE_OF_STEP, Allowance
from .frame import with_point_sources
from .subject import Subject

TOLERANCES = (1e-7, 1e-6)
"""Of the exact field behind elements; the second where the first would take too long."""

SAMPLED_PAIRS, SAMPLED_PIXELS = 30_000_000, (12, 300)
"""Pairs spent on the exact sum, as far as fewest and most sampled pixels allow."""

BRIGHT = 0.1
"""Intensity, relative to the mean, from which the phase of a pixel counts."""


@dataclass(frozen=True)
class ExactField:
    """The exact field on evenly spaced pixels: every ``step``-th from ``first``, along rows and columns.

    field: complex (rows, columns) of them; scatterers: summed; origin: how it was made; seconds: it took; tolerance:
    asked for, where there are elements.
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


def exact_field(assembly, tolerance: float) -> ExactField:
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
    seconds = time.perf_counter() - begin
    return ExactField(first, step, field.reshape(grid.shape), scatterers, origin, seconds, tolerance)


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


def exact_fields(subject: Subject, allowance: Allowance, advance: Callable[[], None]) -> dict[int, ExactField | None]:
    """The exact field at every N1, the smallest first; None where it would take longer than there is time."""
    found: dict[int, ExactField | None] = {}
    for count in subject.point_sources:
        made = {n: field for n, field in found.items() if field is not None}
        seconds, tolerance = _predicted(subject, count, made, allowance.left) if made else (0.0, TOLERANCES[0])
        # The first is made in any case.
        too_long = bool(made) and seconds > allowance.left
        found[count] = None if too_long else exact_field(with_point_sources(subject.assembly, count), tolerance)
        advance()
    return found


def _predicted(subject: Subject, count: int, made: dict[int, ExactField], left: float) -> tuple[float, float]:
    """(seconds that the exact field at N1 should take, tolerance that there is time for), from those made before."""
    *before, (n, last) = made.items()
    if subject.assembly.elements:
        # Few scatterers cost little beside what every frame takes: the growth so far goes on.
        seconds = last.seconds * (max(last.seconds / before[-1][1].seconds, 1.0) if before else 1.0)
        return seconds, last.tolerance if seconds < SHARE_OF_STEP * left else TOLERANCES[1]
    grown = last.scatterers * count / n
    pairs = grown * sampled_pixels(grown) / (last.scatterers * sampled_pixels(last.scatterers))
    return last.seconds * pairs, TOLERANCES[0]
