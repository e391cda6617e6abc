"""Targets given as meshes: density, visibility and shadows of curved, turned and ridged surfaces."""

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
from scipy import stats
from scipy.spatial import cKDTree

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.field.simulation import simulate_frame

pytestmark = pytest.mark.usefixtures("mitsuba")

SIGMAS = 4.5  # Standard errors allowed: about one false alarm in 10^5 checks.
KS_999 = 1.95  # Kolmogorov-Smirnov statistic times sqrt(n) that chance exceeds once in a thousand.
ROUNDING = 1e-13  # [mm]: float64 rounding of coordinates of some 100 mm through a pose and back.


def write_mesh(path, corners):
    """Triangles (f, 3, 3) as a PLY or OBJ file."""
    vertices = np.asarray(corners, float).reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    if path.suffix == ".obj":
        lines = ["v " + " ".join(repr(float(x)) for x in v) for v in vertices]
        lines += ["f " + " ".join(str(i + 1) for i in f) for f in faces]
    else:
        lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
        lines += [f"property float {axis}" for axis in "xyz"]
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        lines += [" ".join(repr(float(x)) for x in v) for v in vertices] + ["3 " + " ".join(map(str, f)) for f in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def quad(p, q, r, s):
    return [[p, q, r], [p, r, s]]


def plane(a=2.0):
    return np.array(quad([-a, -a, 0], [a, -a, 0], [a, a, 0], [-a, a, 0]), float)


def shaft(radius=5.0, length=4.0, sides=360):
    """A cylinder along y whose topmost line lies in the target's plane z = 0, faces outwards."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.stack([radius * np.sin(angle), np.zeros(sides + 1), radius * np.cos(angle) - radius], axis=1)
    low, high = ring - [0, length / 2, 0], ring + [0, length / 2, 0]
    return np.array([t for k in range(sides) for t in quad(low[k], low[k + 1], high[k + 1], high[k])])


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_a_plane_mesh_scatters_like_the_plane_patch(assemble, tmp_path, suffix):
    path = write_mesh(tmp_path / f"plane{suffix}", plane())
    to_laser = direction(35, 180)
    meshed = assemble(free_space(to_laser, target={"filename": str(path), "point_sources": 400}))
    flat = assemble(free_space(to_laser, target={"point_sources": 400}))
    assert meshed.target.surface.density == pytest.approx(flat.target.surface.density, rel=1e-6)
    surfaces = 12
    for assembly in (meshed, flat):
        found = [simulate_frame(assembly.with_seed(seed)).scatterers for seed in range(surfaces)]
        expected = assembly.target.surface.density * np.pi * (3 * 0.12) ** 2 / np.cos(np.radians(35))
        total = sum(s.count for s in found)
        assert total == pytest.approx(surfaces * expected, abs=SIGMAS * np.sqrt(surfaces * expected))
        heights = np.concatenate([s.position[:, 2] for s in found])
        assert stats.kstest(heights / 0.8e-3, "norm").statistic < KS_999 / np.sqrt(total)
        places = np.concatenate([s.position[:, :2] for s in found])
        # Uniform over the elliptic footprint: the scaled squared radius and the angle are uniform.
        scaled = places / [3 * 0.12 / np.cos(np.radians(35)), 3 * 0.12]
        assert stats.kstest(np.sum(scaled**2, axis=1), "uniform").statistic < KS_999 / np.sqrt(total)
        angle = np.arctan2(scaled[:, 1], scaled[:, 0]) / (2 * np.pi) + 0.5
        assert stats.kstest(angle, "uniform").statistic < KS_999 / np.sqrt(total)
        np.testing.assert_allclose(
            np.concatenate([s.normal for s in found]), np.tile([0, 0, 1.0], (total, 1)), atol=1e-6
        )


def test_density_on_a_mesh_does_not_depend_on_its_triangles(assemble, tmp_path):
    """A fan of ever thinner slivers has as many scatterers in equal areas as two big triangles."""
    edges = np.concatenate([[-2], -2 + 4 * np.geomspace(1e-4, 1, 40)])
    fan = np.array([t for p, q in zip(edges, edges[1:]) for t in quad([p, -2, 0], [q, -2, 0], [q, 2, 0], [p, 2, 0])])
    path = write_mesh(tmp_path / "fan.ply", fan)
    assembly = assemble(
        free_space(laser={"beam_radius": None}, target={"filename": str(path), "point_sources": 16_000})
    )
    assert assembly.target.surface.density == pytest.approx(1000, rel=1e-5)
    places = np.concatenate([simulate_frame(assembly.with_seed(seed)).scatterers.position for seed in range(4)])
    n = len(places)
    assert n == pytest.approx(64_000, abs=SIGMAS * np.sqrt(64_000))
    for k in (0, 1):
        assert stats.kstest((places[:, k] + 2) / 4, "uniform").statistic < KS_999 / np.sqrt(n)


def test_only_the_side_of_a_shaft_that_is_lit_and_seen_scatters(assemble, tmp_path):
    path = write_mesh(tmp_path / "shaft.ply", shaft())
    to_laser, sight = direction(50, 180), direction(60, 0)
    text = free_space(
        to_laser, sight, laser_distance=100, laser={"beam_radius": None, "wavefront_radius": None},
        target={"filename": str(path), "point_sources": 40_000, "roughness": 0.0}, detector={"pixel_pitch": 0.001},
    )
    assembly = assemble(text)
    scatterers = simulate_frame(assembly).scatterers
    angle = np.degrees(np.arctan2(scatterers.position[:, 0], scatterers.position[:, 2] + 5.0))
    radial = np.hypot(scatterers.position[:, 0], scatterers.position[:, 2] + 5.0)
    np.testing.assert_allclose(radial, 5.0, atol=2e-4)  # the sagitta of 1 degree facets is 1.9e-4 mm
    # Collimated light at -50 deg reaches -140 ... 40 deg. The detector at 60 mm and 60 deg from the top line sees
    # less than half of the shaft: outward normal times (D - P) > 0.
    centre = np.array([0, 0, -5.0])
    to_detector = 60 * sight - centre
    half_seen = np.degrees(np.arccos(5 / np.linalg.norm(to_detector)))
    towards = np.degrees(np.arctan2(to_detector[0], to_detector[2]))
    low, high = max(-140, towards - half_seen), min(40, towards + half_seen)
    assert np.all(angle > low - 1.1) and np.all(angle < high + 1.1)  # facets are 1 degree wide
    expected = 40_000 * (high - low) / 360
    # The limit of sight is not a straight line along y; it moves by far less than a facet over 4 mm.
    assert scatterers.count == pytest.approx(expected, abs=SIGMAS * np.sqrt(expected) + 40_000 * 2 / 360)
    assert np.einsum("ij,j->i", scatterers.normal, to_laser).min() > 0
    assert np.einsum("ij,ij->i", scatterers.normal, 60 * sight - scatterers.position).min() > 0


def test_a_turned_shaft_brings_its_own_material_under_the_beam(assemble, tmp_path):
    """The target frame stands on the shaft's axis, so ry turns it: by one facet, the pattern of normals repeats."""
    turned = shaft() + [0, 0, 5.0]
    path = write_mesh(tmp_path / "shaft.ply", turned)
    frame = Frame(np.array([0, 0, -5.0]), np.eye(3))
    text = scene_of(
        integrator_xml(),
        laser_xml(frame_along(-direction(0), 50 * direction(0), np.array([1.0, 0, 0])), beam_radius=0.3),
        target_xml(frame, filename=str(path), point_sources=400),
        detector_xml(detector_frame(direction(20), 60.0)),
    )
    assembly = assemble(text)
    pose = Pose(ry=1.0, y=0.05)
    rest, moved = simulate_frame(assembly).scatterers, simulate_frame(assembly, pose).scatterers
    one = frame.to_local(rest.position)
    other = frame.moved(pose).to_local(moved.position)
    distance, index = cKDTree(other).query(one)
    same = distance < 1e-9
    assert same.sum() > 0.7 * len(one)  # turned by 0.09 mm, less than a third of the beam radius
    np.testing.assert_allclose(other[index[same]], one[same], rtol=0, atol=ROUNDING)


def test_a_ridge_casts_a_shadow_on_the_surface_behind_it(assemble, tmp_path):
    """A wall 0.2 mm high across the beam at 60 deg: its shadow reaches 0.2 tan(60 deg) behind it."""
    wall = np.array(quad([0, -2, 0], [0, -2, 0.2], [0, 2, 0.2], [0, 2, 0]), float)
    back = wall[:, ::-1] + [1e-3, 0, 0]
    path = write_mesh(tmp_path / "ridge.ply", np.concatenate([plane(), wall, back]))
    text = free_space(
        direction(60, 180), direction(0), laser={"beam_radius": None, "wavefront_radius": None},
        target={"filename": str(path), "point_sources": 40_000, "roughness": 0.0}, detector={"pixel_pitch": 0.001},
    )
    assembly = assemble(text)
    floor = simulate_frame(assembly).scatterers.position
    floor = floor[np.abs(floor[:, 2]) < 1e-6]
    shadow = 0.2 * np.tan(np.radians(60))
    inside = (floor[:, 0] > 0.003) & (floor[:, 0] < shadow - 0.003)
    assert inside.sum() == 0
    assert np.sum((floor[:, 0] > shadow) & (floor[:, 0] < shadow + 0.1)) > 50
    assert np.sum((floor[:, 0] < 0) & (floor[:, 0] > -0.1)) > 50
    # Turned about the normal by 180 degrees, the shadow falls on the other side of the wall.
    pose = Pose(rz=180.0)
    floor = WORLD.moved(pose).to_local(simulate_frame(assembly, pose).scatterers.position)
    floor = floor[np.abs(floor[:, 2]) < 1e-6]
    assert np.sum((floor[:, 0] < -0.003) & (floor[:, 0] > -shadow + 0.003)) == 0
    assert np.sum((floor[:, 0] > 0.003) & (floor[:, 0] < 0.1)) > 50


def test_a_shadow_points_away_from_the_source_of_a_diverging_beam(assemble, tmp_path):
    """A source 5 mm above the middle: a wall at x = 1.5 mm, 0.5 mm high, shades the floor out to 1.5 * 5/4.5 mm."""
    wall = np.array(quad([1.5, -2, 0], [1.5, -2, 0.5], [1.5, 2, 0.5], [1.5, 2, 0]), float)
    path = write_mesh(tmp_path / "wall.ply", np.concatenate([plane(), wall, wall[:, ::-1]]))
    text = free_space(
        laser={"beam_radius": None, "wavefront_radius": 5.0}, detector={"pixel_pitch": 0.001},
        target={"filename": str(path), "point_sources": 40_000, "roughness": 0.0},
    )
    places = simulate_frame(assemble(text)).scatterers.position
    floor = places[(np.abs(places[:, 2]) < 1e-6) & (np.abs(places[:, 1]) < 0.1)]
    edge = 1.5 * 5 / 4.5
    assert np.sum((floor[:, 0] > edge + 0.02) & (floor[:, 0] < 1.9)) > 10
    assert np.sum((floor[:, 0] > 1.505) & (floor[:, 0] < edge - 0.02)) == 0
