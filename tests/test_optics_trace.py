"""Exact ray tracing and aiming against 30-digit arithmetic, closed forms of geometrical optics and diffraction sums."""

from __future__ import annotations

import json
from pathlib import Path

import mpmath
import numpy as np
import pytest

from speckle_mi.geometry import Frame, rotation_matrix
from speckle_mi.optics.aim import aim
from speckle_mi.optics.surfaces import Circle, Interaction, Rectangle, Sequence, Surface
from speckle_mi.optics.trace import RayStatus, march, trace

WAVELENGTH = 632.8e-6  # mm
PATH_TOLERANCE = 1e-7 * WAVELENGTH  # mm; about 500 units in the last place of a 0.2 m path
POINT_TOLERANCE = 1e-12  # mm; a few roundings of coordinates of some 100 mm
REFERENCE_PATH_TOLERANCE = 1e-9  # mm; the accuracy asked for against the reference file
INDEX = 1.5151


def frame(z: float = 0.0, x: float = 0.0, y: float = 0.0, rotation=(0.0, 0.0, 0.0)) -> Frame:
    return Frame(np.array([x, y, z]), rotation_matrix(np.array(rotation)))


def plane(z: float, **kwargs) -> Interaction:
    return Interaction.through(Surface(frame(z, **kwargs)))


def lens(
    z: float,
    c1: float,
    c2: float,
    thickness: float,
    k1: float = 0.0,
    k2: float = 0.0,
    index: float = INDEX,
    rotation=(0.0, 0.0, 0.0),
):
    """Refractions at the two surfaces of a lens, front vertex at z, turned about it."""
    front = frame(z, rotation=rotation)
    back = Frame(front.to_world(np.array([[0.0, 0.0, thickness]]))[0], front.axes)
    return (
        Interaction.refract(Surface(front, c1, k1), 1.0, index),
        Interaction.refract(Surface(back, c2, k2), index, 1.0),
    )


def ball(z: float, radius: float, index: float = INDEX):
    sphere = Surface.sphere(np.array([0.0, 0.0, z]), radius)
    return (Interaction.refract(sphere, 1.0, index, root="near"), Interaction.refract(sphere, index, 1.0, root="far"))


SYSTEMS = {
    "biconvex": (*lens(60.0, 0.02, -0.02, 5.0), plane(100.0)),
    "plano-convex": (*lens(60.0, 0.0, -0.04, 4.0), plane(100.0)),
    "convex-plano": (*lens(60.0, 0.04, 0.0, 4.0), plane(100.0)),
    "asphere": (*lens(60.0, 0.05, 0.0, 5.0, k1=-0.6), plane(100.0)),
    "asphere reversed": (*lens(60.0, 0.0, -0.05, 5.0, k2=-2.3), plane(100.0)),
    "paraboloid": (*lens(60.0, 0.05, 0.0, 5.0, k1=-1.0), plane(100.0)),
    "oblate": (*lens(60.0, 0.03, -0.01, 5.0, k1=1.5, k2=0.4), plane(100.0)),
    "meniscus tilted": (
        *lens(60.0, 0.03, 0.02, 3.0, rotation=(0.1, -0.2, 0.3)),
        plane(100.0, rotation=(0.2, 0.1, 0.0)),
    ),
    "ball": (*ball(60.0, 10.0), plane(100.0)),
    "two lenses": (*lens(50.0, 0.02, -0.02, 5.0), *lens(70.0, 0.03, 0.0, 5.0, k1=-0.7), plane(100.0)),
    "concave mirror": (Interaction.reflect(Surface(frame(80.0, rotation=(0.1, 0.05, 0.0)), -0.01)), plane(5.0)),
}


def fan(rng: np.random.Generator, n: int, half_width: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """Rays from near the origin towards a patch at z = 60."""
    origins = rng.uniform(-0.5, 0.5, (n, 3))
    return origins, np.column_stack([rng.uniform(-half_width, half_width, (n, 2)), np.full(n, 60.0)]) - origins


def mp_trace(sequence: Sequence, origin, direction):
    """Path, last point and direction in 30 digits, by the textbook quadratic and the vector form of Snell's law."""
    with mpmath.workdps(30):
        mp, vector = mpmath.mpf, lambda a: mpmath.matrix([mpmath.mpf(float(x)) for x in a])
        dot = lambda a, b: mpmath.fsum(x * y for x, y in zip(a, b))  # noqa: E731
        p, d = vector(origin), vector(direction)
        d = d / mpmath.sqrt(dot(d, d))
        path = mp(0)
        for one in sequence.interactions:
            axes = mpmath.matrix([[mpmath.mpf(float(x)) for x in row] for row in one.surface.frame.axes])
            vertex, c, g = vector(one.surface.frame.origin), mp(one.surface.curvature), 1 + mp(one.surface.conic)
            lp, ld = axes.T * (p - vertex), axes.T * d
            qa = c * (ld[0] ** 2 + ld[1] ** 2 + g * ld[2] ** 2)
            qb = c * (lp[0] * ld[0] + lp[1] * ld[1] + g * lp[2] * ld[2]) - ld[2]
            qc = c * (lp[0] ** 2 + lp[1] ** 2 + g * lp[2] ** 2) - 2 * lp[2]
            if qa == 0:
                t = -qc / (2 * qb)
            else:
                roots = sorted([(-qb - mpmath.sqrt(qb**2 - qa * qc)) / qa, (-qb + mpmath.sqrt(qb**2 - qa * qc)) / qa])
                if one.root == "vertex":
                    t = min(roots, key=lambda root: abs(lp[2] + root * ld[2]))
                else:
                    t = roots[0] if one.root == "near" else roots[1]
            h = lp + t * ld
            path += mp(one.index_before) * t
            normal = mpmath.matrix([c * h[0], c * h[1], c * g * h[2] - 1])
            normal = normal / mpmath.sqrt(dot(normal, normal))
            if dot(normal, ld) > 0:
                normal = -normal
            cosine = -dot(normal, ld)
            if one.action == "refract":
                eta = mp(one.index_before) / mp(one.index_after)
                ld = eta * ld + (eta * cosine - mpmath.sqrt(1 - eta**2 * (1 - cosine**2))) * normal
            elif one.action == "reflect":
                ld = ld + 2 * cosine * normal
            p, d = vertex + axes * h, axes * ld
        as_float = lambda a: np.array([float(x) for x in a])  # noqa: E731
        return float(path), as_float(p), as_float(d)


# --- tracing
# -----------------------------------------------------------------------------------------------------------


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


# --- what happens to rays that do not get through
# ------------------------------------------------------------------------


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


def test_nonsense_is_refused_by_name():
    with pytest.raises(ValueError, match="orthonormal"):
        Surface(Frame(np.zeros(3), 2 * np.eye(3)))
    with pytest.raises(ValueError, match="index 1.5 after interaction 0"):
        Sequence((Interaction.refract(Surface(frame()), 1.0, 1.5), plane(1.0)))
    with pytest.raises(ValueError, match="closed"):
        Interaction.reflect(Surface(frame(), 0.1, -1.5), root="near")
    with pytest.raises(ValueError, match="circle radius"):
        Circle(-1.0)
    with pytest.raises(ValueError, match="off the last plane"):
        aim(Sequence((plane(10.0),)), np.zeros((1, 3)), np.array([[0.0, 0.0, 11.0]]))
    with pytest.raises(ValueError, match="'pass'"):
        aim(Sequence(lens(10.0, 0.0, 0.0, 1.0)), np.zeros((1, 3)), np.array([[0.0, 0.0, 11.0]]))


# --- closed forms
# ------------------------------------------------------------------------------------------------------


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


# --- aiming
# ------------------------------------------------------------------------------------------------------------


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


# --- caustics
# ----------------------------------------------------------------------------------------------------------


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
