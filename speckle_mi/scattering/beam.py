"""The laser's field on the target: a Gaussian beam through its waist, or uniform light of plane or spherical waves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import numpy as np

from ..machine.backend import arrays, opaque, opaque_vector

TRUNCATION = 3.0
"""Scatterers are summed out to this many beam radii: beyond lies 1.5e-8 of the power."""

_FOCUS = 1e-200
"""Least square of the beam's radius over that at the reference point: uniform light is finite in its point focus."""


@dataclass(frozen=True)
class Beam:
    """The laser beam as it arrives at the target.

    origin: (3,) place of the laser [mm]; axis: (3,) unit direction of propagation; radius: 1/e^2 intensity radius
    perpendicular to the axis at ``reference`` [mm], inf = uniform; wavefront_radius: signed radius of curvature at
    ``reference`` [mm], positive for a diverging wave, inf = collimated; wavelength [mm]; reference: (3,) point of the
    axis at the target at rest [mm].

    It is the lowest Gaussian mode of complex parameter q = q_0 + s, s the distance along the axis from ``reference``
    and 1/q_0 = 1/R_0 + i lambda/(pi w_0^2) the given values there (phasor e^{+ikL}; A. E. Siegman, Lasers (1986),
    chapter 17):

        E = (q_0/q) exp(-r^2/w^2) exp(ik [s + sqrt(R^2 + r^2) - R]),   1/q = 1/R + i lambda/(pi w^2),

    so that radius w, wavefront radius R, amplitude and Gouy's phase (in q_0/q) are right before, in and behind the
    waist. Wavefronts are spheres of the local radius R, not the mode's paraboloids: where the waist is far it is the
    exact spherical wave. Uniform light has amplitude 1 everywhere, and its phase jumps by -pi in its point focus. The
    error of the Gaussian field is about the square of the beam's divergence lambda/(pi w_waist) [rad].
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
    def inverse_parameter(self) -> complex:
        """1/q_0 = 1/R_0 + i lambda/(pi w_0^2) at the reference point [1/mm]."""
        spread = 0.0 if np.isinf(self.radius) else self.wavelength / (np.pi * self.radius**2)
        return complex(1 / self.wavefront_radius, spread)

    @property
    def divergence(self) -> float:
        """Radius per distance far from the waist, lambda/(pi w_waist): half the angle [rad] of a beam's 1/e^2 cone."""
        return 0.0 if np.isinf(self.radius) else self.radius * abs(self.inverse_parameter)

    @property
    def cutoff(self) -> float:
        """Distance from the axis up to which the beam is taken into account at the reference point [mm]."""
        return TRUNCATION * self.radius

    def aimed_at(self, reference: np.ndarray) -> Beam:
        """The same beam with its radius and wavefront radius given at another point of its axis."""
        return replace(self, reference=np.asarray(reference, dtype=np.float64))

    @property
    def reference_path(self) -> float:
        """Optical path from the laser, which is the phase reference, to ``reference`` [mm]."""
        return float((self.reference - self.origin) @ self.axis)

    def radius_at(self, point: np.ndarray) -> float:
        """1/e^2 intensity radius w [mm] in the plane across the beam through a point (3,)."""
        along = float((point - self.reference) @ self.axis)
        return self.radius * abs(1 + along * self.inverse_parameter)

    def wavefront_radius_at(self, point: np.ndarray) -> float:
        """Signed radius of curvature [mm] of the wavefront through a point (3,), inf where it is plane."""
        along, across = self._parts(np.asarray(point, dtype=np.float64)[None])
        curvature = self._parameter(along)[1][0]
        if curvature == 0:
            return np.inf
        return float(np.copysign(np.hypot(1 / curvature, np.linalg.norm(across)), curvature))

    def directions_to_source(self, points: np.ndarray) -> np.ndarray:
        """Unit vectors (n, 3) from points (n, 3) against the light's direction of propagation there.

        That is the phase's gradient: on either side of a focus they point to where the light comes from.
        """
        along, across = self._parts(points)
        _, curvature, spread = self._parameter(along)
        squared = np.sum(across * across, axis=1)
        obliquity = np.sqrt(1 + curvature**2 * squared)
        forward = (
            obliquity * (1 - spread / self.wavenumber)
            + (spread**2 - curvature**2) * squared / (1 + obliquity)
        )
        heading = curvature[:, None] * across + forward[:, None] * self.axis
        return -heading / np.linalg.norm(heading, axis=1, keepdims=True)

    def field(self, points: np.ndarray) -> np.ndarray:
        """Complex amplitude at points (n, 3) [mm], (n,) complex128; 1 in modulus at ``reference``."""
        lanes = arrays()
        x, y, z = (lanes.Float64(np.ascontiguousarray(column)) for column in np.asarray(points, dtype=np.float64).T)
        _, real, imaginary = BeamKernel(self).evaluate(lanes.Array3f64(x, y, z))
        return real.numpy() + 1j * imaginary.numpy()

    def log_field(self, points: np.ndarray) -> np.ndarray:
        """A logarithm of the field at points (n, 3), (n,) complex128, continuous from place to place: for its slopes.

        Up to a constant; finite where the field itself is too weak for a number.
        """
        along, across = self._parts(points)
        modulus, curvature, _ = self._parameter(along)
        squared = np.sum(across * across, axis=1)
        path = along + curvature * squared / (1 + np.sqrt(1 + curvature**2 * squared))
        if np.isinf(self.radius):
            return 1j * self.wavenumber * path
        decay = squared / (self.radius**2 * modulus) + np.log(1 + along * self.inverse_parameter)
        return 1j * self.wavenumber * path - decay

    def _parts(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance along the axis from the reference (n,) and the vectors across it (n, 3) [mm]."""
        offset = points - self.reference
        along = offset @ self.axis
        return along, offset - along[:, None] * self.axis

    def _parameter(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """|q/q_0|^2, 1/R and lambda/(pi w^2) [1/mm] at distances (n,) along the axis."""
        start = self.inverse_parameter
        step = 1 + along * start
        modulus = np.maximum(step.real**2 + step.imag**2, _FOCUS)
        return modulus, (start.real * step.real + start.imag * step.imag) / modulus, start.imag / modulus


class BeamKernel:
    """A beam as Dr.Jit expressions; its parameters do not enter the compiled code."""

    def __init__(self, beam: Beam) -> None:
        self.uniform = np.isinf(beam.radius)
        self.axis = opaque_vector(beam.axis)
        self.reference = opaque_vector(beam.reference)
        self.curvature = opaque(beam.inverse_parameter.real)
        self.spread = opaque(beam.inverse_parameter.imag)
        self.inverse_square = opaque(0.0 if self.uniform else beam.radius**-2)
        self.inverse_wavenumber = opaque(1 / beam.wavenumber)
        self.inverse_wavelength = opaque(1 / beam.wavelength)
        self.common_waves = opaque(beam.reference_path / beam.wavelength % 1.0)

    def within(self, points):
        """Whether points lie within ``TRUNCATION`` of the beam's local radii of its axis."""
        along, across = self._parts(points)
        return dr.squared_norm(across) * self.inverse_square <= TRUNCATION**2 * self._step(along)[2]

    def evaluate(self, points):
        """(to_source, real, imaginary): vectors towards the light, not of unit length, and the complex amplitude.

        The path from the laser, less that to the reference point, is s + c r^2/(1 + sqrt(1 + c^2 r^2)), c = 1/R, which
        has no cancellation and goes smoothly through the waist, where c = 0. q/q_0 = 1 + s/q_0.
        """
        along, across = self._parts(points)
        real, imaginary, modulus = self._step(along)
        inverse = 1 / dr.maximum(modulus, _FOCUS)
        curvature = (self.curvature * real + self.spread * imaginary) * inverse
        spread = self.spread * inverse
        squared = dr.squared_norm(across)
        obliquity = dr.sqrt(1 + curvature * curvature * squared)
        sagitta = squared / (1 + obliquity)
        path = along + curvature * sagitta
        forward = obliquity * (1 - spread * self.inverse_wavenumber)
        forward += (spread * spread - curvature * curvature) * sagitta
        to_source = -curvature * across - forward * self.axis
        waves = path * self.inverse_wavelength + self.common_waves
        sine, cosine = dr.sincos(2 * np.pi * (waves - dr.round(waves)))
        if self.uniform:
            gouy = dr.select(real < 0, -1.0, 1.0)
            return to_source, gouy * cosine, gouy * sine
        amplitude = dr.exp(-squared * self.inverse_square * inverse) * inverse
        # q_0/q = (real - i imaginary)/modulus turns the phase by Gouy's.
        return (
            to_source,
            amplitude * (real * cosine + imaginary * sine),
            amplitude * (real * sine - imaginary * cosine),
        )

    def _parts(self, points):
        """Distance along the axis from the reference point, and the vector across it [mm]."""
        offset = points - self.reference
        along = dr.dot(offset, self.axis)
        return along, offset - along * self.axis

    def _step(self, along):
        """Real and imaginary part of q/q_0 = 1 + s/q_0, and its squared modulus, which is (w/w_0)^2."""
        real, imaginary = 1 + along * self.curvature, along * self.spread
        return real, imaginary, real * real + imaginary * imaginary
