"""The laser's field on the target: a Gaussian beam through its waists, or uniform light of plane or curved waves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.rotation import vectors_across
from ..machine.backend import arrays
from .beam_kernel import FOCUS, TRUNCATION, BeamKernel


@dataclass(frozen=True)
class Beam:
    """The laser beam as it arrives at the target.

    origin: (3,) place of the laser [mm]; axes: (3, 3) unit columns, the beam's principal axes x, y and its direction of
    propagation; radii: (2,) 1/e^2 intensity radii along x and y at ``reference`` [mm], inf = uniform;
    wavefront_radii: (2,) signed radii of curvature along x and y at ``reference`` [mm], positive for a diverging wave,
    inf = plane; wavelength [mm]; reference: (3,) point of the axis at the target at rest [mm]; strength: modulus of the
    field there; lead: optical path [mm] that the light has come before ``origin``, where it is the last surface on its
    way instead of the laser; cutoff: how many of its radii it is taken into account to.

    Along either axis it is the lowest Gaussian mode of complex parameter q = q_0 + s, s the distance along the beam
    from ``reference`` and 1/q_0 = 1/R_0 + i lambda/(pi w_0^2) the given values there (phasor e^{+ikL}; A. E. Siegman,
    Lasers (1986), chapters 16 and 17). With 1/q_x = c_x + i lambda/(pi w_x^2), the same for y, and C the curvatures'
    matrix diag(c_x, c_y), the field at r = (x, y) across the beam is

        E = sqrt(q_x0 q_y0/(q_x q_y)) exp(-x^2/w_x^2 - y^2/w_y^2) exp(ik [s + r.Cr/(1 + sqrt(1 + |Cr|^2))]),

    so that radii, curvatures, amplitude and Gouy's phase (half a mode's from either root) are right before, in, between
    and behind the two waists. Wavefronts are no paraboloids: where both curvatures are equal they are spheres,
    sqrt(R^2 + r^2) - R, where one is zero cylinders. Where the waist is far a round beam is the exact spherical wave.
    Uniform light has the same amplitude everywhere, and its phase jumps by -pi/2 in each of its line foci, by -pi in a
    point focus. The error of the Gaussian field is about the square of the beam's divergence lambda/(pi w_waist) [rad].
    """

    origin: np.ndarray
    axes: np.ndarray
    radii: np.ndarray
    wavefront_radii: np.ndarray
    wavelength: float
    reference: np.ndarray
    strength: float = 1.0
    lead: float = 0.0
    cutoff: float = TRUNCATION

    @classmethod
    def round(
        cls, origin: np.ndarray, axis: np.ndarray, radius: float, wavefront_radius: float, wavelength: float,
        reference: np.ndarray,
    ) -> Beam:  # fmt: skip
        """A beam that is the same in all directions across its axis (3,)."""
        axis = np.asarray(axis, dtype=np.float64)
        axes = np.column_stack([*vectors_across(axis), axis])
        return cls(origin, axes, np.full(2, float(radius)), np.full(2, float(wavefront_radius)), wavelength, reference)

    @property
    def axis(self) -> np.ndarray:
        """(3,) unit direction of propagation."""
        return self.axes[:, 2]

    @property
    def across(self) -> np.ndarray:
        """(2, 3) unit vectors along the principal axes."""
        return self.axes[:, :2].T

    @property
    def is_uniform(self) -> bool:
        """Whether its amplitude is the same everywhere."""
        return bool(np.isinf(self.radii[0]))

    @property
    def is_round(self) -> bool:
        """Whether it is the same in all directions across its axis."""
        return bool(self.radii[0] == self.radii[1] and self.wavefront_radii[0] == self.wavefront_radii[1])

    @property
    def radius(self) -> float:
        """Radius of the circle that is as large as the beam's cross-section at the reference point [mm]."""
        x, y = (float(radius) for radius in self.radii)
        return x if x == y else float(np.sqrt(x) * np.sqrt(y))

    @property
    def wavenumber(self) -> float:
        """k = 2 pi / wavelength [1/mm]."""
        return 2 * np.pi / self.wavelength

    @property
    def inverse_parameters(self) -> np.ndarray:
        """(2,) 1/q_0 = 1/R_0 + i lambda/(pi w_0^2) along x and y at the reference point [1/mm]."""
        return 1 / self.wavefront_radii + 1j * self.wavelength / (np.pi * self.radii**2)

    @property
    def divergence(self) -> float:
        """Radius per distance far from a waist, lambda/(pi w_waist): half the angle [rad] of the wider 1/e^2 cone."""
        return 0.0 if self.is_uniform else float(np.max(self.radii * np.abs(self.inverse_parameters)))

    @property
    def cutoffs(self) -> np.ndarray:
        """(2,) distances along x and y up to which the beam is taken into account at the reference point [mm]."""
        return self.cutoff * self.radii

    def aimed_at(self, reference: np.ndarray) -> Beam:
        """The same beam with its radii and wavefront radii given at another point of its axis."""
        return replace(self, reference=np.asarray(reference, dtype=np.float64))

    @property
    def reference_path(self) -> float:
        """Optical path from the laser, which is the phase reference, to ``reference`` [mm]."""
        return self.lead + float((self.reference - self.origin) @ self.axis)

    def radii_at(self, point: np.ndarray) -> np.ndarray:
        """(2,) 1/e^2 intensity radii along x and y [mm] in the plane across the beam through a point (3,)."""
        along = float((point - self.reference) @ self.axis)
        return self.radii * np.abs(1 + along * self.inverse_parameters)

    def wavefront_at(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed radii of curvature (2,) [mm] of the wavefront through a point (3,), and unit vectors (2, 3) of them.

        inf where it is plane; the vectors lie in the wavefront. Off the axis of an astigmatic beam they are right to
        the square of the angle to the axis.
        """
        along, across = self._parts(np.asarray(point, dtype=np.float64)[None])
        _, curvature, _ = self._parameters(along)
        with np.errstate(divide="ignore"):
            radii = np.copysign(np.hypot(1 / curvature[:, 0], np.linalg.norm(across)), curvature[:, 0])
        normal = self.directions_to_source(np.asarray(point, dtype=np.float64)[None])[0]
        first = self.axes[:, 0] - (self.axes[:, 0] @ normal) * normal
        first /= np.linalg.norm(first)
        return radii, np.array([first, np.cross(first, normal)])

    def directions_to_source(self, points: np.ndarray) -> np.ndarray:
        """Unit vectors (n, 3) from points (n, 3) against the light's direction of propagation there.

        That is the phase's gradient: on either side of a focus they point to where the light comes from.
        """
        along, across = self._parts(points)
        _, curvature, spread = self._parameters(along)
        bent = curvature * across
        bow, squared = np.sum(bent * across, axis=0), np.sum(bent * bent, axis=0)
        obliquity = np.sqrt(1 + squared)
        sagitta = bow / (1 + obliquity)
        rate = spread**2 - curvature**2  # of the curvatures, along the beam
        aside = (2 * obliquity * bent - sagitta * curvature * bent) / (1 + obliquity)
        forward = obliquity * (1 - np.sum(spread, axis=0) / (2 * self.wavenumber))
        forward += obliquity * np.sum(rate * across**2, axis=0) / (1 + obliquity)
        forward -= sagitta * np.sum(rate * bent * across, axis=0) / (1 + obliquity)
        heading = np.stack([*aside, forward], axis=1) @ self.axes.T
        return -heading / np.linalg.norm(heading, axis=1, keepdims=True)

    def field(self, points: np.ndarray) -> np.ndarray:
        """Complex amplitude at points (n, 3) [mm], (n,) complex128; ``strength`` in modulus at ``reference``."""
        lanes = arrays()
        x, y, z = (lanes.Float64(np.ascontiguousarray(column)) for column in np.asarray(points, dtype=np.float64).T)
        _, real, imaginary = BeamKernel(self).evaluate(lanes.Array3f64(x, y, z))
        return real.numpy() + 1j * imaginary.numpy()

    def log_field(self, points: np.ndarray) -> np.ndarray:
        """A logarithm of the field at points (n, 3), (n,) complex128, continuous from place to place: for its slopes.

        Up to a constant; finite where the field itself is too weak for a number.
        """
        along, across = self._parts(points)
        modulus, curvature, _ = self._parameters(along)
        bent = curvature * across
        path = along + np.sum(bent * across, axis=0) / (1 + np.sqrt(1 + np.sum(bent * bent, axis=0)))
        if self.is_uniform:
            return 1j * self.wavenumber * path
        decay = np.sum(across**2 / (self.radii[:, None] ** 2 * modulus), axis=0)
        decay = decay + 0.5 * np.sum(np.log(1 + along * self.inverse_parameters[:, None]), axis=0)
        return 1j * self.wavenumber * path - decay

    def log_ratio(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Logarithm (n,) of the field at points (n, 3) over that at others close by."""
        return self.log_field(points) - self.log_field(others)

    def _parts(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance along the axis from the reference (n,) and the coordinates across it (2, n) [mm]."""
        local = (points - self.reference) @ self.axes
        return local[:, 2], local[:, :2].T

    def _parameters(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """|q/q_0|^2, 1/R and lambda/(pi w^2) [1/mm], (2, n) each, at distances (n,) along the axis."""
        start = self.inverse_parameters[:, None]
        step = 1 + along * start
        modulus = np.maximum(step.real**2 + step.imag**2, FOCUS)
        return modulus, (start.real * step.real + start.imag * step.imag) / modulus, start.imag / modulus
