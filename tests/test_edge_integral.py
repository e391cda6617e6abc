"""Diffraction along an opening's edge is the integral over its area, however wide the opening is."""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import bench, element_xml, facing, rendered
from reference_optics import Opening, Places, Way, field_of
from reference_rays import Face, frame_along
from scipy.special import fresnel

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.outline import Circle, Rectangle
from speckle_mi.geometry.plane import PlaneGrid, PlanePoints
from speckle_mi.propagation.coherent_sum import ALONG_EDGE
from speckle_mi.propagation.edge_integral import edge_sum

WAVELENGTH = 632.8e-6
AXES = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
ROUNDING = 1e-8
"""Relative error of two integrals over phases of 1e6 rad in double precision, with room to spare."""


def outline_of(half):
    return Circle(half[0]) if len(half) == 1 else Rectangle(*half)


def relative(got, want):
    return np.linalg.norm(got - want) / np.linalg.norm(want)


@pytest.mark.parametrize("half", [(0.35,), (0.2, 0.4)])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.3, -0.2), (1.5, 0.4)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_along_the_edge_is_over_the_area(mitsuba, half, tilt, side):
    """Several sources, an opening facing either way, pixels in light and shadow: Rayleigh and Sommerfeld's integral."""
    axes = frame_along(np.array([*tilt, 1.0])) @ np.diag([1.0, side, side])
    frame = Frame(np.array([0.05, 0.0, 20.0]), axes)
    sources = np.array([[0.0, 0.0, 0.0], [0.1, -0.05, 0.02]])
    weights = np.array([1.0, -0.4 + 0.7j])
    grid = PlaneGrid(np.array([-0.9, -0.8, 45.0]), *AXES, 0.3, (6, 7))
    found = edge_sum(outline_of(half), frame, sources, weights, grid, WAVELENGTH)
    screen = Places(Face(grid.origin, np.eye(3)), (grid.points() - grid.origin)[:, :2])
    hole = Opening(Face(frame.origin, axes), half)
    ways = [field_of([Way(source, [[], []], [hole], screen)], WAVELENGTH) for source in sources]
    want = sum(weight * field for weight, (field, _) in zip(weights, ways, strict=True))
    assert max(own for _, own in ways) < ROUNDING
    assert relative(found.field.ravel(), want) < ROUNDING
    assert relative(found.field.ravel(), want) < found.numerical_error + ROUNDING


@pytest.mark.parametrize("half", [(5.0,), (5.0, 4.0)])
def test_across_the_edge_of_the_light_the_field_is_fresnels(mitsuba, half):
    """Points before, exactly on and behind the edge of the light of a wide opening: Fresnel's integral of an edge."""
    before, behind = 500.0, 300.0
    frame = Frame(np.array([0.0, 0.0, before]), np.eye(3))
    edge = 5.0 * (before + behind) / before
    beside = np.array([-0.2, -0.01, -1e-6, 0.0, 1e-9, 1e-4, 0.01, 0.2])
    target = PlanePoints(np.array([0.0, 0.0, before + behind]), *AXES, edge + beside, np.zeros(len(beside)))
    found = edge_sum(outline_of(half), frame, np.zeros((1, 3)), np.ones(1, complex), target, WAVELENGTH)
    v = -beside * np.sqrt(2 * before / (WAVELENGTH * behind * (before + behind)))
    sine, cosine = fresnel(v)
    want = np.abs((0.5 + cosine) + 1j * (0.5 + sine)) / np.sqrt(2)
    distance = np.linalg.norm(target.points(), axis=1)
    # The far edges add a hundredth; a circle's bend less.
    np.testing.assert_allclose(np.abs(found.field) * distance, want, atol=0.03)
    # Continuous through the edge, where straight light ends and the edge's wave jumps.
    amplitude = found.field * distance * np.exp(-2j * np.pi / WAVELENGTH * (distance - distance[3]))
    assert np.all(np.abs(np.diff(amplitude[2:5])) < 1e-4)


def test_a_stop_of_many_zones_before_a_wide_detector_takes_a_line(assemble, tmp_path):
    """5 mm, 20 mm before 8 mm of detector, would take 10^8 places over its area."""
    stop = element_xml("aperture", "stop", Frame(np.array([0.0, 0, 20]), np.eye(3)), radius=5.0, outer_radius=20.0)
    _, frame, _ = rendered(assemble, bench(tmp_path, [[0.0, 0.0, 0.0]], facing(40.0), [stop], pitch=0.4))
    assert [stage.how.kind for stage in frame.stages if stage.how is not None] == [ALONG_EDGE]
    assert frame.numerical_error < 1e-6
