"""Diffraction at openings in whole scenes, against plain quadrature of Rayleigh and Sommerfeld's first integral."""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import (
    MIRROR,
    bench,
    diffracted,
    disc_nodes,
    element_xml,
    facing,
    rectangle_nodes,
    rendered_unit,
    spherical,
    tilted,
)
from scene_builder import detector_frame, direction
from scipy.special import fresnel

from speckle_mi.geometry.frames import Frame
from speckle_mi.field.simulation import Simulation, simulate_frame

WAVELENGTH = 632.8e-6
K = 2 * np.pi / WAVELENGTH
INTENSITY = 1e-3  # Of the unobstructed intensity, everywhere: the promise.
FIELD = 1e-5  # Of the unobstructed amplitude, at the worst pixel: ten times the L2 error that the scenes ask for.
ENERGY = 0.01  # The promise for power; the sums are far better, the pixels' edges are not.
REFERENCE = 1e-7  # Change of a reference when its nodes are doubled, relative to the unobstructed field.


def through(source, frame, nodes, targets):
    """Field (m,) of a unit source behind one opening with quadrature ``nodes`` in ``frame``."""
    x, y, weight = nodes
    points = frame.to_world(np.stack([x, y, 0 * x], axis=1))
    normal = frame.axes[:, 2] * np.sign(frame.axes[:, 2] @ (frame.origin - source))
    return diffracted(points, spherical(source, points, WAVELENGTH) * weight, normal, targets, WAVELENGTH)


def check_intensity(field, exact, source, targets):
    free = np.abs(spherical(source, targets, WAVELENGTH)) ** 2
    worst = np.max(np.abs(np.abs(field) ** 2 - np.abs(exact) ** 2) / free)
    assert worst <= INTENSITY, worst
    # The phase belongs to it: speckle is made of it.
    assert np.max(np.abs(field - exact) / np.sqrt(free)) <= INTENSITY


APERTURES = {
    "square on": ((0.0, 0.0, 41.0), (0, 0, 0), (0.0, 0.0, 0.0)),
    "off axis": ((0.0, 0.0, 41.0), (0, 0, 0), (0.35, -0.2, 0.1)),
    "tilted": ((0.1, 0.05, 41.0), (15, -20, 30), (0.1, 0.0, 0.0)),
    "faces away": ((0.0, 0.0, 41.0), (180, 10, 0), (0.0, 0.1, 0.0)),
}


@pytest.mark.parametrize("name", APERTURES)
def test_light_behind_a_round_aperture_of_fresnel_number_21_is_the_exact_integral_everywhere(assemble, tmp_path, name):
    place, turn, source = APERTURES[name]
    radius, frame, source = 0.5, Frame(np.array(place), tilted(*turn)), np.array(source)
    assert radius**2 / WAVELENGTH * (1 / 41 + 1 / 34) == pytest.approx(21.3, abs=0.1)
    xml = element_xml("aperture", "hole", frame, radius=radius)
    # A strip from one dark side over both shadow edges to the other, wide enough that the strip's rows differ.
    text = bench(tmp_path, source, facing(75.0, tilt=(0, 0, 30)), [xml], pixels=(160, 2), pitch=0.018, tolerance=1e-4)
    assembly, frame_made, field = rendered_unit(assemble, text)
    targets = assembly.detector.points()
    exact = through(source, frame, disc_nodes(radius, 160, 640), targets)
    few = targets[::23]
    finer = through(source, frame, disc_nodes(radius, 230, 900), few)
    assert np.max(np.abs(exact[::23] - finer)) <= REFERENCE * np.abs(spherical(source, few, WAVELENGTH)).max()
    lit = np.abs(exact) * 75 > 0.5
    assert 40 < lit.sum() < 280, "the strip should hold light and shadow"
    check_intensity(field, exact, source, targets)
    assert any("diffracted at hole" in line for line in frame_made.plan)


@pytest.mark.parametrize("tilt", [0.0, 25.0])
def test_light_behind_a_rectangular_aperture_is_the_exact_integral(assemble, tmp_path, tilt):
    frame, source = Frame(np.array([0.0, 0.0, 30.0]), tilted(0, tilt, 20)), np.array([0.1, 0.0, 0.0])
    xml = element_xml("aperture", "slit", frame, shape="rectangle", width=0.8, height=0.3)
    text = bench(tmp_path, source, facing(70.0), [xml], pixels=(40, 24), pitch=0.07)
    assembly, _, field = rendered_unit(assemble, text)
    targets = assembly.detector.points()
    exact = through(source, frame, rectangle_nodes(0.4, 0.15, 200), targets)
    check_intensity(field, exact, source, targets)


def test_light_behind_a_wide_rectangle_has_fresnels_fringes_at_its_edge(assemble, tmp_path):
    # Near one edge of a wide opening: (1 + i)/2-normalised Fresnel integral, paraxial.
    z1, z2, edge = 40.0, 40.0, 0.5
    frame = Frame(np.array([0.0, 0.0, z1]), np.eye(3))
    xml = element_xml("aperture", "screen", frame, shape="rectangle", width=2 * edge, height=2 * edge)
    text = bench(tmp_path, (0, 0, 0), facing(z1 + z2), [xml], pixels=(120, 1), pitch=0.025)
    assembly, _, field = rendered_unit(assemble, text)
    targets = assembly.detector.points()
    scale = np.sqrt(2 / WAVELENGTH * (1 / z1 + 1 / z2))

    def side(x):
        s, c = fresnel(scale * (np.array([[-edge], [edge]]) - x * z1 / (z1 + z2)))
        return (c[1] - c[0] + 1j * (s[1] - s[0])) / (1 + 1j)

    expected = np.abs(side(targets[:, 0]) * side(targets[:, 1])) ** 2
    measured = np.abs(field) ** 2 * (targets**2).sum(axis=1)
    # The next order of the path, k x^4/8 (1/z1^3 + 1/z2^3), is 2.4e-3 rad at the edge, of a field of at most 1.4.
    paraxial = 1e-2
    assert np.max(np.abs(measured - expected)) <= paraxial


def test_two_apertures_in_a_row_diffract_one_after_the_other(assemble, tmp_path):
    first, second = Frame(np.array([0.0, 0, 20]), np.eye(3)), Frame(np.array([0.05, 0, 35]), tilted(0, 10, 0))
    source = np.array([0.02, 0.0, 0.0])
    elements = [element_xml("aperture", n, f, radius=r) for n, f, r in (("z", first, 0.1), ("a", second, 0.15))]
    text = bench(tmp_path, source, facing(60.0), elements, pixels=(40, 3), pitch=0.04)
    assembly, frame, field = rendered_unit(assemble, text)
    targets = assembly.detector.points()
    x, y, weight = disc_nodes(0.15, 40, 120)
    middle = second.to_world(np.stack([x, y, 0 * x], axis=1))
    there = through(source, first, disc_nodes(0.1, 40, 120), middle)
    exact = diffracted(middle, there * weight, second.axes[:, 2], targets, WAVELENGTH)
    check_intensity(field, exact, source, targets)
    assert sum("nodes" in line and "sum to" in line for line in frame.plan) >= 2


def test_order_of_apertures_in_the_file_does_not_matter(assemble, tmp_path):
    elements = [
        element_xml("aperture", n, Frame(np.array([0.0, 0, z]), np.eye(3)), radius=0.2)
        for n, z in (("near", 20.0), ("far", 35.0))
    ]
    images = [
        rendered_unit(assemble, bench(tmp_path, (0, 0, 0), facing(60), e, pixels=(12, 8)))[2]
        for e in (elements, elements[::-1])
    ]
    assert np.array_equal(*images)


def test_edge_of_a_small_mirror_diffracts_like_the_opening_it_is(assemble, tmp_path):
    mirror, half = Frame(np.array([0.0, 0.0, 40.0]), tilted(0, 135, 0)), (0.5, 0.35)
    source = np.array([0.05, 0.0, 0.0])
    detector = detector_frame(direction(90), 30.0)
    detector = Frame(detector.origin + [0, 0, 40.0], detector.axes)
    wall = element_xml(
        "rectangle", "wall", Frame(np.array([8.0, 0, 13]), tilted(0, 90, 0)), '<bsdf type="diffuse"/>', size=(12, 12, 1)
    )
    xml = element_xml("rectangle", "mirror", mirror, MIRROR, size=(*half, 1))
    assembly, frame, field = rendered_unit(
        assemble, bench(tmp_path, source, detector, [xml, wall], pixels=(40, 24), pitch=0.05)
    )
    normal = mirror.axes[:, 2]
    targets = assembly.detector.points()
    images = targets - 2 * ((targets - mirror.origin) @ normal)[:, None] * normal
    exact = through(source, mirror, rectangle_nodes(*half, 200), images)
    check_intensity(field, exact, source, images)
    assert any("diffracted at mirror" in line for line in frame.plan)


def test_opening_in_glassless_light_of_many_sources_is_the_sum_of_each(assemble, tmp_path):
    points = np.array([[0.0, 0, 0], [0.1, 0.05, 0.001], [-0.08, 0.1, -0.001], [0.02, -0.12, 0.0]])
    frame = Frame(np.array([0.0, 0, 41.0]), np.eye(3))
    xml = element_xml("aperture", "hole", frame, radius=0.5)
    assembly = assemble(bench(tmp_path, points, facing(75), [xml], pixels=(16, 8), pitch=0.15))
    made = simulate_frame(assembly)
    targets = assembly.detector.points()
    exact = sum(
        c * through(p, frame, disc_nodes(0.5, 100, 400), targets)
        for p, c in zip(made.scatterers.position, made.scatterers.amplitude, strict=True)
    )
    assert np.linalg.norm(made.image.field.ravel() - exact) <= INTENSITY * np.linalg.norm(exact)
    assert np.linalg.norm(made.image.field.ravel() - exact) <= 3 * max(made.numerical_error, 1e-6) * np.linalg.norm(
        exact
    )


# Geometric light


def test_without_diffraction_an_aperture_casts_a_sharp_shadow_of_undisturbed_light(assemble, tmp_path):
    source, frame = np.array([0.2, -0.1, 0.0]), Frame(np.array([0.0, 0, 41.0]), tilted(10, 0, 0))
    xml = element_xml("aperture", "hole", frame, radius=0.5)
    text = bench(tmp_path, source, facing(75), [xml], pixels=(80, 60), pitch=0.04, diffraction=False)
    assembly, made, field = rendered_unit(assemble, text)
    targets = assembly.detector.points()
    away = targets - source
    share = (frame.origin - source) @ frame.axes[:, 2] / (away @ frame.axes[:, 2])
    hit = frame.to_local(source + share[:, None] * away)
    clearance = 0.5 - np.hypot(hit[:, 0], hit[:, 1])
    lit = clearance > 0
    certain = np.abs(clearance) > 1e-6  # mm; nearer, rounding decides
    exact = np.where(lit, spherical(source, targets, WAVELENGTH), 0)
    assert 100 < lit.sum() < lit.size - 100
    assert np.max(np.abs(field - exact)[certain]) <= FIELD / 75
    assert any("geometric shadows" in line for line in made.plan)


# From 6 mm on what both sides of the edge make of a detector so near the axis, J0(k R r/L) of 270 rad, shows.
@pytest.mark.parametrize("radius, bound", [(0.5, 0.6), (1.0, 0.35), (2.0, 0.15), (6.0, 0.05), (12.0, 0.04)])
def test_an_aperture_opened_wider_and_wider_leaves_free_space(assemble, tmp_path, radius, bound):
    # On the axis both edges of a round aperture add up: look beside it, where only the near edge counts.
    xml = element_xml("aperture", "hole", Frame(np.array([0.0, 0, 40.0]), np.eye(3)), radius=radius, outer_radius=30.0)
    source = np.zeros(3)
    text = bench(tmp_path, source, facing(80, 0.15, 0.1), [xml], pixels=(16, 12), pitch=0.01)
    assembly, made, field = rendered_unit(assemble, text)
    free = spherical(source, assembly.detector.points(), WAVELENGTH)
    error = np.linalg.norm(field - free) / np.linalg.norm(free)
    assert error <= bound, (error, made.plan)
    assert not any("no geometric light" in line for line in made.warnings), "the detector is small, and lit"


# Energy


def power_through_disc(source, frame, radius):
    x, y, weight = disc_nodes(radius, 60, 60)
    points = frame.to_world(np.stack([x, y, 0 * x], axis=1))
    away = points - source
    r = np.linalg.norm(away, axis=1)
    return float(np.sum(weight / r**2 * np.abs(away @ frame.axes[:, 2]) / r))


@pytest.mark.parametrize("radius, half_width", [(0.5, 2.0), (0.2, 2.0)])
def test_power_through_an_aperture_arrives_at_the_detector_that_catches_it_all(assemble, tmp_path, radius, half_width):
    source, frame = np.array([0.1, 0.0, 0.0]), Frame(np.array([0.0, 0, 41.0]), np.eye(3))
    xml = element_xml("aperture", "hole", frame, radius=radius)
    side, pitch = 200, 2 * half_width / 200
    assembly, _, field = rendered_unit(
        assemble, bench(tmp_path, source, facing(75), [xml], pixels=(side, side), pitch=pitch, tolerance=1e-4)
    )
    caught = np.sum(np.abs(field) ** 2) * pitch**2
    assert caught == pytest.approx(power_through_disc(source, frame, radius), rel=ENERGY)


@pytest.mark.parametrize("detector_z, half_width", [(198.7736, 0.5), (190.0, 0.5), (215.0, 0.8)])
def test_power_through_lens_and_stop_arrives_in_and_out_of_focus(assemble, tmp_path, detector_z, half_width):
    """The stop stands before the lens, where the source's power through it is that of a cone."""
    stop = Frame(np.array([0.0, 0, 95.0]), np.eye(3))
    lens = element_xml(
        "lens",
        "lens",
        Frame(np.array([0.0, 0, 97.0685]), np.eye(3)),
        radius1=50.0,
        radius2=-50.0,
        thickness=5.0,
        diameter=20.0,
        ior=1.5151,
    )
    elements = [lens, element_xml("aperture", "stop", stop, radius=2.0, outer_radius=15.0)]
    side, pitch = 200, 2 * half_width / 200
    assembly, made, field = rendered_unit(
        assemble,
        bench(tmp_path, (0, 0, 0), facing(detector_z), elements, pixels=(side, side), pitch=pitch, tolerance=1e-4),
    )
    caught = np.sum(np.abs(field) ** 2) * pitch**2
    # cos(chi) on the detector is 1 to 2e-4 in this cone.
    assert caught == pytest.approx(power_through_disc(np.zeros(3), stop, 2.0), rel=ENERGY), made.plan


def test_the_cost_of_rays_through_a_stop_is_known_beforehand(assemble, tmp_path):
    xml = element_xml("aperture", "hole", Frame(np.array([0.0, 0, 40.0]), np.eye(3)), radius=0.2)
    text = bench(tmp_path, np.zeros(3), facing(80), [xml], pixels=(16, 12), method="rays")
    cost = Simulation(assemble(text)).cost()
    assert 0 < cost.seconds < 1 and cost.memory > 0
