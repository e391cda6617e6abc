"""How a coherent sum changes as its sources or its points move: again a coherent sum, over a path of another amplitude.

Of E(D) = sum_j c_j A(P_j, D) e^{ikV(P_j, D)} with sources that move by a(P_j) dq and change as d ln c_j = g(P_j) dq,

    dE/dq = sum_j c_j A R e^{ikV},    R(P, D) = g(P) + a.grad_P (ik V + ln A),

and with points that move along u the same with R = u.grad_D (ik V + ln A). What all sources have in common moves no
pattern, but is a thousand times larger than what does: R = R(P0, D) + [R(P, D) - R(P0, D)], P0 the middle source. The
first is a factor on E, the second is summed, so that an error of the sum is relative to what counts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.plane import PlanePoints
from .interpolated import interpolated
from .paths import Path
from .source_box import SourceBox

STEP = 1e-3
"""Largest step [mm] of the difference quotients along a path: with third derivatives of 1/mm^2 it costs 1e-7 of them,
and the rounding of a path of 1 m (1e-13 mm) 1e-10."""

SERIES_TOLERANCE = 1e-7
"""Phase [rad] to which a series stands for a slow path: its slope over a spot of 0.1 mm is then known to 1e-5 rad/mm of
some 40."""

ROOM = 0.02
"""By how much of its size the box of a series is larger than what the sources take up."""


@dataclass(frozen=True)
class RatePath:
    """The path whose sum is that of R(P, D) - R(P0, D), as the module's docstring has it.

    path: V and A; wavelength [mm]; middle: P0, (3,) [mm]; source_velocity: points (n, 3) -> a (n, 3) [mm per unit], or
    None; target_velocity: u (3,) [mm per unit], or None; source_rate: points (n, 3) -> g (n,) [1 per unit], or None;
    reach: largest |a| on the sources [mm per unit].
    """

    path: Path
    wavelength: float
    middle: np.ndarray
    source_velocity: Callable[[np.ndarray], np.ndarray] | None = None
    target_velocity: np.ndarray | None = None
    source_rate: Callable[[np.ndarray], np.ndarray] | None = None
    reach: float = 1.0

    def __call__(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """V and A [R - R(P0)] (n, m) from sources (n, 3) to targets (m, 3)."""
        length, amplitude, rate = self._rates(np.concatenate([sources, self.middle[None]]), targets)
        return length[:-1], amplitude[:-1] * (rate[:-1] - rate[-1])

    def common(self, targets: np.ndarray) -> np.ndarray:
        """R(P0, D), (m,), at targets (m, 3)."""
        return self._rates(self.middle[None], targets)[2][0]

    def _rates(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """V, A and R (n, m). All places are given to the path at once, which knows what they share."""
        step = STEP / max(self.reach, 1e-300)
        if self.target_velocity is None:
            move = step * self.source_velocity(sources)
            places = np.concatenate([sources, sources + move, sources - move])
            lengths, amplitudes = (np.split(part, 3) for part in self.path(places, targets))
        else:
            aside = step * self.target_velocity
            places = np.concatenate([targets, targets + aside, targets - aside])
            lengths, amplitudes = (np.split(part, 3, axis=1) for part in self.path(sources, places))
        rate = 1j * (2 * np.pi / self.wavelength) * (lengths[1] - lengths[2])
        rate = (rate + (amplitudes[1] - amplitudes[2]) / amplitudes[0]) / (2 * step)
        if self.source_rate is not None:
            rate += self.source_rate(sources)[:, None]
        return lengths[0], amplitudes[0], rate


def centre_of_power(sources: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """P0: (3,) where the power |c|^2 of sources (n, 3) with weights (n,) has its centre."""
    power = np.abs(weights) ** 2
    return power @ sources / power.sum() if power.sum() > 0 else sources.mean(axis=0)


def gradient_at(path: Path, wavelength: float, middle: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """grad_P (ik V + ln A) at the source ``middle`` (3,) towards targets (m, 3), (3, m) complex [1/mm]."""
    places = middle + STEP * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    length, amplitude = path(places, targets)
    rate = 1j * (2 * np.pi / wavelength) * (length[1:4] - length[4:])
    return (rate + (amplitude[1:4] - amplitude[4:]) / amplitude[0]) / (2 * STEP)


def differentiable(path: Path, sources: np.ndarray, target: PlanePoints, wavelength: float) -> Path:
    """A path that is evaluated cheaply around all sources (n, 3), off the plane that they lie in as well.

    It is the path itself where it has no series of ``SERIES_TOLERANCE``, or no ray from a little beside the sources.
    """
    low, high = sources.min(axis=0), sources.max(axis=0)
    room = max(ROOM * float(np.linalg.norm(high - low)), 4 * STEP)
    around = np.concatenate([sources + sign * room * axis for axis in np.eye(3) for sign in (-1, 1)])
    box = SourceBox.around(around, target.u)
    try:
        return interpolated(path, box, target, wavelength, SERIES_TOLERANCE) or path
    except InputError:
        return path
