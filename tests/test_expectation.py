"""What is expected of a whole assembly: astigmatic optics, mirrors on the way, the user's own points, several ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exact_optics import BLACK, MIRROR, element_xml, facing, fermat, lens_surfaces, thin_lens_start, tilted
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
from scipy.optimize import minimize
from test_surface_mesh import quad, shaft, write_mesh

from speckle_mi.experiments.chief_ray import SEVERAL_WAYS, axes_as_seen
from speckle_mi.experiments.expectation import expected_by_way, expected_sensitivity
from speckle_mi.experiments.sweep import run_sweep
from speckle_mi.experiments.sweep_result import SweepResult, SweepSettings
from speckle_mi.field.simulation import plan_of
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation

pytestmark = pytest.mark.usefixtures("mitsuba")

EXACT = 2e-5  # Relative to the largest entry: differences over 1e-3 of the motion, of 0.02 mm on the surface.
SPECKLE = 1.5  # [um]: a quarter of a pixel, as one surface scatters over 128 pixels.


def laser_at(spot, angle, azimuth=180.0, **values):
    to_laser = direction(angle, azimuth)
    return laser_xml(frame_along(-to_laser, spot + 50 * to_laser, np.array([1.0, 0, 0])), **values)


# Astigmatic optics

LENS = dict(radius1=50.0, radius2=-50.0, thickness=8.0)
FOCAL_LENGTH = 49.9  # [mm]: only the start of the reference's search.

ASTIGMATIC = {
    "tilted lens": dict(spot=(0.0, 0.0), lens=((0.0, 0.0, 60.0), (0.0, 25.0, 0.0)), detector=(0.0, 0.0, 100.0)),
    "spot off the axis": dict(spot=(2.0, -1.0), lens=((0.0, 0.0, 80.0), (0.0, 0.0, 0.0)), detector=(-4.0, 2.0, 130.0)),
    "behind the focus": dict(
        spot=(0.5, 0.3), lens=((0.0, 0.0, 120.0), (15.0, -20.0, 5.0)), detector=(1.0, -2.0, 300.0)
    ),
}


def stationary_displacement(assembly, spot, dof, path):
    """Displacement per unit motion at which the path change of moved scatterers is stationary over the surface z = 0.

    path: length from points (4, 3) to a pixel (3,), without a word of ray optics.
    """
    grid, beam = assembly.detector, assembly.beam
    focus = beam.reference - beam.wavefront_radii[0] * beam.axis
    tangents = np.eye(3)[:2]

    def whole(points, pixel):
        light = np.sign(beam.wavefront_radii[0]) * np.linalg.norm(points - focus, axis=1)
        return light + path(points, pixel)

    h = 0.02
    points = spot + h * np.concatenate([tangents, -tangents])
    rest = whole(points, grid.centre)

    def slope(amount, shift):
        moved = WORLD.moved(Pose(**{dof: float(amount)})).to_world(points)
        change = whole(moved, grid.centre + shift[0] * grid.u + shift[1] * grid.v) - rest
        return (change[:2] - change[2:]) / (2 * h)

    def displacement(amount):
        shift = np.zeros(2)
        for _ in range(3):
            steps = 0.01 * np.eye(2)
            jacobian = np.stack([(slope(amount, shift + e) - slope(amount, shift - e)) / 0.02 for e in steps])
            shift = shift - np.linalg.solve(jacobian.T, slope(amount, shift))
        return shift

    amount = 0.01 if is_rotation(dof) else 1e-3
    return (displacement(amount) - displacement(-amount)) / (2 * amount)


def agrees_with_paths(assembly, spot, path):
    expected = expected_sensitivity(assembly)
    matrix = np.stack([expected["u"], expected["v"]])
    moved = np.stack([stationary_displacement(assembly, spot, dof, path) for dof in DEGREES_OF_FREEDOM], axis=1)
    for columns in (slice(0, 3), slice(3, 6)):
        scale = np.abs(moved[:, columns]).max()
        np.testing.assert_allclose(matrix[:, columns], moved[:, columns], rtol=0, atol=EXACT * scale)


@pytest.mark.parametrize("name", ASTIGMATIC)
def test_astigmatic_optics_move_the_pattern_to_where_the_path_change_is_stationary(assemble, tmp_path, name):
    case = ASTIGMATIC[name]
    spot = np.array([*case["spot"], 0.0])
    # The reference is that of a point: a small spot, of the beam's spherical wave.
    points = spot + 0.01 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    np.savetxt(tmp_path / "points.csv", points, delimiter=",", fmt="%.17g")
    place, turn = case["lens"]
    frame = Frame(np.array(place), tilted(*turn))
    x, y, z = case["detector"]
    assembly = assemble(scene_of(
        integrator_xml(diffraction=False),
        laser_at(spot, 30.0, 160.0, wavefront_radius=-80.0, beam_radius=None),
        target_xml(points=str(tmp_path / "points.csv"), roughness=None, point_sources=None),
        element_xml("lens", "lens", frame, diameter=36.0, ior=1.5151, **LENS),
        detector_xml(facing(z, x, y, (5.0, -8.0, 20.0)), width=8, height=8, pixel_pitch=0.01),
    ))  # fmt: skip
    surfaces = lens_surfaces(place, frame.axes, index=1.5151, **LENS)
    start = thin_lens_start(spot, assembly.detector.centre, surfaces, FOCAL_LENGTH)
    agrees_with_paths(
        assembly, spot, lambda points, pixel: fermat(points, surfaces, pixel, np.tile(start, (1, len(points))))[0]
    )


# The user's own points


@pytest.mark.parametrize("middle", [(3.0, -2.0), (0.0, 4.0), (-5.0, 1.0)])
def test_the_users_points_move_their_pattern_from_where_they_are(assemble, tmp_path, middle):
    points = np.random.default_rng(4).normal(0, 0.05, (40, 3)) * (1, 1, 0) + [*middle, 0]
    np.savetxt(tmp_path / "points.csv", points, delimiter=",", fmt="%.17g")
    text = free_space(
        direction(35, 180), direction(20, 70), detector_distance=40.0,
        laser={"beam_radius": None, "wavefront_radius": 30.0}, detector={"width": 8, "height": 8},
        target={"points": str(tmp_path / "points.csv"), "roughness": None, "point_sources": None},
    )
    agrees_with_paths(
        assemble(text), points.mean(axis=0), lambda points, pixel: np.linalg.norm(points - pixel, axis=1)
    )


# Coarse meshes

COARSE = 1e-3  # Relative to the largest entry; the facet under the axis alone is off by 1 % and more.


def turned_shaft(sides, radius, turn):
    """A cylinder along y below the plane z = 0, turned by a share of a facet from where an edge lies on top."""
    axis = np.array([0.0, 0.0, -radius])
    return (shaft(radius, 4.0, sides) - axis) @ tilted(0.0, 360.0 / sides * turn, 0.0).T + axis


def roof(left, right):
    """Two planes that meet along y, falling at angles [deg] to either side."""
    a, b = (np.tan(np.radians(angle)) for angle in (left, right))
    return np.array([
        *quad([-2, -2, -2 * a], [0, -2, 0], [0, 2, 0], [-2, 2, -2 * a]),
        *quad([0, -2, 0], [2, -2, -2 * b], [2, 2, -2 * b], [0, 2, 0]),
    ])  # fmt: skip


MESHES = {
    "edge under the beam": (turned_shaft(60, 8.0, 0.0), 0.15),
    "edge beside the axis": (turned_shaft(60, 5.0, 0.15), 0.3),
    "many facets under the beam": (turned_shaft(720, 8.0, 0.0), 0.15),
    "roof": (roof(4.0, 9.0), 0.2),
}


def displacement_of_least_variance(assembly, dof):
    """Displacement per unit motion that leaves least variance of the path change, over places spread on the mesh.

    The places count by the light's intensity: what is left of the change decorrelates the pattern.
    """
    beam, grid, frame = assembly.beam, assembly.detector, assembly.target.frame
    even = replace(assembly.target.surface, roughness=0.0, density=20_000.0)
    lit = even.scatterers(beam, frame).at(frame).lit_by(beam)
    places, weight = frame.to_local(lit.position), np.abs(lit.amplitude) ** 2 / np.sum(np.abs(lit.amplitude) ** 2)
    focus = beam.reference - beam.wavefront_radii[0] * beam.axis

    def path(pose, pixel):
        moved = frame.moved(pose).to_world(places)
        light = np.sign(beam.wavefront_radii[0]) * np.linalg.norm(moved - focus, axis=1)
        return light + np.linalg.norm(moved - pixel, axis=1)

    def change(plus, minus, step):
        value = (plus - minus) / (2 * step)
        return value - weight @ value

    h = 1e-3
    by_pixel = np.array([change(path(Pose(), grid.centre + h * axis), path(Pose(), grid.centre - h * axis), h)
                         for axis in (grid.u, grid.v)])  # fmt: skip
    by_motion = change(path(Pose(**{dof: h}), grid.centre), path(Pose(**{dof: -h}), grid.centre), h)
    return -np.linalg.solve((by_pixel * weight) @ by_pixel.T, (by_pixel * weight) @ by_motion)


@pytest.mark.parametrize("name", MESHES)
def test_pattern_of_a_coarse_mesh_moves_with_all_of_its_facets_under_the_beam(assemble, tmp_path, name):
    corners, radius = MESHES[name]
    path = write_mesh(tmp_path / "mesh.obj", corners)
    assembly = assemble(scene_of(
        integrator_xml(),
        laser_at(np.zeros(3), 25.0, beam_radius=radius, wavefront_radius=-200.0),
        target_xml(filename=str(path)),
        detector_xml(detector_frame(direction(10, 60), 60.0), width=8, height=8),
    ))  # fmt: skip
    expected = expected_sensitivity(assembly)
    matrix = np.stack([expected["u"], expected["v"]])
    moved = np.stack([displacement_of_least_variance(assembly, dof) for dof in DEGREES_OF_FREEDOM], axis=1)
    for columns in (slice(0, 3), slice(3, 6)):
        np.testing.assert_allclose(
            matrix[:, columns], moved[:, columns], rtol=0, atol=COARSE * np.abs(moved[:, columns]).max()
        )


# The detector as the target sees it

FOLDED = {
    "one mirror": [((0.0, 0.0, 40.0), (0.0, 135.0, 0.0))],
    "one mirror out of the planes": [((0.0, 0.0, 40.0), (20.0, 130.0, 10.0))],
    "two mirrors": [((0.0, 0.0, 30.0), (0.0, 135.0, 0.0)), ((30.0, 0.0, 30.0), (25.0, -60.0, 0.0))],
    "three mirrors": [
        ((0.0, 0.0, 30.0), (0.0, 135.0, 0.0)),
        ((30.0, 0.0, 30.0), (25.0, -60.0, 0.0)),
        ((20.0, 20.0, 50.0), (-60.0, 30.0, 0.0)),
    ],
}


def mirrored(points, mirror):
    normal = mirror.axes[:, 2]
    return points - 2 * np.outer((points - mirror.origin) @ normal, normal)


def folded_scene(mirrors, length=30.0, walls=True):
    """(scene text, place of the detector's image, mirrors, detector): the light goes over the mirrors' middles."""
    frames = [Frame(np.array(place), tilted(*turn)) for place, turn in mirrors]
    # The middles of the mirrors are where the axis meets them, so that their places are made to lie on it.
    heading, place, placed, walked = np.array([0.0, 0, 1]), np.zeros(3), [], 0.0
    for frame in frames:
        step = np.linalg.norm(frame.origin - place) if not placed else 30.0
        place = place + step * heading
        placed.append(Frame(place, frame.axes))
        heading = mirrored((place + heading)[None], placed[-1])[0] - place
        walked += step
    centre = place + length * heading
    image = np.array([0.0, 0, walked + length])
    detector = frame_along(-heading, centre, np.array([0.3, 1.0, 0.2]))
    middle = centre / 2
    parts = [element_xml("rectangle", f"m{k}", f, MIRROR, size=(6, 6, 1)) for k, f in enumerate(placed)]
    if walls:
        screen = frame_along(centre, middle, np.array([0.2, 1, 0]))
        parts.append(element_xml("rectangle", "wall", screen, BLACK, size=(3, 3, 1)))
    text = scene_of(
        integrator_xml(diffraction=False),
        laser_at(np.zeros(3), 35.0, 230.0),
        target_xml(),
        *parts,
        detector_xml(detector, width=96, height=96, pixel_pitch=0.008),
    )
    return text, image, placed, detector


def test_motion_projected_on_the_target_is_that_of_the_detectors_image_in_the_mirrors(assemble):
    for name, mirrors in FOLDED.items():
        text, image, placed, _ = folded_scene(mirrors)
        assembly = assemble(text)
        assert len(plan_of(assembly).channels) == 1, name
        straight = assemble(scene_of(
            integrator_xml(), laser_at(np.zeros(3), 35.0, 230.0), target_xml(),
            detector_xml(facing(float(image[2])), width=96, height=96, pixel_pitch=0.008),
        ))  # fmt: skip
        folded, free = expected_sensitivity(assembly), expected_sensitivity(straight)
        for axis in ("x", "y"):
            np.testing.assert_allclose(folded[axis], free[axis], atol=1e-6, err_msg=f"{name}, {axis}")
        assert abs(folded["x"][0]) > 0.8, name


def swept(assembly, folder):
    (folder / "frames").mkdir()
    result = SweepResult()
    settings = SweepSettings(("x",), np.array([-0.02, 0.02]), (0,), None)
    run_sweep(assembly, settings, folder / "frames", result, quiet=True)
    return result


def test_a_sweep_projects_what_it_measures_on_the_axes_that_the_target_sees(shipped, tmp_path):
    assembly = shipped("folded", width=128, height=128, beam_radius=0.3, point_sources=400)
    result = swept(assembly, tmp_path)
    expected = expected_sensitivity(assembly)
    assert expected["x"][0] == pytest.approx(0.937, abs=1e-3)
    for record in result.records[1:]:
        for axis in ("u", "v", "x", "y"):
            predicted = 1e3 * record.displacement * expected[axis][0]
            assert getattr(record, f"shift_{axis}_um") == pytest.approx(predicted, abs=SPECKLE), axis
        assert abs(record.shift_x_um) == pytest.approx(abs(record.shift_u_um), rel=1e-9)
    np.testing.assert_allclose(np.abs(result.axes_as_seen["u"]), [1, 0, 0], atol=1e-6)
    assert all("more than the tolerance" in warning for warning in result.warnings), "but that of the mirror's edge"


def test_of_several_ways_shifts_are_projected_as_the_detector_stands_and_it_is_said(assemble, tmp_path):
    text, _, _, _ = folded_scene(FOLDED["one mirror"], walls=False)
    assembly = assemble(text)
    plan = plan_of(assembly)
    assert len(plan.channels) == 2
    seen = axes_as_seen(assembly, plan)
    np.testing.assert_array_equal(seen.u, assembly.detector.u)
    assert expected_sensitivity(assembly)["x"] is None
    result = swept(assembly, tmp_path)
    assert result.warnings[SEVERAL_WAYS] == 3


def test_of_several_ways_each_has_the_sensitivity_that_it_has_alone(assemble):
    """Without walls light comes straight and over the mirror; with them over the mirror alone."""
    both, alone = (assemble(folded_scene(FOLDED["one mirror"], walls=walls)[0]) for walls in (False, True))
    ways = expected_by_way(both)
    assert len(ways) == 2
    (label, expected), = expected_by_way(alone).items()
    folded = ways.pop(label)
    for axis in ("u", "v", "x", "y"):
        np.testing.assert_allclose(folded[axis], expected[axis], atol=1e-9, err_msg=axis)
        np.testing.assert_array_equal(expected[axis], expected_sensitivity(alone)[axis])
    straight, = ways.values()
    assert np.abs(straight["u"] - folded["u"]).max() > 0.1


CURVED = {
    "convex": dict(centre=(12.0, 0.0, 45.0), radius=12.0, detector=(-40.0, 0.0, 40.0)),
    "convex, out of the plane": dict(centre=(10.0, 8.0, 50.0), radius=20.0, detector=(-30.0, -25.0, 35.0)),
    "convex, far": dict(centre=(30.0, -10.0, 80.0), radius=35.0, detector=(-30.0, 30.0, 45.0)),
}


@pytest.mark.parametrize("name", CURVED)
def test_a_curved_mirror_turns_the_axes_like_the_plane_that_touches_it_where_the_chief_ray_is_reflected(assemble, name):
    case = CURVED[name]
    centre, place = np.array(case["centre"]), np.array(case["detector"])
    towards = centre - place
    detector = frame_along(towards, place, np.array([0.3, 1.0, 0.2]))
    screen = frame_along(place, 0.45 * place, np.array([0.2, 1.0, 0.1]))
    assembly = assemble(scene_of(
        integrator_xml(diffraction=False),
        laser_at(np.zeros(3), 50.0, 90.0),
        target_xml(),
        element_xml("sphere", "ball", Frame(centre, np.eye(3)), MIRROR, radius=case["radius"]),
        element_xml("rectangle", "wall", screen, BLACK, size=(4, 4, 1)),
        detector_xml(detector, width=16, height=16, pixel_pitch=0.01),
    ))  # fmt: skip
    plan = plan_of(assembly)
    assert [channel.route.label for channel in plan.channels] == ["target - ball - detector"]

    def point(angles):
        out = -(np.array([np.sin(angles[0]), np.sin(angles[1]), 0.0]) + centre / np.linalg.norm(centre))
        return centre + case["radius"] * out / np.linalg.norm(out)

    # The shortest way over the near side of the sphere.
    way = minimize(lambda q: np.linalg.norm(point(q)) + np.linalg.norm(point(q) - place), [0.0, 0.0],
                   method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-14, "maxiter": 2000})  # fmt: skip
    hit = point(way.x)
    normal = (hit - centre) / case["radius"]
    seen = axes_as_seen(assembly, plan)
    for axis, turned in ((assembly.detector.u, seen.u), (assembly.detector.v, seen.v)):
        np.testing.assert_allclose(turned, axis - 2 * (axis @ normal) * normal, atol=1e-6)
