"""Second derivatives of the path over a plane against differences of aimed paths, and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from optical_systems import SYSTEMS, frame

from speckle_mi.optics.aim import aim
from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.wavefront import arriving_curvature, leaving_curvature

STEP = 0.02
"""Of the differences [mm]: they are off by its fourth power, and paths are rounded by 1e-14 of theirs."""

DIFFERENCES = 1e-8
"""Second differences over STEP of paths of 100 mm in double precision [1/mm]."""


def differences(path):
    """(2, 2) second differences of a function of places in a plane, fourth order."""
    weights = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    seconds = {-2: -1 / 12, -1: 4 / 3, 0: -5 / 2, 1: 4 / 3, 2: -1 / 12}
    h = STEP
    xx = sum(w * path(k * h, 0) for k, w in seconds.items()) / h**2
    yy = sum(w * path(0, k * h) for k, w in seconds.items()) / h**2
    xy = sum(a * b * path(i * h, j * h) for i, a in weights.items() for j, b in weights.items()) / h**2
    return np.array([[xx, xy], [xy, yy]])


@pytest.mark.parametrize("name", ["biconvex", "asphere", "meniscus tilted", "two lenses", "concave mirror"])
def test_arriving_wavefront_bends_as_the_paths_to_neighbouring_places_say(name):
    sequence, source = Sequence(SYSTEMS[name]), np.array([0.3, -0.2, 0.0])
    plane = sequence.last.surface.frame
    start = aim(sequence, source[None], plane.to_world(np.array([[0.8, -0.5, 0.0]])))

    def path(x, y):
        place = plane.to_world(np.array([[0.8 + x, -0.5 + y, 0.0]]))
        return aim(sequence, source[None], place, start.launch).optical_path_length[0]

    found = arriving_curvature(sequence, source, start.launch[0])
    np.testing.assert_allclose(found, differences(path), rtol=0, atol=DIFFERENCES)


@pytest.mark.parametrize("name", ["biconvex", "asphere", "meniscus tilted", "two lenses", "concave mirror"])
def test_leaving_wavefront_bends_as_the_paths_from_neighbouring_places_say(name):
    sequence, plane = Sequence(SYSTEMS[name]), frame(rotation=(0.12, -0.2, 0.05))
    target = sequence.last.surface.frame.to_world(np.array([[0.8, -0.5, 0.0]]))
    start = aim(sequence, plane.origin[None], target)

    def path(x, y):
        place = plane.to_world(np.array([[x, y, 0.0]]))
        return aim(sequence, place, target, start.launch).optical_path_length[0]

    found = leaving_curvature(sequence, plane, plane.origin, start.launch[0])
    np.testing.assert_allclose(found, differences(path), rtol=0, atol=DIFFERENCES)


def test_in_free_space_both_bend_as_spheres_around_the_other_end():
    place, end = np.array([3.0, -1.0, 0.0]), np.array([1.0, 2.0, 40.0])
    plane, there = frame(x=3.0, y=-1.0), frame(x=1.0, y=2.0, z=40.0)
    ray, length = (end - place) / np.linalg.norm(end - place), np.linalg.norm(end - place)
    sphere = (np.eye(3) - np.outer(ray, ray))[:2, :2] / length
    onward = Sequence((Interaction.through(Surface(there)),))
    np.testing.assert_allclose(leaving_curvature(onward, plane, place, ray), sphere, rtol=0, atol=1e-15)
    np.testing.assert_allclose(arriving_curvature(onward, place, ray), sphere, rtol=0, atol=1e-15)
