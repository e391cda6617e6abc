"""Exact ray tracing against 30-digit arithmetic and closed forms of geometrical optics."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from optical_systems import INDEX, PATH_TOLERANCE, SYSTEMS, ball, frame, lens, mp_trace, plane

from speckle_mi.geometry.frames import Frame
from speckle_mi.optics.aim import aim
from speckle_mi.geometry.outline import Circle, Rectangle
from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.trace import RayStatus, march, trace

POINT_TOLERANCE = 1e-12  # mm; a few roundings of coordinates of some 100 mm
REFERENCE_PATH_TOLERANCE = 1e-9  # mm; 2e-6 wavelengths, far below what any detector could tell


def fan(rng: np.random.Generator, n: int, half_width: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """Rays from near the origin towards a patch at z = 60."""
    origins = rng.uniform(-0.5, 0.5, (n, 3))
    return origins, np.column_stack([rng.uniform(-half_width, half_width, (n, 2)), np.full(n, 60.0)]) - origins


# Tracing


@pytest.mark.parametrize("name", SYSTEMS)
def test_traced_path_point_and_direction_equal_thirty_digit_arithmetic(name):
    sequence = Sequence(SYSTEMS[name])
    origins, directions = fan(np.random.default_rng(1), 12)
    result = trace(sequence, origins, directions)
    assert result.valid.all()
    exact = [mp_trace(sequence, o, d) for o, d in zip(origins, directions)]
    np.testing.assert_allclose(result.optical_path_length, [e[0] for e in exact], rtol=0, atol=1e-2 * PATH_TOLERANCE)
    np.testing.assert_allclose(result.points[-1], [e[1] for e in exact], rtol=0, atol=POINT_TOLERANCE)
    np.testing.assert_allclose(result.directions, [e[2] for e in exact], rtol=0, atol=1e-14)


def test_biconvex_lens_agrees_with_the_published_reference_values():
    reference = json.loads((Path(__file__).parent / "reference" / "biconvex_opl.json").read_text())
    (system,) = reference["systems"]
    rim = Circle(system["clear_diameter"] / 2)
    indices = [system["n_before"], *(s["n_after"] for s in system["surfaces"])]
    sequence = Sequence(
        tuple(
            Interaction.refract(Surface(frame(s["z_vertex"]), s["curvature"], s["conic"], rim), before, after)
            for s, before, after in zip(system["surfaces"], indices, indices[1:])
        )
        + (plane(system["exit_plane_z"]),)
    )
    for case in system["sources"]:
        column = lambda key: np.array([ray[key] for ray in case["rays"]])  # noqa: B023, E731
        sources = np.tile(case["source"], (len(case["rays"]), 1))
        traced = trace(sequence, sources, column("entrance") - sources)
        assert traced.valid.all()
        np.testing.assert_allclose(
            traced.points[:2].swapaxes(0, 1), column("surface_hits"), rtol=0, atol=POINT_TOLERANCE
        )
        np.testing.assert_allclose(traced.points[-1], column("exit"), rtol=0, atol=POINT_TOLERANCE)
        np.testing.assert_allclose(traced.optical_path_length, column("opl"), rtol=0, atol=REFERENCE_PATH_TOLERANCE)
        aimed = aim(sequence, sources, column("exit"))
        assert aimed.converged.all()
        np.testing.assert_allclose(aimed.optical_path_length, column("opl"), rtol=0, atol=REFERENCE_PATH_TOLERANCE)
        np.testing.assert_allclose(aimed.launch, column("launch_dir"), rtol=0, atol=1e-13)
        np.testing.assert_allclose(aimed.arrival, column("exit_dir"), rtol=0, atol=1e-13)


def test_far_source_and_grazing_incidence_keep_the_accuracy():
    sequence = Sequence((*ball(0.0, 10.0), plane(30.0)))
    height = np.array([0.0, 5.0, 9.0, 9.9, 9.999])
    origins = np.column_stack([height, 0 * height, 0 * height - 2e4])
    directions = np.tile([0.0, 0.0, 1.0], (height.size, 1))
    result = trace(sequence, origins, directions)
    exact = [mp_trace(sequence, o, d) for o, d in zip(origins, directions)]
    np.testing.assert_allclose(result.optical_path_length, [e[0] for e in exact], rtol=0, atol=PATH_TOLERANCE)
    np.testing.assert_allclose(
        result.points[-1], [e[1] for e in exact], rtol=0, atol=1e-10
    )  # grazing magnifies rounding


def test_equal_indices_refract_to_exactly_nothing():
    origins, directions = fan(np.random.default_rng(2), 50)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    result = trace(Sequence(lens(60.0, 0.03, -0.05, 5.0, index=1.0)), origins, directions)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.array_equal(result.directions, unit)


def test_surface_becomes_a_plane_continuously_as_curvature_goes_to_zero():
    origins, directions = fan(np.random.default_rng(3), 50)
    flat = trace(Sequence((*lens(60.0, 0.0, 0.0, 5.0), plane(100.0))), origins, directions)
    for curvature in (1e-9, 1e-12, 1e-15, 1e-18, 1e-300):
        bent = trace(Sequence((*lens(60.0, curvature, 0.0, 5.0, k1=-3.0), plane(100.0))), origins, directions)
        # Sag c r^2 / 2 with r < 10 mm bounds every change of length.
        assert np.abs(bent.optical_path_length - flat.optical_path_length).max() < 50 * curvature + 1e-13
        assert np.abs(bent.points - flat.points).max() < 500 * curvature + 1e-13


@pytest.mark.parametrize("name", ["biconvex", "asphere reversed", "meniscus tilted", "ball", "concave mirror"])
def test_light_returns_the_way_it_came_with_the_same_path(name):
    interactions = SYSTEMS[name]
    origins, directions = fan(np.random.default_rng(4), 30)
    there = trace(Sequence(interactions), origins, directions)
    swapped = {"near": "far", "far": "near", "vertex": "vertex"}
    back = [
        Interaction(i.surface, i.action, i.index_after, i.index_before, swapped[i.root]) for i in interactions[-2::-1]
    ]
    home = trace(Sequence((*back, plane(0.0))), there.points[-1], -there.directions)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    beyond_origin = origins[:, 2] / unit[:, 2]  # the way back ends on the plane z = 0
    np.testing.assert_allclose(
        home.optical_path_length, there.optical_path_length + beyond_origin, rtol=0, atol=PATH_TOLERANCE
    )
    np.testing.assert_allclose(home.directions, -unit, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["biconvex", "asphere", "meniscus tilted", "ball", "two lenses"])
def test_path_is_stationary_against_moving_the_refraction_points_on_their_surfaces(name):
    sequence = Sequence(SYSTEMS[name])
    rng = np.random.default_rng(5)
    origins, directions = fan(rng, 5)
    points = trace(sequence, origins, directions).points
    surfaces = [i.surface for i in sequence.interactions[:-1]]
    indices = [i.index_before for i in sequence.interactions]

    def path(shift):
        moved = [origins]
        for surface, hit, xy in zip(surfaces, points, shift):
            local = surface.frame.to_local(hit)
            side = np.sign(1.0 - surface.curvature * local[:, 2])  # which half of a ball lens
            local[:, :2] += xy
            r2, c, g = (local[:, :2] ** 2).sum(axis=1), surface.curvature, 1.0 + surface.conic
            root = np.sqrt(1.0 - g * c * c * r2)
            local[:, 2] = np.where(side > 0, c * r2 / (1.0 + root), (1.0 + root) / (g * c) if c else 0.0)
            moved.append(surface.frame.to_world(local))
        moved.append(points[-1])
        return sum(n * np.linalg.norm(b - a, axis=1) for n, a, b in zip(indices, moved, moved[1:]))

    shift = rng.normal(size=(len(surfaces), 5, 2))
    steps = np.array([1e-2, 1e-3])
    slopes = [(path(h * shift) - path(-h * shift)) / (2 * h) for h in steps]
    # Central differences of a stationary path leave only h^2 times its third derivative.
    assert np.abs(slopes[0]).max() < 1e-3
    assert np.abs(slopes[1]).max() < 2e-2 * np.abs(slopes[0]).max() + 1e-10


@pytest.mark.parametrize("name", SYSTEMS)
def test_tangents_are_the_derivatives_of_the_ray(name):
    sequence = Sequence(SYSTEMS[name])
    rng = np.random.default_rng(6)
    origins, directions = fan(rng, 6)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    dp, dd = rng.normal(size=(2, 6, 3))
    dd -= directions * (dd * directions).sum(axis=1, keepdims=True)
    for step in march(sequence, np.stack([origins, directions, dp, dd], axis=1).transpose(2, 1, 0)):
        pass
    axes = sequence.last.surface.frame.axes
    got = np.concatenate([(axes @ step.state[:, 2]).T, (axes @ step.state[:, 3]).T], axis=1)

    def end(h):
        result = trace(sequence, origins + h * dp, directions + h * dd)
        return np.concatenate([result.points[-1], result.directions], axis=1)

    h = 1e-4
    expected = (8 * (end(h) - end(-h)) - (end(2 * h) - end(-2 * h))) / (12 * h)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-8 * max(1.0, np.abs(expected).max()))  # rounding / h


# What happens to rays that do not get through


def test_lost_rays_say_why_and_where():
    rim = Surface(frame(10.0), outline=Circle(2.0))
    sphere = Surface.sphere(np.array([0.0, 0.0, 30.0]), 5.0)
    sequence = Sequence(
        (
            Interaction.through(rim),
            Interaction.refract(sphere, 1.0, 1.5, root="near"),
            Interaction.refract(sphere, 1.5, 1.0, root="far"),
            plane(50.0),
        )
    )
    origins = np.array([[0.0, 0, 0], [2.5, 0, 0], [7.0, 0, 0], [0.0, 0, 40.0]])
    result = trace(sequence, origins, np.tile([0.0, 0.0, 1.0], (4, 1)))
    expected = [RayStatus.OK, RayStatus.OUTSIDE_OUTLINE, RayStatus.MISSED, RayStatus.BEHIND]
    assert result.status.tolist() == expected
    assert result.stopped_at.tolist() == [-1, 0, 1, 0]
    assert result.valid.tolist() == [True, False, False, False]
    assert np.isfinite(result.optical_path_length).tolist() == [True, True, False, True]


def test_total_internal_reflection_sets_in_at_the_critical_angle():
    sequence = Sequence((Interaction.refract(Surface(frame(1.0)), 1.5, 1.0), plane(2.0)))
    critical = np.arcsin(1 / 1.5)
    angle = critical + np.array([-1e-9, 1e-9])
    directions = np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    result = trace(sequence, np.zeros((2, 3)), directions)
    assert result.status.tolist() == [RayStatus.OK, RayStatus.TOTAL_INTERNAL_REFLECTION]
    assert result.stopped_at.tolist() == [-1, 0]


def test_a_ray_beyond_the_equator_or_on_the_other_sheet_misses_the_lens():
    steep = Sequence((Interaction.refract(Surface(frame(0.0), 0.1), 1.0, 1.5),))
    assert trace(steep, [[10.001, 0.0, -20.0]], [[0.0, 0.0, 1.0]]).status[0] == RayStatus.MISSED
    # Hyperboloid opening to +z; its other sheet lies at z < -2 / (c |1 + k|) = -20.
    hyperboloid = Sequence((Interaction.refract(Surface(frame(0.0), 0.1, -2.0), 1.0, 1.5),))
    result = trace(hyperboloid, [[0.0, 0.0, -40.0]], [[0.01, 0.0, 1.0]])
    assert result.valid[0] and result.points[0, 0, 2] > 0.0


def test_margins_vanish_on_the_rim_and_are_positive_inside():
    surfaces = [
        Surface(frame(10.0, x=1.0, rotation=(0.0, 0.0, 0.5)), outline=Rectangle(3.0, 1.0)),
        Surface(frame(10.0), outline=Circle(2.0)),
    ]
    sequence = Sequence((*(Interaction.through(s) for s in surfaces), plane(20.0)))
    assert sequence.rims == ((0, 0), (0, 1), (1, 0))
    local = np.array([[3.0, 0.5, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0], [4.0, 2.0, 0.0]])
    points = surfaces[0].frame.to_world(local)
    margins = trace(sequence, points - [0.0, 0.0, 10.0], np.tile([0.0, 0.0, 1.0], (4, 1))).margins
    np.testing.assert_allclose(margins[:2], [[0.0, 8 / 9, 1.0, -7 / 9], [0.75, 0.0, 1.0, -3.0]], atol=1e-14)
    np.testing.assert_allclose(margins[2], 1.0 - (points[:, :2] ** 2).sum(axis=1) / 4.0, atol=1e-14)


@pytest.mark.parametrize("outline", [Circle(0.7), Rectangle(0.2, 3.0)], ids=["circle", "rectangle"])
def test_edge_of_an_outline_has_no_clearance_and_spans_its_size(outline):
    x, y = outline.edge(2 * np.pi * np.arange(360) / 360)
    np.testing.assert_allclose(outline.clearance(x, y), 0.0, atol=POINT_TOLERANCE)
    np.testing.assert_allclose(outline.margins(x, y).min(axis=0), 0.0, atol=POINT_TOLERANCE)
    np.testing.assert_allclose([x.max(), y.max()], outline.half_size, atol=POINT_TOLERANCE)
    assert np.hypot(x, y).max() == pytest.approx(outline.reach, abs=POINT_TOLERANCE)
    assert np.all(outline.clearance(0.9 * x, 0.9 * y) > 0) and np.all(outline.clearance(1.1 * x, 1.1 * y) < 0)


@pytest.mark.parametrize("conic", [-2.3, -1.0, 0.0, 1.5])
def test_sag_lies_on_the_surface(conic):
    surface = Surface(frame(), 0.05, conic)
    squared = np.linspace(0.0, 160.0, 50)  # mm^2, for the flattest spheroid up to its equator
    z = surface.sag(np.sqrt(squared), 0.0)
    residual = 0.05 * squared + 0.05 * (1 + conic) * z**2 - 2 * z
    np.testing.assert_allclose(residual, 0.0, atol=POINT_TOLERANCE)


def test_nonsense_is_refused_by_name():
    with pytest.raises(ValueError, match="orthonormal"):
        Surface(Frame(np.zeros(3), 2 * np.eye(3)))
    with pytest.raises(ValueError, match="leaves surface 1 in a medium of index 1.5"):
        Sequence((Interaction.refract(Surface(frame()), 1.0, 1.5), plane(1.0)))
    with pytest.raises(ValueError, match="closed"):
        Interaction.reflect(Surface(frame(), 0.1, -1.5), root="near")
    with pytest.raises(ValueError, match="circle radius"):
        Circle(-1.0)
    with pytest.raises(ValueError, match="off the last plane"):
        aim(Sequence((plane(10.0),)), np.zeros((1, 3)), np.array([[0.0, 0.0, 11.0]]))
    with pytest.raises(ValueError, match="'pass'"):
        aim(Sequence(lens(10.0, 0.0, 0.0, 1.0)), np.zeros((1, 3)), np.array([[0.0, 0.0, 11.0]]))


# Closed forms


def test_plane_mirrors_have_the_path_of_the_image_source():
    rng = np.random.default_rng(7)
    mirrors = [Surface(frame(50.0, rotation=(0.0, 0.8, 0.1))), Surface(frame(45.0, x=-40.0, rotation=(0.1, 0.6, 0.0)))]
    sources = rng.uniform(-1.0, 1.0, (200, 3))
    images = sources
    for mirror in mirrors:
        normal = mirror.frame.axes[:, 2]
        images = images - 2.0 * ((images - mirror.frame.origin) @ normal)[:, None] * normal
    chief = trace(Sequence(tuple(Interaction.reflect(m) for m in mirrors)), np.zeros((1, 3)), [[0.0, 0.0, 1.0]])
    end = Frame(chief.points[-1, 0] + 60.0 * chief.directions[0], frame(rotation=(0.3, 0.9, 0.0)).axes)
    sequence = Sequence((*(Interaction.reflect(m) for m in mirrors), Interaction.through(Surface(end))))
    targets = end.to_world(np.column_stack([rng.uniform(-8.0, 8.0, (200, 2)), np.zeros(200)]))
    aimed = aim(sequence, sources, targets)
    distance = np.linalg.norm(targets - images, axis=1)
    assert aimed.converged.all() and not aimed.caustics.any()
    np.testing.assert_allclose(aimed.optical_path_length, distance, rtol=0, atol=1e-10)
    np.testing.assert_allclose(aimed.amplitude, 1.0 / distance, rtol=1e-10)
    np.testing.assert_allclose(aimed.spread, 1.0, rtol=1e-10)


def test_free_space_is_the_spherical_wave():
    rng = np.random.default_rng(8)
    sources, targets = rng.uniform(-3.0, 3.0, (100, 3)), rng.uniform(-3.0, 3.0, (100, 3)) * [1, 1, 0] + [0, 0, 60.0]
    aimed = aim(Sequence((plane(60.0),)), sources, targets)
    r = np.linalg.norm(targets - sources, axis=1)
    np.testing.assert_allclose(aimed.optical_path_length, r, rtol=1e-15)
    np.testing.assert_allclose(aimed.amplitude, 1.0 / r, rtol=1e-13)
    np.testing.assert_allclose(aimed.focal_distance, r, rtol=1e-13)
    np.testing.assert_allclose(aimed.launch, (targets - sources) / r[:, None], atol=1e-15)


def test_ellipsoidal_mirror_has_the_same_path_for_all_rays_from_focus_to_focus():
    # Ellipse of semi-axes a > b along z: vertex radius b^2/a, conic -e^2, foci at distance a -+ a e from the vertex.
    a, eccentricity = 60.0, 0.5
    radius = a * (1.0 - eccentricity**2)
    mirror = Surface(frame(a), -1.0 / radius, -(eccentricity**2))
    focus = np.array([0.0, 0.0, -a * eccentricity])
    rng = np.random.default_rng(9)
    directions = rng.uniform(-0.4, 0.4, (100, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
    result = trace(Sequence((Interaction.reflect(mirror), plane(-focus[2]))), np.tile(focus, (100, 1)), directions)
    np.testing.assert_allclose(result.points[-1], np.tile(-focus, (100, 1)), atol=1e-12)
    np.testing.assert_allclose(result.optical_path_length, 2 * a, rtol=0, atol=PATH_TOLERANCE)


def test_plano_hyperbolic_lens_collimates_into_equal_paths():
    # A cartesian oval with its object in air at infinity: conic -n^2, focus at R / (n - 1) behind the vertex.
    n, radius = 1.5151, 20.0
    focus = radius / (n - 1.0)
    back = Surface(frame(0.0), -1.0 / radius, -(n**2))
    front = Interaction.refract(Surface(frame(-6.0)), 1.0, n)
    x, y = np.meshgrid(np.linspace(-9.0, 9.0, 9), np.linspace(-9.0, 9.0, 9))
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(81, -10.0)])
    result = trace(
        Sequence((front, Interaction.refract(back, n, 1.0), plane(focus))), origins, np.tile([0.0, 0.0, 1.0], (81, 1))
    )
    assert result.valid.all()
    np.testing.assert_allclose(result.points[-1, :, :2], 0.0, atol=1e-11)
    np.testing.assert_allclose(result.optical_path_length, 4.0 + 6.0 * n + focus, rtol=0, atol=PATH_TOLERANCE)


def test_aplanatic_points_of_a_sphere_are_imaged_with_equal_paths():
    # Source inside the glass at R/n beyond the centre; virtual image at n R: n |P - Q| - |P' - Q| = 0 for all Q
    # (Weierstrass).
    n, radius = 1.5, 10.0
    sphere = Surface.sphere(np.zeros(3), radius)
    source = np.array([0.0, 0.0, -radius / n])
    rng = np.random.default_rng(10)
    directions = rng.normal(size=(60, 3)) * [0.4, 0.4, 0.0] + [0.0, 0.0, 1.0]
    sequence = Sequence((Interaction.refract(sphere, n, 1.0, root="far"), plane(40.0)))
    result = trace(sequence, np.tile(source, (60, 1)), directions)
    virtual = np.linalg.norm(result.points[-1] - [0.0, 0.0, -n * radius], axis=1)
    np.testing.assert_allclose(result.optical_path_length, virtual, rtol=0, atol=PATH_TOLERANCE)


def test_sphere_mirror_sends_light_from_its_centre_back():
    sequence = Sequence((Interaction.reflect(Surface(frame(50.0), -1 / 50.0)), plane(0.0)))
    rng = np.random.default_rng(11)
    result = trace(sequence, np.zeros((20, 3)), rng.normal(size=(20, 3)) * [0.2, 0.2, 0.0] + [0.0, 0.0, 1.0])
    np.testing.assert_allclose(result.optical_path_length, 100.0, rtol=0, atol=PATH_TOLERANCE)
    np.testing.assert_allclose(result.points[-1], 0.0, atol=1e-13)


@pytest.mark.parametrize(
    "c1, c2, thickness", [(0.02, -0.02, 5.0), (0.04, 0.0, 4.0), (0.0, -0.04, 4.0), (0.03, 0.02, 3.0)]
)
def test_back_focal_length_is_the_lensmakers(c1, c2, thickness):
    power = (INDEX - 1) * (c1 - c2 + (INDEX - 1) * thickness * c1 * c2 / INDEX)
    back_focus = (1.0 - (INDEX - 1) * thickness * c1 / INDEX) / power
    height = 1e-4  # mm; spherical aberration of order height^2
    result = trace(Sequence(lens(10.0, c1, c2, thickness)), [[height, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    x, z = result.points[-1, 0, 0], result.points[-1, 0, 2]
    slope = result.directions[0, 0] / result.directions[0, 2]
    assert -height / slope == pytest.approx(1.0 / power, rel=1e-8)
    assert z - x / slope - 10.0 - thickness == pytest.approx(back_focus, rel=1e-8)
