"""The field on few nodes: without its common phase it is band-limited by the extent of the sources.

E(D) e^{-ikV(P0, D)} contains along u no spatial frequency beyond max |d/du [V(P, D) - V(P0, D)]|/lambda over the
sources P. It is sampled on a tensor Chebyshev grid of that bandwidth, interpolated to the pixels by two real matrix
products, and given its common phase back. The bandwidth is measured on the paths themselves, not estimated paraxially.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import numpy as np
from scipy import fft

from ..geometry.plane import PlaneGrid, PlanePoints
from ..machine.backend import arrays
from ..machine.cores import equal_slices, on_all_cores, usable_cores
from .area import Area
from .chebyshev import chebyshev_nodes, interpolation_matrix
from .direct import SINGLE_PRECISION, supports
from .paths import Path
from .phasors import WRITE, phasor, unit_phasor
from .source_box import SourceBox, for_chunks

PROBES = 17
"""Places along each side of the target where the local bandwidth is measured."""

REACH_BINS = 32
"""Bins of a source's bandwidth relative to the outermost one's, in which power is counted."""

POWER_SAMPLE = 1 << 16
"""Sources from which the spread of the power is estimated, evenly taken from all."""

BANDWIDTH_MARGIN = 1.02
"""Covers what the secants between probes miss of the steepest slope."""

PHASE_NODES = 24
"""Nodes along each side that carry the common phase of a path without closed form.

A path traced through lenses is a series of seven or so terms a side: eight nodes carry it to 1e-9 wavelengths in every
scene that ships. Three times as many are still only 576 paths, and hold paths three times as rough."""

PIXELS_AT_ONCE = 1 << 22
"""Pixels interpolated at once: bounds the memory beyond the result at 128 MB."""


def _regular_matrix(count: int, pixels: int, double: bool) -> np.ndarray:
    """Interpolation matrix (pixels, count) to pixels evenly spaced from end to end."""
    places = np.linspace(-1.0, 1.0, pixels) if pixels > 1 else np.zeros(1)
    # Pixels and nodes lie the same from either end.
    matrix = np.empty((pixels, count), dtype=np.float64 if double else np.float32)
    half = -(-pixels // 2)
    matrix[:half] = interpolation_matrix(count, places[:half])
    matrix[half:] = matrix[pixels - half - 1 :: -1, ::-1][: pixels - half]
    return matrix


def _tails(half_turns: float) -> np.ndarray:
    """(REACH_BINS, n) error of n Chebyshev nodes for e^{2 pi i s x}, |x| <= 1, s the upper edge of each bin of reach.

    The Chebyshev coefficients of a plane wave are 2 i^n J_n(2 pi s): the sum of those left out bounds the error. The
    Bessel functions are taken from the Jacobi-Anger series, cos(z sin t) = J_0 + 2 sum J_2m cos(2mt) and
    sin(z sin t) = 2 sum J_2m+1 sin((2m + 1)t), by fast transforms over a quarter turn of t: exact to rounding once no
    order beyond the transforms' counts, and hundreds of times faster than one by one.
    """
    bandwidth = 2 * np.pi * half_turns
    orders = bandwidth + 12 * bandwidth ** (1 / 3) + 60
    count = fft.next_fast_len(int(orders) // 2 + 1, real=True)
    reach = (np.arange(REACH_BINS) + 1) / REACH_BINS
    argument = np.outer(bandwidth * reach, np.sin(np.pi / 2 * (np.arange(count) + 0.5) / count))
    twice_even, twice_odd = fft.dct(np.cos(argument), 2) / count, fft.dst(np.sin(argument), 4) / count
    left_out = np.abs(np.stack([twice_even, twice_odd], axis=2)).reshape(REACH_BINS, -1)
    return np.cumsum(left_out[:, ::-1], axis=1)[:, ::-1]


def nodes_for(half_turns: float, power: np.ndarray, tolerance: float) -> int:
    """Chebyshev nodes that carry the field of sources to the relative L2 ``tolerance``.

    half_turns: bandwidth of the outermost source; power: (REACH_BINS,) share of the sources' power by their bandwidth
    relative to that. Outer sources that bring little light may be carried less well.
    """
    error = np.sqrt(power @ np.minimum(_tails(half_turns), 2.0) ** 2)
    # Two nodes more for the amplitude, which varies slowly but varies.
    return int(np.argmax(error < tolerance)) + 2


@dataclass(frozen=True)
class Reach:
    """How far sources reach along the directions that set the bandwidth.

    bounds: (1 + q, 3) the box centre and the outermost sources [mm]; power: (2, REACH_BINS) share of the sources' power
    by their reach relative to the outermost, for the target's u and v.
    """

    bounds: np.ndarray
    power: np.ndarray


def reach_of(
    path: Path, sources: np.ndarray, weights: np.ndarray, box: SourceBox, target: PlaneGrid | PlanePoints
) -> Reach:
    """The outermost sources, and how the power |c|^2 is spread between the middle and them.

    The slope of the path along u or v is nearly linear in the source, with a direction in the box that is measured at
    the middle and the corners of the target; the sources farthest along these directions bound it.
    """
    directions, axes = _slope_directions(path, box, target)
    if not len(directions):
        return Reach(box.centre[None], np.full((2, REACH_BINS), 1 / REACH_BINS))

    def extremes(chunk: slice) -> np.ndarray:
        along = directions @ box.to_local(sources[chunk]).T.astype(np.float32)
        return chunk.start + np.concatenate([along.argmax(axis=1), along.argmin(axis=1)])

    found = np.unique(np.concatenate(for_chunks(extremes, len(sources))))
    # Each chunk has its extremes; those of them all are among these.
    along = directions @ box.to_local(sources[found]).T
    bounds = np.vstack([box.centre, sources[found[np.unique([along.argmax(axis=1), along.argmin(axis=1)])]]])
    farthest = np.abs(along).max(axis=1)
    some = slice(None, None, max(1, len(sources) // POWER_SAMPLE))
    relative = np.abs(directions @ box.to_local(sources[some]).T) / np.where(farthest > 0, farthest, 1.0)[:, None]
    share = np.abs(weights[some]) ** 2
    power = np.zeros((2, REACH_BINS))
    for axis in (0, 1):
        if np.any(axes == axis) and share.sum() > 0:
            reach = relative[axes == axis].max(axis=0)
            place = np.minimum(np.ceil(reach * REACH_BINS).astype(int), REACH_BINS) - 1
            power[axis] = np.bincount(np.maximum(place, 0), share, minlength=REACH_BINS) / share.sum()
    return Reach(bounds, power)


def _slope_directions(path: Path, box: SourceBox, target: PlaneGrid | PlanePoints) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (q, 3) in the box along which the path's slope on the target grows, and along which axis (q,)."""
    faces = box.to_world(np.vstack([np.eye(3), -np.eye(3)]))
    # Pairs of places on either side of the middle and the corners: along u, then along v, of each.
    middles = np.array([(0.0, 0.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
    steps = 0.04 * np.array([[(-1.0, 0.0), (1.0, 0.0)], [(0.0, -1.0), (0.0, 1.0)]])
    places = (middles[:, None, None] + steps).reshape(-1, 2)
    length = path(faces, Area.around(target).points(target, places).points())[0].reshape(6, -1, 2)
    slope = length[..., 1] - length[..., 0]
    directions = (slope[:3] - slope[3:]).T
    norm = np.linalg.norm(directions, axis=1)
    moving = norm > 0
    axes = np.arange(len(directions)) % 2
    return (directions[moving] / norm[moving, None]).astype(np.float32), axes[moving]


def local_bandwidth(
    path: Path, box: np.ndarray, target: PlaneGrid | PlanePoints, rectangle: Area, wavelength: float
) -> tuple[float, float]:
    """Largest |d/du [V(P, D) - V(P0, D)]|/lambda and the same along v [turns/mm], P0 = box[0], P in box[1:]."""
    a = np.linspace(*rectangle.a, PROBES)
    b = np.linspace(*rectangle.b, PROBES)
    grid_b, grid_a = np.meshgrid(b, a, indexing="ij")
    places = PlanePoints(target.origin, target.u, target.v, grid_a.ravel(), grid_b.ravel()).points()
    length = path(box, places)[0].reshape(len(box), PROBES, PROBES)
    turns = (length[1:] - length[0]) / wavelength

    def steepest(side: np.ndarray, axis: int) -> float:
        step = side[1] - side[0]
        return float(np.abs(np.diff(turns, axis=axis)).max(initial=0.0)) / step if step > 0 else 0.0

    return BANDWIDTH_MARGIN * steepest(a, 2), BANDWIDTH_MARGIN * steepest(b, 1)


@dataclass(frozen=True)
class NodeGrid:
    """Tensor Chebyshev nodes on a rectangle of the target, ``count`` = (along u, along v)."""

    count: tuple[int, int]
    rectangle: Area

    @property
    def size(self) -> int:
        return self.count[0] * self.count[1]

    def points(self, target: PlaneGrid | PlanePoints) -> PlanePoints:
        """The nodes, v-major."""
        b, a = np.meshgrid(chebyshev_nodes(self.count[1]), chebyshev_nodes(self.count[0]), indexing="ij")
        return self.rectangle.points(target, np.stack([a.ravel(), b.ravel()], axis=1))


def node_grid(
    path: Path, reach: Reach, target: PlaneGrid | PlanePoints, wavelength: float, tolerance: float
) -> NodeGrid:
    """Nodes that carry the field of sources of that reach to the relative L2 ``tolerance``."""
    rectangle = Area.around(target)
    bandwidth = local_bandwidth(path, reach.bounds, target, rectangle, wavelength)
    count = tuple(
        nodes_for(rate * (side[1] - side[0]) / 2, power, tolerance) if side[1] > side[0] else 1
        for rate, side, power in zip(bandwidth, (rectangle.a, rectangle.b), reach.power, strict=True)
    )
    return NodeGrid(count, rectangle)


def band_limited_sum(
    evaluate: Callable[[PlanePoints], np.ndarray],
    path: Path,
    reference: np.ndarray,
    nodes: NodeGrid,
    target: PlaneGrid | PlanePoints,
    wavelength: float,
    tolerance: float,
) -> np.ndarray:
    """Field on the target, complex128 of its shape, from the field that ``evaluate`` gives on the nodes.

    reference: (3,) the point P0 whose phase is the common one, as in ``Reach.bounds[0]``.
    """
    double = tolerance < 4 * SINGLE_PRECISION
    places = nodes.points(target)
    at_nodes = evaluate(places) * np.conj(_common_phasor(path, reference, places.points(), wavelength))
    values = at_nodes.reshape(nodes.count[1], nodes.count[0])
    scale = float(np.abs(values).max()) or 1.0
    # (nodes v, 2, nodes u): real and imaginary parts side by side, so that the matrices stay real.
    parts = np.stack([values.real, values.imag], axis=1) / scale
    if not double:
        parts = parts.astype(np.float32)
    if isinstance(target, PlaneGrid):
        return _interpolate_grid(parts, path, reference, nodes, target, wavelength, scale)
    return _interpolate_points(parts, path, reference, nodes, target, wavelength, scale)


def _common_phasor(path: Path, reference: np.ndarray, places: np.ndarray, wavelength: float) -> np.ndarray:
    return unit_phasor(path(reference[None], places)[0][0] / wavelength)


def _interpolate_grid(
    parts: np.ndarray,
    path: Path,
    reference: np.ndarray,
    nodes: NodeGrid,
    grid: PlaneGrid,
    wavelength: float,
    scale: float,
) -> np.ndarray:
    rows, columns = grid.shape
    double = parts.dtype == np.float64
    along_u = _regular_matrix(nodes.count[0], columns, double)
    along_v = _regular_matrix(nodes.count[1], rows, double)
    # Along u on the few rows of nodes first: fewer products than along v first, wherever there are more rows of pixels.
    wide = (parts.reshape(-1, nodes.count[0]) @ along_u.T).reshape(nodes.count[1], -1)
    turns = None if supports(path) else _smooth_turns(path, reference, nodes, grid, wavelength)
    step = max(1, PIXELS_AT_ONCE // columns)
    field = np.empty(grid.shape, dtype=np.complex128) if rows > step else None
    for row in range(0, rows, step):
        chunk = slice(row, min(row + step, rows))
        smooth = _product(along_v[chunk], wide)
        given = None if turns is None else turns(chunk)
        part = _with_common_phase(smooth, given, reference, grid, row, wavelength, scale)
        if field is None:
            return part
        field[chunk] = part
    return field


def _product(matrix: np.ndarray, other: np.ndarray) -> np.ndarray:
    """matrix @ other, the rows shared out to the cores."""
    product = np.empty((len(matrix), other.shape[1]), dtype=other.dtype)
    pieces = equal_slices(len(matrix), usable_cores())
    on_all_cores(lambda piece: np.matmul(matrix[piece], other, out=product[piece]), pieces)
    return product


def _with_common_phase(
    smooth: np.ndarray,
    turns: np.ndarray | None,
    reference: np.ndarray,
    grid: PlaneGrid,
    first_row: int,
    wavelength: float,
    scale: float,
) -> np.ndarray:
    """``smooth`` (rows, 2, columns) real times e^{ikV(P0, D)}: V the distance, or the given turns (rows, columns)."""
    ad = arrays()
    columns = grid.shape[1]
    count = smooth.size // 2
    real, pair = (ad.Float64, ad.Array2f64) if smooth.dtype == np.float64 else (ad.Float32, ad.Array2f)
    column_count = dr.opaque(ad.UInt32, columns)
    index = dr.arange(ad.UInt32, count)
    row = index // column_count
    column = index - row * column_count
    if turns is None:
        offset = (grid.origin - reference) / wavelength
        pitch = grid.pitch / wavelength
        origin = (offset @ grid.u, offset @ grid.v + first_row * pitch, (offset @ grid.normal) ** 2)
        x, y, z_squared, opaque_pitch = (dr.opaque(ad.Float64, float(value)) for value in (*origin, pitch))
        dx, dy = dr.fma(ad.Float64(column), opaque_pitch, x), dr.fma(ad.Float64(row), opaque_pitch, y)
        total = dr.sqrt(dr.fma(dx, dx, dr.fma(dy, dy, z_squared)))
    else:
        total = ad.Float64(turns.ravel())
    cosine, sine = phasor(total, real)
    data = real(smooth.ravel())
    place = (row + row) * column_count + column
    re, im = dr.gather(real, data, place), dr.gather(real, data, place + column_count)
    factor = dr.opaque(ad.Float64, scale)
    value = pair(re * cosine - im * sine, re * sine + im * cosine)
    out = dr.empty(ad.Float64, 2 * count)
    dr.scatter(out, ad.Array2f64(value) * factor, index, mode=WRITE)
    return out.numpy().view(np.complex128).reshape(-1, columns)


def _smooth_turns(
    path: Path, reference: np.ndarray, nodes: NodeGrid, grid: PlaneGrid, wavelength: float
) -> Callable[[slice], np.ndarray]:
    """V(P0, D)/lambda on rows of the grid for a path without closed form, from its values on Chebyshev nodes."""
    coarse = NodeGrid((PHASE_NODES, PHASE_NODES), nodes.rectangle)
    values = path(reference[None], coarse.points(grid).points())[0].reshape(coarse.count) / wavelength
    along_u = _regular_matrix(PHASE_NODES, grid.shape[1], True)
    along_v = _regular_matrix(PHASE_NODES, grid.shape[0], True)
    middle = values.mean()
    return lambda rows: along_v[rows] @ (values - middle) @ along_u.T + (middle - np.round(middle))


def _interpolate_points(
    parts: np.ndarray,
    path: Path,
    reference: np.ndarray,
    nodes: NodeGrid,
    target: PlanePoints,
    wavelength: float,
    scale: float,
) -> np.ndarray:
    flat = parts.reshape(nodes.count[1], -1)

    def part(chunk: slice) -> np.ndarray:
        at = nodes.rectangle.unit_places(target.a[chunk], target.b[chunk])
        along_u, along_v = (
            interpolation_matrix(count, x).astype(parts.dtype) for count, x in zip(nodes.count, at.T, strict=True)
        )
        rows = (along_v @ flat).reshape(-1, 2, nodes.count[0])
        smooth = np.einsum("mpu,mu->mp", rows, along_u)
        some = PlanePoints(target.origin, target.u, target.v, target.a[chunk], target.b[chunk])
        common = _common_phasor(path, reference, some.points(), wavelength)
        return scale * (smooth[:, 0] + 1j * smooth[:, 1]) * common

    return np.concatenate(for_chunks(part, target.size))
