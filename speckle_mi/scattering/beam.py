"""The laser's field on the target: Gaussian or uniform amplitude, plane or spherical wavefront."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import numpy as np

from ..machine.backend import arrays, opaque, opaque_vector

TRUNCATION = 3.0
"""Scatterers are summed out to this many beam radii: beyond lies 1.5e-8 of the power."""


@dataclass(frozen=True)
class Beam:
    """The laser beam as it arrives at the target.

    origin: (3,) place of the laser [mm]; axis: (3,) unit direction of propagation; radius: 1/e^2 intensity radius
    perpendicular to the axis [mm], inf = uniform; wavefront_radius: signed radius of curvature at ``reference``
    [mm], positive for a diverging wave, inf = collimated; wavelength [mm]; reference: (3,) point of the axis at
    the target at rest [mm].
    """

    origin: np.ndarray
    axis: np.ndarray
    radius: float
    wavefront_radius: float
    wavelength: float
    reference: np.ndarray

    @property
    def wavenumber(self) -> float:
        """k = 2 pi / wavelength [1/mm]."""
        return 2 * np.pi / self.wavelength

    @property
    def cutoff(self) -> float:
        """Distance from the axis up to which the beam is taken into account [mm]."""
        return TRUNCATION * self.radius

    def aimed_at(self, reference: np.ndarray) -> Beam:
        """The same beam with its wavefront radius given at another point of its axis."""
        return replace(self, reference=np.asarray(reference, dtype=np.float64))

    @property
    def reference_path(self) -> float:
        """Optical path from the laser, which is the phase reference, to ``reference`` [mm]."""
        return float((self.reference - self.origin) @ self.axis)

    def directions_to_source(self, points: np.ndarray) -> np.ndarray:
        """Unit vectors (n, 3) from points (n, 3) against the light's direction of propagation there."""
        if np.isinf(self.wavefront_radius):
            return np.broadcast_to(-self.axis, points.shape)
        from_centre = points - self.reference + self.wavefront_radius * self.axis
        return -np.sign(self.wavefront_radius) * from_centre / np.linalg.norm(from_centre, axis=1, keepdims=True)

    def field(self, points: np.ndarray) -> np.ndarray:
        """Complex amplitude exp(-r^2/w^2) exp(+i k L) at points (n, 3) [mm], (n,) complex128."""
        lanes = arrays()
        x, y, z = (lanes.Float64(np.ascontiguousarray(column)) for column in np.asarray(points, dtype=np.float64).T)
        _, real, imaginary = BeamKernel(self).evaluate(lanes.Array3f64(x, y, z))
        return real.numpy() + 1j * imaginary.numpy()


class BeamKernel:
    """A beam as Dr.Jit expressions; its parameters do not enter the compiled code."""

    def __init__(self, beam: Beam) -> None:
        self.uniform = np.isinf(beam.radius)
        self.collimated = np.isinf(beam.wavefront_radius)
        self.axis = opaque_vector(beam.axis)
        self.reference = opaque_vector(beam.reference)
        self.wavefront_radius = opaque(0.0 if self.collimated else beam.wavefront_radius)
        self.inverse_radius = opaque(0.0 if self.uniform else 1 / beam.radius)
        self.cutoff = opaque(beam.cutoff)
        self.inverse_wavelength = opaque(1 / beam.wavelength)
        self.common_waves = opaque(beam.reference_path / beam.wavelength % 1.0)

    def across_squared(self, points):
        """Squared distance of points from the axis [mm^2]."""
        p = points - self.reference
        across = p - dr.dot(p, self.axis) * self.axis
        return dr.squared_norm(across)

    def evaluate(self, points):
        """(to_source, real, imaginary): unit vectors towards the light and the complex amplitude at points.

        The path from the laser, less that to the reference point, is sign(R) (|P - S| - |R|) for a wavefront of
        radius R centred at S, formed without cancellation as sign(R) (2 R p.b + p^2) / (|P - S| + |R|) with
        p = P - reference and b the axis; p.b for a plane wave.
        """
        p = points - self.reference
        along = dr.dot(p, self.axis)
        if self.collimated:
            to_source, path = -self.axis, along
        else:
            radius = self.wavefront_radius
            sign = dr.sign(radius)
            from_centre = p + radius * self.axis
            distance = dr.norm(from_centre)
            to_source = from_centre * (-sign / dr.maximum(distance, 1e-300))
            path = sign * (2 * radius * along + dr.squared_norm(p)) / (distance + dr.abs(radius))
        waves = path * self.inverse_wavelength + self.common_waves
        sine, cosine = dr.sincos(2 * np.pi * (waves - dr.round(waves)))
        if self.uniform:
            return to_source, cosine, sine
        amplitude = dr.exp(-self.across_squared(points) * self.inverse_radius * self.inverse_radius)
        return to_source, amplitude * cosine, amplitude * sine
