"""Fields of scenes with elements against references that share no code with them: closed forms and brute-force sums."""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import DIELECTRIC, MIRROR, diffracted, disc_nodes, spherical, tilted
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq

from speckle_mi.measurement.correlator import Correlator
from speckle_mi.measurement.speckle_statistics import centre_of_gravity
from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.geometry.pose import Pose
from speckle_mi.field.simulation import plan_of, simulate, simulate_frame
from speckle_mi.geometry.frames import Frame
from speckle_mi.scene import write
from speckle_mi.scene.write import aimed, on_axis, scene_text

WAVELENGTH = 632.8e-6
K = 2 * np.pi / WAVELENGTH

PATH_TOLERANCE = 1e-5
"""Wavelengths rms, of a path through lenses."""

MIRROR_TOLERANCE = 1e-6
"""Wavelengths, of a path over plane mirrors."""

IRRADIANCE_TOLERANCE = 1e-3
"""Of the unobstructed intensity behind an aperture, and of the peak in an image."""


def scene(
    elements: str, detector: Frame, source=(0.0, 0.0, 0.0), folder=None, pixels=48, pitch=0.04, options=None
) -> str:
    """A scene with one scatterer, lit evenly by a collimated laser from the side."""
    return scene_text(
        write.integrator(**(options or {})),
        write.laser(aimed([-30.0, 0, 40.0])),
        elements,
        write.rough_target(points=write.write_points(folder / "points.csv", source)),
        write.detector(detector, pixels, pixels, pitch),
    )


def facing(z: float) -> Frame:
    return aimed([0.0, 0, z])


def stop(z: float, radius: float, name: str = "stop") -> str:
    return write.shape("aperture", name, on_axis(z), radius=radius, outer_radius=radius + 15).xml()


BICONVEX = {"radius1": 50.0, "radius2": -50.0, "thickness": 5.0, "diameter": 20.0, "ior": 1.5151}


def lens(z: float, **values) -> str:
    return write.shape("lens", "lens", on_axis(z), **BICONVEX | values).xml()


GEOMETRIC = {"diffraction": False}


def unit_field(assembly):
    """Field of the one scatterer at unit amplitude: the laser's own factor taken out."""
    frame = simulate_frame(assembly)
    assert frame.scatterers.count == 1
    return frame.image.field / frame.scatterers.amplitude[0], frame


# An independent tracer: rays in the plane of the axis through a lens of spherical surfaces.


def meridional(angle, z_lens, z_end, front=50.0, back=-50.0, thickness=5.0, index=1.5151):
    """Height, slope angle and path at z_end of a ray that leaves the origin at ``angle``; arrays allowed."""
    y, z = np.zeros_like(angle), np.zeros_like(angle)
    dy, dz = np.sin(angle), np.cos(angle)
    path = np.zeros_like(angle)
    for vertex, radius, before, after in ((z_lens, front, 1.0, index), (z_lens + thickness, back, index, 1.0)):
        centre = vertex + radius
        b = y * dy + (z - centre) * dz
        root = np.sqrt(b * b - (y * y + (z - centre) ** 2 - radius**2))
        length = -b - np.sign(radius) * root
        y, z, path = y + length * dy, z + length * dz, path + before * length
        ny, nz = y / radius, (z - centre) / radius  # towards the light for a front that bulges to it
        cosine = -(dy * ny + dz * nz)
        mu = before / after
        refracted = np.sqrt(1 - mu * mu * (1 - cosine * cosine))
        dy, dz = mu * dy + (mu * cosine - refracted) * ny, mu * dz + (mu * cosine - refracted) * nz
    length = (z_end - z) / dz
    return y + length * dy, np.arctan2(dy, dz), path + length


def radii(assembly):
    points = assembly.detector.points()
    return np.hypot(points[:, 0], points[:, 1]).reshape(assembly.detector.shape)


def test_path_through_a_lens_is_exact_at_every_pixel(assemble, tmp_path):
    assembly = assemble(scene(lens(100), facing(150), folder=tmp_path, pixels=24, pitch=0.05, options=GEOMETRIC))
    field, _ = unit_field(assembly)
    angles = [brentq(lambda t, r=r: meridional(np.array(t), 100, 150)[0] - r, 0, 0.08) for r in radii(assembly).ravel()]
    path = meridional(np.array(angles), 100, 150)[2].reshape(field.shape)
    waves = np.angle(field * np.exp(-1j * K * path)) / (2 * np.pi)
    assert np.sqrt(np.mean(waves**2)) < PATH_TOLERANCE


def test_geometric_amplitude_follows_the_ray_tube(assemble, tmp_path):
    assembly = assemble(scene(lens(100), facing(150), folder=tmp_path, pixels=24, pitch=0.05, options=GEOMETRIC))
    field, _ = unit_field(assembly)
    r = radii(assembly).ravel()
    angles = np.array([brentq(lambda t, r=r: meridional(np.array(t), 100, 150)[0] - r, 0, 0.08) for r in r])
    step = 1e-6
    height, slope, _ = meridional(angles, 100, 150)
    growth = (meridional(angles + step, 100, 150)[0] - meridional(angles - step, 100, 150)[0]) / (2 * step)
    expected = np.sqrt(np.sin(angles) / (height * growth * np.cos(slope)))
    np.testing.assert_allclose(np.abs(field).ravel(), expected, rtol=1e-5)


@pytest.mark.parametrize("angle", [45.0, 30.0])
def test_plane_mirror_is_the_image_source(assemble, tmp_path, angle):
    # The mirror's normal turned by the angle from -z: light along +z leaves at twice the angle.
    turn = np.radians(2 * angle)
    place = np.array([0, 0, 80.0]) + 50 * np.array([np.sin(turn), 0, -np.cos(turn)])
    tilt = tilted(0, 180 - angle, 0)
    mirror = write.shape("rectangle", "mirror", Frame(np.array([0, 0, 80.0]), tilt), [MIRROR], (12, 12, 1)).xml()
    side = Frame(np.array([14.0, 0, 22.0]), tilted(0, 90, 0))
    wall = write.shape("disk", "wall", side, [write.material("diffuse")], (14, 14, 1)).xml()
    looks = aimed(place, (0.0, 0, 80.0))
    assembly = assemble(
        scene(mirror + wall, looks, (0.3, -0.2, 0.0), tmp_path, options={"method": "direct"})
    )
    field, frame = unit_field(assembly)
    lines = " ".join(frame.plan)
    assert "unfolded" in lines and "traced" not in lines and "diffracted" not in lines
    normal = np.array([np.sin(np.radians(180 - angle)), 0, np.cos(np.radians(180 - angle))])
    source = np.array([0.3, -0.2, 0.0])
    image = source - 2 * ((source - [0, 0, 80]) @ normal) * normal
    r = np.linalg.norm(assembly.detector.points() - image, axis=1).reshape(field.shape)
    waves = np.angle(field * np.exp(-1j * K * r)) / (2 * np.pi)
    assert np.abs(waves).max() < MIRROR_TOLERANCE
    np.testing.assert_allclose(np.abs(field), 1 / r, rtol=1e-5)


def test_shadow_of_an_aperture_is_the_rayleigh_sommerfeld_integral(assemble, tmp_path):
    # Fresnel number 20, from the bright middle over the edge of the shadow (r = 1 mm) into the dark.
    assembly = assemble(scene(stop(39, 0.5), facing(78), folder=tmp_path, pixels=20, pitch=0.14))
    field, frame = unit_field(assembly)
    assert "diffracted at stop" in frame.plan
    x, y, area = disc_nodes(0.5, 300, 700)
    hole, points = np.stack([x, y, np.full(len(x), 39.0)], axis=1), assembly.detector.points()
    lit = spherical(np.zeros(3), hole, WAVELENGTH) * area
    expected = diffracted(hole, lit, np.array([0.0, 0.0, 1.0]), points, WAVELENGTH)
    free = 1 / np.sum(points**2, axis=1)
    error = np.abs(np.abs(field.ravel()) ** 2 - np.abs(expected) ** 2) / free
    assert error.max() < IRRADIANCE_TOLERANCE


def test_power_behind_an_aperture_is_what_went_through_it(assemble, tmp_path):
    assembly = assemble(scene(stop(39, 0.5), facing(78), folder=tmp_path, pixels=250, pitch=0.02))
    field, _ = unit_field(assembly)
    through = 2 * np.pi * (1 - 39 / np.hypot(39, 0.5))
    assert np.sum(np.abs(field) ** 2) * 0.02**2 == pytest.approx(through, rel=0.01)


@pytest.mark.parametrize("defocus", [0.0, 2.0])
def test_image_of_a_point_is_the_huygens_sum_over_the_pupil(assemble, tmp_path, defocus):
    z_stop, z_detector, radius = 103.0, 199.1 + defocus, 2.0
    text = scene(
        lens(97.0) + stop(z_stop, radius),
        facing(z_detector),
        folder=tmp_path,
        pixels=60,
        pitch=0.0012 + 0.0016 * defocus,
    )
    assembly = assemble(text)
    field, frame = unit_field(assembly)
    assert "diffracted at stop" in frame.plan
    edge = brentq(lambda t: meridional(np.array(t), 97.0, z_stop)[0] - radius, 0, 0.08)
    x, w = leggauss(160)
    angle, weight = edge * (1 + x) / 2, edge * w / 2
    height, slope, path = meridional(angle, 97.0, z_stop)
    growth = (meridional(angle + 1e-6, 97.0, z_stop)[0] - meridional(angle - 1e-6, 97.0, z_stop)[0]) / 2e-6
    amplitude = np.sqrt(np.sin(angle) / (height * growth * np.cos(slope)))
    spokes = 360
    phi = 2 * np.pi * np.arange(spokes) / spokes
    px, py = np.outer(height, np.cos(phi)).ravel(), np.outer(height, np.sin(phi)).ravel()
    values = amplitude * np.exp(1j * K * (path % WAVELENGTH)) * height * growth * weight * 2 * np.pi / spokes
    values = np.repeat(values, spokes)
    row = assembly.detector.points().reshape(60, 60, 3)[29]
    depth = z_detector - z_stop
    expected = []
    for x, y, _ in row:
        r = np.sqrt(depth**2 + (px - x) ** 2 + (py - y) ** 2)
        expected.append(np.sum(values * np.exp(1j * K * (r % WAVELENGTH)) / r * (depth / r) / (1j * WAVELENGTH)))
    expected = np.abs(expected) ** 2
    peak = (np.abs(field) ** 2).max()
    assert np.abs(np.abs(field[29]) ** 2 - expected).max() < IRRADIANCE_TOLERANCE * max(peak, expected.max())


# What is left out


def test_free_space_launches_no_ray(shipped, monkeypatch):
    from speckle_mi.plan import plan

    monkeypatch.setattr(plan, "find_routes", lambda *_: pytest.fail("a ray was launched"))
    frame = simulate_frame(shipped("tilted_laser", width=32, height=32))
    assert "no ray is launched" in frame.plan[0]


def test_aperture_far_larger_than_the_light_diffracts_nothing(assemble, tmp_path):
    free = simulate(assemble(scene("", facing(78), (0.1, 0.05, 0.0), tmp_path)))
    wide = simulate_frame(assemble(scene(stop(39, 9.0), facing(78), (0.1, 0.05, 0.0), tmp_path)))
    assert any(line.startswith("diffracts nothing") for line in wide.plan)
    np.testing.assert_allclose(wide.image.field, free.field, rtol=1e-5)


def test_diffracted_light_comes_close_to_the_geometric_far_from_edges(assemble, tmp_path):
    # Averaged over its edge waves, diffracted intensity in the middle of a large hole is the free one.
    wide = simulate(assemble(scene(stop(39, 2.0), facing(78), (0.3, 0.2, 0.0), tmp_path, pitch=0.02)))
    free = simulate(assemble(scene("", facing(78), (0.3, 0.2, 0.0), tmp_path, pitch=0.02)))
    assert wide.intensity.mean() == pytest.approx(free.intensity.mean(), rel=0.02)


def test_geometric_field_at_a_focus_is_refused_with_the_reason(assemble, tmp_path):
    with pytest.raises(ValueError, match="focus.*diffraction"):
        simulate(
            assemble(
                scene(lens(97.0) + stop(103.0, 2.0), facing(199.1), folder=tmp_path, pitch=0.002, options=GEOMETRIC)
            )
        )


def test_order_of_shapes_in_the_file_is_irrelevant(assemble, tmp_path):
    one, two = (
        simulate(assemble(scene(parts, facing(170), folder=tmp_path, pixels=24)))
        for parts in (lens(97.0) + stop(103.0, 2.0), stop(103.0, 2.0) + lens(97.0))
    )
    np.testing.assert_array_equal(one.field, two.field)


def test_rays_of_the_paper_agree_with_the_geometric_field(assemble, tmp_path):
    elements = lens(97.0) + stop(103.0, 2.0)
    exact, rays = (
        simulate(assemble(scene(elements, facing(160), (0.1, 0.0, 0.0), tmp_path, options=GEOMETRIC | method))).field
        for method in ({}, {"method": "rays"})
    )
    assert np.linalg.norm(exact - rays) / np.linalg.norm(exact) < 1e-3  # a few pixels on the shadow's edge may differ


@pytest.mark.parametrize(
    ("shape", "what"),
    [
        (write.shape("cylinder", "rod", on_axis(0.0), [DIELECTRIC]).xml(), "rod"),
        (write.shape("sphere", "bubble", on_axis(0.0), [write.material("thindielectric")]).xml(), "bubble"),
    ],
)
def test_what_cannot_be_taken_into_account_is_refused_by_name(assemble, tmp_path, shape, what):
    with pytest.raises(ValueError, match=what):
        assemble(scene(shape, facing(78), folder=tmp_path))


# Sensors with optics


def slopes(assembly, pose, axis, seeds, measure):
    """Sensitivity of ``measure`` to one small motion for each seed [mm/mm or mm/deg]."""
    found = []
    for seed in seeds:
        surface = assembly.with_seed(seed)
        reference = simulate(surface).intensity
        moved = simulate(surface, pose).intensity
        found.append(measure(reference, moved)[axis] * assembly.detector.pitch)
    return np.array(found)


def by_correlation(reference, moved):
    shift = Correlator(reference).shift(moved)
    assert shift.ok, shift.message
    return shift.u_px, shift.v_px


def by_centre_of_gravity(reference, moved):
    return np.subtract(centre_of_gravity(moved), centre_of_gravity(reference))


def test_in_plane_shift_of_an_image_is_the_magnification(shipped):
    assembly = shipped("imaging", beam_radius=0.8)
    expected = expected_sensitivity(assembly)["u"]
    measured = slopes(assembly, Pose(x=0.02), 0, range(3), by_correlation) / 0.02
    assert np.mean(measured) == pytest.approx(expected[0], rel=0.005)
    tilted = slopes(assembly, Pose(ry=0.05), 0, range(2), by_correlation) / 0.05
    # In focus tilt moves nothing: less than a hundredth of the 3.4 mm/deg of free space at that distance.
    assert np.abs(np.mean(tilted)) < 0.03


def test_tilt_moves_a_defocused_image_as_theory_says(shipped):
    assembly = shipped("imaging_defocused", beam_radius=0.8)
    expected = expected_sensitivity(assembly)["u"][4]
    measured = slopes(assembly, Pose(ry=0.05), 0, range(4), by_correlation) / 0.05
    error = np.std(measured, ddof=1) / np.sqrt(len(measured))
    assert abs(expected) > 0.05
    assert np.mean(measured) == pytest.approx(expected, abs=max(0.03 * abs(expected), 4 * error))


def test_centre_of_gravity_behind_an_aperture_follows_triangulation(shipped):
    # A wider beam than the paper's gives more speckles, and so a smaller spread; the geometry is the same.
    assembly = shipped("integrated_sensor", beam_radius=0.5, width=186, height=120, pixel_pitch=0.024)
    assert expected_sensitivity(assembly)["cog_u"][2] == pytest.approx(0.6715, abs=1e-4)
    measured = slopes(assembly, Pose(z=0.1), 0, range(16), by_centre_of_gravity) / 0.1
    error = np.std(measured, ddof=1) / np.sqrt(len(measured))
    assert error < 0.1
    assert np.mean(measured) == pytest.approx(0.6715, abs=4 * error)


def test_every_shipped_scene_has_a_plan(mitsuba):
    from conftest import SCENES

    from speckle_mi.scene.read import assemblies_from_scene

    for path in SCENES.glob("*.xml"):
        small = {"width": "32", "height": "32"} if 'default name="width"' in path.read_text() else {}
        scene = mitsuba.load_file(str(path), **small)
        for assembly in assemblies_from_scene(scene).values():
            plan = plan_of(assembly)
            assert plan.channels and not plan.warnings, path.name


def test_tilt_decorrelates_an_image_as_the_pupils_overlap(shipped):
    from speckle_mi.experiments.expectation import expected_correlation

    # Enough scatterers for several in each resolution cell of the lens, or the image shows single points.
    assembly = shipped("imaging", beam_radius=0.4, point_sources=12000)
    tilt = 0.2
    peaks = []
    for seed in range(3):
        surface = assembly.with_seed(seed)
        peaks.append(Correlator(simulate(surface).intensity).shift(simulate(surface, Pose(ry=tilt)).intensity).ncc)
    expected = expected_correlation(assembly, "ry", np.array([tilt]))[0]
    assert 0.5 < expected < 0.8
    # The spot's image stands still under the speckle, which holds some percent of correlation.
    assert np.mean(peaks) == pytest.approx(expected, abs=0.06)
