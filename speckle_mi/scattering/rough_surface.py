"""The rough surface as material: scatterers that stay where they are on it, whatever its pose.

The surface consists of plane facets: one rectangle, or the triangles of a mesh. Each facet carries a lattice of
square cells with one scatterer at a random place in each (a jittered lattice has no grating lobes). Place and
height of a scatterer are pure functions of (surface seed, facet, cell), so any pose, order of frames or
partition of the work finds the same scatterers.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import numpy as np

from ..errors import InputError
from ..geometry.frames import Frame
from ..machine.backend import arrays, opaque, opaque_vector
from . import hashing
from .beam import Beam
from .beam_kernel import BeamKernel
from .facets import Facets
from .footprint import footprint_bounds

MAX_CELLS = 100_000_000
"""Most cells that one frame may look at (about 5 GB of memory at the peak)."""

_PLACE_U, _PLACE_V, _HEIGHT_RADIUS, _HEIGHT_ANGLE = range(4)
_LATTICE_SEED = 0x6C61747469636500


@dataclass(frozen=True)
class RoughSurface:
    """Facets with scatterers on them.

    density: scatterers per area [1/mm^2]; roughness: rms height [mm]; correlation_length: 1/e length of the
    heights' Gaussian autocorrelation [mm], 0 = independent heights; seed: which surface.
    """

    facets: Facets
    density: float
    roughness: float
    correlation_length: float
    seed: int

    def scatterers(self, beam: Beam, frame: Frame) -> SurfaceScatterers:
        """The scatterers of all cells that the beam may reach with the surface at ``frame``: the material alone.

        ``surface.scatterers(beam, frame).at(frame).lit_by(beam)`` are those under the beam with the light on them.
        Raises ValueError when more than :data:`MAX_CELLS` cells would have to be looked at.
        """
        return SurfaceScatterers(self, _cells_under_beam(self, beam, frame))


@dataclass(frozen=True)
class PointScatterers:
    """The user's own scatterers: points (n, 3) [mm] in the target frame, weights (n,) complex."""

    points: np.ndarray
    weights: np.ndarray

    def at(self, frame: Frame) -> PlacedPoints:
        """The scatterers with the target at ``frame``."""
        return PlacedPoints(self, frame)


@dataclass(frozen=True)
class PlacedPoints:
    """The user's own scatterers where they are in the world."""

    scatterers: PointScatterers
    frame: Frame

    def lit_by(self, beam: Beam) -> Scatterers:
        """All of them, with the beam's field times their weight."""
        position = self.frame.to_world(self.scatterers.points)
        normal = np.broadcast_to(self.frame.axes[:, 2], position.shape)
        return Scatterers(position, beam.field(position) * self.scatterers.weights, normal)


@dataclass(frozen=True)
class Scatterers:
    """Point sources under the beam at one pose.

    position: (n, 3) [mm], world; amplitude: (n,) complex128, the illumination there times the scatterer's weight;
    normal: (n, 3) world unit normal of the mean surface at each scatterer, one row repeated where it is plane.
    """

    position: np.ndarray
    amplitude: np.ndarray
    normal: np.ndarray = field(repr=False)

    @property
    def count(self) -> int:
        return len(self.amplitude)

    @property
    def on_plane(self) -> bool:
        """Whether all lie on one plane facet, whose normal is stored once."""
        return self.count > 0 and self.normal.strides[0] == 0

    def selected(self, keep: np.ndarray) -> Scatterers:
        """Those where ``keep`` (n,) is true, or that ``keep`` numbers."""
        position = self.position[keep]
        normal = np.broadcast_to(self.normal[0], position.shape) if self.on_plane else self.normal[keep]
        return Scatterers(position, self.amplitude[keep], normal)


def illuminated_scatterers(surface: RoughSurface, beam: Beam, frame: Frame) -> Scatterers:
    """Scatterers of ``surface`` that the beam reaches with the target at ``frame``."""
    return surface.scatterers(beam, frame).at(frame).lit_by(beam)


@dataclass(frozen=True)
class _Cells:
    """Blocks of lattice cells to look at: facet number, first cell and size along e1 and e2, first lane."""

    facet: np.ndarray
    first: np.ndarray
    size: np.ndarray
    start: np.ndarray
    total: int


def _cells_under_beam(surface: RoughSurface, beam: Beam, frame: Frame) -> _Cells:
    facets = surface.facets
    pitch = surface.density**-0.5
    lower, upper = facets.bounds[:, 0::2].copy(), facets.bounds[:, 1::2].copy()
    if not beam.is_uniform:
        centre, half = footprint_bounds(facets, beam, frame)
        lower, upper = np.fmax(lower, centre - half), np.fmin(upper, centre + half)
    meets = np.all(upper > lower, axis=1)
    first = np.floor(lower[meets] / pitch)
    size = np.ceil(upper[meets] / pitch) - first
    count = np.prod(size, axis=1)
    total = float(np.sum(count))
    if total > MAX_CELLS:
        raise InputError(
            f"the target's scatterers: about {total:.2g} lie under the beam or on the patch "
            f"(some {total * 50 / 1e9:.3g} GB), must be at most {MAX_CELLS:.0e}: reduce point_sources or the lit area"
        )
    start = np.concatenate([[0], np.cumsum(count)[:-1]]) if len(count) else np.zeros(0)
    return _Cells(
        np.flatnonzero(meets), first.astype(np.int64), size.astype(np.int64), start.astype(np.int64), int(total)
    )


class SurfaceScatterers:
    """Scatterers as parts of the material, one cell of the lattice each: where on it, how high.

    Dr.Jit expressions in the target's own frame; nothing is computed before they are placed and lit.
    """

    def __init__(self, surface: RoughSurface, cells: _Cells) -> None:
        self.surface, self.cells = surface, cells
        if cells.total == 0:
            return
        lanes = self.lanes = arrays()
        facets, lane = surface.facets, dr.arange(lanes.UInt32, cells.total)
        if len(cells.facet) == 1:
            self.row, block = None, lane
        else:
            rows = np.repeat(np.arange(len(cells.facet), dtype=np.uint32), np.prod(cells.size, axis=1))
            self.row = lanes.UInt32(rows)
            block = lane - self.of_row(cells.start.astype(np.uint32), lanes.UInt32)
        width = self.of_row(cells.size[:, 0].astype(np.float64))
        # An integer division would trap in the padding lanes of the last packet, whose divisor is zero.
        down = lanes.UInt32(dr.floor((lanes.Float64(block) + 0.5) / width))
        first = [self.of_row(cells.first[:, k], lanes.Int64) for k in range(2)]
        cell = [lanes.Int64(block - down * lanes.UInt32(width)) + first[0], lanes.Int64(down) + first[1]]
        facet = self.of_row(cells.facet.astype(np.uint64), lanes.UInt64)
        seed = dr.opaque(lanes.UInt64, hashing.seed_word(surface.seed))
        key = hashing.cell_key(seed, facet, *(lanes.UInt64(number) for number in cell), kind=lanes.UInt64)
        pitch = opaque(surface.density**-0.5)
        a, b = ((lanes.Float64(number) + self._uniform(key, stream)) * pitch
                for number, stream in zip(cell, (_PLACE_U, _PLACE_V), strict=True))  # fmt: skip
        self.inside = lanes.Bool(True)
        for e in range(4):
            p, q, r = (self.of_row(facets.edges[cells.facet, e, k]) for k in range(3))
            self.inside &= p * a + q * b <= r
        origin, e1, e2 = (self.vectors(getattr(facets, name)[cells.facet]) for name in ("origin", "e1", "e2"))
        self.place = origin + a * e1 + b * e2
        self.height = self._height(key)

    @property
    def total(self) -> int:
        """Cells that are looked at."""
        return self.cells.total

    def at(self, frame: Frame) -> PlacedScatterers:
        """The scatterers with the target at ``frame``."""
        return PlacedScatterers(self, frame)

    def of_row(self, values: np.ndarray, kind: type | None = None):
        """What a facet's cells share, one a lane."""
        kind = kind or self.lanes.Float64
        if self.row is None:
            return dr.opaque(kind, values[0].item())
        return dr.gather(kind, kind(np.ascontiguousarray(values)), self.row)

    def vectors(self, values: np.ndarray):
        """Vectors (f, 3) that a facet's cells share, one a lane."""
        return self.lanes.Array3f64(*(self.of_row(values[:, k]) for k in range(3)))

    def _height(self, key):
        """Heights [mm]: Gaussian, independent or with a Gaussian autocorrelation."""
        rms = opaque(self.surface.roughness)
        if self.surface.correlation_length == 0:
            return rms * self._gaussian(key)
        dimensions = 2 if self.surface.facets.count == 1 else 3
        return rms * self._correlated([self.place.x, self.place.y, self.place.z][:dimensions])

    def _uniform(self, key, stream: int):
        return self.lanes.Float64(hashing.uniform_bits(key, stream, self.lanes.UInt64)) * 2.0**-53

    def _gaussian(self, key):
        """Standard normal deviates by Box and Muller's transform."""
        radius = dr.sqrt(-2 * dr.log(1 - self._uniform(key, _HEIGHT_RADIUS)))
        return radius * dr.cos(2 * np.pi * self._uniform(key, _HEIGHT_ANGLE))

    def _correlated(self, place):
        """Unit-variance Gaussian noise with autocorrelation exp(-r^2/l^2) at places given by 2 or 3 coordinates.

        White noise on a lattice of pitch l/2 convolved with exp(-2 r^2/l^2), cut off at 2 l where the kernel is
        3e-4, and divided by the root of its local sum of squares.
        """
        lanes, bits = self.lanes, 3
        reach = 1 << bits
        length = opaque(self.surface.correlation_length)
        scaled = [coordinate * (2 / length) for coordinate in place]
        corner = [lanes.Int64(dr.floor(coordinate)) - (reach // 2 - 1) for coordinate in scaled]
        seed = dr.opaque(lanes.UInt64, hashing.seed_word(self.surface.seed ^ _LATTICE_SEED))

        def step(number, total, squares):
            cell = [first + lanes.Int64((number >> (bits * axis)) & (reach - 1)) for axis, first in enumerate(corner)]
            distance = sum((c - lanes.Float64(k)) ** 2 for c, k in zip(scaled, cell, strict=True))
            weight = dr.exp(-0.5 * distance)
            key = hashing.cell_key(seed, *(lanes.UInt64(k) for k in cell), kind=lanes.UInt64)
            return number + 1, total + weight * self._gaussian(key), squares + weight * weight

        nodes = reach ** len(place)
        zero = dr.zeros(lanes.Float64, dr.width(scaled[0]))
        _, total, squares = dr.while_loop(
            (lanes.UInt32(0), zero, zero + 0), lambda number, *_: number < nodes, step, label="correlated heights"
        )
        return total * dr.rsqrt(squares)


class PlacedScatterers:
    """Scatterers of the material where they are in the world."""

    def __init__(self, material: SurfaceScatterers, frame: Frame) -> None:
        self.material, self.frame = material, frame

    def lit_by(self, beam: Beam) -> Scatterers:
        """Those on their facet, on the side of the light and within the beam, with its field on them."""
        material, frame = self.material, self.frame
        if material.total == 0:
            return Scatterers(np.zeros((0, 3)), np.zeros(0, complex), np.zeros((0, 3)))
        facets, lanes = material.surface.facets, material.lanes
        local, axes = material.place, [opaque_vector(frame.axes[:, k]) for k in range(3)]
        mean = opaque_vector(frame.origin) + local.x * axes[0] + local.y * axes[1] + local.z * axes[2]
        normal = material.vectors(facets.normal[material.cells.facet] @ frame.axes.T)
        position = mean + material.height * normal
        kernel = BeamKernel(beam)
        to_source, real, imaginary = kernel.evaluate(position)
        lit = material.inside & (dr.dot(to_source, normal) > 0)
        if not beam.is_uniform:
            lit &= kernel.within(mean)
        # Everything is computed for all cells at once in one kernel; then those under the beam are picked.
        amplitude = lanes.Array2f64(real, imaginary)
        curved = facets.count > 1
        dr.eval(lit, position, amplitude, normal if curved else ())
        index = dr.compress(lit)
        # Interleaved on the device: NumPy only looks at the result.
        picked = [
            dr.ravel(dr.gather(type(value), value, index))
            for value in (position, amplitude, *((normal,) if curved else ()))
        ]
        dr.eval(picked)
        places, amplitudes, *normals = (value.numpy() for value in picked)
        places = places.reshape(-1, 3)
        if curved:
            return Scatterers(places, amplitudes.view(np.complex128), normals[0].reshape(-1, 3))
        return Scatterers(
            places, amplitudes.view(np.complex128), np.broadcast_to(frame.axes @ facets.normal[0], places.shape)
        )
