"""Light around a place of the target, beside what a Gaussian beam tells: a smooth complex amplitude in a box."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..propagation.chebyshev import interpolation_matrix
from ..scattering.beam import Beam
from ..scattering.rough_surface import Scatterers

_AT_ONCE = 1 << 21
"""Values that are interpolated together."""


@dataclass(frozen=True, eq=False)
class LightFactor:
    """Amplitude of light in units of a beam's own, beside the phase of the beam, interpolated in a box.

    low, high: (3,) corners of the box in the beam's coordinates x, y and along its axis, from its reference [mm];
    values: (a, b, c) complex128 at the tensor of Chebyshev nodes; nodes: of the plane that they were summed from;
    error: relative L2.
    """

    beam: Beam
    low: np.ndarray
    high: np.ndarray
    values: np.ndarray
    nodes: int
    error: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(n,) complex128 at places (n, 3) in the box, world [mm]."""
        local = (points - self.beam.reference) @ self.beam.axes
        unit = (2 * local - self.low - self.high) / (self.high - self.low)
        found = np.empty(len(points), dtype=np.complex128)
        a, b, c = self.values.shape
        step = max(1, _AT_ONCE // (b * c))
        for first in range(0, len(points), step):
            some = unit[first : first + step]
            x, y, z = (interpolation_matrix(count, some[:, axis]) for axis, count in enumerate((a, b, c)))
            rows = (x @ self.values.reshape(a, b * c)).reshape(len(some), b, c)
            found[first : first + step] = np.sum((rows @ z[:, :, None])[:, :, 0] * y, axis=1)
        return found

    def on(self, lit: Scatterers) -> Scatterers:
        """Scatterers under the beam alone, under this light."""
        return replace(lit, amplitude=lit.amplitude / np.abs(self.beam.field(lit.position)) * self(lit.position))

    def log_ratio(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Logarithm (n,) of the field at points (n, 3) over that at others beside them."""
        phase = self.beam.log_field(points).imag - self.beam.log_field(others).imag
        here, there = self(points), self(others)
        dark = (here == 0) | (there == 0)
        return 1j * phase + np.log(np.where(dark, 1.0, here) / np.where(dark, 1.0, there))

    @property
    def beside(self) -> float:
        """Amplitude of the light beyond the box, relative to that in it.

        From the light in the outermost part of the box across: what an edge has thrown there falls off in amplitude as
        r^(-3/2) at most.
        """
        a, b, c = self.values.shape
        power = np.abs(self.values[:, :, c // 2]) ** 2
        x, y = (np.sin((np.arange(n) + 0.5) * np.pi / n) for n in (a, b))  # Chebyshev nodes are dense at the ends
        areas = np.outer(x, y)
        u, v = (np.cos((np.arange(n) + 0.5) * np.pi / n) for n in (a, b))
        ring = np.hypot(*np.meshgrid(u, v, indexing="ij"))
        edge = (ring > 0.9) & (ring < 1.0)
        at_edge = np.average(power[edge], weights=areas[edge])
        return float(np.sqrt(2 * np.pi * at_edge / (4 * np.average(power, weights=areas))))
