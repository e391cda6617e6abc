"""Peers of the benchmark: what an engineer would write, or take from a library, to sum the same scatterers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...geometry.plane import PlaneGrid

FRESNEL_EPS = 1e-6
"""What FINUFFT is asked for: its own error then hides behind the approximation's."""


def numpy_sum(position: np.ndarray, amplitude: np.ndarray, points: np.ndarray, wavelength: float) -> np.ndarray:
    """sum_j c_j e^{ikr}/r at points (m, 3) in float64, vectorised over thousands of pairs at a time."""
    wavenumber = 2 * np.pi / wavelength
    field = np.zeros(len(points), dtype=np.complex128)
    step = max(1, (1 << 20) // min(len(position), 4096))
    for first in range(0, len(points), step):
        some = points[first : first + step]
        for start in range(0, len(position), 4096):
            chunk = slice(start, start + 4096)
            r = np.sqrt(sum(np.subtract.outer(position[chunk, axis], some[:, axis]) ** 2 for axis in range(3)))
            field[first : first + step] += amplitude[chunk] @ (np.exp(1j * wavenumber * r) / r)
    return field


def numba_sum() -> Callable[..., np.ndarray] | None:
    """The same double loop compiled by numba, pixels on all cores, fastmath off; None without numba."""
    try:
        import numba
    except ImportError:
        return None

    @numba.njit(parallel=True, fastmath=False)
    def summed(position, amplitude, points, wavelength):
        wavenumber = 2 * np.pi / wavelength
        field = np.empty(len(points), dtype=np.complex128)
        for m in numba.prange(len(points)):
            x, y, z = points[m]
            real = imaginary = 0.0
            for j in range(len(position)):
                dx, dy, dz = x - position[j, 0], y - position[j, 1], z - position[j, 2]
                r = np.sqrt(dx * dx + dy * dy + dz * dz)
                cosine, sine = np.cos(wavenumber * r) / r, np.sin(wavenumber * r) / r
                a, b = amplitude[j].real, amplitude[j].imag
                real += a * cosine - b * sine
                imaginary += a * sine + b * cosine
            field[m] = complex(real, imaginary)
        return field

    return summed


def fresnel_sum(position: np.ndarray, amplitude: np.ndarray, grid: PlaneGrid, wavelength: float) -> np.ndarray:
    """The Fresnel approximation by one type-1 NUFFT onto the pixel grid, (rows, columns).

    r = L - z + (X^2 + Y^2)/(2L) - (X x + Y y)/L + (x^2 + y^2)/(2L), with x, y, z the scatterer's place along u, v and
    towards the detector, X, Y the pixel's, L the distance; the amplitude 1/L. Good far away and near the axis.
    """
    from ...machine.nufft import finufft

    k = 2 * np.pi / wavelength
    rows, columns = grid.shape
    foot = grid.centre - position.mean(axis=0)
    distance = abs(float(foot @ grid.normal))
    towards = grid.normal * np.sign(foot @ grid.normal)
    origin = grid.centre - distance * towards
    x, y, z = ((position - origin) @ axis for axis in (grid.u, grid.v, towards))
    # finufft's mode numbers run from -n/2 (rounded down): the pixel they stand on, not the middle, is the origin.
    middle_x, middle_y = (0.5 * grid.pitch if n % 2 == 0 else 0.0 for n in (columns, rows))
    weights = amplitude * np.exp(
        1j * k * ((x * x + y * y) / (2 * distance) - z - (middle_x * x + middle_y * y) / distance)
    )
    rate = k * grid.pitch / distance
    wrapped = [np.mod(rate * value + np.pi, 2 * np.pi) - np.pi for value in (y, x)]
    sums = finufft.nufft2d1(*wrapped, weights, (rows, columns), isign=-1, eps=FRESNEL_EPS)
    across = (grid.columns - grid.columns[-1] / 2) ** 2 + ((grid.rows - grid.rows[-1] / 2) ** 2)[:, None]
    return sums * np.exp(1j * k * (distance + across / (2 * distance))) / distance
