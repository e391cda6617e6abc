"""The field of point sources in free space with all its first derivatives, in one pass over the pairs.

With T_j = c_j e^{ikr}/r, d = P_j - D, r = |d| and the gradient G_j = grad ln c + (ik - 1/r) d/r of ln T_j by the
source's place, a motion shift + turn x (P - P0) changes the field by

    dE = shift . sum_j T_j G_j + turn . sum_j T_j (P_j - P0) x G_j,

and a step of the point along u by -u . sum_j T_j (ik - 1/r) d/r. All terms have the same T_j: what its rounding does to
the phase that sources have in common is the same in E, and moves no pattern.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import numpy as np

from ..geometry.plane import PlanePoints
from ..machine.backend import arrays, opaque
from .phasors import multiply, phasor

_SUMS = 18
"""Real sums: E, three of T G, three of T (P - P0) x G and two along the target's axes, complex each."""


@dataclass(frozen=True)
class FreeSpaceRates:
    """field: (m,); by_shift: (3, m) [1/mm] and by_turn: (3, m) [1/rad] about ``middle`` (3,), along the world's axes;
    along: (2, m) [1/mm] for steps of the points along u and v."""

    field: np.ndarray
    by_shift: np.ndarray
    by_turn: np.ndarray
    along: np.ndarray
    middle: np.ndarray

    def by_motion(self, shift: np.ndarray, turn: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """(m,) the field's derivative by the motion shift + turn x (P - origin)."""
        return (shift + np.cross(turn, self.middle - origin)) @ self.by_shift + turn @ self.by_turn


def free_space_rates(
    sources: np.ndarray, weights: np.ndarray, gradients: np.ndarray, target: PlanePoints, wavelength: float
) -> FreeSpaceRates:
    """Field and first derivatives at points of a plane.

    sources: (n, 3) [mm]; weights c: (n,) complex; gradients: (n, 3) complex, of ln c by the source's place [1/mm];
    wavelength [mm]. float32 phasors: 1e-6 relative L2. Sources must not lie on the points.
    """
    ad = arrays()
    middle = sources.mean(axis=0)
    scale = float(np.abs(weights).max(initial=0.0)) or 1.0
    held = [sources - middle, (weights / scale).view(np.float64).reshape(-1, 2), gradients.real, gradients.imag]
    columns = [ad.Float64(np.ascontiguousarray(column)) for part in held for column in part.T]
    point = ad.Array3f64(*(ad.Float64(np.ascontiguousarray(x)) for x in (target.points() - middle).T))
    axes = [ad.Array3f64(*(opaque(x) for x in axis)) for axis in (target.u, target.v)]
    wavenumber, inverse_wavelength = opaque(2 * np.pi / wavelength), opaque(1 / wavelength)
    count = dr.opaque(ad.UInt32, len(sources))

    def add(number, *sums):
        x, y, z, re, im, *slopes = (dr.gather(ad.Float64, column, number) for column in columns)
        place = ad.Array3f64(x, y, z)
        away = place - point
        inverse = dr.rsqrt(dr.squared_norm(away))
        r = dr.squared_norm(away) * inverse
        cosine, sine = phasor(r * inverse_wavelength, ad.Float32)
        turn = ad.Float64(cosine) * inverse, ad.Float64(sine) * inverse
        term = multiply((re, im), turn)
        unit = away * inverse
        # (ik - 1/r) T, and T grad ln c
        steep = multiply(term, (-inverse, wavenumber))
        real, imaginary = ad.Array3f64(*slopes[:3]), ad.Array3f64(*slopes[3:])
        gradient_re = unit * steep[0] + real * term[0] - imaginary * term[1]
        gradient_im = unit * steep[1] + real * term[1] + imaginary * term[0]
        torque_re, torque_im = dr.cross(place, gradient_re), dr.cross(place, gradient_im)
        along = [-dr.dot(unit, axis) * part for axis in axes for part in steep]
        terms = [*term, *gradient_re, *gradient_im, *torque_re, *torque_im, *along]
        return number + 1, *(one + other for one, other in zip(sums, terms, strict=True))

    zeros = [dr.zeros(ad.Float64, target.size) for _ in range(_SUMS)]
    _, *sums = dr.while_loop(
        (ad.UInt32(0), *zeros), lambda number, *_: number < count, add, label="free space with derivatives"
    )
    dr.eval(sums)
    values = scale * np.array([one.numpy() for one in sums])
    return FreeSpaceRates(
        field=values[0] + 1j * values[1],
        by_shift=values[2:5] + 1j * values[5:8],
        by_turn=values[8:11] + 1j * values[11:14],
        along=values[14::2] + 1j * values[15::2],
        middle=middle,
    )
