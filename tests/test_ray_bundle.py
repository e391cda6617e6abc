"""First-order theory from the rays that meet at a place, against the closed forms that hold in special cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from speckle_mi import theory
from speckle_mi.experiments.chief_ray import launch_to, opening_middle
from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.field.simulation import plan_of
from speckle_mi.geometry.rotation import vectors_across
from speckle_mi.optics.sequence import Sequence, detector_plane
from speckle_mi.optics.trace import trace
from speckle_mi.theory.bundle import bundle_displacement

SMALL_SPOT = 1e-5
"""Agreement with a closed form for a point [1], of a spot of 1e-4 of the distance: its square, less rounding."""

SMALL_STOP = 5e-3
"""Agreement with the optics of one chief ray, relative to the largest entry: what aberrations are left
over a stop and a spot that are a tenth and less of those shipped."""


def _unit(vector):
    return vector / np.linalg.norm(vector)


def _rotated(random):
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


@pytest.mark.parametrize("seed", range(5))
def test_rays_of_a_small_spot_in_free_space_move_the_pattern_as_the_closed_form_says(seed):
    """Everything tilted; the light comes from a point in front of the surface or goes to one behind it."""
    random = np.random.default_rng(seed)
    axes = _rotated(random)
    origin, spot = random.normal(size=(2, 3))
    to_source, sight = (_unit(axes[:, 2] + 0.4 * random.normal(size=3)) for _ in range(2))
    facing = vectors_across(_unit(sight + 0.4 * random.normal(size=3)))
    radius, detector = 40.0 * (-1) ** seed, spot + 60 * sight
    points = spot + 1e-3 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]) @ axes[:, :2].T
    light, to_detector = points - (spot + radius * to_source), detector - points
    light *= np.sign(radius) / np.linalg.norm(light, axis=1, keepdims=True)
    launch = to_detector / np.linalg.norm(to_detector, axis=1, keepdims=True)
    motions = [np.broadcast_to(axis, points.shape) for axis in axes.T]
    motions += [np.cross(axis, points - origin) for axis in axes.T]
    changes = np.stack([np.sum((light - launch) * motion, axis=1) for motion in motions], axis=1)
    found = bundle_displacement((launch @ facing.T)[None], changes[None], np.ones((1, 4)))
    expected = theory.first_order_displacement(spot, origin, axes, to_source, radius, detector, *facing)
    np.testing.assert_allclose(found, expected, atol=SMALL_SPOT * np.abs(expected).max())


def test_light_of_one_ray_and_no_light_have_no_pattern():
    slopes, changes = np.ones((1, 3, 2)), np.ones((1, 3, 6))
    assert bundle_displacement(slopes, changes, np.zeros((1, 3))) is None
    assert bundle_displacement(slopes, changes, np.ones((1, 3))) is None


def test_places_count_by_the_square_of_their_light_and_the_displacement_may_change_over_them():
    random = np.random.default_rng(1)
    places, slopes = random.uniform(-2, 2, (9, 2)), random.normal(size=(9, 40, 2))
    moved = np.array([0.7, -0.3]) + places @ np.array([[0.2, -0.1], [0.05, 0.3]])
    changes = -np.einsum("mnd,md->mn", slopes, moved)[..., None]
    weights = random.uniform(0.1, 1, (9, 40))
    np.testing.assert_allclose(bundle_displacement(slopes, changes, weights, places)[:, 0], [0.7, -0.3], atol=1e-12)
    changes[8] += 5.0 * slopes[8, :, :1]
    weights[8] *= 1e-6
    np.testing.assert_allclose(bundle_displacement(slopes, changes, weights, places)[:, 0], [0.7, -0.3], atol=1e-9)


def of_one_chief_ray(assembly):
    """(2, 6) [mm/mm, mm/deg] by ``theory.system_displacement``, with the chief ray's own magnification and lever."""
    channel, = plan_of(assembly).channels
    spot, grid, step = assembly.spot, channel.grid, 1e-4
    sight = launch_to(channel, spot.point[None], opening_middle(channel))[0]
    across = vectors_across(sight)
    steps = step * np.concatenate([across, -across])
    system = Sequence((*channel.interactions, detector_plane(grid)))
    plane = np.stack([grid.u, grid.v], axis=1)
    held = np.broadcast_to(spot.point, (4, 3)), np.broadcast_to(sight, (4, 3))
    moved = trace(system, held[0] + steps, held[1]).points[-1] @ plane
    tilted = trace(system, held[0], held[1] + steps).points[-1] @ plane
    magnification, lever = (((ends[:2] - ends[2:]) / (2 * step)).T for ends in (moved, tilted))
    frame, beam = assembly.target.frame, assembly.beam
    return theory.per_degree(theory.system_displacement(
        spot.point, frame.origin, frame.axes, beam.directions_to_source(spot.point[None])[0],
        beam.wavefront_at(spot.point)[0][0], sight, across, magnification, lever, spot.normal,
    ))  # fmt: skip


def displaced(assembly, x):
    """The assembly with the laser moved, so that the spot lies off the optics' axis, and the detector where it images.

    The light of a small spot is bent over it, so that its middle counts.
    """
    beam, shift = assembly.beam, np.array([x, 0.0, 0.0])
    moved = replace(assembly, beam=replace(beam, origin=beam.origin + shift, reference=beam.reference + shift))
    for _ in range(2):  # which opening limits the light is known where there is light
        channel, = plan_of(moved).channels
        sight = launch_to(channel, moved.spot.point[None], opening_middle(channel))
        system, grid = Sequence((*channel.interactions, detector_plane(channel.grid))), moved.detector
        landing = trace(system, moved.spot.point[None], sight).points[-1, 0]
        moved = replace(moved, detector=replace(grid, origin=grid.origin + landing - grid.centre))
    return moved


SYSTEMS = {
    "camera out of focus": ("imaging_defocused", {"stop_radius": 0.1, "beam_radius": 0.03}, 0.0),
    "camera out of focus, off its axis": ("imaging_defocused", {"stop_radius": 0.1, "beam_radius": 0.03}, 3.0),
    "telecentric, off its axis": ("telecentric", {"stop_radius": 0.05, "beam_radius": 0.03}, 2.0),
    "ball lens, off its axis": ("ball_lens", {"stop_radius": 0.02, "beam_radius": 0.01}, 0.2),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_of_a_small_spot_behind_a_small_stop_the_rays_move_the_pattern_as_the_one_chief_ray_s_optics(shipped, name):
    scene, defaults, x = SYSTEMS[name]
    assembly = displaced(shipped(scene, **defaults), x)
    found, expected = expected_sensitivity(assembly), of_one_chief_ray(assembly)
    for columns in (slice(0, 3), slice(3, 6)):
        allowed = SMALL_STOP * max(np.abs(expected[:, columns]).max(), 0.05)
        np.testing.assert_allclose(np.stack([found["u"], found["v"]])[:, columns], expected[:, columns], atol=allowed)
