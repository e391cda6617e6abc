"""Path oracles: optical path length and amplitude from source points to target points.

A path is any object that, called with source points ``P`` (n, 3) and target points ``D`` (m, 3), both [mm],
returns ``(length, amplitude)``: the optical path length (n, m) float64 [mm] and the amplitude (n, m), float64 or
complex128. The coherent sum adds ``c A exp(+i k V)``: a longer path is a larger phase. Paths must be smooth
functions of both points; nothing else is asked of them, so that a path traced through lenses fits as well as
the two closed forms below.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Path(Protocol):
    """What the coherent sum asks of a path; see the module's docstring."""

    def __call__(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Length (n, m) [mm] and amplitude (n, m) from sources (n, 3) to targets (m, 3) [mm]."""
        ...


def distances(sources: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """|D - P| (n, m) [mm] from sources (n, 3) to targets (m, 3)."""
    # Coordinate by coordinate and in place: new arrays of megabytes take longer than what is computed in them.
    squared = np.zeros((len(sources), len(targets)))
    along = np.empty_like(squared)
    for axis in range(3):
        np.subtract.outer(sources[:, axis], targets[:, axis], out=along)
        along *= along
        squared += along
    return np.sqrt(squared, out=squared)


@dataclass(frozen=True)
class FreeSpace:
    """A point source in a homogeneous medium: V = |D - P|, A = 1/|D - P| [1/mm]."""

    def __call__(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r = distances(sources, targets)
        return r, 1.0 / r


@dataclass(frozen=True)
class RayleighSommerfeld:
    """A point of a plane opening, after the first Rayleigh-Sommerfeld integral (phasor e^{+ikr}).

    A = 1/(i lambda) (1/r) (1 + i/(kr)) cos(chi) [1/mm^2], cos(chi) = normal . (D - P)/r; a quadrature weight [mm^2]
    belongs to the source. Source: Goodman, Introduction to Fourier Optics, 3rd ed., Eq. (3-41) and (3-43).

    normal: (3,) unit vector of the opening, pointing to where the light goes; wavelength [mm].
    """

    normal: np.ndarray
    wavelength: float

    def __post_init__(self) -> None:
        normal = np.asarray(self.normal, dtype=np.float64)
        if normal.shape != (3,) or not abs(np.linalg.norm(normal) - 1.0) < 1e-9:
            raise ValueError(f"normal = {self.normal}: must be a unit vector of shape (3,)")
        if not (np.isfinite(self.wavelength) and self.wavelength > 0):
            raise ValueError(f"wavelength = {self.wavelength}: must be a positive number of mm")
        object.__setattr__(self, "normal", normal)

    def __call__(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r = distances(sources, targets)
        cos_chi = np.subtract.outer(-(sources @ self.normal), -(targets @ self.normal)) / r
        wavenumber = 2 * np.pi / self.wavelength
        return r, cos_chi / (1j * self.wavelength * r) * (1 + 1j / (wavenumber * r))
