"""What arrives of one source's rays on the detector, and the polynomials that carry it onto the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.linalg import eigh
from scipy.ndimage import binary_dilation

from ..errors import InputError
from ..geometry.plane import PlaneGrid
from ..machine.memory import excess
from ..optics.sequence import Sequence
from ..optics.trace import RayStatus
from .ray_fan import PROBE_RAYS, LaunchCones, Rays, detector_box, find_window, lattice

FEWEST_ARRIVALS = 4
"""Arriving rays, on the detector and free, below which a source's light is not interpolated."""

MAXIMUM_DEGREE = 16
"""Of the polynomials: rounding is reached before, and the fit's cost grows with its fourth power."""

DEPENDENT = 1e-12
"""Mean square of a polynomial on the rays, relative to the largest, below which the rays do not tell it from the
others."""


@dataclass(frozen=True)
class SourceRays:
    """The rays of one source that its light on the detector is interpolated from.

    rays: all of the lattice; box: (2, 2) low and high corner of the region that they are interpolated in [mm];
    lit: (n,) free and on the detector; used: (n,) lent to the interpolation; lines: of the lattice that hold such rays,
    along p and q; rim_cuts: rims, and not the detector's edges, bound the light; ragged: light ends next to rays that
    do not exist, not at a rim; solid_angle: of one ray [sr].
    """

    rays: Rays
    box: np.ndarray
    lit: np.ndarray
    used: np.ndarray
    lines: tuple[int, int]
    rim_cuts: bool
    ragged: bool
    solid_angle: float


def rays_of_source(system: Sequence, grid: PlaneGrid, cones: LaunchCones, source, count: int) -> SourceRays | int:
    """Trace the lattice of one source. Returns the number of rays traced instead where too few of them arrive."""
    traced = 0
    window = cones.of(source)
    while window is not None:
        rays, shape, solid_angle = lattice(system, cones.axes, source, window, count)
        traced += rays.a.size
        lit = rays.free & rays.within(*detector_box(grid))
        if lit.sum() >= FEWEST_ARRIVALS:
            return _selected(rays, lit, shape, solid_angle, grid)
        # The linear law of windows may have missed this source's light.
        searched = traced > rays.a.size
        window = None if searched else find_window(system, grid, cones.axes, source, [(PROBE_RAYS, window)])
    return traced


def _selected(rays: Rays, lit: np.ndarray, shape: tuple[int, int], solid_angle: float, grid: PlaneGrid) -> SourceRays:
    """Choose the rays that lend their path: those in and around the lit region, and a narrow band behind its rims."""
    low, high = (np.array([f(rays.a[lit]), f(rays.b[lit])]) for f in (np.min, np.max))
    step = np.sqrt(np.median(np.abs(rays.tube[lit])) * solid_angle)
    box = np.stack([low - 2.0 * step, high + 2.0 * step])
    # Two rows of the lattice, in the clearance 1 - (r/R)^2 of a rim that fills it.
    band = 1.0 - (1.0 + 4.0 / min(shape)) ** 2
    sign = np.sign(np.median(rays.tube[lit]))
    near = (rays.status <= RayStatus.OUTSIDE_OUTLINE) & rays.within(*box)
    used = near & (rays.tube * sign > 0) & np.all(rays.margins > band, axis=0)
    used |= lit
    on_detector = rays.within(*detector_box(grid))
    rim_cuts = bool(np.any(near & ~rays.free & on_detector)) and not np.any(rays.free & ~on_detector)
    no_ray = (rays.status > RayStatus.OUTSIDE_OUTLINE).reshape(shape)
    ragged = bool(np.any(binary_dilation(no_ray) & lit.reshape(shape)))
    lines = tuple(int(used.reshape(shape).any(axis=i).sum()) for i in (1, 0))
    return SourceRays(rays, box, lit, used, lines, rim_cuts, ragged, solid_angle)


@dataclass(frozen=True)
class Fit:
    """Chebyshev polynomials of path, amplitude and clearances through the arrivals of one source.

    box: (2, 2) [mm]; coefficients: (d1+1, d2+1, 2 + r); middle: path [mm] that is taken out of it; lit_cells: (x, y)
    mask of cells of the box with free rays in or beside them; path_error: [wavelengths].
    """

    box: np.ndarray
    coefficients: np.ndarray
    middle: float
    lit_cells: np.ndarray
    path_error: float

    @classmethod
    def through(cls, arrivals: SourceRays, wavelength: float) -> Fit:
        """Least squares over the rays used, of the degree that they determine stably."""
        rays, box, used = arrivals.rays, arrivals.box, arrivals.used
        place = np.stack([rays.a[used], rays.b[used]])
        middle = float(np.median(rays.path[used]))
        values = np.stack([rays.path[used] - middle, rays.amplitude[used], *rays.margins[:, used]], axis=1)
        count = place.shape[1]
        keep = _euclidean_degree(arrivals.lines, count)
        # The basis and its orthonormal combinations; half as much again for the products on the way.
        if too_much := excess(3 * 8 * count * np.count_nonzero(keep)):
            raise InputError(f"method 'rays': the {count} rays of one source {too_much}: take fewer rays_per_source")
        x, y = (chebvander(t, n - 1) for t, n in zip(_scaled(place.T, box).T, keep.shape, strict=True))
        basis = (x[:, :, None] * y[:, None, :])[:, keep]
        # By the small Gram matrix, refined once: far cheaper than QR. Where rays fill only part of the box the basis is
        # nearly dependent; the cut leaves no wild combinations.
        sizes, vectors = eigh(basis.T @ basis, check_finite=False)
        vectors = vectors[:, sizes > DEPENDENT * sizes[-1]] / np.sqrt(sizes[sizes > DEPENDENT * sizes[-1]])
        q = basis @ vectors
        solution = vectors @ (q.T @ values)
        for _ in range(2):
            solution += vectors @ (q.T @ (values - basis @ solution))
        coefficients = np.zeros((*keep.shape, values.shape[1]))
        coefficients[keep] = solution
        # Distance of a ray from the interpolant through all others (Allen's PRESS): residual / (1 - leverage).
        left_out = np.maximum(1.0 - (q * q).sum(axis=1), 1e-3)
        missed = np.abs(basis @ solution[:, 0] - values[:, 0]) / left_out
        error = float(missed[arrivals.lit[used]].max()) / wavelength
        return cls(box, coefficients, middle, _lit_cells(arrivals), error)

    def on_grid(self, columns: np.ndarray, rows: np.ndarray, wavelength: float) -> tuple[np.ndarray, np.ndarray]:
        """Pixels reached and the field of a unit source there, both (rows, columns), at coordinates [mm]."""
        x, y = (
            chebvander(_scaled(t, self.box[:, k]), self.coefficients.shape[k] - 1)
            for k, t in enumerate((columns, rows))
        )
        path, amplitude, *margins = (y @ c.T @ x.T for c in np.moveaxis(self.coefficients, 2, 0))
        i, j = (
            np.minimum((n * (t - self.box[0, k]) / np.ptp(self.box[:, k])).astype(int), n - 1)
            for k, (t, n) in enumerate(zip((columns, rows), self.lit_cells.shape, strict=True))
        )
        free = self.lit_cells.T[np.ix_(j, i)]
        for margin in margins:
            free &= margin > 0.0
        phase = (2.0 * np.pi) * np.mod((path + self.middle) / wavelength, 1.0)
        amplitude[~free] = 0.0
        field = np.empty(phase.shape, dtype=np.complex128)
        np.multiply(amplitude, np.cos(phase), out=field.real)
        np.multiply(amplitude, np.sin(phase), out=field.imag)
        return free, field


def _euclidean_degree(lines: tuple[int, int], count: int) -> np.ndarray:
    """Mask (d1+1, d2+1) of the products T_i T_j with (i/d1)^2 + (j/d2)^2 <= 1: what a function without preferred
    directions needs.

    d = 2 sqrt(lines) along each axis, less where ``count`` rays are too few for it. L. N. Trefethen, "Multivariate
    polynomial approximation in the hypercube", Proc. AMS 145 (2017), doi:10.1090/proc/13623.
    """
    d1, d2 = (max(1, min(MAXIMUM_DEGREE, int(2.0 * np.sqrt(n)), n - 1)) for n in lines)
    while True:
        keep = (np.arange(d1 + 1)[:, None] / d1) ** 2 + (np.arange(d2 + 1) / d2) ** 2 <= 1.0 + 1e-9
        if keep.sum() <= 0.7 * count or d1 == d2 == 1:
            return keep
        d1, d2 = max(1, d1 - (d1 >= d2)), max(1, d2 - (d2 >= d1))


def _scaled(place: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Coordinates in [-1, 1] of places in the box (low, high)."""
    return (2.0 * place - box[0] - box[1]) / (box[1] - box[0])


def _lit_cells(arrivals: SourceRays) -> np.ndarray:
    """Cells of the box, about 2.5 rays wide, that hold a free ray or touch one that does.

    Keeps clearances that are extrapolated far from all rays from lighting anything; edges lie where a clearance
    is zero.
    """
    rays, box = arrivals.rays, arrivals.box
    step = np.sqrt(np.median(np.abs(rays.tube[arrivals.lit])) * arrivals.solid_angle)
    shape = np.maximum(1, (np.ptp(box, axis=0) / (2.5 * step)).astype(int))
    free = rays.free & rays.within(*box)
    cells = np.histogram2d(rays.a[free], rays.b[free], bins=shape, range=box.T)[0] > 0
    return binary_dilation(cells, np.ones((3, 3)))
