"""Rigid motions, tangent vectors and the detector's plane against independent formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.plane import PlaneGrid
from speckle_mi.geometry.pose import Pose
from speckle_mi.geometry.rotation import cross_matrix, rotation_matrix, vectors_across

ROUNDING = 1e-14  # A few units in the last place of numbers of order one.
PLACE = 1e-13  # mm; the same of coordinates of some 10 mm.


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 0.3, np.pi, 6.0])
def test_rotation_is_exact_for_small_and_large_angles(angle):
    vector = angle * np.array([0.48, -0.6, 0.64])
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(rotation_matrix(vector), expected, rtol=0, atol=ROUNDING)


def test_pose_rotates_about_the_frames_origin_and_then_moves_along_its_axes():
    frame = Frame(np.array([20.0, -10.0, 5.0]), rotation_matrix(np.array([0.4, -0.7, 1.1])))
    pose = Pose(x=0.3, y=-0.2, z=0.1, rx=5.0, ry=-30.0, rz=80.0)
    material = np.random.default_rng(0).normal(size=(20, 3))
    turned = Rotation.from_rotvec([5.0, -30.0, 80.0], degrees=True).apply(material) + [0.3, -0.2, 0.1]
    np.testing.assert_allclose(frame.moved(pose).to_world(material), frame.to_world(turned), rtol=0, atol=PLACE)
    np.testing.assert_allclose(frame.to_local(frame.to_world(material)), material, rtol=0, atol=PLACE)


def test_pose_written_down_is_read_back_to_the_last_bit():
    pose = Pose(x=0.1, z=-1e-9, ry=1 / 3)
    assert Pose.parse(str(pose)) == pose
    assert Pose.parse("") == Pose() and str(Pose()) == ""


def test_vectors_across_a_direction_make_an_orthonormal_right_handed_frame_with_it():
    for direction in (*np.eye(3), *-np.eye(3), *rotation_matrix(np.array([0.3, 1.0, -2.0]))):
        first, second = vectors_across(direction)
        axes = np.stack([first, second, direction])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), rtol=0, atol=ROUNDING)
        assert np.linalg.det(axes) == pytest.approx(1.0, abs=ROUNDING)
        np.testing.assert_allclose(cross_matrix(direction) @ first, np.cross(direction, first), rtol=0, atol=ROUNDING)


def test_detector_reaches_half_a_pixel_beyond_the_centres_of_its_outermost_pixels():
    axes = rotation_matrix(np.array([0.2, 0.1, -0.4]))
    grid = PlaneGrid(np.array([1.0, 2.0, 60.0]), axes[:, 0], axes[:, 1], 0.02, (7, 12))
    offset = grid.points() - grid.centre
    half_u, half_v = grid.half_size
    assert half_u == pytest.approx(np.max(offset @ grid.u) + 0.01, abs=PLACE) == pytest.approx(0.12)
    assert half_v == pytest.approx(np.max(offset @ grid.v) + 0.01, abs=PLACE) == pytest.approx(0.07)
