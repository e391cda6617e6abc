"""Shape ``mirror``: its surface against the geometry of conics, its mesh, its limits, and the field behind it."""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import Refractor, bench, element_xml, fermat, rendered_unit, spherical, tilted

import speckle_mi  # noqa: F401  (finds LLVM and registers the plugins)
from speckle_mi.scene.elements import OUTSIDE
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.outline import Circle, OffsetCircle
from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.trace import trace

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_mono")

WAVELENGTH = 632.8e-6
PATH_TOLERANCE = 1e-6 * WAVELENGTH  # mm; some thousand units in the last place of a 0.3 m path
FOCUS_TOLERANCE = 1e-10  # mm; rounding of a direction, over 0.1 m
OUTLINE_TOLERANCE = 1e-12  # mm; rounding of some 10 mm
FACET_DEPTH = 1e-2  # mm; a facet's depth under a steep surface
FIELD_TOLERANCE = 1e-5  # relative, of a scene whose tolerance is 1e-6

PARABOLOID = {"type": "mirror", "radius": 100.0, "conic": -1.0, "diameter": 25.0, "off_axis": 60.0}
FORMS = {
    "plane": {"diameter": 25.0},
    "plane beside the axis": {"diameter": 25.0, "off_axis": -40.0},
    "concave sphere": {"radius": 100.0, "diameter": 50.0},
    "convex sphere": {"radius": -100.0, "diameter": 50.0},
    "hemisphere": {"radius": 25.0, "diameter": 50.0},
    "paraboloid": {"radius": 100.0, "conic": -1.0, "diameter": 80.0},
    "off-axis paraboloid": PARABOLOID,
    "off-axis sphere": {"radius": 80.0, "diameter": 20.0, "off_axis": -65.0},
    "off-axis hyperboloid": {"radius": -60.0, "conic": -4.0, "diameter": 30.0, "off_axis": 80.0},
    "oblate": {"radius": 60.0, "conic": 1.0, "diameter": 50.0},
}
PLACE = Frame(np.array([3.0, -2.0, 41.0]), tilted(20.0, -35.0, 10.0))


def mirror(form: dict, frame: Frame = PLACE):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = frame.axes, frame.origin
    return mi.load_dict({"type": "mirror", "to_world": mi.ScalarTransform4f(matrix)} | form)


def inside(outline, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Places x, y (count,) [mm] spread over an outline."""
    number = np.arange(count) + 0.5
    r, angle = outline.half_size[0] * np.sqrt(number / count), np.pi * (1 + 5**0.5) * number
    return outline.centre[0] + r * np.cos(angle), outline.centre[1] + r * np.sin(angle)


# The outline


@pytest.mark.parametrize("outline", [Circle(7.0), OffsetCircle(7.0, (-12.0, 5.0)), OffsetCircle(7.0, (0.0, 3.0))])
def test_margins_clearance_edge_and_reach_of_a_circle_are_of_one_rim(outline):
    angle = np.linspace(-np.pi, np.pi, 4001)
    x, y = outline.edge(angle)
    assert np.abs(outline.margins(x, y)).max() < OUTLINE_TOLERANCE
    assert np.abs(outline.clearance(x, y)).max() < OUTLINE_TOLERANCE
    middle = tuple(np.array([value]) for value in outline.centre)
    assert outline.margins(*middle) == 1.0 and outline.clearance(*middle) == 7.0
    assert np.ptp(x) / 2 == pytest.approx(outline.half_size[0]) and np.ptp(y) / 2 == pytest.approx(outline.half_size[1])
    # The rim's farthest point lies between two angles, up to half a step from the nearer.
    assert outline.reach * (1 - 1e-6) < np.hypot(x, y).max() <= outline.reach + OUTLINE_TOLERANCE
    one_mm_beyond = outline.clearance(*(c + 8 / 7 * (edge - c) for c, edge in zip(outline.centre, (x, y), strict=True)))
    np.testing.assert_allclose(one_mm_beyond, -1.0, atol=OUTLINE_TOLERANCE)


def test_a_circle_has_a_radius_and_a_place():
    with pytest.raises(ValueError, match="radius = 0.0 mm"):
        OffsetCircle(0.0, (1.0, 0.0))
    with pytest.raises(ValueError, match="centre"):
        OffsetCircle(1.0, (np.nan, 0.0))


# Conics image their foci without any difference of path


@pytest.mark.parametrize("off_axis", [0.0, 60.0, -130.0])
def test_light_along_the_axis_of_a_paraboloid_comes_to_its_focus_over_equal_paths(off_axis):
    element = mirror(PARABOLOID | {"off_axis": off_axis}).element()
    face = element.faces[0]
    assert element.kind == "mirror" and not element.closed
    x, y = inside(face.outline)
    place = face.frame  # as single precision has rounded it
    start = place.to_world(np.stack([x, y, np.full(x.size, 300.0)], axis=1))
    focus = place.to_world(np.array([[0.0, 0.0, 50.0]]))
    across = Interaction.through(Surface(Frame(focus[0], place.axes @ tilted(0.0, 50.0, 0.0))))
    traced = trace(Sequence((element.interaction(0, OUTSIDE), across)), start, np.tile(-place.axes[:, 2], (x.size, 1)))
    assert traced.valid.all()
    assert np.abs(traced.points[1] - focus).max() < FOCUS_TOLERANCE
    assert np.abs(traced.optical_path_length - 350.0).max() < PATH_TOLERANCE


@pytest.mark.parametrize("conic", [0.0, -0.25, -0.64])
def test_an_ellipsoid_images_one_focus_on_the_other_over_equal_paths(conic):
    face = mirror({"radius": 100.0, "conic": conic, "diameter": 40.0, "off_axis": 25.0}).element().faces[0]
    eccentricity = np.sqrt(-conic)
    near, far = (face.frame.to_world(np.array([[0.0, 0.0, 100.0 / (1 + sign * eccentricity)]])) for sign in (1, -1))
    x, y = inside(face.outline)
    hit = face.frame.to_world(np.stack([x, y, face.sag(x, y)], axis=1))
    end = Interaction.through(Surface(Frame(far[0], face.frame.axes)))
    traced = trace(Sequence((Interaction.reflect(face), end)), np.repeat(near, x.size, axis=0), hit - near)
    assert traced.valid.all()
    assert np.abs(traced.points[1] - far).max() < 10 * FOCUS_TOLERANCE  # magnified up to 9 times
    assert np.abs(traced.optical_path_length - 200.0 / (1 + conic)).max() < PATH_TOLERANCE


def test_a_catalogue_paraboloid_turns_the_light_by_its_off_axis_angle():
    focal_length, angle = 50.8, np.radians(30.0)
    form = {"radius": focal_length * (1 + np.cos(angle)), "off_axis": focal_length * np.sin(angle)}
    face = mirror({"conic": -1.0, "diameter": 25.4} | form).element().faces[0]
    to_focus = face.frame.to_world(np.array([[0.0, 0.0, form["radius"] / 2]]))[0] - face.middle
    assert np.linalg.norm(to_focus) == pytest.approx(focal_length, abs=OUTLINE_TOLERANCE)
    assert to_focus @ face.frame.axes[:, 2] / focal_length == pytest.approx(np.cos(angle), abs=OUTLINE_TOLERANCE)


def test_reflectance_is_of_the_intensity():
    element = mirror(PARABOLOID | {"reflectance": 0.81}).element()
    assert element.interaction(0, OUTSIDE).amplitude == pytest.approx(0.9, abs=1e-15)
    assert mirror(PARABOLOID).element().interaction(0, OUTSIDE).amplitude == 1.0


@pytest.mark.parametrize("conic", [0.0, -1.0, -2.0])
def test_light_that_climbs_in_a_deep_bowl_meets_its_wall(conic):
    """A ray sent from a point of the wall to another comes to that other, whether it goes up or down on its way."""
    face = mirror({"radius": 25.0, "conic": conic, "diameter": 48.0}).element().faces[0]
    angle = np.linspace(0.0, 2 * np.pi, 9)[:-1]
    for low, high in ((3.0, 23.0), (15.0, 15.5), (20.0, 20.0)):
        start, end = (
            np.stack([r * np.cos(a), r * np.sin(a), np.full(8, face.sag(r, 0.0))], axis=1)
            for r, a in ((low, angle), (high, angle + 2.0))
        )
        for one, two in ((start, end), (end, start)):
            one, two = face.frame.to_world(one + 0.01 * (two - one)), face.frame.to_world(two)
            traced = trace(Sequence((Interaction.reflect(face),)), one, two - one)
            assert traced.valid.all()
            assert np.abs(traced.points[0] - two).max() < FOCUS_TOLERANCE


# The mesh finds the mirror from both sides


@pytest.mark.parametrize("name", FORMS)
def test_rays_meet_the_mesh_inside_the_rim_from_both_sides_and_pass_beside_it(name):
    shape = mirror(FORMS[name])
    scene = mi.load_dict({"type": "scene", "mirror": shape})
    face = shape.element().faces[0]
    centre = np.array(face.outline.centre)[:, None]
    whole = np.stack(inside(face.outline))
    # Not at the corners of the mesh: a ray exactly on an edge can slip through in single precision.
    rim = np.stack(face.outline.edge(0.001 + np.linspace(0, 2 * np.pi, 1001)))
    high = 20.0 + 2 * abs(face.sag(face.outline.reach, 0.0))
    just_inside, beside = (centre + scale * (rim - centre) for scale in (1 - 1e-6, 1.01))
    for places, met in ((whole, True), (just_inside, True), (beside, False)):
        sag = face.sag(*places)
        for side in (-1.0, 1.0):
            start = face.frame.to_world(np.stack([*places, np.full(sag.size, side * high)], axis=1))
            direction = mi.Vector3f((-side * face.frame.axes[:, 2]).tolist())
            hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), direction))
            assert np.all(np.array(hit.is_valid()) == met)
            if places is whole:
                local = face.frame.to_local(np.array(hit.p, dtype=np.float64).T)
                normal = face.gradient(np.stack([*places, sag]))
                depth = (local[:, 2] - sag) * normal[2] / np.linalg.norm(normal, axis=0)
                assert np.abs(depth).max() < FACET_DEPTH


def test_changed_parameters_take_effect():
    shape = mirror(PARABOLOID)
    parameters = mi.traverse(shape)
    parameters["radius"], parameters["conic"], parameters["off_axis"] = -80.0, 0.5, 0.0
    parameters["diameter"], parameters["reflectance"] = 30.0, 0.25
    parameters["to_world"] = mi.Transform4f().translate([0, 0, 7])
    parameters.update()
    element = shape.element()
    face = element.faces[0]
    assert (face.curvature, face.conic, face.outline, element.amplitude) == (-1 / 80, 0.5, Circle(15.0), 0.5)
    assert face.frame.origin.tolist() == [0.0, 0.0, 7.0] and face.middle.tolist() == [0.0, 0.0, 7.0]
    np.testing.assert_allclose(element.body.bounds[:, :2], [[-15, -15], [15, 15]], rtol=1e-4)
    vertices = np.array(mi.traverse(shape)["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    np.testing.assert_allclose(vertices, element.body.vertices, atol=1e-5)  # single precision
    assert float(mi.traverse(shape.bsdf())["brdf_0.specular_reflectance.value"][0]) == 0.25
    parameters["diameter"] = 1000.0
    with pytest.raises(ValueError, match="'diameter' is 1000 mm, must be at most 130.6395 mm, where"):
        parameters.update()


@pytest.mark.parametrize(
    "change, message",
    [
        ({"diameter": 301.0, "radius": 200.0, "conic": 0.0, "off_axis": 50.0}, "at most 300 mm at 'off_axis' = 50 mm"),
        ({"radius": 10.0, "conic": 0.0, "off_axis": 0.0}, "'diameter' is 25 mm, must be at most 20 mm, where the"),
        ({"radius": 10.0, "conic": 0.0, "off_axis": -11.0}, "'off_axis' is -11 mm, must be less than 10 mm in size"),
        ({"diameter": 0.0}, "'diameter' is 0 mm, must be at least 1e-06 mm"),
        ({"reflectance": 0.0}, "'reflectance' is 0, must be above 0 and at most 1"),
        ({"reflectance": 1.5}, "'reflectance' is 1.5, must be above 0 and at most 1"),
        ({"conic": float("nan")}, "'conic' is nan"),
        ({"conic": -1e5}, "'conic' is -100000"),
        ({"off_axis": float("inf")}, "'off_axis' is inf"),
        ({"thickness": 5.0}, "thickness"),
    ],
)
def test_impossible_mirrors_are_refused(change, message):
    with pytest.raises(RuntimeError, match=message):
        mi.load_dict(PARABOLOID | change)


def test_a_mirror_without_a_diameter_is_refused():
    with pytest.raises(RuntimeError, match="'diameter' is missing"):
        mi.load_dict({"type": "mirror"})


# Fields

TO_THE_SIDE = np.stack([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]], axis=1)
"""Axes of a mirror whose axis is the world's x and whose local x the world's z: it turns light from below by 90 deg."""


def field_beside(tmp_path, assemble, frame: Frame, form: dict, source: np.ndarray, detector: Frame, middle):
    """Rendered and independent geometric field, (pixels,) each, of a source over one mirror, and the pixels (n, 3).

    middle: guess of local x, y on the mirror.
    """
    shape = element_xml("mirror", "mirror", frame, **form)
    assembly, _, field = rendered_unit(assemble, bench(tmp_path, source, detector, [shape], diffraction=False))
    conic, curvature = form.get("conic", 0.0), 1 / form["radius"]
    surface = Refractor(frame.origin, frame.axes, curvature, conic, 1.0)
    pixels = assembly.detector.points()
    start = np.tile(np.array(middle, float)[:, None], (1, len(pixels)))
    length, amplitude = fermat(source, [surface], pixels, start)
    return field, amplitude * np.exp(2j * np.pi / WAVELENGTH * length), pixels


def facing_x(x: float, z: float) -> Frame:
    """A detector at (x, 0, z) that looks along -x."""
    return Frame(np.array([x, 0.0, z]), np.stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], axis=1))


def test_field_over_an_off_axis_paraboloid_is_that_of_fermats_path_and_of_the_light_that_comes_straight(
    tmp_path, assemble
):
    frame = Frame(np.array([-50.0, 0.0, 0.0]), TO_THE_SIDE)  # its focus at the world's origin
    form = {"radius": 100.0, "conic": -1.0, "diameter": 50.0, "off_axis": 100.0}
    source = np.array([0.02, -0.03, 0.0])
    detector = facing_x(60.0, 100.0)
    field, over, pixels = field_beside(tmp_path, assemble, frame, form, source, detector, (100.0, 0.0))
    expected = over + spherical(source, pixels, WAVELENGTH)
    assert np.linalg.norm(field - expected) < FIELD_TOLERANCE * np.linalg.norm(expected)


@pytest.mark.parametrize("radius, axis", [(150.0, -1.0), (-150.0, 1.0), (-150.0, -1.0), (150.0, 1.0)])
def test_field_over_a_spherical_mirror_is_that_of_fermats_path_on_both_sides(tmp_path, assemble, radius, axis):
    """Concave and convex to the light, each with its front and with its back."""
    axes = tilted(0.0, 20.0, 0.0) @ np.diag([1.0, axis, axis])
    frame = Frame(np.array([0.0, 0.0, 90.0]), axes)
    sight = tilted(0.0, 40.0, 0.0) @ [0.0, 0.0, -1.0]
    place = frame.origin + 60.0 * sight
    across = np.array([0.0, 1.0, 0.0])
    detector = Frame(place, np.stack([np.cross(across, -sight), across, -sight], axis=1))
    form = {"radius": radius, "diameter": 50.0}
    field, expected, _ = field_beside(tmp_path, assemble, frame, form, np.zeros(3), detector, (0.0, 0.0))
    assert np.linalg.norm(field - expected) < FIELD_TOLERANCE * np.linalg.norm(expected)
