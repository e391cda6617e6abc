"""Shapes and rims that cut the light in part: each scatterer's shadow without diffraction, else a refusal by name."""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import (
    BLACK,
    MIRROR,
    bench,
    diffracted,
    disc_nodes,
    element_xml,
    facing,
    fermat,
    lens_surfaces,
    rectangle_nodes,
    rendered,
    spherical,
    thin_lens_start,
    tilted,
)
from scene_builder import detector_frame, direction
from scipy.special import fresnel

from speckle_mi.field import stages as fields
from speckle_mi.geometry.frames import Frame
from speckle_mi.scene.errors import SceneError
from speckle_mi.field.simulation import Simulation, simulate_frame

WAVELENGTH = 632.8e-6
FIELD = 1e-5  # Relative L2 over the pixels that are clear of a shadow's edge by more than the next figure.
EDGE = 1e-4  # Distance [mm] at the edge within which single precision decides, of the rays that look for shapes.
LENS_EDGE = 1e-3  # The same behind a lens, whose rays are interpolated from few.
INTENSITY = 1e-3  # Of the unobstructed intensity: the promise for diffracted light.
SPREAD = np.array([[0.0, 0.0, 0.0], [0.4, 0.1, 0.0], [-0.3, 0.2, 0.01], [0.1, -0.5, -0.01]])
LENS = dict(radius1=50.0, radius2=-50.0, thickness=5.0)


def card(x: float, z: float, size: float = 10.0) -> str:
    """An opaque square whose edge is at x, all of it on the larger x."""
    return element_xml("rectangle", "card", Frame(np.array([x + size, 0.0, z]), np.eye(3)), BLACK, size=(size, size, 1))


def crossing(start, end, z):
    """Points (.., 3) where straight lines cross the plane at z."""
    return start + (end - start) * ((z - start[..., 2:]) / (end - start)[..., 2:])


def check(field, parts, lit, near):
    """The sum of parts (s, n) where lit (s, n), compared where no source's edge is near (s, n)."""
    clear = ~np.any(near, axis=0)
    expected = np.sum(parts * lit, axis=0)
    mixed = np.any(lit, axis=0) & ~np.all(lit, axis=0)
    assert np.any(mixed & clear) and np.any(np.all(lit, axis=0)) and np.any(~np.any(lit, axis=0))
    assert np.linalg.norm((field - expected)[clear]) <= FIELD * np.linalg.norm(expected[clear])


def test_knife_edge_in_free_space_shades_every_scatterer_for_itself(assemble, tmp_path):
    assembly, frame, field = rendered(
        assemble, bench(tmp_path, SPREAD, facing(60), [card(0.3, 25.0)], pixels=(80, 24), diffraction=False)
    )
    targets, amplitude = assembly.detector.points(), frame.scatterers.amplitude
    places = np.array([crossing(p, targets, 25.0)[:, 0] for p in frame.scatterers.position]) - 0.3
    parts = [c * spherical(p, targets, WAVELENGTH) for p, c in zip(frame.scatterers.position, amplitude, strict=True)]
    check(field, np.array(parts), places < 0, np.abs(places) < EDGE)


@pytest.mark.parametrize("most", [1024, 64])
def test_knife_edge_close_to_a_spot_shades_each_of_many_scatterers_or_tells_the_error(
    assemble, tmp_path, monkeypatch, most
):
    monkeypatch.setattr(fields, "SHADOWS_ON_DETECTOR", most)
    rng = np.random.default_rng(3)
    spot = np.column_stack([rng.normal(0, 0.15, (150, 2)), rng.normal(0, 1e-3, 150)])
    text = bench(tmp_path, spot, facing(60), [card(0.05, 10.0)], pixels=(60, 16), pitch=0.04, diffraction=False)
    assembly, frame, field = rendered(assemble, text)
    targets = assembly.detector.points()
    exact = np.zeros(len(targets), complex)
    for p, c in zip(frame.scatterers.position, frame.scatterers.amplitude, strict=True):
        exact += c * spherical(p, targets, WAVELENGTH) * (crossing(p, targets, 10.0)[:, 0] < 0.05)
    error = np.linalg.norm(field - exact) / np.linalg.norm(exact)
    if most >= len(spot):
        assert error <= FIELD and frame.numerical_error <= FIELD
    else:
        assert FIELD < error <= 2 * frame.numerical_error


def lens_rays(sources, surfaces, targets, focal_length):
    """Lengths, amplitudes (s, n), launch and arrival directions (s, n, 3) of all pairs: gradients of the path."""
    step = 1e-3
    found = []
    for source in sources:
        def length(p, d):
            return fermat(p, surfaces, d, thin_lens_start(p, d, surfaces, focal_length))

        def gradient(moved):
            return np.stack([(moved(step * e) - moved(-step * e)) / (2 * step) for e in np.eye(3)], axis=-1)

        launch = -gradient(lambda e: length(source + e, targets)[0])
        arrival = gradient(lambda e: length(np.broadcast_to(source, targets.shape), targets + e)[0])
        found.append((*length(source, targets), launch, arrival))
    return (np.array(parts) for parts in zip(*found, strict=True))


@pytest.mark.parametrize("z, edge", [(20.0, 0.3), (95.0, 0.2)])
def test_knife_edge_before_or_behind_a_lens_shades_every_scatterer_for_itself(assemble, tmp_path, z, edge):
    frame = Frame(np.array([0.0, 0.0, 60.0]), np.eye(3))
    lens = element_xml("lens", "lens", frame, diameter=30.0, ior=1.5151, **LENS)
    text = bench(tmp_path, SPREAD, facing(110), [lens, card(edge, z)], pixels=(60, 20), pitch=0.06, diffraction=False)
    assembly, made, field = rendered(assemble, text)
    surfaces, targets, sources = (
        lens_surfaces(frame.origin, frame.axes, index=1.5151, **LENS),
        assembly.detector.points(),
        made.scatterers.position,
    )
    length, amplitude, launch, arrival = lens_rays(sources, surfaces, targets, 49.4)
    if z < 60:
        places = np.array([crossing(p, p + d, z)[:, 0] for p, d in zip(sources, launch, strict=True)]) - edge
    else:
        places = np.array([crossing(targets, targets + d, z)[:, 0] for d in arrival]) - edge
    parts = made.scatterers.amplitude[:, None] * amplitude * np.exp(2j * np.pi / WAVELENGTH * length)
    check(field, parts, places < 0, np.abs(places) < LENS_EDGE)


def test_mirror_that_ends_in_the_beam_shows_the_image_to_a_part_of_the_detector(assemble, tmp_path):
    mirror = Frame(np.array([0.0, 0.0, 40.0]), tilted(0, 135, 0))
    place = detector_frame(direction(90), 30.0)
    detector = Frame(place.origin + [0, 0, 40.0], place.axes)
    wall = element_xml("rectangle", "wall", Frame(np.array([8.0, 0, 13]), tilted(0, 90, 0)), BLACK, size=(12, 12, 1))
    shifted = Frame(mirror.origin + 5.0 * mirror.axes[:, 0], mirror.axes)
    xml = element_xml("rectangle", "mirror", shifted, MIRROR, size=(5, 5, 1))
    assembly, made, field = rendered(
        assemble, bench(tmp_path, SPREAD, detector, [xml, wall], pixels=(60, 16), diffraction=False)
    )
    normal, targets = mirror.axes[:, 2], assembly.detector.points()
    parts, places = [], []
    for p, c in zip(made.scatterers.position, made.scatterers.amplitude, strict=True):
        image = p - 2 * ((p - mirror.origin) @ normal) * normal
        parts.append(c * spherical(image, targets, WAVELENGTH))
        share = ((mirror.origin - image) @ normal) / ((targets - image) @ normal)
        places.append((image + share[:, None] * (targets - image) - mirror.origin) @ mirror.axes[:, 0])
    places = np.array(places)
    check(field, np.array(parts), places > 0, np.abs(places) < EDGE)


def test_mirror_that_ends_in_the_beam_diffracts_at_its_edge(assemble, tmp_path):
    mirror, source = Frame(np.array([0.0, 0.0, 40.0]), tilted(0, 135, 0)), np.zeros(3)
    place = detector_frame(direction(90), 30.0)
    detector = Frame(place.origin + [0, 0, 40.0], place.axes)
    wall = element_xml("rectangle", "wall", Frame(np.array([8.0, 0, 13]), tilted(0, 90, 0)), BLACK, size=(12, 12, 1))
    shifted = Frame(mirror.origin + 0.6 * mirror.axes[:, 0], mirror.axes)
    xml = element_xml("rectangle", "mirror", shifted, MIRROR, size=(0.6, 0.5, 1))
    assembly, made, field = rendered(assemble, bench(tmp_path, source, detector, [xml, wall], pixels=(24, 12)))
    normal, targets = mirror.axes[:, 2], assembly.detector.points()
    images = targets - 2 * ((targets - mirror.origin) @ normal)[:, None] * normal
    x, y, weight = rectangle_nodes(0.6, 0.5, 300)
    points = shifted.to_world(np.stack([x, y, 0 * x], axis=1))
    exact = diffracted(points, spherical(source, points, WAVELENGTH) * weight, -normal, images, WAVELENGTH)
    free = np.abs(spherical(source, images, WAVELENGTH)) ** 2
    assert any("diffracted at mirror" in line for line in made.plan)
    assert np.max(np.abs(np.abs(field / made.scatterers.amplitude) ** 2 - np.abs(exact) ** 2) / free) <= INTENSITY


LENS_AND_STOP = [
    element_xml("lens", "lens", Frame(np.array([0.0, 0.0, 90.0]), np.eye(3)), diameter=20.0, ior=1.5151, **LENS),
    element_xml("aperture", "stop", Frame(np.array([0.0, 0.0, 97.0]), np.eye(3)), radius=2.0, outer_radius=20.0),
]


def hole(z: float = 41.0) -> str:
    return element_xml("aperture", "hole", Frame(np.array([0.0, 0, z]), np.eye(3)), radius=0.5)


@pytest.mark.parametrize(
    "elements, detector",
    [([card(0.5, 130.0), *LENS_AND_STOP], facing(198.0)), ([card(0.1, 60.0), hole()], facing(75.0))],
    ids=["behind a stop", "behind an aperture"],
)
def test_shape_that_cuts_diffracted_light_in_half_is_refused(assemble, tmp_path, elements, detector):
    with pytest.raises(SceneError, match="card|hides a part") as caught:
        simulate_frame(assemble(bench(tmp_path, (0, 0, 0), detector, elements, pixels=(24, 16), pitch=0.02)))
    assert "diffraction" in str(caught.value)


@pytest.mark.parametrize("x, z", [(0.1, 30.0), (-0.05, 12.0), (0.3, 38.0)])
def test_shape_before_an_opening_casts_its_shadow_there_and_the_wave_of_its_edge_is_stated(assemble, tmp_path, x, z):
    text = bench(tmp_path, (0, 0, 0), facing(75.0), [card(x, z), hole()], pixels=(48, 32), pitch=0.02)
    assembly, frame, field = rendered(assemble, text)
    a, b, weight = disc_nodes(0.5, 120, 600)
    nodes = np.stack([a, b, np.full_like(a, 41.0)], axis=1)
    # The straight edge's exact wave in Fresnel's approximation.
    v = (x - crossing(np.zeros(3), nodes, z)[:, 0]) * np.sqrt(2 * 41.0 / (WAVELENGTH * z * (41.0 - z)))
    s, c = fresnel(v)
    passed = spherical(np.zeros(3), nodes, WAVELENGTH) * (1 - 1j) / 2 * (0.5 + c + 1j * (0.5 + s))
    exact = diffracted(nodes, passed * weight, np.array([0, 0, 1.0]), assembly.detector.points(), WAVELENGTH)
    found = field / frame.scatterers.amplitude[0]
    found = found * np.vdot(found, exact) / abs(np.vdot(found, exact))
    error = np.linalg.norm(found - exact) / np.linalg.norm(exact)
    cut, *_ = [stage for stage in frame.stages if stage.kind == "cut"]
    assert cut.elements == ("card",) and 1e-3 < error <= frame.numerical_error <= 10 * error


def test_shape_before_a_lens_takes_its_part_of_the_image_s_light(assemble, tmp_path):
    whole, cut = (
        simulate_frame(assemble(bench(tmp_path, (0, 0, 0), facing(198.0), elements, pixels=(32, 24), pitch=0.01)))
        for elements in (LENS_AND_STOP, [card(0.5, 40.0), *LENS_AND_STOP])
    )
    # The thin lens at 92.5 mm, f = 49.4 mm, takes the ray past the edge to 1.11 mm of the stop's 2 mm at 97 mm.
    height = 0.5 * 92.5 / 40
    height += (0.5 / 40 - height / 49.4) * (97 - 92.5)
    part = 1 - (np.arccos(height / 2) - height / 2 * np.sqrt(1 - (height / 2) ** 2)) / np.pi
    powers = [np.sum(np.abs(frame.image.field) ** 2) for frame in (cut, whole)]
    assert abs(powers[0] / powers[1] - part) < 0.01  # the edge's wave takes light over to the other side
    assert any("'card' cuts a part of the light" in line for line in cut.plan) and cut.numerical_error < 0.5


@pytest.mark.parametrize(
    "element",
    [card(0.0, 25.0), element_xml("sphere", "card", Frame(np.array([2.0, 0, 30]), np.eye(3)), BLACK, radius=2.0)],
    ids=["card", "ball"],
)
def test_shape_that_cuts_free_light_casts_its_shadow_and_the_wave_of_its_edge_is_stated(assemble, tmp_path, element):
    frame, shadow = (
        simulate_frame(
            assemble(bench(tmp_path, (0, 0, 0), facing(60), [element], pixels=(48, 32), pitch=0.05, diffraction=d))
        )
        for d in (True, False)
    )
    assert np.array_equal(frame.image.field == 0, shadow.image.field == 0) and np.any(frame.image.field == 0)
    cut, *_ = [stage for stage in frame.stages if stage.kind == "cut"]
    assert cut.elements == ("card",) and 0.02 < cut.predicted_error <= frame.numerical_error
    assert any("more than the tolerance" in warning for warning in frame.warnings)


@pytest.mark.parametrize("diffraction", [True, False])
def test_shape_beside_the_light_changes_nothing(assemble, tmp_path, diffraction):
    values = dict(pixels=(24, 16), pitch=0.02, diffraction=diffraction)
    detector = facing(198.0 if diffraction else 150.0)
    alone = simulate_frame(assemble(bench(tmp_path, (0, 0, 0), detector, LENS_AND_STOP, **values)))
    beside = simulate_frame(
        assemble(
            bench(
                tmp_path,
                (0, 0, 0),
                detector,
                [card(6.0, 40.0), card(6.0, 130.0).replace("card", "plate"), *LENS_AND_STOP],
                **values,
            )
        )
    )
    assert np.linalg.norm(beside.image.field - alone.image.field) <= 1e-6 * np.linalg.norm(alone.image.field)


def test_rim_behind_a_stop_that_cuts_its_light_is_refused(assemble, tmp_path):
    # Half of what the stop lets through meets the lens, which stands aside.
    elements = [
        element_xml("aperture", "stop", Frame(np.array([0.0, 0.0, 60.0]), np.eye(3)), radius=0.5, outer_radius=30.0),
        element_xml(
            "lens",
            "lens",
            Frame(np.array([2.0, 0.0, 90.0]), np.eye(3)),
            diameter=4.0,
            ior=1.5151,
            radius1=50.0,
            radius2=-50.0,
            thickness=1.0,
        ),
    ]
    with pytest.raises(SceneError, match="hides a part|rim"):
        simulate_frame(assemble(bench(tmp_path, (0, 0, 0), facing(120.0), elements, pixels=(48, 24), pitch=0.05)))


# The user's own scatterers


@pytest.mark.parametrize("side, behind", [(1, 0.1), (1, 5.0), (-1, 0.0)])
def test_scatterers_are_not_hidden_by_the_targets_own_patch(assemble, tmp_path, side, behind):
    hole, sources = Frame(np.array([0.0, 0, side * 41.0]), np.eye(3)), SPREAD - [0, 0, side * behind]
    detector = facing(75) if side > 0 else detector_frame(direction(180), 75.0)
    xml = element_xml("aperture", "hole", hole, radius=0.5)
    assembly, made, field = rendered(assemble, bench(tmp_path, sources, detector, [xml], pixels=(16, 8), pitch=0.15))
    assert any("diffracted at hole" in line for line in made.plan) and not made.warnings
    x, y, weight = disc_nodes(0.5, 120, 500)
    points = hole.to_world(np.stack([x, y, 0 * x], axis=1))
    targets = assembly.detector.points()
    parts = [
        c * diffracted(points, spherical(p, points, WAVELENGTH) * weight, np.array([0, 0, side]), targets, WAVELENGTH)
        for p, c in zip(made.scatterers.position, made.scatterers.amplitude, strict=True)
    ]
    assert np.allclose(np.sort(made.scatterers.position, axis=0), np.sort(sources, axis=0))
    assert np.linalg.norm(field - np.sum(parts, axis=0)) <= INTENSITY * np.linalg.norm(field)


@pytest.mark.parametrize("x", [0.9, 5.0, 40.0])
def test_edge_beside_the_light_is_told_with_the_wave_that_is_left_out(assemble, tmp_path, x):
    source, z = np.zeros(3), 30.0
    assembly, made, field = rendered(
        assemble, bench(tmp_path, source, facing(60), [card(x, z)], pixels=(40, 8), pitch=0.03)
    )
    told = [line for line in made.plan if "left out" in line]
    assert told and "card" in told[0]
    # The straight edge's exact wave in Fresnel's approximation, U = (1 + i)/2 ... : F(v) against 1.
    targets = assembly.detector.points()
    v = (x - crossing(source, targets, z)[:, 0]) * np.sqrt(2 / (WAVELENGTH * 15.0))
    s, c = fresnel(v)
    left_out = np.abs((1 - 1j) / 2 * (0.5 + c + 1j * (0.5 + s)) - 1)
    share = float(told[0].split("at most ")[1].split("%")[0]) / 100
    assert left_out.max() <= 1.2 * share and share <= 6 * left_out.max()


def test_edge_that_counts_and_is_left_out_tells_its_cost_and_the_tolerance_that_does_without(shipped):
    assembly = shipped("folded")
    told = [line for line in Simulation(assembly).plan().lines if "diffracts nothing" in line]
    assert "diffraction at it would take about" in told[0]
    advised = float(told[0].split("a tolerance of ")[1].split(" does without")[0])
    kept = [line for line in Simulation(assembly.with_options(tolerance=advised)).plan().lines if "edge" in line]
    assert "would take" not in kept[0]
