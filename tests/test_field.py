"""The field of a scene against a plain NumPy sum over the exported scatterers, and what can be seen in it."""

from __future__ import annotations

import numpy as np
import pytest
from scene_builder import (
    WORLD,
    detector_frame,
    detector_xml,
    direction,
    frame_along,
    free_space,
    integrator_xml,
    laser_xml,
    scene_of,
    target_xml,
)

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.plane import PlaneGrid
from speckle_mi.geometry.pose import Pose
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.field.sources import write_sources
from speckle_mi.field.simulation import simulate, simulate_frame

FIELD_ERROR = 1e-5  # Relative L2 error promised for the exact sum.
FILM_ROUNDING = 3e-7  # A film weights red, green and blue in single precision.
WAVELENGTH = 632.8e-6
TILT = rotation_matrix(np.radians([12.0, -20.0, 8.0]))


def relative_error(field, exact):
    return np.linalg.norm(field - exact) / np.linalg.norm(exact)


def sum_of_sources(path, shape):
    """The five lines with which anyone can check a field."""
    s = np.load(path)
    rows, columns = np.indices(shape)
    pixel = s["pixel_origin"] + s["pitch"] * (columns[..., None] * s["u"] + rows[..., None] * s["v"])
    r = np.linalg.norm(pixel[:, :, None] - s["position"], axis=-1)
    return (s["amplitude"] * np.exp(2j * np.pi / s["wavelength"] * r) / r).sum(axis=-1)


def check_against_sources(assembly, tmp_path, pose=Pose(), tolerance=FIELD_ERROR):
    frame = simulate_frame(assembly, pose)
    write_sources(tmp_path / "sources.npz", assembly, frame.scatterers, {})
    exact = sum_of_sources(tmp_path / "sources.npz", assembly.detector.shape)
    error = relative_error(frame.image.field, exact)
    assert frame.scatterers.count > 50 and error <= tolerance, (error, frame.plan)
    return frame, exact


GEOMETRIES = {
    "paraxial": (direction(0), direction(0), None),
    "skew": (direction(40, 190), direction(35, 50), TILT),
}


@pytest.mark.parametrize("wavefront_radius", [-750.0, 50.0, None])
@pytest.mark.parametrize("distance, pitch, point_sources", [(5.0, 0.02, 150), (60.0, 0.02, 150), (1e4, 0.4, 150)])
@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("method", ["direct", "auto"])
def test_field_is_the_coherent_sum_over_its_sources(
    assemble, tmp_path, geometry, distance, pitch, point_sources, wavefront_radius, method
):
    to_laser, sight, tilt = GEOMETRIES[geometry]
    text = free_space(
        to_laser, sight, tilt=tilt, detector_distance=distance, laser={"wavefront_radius": wavefront_radius},
        target={"point_sources": point_sources}, detector={"width": 80, "height": 60, "pixel_pitch": pitch},
        integrator={"method": method, "tolerance": FIELD_ERROR},
    )
    frame, _ = check_against_sources(assemble(text), tmp_path, Pose(x=0.03, ry=0.5, rz=1))
    assert frame.numerical_error <= FIELD_ERROR


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_auto_keeps_its_tolerance_on_a_detector_where_it_expands(assemble, tmp_path, geometry, tolerance):
    to_laser, sight, tilt = GEOMETRIES[geometry]
    text = free_space(
        to_laser, sight, tilt=tilt, target={"point_sources": 12}, integrator={"method": "fast", "tolerance": tolerance},
        detector={"width": 372, "height": 240, "pixel_pitch": 0.006},
    )
    frame, exact = check_against_sources(assemble(text), tmp_path, tolerance=tolerance)
    # Measured on a few tens of the pixels, and stated as a bound: not below the true one, and not far above it.
    true = relative_error(frame.image.field, exact)
    assert true <= frame.numerical_error < 3 * true + 1e-9


def test_field_ten_metres_away_from_a_laser_ten_metres_away(assemble, tmp_path):
    text = free_space(
        direction(35, 180),
        direction(20, 60),
        tilt=TILT,
        laser_distance=1e4,
        detector_distance=1e4,
        detector={"pixel_pitch": 0.5},
        target_frame=Frame(np.array([3e3, -5e3, 2e3]), rotation_matrix(np.array([0.5, 1, -2]))),
        integrator={"method": "direct"},
    )
    check_against_sources(assemble(text), tmp_path, Pose(z=0.1, rx=-0.3))


def test_the_paper_scene_is_exact(shipped, tmp_path):
    check_against_sources(shipped("both_tilted", method="direct", width=160, height=120), tmp_path, Pose(rz=0.1))


def test_field_of_the_users_points_is_their_sum(assemble, tmp_path):
    rng = np.random.default_rng(0)
    rows = np.column_stack([rng.uniform(-0.2, 0.2, (60, 2)), rng.uniform(-0.01, 0.01, 60), rng.normal(size=(60, 2))])
    path = tmp_path / "points.csv"
    np.savetxt(path, rows, delimiter=",", fmt="%.17g")
    text = free_space(direction(20), direction(30, 90), target={"points": str(path)}, integrator={"method": "direct"})
    check_against_sources(assemble(text), tmp_path)


# Pixels


@pytest.mark.parametrize("samples, side", [(4, 2), (9, 3), (10, 4)])
def test_intensity_is_the_mean_over_sub_pixels_and_the_field_stays_at_the_centre(assemble, tmp_path, samples, side):
    text = free_space(
        direction(20), direction(10, 30), tilt=TILT, detector_distance=20.0, target={"point_sources": 20},
        detector={"width": 40, "height": 30, "pixel_pitch": 0.03}, integrator={"method": "direct"},
    )
    assembly = assemble(text, spp=samples)
    frame, centre = check_against_sources(assembly, tmp_path)
    grid, offsets = assembly.detector, (np.arange(side) + 0.5) / side - 0.5
    s = np.load(tmp_path / "sources.npz")
    total = np.zeros(grid.shape)
    for a in offsets:
        for b in offsets:
            points = grid.points() + grid.pitch * (a * grid.u + b * grid.v)
            r = np.linalg.norm(points[:, None] - s["position"], axis=-1)
            field = (s["amplitude"] * np.exp(2j * np.pi / WAVELENGTH * r) / r).sum(axis=-1)
            total += np.abs(field.reshape(grid.shape)) ** 2
    expected = total / side**2
    assert relative_error(frame.image.intensity, expected) < 2 * FIELD_ERROR
    assert relative_error(np.abs(centre) ** 2, expected) > 0.05  # pixels are coarse enough for the mean to matter


def test_a_sampler_in_the_scene_asks_for_sub_pixels(assemble):
    for samples, side in ((1, 1), (4, 2), (16, 4)):
        assert assemble(free_space(detector={"samples": samples})).sub_pixels == side


def test_mitsuba_render_gives_the_simulated_image_in_named_channels(mitsuba, load, assemble):
    text = free_space(direction(20), direction(10, 30), detector={"width": 40, "height": 24})
    image = simulate(assemble(text))
    rendered = np.array(mitsuba.render(load(text)))
    assert rendered.shape == (24, 40, 3)
    np.testing.assert_allclose(rendered[..., 0], image.intensity, rtol=FILM_ROUNDING)
    np.testing.assert_array_equal(rendered[..., 1], image.field.real.astype(np.float32))
    np.testing.assert_array_equal(rendered[..., 2], image.field.imag.astype(np.float32))
    np.testing.assert_allclose(rendered[..., 0], rendered[..., 1] ** 2 + rendered[..., 2] ** 2, rtol=1e-5)
    scene = load(text)
    scene.integrator().render(scene)
    assert list(scene.sensors()[0].film().bitmap().struct_())[0].name in ("Y", "E.im")
    assert {channel.name for channel in scene.sensors()[0].film().bitmap().struct_()} == {"Y", "E.re", "E.im"}


def test_render_with_samples_averages_pixels(mitsuba, load, assemble):
    text = free_space(direction(20), direction(10, 30), detector_distance=20.0, detector={"pixel_pitch": 0.02})
    rendered = np.array(mitsuba.render(load(text), spp=4))
    np.testing.assert_allclose(rendered[..., 0], simulate(assemble(text, spp=4)).intensity, rtol=FILM_ROUNDING)


# What can be seen


@pytest.mark.parametrize("separation", [0.05, 0.2])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_two_scatterers_make_fringes_of_wavelength_times_distance_over_separation(assemble, tmp_path, separation, axis):
    half = separation / 2 * np.array([axis == "x", axis == "y"])
    path = tmp_path / "points.csv"
    path.write_text(f"{half[0]},{half[1]},0\n{-half[0]},{-half[1]},0\n")
    text = free_space(
        laser={"beam_radius": None, "wavefront_radius": None}, target={"points": str(path)},
        detector={"width": 500, "height": 500, "pixel_pitch": 0.005},
    )
    intensity = simulate(assemble(text)).intensity.astype(float)
    # The paths' difference at d from the middle is 2 d half/r to third order, d up to 1.25 mm of 60 mm: 1e-3.
    along, across = (intensity[250], intensity[:, 250]) if axis == "x" else (intensity[:, 250], intensity[250])
    place = (np.arange(500) - 249.5) * 0.005
    phase = 2 * np.pi * place * separation / (WAVELENGTH * 60)
    expected = 2 * (1 + np.cos(phase)) / 60**2
    np.testing.assert_allclose(along, expected, atol=4 / 60**2 * 0.03)
    assert np.ptp(across) < 0.01 * across.mean()


def converging_points(path, focus):
    """Scatterers with weights that make their spherical waves meet in ``focus`` (3,), under collimated normal light."""
    places = np.random.default_rng(0).uniform(-1.5, 1.5, (400, 2))
    points = np.column_stack([places, np.zeros(len(places))])
    r = np.linalg.norm(points - focus, axis=1)
    weights = np.exp(-2j * np.pi * r / WAVELENGTH)
    np.savetxt(path, np.column_stack([points, weights.real, weights.imag]), delimiter=",", fmt="%.17g")


DETECTORS = {
    "facing, upright": (direction(0), None),
    "tilted line of sight": (direction(35), None),
    "skew and tilted": (direction(25, 70), TILT),
    "rolled by 90 degrees": (direction(0), rotation_matrix(np.radians([0, 0, 90.0]))),
}


@pytest.mark.parametrize("name", DETECTORS)
def test_a_bright_point_in_the_world_shows_at_its_column_and_row(assemble, tmp_path, name):
    sight, tilt = DETECTORS[name]
    frame = detector_frame(sight, 60.0, tilt)
    # Independent of the code: columns run along local -x, rows along local -y, as documented.
    column, row, width, height, pitch = 95, 22, 121, 81, 0.01
    u, v = -frame.axes[:, 0], -frame.axes[:, 1]
    focus = frame.origin + pitch * ((column - 60) * u + (row - 40) * v)
    converging_points(tmp_path / "points.csv", focus)
    text = free_space(
        direction(0),
        sight,
        tilt=tilt,
        laser={"beam_radius": None, "wavefront_radius": None},
        target={"points": str(tmp_path / "points.csv")},
        detector={"width": width, "height": height, "pixel_pitch": pitch},
    )
    assembly = assemble(text)
    intensity = simulate(assembly).intensity
    assert np.unravel_index(np.argmax(intensity), intensity.shape) == (row, column)
    np.testing.assert_allclose(assembly.detector.u, u, atol=1e-12)
    np.testing.assert_allclose(assembly.detector.v, v, atol=1e-12)
    # Seen from behind the camera looking along local +z with +y up: right-handed image axes.
    np.testing.assert_allclose(np.cross(assembly.detector.u, assembly.detector.v), frame.axes[:, 2], atol=1e-12)


def test_shipped_detector_columns_run_along_x_and_rows_against_y(shipped, tmp_path):
    assembly = shipped("tilted_laser")
    np.testing.assert_allclose(assembly.detector.u, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(assembly.detector.v, [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(assembly.detector.centre, [0, 0, 60], atol=1e-9)
    assert isinstance(assembly.detector, PlaneGrid) and assembly.detector.shape == (480, 744)
    assert assembly.beam.origin[0] < 0  # the laser is on the -x side
    header = simulate(shipped("tilted_laser", width=16, height=16)).header
    np.testing.assert_allclose([header["u"], header["v"]], [[1, 0, 0], [0, -1, 0]], atol=1e-12)


# Lobe


def lobed(bsdf, sight=direction(0), to_laser=direction(30, 180), lobe=True):
    return scene_of(
        integrator_xml(method="direct"),
        laser_xml(frame_along(-to_laser, 50 * to_laser, np.array([1.0, 0, 0]))),
        target_xml(WORLD, bsdf if lobe else "", lobe=lobe),
        detector_xml(detector_frame(sight, 20.0), width=60, height=40, pixel_pitch=0.4),
    )


def test_lobe_of_a_diffuse_target_is_lamberts_cosine(assemble):
    bsdf = '<bsdf type="diffuse"><spectrum name="reflectance" value="0.4"/></bsdf>'
    pose = Pose(ry=10.0)
    even, shaped = (simulate(assemble(lobed(bsdf, lobe=lobe)), pose).field for lobe in (False, True))
    grid = assemble(lobed(bsdf)).detector
    directions = grid.points() / np.linalg.norm(grid.points(), axis=1, keepdims=True)
    normal = rotation_matrix(np.radians([0, 10.0, 0])) @ [0, 0, 1]
    expected = np.sqrt(0.4 / np.pi * (directions @ normal)).reshape(grid.shape)
    # The beam's middle stands for all scatterers: they are 0.3 mm from it at 20 mm, but share the factor exactly.
    np.testing.assert_allclose(np.abs(shaped / even), expected, rtol=1e-5)


def test_lobe_of_a_rough_conductor_is_brightest_towards_the_mirror_direction(assemble):
    bsdf = '<bsdf type="roughconductor"><string name="material" value="Al"/><float name="alpha" value="0.1"/></bsdf>'
    mirror, back = direction(30, 0), direction(30, 180)
    power = {}
    for name, sight in {"mirror": mirror, "normal": direction(0), "back": back}.items():
        even, shaped = (simulate(assemble(lobed(bsdf, sight, lobe=lobe))).field for lobe in (False, True))
        power[name] = np.abs(shaped / even)[20, 30] ** 2
    assert power["mirror"] > 10 * power["normal"] > 100 * power["back"]


def test_lobe_turns_with_the_target(assemble):
    """Turned by 15 deg about y, the normal view of light from 30 deg lies in the mirror direction."""
    bsdf = '<bsdf type="roughconductor"><string name="material" value="Al"/><float name="alpha" value="0.05"/></bsdf>'
    assembly, even = assemble(lobed(bsdf)), assemble(lobed(bsdf, lobe=False))
    power = {
        angle: np.abs(simulate(assembly, Pose(ry=angle)).field / simulate(even, Pose(ry=angle)).field)[20, 30] ** 2
        for angle in (-20.0, -15.0, -10.0, 15.0)
    }
    assert max(power, key=power.get) == -15.0


# Work


def test_frames_of_a_sweep_compile_nothing_new(shipped):
    """Other poses, seeds, numbers of scatterers and beams reuse the kernels of the first frames."""
    import drjit as dr

    assemblies = [
        shipped("tilted_laser", width=96, height=64),
        shipped(
            "tilted_laser", width=96, height=64, beam_radius=0.1, roughness=1.1, wavefront_radius=-500, wavelength=780
        ),
    ]
    poses = [Pose(), Pose(x=0.02), Pose(z=-0.1), Pose(rx=0.1, ry=-0.05, rz=0.02)]
    for pose in poses[:2]:
        simulate(assemblies[0], pose)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for assembly in assemblies:
            for seed in (0, 1):
                for pose in poses:
                    simulate(assembly.with_seed(seed), pose)
        kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(entry["cache_hit"] for entry in kernels), sum(not entry["cache_hit"] for entry in kernels)
