"""Traced path lengths and amplitudes between sets of points: the exact oracle that interpolation is built from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.pairs import all_pairs
from .aim import AimedPaths, aim
from .sequence import Sequence
from .trace import RayStatus


@dataclass(frozen=True, eq=False)
class TracedPath:
    """Path length and amplitude through ``sequence`` from every source to every target on its last plane.

    Every pair costs an aimed ray, so call it on nodes, not on pixels.
    """

    sequence: Sequence

    def __call__(self, P: np.ndarray, D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Length (n, m) [mm] and complex amplitude (n, m) [1/mm] from sources P (n, 3) to targets D (m, 3), world [mm].

        The field at D of a unit source at P is amplitude * exp(i k length). The amplitude holds the factor exp(-i pi/2)
        of every focal line on the way (phasor e^{+ikL}: Gouy's phase). Vignetting is not in it, see ``margins``.
        Raises InputError when a pair has no ray; reasons are counted in the message.
        """
        aimed = self.aimed(P, D)
        shape = (len(P), len(D))
        return aimed.optical_path_length.reshape(shape), aimed.complex_amplitude.reshape(shape)

    def margins(self, P: np.ndarray, D: np.ndarray) -> np.ndarray:
        """Smooth clearance (r, n, m) of the rims in ``sequence.rims``; the ray from P to D is free where all are > 0.

        Raises InputError when a pair has no ray.
        """
        return self.aimed(P, D).margins.reshape(-1, len(P), len(D))

    def aimed(self, P: np.ndarray, D: np.ndarray) -> AimedPaths:
        """The rays of all pairs, n * m, row-major (source, target). Raises InputError when a pair has no ray."""
        aimed = aim(self.sequence, *all_pairs(P, D))
        if not aimed.converged.all():
            lost = aimed.status[~aimed.converged]
            reasons = ", ".join(
                f"{(lost == code).sum()} {RayStatus(code).name.lower().replace('_', ' ')}" for code in np.unique(lost)
            )
            raise InputError(
                f"{lost.size} of {aimed.status.size} pairs of source and target have no ray through the optics: "
                f"{reasons}"
            )
        return aimed


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

        Raises InputError where no ray connects a pair.
        """
        aimed = self.traced.aimed(sources, targets)
        amplitude = aimed.complex_amplitude
        if self.opening is not None:
            normal, index = self.opening
            amplitude = amplitude * (aimed.launch @ normal) * index / (1j * self.wavelength)
        shape = (len(sources), len(targets))
        return aimed.optical_path_length.reshape(shape), amplitude.reshape(shape)
