"""Paraxial optics: focal lengths, images and pupils against the lensmaker's equation and rays that are followed."""

from __future__ import annotations

import numpy as np
import pytest

from speckle_mi.theory import paraxial

BICONVEX = [(1 / 50, 5.0, 1.5151), (-1 / 50, 0.0, 1.0)]


def test_thick_lens_has_the_focal_length_of_the_lensmaker():
    matrix = paraxial.system_matrix(BICONVEX)
    points = paraxial.cardinal_points(matrix)
    n = 1.5151
    power = (n - 1) * (2 / 50 - (n - 1) * 5 / (n * 50 * 50))
    np.testing.assert_allclose(points.focal_length, 1 / power, rtol=1e-12)
    np.testing.assert_allclose(points.rear_focus, (1 - (n - 1) * 5 / (n * 50)) / power, rtol=1e-12)
    front = [points.front_focus, points.front_principal]
    np.testing.assert_allclose(front, [-points.rear_focus, -points.rear_principal])
    assert abs(np.linalg.det(matrix) - 1) < 1e-14


def test_image_of_the_principal_planes_is_upright_and_of_twice_the_focal_length_inverted():
    matrix = paraxial.system_matrix(BICONVEX)
    points = paraxial.cardinal_points(matrix)
    distance, magnification = paraxial.paraxial_image(matrix, 2 * points.focal_length - points.front_principal)
    np.testing.assert_allclose([distance, magnification], [2 * points.focal_length + points.rear_principal, -1])
    distance, magnification = paraxial.paraxial_image(matrix, -points.front_principal)
    np.testing.assert_allclose([distance, magnification], [points.rear_principal, 1], atol=1e-12)
    with pytest.raises(ValueError, match="infinity"):
        paraxial.paraxial_image(matrix, -points.front_focus)


def test_paraxial_image_is_where_two_rays_through_a_skew_system_meet():
    surfaces = [(0.01, 3.0, 1.6), (-0.03, 7.0, 1.2), (0.02, 2.0, 1.33)]
    n, n_image, before = 1.1, 1.33, 120.0
    matrix = paraxial.system_matrix(surfaces, n)
    distance, magnification = paraxial.paraxial_image(matrix, before, n, n_image)
    for angle in (-0.1, 0.0, 0.2):
        height, index = 1.0 + before * angle, n
        for curvature, gap, behind in surfaces:  # Refraction n' u' = n u - y (n' - n) c, then straight on.
            angle = (index * angle - height * (behind - index) * curvature) / behind
            height, index = height + gap * angle, behind
        np.testing.assert_allclose(height + distance * angle, magnification, rtol=1e-12)


def test_pupils_are_the_images_of_the_stop():
    front = paraxial.system_matrix([*BICONVEX[:1], (-1 / 50, 8.0, 1.0)])
    focal = paraxial.cardinal_points(paraxial.system_matrix(BICONVEX)).focal_length
    position, radius = paraxial.entrance_pupil(front, 2.0)
    distance, magnification = paraxial.paraxial_image(front, -position)
    np.testing.assert_allclose([distance, radius * abs(magnification)], [0, 2.0], atol=1e-12)
    assert position > 8
    assert paraxial.exit_pupil(np.eye(2), 2.0) == (0.0, 2.0)
    thin_lens_in_its_focus = np.array([[0.0, focal], [-1 / focal, 1.0]])
    assert paraxial.entrance_pupil(thin_lens_in_its_focus, 2.0) == (np.inf, np.inf)
    behind = paraxial.system_matrix([(0.0, 10.0, 1.0), *BICONVEX])
    position, radius = paraxial.exit_pupil(behind, 2.0)
    distance, magnification = paraxial.paraxial_image(behind, 0.0)
    np.testing.assert_allclose([position, radius], [distance, 2.0 * abs(magnification)])


def test_afocal_system_has_no_cardinal_points_but_an_image():
    thin = lambda power: np.array([[1.0, 0.0], [-power, 1.0]])  # noqa: E731
    telescope = thin(0.25) @ np.array([[1.0, 6.0], [0.0, 1.0]]) @ thin(0.5)  # Exact in binary: f = 2 and 4.
    with pytest.raises(ValueError, match="afocal"):
        paraxial.cardinal_points(telescope)
    assert paraxial.paraxial_image(telescope, 2.0) == (4.0, -2.0)
