"""Closed formulas against published and independent numbers, and against moving the geometry."""

from __future__ import annotations

import json
from pathlib import Path

import mpmath
import numpy as np
import pytest

from speckle_mi import theory
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation
from speckle_mi.geometry.rotation import rotation_matrix

REFERENCE = Path(__file__).parent / "reference"
FIRST_ORDER = json.loads((REFERENCE / "first_order.json").read_text())["cases"]
PAPER = json.loads((REFERENCE / "paper.json").read_text())

REFERENCE_ERROR = 1e-9  # The reference has 40 digits; the linear algebra keeps about 1e-15, scale 2.
PRINTED_DIGITS = 6e-3  # Half a unit of the second decimal, to which the paper rounds.
CUT_DIGITS = 1e-2  # Table 1 cuts the second decimal: 0.94 for 0.946, 0.83 for 0.837.
MOTION_ERROR = 1e-9  # Central differences over 1e-6 in 40 digits leave 1e-12 relative.
QUADRATIC = 1e-7  # Moving by 1e-4 either way in float64: second order cancels, third leaves 1e-8, rounding 1e-11.
WAVELENGTH = 632.8e-6


def assembly(case):
    """Arguments of first_order_displacement for one case of the reference."""
    radius = np.inf if case["Ls"] is None else case["Ls"]
    vectors = [np.array(case[name]) for name in ("detector_centre", "detector_axis_X", "detector_axis_Y")]
    return np.zeros(3), np.zeros(3), np.eye(3), np.array(case["source_direction"]), radius, *vectors


def tilted(laser_deg, detector_deg, laser_radius=-750.0, distance=60.0):
    """Arguments for laser and detector in the xz plane at angles from the normal, detector facing the spot."""
    laser, sight = np.radians(laser_deg), np.radians(detector_deg)
    direction = np.array([np.sin(sight), 0, np.cos(sight)])
    u, v = np.array([np.cos(sight), 0, -np.sin(sight)]), np.array([0.0, 1, 0])
    source = np.array([np.sin(laser), 0, np.cos(laser)])
    return np.zeros(3), np.zeros(3), np.eye(3), source, laser_radius, distance * direction, u, v


def random_unit(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def skew_assembly(seed):
    """A geometry without any symmetry: spot off the origin, tilted axes, normal, laser and detector, finite radius."""
    rng = np.random.default_rng(seed)
    axes = rotation_matrix(rng.normal(size=3))
    normal = axes @ rotation_matrix(0.4 * rng.normal(size=3))[:, 2]
    above = [direction * np.sign(direction @ normal) for direction in (random_unit(rng), random_unit(rng))]
    source, sight = [(0.5 * normal + d) / np.linalg.norm(0.5 * normal + d) for d in above]
    origin = 10 * rng.normal(size=3)
    spot = origin + 3 * rng.normal(size=3)
    plane = rotation_matrix(0.5 * rng.normal(size=3))
    facing = np.linalg.svd(sight[None])[2][1:]
    u, v = plane @ facing[0], plane @ facing[1]
    radius = float(rng.choice([-1, 1]) * rng.uniform(30, 200))
    return {
        "spot": spot,
        "origin": origin,
        "axes": axes,
        "source_direction": source,
        "wavefront_radius": radius,
        "detector_centre": spot + rng.uniform(30, 90) * sight,
        "u": u,
        "v": v,
        "normal": normal,
    }


def moved_geometry_displacement(geometry, dof, side=1):
    """Displacement per unit motion found by moving the target: only optical path lengths, 40 digits, no formula.

    The displacement is where the path change of the moved scatterers is stationary over the surface at the spot.
    side: 1 for a detector in front of the surface, -1 for a plane behind it that a lens images: the path through the
    scatterer to the image is then shorter by the scatterer's distance from that plane's point.
    """
    mp = mpmath.mp.clone()
    mp.dps = 40
    vector = lambda values: mp.matrix([mp.mpf(float(x)) for x in values])  # noqa: E731
    spot, origin, source = (vector(geometry[name]) for name in ("spot", "origin", "source_direction"))
    detector, u, v = (vector(geometry[name]) for name in ("detector_centre", "u", "v"))
    tangents = [vector(t) for t in np.linalg.svd(geometry["normal"][None])[2][1:]]
    radius = mp.mpf(geometry["wavefront_radius"])
    laser = spot + radius * source
    index = DEGREES_OF_FREEDOM.index(dof)
    axis = vector(geometry["axes"][:, index % 3])
    cross = mp.matrix([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])

    def move(point, amount):
        if not is_rotation(dof):
            return point + amount * axis
        rotation = mp.eye(3) + mp.sin(amount) * cross + (1 - mp.cos(amount)) * (cross * cross)
        return origin + rotation * (point - origin)

    def path(point, pixel):
        return mp.sign(radius) * mp.norm(point - laser) + side * mp.norm(point - pixel)

    step = mp.mpf(10) ** -10

    def slope(amount, shift):
        pixel = detector + shift[0] * u + shift[1] * v
        change = lambda p: path(move(p, amount), pixel) - path(p, detector)  # noqa: E731
        return mp.matrix([(change(spot + step * t) - change(spot - step * t)) / (2 * step) for t in tangents])

    def displacement(amount):
        shift = mp.matrix(2, 1)
        for _ in range(4):
            here = slope(amount, shift)
            h = mp.mpf(10) ** -10
            columns = [(slope(amount, shift + h * mp.matrix(e)) - here) / h for e in ([1, 0], [0, 1])]
            jacobian = mp.matrix([[columns[0][0], columns[1][0]], [columns[0][1], columns[1][1]]])
            shift = shift - mp.lu_solve(jacobian, here)
        return shift

    amount = mp.mpf(10) ** -6
    difference = (displacement(amount) - displacement(-amount)) / (2 * amount)
    return np.array([float(difference[0]), float(difference[1])])


@pytest.mark.parametrize("case", FIRST_ORDER, ids=lambda c: f"{c['geometry']}-{c['illumination']}")
def test_displacement_agrees_with_the_forty_digit_reference(case):
    matrix = theory.per_degree(theory.first_order_displacement(*assembly(case)))
    np.testing.assert_allclose(matrix, case["matrix_2x6"], rtol=0, atol=REFERENCE_ERROR)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("dof", DEGREES_OF_FREEDOM)
def test_displacement_is_where_the_path_change_of_the_moved_skew_geometry_is_stationary(seed, dof):
    geometry = skew_assembly(seed)
    column = theory.first_order_displacement(**geometry)[:, DEGREES_OF_FREEDOM.index(dof)]
    moved = moved_geometry_displacement(geometry, dof)
    np.testing.assert_allclose(column, moved, rtol=MOTION_ERROR, atol=MOTION_ERROR)


def paper_equations(l, l_s, distance, radius):  # noqa: E741
    """(2, 6) A_zeta, A_eta by Eqs. (1) and (2) of Opt. Eng. 61(6) 061410; sensitivities are printed negated.

    Misprints corrected: the L_O L_O/(L_S L_S) of Eq. (2) is L_O/L_S, dimensions and symmetry with Eq. (1) demand it;
    -Omega_y[-L_O(..)] of Eq. (1) keeps its sign, -Omega_x[-L_O(..)] of Eq. (2) has the sign of a left-handed rotation.
    """
    ratio = distance / radius
    zeta = [-(ratio * (l_s[0] ** 2 - 1) + l[0] ** 2 - 1), -(ratio * l_s[0] * l_s[1] + l[0] * l[1])]
    zeta += [-(ratio * l_s[0] * l_s[2] + l[0] * l[2]), 0, distance * (l_s[2] + l[2]), -distance * (l_s[1] + l[1])]
    eta = [-(ratio * l_s[0] * l_s[1] + l[0] * l[1]), -(ratio * (l_s[1] ** 2 - 1) + l[1] ** 2 - 1)]
    eta += [-(ratio * l_s[1] * l_s[2] + l[1] * l[2]), -distance * (l_s[2] + l[2]), 0, distance * (l_s[0] + l[0])]
    return np.array([zeta, eta])


@pytest.mark.parametrize("seed", range(5))
def test_equations_of_the_paper_are_the_projection_of_a_detector_that_faces_the_spot(seed):
    rng = np.random.default_rng(seed)
    axes = np.eye(3)
    sight, source = (d * np.sign(d[2]) for d in (random_unit(rng), random_unit(rng)))
    u, v = np.linalg.svd(sight[None])[2][1:]
    matrix = theory.first_order_displacement(np.zeros(3), np.zeros(3), axes, source, -80.0, 60 * sight, u, v)
    expected = paper_equations(sight, source, 60.0, -80.0)
    np.testing.assert_allclose(theory.project_on_target(matrix, u, v, axes), expected, atol=1e-11)


@pytest.mark.parametrize(
    ("name", "laser", "detector"),
    [("tilted_laser", -35, 0), ("tilted_detector", 0, 35), ("both_tilted", -17.5, 17.5)],
)
def test_tables_of_the_paper_follow_from_a_wavefront_radius_of_minus_750_mm(name, laser, detector):
    arguments = tilted(laser, detector)
    matrix = theory.per_degree(theory.first_order_displacement(*arguments))
    on_target = theory.project_on_target(matrix, *arguments[6:8], arguments[2])
    table = PAPER["table1_sensitivity_translation_mm_per_mm"][name]
    for key, value in (("kx", on_target[0, 0]), ("ky", on_target[1, 1]), ("kz", on_target[0, 2])):
        assert abs(abs(value) - table[key]) < CUT_DIGITS, key
    table = PAPER["table2_sensitivity_rotation_mm_per_deg"][name]
    assert abs(abs(on_target[1, 3]) - table["kx"]) < PRINTED_DIGITS
    assert abs(abs(on_target[0, 4]) - table["ky"]) < PRINTED_DIGITS
    if name != "both_tilted":  # Its printed k_z belongs to laser and detector on the same side.
        assert abs(abs(on_target[1, 5]) - table["kz"]) < PRINTED_DIGITS


def test_in_plane_rotation_moves_the_pattern_with_laser_and_detector_on_the_same_side_only():
    opposite = theory.per_degree(theory.first_order_displacement(*tilted(-17.5, 17.5)))
    same = theory.per_degree(theory.first_order_displacement(*tilted(17.5, 17.5)))
    assert abs(opposite[1, 5]) < 1e-12
    assert abs(same[1, 5] - PAPER["table2_sensitivity_rotation_mm_per_deg"]["both_tilted"]["kz"]) < PRINTED_DIGITS


def test_tilted_detector_measures_the_projected_displacement_over_the_cosine():
    arguments = tilted(0, 35)
    matrix = theory.first_order_displacement(*arguments)
    on_target = theory.project_on_target(matrix, *arguments[6:8], arguments[2])
    np.testing.assert_allclose(matrix[0] * np.cos(np.radians(35)), on_target[0], atol=1e-12)
    np.testing.assert_allclose([matrix[0, 0], theory.per_degree(matrix)[0, 4]], [0.7215, 2.3256], atol=1e-4)


def test_grazing_detection_and_bad_vectors_are_refused_by_name():
    spot, origin, axes, source, radius, centre, u, v = tilted(-35, 0)
    build = theory.first_order_displacement
    with pytest.raises(ValueError, match="grazing detection.*target plane"):
        build(spot, origin, axes, source, radius, np.array([60.0, 0, 0]), v, np.array([0.0, 0, 1]))
    with pytest.raises(ValueError, match="grazing detection.*detector plane"):
        build(spot, origin, axes, source, radius, centre, u, np.array([0.0, 0, 1]))
    with pytest.raises(ValueError, match="source_direction.*unit vector"):
        build(spot, origin, axes, 2 * source, radius, centre, u, v)
    with pytest.raises(ValueError, match="wavefront_radius = 0"):
        build(spot, origin, axes, source, 0.0, centre, u, v)
    with pytest.raises(ValueError, match="right angles"):
        build(spot, origin, axes, source, radius, centre, u, (u + v) / np.sqrt(2))
    with pytest.raises(ValueError, match="detector_centre.*apart"):
        build(spot, origin, axes, source, radius, spot, u, v)


def imaged(geometry, defocus, magnification=1.0):
    sight = geometry["detector_centre"] - geometry["spot"]
    names = ("spot", "origin", "axes", "source_direction", "wavefront_radius")
    values = [geometry[name] for name in names]
    sight /= np.linalg.norm(sight)
    return theory.imaging_displacement(
        *values, sight, geometry["u"], geometry["v"], magnification, defocus, geometry["normal"]
    )


def test_in_focus_image_moves_by_magnification_times_the_motion_across_the_line_of_sight():
    spot, origin, axes, source, radius, _, u, v = tilted(-35, 0)
    matrix = theory.imaging_displacement(spot, origin, axes, source, radius, np.array([0.0, 0, 1]), u, v, -0.5)
    expected = np.zeros((2, 6))
    expected[0, 0] = expected[1, 1] = -0.5
    np.testing.assert_allclose(matrix, expected, atol=1e-15)


@pytest.mark.parametrize("seed", range(3))
def test_defocused_image_moves_as_the_free_space_pattern_at_the_defocus_times_the_magnification(seed):
    geometry = skew_assembly(seed)
    distance = np.linalg.norm(geometry["detector_centre"] - geometry["spot"])
    magnification = np.array([[0.3, -0.1], [0.2, 1.7]])
    free = theory.first_order_displacement(**geometry)
    np.testing.assert_allclose(imaged(geometry, distance, magnification), magnification @ free, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("defocus", [0.5, -0.5])
@pytest.mark.parametrize("dof", DEGREES_OF_FREEDOM)
def test_image_of_a_plane_before_or_behind_the_surface_is_where_the_path_change_is_stationary(defocus, dof):
    geometry = skew_assembly(1)
    expected = imaged(geometry, defocus)[:, DEGREES_OF_FREEDOM.index(dof)]
    sight = geometry["detector_centre"] - geometry["spot"]
    geometry["detector_centre"] = geometry["spot"] + defocus * sight / np.linalg.norm(sight)
    moved = moved_geometry_displacement(geometry, dof, side=int(np.sign(defocus)))
    np.testing.assert_allclose(expected, moved, rtol=MOTION_ERROR, atol=MOTION_ERROR)


@pytest.mark.parametrize("seed", range(3))
def test_displacement_is_linear_in_the_defocus_through_focus(seed):
    geometry = skew_assembly(seed)
    behind, focus, before = (imaged(geometry, defocus) for defocus in (-0.01, 0.0, 0.01))
    np.testing.assert_allclose((behind + before) / 2, focus, atol=1e-11)


def test_image_in_focus_ignores_tilt_about_the_spot_and_the_illumination():
    geometry = skew_assembly(0)
    geometry["origin"] = geometry["spot"]
    focus = imaged(geometry, 0.0)
    np.testing.assert_allclose(focus[:, 3:], 0, atol=1e-14)
    geometry["wavefront_radius"] = 5.0
    np.testing.assert_allclose(imaged(geometry, 0.0), focus, atol=1e-14)


def triangulated(geometry, frame):
    """Place (u, v) of the spot's central projection when the surface's tangent plane has moved to ``frame``."""
    normal, point = frame.axes[:, 2], frame.origin
    source, aperture = geometry["source_direction"], geometry["aperture_centre"]
    spot = geometry["spot"] + source * (normal @ (point - geometry["spot"])) / (normal @ source)
    facing = np.cross(geometry["u"], geometry["v"])
    ray = aperture - spot
    image = spot + ray * (facing @ (geometry["detector_centre"] - spot)) / (facing @ ray)
    return np.array([geometry["u"] @ image, geometry["v"] @ image])


@pytest.mark.parametrize("seed", range(4))
def test_centre_of_gravity_follows_the_projected_spot_on_the_moved_surface(seed):
    geometry = skew_assembly(seed)
    rng = np.random.default_rng(100 + seed)
    del geometry["wavefront_radius"]
    axes, normal, origin = geometry["axes"], geometry["normal"], geometry["origin"]
    sight = geometry["detector_centre"] - geometry["spot"]
    geometry["aperture_centre"] = geometry["spot"] + 0.6 * sight + rng.normal(size=3)
    matrix = theory.centre_of_gravity_aperture(**geometry)
    tangent = np.linalg.svd(normal[None])[2]
    surface = Frame(geometry["spot"], np.column_stack([tangent[1], tangent[2], normal]))
    step = 1e-4
    for index, dof in enumerate(DEGREES_OF_FREEDOM):
        places = []
        for amount in (step, -step):
            vector = amount * axes[:, index % 3]
            if is_rotation(dof):
                turn = rotation_matrix(vector)
                surface_moved = Frame(origin + turn @ (surface.origin - origin), turn @ surface.axes)
            else:
                surface_moved = Frame(surface.origin + vector, surface.axes)
            places.append(triangulated(geometry, surface_moved))
        moved = (places[0] - places[1]) / (2 * step)
        np.testing.assert_allclose(matrix[:, index], moved, rtol=QUADRATIC, atol=QUADRATIC)


def test_integrated_sensor_of_the_paper_sees_out_of_plane_motion_with_0_67():
    theta = np.radians(39)
    source = np.array([-np.sin(theta), 0, np.cos(theta)])
    x, y = np.eye(3)[:2]
    at = np.array([[0, 0, 41.0], [0, 0, 75.0]])
    matrix = theory.centre_of_gravity_aperture(np.zeros(3), np.zeros(3), np.eye(3), source, *at, x, y)
    expected = np.zeros((2, 6))
    expected[0, 2] = np.tan(theta) * (75 - 41) / 41
    np.testing.assert_allclose(matrix, expected, atol=1e-14)
    assert abs(matrix[0, 2] - PAPER["integrated_sensor"]["cog_sensitivity"]) < PRINTED_DIGITS
    with pytest.raises(ValueError, match="aperture_centre.*between"):
        theory.centre_of_gravity_aperture(np.zeros(3), np.zeros(3), np.eye(3), source, at[1], at[0], x, y)


def test_material_moves_across_a_tilted_beam_by_the_sine_or_cosine_of_its_angle():
    theta = np.radians(35)
    source = np.array([np.sin(theta), 0, np.cos(theta)])
    moved = lambda text: np.linalg.norm(  # noqa: E731
        theory.beam_displacement_of_material(Pose.parse(text), np.zeros(3), np.zeros(3), np.eye(3), source)
    )
    across = [moved("x=0.1"), moved("y=0.1"), moved("z=0.1")]
    np.testing.assert_allclose(across, 0.1 * np.array([np.cos(theta), 1, np.sin(theta)]))
    assert moved("rx=1,ry=2,rz=3") == 0
    lever = theory.beam_displacement_of_material(
        Pose(rz=90), np.array([2.0, 0, 0]), np.zeros(3), np.eye(3), np.array([0.0, 0, 1])
    )
    np.testing.assert_allclose(lever, [-2, 2, 0], atol=1e-12)


def gaussian_average(phase, beam_radius, points=160):
    """|<exp(i phase)>|^2 over a Gaussian spot by Gauss-Legendre quadrature in x and y."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    x = 3.5 * beam_radius * nodes
    density = np.exp(-2 * (x[:, None] ** 2 + x**2) / beam_radius**2) * weights[:, None] * weights
    return abs(np.sum(density * np.exp(1j * phase(x[:, None], x[None]))) / density.sum()) ** 2


def test_axial_decorrelation_is_the_average_of_the_path_change_over_the_spot():
    w, motion, detector, laser = 0.6, 1.5, 60.0, 50.0
    quadratic = np.pi / WAVELENGTH * motion * (1 / detector**2 + 1 / laser**2)
    exact = gaussian_average(lambda x, y: quadratic * (x**2 + y**2), w)
    value = theory.decorrelation_axial(motion, w, WAVELENGTH, detector, laser)
    cut_at_three_and_a_half_radii = 1e-9
    assert 0.2 < value < 0.8
    assert abs(value - exact) < cut_at_three_and_a_half_radii
    assert theory.decorrelation_axial(motion, w, WAVELENGTH, detector, np.inf) > value


def test_in_plane_decorrelation_is_the_overlap_of_the_shifted_beam():
    x = np.linspace(-8, 8, 4001)
    amplitude = lambda shift: np.exp(-((x - shift) ** 2))  # noqa: E731
    overlap = np.sum(amplitude(0) * amplitude(0.7)) / np.sum(amplitude(0) ** 2)
    np.testing.assert_allclose(theory.decorrelation_in_plane(0.7, 1.0), overlap**2, rtol=1e-12)
    assert theory.decorrelation_in_plane(0.1, 0.12) < PAPER["simulated"]["tilted_laser"]["correlation_at_100um_below"]


def test_circular_pupil_decorrelates_by_the_overlap_of_two_discs():
    grid = (np.arange(2000) + 0.5) / 1000 - 1
    x, y = grid[:, None], grid[None]
    s = 0.4
    both = np.mean((x**2 + y**2 < 1) & ((x - 2 * s) ** 2 + y**2 < 1)) / np.mean(x**2 + y**2 < 1)
    pixels_of_the_rim = 1e-3
    assert abs(theory.decorrelation_circular_pupil(s) - both**2) < pixels_of_the_rim
    np.testing.assert_array_equal(theory.decorrelation_circular_pupil([0.0, 1.0, 7.0, -1.0]), [1, 0, 0, 0])


def test_contrast_of_equal_phasors_agrees_with_their_random_sums():
    rng = np.random.default_rng(0)
    intensity = abs(np.exp(2j * np.pi * rng.random((200_000, 4))).sum(axis=1)) ** 2
    sampling_error = 0.005  # Two hundred thousand draws leave about 0.001.
    assert abs(intensity.std() / intensity.mean() - theory.contrast_of_equal_phasors(4)) < sampling_error
    assert theory.contrast_of_equal_phasors(1) == 0
    with pytest.raises(ValueError, match="1 or more"):
        theory.contrast_of_equal_phasors(0)


def test_intensity_density_integrates_to_one_and_has_its_mean():
    intensity = np.linspace(-10, 200, 210_001)
    density = theory.intensity_pdf(intensity, 3.0)
    step_of_the_sum = 1e-3
    assert abs(np.trapezoid(density, intensity) - 1) < step_of_the_sum
    assert abs(np.trapezoid(intensity * density, intensity) - 3) < step_of_the_sum
    assert theory.intensity_pdf(-1.0) == 0


def test_speckle_shape_of_aligned_parts_is_the_coherence_of_a_gaussian_spot():
    z, x, y = np.eye(3)[[2, 0, 1]]
    shape = theory.speckle_shape_gaussian_beam(0.3, WAVELENGTH, np.zeros(3), z, z, 60 * z, x, y)
    separation = 0.05
    value = theory.coherence_gaussian_beam(separation, 0.3, WAVELENGTH, 60.0)
    np.testing.assert_allclose(np.exp(-shape[0, 0] * separation**2), value, rtol=1e-12)
    size = theory.speckle_size_gaussian_beam(0.3, WAVELENGTH, np.zeros(3), z, z, 60 * z, x, y)
    np.testing.assert_allclose(size, 2 * np.sqrt(np.log(2)) * WAVELENGTH * 60 / (np.pi * 0.3))
    np.testing.assert_allclose(theory.coherence_gaussian_beam(size / 2, 0.3, WAVELENGTH, 60.0), 0.5)


@pytest.mark.parametrize("seed", range(4))
def test_speckle_shape_of_a_skew_assembly_is_the_sum_over_scatterers_in_the_beam(seed):
    geometry = skew_assembly(seed)
    rng = np.random.default_rng(seed)
    spot, source, normal = geometry["spot"], geometry["source_direction"], geometry["normal"]
    centre, u, v = geometry["detector_centre"], geometry["u"], geometry["v"]
    w = 0.1
    shape = theory.speckle_shape_gaussian_beam(w, WAVELENGTH, spot, normal, source, centre, u, v)
    tangents = np.linalg.svd(normal[None])[2][1:]
    extent = 3 * w / abs(normal @ source)
    a = np.linspace(-extent, extent, 401)
    points = (a[:, None, None] * tangents[0] + a[None, :, None] * tangents[1]).reshape(-1, 3)
    intensity = np.exp(-2 * (np.sum(points**2, axis=1) - (points @ source) ** 2) / w**2)
    for _ in range(3):
        d = rng.normal(size=2)
        d *= np.sqrt(0.7 / (d @ shape @ d))
        to = [centre + sign * 0.5 * (d[0] * u + d[1] * v) - spot for sign in (1, -1)]
        path = [np.linalg.norm(points - t, axis=1) for t in to]
        exact = abs(np.sum(intensity * np.exp(2j * np.pi / WAVELENGTH * (path[0] - path[1]))) / intensity.sum()) ** 2
        spot_over_distance = 2e-3  # The path is expanded to first order in w/z, about 1e-3 here.
        assert abs(np.exp(-d @ shape @ d) - exact) < spot_over_distance


def test_shift_scatter_grows_with_lost_correlation_and_is_unlimited_without_any():
    scatter = theory.shift_scatter(4.0, 64, [1.0, 0.5, 0.0, -0.1])
    np.testing.assert_allclose(scatter, [0, 0.6 * 16 / 64, np.inf, np.inf])
