"""The pieces that sums share: phasors of reduced phase, in Dr.Jit and NumPy, a cheap float64 root, complex products."""

from __future__ import annotations

import drjit as dr
import numpy as np

WRITE = dr.ReduceMode.NoConflicts
"""Every pixel is written once. Saying so lets Dr.Jit fuse the writes of a run into one kernel instead of one each."""


# Chebyshev fits on |y| <= 1/4, in powers of y^2, of sin(2 pi y)/y and cos(2 pi y): to 7e-9 and 2e-10 for float32,
# to 3e-16 for float64.
SINE = (6.283185280261414, -41.34168066806317, 81.60248074286561, -76.58128455932848, 39.76072207550286)
COSINE = (0.9999999997799042, -19.739208548315304, 64.93934655290143, -85.45356819524321, 60.14395233716958,
          -24.981836135847793)  # fmt: skip
SINE_64 = (6.283185307179586, -41.341702240399755, 81.60524927607362, -76.70585975282509, 42.05869392543926,
           -15.094641676478926, 3.8199281010531383, -0.7177338593450135, 0.10089722381061697)  # fmt: skip
COSINE_64 = (1.0, -19.739208802178705, 64.93939402266396, -85.45681720598118, 60.24464131319568,
             -26.426254067893844, 7.90346251484126, -1.7132186347396439, 0.27194674558121545)  # fmt: skip


def active_variant() -> str:
    """Name of the active Mitsuba variant, empty before one is set."""
    import mitsuba

    return mitsuba.variant() or ""


def sine_cosine(y, sine_powers: tuple, cosine_powers: tuple):
    """sin and cos of 2 pi y for |y| <= 1/4."""
    z = y * y
    sine, cosine = type(y)(sine_powers[-1]), type(y)(cosine_powers[-1])
    for power in sine_powers[-2::-1]:
        sine = dr.fma(sine, z, power)
    for power in cosine_powers[-2::-1]:
        cosine = dr.fma(cosine, z, power)
    return sine * y, cosine


def phasor(turns, real):
    """cos and sin of 2 pi ``turns`` (float64 of any size), in ``real``, a Dr.Jit float type."""
    x = real(turns - dr.round(turns))
    # |x| <= 1/2: cos(2 pi x) = sin(2 pi y), sin(2 pi x) = sign(x) cos(2 pi y), y = 1/4 - |x|.
    powers = (SINE_64, COSINE_64) if dr.type_v(real) == dr.VarType.Float64 else (SINE, COSINE)
    sine, cosine = sine_cosine(0.25 - dr.abs(x), *powers)
    return sine, dr.copysign(cosine, x)


def inverse_root(x, float32):
    """1/sqrt(x) in float64 from a float32 start: half the time of a float64 root and division.

    One step of third order: an error of 1e-6 becomes 1e-18. x [wavelengths^2] stays within float32's range.
    """
    start = type(x)(dr.rsqrt(float32(x)))
    miss = dr.fma(-x * start, start, 1.0)
    return dr.fma(start * miss, dr.fma(miss, 0.375, 0.5), start)


def multiply(a, b):
    """Complex product of (re, im) pairs."""
    return dr.fma(a[0], b[0], -(a[1] * b[1])), dr.fma(a[0], b[1], a[1] * b[0])


def unit_phasor(turns: np.ndarray) -> np.ndarray:
    """e^{2 pi i turns}, complex128, of ``turns`` (float64 of any size), in NumPy."""
    angle = 2 * np.pi * (turns - np.round(turns))
    return np.cos(angle) + 1j * np.sin(angle)
