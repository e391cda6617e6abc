"""Several fields carried from an opening to points behind it, and one of them with its slopes, in one pass.

All have the same kernel of the first Rayleigh-Sommerfeld integral (see :mod:`.paths`), of which a pair's root and
phasor are most of the work. Paths are float64, phasors and sums over blocks of sources float32, sums over blocks
float64, as in :mod:`.direct`.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import numpy as np

from ..geometry.plane import PlanePoints
from ..machine.backend import arrays, opaque
from .direct import BLOCK, LANES_AT_ONCE, sum_in_blocks
from .paths import RayleighSommerfeld
from .phasors import inverse_root, multiply, phasor
from .rates import RatePath, centre_of_power

_PACKET = 4
"""Float32 numbers that one gather fetches: two fields."""


@dataclass(frozen=True)
class Carried:
    """values: (k, m) the fields; along: (2, m) slopes of the first along the target's u and v [1/mm]."""

    values: np.ndarray
    along: np.ndarray


def carried(
    path: RayleighSommerfeld, sources: np.ndarray, rows: np.ndarray, target: PlanePoints, wavelength: float
) -> Carried:
    """The fields of ``rows`` (k, n), complex, of sources (n, 3) in an opening [mm] at points behind it.

    The slopes are summed less what all sources have in common, see :mod:`.rates`, which is added afterwards. What the
    slopes of the amplitude differ by between sources is left out: they are lambda/(2 pi r) of the phase's.
    """
    middle = centre_of_power(sources, rows[0])
    scales = np.maximum(np.abs(rows).max(axis=1), 1e-300)
    sums = _sums(path, sources - middle, rows / scales[:, None], target, middle, wavelength)
    values = sums[:-2] * scales[:, None]
    places = target.points()
    commons = [RatePath(path, wavelength, middle, None, axis).common(places) for axis in (target.u, target.v)]
    along = scales[0] * sums[-2:] + np.array(commons) * values[0]
    return Carried(values, along)


def _sums(path, sources, rows, target: PlanePoints, middle: np.ndarray, wavelength: float) -> np.ndarray:
    """(k + 2, m): the sums of all rows, and those of the first with the slopes, less the middle's, along u and v."""
    ad = arrays()
    blocks = -(-len(sources) // BLOCK)
    place = np.zeros((blocks * BLOCK, 4))
    place[: len(sources), :3], place[len(sources) :, :3] = sources / wavelength, sources[0] / wavelength
    packets = -(-2 * len(rows) // _PACKET)
    weights = np.zeros((blocks * BLOCK, packets * _PACKET // 2), dtype=np.complex64)
    weights[: len(sources), : len(rows)] = rows.T
    device_place, device_weights = ad.Float64(place.ravel()), ad.Float32(weights.view(np.float32).ravel())
    points = (target.points() - middle) / wavelength
    normal = [opaque(x) for x in path.normal]
    axes = [[opaque(x) for x in axis] for axis in (target.u, target.v)]
    outputs = 2 * (len(rows) + 2)
    found = np.empty((outputs, len(points)))

    def dot(vector, other):
        return dr.fma(vector[0], other[0], dr.fma(vector[1], other[1], vector[2] * other[2]))

    for start in range(0, len(points), LANES_AT_ONCE):
        some = points[start : start + LANES_AT_ONCE]
        x, y, z = (ad.Float64(np.ascontiguousarray(column)) for column in some.T)
        inverse_middle = dr.rsqrt(x * x + y * y + z * z)
        slopes_middle = [dot(axis, (x, y, z)) * inverse_middle for axis in axes]

        def add(partial, number):
            px, py, pz, _ = dr.gather(ad.Array4f64, device_place, number)
            d = x - px, y - py, z - pz
            squared = dot(d, d)
            inverse = inverse_root(squared, ad.Float32)
            near = ad.Float32(inverse) * (1 / (2 * np.pi))
            term = multiply(phasor(squared * inverse, ad.Float32), (1.0, near))
            amplitude = ad.Float32(dot(normal, d) * inverse * inverse)
            term = term[0] * amplitude, term[1] * amplitude
            fields = []
            for packet in range(packets):
                values = dr.gather(ad.Array4f, device_weights, number * packets + packet)
                fields += [multiply((values[2 * i], values[2 * i + 1]), term) for i in range(_PACKET // 2)]
            fields = fields[: len(rows)]
            for axis, common in zip(axes, slopes_middle, strict=True):
                slope = ad.Float32(dr.fma(dot(axis, d), inverse, -common)) * (2 * np.pi)
                fields.append((-fields[0][1] * slope, fields[0][0] * slope))
            return [one + part for one, part in zip(partial, (part for pair in fields for part in pair), strict=True)]

        begin = dr.zeros(ad.UInt32, len(some))
        totals = sum_in_blocks(ad, ad.Float32, begin, dr.opaque(ad.UInt32, blocks, len(some)), outputs, add)
        dr.eval(totals)
        found[:, start : start + len(some)] = [one.numpy() for one in totals]
    # 1/(i lambda) and a path in wavelengths, whose inverse square is the amplitude's.
    factor = np.full((len(rows) + 2, 1), 1 / (1j * wavelength**2))
    factor[-2:] /= wavelength
    return factor * (found[0::2] + 1j * found[1::2])
