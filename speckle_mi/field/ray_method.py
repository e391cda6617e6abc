"""The paper's own algorithm: a fan of rays from every scatterer, its path lengths interpolated onto the pixels.

Every source sends rays equally distributed over the solid angle that the detector takes up. Each is traced exactly to
the detector's plane. What arrives there, scattered points with an optical path length, an amplitude and clearances of
the rims, is interpolated onto the pixel grid, and the complex fields of all sources are added,

    E(D) = sum_j c_j A_j(D) e^{+ik L_j(D)},    A = (dA_detector |cos chi| / dOmega_source)^(-1/2),

with the geometric shadow of every rim and no diffraction. Source: "Efficient framework for the simulation of
translational and rotational laser speckle displacement in optical sensor assemblies", Opt. Eng. 61(6) 061410 (2022),
section 3, doi:10.1117/1.OE.61.6.061410. Unlike there, the path is interpolated and not the wrapped phase, by
Chebyshev polynomials through all rays of a source (least squares) and not linearly between three of them; a ray beyond
a rim lends its path to the interpolation next to the edge, so that the clearance's zero places the edge between rays.

Relative error of the field on the paper's detector (744 x 480 pixels at 60 mm, free space) against the exact sum: 16
rays a source 2e-2, 36: 7e-4, 64: 4e-6, 100: 2e-7, 400 and more: 1e-10, the rounding of the path. Linear interpolation
of 1500 rays: 0.3. Lenses out of focus with 1500 rays: 1e-10 to 1e-6, the more the closer to the focus.
The polynomials' degree d ~ 2 N2^(1/4) is what regularly spaced rays determine stably (L. N. Trefethen, "Approximation
Theory and Approximation Practice", SIAM 2013, ch. 13), so the error falls like exp(-C N2^(1/4)).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.frames import Frame
from ..geometry.plane import PlaneGrid
from ..machine.progress import tell
from ..optics.sequence import Interaction, Sequence
from ..optics.surface import Surface
from .ray_fan import LaunchCones
from .ray_fit import Fit, SourceRays, rays_of_source

FEWEST_RAYS = 16
"""Rays a source below which there is no lattice to interpolate on."""

PATH_WARNING = 0.02
"""Interpolation error [wavelengths] from which the user is told to take more rays."""

CAUSTIC_RATIO = 0.05
"""A ray tube this much narrower in area than the middle one of its source is on its way to a caustic."""

CONCENTRATED = 0.1
"""Ray tube's section over that of free space below which light behind a rim is being focused."""

PIXELS_AT_ONCE = 1 << 19


@dataclass(frozen=True)
class RayField:
    """Outcome of the ray method.

    field: (rows, columns) complex128; covered: fraction of the pixels that the light of at least one source reaches;
    path_error: largest estimated error of an interpolated path length [wavelengths], from the rays' distance to their
    interpolant; warnings: what the user should know; rays_traced: in all, without those that found the solid angles.
    """

    field: np.ndarray
    covered: float
    path_error: float
    warnings: list[str]
    rays_traced: int


def ray_field(
    sequence: Sequence | None,
    grid: PlaneGrid,
    position: np.ndarray,
    amplitude: np.ndarray,
    wavelength: float,
    rays_per_source: int,
) -> RayField:
    """Field on ``grid`` of point sources, by rays through ``sequence``, which ends before the detector (None: free
    space).

    position: (n, 3) [mm], world; amplitude c: (n,) complex, the field at unit distance; wavelength [mm], vacuum;
    rays_per_source: N2, at least ``FEWEST_RAYS``; the lattice holds as many as fit, at most N2. Phasor e^{+ikL}, with
    the factor -i of every focal line on the way. No random numbers.
    Raises ValueError for arrays that do not fit or values out of range, and where the detector meets a caustic.
    """
    position, amplitude = _checked(position, amplitude, wavelength, rays_per_source)
    system = _to_detector(sequence, grid)
    total = _Sum(grid, wavelength)
    if len(position):
        cones = LaunchCones.around(system, grid, position)
        for number, (source, weight) in enumerate(zip(position, amplitude, strict=True)):
            total.add(rays_of_source(system, grid, cones, source, rays_per_source), weight)
            tell("sources", number + 1, len(position))
    return total.result()


def _checked(position, amplitude, wavelength: float, rays_per_source: int) -> tuple[np.ndarray, np.ndarray]:
    position, amplitude = np.asarray(position, dtype=np.float64), np.asarray(amplitude, dtype=np.complex128)
    if position.ndim != 2 or position.shape[1] != 3 or amplitude.shape != (len(position),):
        raise ValueError(f"position {position.shape} and amplitude {amplitude.shape}: must be (n, 3) and (n,)")
    if not (np.isfinite(position).all() and np.isfinite(amplitude).all()):
        raise ValueError("position and amplitude of the sources must be finite numbers")
    if not (np.isfinite(wavelength) and wavelength > 0):
        raise ValueError(f"wavelength = {wavelength}: must be a positive number of mm")
    if rays_per_source < FEWEST_RAYS:
        raise ValueError(f"rays_per_source = {rays_per_source}: must be at least {FEWEST_RAYS}, the paper takes 1500")
    return position, amplitude


def _to_detector(sequence: Sequence | None, grid: PlaneGrid) -> Sequence:
    """The sequence with the detector's plane behind it; local x, y there run along columns and rows."""
    plane = Surface(Frame(grid.origin, np.stack([grid.u, grid.v, grid.normal], axis=1)))
    before = sequence.interactions if sequence else ()
    return Sequence((*before, Interaction.through(plane, before[-1].index_after if before else 1.0)))


def _check_no_caustic(arrivals: SourceRays, wavelength: float) -> bool:
    """Whether the shadow of the rims is sharper than diffraction makes it; ValueError where light is focused.

    A caustic on the detector is where the tubes' section changes sign, or where rays from different sides of a focal
    line arrive. A bundle cut by rims is at its focus when its Fresnel number rho^2/(lambda z) is below 1: rho the
    radius of the patch it lights, z the way from the focal line.
    """
    rays, lit = arrivals.rays, arrivals.lit
    sections, reach = np.abs(rays.tube[lit]), float(np.median(rays.reach[lit]))
    patch = sections.sum() * arrivals.solid_angle / np.pi
    shadowless = arrivals.rim_cuts and patch < wavelength * reach
    reason = ""
    if np.ptp(np.sign(rays.tube[lit])) or np.ptp(rays.caustics[lit]):
        reason = "a focal line crosses the lit part of the detector, where several rays of one source reach one pixel"
    elif sections.min() < CAUSTIC_RATIO * np.median(sections):
        reason = f"a ray tube is {np.median(sections) / sections.min():.3g} times narrower than the middle one"
    elif shadowless and np.median(rays.spread[lit]) < CONCENTRATED:
        reason = f"a patch of radius {1e3 * np.sqrt(patch):.3g} um is lit {reach:.3g} mm from its focus"
    elif reach < 100.0 * wavelength:
        reason = f"a focal line lies {1e3 * reach:.3g} um from the detector"
    if reason:
        raise InputError(
            f"method 'rays' does not apply: the detector meets a caustic ({reason}). Rays have no field there; "
            "use method 'auto' with diffraction, which is right in and out of focus, or move the detector out of focus"
        )
    return not shadowless


class _Sum:
    """The detector's field while the sources' are added one by one."""

    def __init__(self, grid: PlaneGrid, wavelength: float) -> None:
        self._grid, self._wavelength = grid, wavelength
        self._field = np.zeros(grid.shape, dtype=np.complex128)
        self._reached = np.zeros(grid.shape, dtype=bool)
        self._rays_traced, self._path_error = 0, 0.0
        self._notes: Counter[str] = Counter()

    def add(self, arrivals: SourceRays | int, weight: complex) -> None:
        """Add one source of strength ``weight``; a number of rays: of a source that does not reach the detector."""
        if isinstance(arrivals, int):
            self._rays_traced += arrivals
            self._notes["dark"] += 1
            return
        self._rays_traced += arrivals.rays.a.size
        self._notes["shadowless"] += not _check_no_caustic(arrivals, self._wavelength)
        self._notes["ragged"] += arrivals.ragged
        fit = Fit.through(arrivals, self._wavelength)
        self._notes["coarse"] += fit.path_error > PATH_WARNING
        self._path_error = max(self._path_error, fit.path_error)
        gouy = (1.0, -1j, -1.0, 1j)[int(np.median(arrivals.rays.caustics[arrivals.lit])) % 4]
        columns, rows = (
            slice(max(0, int(np.ceil(low))), min(n, int(np.floor(high)) + 1))
            for low, high, n in zip(*arrivals.box / self._grid.pitch, self._grid.shape[::-1], strict=True)
        )
        at_once = max(1, PIXELS_AT_ONCE // max(1, columns.stop - columns.start))
        for first in range(rows.start, rows.stop, at_once):
            part = slice(first, min(first + at_once, rows.stop)), columns
            free, values = fit.on_grid(self._grid.columns[columns], self._grid.rows[part[0]], self._wavelength)
            self._field[part] += (weight * gouy) * values
            self._reached[part] |= free

    def result(self) -> RayField:
        """What has been added so far."""
        notes = {
            "dark": "reach the detector with too few rays to interpolate, or none, and are left out",
            "coarse": f"have a path interpolated to no better than {PATH_WARNING} wavelengths "
            f"(worst {self._path_error:.2g}): take more rays_per_source",
            "ragged": "end where rays miss a surface or are reflected totally: that edge is placed to a ray spacing",
            "shadowless": "light a patch of Fresnel number below 1: diffraction, left out, blurs all of it",
        }
        told = ((self._notes[key], text) for key, text in notes.items())
        warnings = [f"method 'rays': {count} sources {text}" for count, text in told if count]
        covered = float(self._reached.mean()) if self._reached.size else 0.0
        return RayField(self._field, covered, self._path_error, warnings, self._rays_traced)
