"""The stated error of the sums is a bound and within three times the true one: a sample of ``error_bounds.py``."""

from __future__ import annotations

import numpy as np
import pytest
from error_bounds import STOPPED, outcome, scene

from speckle_mi.field.simulation import Simulation
from speckle_mi.plan.legs import light_over, straight_on

LOOSEST = 3.0
"""Stated error over the true one that is promised; twice what is measured is stated."""


@pytest.mark.parametrize("number", [0, 1, 2, 3, 4, 6, 7, 8, 50, 86])
def test_the_stated_error_bounds_the_true_one_and_is_near_it(assemble, tmp_path, number):
    found = outcome(number, assemble, tmp_path)
    assert 1.0 <= found.ratio <= LOOSEST, found


def test_the_part_of_a_stop_that_lights_the_detector_is_where_rays_from_it_land(assemble, tmp_path):
    assembly = assemble(scene(STOPPED, np.random.default_rng(86), tmp_path, 1e-3, "auto"))
    simulation = Simulation(assembly)
    channel, = simulation.plan().channels
    onward, rim, grid = channel.onward[0], channel.openings[0], channel.grid
    x, y = np.random.default_rng(1).uniform(-1, 1, (2, 4000)) * onward.reach
    inside = np.hypot(x, y) < onward.reach
    x, y = x[inside], y[inside]
    spots = assembly.target.points.points
    landed = np.zeros(len(x), dtype=bool)
    for spot in spots[:: len(spots) // 8]:
        over = light_over(channel, None, spot[None], rim, rim.plane.frame.to_world(np.stack([x, y, 0 * x], axis=1)))
        offset = (straight_on(channel, over, None) - grid.centre) @ np.stack([grid.u, grid.v], axis=1)
        landed |= np.all(np.abs(offset) <= grid.half_size, axis=1)
    # From inside the spot light comes to what the places around it light together, up to the width of diffraction.
    assert 0.005 < np.mean(landed) < 0.5
    assert np.mean(onward.sends(x, y)[landed]) > 0.95
    assert np.mean(onward.sends(x, y)) < 4 * np.mean(landed) + 0.1
