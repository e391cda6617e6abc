"""Images of points and of rough surfaces: point spread, shifts, decorrelation and the integrated sensor."""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import bench, diffracted, disc_nodes, element_xml, fermat, lens_surfaces, thin_lens_start
from scene_builder import detector_frame, direction

from speckle_mi import theory
from speckle_mi.measurement.correlator import Correlator
from speckle_mi.measurement.speckle_statistics import centre_of_gravity, contrast
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.theory.paraxial import entrance_pupil, system_matrix
from speckle_mi.measurement.sensitivity import fit_sensitivity
from speckle_mi.field.resolution import scatterers_in_cell
from speckle_mi.field.simulation import Simulation, simulate, simulate_frame

WAVELENGTH = 632.8e-6
K = 2 * np.pi / WAVELENGTH
INDEX = 1.5151
LENS_Z, STOP_Z, STOP, PARAXIAL, FOCUS = 97.0685, 103.0, 2.0, 199.1371, 198.8947  # As in scenes/imaging.xml.

POINT_IMAGE = 1e-3  # Of the peak irradiance: the promise.
FIRST_MINIMUM = 2e-3  # Relative, of the first dark ring's radius: the promise.


# Image of a point


def point_image(assemble, tmp_path, source, detector_z, centre, pixels, pitch, diffraction=True):
    """(assembly, field (n,) of a unit source) around ``centre`` (2,) on the detector."""
    form = dict(radius1=50.0, radius2=-50.0, thickness=5.0, diameter=20.0, ior=INDEX)
    lens = element_xml("lens", "lens", Frame(np.array([0.0, 0, LENS_Z]), np.eye(3)), **form)
    stop = element_xml("aperture", "stop", Frame(np.array([0.0, 0, STOP_Z]), np.eye(3)), radius=STOP, outer_radius=15.0)
    frame = detector_frame(direction(0), detector_z)
    frame = Frame(frame.origin + [*centre, 0.0], frame.axes)
    text = bench(
        tmp_path, source, frame, [stop, lens], pixels=pixels, pitch=pitch, tolerance=1e-5, diffraction=diffraction
    )
    assembly = assemble(text)
    made = simulate_frame(assembly)
    return assembly, made.image.field.ravel() / made.scatterers.amplitude[0]


def huygens(source, targets, rings=60, spokes=160):
    """Field (m,) of a unit source: Fermat's paths and Van Vleck's amplitudes to the stop, a plain sum from there."""
    x, y, weight = disc_nodes(STOP, rings, spokes)
    pupil = np.stack([x, y, np.full_like(x, STOP_Z)], axis=1)
    surfaces = lens_surfaces([0, 0, LENS_Z], np.eye(3), 50.0, -50.0, 5.0, INDEX)
    length, amplitude = fermat(source, surfaces, pupil, thin_lens_start(source, pupil, surfaces, 49.37))
    return diffracted(pupil, amplitude * np.exp(1j * K * length) * weight, np.array([0.0, 0, 1]), targets, WAVELENGTH)


@pytest.mark.parametrize("defocus", [0.0, 2.0, -2.0])
@pytest.mark.parametrize("off_axis", [0.0, 0.5])
def test_image_of_a_point_is_the_huygens_sum_over_the_stop(assemble, tmp_path, defocus, off_axis):
    source = np.array([0.6 * off_axis, 0.8 * off_axis, 0.0])
    detector_z = PARAXIAL + defocus
    centre = -source[:2] * (1 + 0.01 * defocus)
    assembly, field = point_image(assemble, tmp_path, source, detector_z, centre, (27, 25), 0.005)
    targets = assembly.detector.points()
    exact = huygens(source, targets)
    assert np.max(np.abs(huygens(source, targets[::40], 90, 240) - exact[::40])) <= 1e-7 * np.abs(exact).max()
    peak = np.max(np.abs(exact) ** 2)
    assert np.max(np.abs(np.abs(field) ** 2 - np.abs(exact) ** 2)) <= POINT_IMAGE * peak
    assert np.max(np.abs(field - exact)) <= POINT_IMAGE * np.sqrt(peak)
    assert 0.02 * peak > np.abs(exact[0]) ** 2, "the detector should reach into the dark"


def first_minimum(radius, irradiance):
    """Radius of the first local minimum of (n,) samples, from a parabola."""
    k = next(k for k in range(1, len(irradiance) - 1) if irradiance[k - 1] > irradiance[k] <= irradiance[k + 1])
    a, b, c = irradiance[k - 1 : k + 2]
    return radius[k] + (radius[1] - radius[0]) * 0.5 * (a - c) / (a - 2 * b + c)


def test_first_dark_ring_of_a_point_is_the_aberrated_ones_and_near_airys(assemble, tmp_path):
    assembly, field = point_image(assemble, tmp_path, np.zeros(3), PARAXIAL, (0.015, 0.0), (121, 1), 0.00025)
    targets = assembly.detector.points()
    measured = first_minimum(targets[:, 0], np.abs(field) ** 2)
    reference = first_minimum(targets[:, 0], np.abs(huygens(np.zeros(3), targets)) ** 2)
    assert measured == pytest.approx(reference, rel=FIRST_MINIMUM)
    airy = 1.21967 * WAVELENGTH * (PARAXIAL - STOP_Z) / (2 * STOP)
    assert reference == pytest.approx(airy, rel=0.05)  # Spherical aberration of a quarter wave narrows it by 1 %.


# Imaged speckle

STEPS = 128  # Pixels a side: the spot's image fills it.
SEEDS = range(4)


def imaging(shipped, name="imaging", **values):
    return shipped(name, **({"width": STEPS, "height": STEPS, "beam_radius": 0.15, "point_sources": 400} | values))


def shifts(assembly, poses, seeds=SEEDS, window=None):
    """((seeds, poses, 2) shift [mm] along u, v; (seeds, poses) correlation)."""
    found, peaks = [], []
    for seed in seeds:
        surface = assembly.with_seed(seed)
        correlator = Correlator(simulate(surface, Pose()).intensity, window)
        results = [correlator.shift(simulate(surface, pose).intensity) for pose in poses]
        found.append([[r.u_px, r.v_px] for r in results])
        peaks.append([r.ncc for r in results])
    return np.array(found) * assembly.detector.pitch, np.array(peaks)


def chief_ray_magnification(detector_z):
    """Of the plane through the detector, with the stop's middle as the centre of projection, by Fermat's principle."""
    surfaces = lens_surfaces([0, 0, LENS_Z], np.eye(3), 50.0, -50.0, 5.0, INDEX)
    source = np.array([0.01, 0.0, 0.0])
    pupil = np.array([[0.0, 0.0, STOP_Z], [1e-4, 0.0, STOP_Z], [-1e-4, 0.0, STOP_Z]])
    length, _ = fermat(source, surfaces, pupil, thin_lens_start(source, pupil, surfaces, 49.37))
    slope = (length[1] - length[2]) / 2e-4  # Direction cosine of the chief ray behind the stop.
    return slope / np.sqrt(1 - slope**2) * (detector_z - STOP_Z) / 0.01


TILT = 0.03  # Of the first-order shift out of focus.
MAGNIFICATION = 5e-3  # The promise for imaged speckle.


def test_in_plane_shift_of_an_image_is_the_magnification(shipped):
    poses = [Pose(x=0.02), Pose(x=-0.02), Pose(y=0.02), Pose(y=-0.02)]
    assembly = imaging(shipped)
    moved, peaks = shifts(assembly, poses)
    m = chief_ray_magnification(FOCUS)
    assert m == pytest.approx(-1, abs=0.01)
    u = assembly.detector.u[0] * (moved[:, 0, 0] - moved[:, 1, 0]) / 0.04
    v = assembly.detector.v[1] * (moved[:, 2, 1] - moved[:, 3, 1]) / 0.04
    for value in (u, v):
        error = value.std(ddof=1) / np.sqrt(len(value))
        assert error < MAGNIFICATION, "too few surfaces to tell"
        assert abs(value.mean() - m) <= MAGNIFICATION * abs(m), (value, m)
    assert peaks.min() > 0.8


def test_image_in_focus_does_not_move_with_tilt_and_out_of_focus_it_does_as_theory_says(shipped):
    poses = [Pose(ry=0.05), Pose(ry=-0.05), Pose(rx=0.05), Pose(rx=-0.05)]
    # A spot much wider than the blur: in a small one the still envelope of the light holds the pattern back.
    for defocus in (0.0, 5.0):
        assembly = imaging(shipped, "imaging_defocused", defocus=defocus, beam_radius=0.3, point_sources=1600)
        moved, _ = shifts(assembly, poses, range(3))
        measured = np.stack([moved[:, 0] - moved[:, 1], moved[:, 2] - moved[:, 3]], axis=1) / np.radians(0.1)  # ry, rx
        m = chief_ray_magnification(FOCUS + defocus)
        # The plane that is imaged on the detector instead of the target, by the longitudinal magnification of the pair.
        object_defocus = defocus / (m * chief_ray_magnification(FOCUS))
        beam, grid = assembly.beam, assembly.detector
        expected = theory.imaging_displacement(
            np.zeros(3),
            np.zeros(3),
            np.eye(3),
            -beam.axis,
            beam.wavefront_radii[0],
            np.array([0.0, 0, 1]),
            grid.u,
            grid.v,
            m,
            object_defocus,
        )[:, [4, 3]].T
        mean, spread = measured.mean(axis=0), measured.std(axis=0, ddof=1) / np.sqrt(len(measured))
        # First-order theory leaves out that the pupil cuts off other light after the tilt: some percent of the shift.
        allowed = TILT * np.abs(np.diag(expected)) + 3 * np.diag(spread) + 0.03
        assert np.all(np.abs(np.diag(mean - expected)) <= allowed), (defocus, mean, expected, spread)
        if defocus == 0:
            assert np.max(np.abs(mean)) < 0.25  # mm/rad, against 9 at 5 mm of defocus


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
def test_decorrelation_with_tilt_follows_the_overlap_of_pupils(shipped, share):
    # A tilt under light from straight above turns the pattern by twice its angle; the pupil is the stop's image.
    system = system_matrix([(1 / 50.0, 5.0, INDEX), (-1 / 50.0, STOP_Z - LENS_Z - 5.0, 1.0)])
    position, radius = entrance_pupil(system, STOP)
    tilt = np.degrees(share * 2 * radius / (LENS_Z + position) / 2)
    # In a spot much wider than what is looked at, or else the envelope of the light correlates as well.
    assembly = imaging(shipped, laser_angle=0, beam_radius=0.3, point_sources=1200, width=72, height=72)
    found = []
    for seed in range(8):
        surface = assembly.with_seed(seed)
        still, tilted = (simulate(surface, pose).intensity.ravel() for pose in (Pose(), Pose(ry=tilt)))
        # In focus the pattern stays where it is: its correlation there needs no search, which would find chance peaks.
        found.append(np.corrcoef(still, tilted)[0, 1])
    expected = theory.decorrelation_circular_pupil(share)
    error = np.std(found, ddof=1) / np.sqrt(len(found))
    assert abs(np.mean(found) - expected) <= 3 * error + 0.02, (np.mean(found), expected, error)


# Integrated sensor

COG = np.tan(np.radians(39)) * (75 - 41) / 41  # 0.6715
COG_TOLERANCE = 0.02  # The promise.


def test_light_of_a_point_that_slides_along_the_beam_moves_behind_the_aperture_as_triangulation_says(
    assemble, tmp_path
):
    hole = element_xml("aperture", "aperture", Frame(np.array([0.0, 0, 41.0]), np.eye(3)), radius=0.5)
    places = np.array([0.0, 0.025, 0.05])
    centres = []
    for z in places:
        source = np.array([-z * np.tan(np.radians(39)), 0.0, z])
        text = bench(tmp_path, source, detector_frame(direction(0), 75.0), [hole], pixels=(186, 120), pitch=0.024)
        assembly = assemble(text)
        centres.append(
            centre_of_gravity(simulate(assembly).intensity)[0] * assembly.detector.pitch * assembly.detector.u[0]
        )
    assert np.polyfit(places, centres, 1)[0] == pytest.approx(COG, rel=COG_TOLERANCE)


@pytest.mark.parametrize("sources", [80, 160])
def test_centre_of_gravity_of_the_integrated_sensor_moves_by_the_apertures_projection(shipped, sources):
    # Over 2 mm: the speckles in the lit disc throw its centre about by some 20 um, however far the target moves.
    z = np.array([-1.0, 1.0])
    assembly = shipped(
        "integrated_sensor", point_sources=sources, width=124, height=80, pixel_pitch=0.036, tolerance="1e-2"
    )
    to_um = 1e3 * assembly.detector.pitch * assembly.detector.u[0]
    places = [
        [centre_of_gravity(simulate(assembly.with_seed(seed), Pose(z=float(one))).intensity)[0] * to_um for one in z]
        for seed in range(12)
    ]
    found = fit_sensitivity(z, np.array(places) - np.mean(places, axis=1, keepdims=True))
    assert found.value == pytest.approx(COG, rel=COG_TOLERANCE)
    low, high = found.ci95
    assert low <= COG <= high and high - low <= 2 * COG_TOLERANCE * COG, found


@pytest.mark.parametrize("displacement, diffraction", [(0.01, "false"), (0.05, "true")])
def test_speckle_shift_of_the_integrated_sensor_is_the_tilted_lasers_at_its_distances(
    shipped, displacement, diffraction
):
    """With diffraction only motions of half a speckle and more: the aperture's rings stand still, which holds back
    smaller ones."""
    assembly = shipped(
        "integrated_sensor",
        width=186,
        height=120,
        pixel_pitch=0.024,
        point_sources=150,
        diffraction=diffraction,
    )
    beam, grid = assembly.beam, assembly.detector
    expected = theory.first_order_displacement(
        np.zeros(3), np.zeros(3), np.eye(3), -beam.axis, beam.wavefront_radii[0], grid.centre, grid.u, grid.v
    )
    a = displacement
    moved, _ = shifts(assembly, [Pose(x=a), Pose(x=-a), Pose(y=a), Pose(y=-a)], range(4), window=32)
    for plus, axis in ((0, 0), (2, 1)):
        value = (moved[:, plus, axis] - moved[:, plus + 1, axis]) / (2 * a)
        error = value.std(ddof=1) / np.sqrt(len(value))
        assert abs(value.mean() - expected[axis, axis]) <= 3 * error + 0.01, (value.mean(), expected[axis, axis], error)


def test_an_image_of_single_scatterers_is_warned_of_with_its_contrast(shipped):
    """Intensities of few scatterers at random in a resolution cell: contrast^2 = 1 + 1/N."""
    assembly = shipped("imaging", beam_radius=2.0, point_sources=1600, width=96, height=96)
    simulation = Simulation(assembly)
    count = scatterers_in_cell(simulation.setup(), simulation.plan().channels[0])
    frames = [simulation.frame(seed=seed) for seed in range(6)]
    found = np.mean([contrast(frame.image.intensity) for frame in frames])
    assert found == pytest.approx(np.sqrt(1 + 1 / count), rel=0.15)
    assert any("scatterers: the image is single points" in line for line in frames[0].warnings)
    enough = Simulation(shipped("imaging", point_sources=400, width=32, height=32)).frame()
    assert not any("single points" in line for line in enough.warnings)
