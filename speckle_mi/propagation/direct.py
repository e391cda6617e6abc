"""The exact coherent sum for closed-form paths, as Dr.Jit kernels for CPU (LLVM) and GPU (CUDA).

Everything inside is in the target plane's own coordinates and in units of the wavelength, so that a path length *is* a
phase in turns. It is formed in float64 and reduced to the nearest turn before it becomes a float32 angle: a float32
path of 0.1 m would carry 0.1 rad of error. Sums are float32 over blocks of 32 sources, float64 over blocks.

Two kernels:

- *points*: any points of the plane. One float64 path for each pair.
- *runs*: a regular grid. A lane owns a run of pixels along a row. One float64 path for each source and run centre;
  along the run the logarithm of the summand is a cubic in the pixel index, and a cubic's exponential needs three
  complex products a pixel (forward differences). The remainder is bounded beforehand (``runs.py``); where the bound
  fails the shorter run or *points* is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import drjit as dr
import numpy as np

from ..geometry.plane import PlaneGrid, PlanePoints
from ..machine.backend import arrays
from ..machine.progress import tell
from .paths import FreeSpace, RayleighSommerfeld
from .phasors import COSINE, SINE, WRITE, inverse_root, multiply, phasor, sine_cosine
from .runs import Extent, choose_run

BLOCK = 32
"""Sources summed in float32 before the float64 accumulator takes over; sources are padded to a multiple."""

POINTS_PER_LANE = 4
"""Scattered points a lane owns: shares one gather of the source's data."""

SINGLE_PRECISION = 1e-6
"""Relative L2 error that float32 phasors and weights keep."""

LANES_AT_ONCE = 1 << 19
"""Lanes per kernel launch: bounds the device memory at 16 x 16 bytes a lane, 128 MB."""

MINIMUM_LANES = 1 << 10
"""With fewer lanes of targets than this the sources are split over lanes, so that all cores have work."""


def supports(path: object) -> bool:
    """Whether the path has a closed form that the kernels know."""
    return isinstance(path, (FreeSpace, RayleighSommerfeld))


@dataclass(frozen=True)
class _Sources:
    """Sources on the device, in the target's coordinates [wavelengths], padded with zero weights to whole blocks."""

    place: object  # float64, four a source: x, y, z^2, z
    weight: object  # float32 or float64, two a source: re, im, scaled to 1 at most
    blocks: int
    normal: object  # None in free space, else three opaque float64: the opening's normal in the target's coordinates

    @classmethod
    def upload(
        cls,
        ad: ModuleType,
        points: np.ndarray,
        weights: np.ndarray,
        target: PlaneGrid | PlanePoints,
        unit: float,
        normal: np.ndarray | None,
        double: bool,
    ) -> _Sources:
        """Points (n, 3) [mm] to the target's coordinates in ``unit`` [mm], on the device."""
        blocks = -(-len(points) // BLOCK)
        count, index = dr.opaque(ad.UInt32, len(points)), dr.arange(ad.UInt32, blocks * BLOCK)
        inside = dr.minimum(index, count - 1)  # padding repeats the last place, with zero weight
        world = dr.gather(ad.Array3f64, ad.Float64(np.ascontiguousarray(points).ravel()), inside)
        axes = np.array([target.u, target.v, target.normal]) / unit

        def along(axis: np.ndarray):
            coordinate = dr.opaque(ad.Float64, -float(axis @ target.origin))
            for value, part in zip(axis, world, strict=True):
                coordinate = dr.fma(dr.opaque(ad.Float64, float(value)), part, coordinate)
            return coordinate

        x, y, z = (along(axis) for axis in axes)
        place = dr.empty(ad.Float64, 4 * blocks * BLOCK)
        dr.scatter(place, ad.Array4f64(x, y, z * z, z), index, mode=WRITE)
        padded = np.zeros(blocks * BLOCK, dtype=np.complex128 if double else np.complex64)
        padded[: len(points)] = weights
        parts = ad.Float64(padded.view(np.float64)) if double else ad.Float32(padded.view(np.float32))
        opaque_normal = None if normal is None else [dr.opaque(ad.Float64, value) for value in normal]
        dr.eval(place)
        return cls(place, parts, blocks, opaque_normal)

    @property
    def real(self) -> type:
        """Dr.Jit type of phasors and partial sums."""
        return type(self.weight)


def sum_in_blocks(ad: ModuleType, real: type, first_block, end_block, outputs: int, add):
    """Two nested symbolic loops: ``add(accumulators, number)`` over a block's sources in ``real``, float64 over blocks.

    first_block, end_block: of every lane; returns the ``outputs`` totals.
    """

    def over_blocks(block, end, *totals):
        def over_block(j, stop, *partial):
            return (j + 1, stop, *add(partial, j))

        start = block * BLOCK
        zeros = [dr.zeros(real, dr.width(block)) for _ in totals]
        state = dr.while_loop((start, start + BLOCK, *zeros), lambda j, stop, *_: j < stop, over_block)
        return (block + 1, end, *(t + ad.Float64(p) for t, p in zip(totals, state[2:], strict=True)))

    totals = [dr.zeros(ad.Float64, dr.width(first_block)) for _ in range(outputs)]
    return dr.while_loop(
        (first_block, end_block, *totals), lambda block, end, *_: block < end, over_blocks
    )[2:]


def _sum_over_sources(ad: ModuleType, sources: _Sources, first_block, end_block, outputs: int, add):
    """:func:`sum_in_blocks` of ``add(accumulators, place, weight)``."""
    pair = ad.Array2f64 if sources.real is ad.Float64 else ad.Array2f

    def add_source(partial, j):
        return add(partial, dr.gather(ad.Array4f64, sources.place, j), dr.gather(pair, sources.weight, j))

    return sum_in_blocks(ad, sources.real, first_block, end_block, outputs, add_source)


def _add_points(ad: ModuleType, sources: _Sources, a: list, b: list):
    """Adds one source to the points (a, b) [wavelengths]: one float64 path a pair."""
    real = sources.real

    def add(partial, place, weight):
        x, y, z_squared, z = place
        sums = list(partial)
        for i in range(len(a)):
            dx, dy = a[i] - x, b[i] - y
            squared = dr.fma(dx, dx, dr.fma(dy, dy, z_squared))
            inverse = inverse_root(squared, ad.Float32)
            r = squared * inverse
            term = multiply(weight, phasor(r, real))
            if sources.normal is None:
                amplitude = real(inverse)
            else:
                slope = dr.fma(sources.normal[0], dx, dr.fma(sources.normal[1], dy, -sources.normal[2] * z))
                amplitude = real(slope * inverse * inverse)
                near = real(inverse) * (1 / (2 * np.pi))
                term = multiply(term, (1.0, near))
            sums[2 * i] = dr.fma(amplitude, term[0], sums[2 * i])
            sums[2 * i + 1] = dr.fma(amplitude, term[1], sums[2 * i + 1])
        return sums

    return add


def _add_run(ad: ModuleType, sources: _Sources, a, b, pitch, run: int):
    """Adds one source to the ``run`` pixels around (a, b) [wavelengths], pixel i at a + (i - run/2) pitch.

    With t = (D - P).u/r, e = s/r: r(s) = r [1 + t e + (1 - t^2) e^2/2 - t (1 - t^2) e^3/2 + O(e^4)] and
    ln r(s) = ln r + t e + (1/2 - t^2) e^2 + (4 t^3/3 - t) e^3 + O(e^4). For F_i = f0 + f1 i + f2 i^2 + f3 i^3 the
    products z' = z w, w' = w q, q' = q p with z = e^F_0, w = e^(F_1 - F_0), q = e^(2 f2 + 6 f3), p = e^(6 f3) step
    through e^F_i.
    """
    half = run // 2

    def exponential_less_one(turns, logarithm):
        # e^x - 1 for x below 1e-2, and (cos, sin) - 1 by the half angle: nothing cancels and steps may be repeated.
        growth = dr.fma(logarithm * logarithm, 0.5, logarithm)
        sine, cosine = sine_cosine(ad.Float32(turns) * 0.5, SINE, COSINE)
        re, im = -2 * sine * sine, 2 * sine * cosine
        return dr.fma(re, growth, re + growth), dr.fma(im, growth, im)

    def grow(value, rate):
        """value (1 + rate), complex."""
        return (
            dr.fma(value[0], rate[0], dr.fma(-value[1], rate[1], value[0])),
            dr.fma(value[0], rate[1], dr.fma(value[1], rate[0], value[1])),
        )

    def add(partial, place, weight):
        x, y, z_squared, z = place
        sums = list(partial)
        dx, dy = a - x, b - y
        squared = dr.fma(dx, dx, dr.fma(dy, dy, z_squared))
        inverse = inverse_root(squared, ad.Float32)
        t = dx * inverse
        e = pitch * inverse
        across = dr.fma(-t, t, 1.0)
        f1 = pitch * t
        f2 = 0.5 * pitch * e * across
        f3 = -f2 * e * t
        # The amplitude's logarithm, in float32: a relative error of 1e-7 in terms of 1e-3.
        t32, e32 = ad.Float32(t), ad.Float32(e)
        powers = 1.0 if sources.normal is None else 2.0
        l1 = -powers * t32 * e32
        l2 = -powers * e32 * e32 * dr.fma(-t32, t32, 0.5)
        l3 = -powers * e32 * e32 * e32 * t32 * dr.fma(t32, t32 * (4 / 3), -1.0)
        if sources.normal is None:
            centre = multiply(weight, phasor(squared * inverse, ad.Float32))
            amplitude = ad.Float32(inverse)
        else:
            slope = dr.fma(sources.normal[0], dx, dr.fma(sources.normal[1], dy, -sources.normal[2] * z))
            amplitude = ad.Float32(slope * inverse * inverse)
            near = ad.Float32(inverse) * (1 / (2 * np.pi))
            centre = multiply(multiply(weight, phasor(squared * inverse, ad.Float32)), (1.0, near))
            g = ad.Float32(sources.normal[0] * pitch / slope)
            l1, l2, l3 = l1 + g, l2 - g * g * 0.5, l3 + g * g * g * (1 / 3)
            # The near-field factor 1 + i/(kr) turns along the run by -e t/(kr) to first order.
            f1 = f1 - ad.Float64(near * t32 * e32) * (1 / (2 * np.pi))
        centre = centre[0] * amplitude, centre[1] * amplitude
        for direction in (1, -1):
            odd, odd_log = direction * f3, direction * l3
            step_turns = direction * f1 + f2 + odd
            cosine, sine = phasor(step_turns, ad.Float32)
            # Rounding leaves a modulus of 1 +- 1e-7, which half a run of products would raise to the eighth power.
            excess = dr.fma(cosine, cosine, dr.fma(sine, sine, -1.0))
            growth = direction * l1 + l2 + odd_log + 0.5 * l1 * l1
            step = grow((cosine, sine), (dr.fma(excess, -0.5, growth), 0.0))
            change = exponential_less_one(2 * f2 + 6 * odd, 2 * l2 + 6 * odd_log)
            drift = exponential_less_one(6 * odd, 6 * odd_log)
            value = centre
            for i in range(half if direction == 1 else half + 1):
                if i > 0 or direction == 1:
                    k = 2 * (half + direction * i)
                    sums[k], sums[k + 1] = sums[k] + value[0], sums[k + 1] + value[1]
                value = multiply(value, step)
                step = grow(step, change)
                # (1 + change)(1 + drift) - 1
                product = multiply(change, drift)
                change = change[0] + drift[0] + product[0], change[1] + drift[1] + product[1]
        return sums

    return add


def direct_sum(
    path: FreeSpace | RayleighSommerfeld,
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    wavelength: float,
    tolerance: float = 1e-6,
) -> np.ndarray:
    """E_m = sum_j c_j A(P_j, D_m) e^{+ikV(P_j, D_m)} for every pair, complex128 of the target's shape.

    Relative L2 error 1e-6 or better; with a smaller ``tolerance`` everything is float64 (three times slower).

    sources: (n, 3) [mm]; weights c: (n,) complex; wavelength [mm]. Memory beyond the result is bounded.
    A change of the number of sources or targets, of the geometry or of the wavelength compiles nothing anew.
    """
    ad = arrays()
    scale = float(np.abs(weights).max(initial=0.0)) or 1.0
    normal = None
    factor = scale / wavelength
    unit_weights = weights / scale
    if isinstance(path, RayleighSommerfeld):
        normal = np.array([path.normal @ target.u, path.normal @ target.v, path.normal @ target.normal])
        factor = scale / wavelength**2
        unit_weights = unit_weights / 1j
    double = tolerance < SINGLE_PRECISION
    device = _Sources.upload(ad, sources, unit_weights, target, wavelength, normal, double)
    if isinstance(target, PlanePoints):
        return _points_field(ad, device, target.a / wavelength, target.b / wavelength, factor)
    run = None if double else choose_run(Extent.of(sources, target), target, wavelength, normal)
    if run is None:
        rows_at_once = max(1, POINTS_PER_LANE * LANES_AT_ONCE // target.shape[1])
        field = np.empty(target.shape, dtype=np.complex128)
        for row in range(0, target.shape[0], rows_at_once):
            b, a = np.meshgrid(target.rows[row : row + rows_at_once], target.columns, indexing="ij")
            part = _points_field(ad, device, a.ravel() / wavelength, b.ravel() / wavelength, factor)
            field[row : row + rows_at_once] = part.reshape(b.shape)
            tell("pairs", row + rows_at_once, target.shape[0])
        return field
    return _grid_field(ad, device, target, target.pitch / wavelength, run, factor)


def _slices(ad: ModuleType, lanes: int, blocks: int):
    """How many slices the sources are cut into, and the first and end block of every lane (slice-major)."""
    slices = min(blocks, max(1, MINIMUM_LANES // lanes))
    index = dr.arange(ad.UInt32, lanes * slices)
    lane_count, per_slice = dr.opaque(ad.UInt32, lanes), dr.opaque(ad.UInt32, -(-blocks // slices))
    number = index // lane_count
    first = number * per_slice
    end = dr.minimum(first + per_slice, dr.opaque(ad.UInt32, blocks))
    return slices, number, index - number * lane_count, first, end


def _points_field(ad: ModuleType, sources: _Sources, a: np.ndarray, b: np.ndarray, factor: float) -> np.ndarray:
    """Field (m,) at points (a, b) [wavelengths]."""
    field = np.empty(a.size, dtype=np.complex128)
    step = POINTS_PER_LANE * LANES_AT_ONCE
    for start in range(0, a.size, step):
        count = min(step, a.size - start)
        lanes = -(-count // POINTS_PER_LANE)
        slices, number, lane, first, end = _slices(ad, lanes, sources.blocks)
        device_a, device_b = ad.Float64(a[start : start + count]), ad.Float64(b[start : start + count])
        size, lane_count = dr.opaque(ad.UInt32, count), dr.opaque(ad.UInt32, lanes)
        places = [dr.minimum(lane + lane_count * i, size - 1) for i in range(POINTS_PER_LANE)]
        points_a = [dr.gather(ad.Float64, device_a, place) for place in places]
        points_b = [dr.gather(ad.Float64, device_b, place) for place in places]
        sums = _sum_over_sources(
            ad, sources, first, end, 2 * POINTS_PER_LANE, _add_points(ad, sources, points_a, points_b)
        )
        out = dr.empty(ad.Float64, 2 * slices * count)
        scale = dr.opaque(ad.Float64, factor)
        for i in range(POINTS_PER_LANE):
            inside = lane + lane_count * i < size
            value = ad.Array2f64(sums[2 * i] * scale, sums[2 * i + 1] * scale)
            dr.scatter(out, value, number * size + places[i], inside, mode=WRITE)
        field[start : start + count] = _host(out).reshape(slices, count).sum(axis=0)
    return field


def _grid_field(
    ad: ModuleType, sources: _Sources, grid: PlaneGrid, pitch: float, run: int, factor: float
) -> np.ndarray:
    """Field (rows, columns) on a grid of ``pitch`` [wavelengths]."""
    rows, columns = grid.shape
    runs = -(-columns // run)
    field = np.empty(grid.shape, dtype=np.complex128)
    rows_at_once = max(1, LANES_AT_ONCE // runs)
    column_count, runs_a_row = dr.opaque(ad.UInt32, columns), dr.opaque(ad.UInt32, runs)
    opaque_pitch, scale = dr.opaque(ad.Float64, pitch), dr.opaque(ad.Float64, factor)
    for first_row in range(0, rows, rows_at_once):
        count = min(rows_at_once, rows - first_row)
        slices, number, lane, first, end = _slices(ad, count * runs, sources.blocks)
        row = lane // runs_a_row
        column = (lane - row * runs_a_row) * run
        a = ad.Float64(column + run // 2) * opaque_pitch
        b = ad.Float64(row + dr.opaque(ad.UInt32, first_row)) * opaque_pitch
        sums = _sum_over_sources(ad, sources, first, end, 2 * run, _add_run(ad, sources, a, b, opaque_pitch, run))
        out = dr.empty(ad.Float64, 2 * slices * count * columns)
        base = (number * dr.opaque(ad.UInt32, count) + row) * column_count + column
        for i in range(run):
            value = ad.Array2f64(sums[2 * i] * scale, sums[2 * i + 1] * scale)
            dr.scatter(out, value, base + i, column + i < column_count, mode=WRITE)
        field[first_row : first_row + count] = _host(out).reshape(slices, count, columns).sum(axis=0)
        tell("pairs", first_row + count, rows)
    return field


def _host(interleaved) -> np.ndarray:
    """Complex128 view of an array of (re, im) pairs on the device."""
    return np.ascontiguousarray(interleaved.numpy()).view(np.complex128)
