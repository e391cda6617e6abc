"""Paths through optics between two sets of points, as the coherent sum asks for them."""

from __future__ import annotations

import numpy as np

from .optics.path import TracedPath
from .optics.surfaces import Sequence


class TracedLeg:
    """Optical path length and amplitude through a sequence of surfaces that ends in the targets' plane.

    sequence: the surfaces, the last a plane that the targets lie on; wavelength [mm]. opening: None, or
    (normal (3,), index) of the opening that the sources lie in: the amplitude is then that of the Rayleigh-Sommerfeld
    integral far from the opening, cos(chi) n / (i lambda) times the geometric one.
    Every pair is traced: the coherent sum asks for few and interpolates.
    """

    def __init__(self, sequence: Sequence, wavelength: float, opening: tuple[np.ndarray, float] | None = None) -> None:
        self.traced = TracedPath(sequence)
        self.wavelength, self.opening = wavelength, opening

    def __call__(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Length (n, m) [mm] and complex amplitude (n, m) from sources (n, 3) to targets (m, 3).

        Raises ValueError where no ray connects a pair.
        """
        aimed = self.traced.paired(np.repeat(sources, len(targets), axis=0), np.tile(targets, (len(sources), 1)))
        amplitude = aimed.complex_amplitude
        if self.opening is not None:
            normal, index = self.opening
            amplitude = amplitude * (aimed.launch @ normal) * index / (1j * self.wavelength)
        shape = (len(sources), len(targets))
        return aimed.optical_path_length.reshape(shape), amplitude.reshape(shape)
