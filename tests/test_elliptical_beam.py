"""Elliptical, astigmatic beams: their field against 40-digit arithmetic and the wave equation, and what they do to
speckle along both axes against first-order theory and the statistics of simulated frames."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scene_builder import detector_frame, detector_xml, direction, frame_along, integrator_xml, laser_xml, scene_of, target_xml
from test_illumination import against_the_phase, propagated

from speckle_mi import theory
from speckle_mi.experiments.expectation import expected_correlation, expected_sensitivity
from speckle_mi.field.simulation import simulate, simulate_frame
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM, Pose
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.measurement.correlator import Correlator
from speckle_mi.scattering.beam import Beam
from speckle_mi.scattering.beam_kernel import TRUNCATION
from speckle_mi.scattering.facets import Facets
from speckle_mi.scattering.footprint import footprint_bounds

pytestmark = pytest.mark.usefixtures("mitsuba")

WAVELENGTH = 632.8e-6
PHASE_ERROR = 2 * np.pi * 1e-5  # [rad]: the paths are to be right to 1e-5 of a wavelength.
ROUNDING = 1e-12  # [1]: float64 arithmetic on numbers of order 1.
DIFFERENCE = 1e-6  # [rad]: differences of the phase over 1e-6 mm in float64.
RELATIVE = 0.01  # Deviation from theory that is allowed ...
STANDARD_ERRORS = 4  # ... or as many standard errors of the mean over surfaces.


def turned_frame(to_laser, distance, turn):
    """A laser's place, its local axes turned [deg] about its direction of propagation."""
    frame = frame_along(-np.asarray(to_laser), distance * np.asarray(to_laser))
    return Frame(frame.origin, frame.axes @ rotation_matrix(np.radians([0.0, 0.0, turn])))


def beam(radii, wavefront_radii, to_laser=direction(35, 180), distance=50.0, turn=25.0):
    frame = turned_frame(to_laser, distance, turn)
    return Beam(frame.origin, frame.axes, np.array(radii), np.array(wavefront_radii), WAVELENGTH, np.zeros(3))


def exact_field(lit, point):
    """The product of two one-dimensional Gaussian modes of q = q_0 + s and its wavefront, by mpmath."""
    with mpmath.workdps(40):
        vector = lambda values: [mpmath.mpf(float(v)) for v in values]  # noqa: E731
        dot = lambda a, b: sum(x * y for x, y in zip(a, b, strict=True))  # noqa: E731
        k = 2 * mpmath.pi / mpmath.mpf(lit.wavelength)
        offset = [p - q for p, q in zip(vector(point), vector(lit.reference), strict=True)]
        axes = [vector(column) for column in lit.axes.T]
        path = dot([p - q for p, q in zip(vector(lit.reference), vector(lit.origin), strict=True)], axes[2])
        s, value, bow, squared = dot(offset, axes[2]), mpmath.mpc(1), mpmath.mpf(0), mpmath.mpf(0)
        for axis, radius, bend in zip(axes, lit.radii, lit.wavefront_radii, strict=False):
            c = dot(offset, axis)
            curved = 0 if np.isinf(bend) else 1 / mpmath.mpf(bend)
            start = mpmath.mpc(curved, 0 if np.isinf(radius) else 2 / (k * mpmath.mpf(radius) ** 2))
            if np.isinf(radius):  # turned by a quarter of a wave in each line focus between here and the reference
                value *= (-1j if s > 0 else 1j) if mpmath.re(1 + s * start) < 0 else 1
            else:
                # The root that is continuous from the reference on: by the angle that grows from zero.
                step = 1 + s * start
                value *= mpmath.exp(-1j * mpmath.arg(step) / 2) / mpmath.sqrt(abs(step))
                value *= mpmath.exp(-k / 2 * mpmath.im(start / step) * c**2)
            curvature = mpmath.re(start / (1 + s * start))
            bow, squared = bow + curvature * c**2, squared + (curvature * c) ** 2
        return complex(value * mpmath.exp(1j * k * (path + s + bow / (1 + mpmath.sqrt(1 + squared)))))


BEAMS = {
    "elliptical": ([0.1, 0.3], [-750.0, -750.0]),
    "astigmatic": ([0.12, 0.12], [-60.0, 90.0]),
    "both": ([0.05, 0.2], [40.0, -300.0]),
    "plane along one axis": ([0.2, 0.04], [np.inf, 25.0]),
    "uniform, a line focus on either side": ([np.inf, np.inf], [0.2, -0.15]),
    "uniform, cylindrical": ([np.inf, np.inf], [np.inf, -80.0]),
}


@pytest.mark.parametrize("name", BEAMS)
def test_field_is_that_of_two_modes_to_forty_digits(name):
    lit = beam(*BEAMS[name])
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (12, 3))
    exact = np.array([exact_field(lit, point) for point in points])
    field = lit.field(points)
    assert np.abs(np.angle(field / exact)).max() < PHASE_ERROR
    np.testing.assert_allclose(np.abs(field), np.abs(exact), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("name", BEAMS)
def test_light_comes_from_where_the_phase_says(name):
    lit = beam(*BEAMS[name])
    points = lit.reference + np.array([[0.1, 0.05, -0.02], [-0.04, 0.03, 0.06]])
    np.testing.assert_allclose(lit.directions_to_source(points), against_the_phase(lit, points), atol=DIFFERENCE)


@pytest.mark.parametrize("name", BEAMS)
def test_slopes_of_the_logarithm_are_those_of_the_field(name):
    lit, step = beam(*BEAMS[name]), 1e-6
    points = np.array([[0.1, 0.05, -0.02], [-0.04, 0.03, 0.06]])
    for axis in np.eye(3):
        ends = points + step * axis, points - step * axis
        ratio = np.log(lit.field(ends[0]) / lit.field(ends[1]))
        # Both are differences of phases of some 1e5 rad.
        np.testing.assert_allclose(lit.log_field(ends[0]) - lit.log_field(ends[1]), ratio, atol=1e-9)


FOCUSED = {
    "waists at two places": ([0.03, 0.02], [3.0, -0.8]),
    "one waist on the target": ([0.01, 0.03], [np.inf, -0.9]),
}


@pytest.mark.parametrize("name", FOCUSED)
def test_field_before_between_and_behind_the_two_waists_is_that_of_the_angular_spectrum(name):
    lit = beam(*FOCUSED[name], to_laser=direction(0), turn=0.0)
    q = 1 / lit.inverse_parameters
    waists, rayleigh = -q.real, np.abs(q.imag)
    before = (waists - 2 * rayleigh).min()
    n, axes = 512, lit.across
    start_radii = np.maximum(lit.radii_at(before * lit.axis), lit.radii_at((waists + 2 * rayleigh).max() * lit.axis))
    pitch = 9 * start_radii.max() / n
    a, b = np.meshgrid(*2 * [pitch * (np.arange(n) - n / 2)])
    grid = a.ravel()[:, None] * axes[0] + b.ravel()[:, None] * axes[1]

    def on_plane(along):
        return lit.field(grid + along * lit.axis).reshape(n, n)

    start = on_plane(before)
    for along in (*waists, waists.mean(), (waists + 2 * rayleigh).max()):
        exact = propagated(start, pitch, along - before)
        error = np.linalg.norm(on_plane(along) - exact) / np.linalg.norm(exact)
        assert error < lit.divergence**2, (along, error)


def test_a_beam_of_two_equal_axes_is_the_round_beam():
    """The two ways of evaluating it agree, on either side of the waist."""
    points = np.random.default_rng(2).uniform(-0.5, 0.5, (200, 3))
    for wavefront_radius in (-750.0, 0.3, np.inf):
        same = beam([0.04, 0.04], [wavefront_radius] * 2)
        # The last digit of a radius apart, which the round beam's own formulas do not take.
        apart = beam([0.04, np.nextafter(0.04, 1)], [wavefront_radius] * 2)
        assert same.is_round and not apart.is_round
        np.testing.assert_allclose(apart.field(points), same.field(points), rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            apart.directions_to_source(points), same.directions_to_source(points), rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(apart.wavefront_at(points[0])[0], same.wavefront_at(points[0])[0])


# What lies under the beam


def scene(laser, detector=None, target=None, to_laser=direction(35, 180), sight=direction(0), turn=0.0, integrator=None):
    return scene_of(
        integrator_xml(**(integrator or {})),
        laser_xml(turned_frame(to_laser, 50.0, turn), **{"beam_radius": None, "wavefront_radius": None} | laser),
        target_xml(**(target or {})),
        detector_xml(detector_frame(np.asarray(sight), 60.0), **(detector or {"width": 8, "height": 8})),
    )


def beside_axis(lit, places):
    """Distances (2, ...) of places from the axis over the radii there, along both axes."""
    local = (places - lit.reference) @ lit.axes
    step = np.abs(1 + local[..., 2, None] * lit.inverse_parameters)
    return np.moveaxis(local[..., :2] / (step * lit.radii), -1, 0)


@pytest.mark.parametrize(
    "laser, angle, turn",
    [
        ({"beam_radius_x": 0.1, "beam_radius_y": 0.3}, 35, 0),
        ({"beam_radius_x": 0.05, "beam_radius_y": 0.2, "wavefront_radius_x": -1.5, "wavefront_radius_y": 4.0}, 50, 30),
        ({"beam_radius": 0.02, "wavefront_radius_x": -0.4, "wavefront_radius_y": 0.3}, 60, 70),
    ],
)
def test_all_that_lies_within_the_ellipse_is_lit_and_nothing_else(assemble, laser, angle, turn):
    assembly = assemble(scene(laser, target={"point_sources": 4000, "roughness": 0.0}, to_laser=direction(angle, 180), turn=turn))
    lit, place = assembly.beam, simulate_frame(assembly).scatterers.position
    assert np.all(np.sum(beside_axis(lit, place) ** 2, axis=0) <= TRUNCATION**2 * (1 + 1e-9))
    half = 2.0
    x, y = np.meshgrid(*2 * [np.linspace(-half, half, 1601)])
    inside = np.sum(beside_axis(lit, np.stack([x, y, np.zeros_like(x)], axis=-1)) ** 2, axis=0) <= TRUNCATION**2
    expected = assembly.target.surface.density * inside.sum() * (2 * half / 1600) ** 2
    on_edge = 2 * np.sqrt(np.pi * expected) * max(*lit.radii) / min(*lit.radii)
    assert len(place) == pytest.approx(expected, rel=0, abs=4 * 0.5 * np.sqrt(on_edge))
    # The box that is searched: it holds all of it, and is not much larger.
    centre, reach = footprint_bounds(Facets.rectangle(8.0, 8.0), lit, assembly.target.frame)
    seen = np.stack([x[inside], y[inside]], axis=1)
    assert np.all(np.abs(seen - centre[0]) <= reach[0] + 1e-9)
    assert np.all(reach[0] <= 1.45 * np.ptp(seen, axis=0) / 2)


def test_point_sources_are_those_in_the_ellipse_of_both_radii(assemble):
    laser = {"beam_radius_x": 0.1, "beam_radius_y": 0.3}
    assembly = assemble(scene(laser, target={"point_sources": 4000, "roughness": 0.0}))
    place = simulate_frame(assembly).scatterers.position
    inside = np.sum(beside_axis(assembly.beam, place) ** 2, axis=0) <= 1
    assert inside.sum() == pytest.approx(4000, rel=0.01)


@pytest.mark.parametrize(
    "laser, words",
    [
        ({"beam_radius_x": 0.1}, ["beam_radius_x", "beam_radius_y", "inf", "both"]),
        ({"beam_radius": 0.1, "beam_radius_x": 0.1, "beam_radius_y": 0.2}, ["beam_radius", "left out"]),
        ({"beam_radius": 0.1, "wavefront_radius_y": 0.0}, ["wavefront_radius_y", "must not be 0"]),
        ({"beam_radius": 0.1, "wavefront_radius_y": -0.1}, ["wavefront_radius_y", "diverges", "at most"]),
        ({"beam_radius_x": -0.1, "beam_radius_y": 0.1}, ["beam_radius_x", "-0.1", "at least"]),
    ],
)
def test_radii_that_describe_no_beam_are_refused_in_one_line(assemble, laser, words):
    with pytest.raises((ValueError, RuntimeError)) as refused:
        assemble(scene(laser))
    message = str(refused.value)
    assert all(word in message for word in words), message


# Speckle: size, displacement, decorrelation

WIDE = {"beam_radius_x": 0.12, "beam_radius_y": 0.3}
BENT = {"wavefront_radius_x": -60.0, "wavefront_radius_y": 90.0}
DETECTOR = {"width": 192, "height": 192, "pixel_pitch": 0.016}


@pytest.mark.parametrize("turn", [0.0, 35.0])
def test_coherence_on_the_detector_is_that_of_the_elliptical_spot_along_both_axes(assemble, turn):
    """|mu| of what the simulation sums, its random phases averaged: sum |c|^2 e^{ik(r1 - r2)} over its scatterers."""
    assembly = assemble(scene(WIDE | BENT, target={"point_sources": 20_000, "roughness": 0.0}, turn=turn))
    lit, spot, grid = simulate_frame(assembly).scatterers, assembly.spot, assembly.detector
    k = 2 * np.pi / WAVELENGTH
    centre = grid.centre
    expected = theory.speckle_size_gaussian_beam(
        assembly.beam.radii, WAVELENGTH, spot.point, spot.normal, -assembly.beam.axis, centre, grid.u, grid.v,
        assembly.beam.across,
    )

    def coherence(step):
        r = [np.linalg.norm(lit.position - (centre + sign * step / 2), axis=1) for sign in (1, -1)]
        power = np.abs(lit.amplitude) ** 2
        return abs(np.sum(power * np.exp(1j * k * (r[0] - r[1])))) ** 2 / np.sum(power) ** 2

    for axis, width in zip((grid.u, grid.v), expected, strict=True):
        # Half the full width at half maximum of |mu|^2 apart: one half.
        assert coherence(width / 2 * axis) == pytest.approx(0.5, rel=RELATIVE)
    assert turn or expected[0] > 2 * expected[1]


def test_speckle_of_frames_is_as_wide_as_the_ellipse_says_along_both_axes(assemble):
    # The spot's image must be resolved by the pixels: 3 px and more.
    assembly = assemble(scene(WIDE | BENT, detector=DETECTOR, target={"point_sources": 400}, to_laser=direction(0)))
    grid, spot, surfaces = assembly.detector, assembly.spot, 12
    shape = theory.speckle_shape_gaussian_beam(
        assembly.beam.radii, WAVELENGTH, spot.point, spot.normal, -assembly.beam.axis, grid.centre, grid.u, grid.v,
        assembly.beam.across,
    )
    for axis, step in ((1, 2), (0, 4)):
        found = []
        for seed in range(surfaces):
            image = simulate(assembly.with_seed(seed)).intensity.astype(np.float64)
            image = image / image.mean() - 1
            first, second = (np.moveaxis(image, axis, 0)[part] for part in (slice(step, None), slice(None, -step)))
            found.append(np.mean(first * second))
        which = 0 if axis == 1 else 1
        expected = np.exp(-shape[which, which] * (step * grid.pitch) ** 2)
        error = np.std(found, ddof=1) / np.sqrt(surfaces)
        # Each image's mean is taken of itself, which lowers the covariance by one over its number of speckles.
        count = grid.size * grid.pitch**2 * np.sqrt(np.linalg.det(shape)) / np.pi
        assert np.mean(found) == pytest.approx(expected - 1 / count, abs=max(STANDARD_ERRORS * error, RELATIVE * expected))


def stationary(lit, spot, path, pose, u, v):
    """Displacement (2,) of the pattern on (u, v): the whole path's change has no gradient over the surface z = 0.

    path: length from points (n, 3) to a place (3,).
    """
    h, k = 0.01, 2 * np.pi / lit.wavelength
    points = spot + h * np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    moved = Frame(np.zeros(3), np.eye(3)).moved(pose).to_world(points)
    whole = lambda places, end: lit.log_field(places).imag / k + path(places, end)  # noqa: E731
    rest = whole(points, 0.0)
    slope = lambda shift: np.subtract(*np.split(whole(moved, shift[0] * u + shift[1] * v) - rest, 2))  # noqa: E731
    base = slope(np.zeros(2))
    step = 1e-3
    matrix = np.stack([(slope(step * unit) - slope(-step * unit)) / (2 * step) for unit in np.eye(2)], axis=1)
    return np.linalg.solve(matrix, -base)


@pytest.mark.parametrize("turn", [0.0, 40.0])
def test_first_order_theory_is_where_the_exact_paths_change_alike(assemble, turn):
    assembly = assemble(scene(WIDE | BENT, turn=turn, sight=direction(20, 60)))
    expected = expected_sensitivity(assembly)
    lit, grid = assembly.beam, assembly.detector
    closed = theory.first_order_displacement(
        assembly.spot.point, np.zeros(3), np.eye(3), -lit.axis, theory.astigmatic_wave(*lit.wavefront_at(assembly.spot.point)),
        grid.centre, grid.u, grid.v,
    )
    np.testing.assert_allclose(theory.per_degree(closed), [expected["u"], expected["v"]], rtol=1e-4, atol=1e-4)
    path = lambda places, end: np.linalg.norm(grid.centre + end - places, axis=1)  # noqa: E731
    amount = 1e-3
    for column, dof in enumerate(DEGREES_OF_FREEDOM):
        ends = [stationary(lit, assembly.spot.point, path, Pose(**{dof: s * amount}), grid.u, grid.v) for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * amount)
        theirs = np.array([expected["u"][column], expected["v"][column]])
        # The surface is sampled over 0.01 mm, and displacement is first order: squares of 1e-3.
        np.testing.assert_allclose(slope, theirs, rtol=2e-3, atol=2e-4, err_msg=dof)


STEP = {"x": 0.02, "y": 0.02, "z": 0.02, "rx": 0.015, "ry": 0.015, "rz": 0.03}  # [mm, deg]


def test_patterns_of_frames_move_as_theory_says_along_both_axes(assemble):
    text = scene(
        {"beam_radius_x": 0.25, "beam_radius_y": 0.35} | BENT, detector=DETECTOR, target={"point_sources": 30}, turn=20.0,
        sight=direction(10, 60),
    )
    assembly, surfaces = assemble(text), 12
    expected = expected_sensitivity(assembly)
    round_one = assemble(text.replace('name="wavefront_radius_y" value="90.0"', 'name="wavefront_radius_y" value="-60.0"'))
    other = expected_sensitivity(round_one)
    slopes = np.empty((surfaces, 2, 6))
    for seed in range(surfaces):
        surface = assembly.with_seed(seed)
        correlator = Correlator(simulate(surface, Pose()).intensity)
        for column, dof in enumerate(DEGREES_OF_FREEDOM):
            ends = [correlator.shift(simulate(surface, Pose(**{dof: s * STEP[dof]})).intensity) for s in (1, -1)]
            assert all(end.ok for end in ends), [end.message for end in ends]
            between = np.array([ends[0].u_px - ends[1].u_px, ends[0].v_px - ends[1].v_px])
            slopes[seed, :, column] = between * assembly.detector.pitch / (2 * STEP[dof])
    mean, error = slopes.mean(axis=0), slopes.std(axis=0, ddof=1) / np.sqrt(surfaces)
    theirs = np.array([expected["u"], expected["v"]])
    assert np.all(np.abs(mean - theirs) <= np.maximum(RELATIVE * np.abs(theirs), STANDARD_ERRORS * error)), (mean, theirs)
    # It would tell the same beam without astigmatism from this one.
    assert np.any(np.abs(mean - np.array([other["u"], other["v"]])) > 20 * error)


DECORRELATION_ERROR = 0.01


def test_pattern_decorrelates_faster_along_the_narrow_axis(assemble):
    """Peak correlation exp(-a^2/w^2), w the beam's radius along the motion."""
    text = scene(
        {"beam_radius_x": 0.3, "beam_radius_y": 0.6}, to_laser=direction(0), target={"point_sources": 800},
        detector={"width": 400, "height": 400, "pixel_pitch": 0.012}, integrator={"method": "fast", "tolerance": 1e-3},
    )
    assembly, surfaces = assemble(text), 6
    moves = (("x", 0.15), ("y", 0.15), ("y", 0.35))
    measured = np.empty((surfaces, len(moves)))
    for seed in range(surfaces):
        surface = assembly.with_seed(seed)
        correlator = Correlator(simulate(surface).intensity, window=288)
        measured[seed] = [correlator.shift(simulate(surface, Pose(**{dof: a})).intensity).ncc for dof, a in moves]
    expected = np.array([expected_correlation(assembly, dof, np.array([a]))[0] for dof, a in moves])
    radius = {"x": 0.3, "y": 0.6}
    np.testing.assert_allclose(expected, [np.exp(-((a / radius[dof]) ** 2)) for dof, a in moves], rtol=1e-12)
    error = measured.std(axis=0, ddof=1) / np.sqrt(surfaces)
    assert error.max() < DECORRELATION_ERROR / 2, error
    np.testing.assert_allclose(measured.mean(axis=0), expected, atol=DECORRELATION_ERROR)


def test_diode_triangulation_reads_height_by_the_image_of_its_line(shipped):
    assembly = shipped("diode_triangulation")
    expected = expected_sensitivity(assembly)
    # M sin(a), of a lens that images in its own size: its thickness and aberrations leave a hundredth.
    assert abs(expected["cog_u"][2]) == pytest.approx(np.sin(np.radians(35)), rel=0.02)
    frame = simulate_frame(shipped("diode_triangulation", width=64, height=64, pixel_pitch=0.02))
    image = frame.image.intensity.astype(np.float64)
    place = np.arange(64) * 0.02
    sizes = []
    for axis in (0, 1):
        profile = image.sum(axis=axis)
        # Of a Gaussian of radius w half the light lies within 0.6745 w/2; an Airy pattern's tails do not count so.
        low, high = np.interp([0.25, 0.75], np.cumsum(profile) / profile.sum(), place)
        sizes.append((high - low) / 0.6745)
    # Radii of the image: the footprint, foreshortened along u, and speckled.
    assert sizes[0] == pytest.approx(0.08 * np.cos(np.radians(35)), rel=0.25)
    assert sizes[1] == pytest.approx(0.32, rel=0.2)
