"""The laser's field at the target against 40-digit arithmetic, and through its focus against the wave equation."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scene_builder import direction, free_space

from speckle_mi.field.simulation import simulate_frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.scattering.beam import TRUNCATION, Beam

pytestmark = pytest.mark.usefixtures("mitsuba")

WAVELENGTH = 632.8e-6
PHASE_ERROR = 2 * np.pi * 1e-5  # [rad]: the paths are to be right to 1e-5 of a wavelength.
AMPLITUDE_ERROR = 1e-12  # [1]: float64 arithmetic on numbers of order 1.


def beam(to_laser, distance, wavefront_radius, radius=0.12, spot=np.array([0.3, -0.2, 0.1])):
    """A beam from ``distance`` [mm] that meets ``spot`` with the given radius of curvature there."""
    return Beam.round(
        origin=spot + distance * to_laser, axis=-to_laser, radius=radius, wavefront_radius=wavefront_radius,
        wavelength=WAVELENGTH, reference=spot,
    )


def exact_field(beam, point):
    """The Gaussian mode of parameter q = q_0 + s by mpmath, its wavefronts taken as spheres; a sphere if uniform.

    L from the laser along the axis, then to the wavefront through the point.
    """
    with mpmath.workdps(40):
        vector = lambda values: mpmath.matrix([mpmath.mpf(float(v)) for v in values])
        dot = lambda a, b: sum(x * y for x, y in zip(a, b))
        origin, reference, p = vector(beam.origin), vector(beam.reference), vector(point)
        axis, k = vector(beam.axis), 2 * mpmath.pi / mpmath.mpf(beam.wavelength)
        offset = p - reference
        path, s = dot(reference - origin, axis), dot(offset, axis)
        radius = mpmath.mpf(beam.wavefront_radii[0])
        if np.isinf(beam.wavefront_radii[0]) and np.isinf(beam.radius):
            return complex(mpmath.exp(1j * k * (path + s)))
        if np.isinf(beam.radius):  # the laser, the point focus and Gouy's phase of it
            centre = reference - radius * axis
            side, behind = mpmath.sign(s + radius), mpmath.sign(s + radius) != mpmath.sign(radius)
            path += side * mpmath.norm(p - centre) - radius
            return complex((-1 if behind else 1) * mpmath.exp(1j * k * path))
        start = 1 / (1 / radius + 2j / (k * mpmath.mpf(beam.radius) ** 2))
        q, across = start + s, offset - s * axis
        squared, curvature = dot(across, across), mpmath.re(1 / q)
        bow = (mpmath.sqrt(1 + squared * curvature**2) - 1) / curvature if curvature else 0
        return complex(start / q * mpmath.exp(-k / 2 * mpmath.im(1 / q) * squared + 1j * k * (path + s + bow)))


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


@pytest.mark.parametrize("wavefront_radius", [-0.5, 3.0, np.inf])
def test_amplitude_falls_to_one_over_e_at_the_local_radius_and_the_power_is_the_same_everywhere(wavefront_radius):
    lit = beam(direction(35, 180), 50.0, wavefront_radius, radius=0.03)
    across = np.cross(lit.axis, [0.0, 1.0, 0.0])
    for along in (0.0, 0.3, 0.5, 2.0, -0.4):
        place = lit.reference + along * lit.axis
        radius = lit.radii_at(place)[0]
        middle, edge = np.abs(lit.field(np.stack([place, place + radius * across])))
        assert edge / middle == pytest.approx(np.exp(-1), abs=AMPLITUDE_ERROR)
        assert middle * radius == pytest.approx(0.03, rel=AMPLITUDE_ERROR)
    assert lit.radii_at(lit.reference)[0] == 0.03


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
    points = lit.reference + np.array([[0.1, 0.05, -0.02]])
    np.testing.assert_allclose(lit.directions_to_source(points), against_the_phase(lit, points), atol=DIFFERENCE)


# Through the focus

DIFFERENCE = 1e-6  # [rad]: differences of the phase over 1e-6 mm in float64.
DIVERGENCE_SQUARED = 1.0  # The promise: the field's relative error over the square of the beam's divergence.

FOCUSED = {
    "converging": {"radius": 0.02, "wavefront_radius": -0.5},
    "diverging": {"radius": 0.03, "wavefront_radius": 3.0},
    "waist on the target": {"radius": 0.01, "wavefront_radius": np.inf},
}


def against_the_phase(lit, points):
    """Unit vectors (n, 3) against the gradient of the field's phase, by central differences."""
    step = 1e-6
    gradient = np.stack(
        [np.angle(lit.field(points + step * axis) / lit.field(points - step * axis)) for axis in np.eye(3)], axis=1
    )
    return -gradient / np.linalg.norm(gradient, axis=1, keepdims=True)


def propagated(field, pitch, distance):
    """A field on a square grid after a distance [mm], by its angular spectrum: exact for the wave equation."""
    f = np.fft.fftfreq(len(field), pitch)
    along = np.sqrt((WAVELENGTH**-2 - f[:, None] ** 2 - f**2).astype(complex))
    return np.fft.ifft2(np.fft.fft2(field) * np.exp(2j * np.pi * along * distance))


def places_to_the_waist(lit):
    """Distances along the axis of the waist [mm], and the Rayleigh length."""
    q = 1 / (1 / lit.wavefront_radii[0] + 1j * lit.wavelength / (np.pi * lit.radius**2))
    return -q.real, -q.imag


@pytest.mark.parametrize("name", FOCUSED)
def test_field_before_in_and_behind_the_waist_is_that_of_the_angular_spectrum(name):
    lit = beam(direction(0), 50.0, spot=np.zeros(3), **FOCUSED[name])
    waist, rayleigh = places_to_the_waist(lit)
    before, behind = waist - 5 * rayleigh, waist + np.array([-1.0, 0.0, 0.7, 5.0]) * rayleigh
    n, pitch = 256, 10 * lit.radii_at(before * lit.axis)[0] / 256
    x, y = np.meshgrid(*2 * [pitch * (np.arange(n) - n / 2)])

    def on_plane(along):
        return lit.field(np.stack([x.ravel(), y.ravel(), np.full(x.size, -along)], axis=1)).reshape(n, n)

    start = on_plane(before)
    for along in behind:
        exact = propagated(start, pitch, along - before)
        error = np.linalg.norm(on_plane(along) - exact) / np.linalg.norm(exact)
        assert error < DIVERGENCE_SQUARED * lit.divergence**2, (along, error)


@pytest.mark.parametrize("name", FOCUSED)
def test_field_is_continuous_through_the_waist_and_turns_by_half_a_wave_less_than_the_path(name):
    lit = beam(direction(20), 50.0, **FOCUSED[name])
    waist, rayleigh = places_to_the_waist(lit)
    across = 0.3 * lit.divergence * rayleigh * np.cross(lit.axis, [0.0, 1.0, 0.0])
    along = waist + rayleigh * np.linspace(-20, 20, 4001)
    for aside in (0 * across, across):
        field = lit.field(lit.reference + aside + along[:, None] * lit.axis)
        field = field * np.exp(-1j * lit.wavenumber * (lit.reference_path + along))
        assert np.abs(np.diff(field)).max() < 0.02 * np.abs(field).max()
    field = lit.field(lit.reference + along[:, None] * lit.axis) * np.exp(-1j * lit.wavenumber * along)
    turned = np.unwrap(np.angle(field))
    # Gouy's phase -atan((s - s_waist)/b).
    np.testing.assert_allclose(turned - turned[2000], -np.arctan((along - waist) / rayleigh), atol=PHASE_ERROR)


@pytest.mark.parametrize("name", FOCUSED)
def test_light_comes_from_where_the_phase_says_on_either_side_of_the_waist(name):
    lit = beam(direction(35, 180), 50.0, **FOCUSED[name])
    waist, rayleigh = places_to_the_waist(lit)
    width = lit.divergence * rayleigh
    across = np.stack([np.cross(lit.axis, [0.0, 1.0, 0.0]), [0.0, 1.0, 0.0]])
    along = waist + rayleigh * np.array([-10.0, -1.0, 0.0, 0.5, 10.0])
    points = lit.reference + along[:, None] * lit.axis + width * np.array([0.7, -0.4]) @ across
    np.testing.assert_allclose(lit.directions_to_source(points), against_the_phase(lit, points), atol=DIFFERENCE)
    assert np.all(lit.directions_to_source(points) @ lit.axis < 0)


@pytest.mark.parametrize("wavefront_radius", [-0.5, 0.5, -750.0])
def test_uniform_light_goes_through_its_point_focus_as_an_exact_sphere_and_turns_by_pi(wavefront_radius):
    lit = beam(direction(35, 180), 1000.0, wavefront_radius, radius=np.inf)
    focus = lit.reference - wavefront_radius * lit.axis
    rng = np.random.default_rng(5)
    aside = np.cross(rng.normal(size=(8, 3)), lit.axis) * 0.05
    for along in (-0.3, 0.3):
        points = focus + aside + along * lit.axis
        exact = np.array([exact_field(lit, point) for point in points])
        np.testing.assert_allclose(lit.field(points), exact, rtol=0, atol=PHASE_ERROR)
        away = np.sign(along) * (focus - points)
        expected = away / np.linalg.norm(away, axis=1, keepdims=True)
        np.testing.assert_allclose(lit.directions_to_source(points), expected, atol=1e-9)
        assert lit.wavefront_at(points[0])[0] == pytest.approx(np.sign(along) * np.linalg.norm(points[0] - focus))
    assert np.abs(lit.field(focus[None]))[0] == pytest.approx(1, abs=AMPLITUDE_ERROR)


# Scatterers under a beam of changing radius


@pytest.mark.parametrize("angle, radius, past", [(0.0, 0.02, 0.3), (35.0, 0.02, 1.5), (50.0, 0.05, 0.3)])
def test_a_target_behind_the_focus_is_lit_by_a_diverging_beam_of_the_radius_there(assemble, angle, radius, past):
    text = free_space(
        direction(angle, 180), direction(0), laser={"beam_radius": radius, "wavefront_radius": -0.5},
        target={"roughness": 0.0, "point_sources": 4000}, detector={"width": 4, "height": 4, "pixel_pitch": 0.1},
    )
    assembly = assemble(text)
    moved = -(0.5 + past) * np.cos(np.radians(angle))
    frame = simulate_frame(assembly, Pose(z=moved))
    assert not frame.warnings and np.abs(frame.image.field).min() > 0
    lit, place = assembly.beam, frame.scatterers.position
    along = (place - lit.reference) @ lit.axis
    across = np.linalg.norm(place - lit.reference - along[:, None] * lit.axis, axis=1)
    waist, rayleigh = places_to_the_waist(lit)
    local = np.hypot(1, (along - waist) / rayleigh) / np.hypot(1, waist / rayleigh) * radius
    assert np.all(across <= TRUNCATION * local * (1 + 1e-9))
    # The area on the tilted plane that lies within three local radii, counted on a fine grid.
    spot = lit.reference + (0.5 + past) * lit.axis
    half = 4 * TRUNCATION * lit.radii_at(spot)[0] / np.cos(np.radians(angle))
    x, y = np.meshgrid(*2 * [np.linspace(-half, half, 1201)])
    grid = np.stack([x, y, np.zeros_like(x)], axis=-1) + spot
    s = (grid - lit.reference) @ lit.axis
    r = np.linalg.norm(grid - lit.reference - s[..., None] * lit.axis, axis=-1)
    inside = r <= TRUNCATION * radius * np.hypot(1, (s - waist) / rayleigh) / np.hypot(1, waist / rayleigh)
    assert not (inside[0].any() or inside[-1].any() or inside[:, 0].any() or inside[:, -1].any())
    expected = assembly.target.surface.density * inside.sum() * (2 * half / 1200) ** 2
    # One scatterer a cell: only the cells that the edge cuts may go either way.
    on_edge = 2 * np.sqrt(np.pi * expected)
    assert frame.scatterers.count == pytest.approx(expected, rel=0, abs=4 * 0.5 * np.sqrt(on_edge))


@pytest.mark.parametrize("values", [{"beam_radius": 0.12, "wavefront_radius": -0.1}, {"beam_radius": 1e-4}])
def test_light_that_is_too_steep_for_a_gaussian_beam_is_refused_in_one_line(assemble, values):
    with pytest.raises((ValueError, RuntimeError), match=r"beam_radius [\d.e-]+ mm .* diverges by [\d.]+ rad.*at most"):
        assemble(free_space(laser=values))
