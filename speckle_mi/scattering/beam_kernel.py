"""A beam as Dr.Jit expressions, for all scatterers at once."""

from __future__ import annotations

import drjit as dr
import numpy as np

from ..machine.backend import opaque, opaque_vector

TRUNCATION = 3.0
"""Scatterers are summed out to this many beam radii: beyond lies 1.5e-8 of the power."""

FOCUS = 1e-200
"""Least square of the beam's radius over that at the reference point: uniform light is finite in its foci."""


class BeamKernel:
    """A :class:`Beam` as Dr.Jit expressions; its parameters do not enter the compiled code.

    Of a round beam the two axes share their complex parameter, and with it all that depends on the distance alone.
    """

    def __init__(self, beam) -> None:
        self.uniform, self.round = beam.is_uniform, beam.is_round
        self.axes = [opaque_vector(beam.axes[:, k]) for k in range(3)]
        self.reference = opaque_vector(beam.reference)
        modes = slice(0, 1) if self.round else slice(0, 2)
        self.modes = [
            (opaque(value.real), opaque(value.imag), opaque(0.0 if self.uniform else radius**-2))
            for value, radius in zip(beam.inverse_parameters[modes], beam.radii[modes], strict=True)
        ]
        self.inverse_wavenumber = opaque(1 / beam.wavenumber)
        self.inverse_wavelength = opaque(1 / beam.wavelength)
        self.cutoff_square = opaque(beam.cutoff**2)
        self.strength = None if beam.strength == 1 else opaque(beam.strength)
        self.common_waves = opaque(beam.reference_path / beam.wavelength % 1.0)

    def within(self, points):
        """Whether points lie within the beam's ``cutoff`` times its local radii of its axis."""
        along, across = self._parts(points)
        steps = [_step(along, *mode[:2]) for mode in self.modes]
        if self.round:
            inverse_square = self.modes[0][2]
            return _squares(across) * inverse_square <= self.cutoff_square * steps[0][2]
        # Without a division, which would be by zero in the foci of a beam that is nearly uniform.
        x, y = (c * c * mode[2] for c, mode in zip(across, self.modes, strict=True))
        return x * steps[1][2] + y * steps[0][2] <= self.cutoff_square * steps[0][2] * steps[1][2]

    def evaluate(self, points):
        """(to_source, real, imaginary): vectors towards the light, not of unit length, and the complex amplitude.

        The path from the laser, less that to the reference point, is s + r.Cr/(1 + sqrt(1 + |Cr|^2)), which has no
        cancellation and goes smoothly through the waists, where a curvature is 0. q/q_0 = 1 + s/q_0.
        """
        along, across = self._parts(points)
        steps, curvatures, spreads, inverses = [], [], [], []
        for curvature, spread, _ in self.modes:
            real, imaginary, modulus = _step(along, curvature, spread)
            inverse = 1 / dr.maximum(modulus, FOCUS)
            steps.append((real, imaginary, modulus))
            inverses.append(inverse)
            curvatures.append((curvature * real + spread * imaginary) * inverse)
            spreads.append(spread * inverse)
        heading, path = (self._round if self.round else self._astigmatic)(along, across, curvatures, spreads)
        to_source = -heading[0] * self.axes[0] - heading[1] * self.axes[1] - heading[2] * self.axes[2]
        waves = path * self.inverse_wavelength + self.common_waves
        sine, cosine = dr.sincos(2 * np.pi * (waves - dr.round(waves)))
        real, imaginary = self._envelope(along, across, steps, inverses)
        if self.strength is not None:
            real, imaginary = self.strength * real, self.strength * imaginary
        return to_source, real * cosine - imaginary * sine, real * sine + imaginary * cosine

    def _round(self, along, across, curvatures, spreads):
        """Gradient of the phase, times its obliquity, along x, y and the beam; path [mm]."""
        (curvature,), (spread,), squared = curvatures, spreads, _squares(across)
        obliquity = dr.sqrt(1 + curvature * curvature * squared)
        sagitta = squared / (1 + obliquity)
        forward = obliquity * (1 - spread * self.inverse_wavenumber)
        forward += (spread * spread - curvature * curvature) * sagitta
        return (curvature * across[0], curvature * across[1], forward), along + curvature * sagitta

    def _astigmatic(self, along, across, curvatures, spreads):
        """The same where curvature and radius differ along x and y."""
        bent = [curvature * c for curvature, c in zip(curvatures, across, strict=True)]
        obliquity = dr.sqrt(1 + _squares(bent))
        inverse = 1 / (1 + obliquity)
        sagitta = (bent[0] * across[0] + bent[1] * across[1]) * inverse
        rates = [spread * spread - curvature * curvature
                 for spread, curvature in zip(spreads, curvatures, strict=True)]  # fmt: skip
        moved = [rate * c for rate, c in zip(rates, across, strict=True)]
        aside = [inverse * b * (2 * obliquity - sagitta * curvature)
                 for b, curvature in zip(bent, curvatures, strict=True)]  # fmt: skip
        forward = obliquity * (1 - 0.5 * (spreads[0] + spreads[1]) * self.inverse_wavenumber)
        forward += inverse * obliquity * (moved[0] * across[0] + moved[1] * across[1])
        forward -= inverse * sagitta * (moved[0] * bent[0] + moved[1] * bent[1])
        return (*aside, forward), along + sagitta

    def _envelope(self, along, across, steps, inverses):
        """Real and imaginary part of the amplitude without the path's phase: sqrt(q_x0 q_y0/(q_x q_y)) e^-decay."""
        if self.uniform:
            real, imaginary = 1.0, 0.0
            side = dr.select(along < 0, 1.0, -1.0)  # of the reference: a focus on the way turns the phase by -pi/2
            for step in steps if len(steps) == 2 else steps * 2:
                behind = step[0] < 0
                turned = -side * imaginary, side * real
                real, imaginary = dr.select(behind, turned[0], real), dr.select(behind, turned[1], imaginary)
            return real, imaginary
        if self.round:
            (real, imaginary, _), inverse = steps[0], inverses[0]
            amplitude = dr.exp(-_squares(across) * self.modes[0][2] * inverse) * inverse
            # q_0/q = (real - i imaginary)/modulus turns the phase by Gouy's.
            return amplitude * real, -amplitude * imaginary
        decay = sum(c * c * mode[2] * inverse for c, mode, inverse in zip(across, self.modes, inverses, strict=True))
        (a, b), (c, d) = (_inverse_root(*step[:2], inverse) for step, inverse in zip(steps, inverses, strict=True))
        amplitude = dr.exp(-decay)
        return amplitude * (a * c - b * d), amplitude * (a * d + b * c)

    def _parts(self, points):
        """Distance along the axis from the reference point, and the two coordinates across it [mm]."""
        offset = points - self.reference
        return dr.dot(offset, self.axes[2]), [dr.dot(offset, axis) for axis in self.axes[:2]]


def _squares(pair):
    return pair[0] * pair[0] + pair[1] * pair[1]


def _step(along, curvature, spread):
    """Real and imaginary part of q/q_0 = 1 + s/q_0, and its squared modulus, which is (w/w_0)^2."""
    real, imaginary = 1 + along * curvature, along * spread
    return real, imaginary, real * real + imaginary * imaginary


def _inverse_root(real, imaginary, inverse):
    """1/sqrt(q/q_0) as real and imaginary part: the root that is continuous along the beam and 1 at the reference.

    inverse: 1/|q/q_0|^2. The principal root is that one, as the imaginary part of s/q_0 has the sign of s.
    """
    modulus = 1 / dr.sqrt(inverse)
    larger = dr.sqrt(0.5 * (modulus + dr.abs(real)))
    smaller = 0.5 * dr.abs(imaginary) / larger
    front = real >= 0
    scale = dr.sqrt(inverse)  # 1/sqrt(z) is the conjugate of sqrt(z) over |z|
    return scale * dr.select(front, larger, smaller), -scale * dr.mulsign(dr.select(front, smaller, larger), imaginary)
