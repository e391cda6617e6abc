"""What a plan foresees of a frame: terms of the sums, light that passes a screen by, shadows from few rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exact_optics import bench, element_xml, facing

from speckle_mi.field.simulation import Simulation
from speckle_mi.geometry.frames import Frame
from speckle_mi.plan import opening_shadows
from speckle_mi.plan.stage import SUM
from speckle_mi.propagation.chebyshev import TensorSeries, tensor_polynomials
from speckle_mi.propagation.costs import RECORDED
from speckle_mi.scene.errors import SceneError

SAME_TERMS = 0.35
"""Share by which the terms sampled for the plan may differ from those of the sum."""


def lens(z: float, focal: float, radius: float, thickness: float = 6.0):
    form = dict(radius1=focal, radius2=-focal, thickness=thickness, diameter=2 * radius, ior=1.5)
    return element_xml("lens", "lens", Frame(np.array([0.0, 0.0, z]), np.eye(3)), **form)


def stop(z: float, radius: float, outer: float):
    return element_xml("aperture", "stop", Frame(np.array([0.0, 0.0, z]), np.eye(3)), radius=radius, outer_radius=outer)


@pytest.mark.parametrize("radius, beyond, tilt, tolerance", [(6, 0, 0, 1e-3), (8, 20, 30, 1e-3), (10, 20, 30, 1e-2)])
def test_terms_of_a_sum_over_a_wide_pupil_are_known_beforehand(assemble, tmp_path, radius, beyond, tilt, tolerance):
    detector = facing(216.0 + beyond, tilt=(tilt, 0.0, 0.0))
    text = bench(tmp_path, [[0, 0, 0], [0.05, 0, 0]], detector, [lens(80.0, 50.0, radius)], pixels=(24, 18), pitch=0.02,
                 tolerance=tolerance)  # fmt: skip
    simulation = Simulation(assemble(text))
    channel, = simulation.plan().channels
    last = [stage for stage in simulation.frame().stages if stage.kind == SUM][-1].how
    assert last.ranks is not None and last.ranks[1] > 5 and last.parts == 1
    assert channel.gradients[-1].terms[1] == pytest.approx(last.ranks[1], rel=SAME_TERMS)


def test_light_past_a_screen_that_is_too_small_is_refused_beforehand_and_a_wider_one_shuts_it_out(assemble, tmp_path):
    """Spherical aberration takes rays from the lens's edge around the screen to where the paraxial image lies."""

    def planned(outer: float):
        elements = [lens(80.0, 30.0, 14.0, 8.0), stop(96.0, 0.8, outer)]
        return Simulation(assemble(bench(tmp_path, (0, 0, 0), facing(118.0), elements, pixels=(24, 18), pitch=0.02,
                                         tolerance=1e-2))).plan()  # fmt: skip

    with pytest.raises(SceneError, match="'stop' hides a part of 'lens' from every pixel.* make it wider"):
        planned(6.0)
    channel, = planned(20.0).channels
    assert channel.route.names.count("stop") == 1


def test_clearances_over_an_opening_from_few_rays_are_those_of_all(assemble, tmp_path, monkeypatch):
    elements = [lens(80.0, 50.0, 2.2), stop(95.0, 2.5, 20.0)]
    text = bench(tmp_path, (0.3, 0.1, 0), facing(140.0), elements, pixels=(24, 18), pitch=0.02)
    channel = Simulation(assemble(text)).plan().channels[0]
    rim = next(rim for rim in channel.rims if rim.is_screen)
    channel = replace(channel, openings=(rim,))
    x, y = np.random.default_rng(1).uniform(-2.5, 2.5, (2, 12_000))
    points = rim.plane.frame.to_world(np.stack([x, y, 0 * x], axis=1)[np.hypot(x, y) < 2.5])
    source = np.array([0.3, 0.1, 0.0])
    want = opening_shadows._clearance_over(channel, rim, np.broadcast_to(source, points.shape), points)
    rays, over = [], opening_shadows._clearance_over
    monkeypatch.setattr(opening_shadows, "_clearance_over", lambda *a: rays.append(len(a[3])) or over(*a))
    got = opening_shadows._clearance_at(channel, rim, source, points)
    assert sum(rays) < len(points) / 2
    assert np.array_equal(got >= 0, want >= 0) and 0 < np.mean(np.all(want >= 0, axis=0)) < 1
    assert np.allclose(got, want, atol=1e-6)


def test_few_functions_of_two_coordinates_are_the_products_of_polynomials_summed():
    random = np.random.default_rng(2)
    index = np.array([(a, 0, b) for a in range(11) for b in range(9) if a + b < 13])
    series = TensorSeries(index, random.normal(size=(len(index), 3)))
    places = random.uniform(-1, 1, (9000, 3))
    assert np.allclose(series(places), (series.coefficients.T @ tensor_polynomials(index, places)).T, atol=1e-12)


def test_a_field_on_many_nodes_costs_more_at_scattered_points_than_on_a_grid():
    nodes, points = (400, 400), 250_000
    scattered, grid = (RECORDED.interpolation(nodes, shape) for shape in ((points,), (500, 500)))
    assert scattered > 2 * points * nodes[0] * nodes[1] * RECORDED.multiply_add
    assert scattered > 100 * grid
