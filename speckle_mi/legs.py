"""Paths through optics between two sets of points, as the coherent sum asks for them."""

from __future__ import annotations

import numpy as np

from .optics import chebyshev
from .optics.path import TracedPath
from .optics.surfaces import Sequence

EXACT_PAIRS = 16_384
"""Pairs up to which every one is traced; beyond, the path is interpolated."""

LENGTH_TOLERANCE = 1e-7
"""Error allowed to an interpolated path length, in wavelengths."""

AMPLITUDE_TOLERANCE = 1e-7
"""Error allowed to an interpolated amplitude, relative to the largest."""

_BOX_MARGIN = 0.02


class TracedLeg:
    """Optical path length and amplitude through a sequence of surfaces that ends in the targets' plane.

    sequence: the surfaces, the last a plane that the targets lie on; wavelength [mm]; axes: (3, 3) columns, the
    directions in which the sources extend. opening: None, or (normal (3,), index) of the opening that the sources
    lie in: the amplitude is then that of the Rayleigh-Sommerfeld integral, cos(chi) n / (i lambda) times the
    geometric one.
    """

    def __init__(
        self, sequence: Sequence, wavelength: float, axes: np.ndarray, opening: tuple[np.ndarray, float] | None = None
    ) -> None:
        self.traced = TracedPath(sequence)
        self.wavelength, self.axes, self.opening = wavelength, axes, opening
        self._plane = sequence.last.surface.frame
        self._interpolant: chebyshev.Interpolant | None = None

    def __call__(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Length (n, m) [mm] and complex amplitude (n, m). Raises ValueError where no ray connects a pair."""
        if len(sources) * len(targets) <= EXACT_PAIRS:
            return self._exact(sources, targets)
        place, spot = self._source_coordinates(sources), self._target_coordinates(targets)
        values = self._over(place, spot)
        basis_p = _tensor_basis(values, range(3), place)
        basis_d = _tensor_basis(values, range(3, 5), spot)
        table = values.coefficients.reshape(basis_p.shape[1], basis_d.shape[1], 3)
        length, real, imaginary = (basis_p @ table[..., k] @ basis_d.T for k in range(3))
        return length, real + 1j * imaginary

    def _exact(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        length, amplitude = self._traced(np.repeat(sources, len(targets), axis=0), np.tile(targets, (len(sources), 1)))
        shape = (len(sources), len(targets))
        return length.reshape(shape), amplitude.reshape(shape)

    def _traced(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Length (n,) and amplitude (n,) of the rays from sources (n, 3) to targets (n, 3), one each."""
        aimed = self.traced.paired(sources, targets)
        amplitude = aimed.complex_amplitude
        if self.opening is not None:
            normal, index = self.opening
            amplitude = amplitude * (aimed.launch @ normal) * index / (1j * self.wavelength)
        return aimed.optical_path_length, amplitude

    def _source_coordinates(self, points: np.ndarray) -> np.ndarray:
        return points @ self.axes

    def _target_coordinates(self, points: np.ndarray) -> np.ndarray:
        return self._plane.to_local(points)[:, :2]

    def _over(self, place: np.ndarray, spot: np.ndarray) -> chebyshev.Interpolant:
        """An interpolant whose box holds the given coordinates; it is kept, and grows when points fall outside."""
        lower = np.concatenate([place.min(axis=0), spot.min(axis=0)])
        upper = np.concatenate([place.max(axis=0), spot.max(axis=0)])
        held = self._interpolant
        if held is not None:
            if np.all(lower >= held.lower - 1e-12) and np.all(upper <= held.upper + 1e-12):
                return held
            lower, upper = np.minimum(lower, held.lower), np.maximum(upper, held.upper)
        margin = _BOX_MARGIN * (upper - lower)
        lower, upper = lower - margin, upper + margin
        scale = np.abs(self._values((0.5 * (lower + upper))[None])[0, 1:]).max()
        tolerance = np.array([LENGTH_TOLERANCE * self.wavelength, *2 * (AMPLITUDE_TOLERANCE * scale,)])
        self._interpolant, _ = chebyshev.adapt(self._values, lower, upper, tolerance)
        return self._interpolant

    def _values(self, coordinates: np.ndarray) -> np.ndarray:
        """Length, real and imaginary amplitude (n, 3) at coordinates (n, 5) of source and target."""
        sources = coordinates[:, :3] @ self.axes.T
        targets = self._plane.to_world(np.pad(coordinates[:, 3:], ((0, 0), (0, 1))))
        length, amplitude = self._traced(sources, targets)
        return np.stack([length, amplitude.real, amplitude.imag], axis=1)


def _tensor_basis(interpolant: chebyshev.Interpolant, axes: range, points: np.ndarray) -> np.ndarray:
    """Products of the Chebyshev polynomials along ``axes`` at points (n, len(axes)), (n, product of orders)."""
    basis = np.ones((len(points), 1))
    for column, axis in enumerate(axes):
        along = interpolant.basis(axis, points[:, column])
        basis = (basis[:, :, None] * along[:, None, :]).reshape(len(points), -1)
    return basis
