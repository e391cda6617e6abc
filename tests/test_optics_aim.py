"""Rays aimed at their targets, their tubes and caustics, against traced rays, closed forms and diffraction sums."""

from __future__ import annotations

import numpy as np
import pytest
from optical_systems import INDEX, PATH_TOLERANCE, SYSTEMS, ball, frame, lens, mp_trace, plane

from speckle_mi.geometry.frames import Frame
from speckle_mi.optics.aim import aim
from speckle_mi.geometry.outline import Circle
from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.trace import RayStatus, trace

AIMED = {
    "biconvex": 4.0,
    "plano-convex": 4.0,
    "convex-plano": 4.0,
    "asphere": 4.0,
    "asphere reversed": 4.0,
    "meniscus tilted": 6.0,
    "two lenses": 2.0,
    "concave mirror": 5.0,
}


@pytest.mark.parametrize("name", AIMED)
def test_aimed_ray_passes_through_its_target_with_the_traced_path(name):
    sequence = Sequence(SYSTEMS[name])
    rng = np.random.default_rng(12)
    n, half = 300, AIMED[name]
    sources = rng.uniform(-0.5, 0.5, (n, 3))
    middle = trace(sequence, np.zeros((1, 3)), [[0.0, 0.0, 1.0]]).points[-1, 0]
    local = sequence.last.surface.frame.to_local(middle[None]) + np.column_stack(
        [rng.uniform(-half, half, (n, 2)), np.zeros(n)]
    )
    targets = sequence.last.surface.frame.to_world(local)
    aimed = aim(sequence, sources, targets)
    assert aimed.converged.all()
    traced = trace(sequence, sources, aimed.launch)
    np.testing.assert_allclose(traced.points[-1], targets, rtol=0, atol=1e-11)
    np.testing.assert_allclose(traced.directions, aimed.arrival, rtol=0, atol=1e-13)
    np.testing.assert_allclose(aimed.optical_path_length, traced.optical_path_length, rtol=0, atol=PATH_TOLERANCE)


def test_gradient_of_the_aimed_path_is_the_arrival_direction():
    # The eikonal equation: grad L = n d, so path lengths of neighbouring targets are consistent with the rays.
    sequence = Sequence(SYSTEMS["asphere"])
    targets = np.array([[1.0, -2.0, 100.0], [-3.0, 0.5, 100.0]])
    sources = np.array([[0.3, 0.1, 0.0], [-0.2, 0.4, 0.1]])
    h = 1e-3
    path = lambda shift: aim(sequence, sources, targets + shift).optical_path_length  # noqa: E731
    centre = aim(sequence, sources, targets)
    for axis in (0, 1):
        e = np.eye(3)[axis] * h
        slope = (8 * (path(e) - path(-e)) - (path(2 * e) - path(-2 * e))) / (12 * h)
        np.testing.assert_allclose(slope, centre.arrival[:, axis], rtol=0, atol=1e-10)


@pytest.mark.parametrize("name, radius", [("biconvex", 3.0), ("convex-plano", 3.0), ("asphere", 3.0)])
def test_energy_in_the_ray_tube_is_the_solid_angle_it_left_in(name, radius):
    sequence = Sequence(SYSTEMS[name])
    node, weight = np.polynomial.legendre.leggauss(24)
    r, w = 0.5 * radius * (node + 1.0), 0.5 * radius * weight
    targets = np.column_stack([r, 0 * r, np.full(r.size, 100.0)])
    aimed = aim(sequence, np.zeros_like(targets), targets)
    power = (2 * np.pi * r * w * aimed.amplitude**2 * aimed.arrival[:, 2]).sum()
    rim = aim(sequence, np.zeros((1, 3)), np.array([[radius, 0.0, 100.0]]))
    sine = np.hypot(*rim.launch[0, :2])
    solid_angle = 2 * np.pi * sine**2 / (1.0 + rim.launch[0, 2])
    assert power == pytest.approx(solid_angle, rel=1e-9)


def test_ball_lens_is_aimed_through_up_to_large_angles():
    sequence = Sequence((*ball(20.0, 5.0, 1.5), plane(26.0)))
    rng = np.random.default_rng(13)
    sources = rng.uniform(-0.3, 0.3, (400, 3)) * [1, 1, 0.1]
    height = trace(sequence, np.zeros((1, 3)), [[0.1, 0.0, 1.0]]).points[-1, 0, 0]
    assert height > 0.5
    angle, r = rng.uniform(0, 2 * np.pi, 400), height * np.sqrt(rng.random(400))
    targets = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(400, 26.0)])
    aimed = aim(sequence, sources, targets)
    assert aimed.converged.all()
    exact = np.array([mp_trace(sequence, s, d)[:2][0] for s, d in zip(sources[:5], aimed.launch[:5])])
    np.testing.assert_allclose(aimed.optical_path_length[:5], exact, rtol=0, atol=PATH_TOLERANCE)


def test_unreachable_target_is_reported_and_the_others_are_not_disturbed():
    sequence = Sequence((*ball(20.0, 5.0, 1.5), plane(26.0)))
    targets = np.array([[0.5, 0.0, 26.0], [30.0, 0.0, 26.0]])
    aimed = aim(sequence, np.zeros((2, 3)), targets)
    assert aimed.converged.tolist() == [True, False]
    assert np.isnan(aimed.optical_path_length[1]) and np.isfinite(aimed.optical_path_length[0])
    assert aimed.caustics[1] == -1


def lit_through_a_stop(stop_radius: float, stop_z: float, lens_pair, end: float, source, rng):
    """Sequence of stop, lens and plane at ``end``, and the launch directions (n, 3) of rays through the stop."""
    stop = Interaction.through(Surface(frame(stop_z), outline=Circle(stop_radius)))
    rims = [
        Interaction.refract(Surface(i.surface.frame, i.surface.curvature, i.surface.conic, Circle(10.0)),
                            i.index_before, i.index_after)
        for i in lens_pair
    ]  # fmt: skip
    angle, r = rng.uniform(0.0, 2 * np.pi, 200), 0.999 * stop_radius * np.sqrt(rng.random(200))
    direction = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(200, stop_z)]) - source
    return Sequence((stop, *rims, plane(end))), direction / np.linalg.norm(direction, axis=1, keepdims=True)


def assert_bulk_equals_single(sequence: Sequence, sources, targets, bulk, rows):
    for i in rows:
        single = aim(sequence, sources[i : i + 1], targets[i : i + 1])
        assert (single.status[0], single.caustics[0]) == (bulk.status[i], bulk.caustics[i])
        np.testing.assert_allclose(
            single.optical_path_length[0], bulk.optical_path_length[i], rtol=0, atol=PATH_TOLERANCE
        )


@pytest.mark.parametrize("end", [190.0, 195.0, 198.0, 202.0])
def test_pixels_around_the_image_of_a_spot_are_lit_by_the_rays_through_the_stop(end):
    # Spherical aberration brings rays from far outside the stop to the same pixels; these must not be taken instead.
    source, rng = np.array([-0.085, 0.108, 0.0]), np.random.default_rng(14)
    sequence, launch = lit_through_a_stop(2.0, 98.0, lens(100.0, 0.02, -0.02, 5.0), end, source, rng)
    sources = np.tile(source, (576, 1))
    side = (np.arange(24) - 11.5) * 8e-3
    x, y = (m.ravel() for m in np.meshgrid(side, side))
    pixels = np.column_stack([x, y, np.full(576, end)])
    bulk = aim(sequence, sources, pixels)
    assert bulk.converged.all()
    assert_bulk_equals_single(sequence, sources, pixels, bulk, range(0, 576, 23))
    # The lit pixels are those within the patch that the traced rays make.
    patch = trace(sequence, sources[:200], launch).points[-1, :, :2]
    centre = trace(sequence, sources[:1], [[0.0, 0.0, 98.0] - source]).points[-1, 0, :2]
    inside = np.hypot(*(pixels[:, :2] - centre).T) < 0.9 * np.hypot(*(patch - centre).T).max()
    assert (bulk.status[inside] == RayStatus.OK).all()


@pytest.mark.parametrize("seed", range(8))
def test_ray_traced_through_the_stop_is_found_again_near_a_focus(seed):
    rng = np.random.default_rng(seed)
    z, source = rng.uniform(90.0, 160.0), rng.uniform(-0.3, 0.3, 3)
    curved = lens(
        z, 1 / rng.uniform(25.0, 60.0), -1 / rng.uniform(25.0, 60.0), rng.uniform(3.0, 6.0), k1=rng.uniform(-1.0, 1.0),
        rotation=(*rng.uniform(-0.1, 0.1, 2), 0.0),
    )  # fmt: skip
    near_axis = np.array([[0.0, 0.0, z], [1e-3, 0.0, z]]) - source
    close = trace(Sequence((*curved, plane(z + 7.0))), np.tile(source, (2, 1)), near_axis)
    slopes = close.directions[:, 0] / close.directions[:, 2]
    to_focus = -(close.points[-1, 1, 0] - close.points[-1, 0, 0]) / (slopes[1] - slopes[0])
    assert to_focus > 0.0
    # Within the range in which the outer zones' aberration folds the wavefront back onto the lit patch.
    end = z + 7.0 + to_focus * (1.0 + rng.choice([-0.08, -0.05, 0.05, 0.08]))
    sequence, launch = lit_through_a_stop(rng.uniform(0.5, 2.0), z - 2.0, curved, end, source, rng)
    sources = np.tile(source, (200, 1))
    traced = trace(sequence, sources, launch)
    assert traced.valid.all()
    patch = traced.points[-1]
    again = aim(sequence, sources, patch)
    np.testing.assert_allclose(again.launch, launch, rtol=0, atol=1e-9)  # 1e-8 mm at the target, magnified by the focus
    np.testing.assert_allclose(again.optical_path_length, traced.optical_path_length, rtol=0, atol=PATH_TOLERANCE)
    # A larger detector: the same holds for what is shadowed.
    centre, width = patch.mean(axis=0), np.ptp(patch, axis=0)[:2].max()
    targets = centre + rng.uniform(-width, width, (200, 3)) * [1.0, 1.0, 0.0]
    sources = sources + rng.uniform(-0.05, 0.05, (200, 3)) * [1.0, 1.0, 0.0]
    bulk = aim(sequence, sources, targets)
    assert {RayStatus.OK, RayStatus.OUTSIDE_OUTLINE} <= set(bulk.status.tolist())
    assert_bulk_equals_single(sequence, sources, targets, bulk, range(0, 200, 20))


def test_vignetted_ray_is_found_with_a_negative_margin():
    front, back = lens(60.0, 0.02, -0.02, 5.0)
    stop = Interaction.through(Surface(frame(66.0), outline=Circle(1.0)))
    sequence = Sequence((front, back, stop, plane(100.0)))
    aimed = aim(sequence, np.zeros((2, 3)), np.array([[0.3, 0.0, 100.0], [6.0, 0.0, 100.0]]))
    assert aimed.converged.all()
    assert aimed.margins.shape == (1, 2) and aimed.margins[0, 0] > 0.0 > aimed.margins[0, 1]


# Caustics


def test_focal_lines_are_counted_and_their_distance_is_coddingtons():
    # Concave mirror at incidence i: tangential focus at (R/2) cos i, sagittal at (R/2) / cos i for collimated light.
    incidence, radius = 0.4, 100.0
    mirror = Interaction.reflect(Surface(frame(0.0, rotation=(0.0, incidence, 0.0)), -1.0 / radius))
    out = np.array([-np.sin(2 * incidence), 0.0, -np.cos(2 * incidence)])
    tangential, sagittal = 0.5 * radius * np.cos(incidence), 0.5 * radius / np.cos(incidence)
    far = 1e6
    for distance, count in ((40.0, 0), (50.0, 1), (60.0, 2)):
        axes = frame(rotation=(0.0, 2 * incidence, 0.0)).axes
        sequence = Sequence((mirror, Interaction.through(Surface(Frame(distance * out, axes)))))
        aimed = aim(sequence, np.array([[0.0, 0.0, -far]]), distance * out[None])
        assert aimed.caustics[0] == count
        nearest = min(abs(distance - tangential), abs(distance - sagittal))
        assert aimed.focal_distance[0] == pytest.approx(nearest, abs=2e-2)  # foci move by f^2 / far
        expected = abs((1 - distance / tangential) * (1 - distance / sagittal))
        assert aimed.amplitude[0] == pytest.approx(1.0 / far / np.sqrt(expected), rel=5e-3)


def test_spread_vanishes_at_the_image_of_the_source():
    sequence = Sequence((*lens(100.0, 0.02, -0.02, 5.0), plane(200.0)))
    power = (INDEX - 1) * (0.04 - (INDEX - 1) * 5.0 * 0.0004 / INDEX)
    principal = (INDEX - 1) * 5.0 * 0.02 / INDEX / power  # from either vertex inwards
    image = 105.0 - principal + 1.0 / (power - 1.0 / (100.0 + principal))
    spread = []
    for z in (image - 10.0, image - 1.0, image, image + 1.0, image + 10.0):
        aimed = aim(Sequence((*sequence.interactions[:-1], plane(z))), np.zeros((1, 3)), np.array([[0.0, 0.0, z]]))
        if z != image:
            assert aimed.caustics[0] == (0 if z < image else 2)
        assert aimed.focal_distance[0] == pytest.approx(abs(z - image), abs=1e-6)
        spread.append(aimed.spread[0])
    assert spread[2] < 1e-12  # rounding of the focus, squared
    assert min(spread[1], spread[3]) > 1e-5


def test_relay_of_two_lenses_turns_the_phase_at_both_images():
    first, second = lens(100.0, 0.02, -0.02, 5.0), lens(300.0, 0.02, -0.02, 5.0)
    for z, count in ((150.0, 0), (250.0, 2), (350.0, 2), (450.0, 4)):
        interactions = (*first, *(second if z > 300.0 else ()), plane(z))
        aimed = aim(Sequence(interactions), np.array([[0.1, 0.0, 0.0]]), np.array([[0.0, 0.05, z]]))
        assert aimed.converged[0] and aimed.caustics[0] == count


def rayleigh_sommerfeld(points, weights, normal, field, target, wavenumber):
    """First Rayleigh-Sommerfeld integral of ``field`` on an opening with unit ``normal`` along the light, at one
    ``target``."""
    separation = target - points
    r = np.linalg.norm(separation, axis=1)
    obliquity = separation @ normal / r
    kernel = np.exp(1j * wavenumber * r) / r * (1.0 + 1j / (wavenumber * r)) * obliquity
    return wavenumber / (2j * np.pi) * (weights * field * kernel).sum()


@pytest.mark.parametrize(
    "caustics, distance, wavelength, soft", [(0, 25.0, 4e-3, 1.0), (1, 50.0, 1e-3, 1.5), (2, 85.0, 2e-3, 1.5)]
)
def test_field_beyond_focal_lines_has_the_phase_of_the_diffraction_integral(caustics, distance, wavelength, soft):
    # A tilted concave mirror makes two focal lines. Field on a plane before them, with a soft edge so that there is no
    # edge wave, propagated by diffraction, must go over into the geometric field as the wavelength goes to zero.
    incidence, radius = 0.5, 100.0
    mirror = Interaction.reflect(Surface(frame(0.0, rotation=(0.0, incidence, 0.0)), -1.0 / radius))
    axes = frame(rotation=(0.0, 2 * incidence, 0.0)).axes @ np.diag([1.0, -1.0, -1.0])
    out = axes[:, 2]
    source = np.array([[0.0, 0.0, -2000.0]])
    opening = Interaction.through(Surface(Frame(10.0 * out, axes)))
    sequence = Sequence((mirror, opening))

    node, weight = np.polynomial.legendre.leggauss(300)  # resolves the phase at the window's edge
    half = 3.0 * soft
    x, y = (m.ravel() for m in np.meshgrid(half * node, half * node))
    weights = half**2 * np.outer(weight, weight).ravel()
    window = lambda x, y: np.exp(-(x**2 + y**2) / soft**2)  # noqa: E731
    points = opening.surface.frame.to_world(np.column_stack([x, y, 0 * x]))
    pupil = aim(sequence, np.repeat(source, x.size, axis=0), points)
    assert pupil.converged.all() and not pupil.caustics.any()

    end = Interaction.through(Surface(Frame(distance * out, axes)))
    target = end.surface.frame.to_world(np.array([[0.05, 0.03, 0.0]]))
    full = aim(Sequence((mirror, opening, end)), source, target)
    assert full.caustics[0] == caustics
    crossing = opening.surface.frame.to_local(trace(sequence, source, full.launch).points[-1])[0]
    errors = []
    for k in (np.pi / wavelength, 2 * np.pi / wavelength):
        field = pupil.amplitude * np.exp(1j * k * pupil.optical_path_length) * window(x, y)
        diffracted = rayleigh_sommerfeld(points, weights, out, field, target[0], k)
        geometric = full.amplitude[0] * np.exp(1j * (k * full.optical_path_length[0] - 0.5 * np.pi * full.caustics[0]))
        errors.append(abs(geometric * window(crossing[0], crossing[1]) / diffracted - 1.0))
    assert errors[1] < 0.1
    assert errors[1] < 0.6 * errors[0]  # the leave-out of geometrical optics is of first order in the wavelength
