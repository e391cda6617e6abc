"""The judge is judged: closed forms, stigmatic surfaces, reciprocity, and two ways of evaluating one integral."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from reference_optics import Opening, Places, Way, edge_field_of, field_of
from reference_rays import Face, NoReference, ball_faces, chief, frame_along, lens_faces, rays, trace

WAVELENGTH = 632.8e-6
K = 2 * np.pi / WAVELENGTH
ORIGIN, UPRIGHT = np.zeros(3), np.eye(3)
FACING = np.diag([-1.0, 1.0, -1.0])

ROUNDING = 1e-9
"""Relative error of a sum of some 1e5 terms whose phases run to 1e6 rad in double precision, with room to spare."""

SPLIT = np.array([[0.0, 0.0], [0.1, 0.05], [-0.2, 0.1], [0.15, -0.25], [0.3, 0.02]])


def detector(z, places=SPLIT, x=0.0):
    return Places(Face(np.array([x, 0.0, z]), FACING), places)


def stop(z, *half, tilt=(0.0, 0.0), x=0.0):
    return Opening(Face(np.array([x, 0.0, z]), frame_along([*tilt, 1.0])), half)


def far(got, want):
    return np.linalg.norm(got - want) / np.linalg.norm(want)


def aimed(faces, goal, uv, source=ORIGIN):
    first = chief(source, faces, goal)
    return rays(np.tile(source, (len(uv), 1)), faces, goal, uv, np.tile(first, (len(uv), 1)))


@pytest.mark.parametrize("half", [(0.4,), (0.3, 0.5)])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.2, -0.1)])
def test_a_hole_summed_over_its_area_and_along_its_edge_is_the_same(half, tilt):
    hole, screen = stop(20.0, *half, tilt=tilt, x=0.1), detector(45.0, x=0.2)
    source = np.array([0.05, -0.02, 0.0])
    area, own = field_of([Way(source, [[], []], [hole], screen)], WAVELENGTH)
    edge, other = edge_field_of(source, hole, screen.face.points(screen.uv), WAVELENGTH)
    assert max(own, other) < ROUNDING
    assert far(area, edge) < ROUNDING


@pytest.mark.parametrize("radius, before, behind", [(0.3, 20.0, 30.0), (0.005, 1000.0, 20.0), (0.02, 0.5, 2.0)])
def test_the_axis_of_a_round_hole_is_a_single_integral(radius, before, behind):
    way = Way(ORIGIN, [[], []], [stop(before, radius)], detector(before + behind, np.zeros((1, 2))))
    got = field_of([way], WAVELENGTH)[0][0]
    with mpmath.workdps(30):
        k = 2 * mpmath.pi / mpmath.mpf(WAVELENGTH)

        def ring(square):
            r, s = mpmath.sqrt(before**2 + square), mpmath.sqrt(behind**2 + square)
            return mpmath.exp(1j * k * (r + s - before - behind)) / (r * s) * behind / s * (1 + 1j / (k * s))

        edges = mpmath.linspace(0, mpmath.mpf(radius) ** 2, 30)
        want = mpmath.quad(ring, edges) * mpmath.pi / (1j * mpmath.mpf(WAVELENGTH))
        want = complex(want * mpmath.exp(1j * k * (before + behind)))
    assert abs(got / want - 1) < 1e-7  # of a path of 1 m, double precision's last place is 1e-9 rad


def test_a_plane_mirror_shows_an_image_of_the_source():
    mirror = Face(np.array([0.0, 0.0, 40.0]), frame_along([1.0, 0.0, -1.0]), after=None, reach=25.0)
    axes = frame_along([1.0, 0.0, 0.0])
    hole = Opening(Face(np.array([20.0, 0.0, 40.0]), axes), (0.5,))
    screen = Places(Face(np.array([60.0, 0.0, 40.0]), axes), SPLIT)
    folded = field_of([Way(ORIGIN, [[mirror], []], [hole], screen)], WAVELENGTH)[0]
    image = field_of([Way(np.array([-40.0, 0.0, 40.0]), [[], []], [hole], screen)], WAVELENGTH)[0]
    assert far(folded, image) < ROUNDING


def test_a_plate_on_the_axis_is_longer_and_nearer_by_the_textbook():
    index, thickness = 1.5, 3.0
    plate = lens_faces((0, 0, 20.0), UPRIGHT, 0, 0, thickness, index)
    found = aimed(plate, Face(np.array([0, 0, 50.0]), UPRIGHT), np.zeros((1, 2)))
    assert found.length[0] == pytest.approx(50 + (index - 1) * thickness, abs=1e-12)
    assert found.amplitude[0] == pytest.approx(1 / (50 - thickness + thickness / index), rel=1e-12)


def test_light_from_an_ellipsoid_s_far_focus_leaves_the_glass_as_a_plane_wave():
    index, focal = 1.5, 60.0
    radius = focal * (index - 1) / index
    back = [Face(np.array([0, 0, focal]), UPRIGHT, -1 / radius, -1 / index**2, index, 1.0)]
    found = aimed(back, Face(np.array([0, 0, focal + 5.0]), UPRIGHT), SPLIT * 10)
    assert np.ptp(found.length) < 1e-12
    d = trace(np.zeros((len(SPLIT), 3)), found.direction, back)[1]
    assert np.allclose(d, [0, 0, 1], atol=1e-14)


def test_an_ellipsoidal_mirror_joins_its_foci_and_turns_the_sign_beyond():
    major, eccentricity = 100.0, 0.4
    focus = major * eccentricity
    radius = major * (1 - eccentricity**2)
    # Vertex at +z; the centre of curvature lies on the inside. The source is in the far focus.
    mirror = Face(np.array([0, 0, focus + major]), np.diag([1.0, -1.0, -1.0]), 1 / radius, -eccentricity**2, 1.0, None)
    source = np.array([0.0, 0.0, 0.0])
    directions = np.array([[0.1, 0.0, 1.0], [0.0, 0.3, 1.0], [-0.2, 0.2, 1.0]])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    p, d, length, _ = trace(np.tile(source, (3, 1)), directions, [mirror])
    other = np.array([0.0, 0.0, 2 * focus])
    assert np.allclose(length + np.linalg.norm(other - p, axis=1), 2 * major, atol=1e-12)
    beyond = Face(np.array([0, 0, focus]), np.diag([1.0, -1.0, -1.0]))
    before = Face(np.array([0, 0, 2 * focus + 10]), np.diag([1.0, -1.0, -1.0]))
    places = np.array([[3.0, 1.0], [-2.0, 4.0]])
    assert np.all(aimed([mirror], beyond, places).focal_lines == 2)
    assert np.all(aimed([mirror], before, places / 4).focal_lines == 0)


def test_light_folded_by_a_sphere_has_one_focal_line_behind_it_between_its_two():
    mirror = Face(np.array([0, 0, 50.0]), frame_along([np.sin(0.5), 0, -np.cos(0.5)]), 1 / 40.0, 0.0, 1.0, None, 2.0)
    d = trace(ORIGIN[None], np.array([[0.0, 0.0, 1.0]]), [mirror])[1][0]
    # Coddington: 1/s + 1/s' = 2/(R cos) across, 2 cos/R along; one image at either side of this distance.
    cosine = np.cos(0.5)
    tangential = 1 / (2 / (40 * cosine) - 1 / 50)
    sagittal = 1 / (2 * cosine / 40 - 1 / 50)
    for share, lines in ((0.5, 0), (1.5, 2)):
        place = np.array([0, 0, 50.0]) + d * share * (tangential if lines == 0 else sagittal)
        assert aimed([mirror], Face(place, frame_along(d)), np.zeros((1, 2))).focal_lines[0] == lines
    place = np.array([0, 0, 50.0]) + d * (tangential + sagittal) / 2
    assert aimed([mirror], Face(place, frame_along(d)), np.zeros((1, 2))).focal_lines[0] == 1


PARAXIAL = 3e-4
"""Rayleigh and Sommerfeld's integral has the cosine on one side only; of angles of 0.01 rad and less."""


def test_two_holes_are_the_same_from_either_end():
    one, two, end = stop(20.0, 0.08), stop(50.0, 0.1), 90.0
    there = field_of([Way(ORIGIN, [[], [], []], [one, two], detector(end, SPLIT))], WAVELENGTH)[0]
    for value, x in zip(there, detector(end, SPLIT).face.points(SPLIT), strict=True):
        back = Way(x, [[], [], []], [two, one], Places(Face(ORIGIN, UPRIGHT), np.zeros((1, 2))))
        assert abs(field_of([back], WAVELENGTH)[0][0] - value) < PARAXIAL * np.abs(there).max()


def test_a_stop_and_a_lens_are_the_same_from_either_end():
    hole = stop(20.0, 0.2)
    lens = lens_faces((0, 0, 30.0), UPRIGHT, 40.0, -40.0, 4.0, 1.5)
    reverse = [Face(f.vertex, f.axes, f.curvature, f.conic, f.after, f.before) for f in lens[::-1]]
    places = detector(90.0, SPLIT)
    there = field_of([Way(ORIGIN, [[], lens], [hole], places)], WAVELENGTH)[0]
    for value, x in zip(there, places.face.points(SPLIT), strict=True):
        back = Way(x, [reverse, []], [hole], Places(Face(ORIGIN, UPRIGHT), np.zeros((1, 2))))
        assert abs(field_of([back], WAVELENGTH)[0][0] - value) < PARAXIAL * np.abs(there).max()


def test_the_rim_of_a_lens_and_a_hole_in_the_plane_behind_it_make_the_same_image():
    radius, index = 2.0, 1.5151
    front, back = lens_faces((0, 0, 100.0), UPRIGHT, 0, -20.0, 1.0, index)
    image = 101 + 1 / ((index - 1) / 20 - 1 / 100.0)
    places = detector(image, SPLIT * 0.05)
    rim = field_of([Way(ORIGIN, [[front], []], [Opening(back, (radius,))], places)], WAVELENGTH)[0]
    edge = back.points(np.array([[radius, 0.0]]))
    found = aimed([front], Face(back.vertex, UPRIGHT, back.curvature, 0, index, 1.0), np.array([[radius, 0.0]]))
    p, d, _, _ = trace(ORIGIN[None], found.direction, [front, back])
    plane = 101.0
    beside = p[0] + d[0] * (plane - p[0, 2]) / d[0, 2]
    hole = stop(plane, float(beside[0]))
    flat = field_of([Way(ORIGIN, [[front, back], []], [hole], places)], WAVELENGTH)[0]
    assert abs(edge[0, 0] - radius) < 1e-12
    assert far(rim, flat) < 1e-4  # what it means to say of a thick rim that it is in one plane or the other


def test_several_rays_are_refused():
    # Behind a ball and before its paraxial image the marginal light has crossed the axis already.
    ball = ball_faces((0, 0, 30.0), 10.0, (0, 0, 1.0), 1.5168)
    with pytest.raises(NoReference, match="several"):
        field_of([Way(ORIGIN, [ball], [], detector(52.0, SPLIT))], WAVELENGTH)
