"""The paper's own algorithm: a fan of rays from every scatterer, its path lengths interpolated onto the pixels.

Every source sends rays equally distributed over the solid angle that the detector takes up. Each is traced exactly to
the detector's plane. What arrives there, scattered points with an optical path length, an amplitude and clearances of
the
rims, is interpolated onto the pixel grid, and the complex fields of all sources are added,

    E(D) = sum_j c_j A_j(D) e^{+ik L_j(D)},    A = (dA_detector |cos chi| / dOmega_source)^(-1/2),

with the geometric shadow of every rim and no diffraction. Source: "Efficient framework for the simulation of
translational and rotational laser speckle displacement in optical sensor assemblies", Opt. Eng. 61(6) 061410 (2022),
section 3, doi:10.1117/1.OE.61.6.061410. Unlike there, the path is interpolated and not the wrapped phase, by
Chebyshev polynomials through all rays of a source (least squares) and not linearly between three of them; a ray beyond
a
rim lends its path to the interpolation next to the edge, so that the clearance's zero places the edge between rays.

Relative error of the field on the paper's detector (744 x 480 pixels at 60 mm, free space) against the exact sum: 16
rays
a source 2e-2, 36: 7e-4, 64: 4e-6, 100: 2e-7, 400 and more: 1e-10, the rounding of the path. Linear interpolation of
1500
rays: 0.3. Lenses out of focus with 1500 rays: 1e-10 to 1e-6, the more the closer to the focus.
The polynomials' degree d ~ 2 N2^(1/4) is what regularly spaced rays determine stably (L. N. Trefethen, "Approximation
Theory and Approximation Practice", SIAM 2013, ch. 13), so the error falls like exp(-C N2^(1/4)).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.linalg import eigh
from scipy.ndimage import binary_dilation

from speckle_mi.geometry import Frame, PlaneGrid
from speckle_mi.optics.aim import aim, zeros_between
from speckle_mi.optics.surfaces import Interaction, Sequence, Surface
from speckle_mi.optics.trace import Log, RayStatus, march

FEWEST_RAYS = 16
"""Rays a source below which there is no lattice to interpolate on."""
FEWEST_ARRIVALS = 4
"""Arriving rays, on the detector and free, below which a source's light is not interpolated."""
MAXIMUM_DEGREE = 16
"""Of the polynomials: rounding is reached before, and the fit's cost grows with its fourth power."""
DEPENDENT = 1e-12
"""Mean square of a polynomial on the rays, relative to the largest, below which the rays do not tell it from the
others."""
PROBE_RAYS, DENSE_PROBE_RAYS = 41, 201
"""Rays along each side of the lattices that find the solid angle to be covered; dense: the first look for a pinhole."""
PROBE_STEPS = 20
PROBE_WIDTHS = (0.02, 0.1, 0.4, 1.2)
"""Half widths [rad] of the fans that look for light where rays aimed at the detector find none."""
WIDEST = 1.3
"""Half width of a fan in equal-area coordinates; sqrt(2) in all directions is the half space."""
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
    progress: Callable[[int, int], None] | None = None,
) -> RayField:
    """Field on ``grid`` of point sources, by rays through ``sequence``, which ends before the detector (None: free
    space).

    position: (n, 3) [mm], world; amplitude c: (n,) complex, the field at unit distance; wavelength [mm], vacuum;
    rays_per_source: N2, at least ``FEWEST_RAYS``; the lattice holds as many as fit, at most N2. progress: called with
    (sources done, sources). Phasor e^{+ikL}, with the factor -i of every focal line on the way. No random numbers.
    Raises ValueError for arrays that do not fit or values out of range, and where the detector meets a caustic.
    """
    position, amplitude = _checked(position, amplitude, wavelength, rays_per_source)
    system = _to_detector(sequence, grid)
    total = _Sum(grid, wavelength)
    if len(position):
        cones = _LaunchCones.around(system, grid, position)
        for done, (source, weight) in enumerate(zip(position, amplitude, strict=True), start=1):
            total.add(_arrivals(system, grid, cones, source, rays_per_source), weight)
            if progress:
                progress(done, len(position))
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


@dataclass(frozen=True)
class _Rays:
    """Rays of one source at the detector's plane, n of them.

    a, b: (n,) places along u, v [mm]; path: (n,) [mm]; tube: (n,) signed section on the detector plane per solid angle
    [mm^2]; amplitude: (n,) [1/mm]; spread: (n,) |section| over that of free space; reach: (n,) length [mm] over which
    the tube has spread, from its nearest focal line or its source; caustics: (n,) focal lines touched; margins: (r, n);
    status: (n,).
    """

    a: np.ndarray
    b: np.ndarray
    path: np.ndarray
    tube: np.ndarray
    amplitude: np.ndarray
    spread: np.ndarray
    reach: np.ndarray
    caustics: np.ndarray
    margins: np.ndarray
    status: np.ndarray

    @property
    def free(self) -> np.ndarray:
        """(n,) not blocked."""
        return self.status == RayStatus.OK

    def within(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(n,) in the box low (2,) to high (2,) of the detector's plane."""
        with np.errstate(invalid="ignore"):
            return (self.a >= low[0]) & (self.a <= high[0]) & (self.b >= low[1]) & (self.b <= high[1])


def _trace(system: Sequence, source: np.ndarray, axes: np.ndarray, p: np.ndarray, q: np.ndarray) -> _Rays:
    """Rays from ``source`` (3,) at equal-area coordinates p, q (n,) about ``axes[0]``, with their tubes."""
    log = Log(p.size)
    length, caustics = np.zeros(p.size), np.zeros(p.size, dtype=np.int64)
    with np.errstate(invalid="ignore", divide="ignore"):
        for step in march(system, _launch_state(source, axes, p, q), tubes=True):
            log.add(step)
            length += np.abs(step.length)
            caustics += zeros_between(*step.tube, step.length)
        a0, a1, a2 = step.tube
        section, slope = a0 + step.length * (a1 + step.length * a2), a1 + 2.0 * step.length * a2
        bend = np.sqrt(np.maximum(slope * slope - 4.0 * section * a2, 0.0))
        focal = 2.0 * np.abs(section) / (np.abs(slope) + bend)
        state = step.state
        return _Rays(
            a=state[0, 0],
            b=state[1, 0],
            path=log.optical_path_length,
            tube=state[0, 2] * state[1, 3] - state[0, 3] * state[1, 2],
            amplitude=1.0 / np.sqrt(np.abs(section)),
            spread=np.abs(section) / length**2,
            reach=np.fmin(focal, length),
            caustics=caustics,
            margins=log.stacked_margins(),
            status=log.status,
        )


def _launch_state(source: np.ndarray, axes: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Rays (3, 6, n) with tangents along p and q.

    d = (1 - s^2/2) c + sqrt(1 - s^2/4) (p e1 + q e2), s^2 = p^2 + q^2 (Lambert's azimuthal projection): dp dq is the
    solid angle, so a regular lattice in p, q is equally distributed over it.
    """
    centre, e1, e2 = axes[:, :, None]
    square = p * p + q * q
    scale = np.sqrt(1.0 - 0.25 * square)
    across = p * e1 + q * e2
    place = np.repeat(source[:, None], p.size, axis=1)
    state = np.zeros((3, 6, p.size))
    state[:, 0], state[:, 1] = place, (1.0 - 0.5 * square) * centre + scale * across
    state[:, 4] = -p * centre + scale * e1 - (0.25 * p / scale) * across
    state[:, 5] = -q * centre + scale * e2 - (0.25 * q / scale) * across
    return state


def _detector_box(grid: PlaneGrid) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2,) of the detector [mm], outer edges of its pixels."""
    rows, columns = grid.shape
    return np.full(2, -0.5 * grid.pitch), grid.pitch * (np.array([columns, rows]) - 0.5)


@dataclass(frozen=True)
class _LaunchCones:
    """Which solid angle every source has to fill: a window of equal-area coordinates, linear in the source's place.

    axes: (3, 3) rows c, e1, e2, c the middle direction; centre: (3,) of the spot [mm]; window: (4,) p low, p high, q
    low,
    q high for a source there, None where no light was found; slope: (3, 4) change [1/mm]; margin: (4,) what the linear
    law leaves open.
    """

    axes: np.ndarray
    centre: np.ndarray
    window: np.ndarray | None
    slope: np.ndarray
    margin: np.ndarray

    @classmethod
    def around(cls, system: Sequence, grid: PlaneGrid, position: np.ndarray) -> _LaunchCones:
        """From the windows of the outermost sources and the middle one of (n, 3)."""
        centre = position.mean(axis=0)
        axes, start = _aimed_start(system, grid, centre)
        chosen = {int(np.argmin(((position - centre) ** 2).sum(axis=1)))}
        chosen |= {int(pick(position[:, i])) for i in range(3) for pick in (np.argmin, np.argmax)}
        some = position[sorted(chosen)]
        fans = [(PROBE_RAYS, np.array([-w, w, -w, w])) for w in PROBE_WIDTHS]
        starts = [(PROBE_RAYS, start), (DENSE_PROBE_RAYS, start), *fans]
        windows = [_find_window(system, grid, axes, source, starts) for source in some]
        lit = [i for i, window in enumerate(windows) if window is not None]
        if not lit:
            return cls(axes, centre, None, np.zeros((3, 4)), np.zeros(4))
        limits, offset = np.array([windows[i] for i in lit]), some[lit] - centre
        middle, away = limits.mean(axis=0), offset.mean(axis=0)
        slope = np.linalg.lstsq(offset - away, limits - middle, rcond=1e-3)[0]
        margin = np.abs(limits - middle - (offset - away) @ slope).max(axis=0)
        return cls(axes, centre, middle - away @ slope, slope, margin * [-1, 1, -1, 1])

    def of(self, source: np.ndarray) -> np.ndarray | None:
        """Window (4,) of ``source`` (3,), or None."""
        if self.window is None:
            return None
        return np.clip(self.window + (source - self.centre) @ self.slope + self.margin, -WIDEST, WIDEST)


def _aimed_start(system: Sequence, grid: PlaneGrid, source: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) about the ray to the detector's middle and the window (4,) of rays aimed at edges and corners.

    The axes are turned so that p and q move the landing point along u and v, as far as a rotation can.
    """
    low, high = _detector_box(grid)
    s, t = (mesh.ravel()[:, None] for mesh in np.meshgrid([0.5, 0.0, 1.0], [0.5, 0.0, 1.0]))
    edge = low + (high - low) * np.concatenate([s, t], axis=1)
    targets = grid.origin + edge[:, :1] * grid.u + edge[:, 1:] * grid.v
    paths = aim(system, np.repeat(source[None], 9, axis=0), targets)
    if paths.converged[0]:
        c = paths.launch[0]
    else:
        c = system.interactions[0].surface.frame.origin - source
        c = c / np.linalg.norm(c) if np.linalg.norm(c) > 0 else grid.normal
    e1 = np.cross(c, np.eye(3)[np.argmin(np.abs(c))])
    e1 /= np.linalg.norm(e1)
    axes = np.stack([c, e1, np.cross(c, e1)])
    for last in march(system, _launch_state(source, axes, np.zeros(1), np.zeros(1))):
        pass
    jacobian = last.state[:2, 2:4, 0]
    if np.isfinite(jacobian).all():
        left, _, right = np.linalg.svd(jacobian)
        axes[1:] = (left @ right) @ axes[1:]
    local = paths.launch[paths.converged] @ axes.T
    local = local[local[:, 0] > 0.0]
    across = local[:, 1:] * np.sqrt(2.0 / (1.0 + local[:, :1]))
    half = np.abs(across).max(axis=0, initial=1e-3)
    return axes, np.array([-half[0], half[0], -half[1], half[1]])


def _find_window(system: Sequence, grid: PlaneGrid, axes, source, starts: list[tuple[int, np.ndarray]]):
    """Smallest window (4,) that holds every free ray of ``source`` to the detector, to a step of the probing lattice.

    starts: rays along a side and window (4,) of the lattices to begin with, one after the other until a ray arrives.
    The
    lattice is widened where rays at its edge still arrive, and narrowed where they do not. None: no ray does.
    """
    low, high = _detector_box(grid)
    for n, window in starts:
        for _ in range(PROBE_STEPS):
            p, q = np.linspace(*window[:2], n), np.linspace(*window[2:], n)
            rays = _trace(system, source, axes, *(mesh.ravel() for mesh in np.meshgrid(p, q, indexing="ij")))
            arrives = (rays.free & rays.within(low, high)).reshape(n, n)
            if not arrives.any():
                break
            sides = [_side(p, arrives.any(axis=1)), _side(q, arrives.any(axis=0))]
            found = np.clip(np.concatenate([limits for limits, _ in sides]), -WIDEST, WIDEST)
            before, window, n = window, found, PROBE_RAYS
            narrowed = (found[1] - found[0]) * (found[3] - found[2]) < 0.6 * np.prod(before[1::2] - before[::2])
            if np.array_equal(before, found) or not (narrowed or any(open_ for _, open_ in sides)):
                return window
        else:
            return window
    return None


def _side(x: np.ndarray, arrives: np.ndarray) -> tuple[np.ndarray, bool]:
    """New limits (2,) along one axis, and whether light may go on beyond the lattice."""
    some = np.flatnonzero(arrives)
    step, width = x[1] - x[0], x[-1] - x[0]
    first, last = arrives[0], arrives[-1]
    limits = [x[some[0]] - (0.5 * width if first else step), x[some[-1]] + (0.5 * width if last else step)]
    return np.array(limits), bool(first or last)


@dataclass(frozen=True)
class _Arrivals:
    """The rays of one source that its light on the detector is interpolated from.

    rays: all of the lattice; box: (2, 2) low and high corner of the region that they are interpolated in [mm];
    lit: (n,) free and on the detector; used: (n,) lent to the interpolation; lines: of the lattice that hold such rays,
    along p and q; rim_cuts: rims, and not the detector's edges, bound
    the light; ragged: light ends next to rays that do not exist, not at a rim; solid_angle: of one ray [sr].
    """

    rays: _Rays
    box: np.ndarray
    lit: np.ndarray
    used: np.ndarray
    lines: tuple[int, int]
    rim_cuts: bool
    ragged: bool
    solid_angle: float


def _arrivals(system: Sequence, grid: PlaneGrid, cones: _LaunchCones, source, count: int) -> _Arrivals | int:
    """Trace the lattice of one source. Returns the number of rays traced instead where too few of them arrive."""
    traced = 0
    window = cones.of(source)
    while window is not None:
        rays, shape, solid_angle = _lattice(system, cones.axes, source, window, count)
        traced += rays.a.size
        lit = rays.free & rays.within(*_detector_box(grid))
        if lit.sum() >= FEWEST_ARRIVALS:
            return _selected(rays, lit, shape, solid_angle, grid)
        # The linear law of windows may have missed this source's light.
        searched = traced > rays.a.size
        window = None if searched else _find_window(system, grid, cones.axes, source, [(PROBE_RAYS, window)])
    return traced


def _lattice(system: Sequence, axes, source, window, count: int) -> tuple[_Rays, tuple[int, int], float]:
    """At most ``count`` rays on a lattice of squares over the window and one step beyond it."""
    width = np.maximum(window[1::2] - window[::2], 1e-12)
    along_p = int(np.clip(round(np.sqrt(count * width[0] / width[1])), 4, count // 4))
    shape = (along_p, count // along_p)
    axes_pq = []
    for i, n in enumerate(shape):
        beyond = width[i] / (n - 3) if n >= 10 else 0.0
        axes_pq.append(np.linspace(window[2 * i] - beyond, window[2 * i + 1] + beyond, n))
    p, q = axes_pq
    rays = _trace(system, source, axes, *(mesh.ravel() for mesh in np.meshgrid(p, q, indexing="ij")))
    return rays, shape, float((p[1] - p[0]) * (q[1] - q[0]))


def _selected(rays: _Rays, lit: np.ndarray, shape: tuple[int, int], solid_angle: float, grid: PlaneGrid) -> _Arrivals:
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
    on_detector = rays.within(*_detector_box(grid))
    rim_cuts = bool(np.any(near & ~rays.free & on_detector)) and not np.any(rays.free & ~on_detector)
    no_ray = (rays.status > RayStatus.OUTSIDE_OUTLINE).reshape(shape)
    ragged = bool(np.any(binary_dilation(no_ray) & lit.reshape(shape)))
    lines = tuple(int(used.reshape(shape).any(axis=i).sum()) for i in (1, 0))
    return _Arrivals(rays, box, lit, used, lines, rim_cuts, ragged, solid_angle)


def _check_no_caustic(arrivals: _Arrivals, wavelength: float) -> bool:
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
        raise ValueError(
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

    def add(self, arrivals: _Arrivals | int, weight: complex) -> None:
        """Add one source of strength ``weight``; a number of rays: of a source that does not reach the detector."""
        if isinstance(arrivals, int):
            self._rays_traced += arrivals
            self._notes["dark"] += 1
            return
        self._rays_traced += arrivals.rays.a.size
        self._notes["shadowless"] += not _check_no_caustic(arrivals, self._wavelength)
        self._notes["ragged"] += arrivals.ragged
        fit = _Fit.through(arrivals, self._wavelength)
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


@dataclass(frozen=True)
class _Fit:
    """Chebyshev polynomials of path, amplitude and clearances through the arrivals of one source.

    box: (2, 2) [mm]; coefficients: (d1+1, d2+1, 2 + r); middle: path [mm] that is taken out of it; lit_cells: (x, y)
    mask
    of cells of the box with free rays in or beside them; path_error: [wavelengths].
    """

    box: np.ndarray
    coefficients: np.ndarray
    middle: float
    lit_cells: np.ndarray
    path_error: float

    @classmethod
    def through(cls, arrivals: _Arrivals, wavelength: float) -> _Fit:
        """Least squares over the rays used, of the degree that they determine stably."""
        rays, box, used = arrivals.rays, arrivals.box, arrivals.used
        place = np.stack([rays.a[used], rays.b[used]])
        middle = float(np.median(rays.path[used]))
        values = np.stack([rays.path[used] - middle, rays.amplitude[used], *rays.margins[:, used]], axis=1)
        count = place.shape[1]
        keep = _euclidean_degree(arrivals.lines, count)
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
    """Mask (d1+1, d2+1) of the products T_i T_j with (i/d1)^2 + (j/d2)^2 <= 1, all that serve a function without
    directions.

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


def _lit_cells(arrivals: _Arrivals) -> np.ndarray:
    """Cells of the box, about 2.5 rays wide, that hold a free ray or touch one that does.

    Keeps clearances that are extrapolated far from all rays from lighting anything; edges lie where a clearance is
    zero.
    """
    rays, box = arrivals.rays, arrivals.box
    step = np.sqrt(np.median(np.abs(rays.tube[arrivals.lit])) * arrivals.solid_angle)
    shape = np.maximum(1, (np.ptp(box, axis=0) / (2.5 * step)).astype(int))
    free = rays.free & rays.within(*box)
    cells = np.histogram2d(rays.a[free], rays.b[free], bins=shape, range=box.T)[0] > 0
    return binary_dilation(cells, np.ones((3, 3)))
