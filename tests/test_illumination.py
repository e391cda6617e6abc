"""The laser's field at the target against 40-digit arithmetic."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scene_builder import direction

from speckle_mi.scattering.beam import Beam

pytestmark = pytest.mark.usefixtures("mitsuba")

WAVELENGTH = 632.8e-6
PHASE_ERROR = 2 * np.pi * 1e-5  # [rad]: the paths are to be right to 1e-5 of a wavelength.
AMPLITUDE_ERROR = 1e-12  # [1]: float64 arithmetic on numbers of order 1.


def beam(to_laser, distance, wavefront_radius, radius=0.12, spot=np.array([0.3, -0.2, 0.1])):
    """A beam from ``distance`` [mm] that meets ``spot`` with the given radius of curvature there."""
    return Beam(
        origin=spot + distance * to_laser, axis=-to_laser, radius=radius, wavefront_radius=wavefront_radius,
        wavelength=WAVELENGTH, reference=spot,
    )


def exact_field(beam, point):
    """exp(-r^2/w^2) exp(+ikL) by mpmath; L from the laser along the axis, then to the wavefront through the point."""
    with mpmath.workdps(40):
        vector = lambda values: mpmath.matrix([mpmath.mpf(float(v)) for v in values])
        dot = lambda a, b: sum(x * y for x, y in zip(a, b))
        origin, reference, p = vector(beam.origin), vector(beam.reference), vector(point)
        axis = vector(beam.axis)
        offset = p - reference
        to_reference = dot(reference - origin, axis)
        if np.isinf(beam.wavefront_radius):
            path = to_reference + dot(offset, axis)
        else:
            radius = mpmath.mpf(beam.wavefront_radius)
            centre = reference - radius * axis
            path = to_reference + mpmath.sign(radius) * (mpmath.norm(p - centre) - abs(radius))
        across = offset - dot(offset, axis) * axis
        amplitude = mpmath.exp(-dot(across, across) / mpmath.mpf(beam.radius) ** 2) if np.isfinite(beam.radius) else 1
        value = amplitude * mpmath.exp(2j * mpmath.pi * path / mpmath.mpf(beam.wavelength))
        return complex(value)


@pytest.mark.parametrize("wavefront_radius", [-750.0, 750.0, 50.0, -20.0, np.inf, 1e7])
@pytest.mark.parametrize("distance", [1.0, 50.0, 1e4])
@pytest.mark.parametrize(
    "to_laser", [direction(0), direction(35, 180), direction(62, 41)], ids=["normal", "tilted", "skew"]
)
def test_phase_of_the_beam_is_right_to_a_hundred_thousandth_of_a_wavelength(to_laser, distance, wavefront_radius):
    rng = np.random.default_rng(1)
    lit = beam(to_laser, distance, wavefront_radius)
    points = lit.reference + rng.uniform(-0.4, 0.4, (6, 3))
    field = lit.field(points)
    exact = np.array([exact_field(lit, point) for point in points])
    assert np.abs(np.angle(field / exact)).max() < PHASE_ERROR
    np.testing.assert_allclose(np.abs(field), np.abs(exact), rtol=0, atol=AMPLITUDE_ERROR)


def test_amplitude_falls_to_one_over_e_at_the_beam_radius_across_the_beam_and_not_along_it():
    lit = beam(direction(35, 180), 50.0, -750.0)
    across = np.cross(lit.axis, [0.0, 1.0, 0.0])
    points = np.stack([lit.reference, lit.reference + 0.12 * across, lit.reference + 0.5 * lit.axis])
    np.testing.assert_allclose(np.abs(lit.field(points)), [1, np.exp(-1), 1], atol=AMPLITUDE_ERROR)


def test_uniform_beam_has_the_same_amplitude_everywhere():
    lit = beam(direction(20), 50.0, 100.0, radius=np.inf)
    points = np.random.default_rng(2).uniform(-3, 3, (50, 3))
    np.testing.assert_allclose(np.abs(lit.field(points)), 1.0, atol=AMPLITUDE_ERROR)
    exact = np.array([exact_field(lit, point) for point in points[:5]])
    assert np.abs(np.angle(lit.field(points[:5]) / exact)).max() < PHASE_ERROR


def test_phase_increases_along_the_beam():
    lit = beam(direction(0), 50.0, np.inf)
    step = WAVELENGTH / 8
    before, after = lit.field(np.stack([lit.reference, lit.reference + step * lit.axis]))
    assert np.angle(after / before) == pytest.approx(2 * np.pi / 8, abs=PHASE_ERROR)


@pytest.mark.parametrize("wavefront_radius, sign", [(750.0, 1), (-750.0, -1)])
def test_light_of_a_diverging_beam_comes_later_off_axis_and_of_a_converging_one_earlier(wavefront_radius, sign):
    lit = beam(direction(0), 50.0, wavefront_radius)
    centre, side = lit.field(np.stack([lit.reference, lit.reference + [0.1, 0, 0]]))
    sagitta = 0.1**2 / (2 * 750)
    assert np.angle(side / centre) == pytest.approx(sign * 2 * np.pi * sagitta / WAVELENGTH, abs=1e-4)


@pytest.mark.parametrize("wavefront_radius", [-750.0, 750.0, np.inf])
def test_direction_to_the_source_is_the_gradient_of_the_phase(wavefront_radius):
    lit = beam(direction(35, 180), 50.0, wavefront_radius)
    point = lit.reference + np.array([0.1, 0.05, -0.02])
    step = 1e-6
    gradient = [
        np.angle(lit.field((point + step * axis)[None])[0] / lit.field((point - step * axis)[None])[0])
        for axis in np.eye(3)
    ]
    expected = -np.array(gradient) / (2 * step * lit.wavenumber)
    np.testing.assert_allclose(
        lit.directions_to_source(point[None])[0], expected, atol=1e-6
    )  # differences of 1e-6 mm in float64
