"""Mirrors, plates and lenses in whole scenes, against Fermat's principle and image sources; what a scene leaves out."""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import (
    BLACK,
    DIELECTRIC,
    MIRROR,
    Refractor,
    bench,
    element_xml,
    facing,
    fermat,
    lens_surfaces,
    rendered_unit,
    spherical,
    thin_lens_start,
    tilted,
)
from scipy.optimize import brentq

from speckle_mi.field import simulation as simulate, stages as fields
from speckle_mi.plan import plan
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.scene.errors import SceneError
from speckle_mi.field.simulation import simulate_frame

WAVELENGTH = 632.8e-6
K = 2 * np.pi / WAVELENGTH
INDEX = 1.5151

LENS_PHASE = 1e-5  # rms, in wavelengths: the promise for traced elements.
MIRROR_PHASE = 1e-6  # The promise for plane mirrors, which are exact but for double-precision rounding.
FIELD = 1e-5  # Relative L2: ten times the error that the scenes ask for.
MIRROR_AMPLITUDE = 1e-6  # Relative, at the worst pixel: ten times the L2 error that the scene asks for.
AMPLITUDE = 1e-5  # Relative; amplitudes change slowly, so this is below what the field's tolerance allows.


def waves_rms(field, exact) -> float:
    return float(np.sqrt(np.mean(np.angle(field / exact) ** 2)) / (2 * np.pi))


def check_field(field, length, amplitude, phase_tolerance=LENS_PHASE):
    exact = amplitude * np.exp(1j * K * length)
    assert np.all(np.isfinite(field)) and np.all(np.abs(field) > 0)
    assert waves_rms(field, exact) <= phase_tolerance
    assert np.max(np.abs(np.abs(field) / np.abs(exact) - 1)) <= AMPLITUDE


# Lenses. Radii, conics, thickness; f is only the start of the reference's search.

LENSES = {
    "biconvex": dict(radius1=50.0, radius2=-50.0, thickness=5.0),
    "planoconvex": dict(radius1=0.0, radius2=-25.755, thickness=4.0),
    "convexplano": dict(radius1=25.755, radius2=0.0, thickness=4.0),
    "asphere": dict(radius1=25.755, radius2=0.0, conic1=-0.6, thickness=4.0),
    "asphere_reversed": dict(radius1=0.0, radius2=-25.755, conic2=-2.2956, thickness=4.0),
    "meniscus": dict(radius1=30.0, radius2=80.0, conic1=-0.5, thickness=4.0),
    "biconcave": dict(radius1=-40.0, radius2=60.0, thickness=2.0),
    "oblate": dict(radius1=60.0, radius2=-60.0, conic1=3.0, conic2=1.0, thickness=5.0),
}
SOURCES = {"on_axis": (0.0, 0.0, 0.0), "off_axis": (0.5, -1.5, 0.1)}
PLACES = {"straight": ((0.0, 0.0, 90.0), (0.0, 0.0, 0.0)), "tilted": ((0.8, -0.5, 90.0), (6.0, -4.0, 20.0))}


def focal_length(radius1, radius2, thickness, **_):
    one, two = (1 / r if r else 0.0 for r in (radius1, radius2))
    return 1 / ((INDEX - 1) * (one - two + (INDEX - 1) * thickness * one * two / INDEX))


def lens_case(form, place):
    origin, turn = PLACES[place]
    frame = Frame(np.array(origin), tilted(*turn))
    xml = element_xml("lens", "lens", frame, diameter=20.0, ior=INDEX, **form)
    return lens_surfaces(frame.origin, frame.axes, index=INDEX, **form), xml


@pytest.mark.parametrize("detector_z", [110.0, 350.0])  # Well before and well behind every image.
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("name", LENSES)
def test_field_behind_a_lens_is_that_of_the_path_fermat_gives(assemble, tmp_path, name, source, place, detector_z):
    form, point = LENSES[name], np.array(SOURCES[source])
    surfaces, xml = lens_case(form, place)
    # Where the light goes: scaled with the lens's magnified cone so that the same part of it is looked at.
    pitch = 0.05 if detector_z < 200 else 0.15
    text = bench(tmp_path, point, facing(detector_z, 0.3, 0.2, (5, 8, 0)), [xml], pitch=pitch, diffraction=False)
    assembly, _, field = rendered_unit(assemble, text)
    targets = assembly.detector.points()
    length, amplitude = fermat(
        point, surfaces, targets, thin_lens_start(point, targets, surfaces, focal_length(**form))
    )
    check_field(field, length, amplitude)


def ball_surfaces(centre, radius):
    centre, axes = np.asarray(centre, float), np.eye(3)
    return [
        Refractor(centre - [0, 0, radius], axes, 1 / radius, 0.0, INDEX),
        Refractor(centre + [0, 0, radius], axes, -1 / radius, 0.0, 1.0),
    ]


@pytest.mark.parametrize("distance, detector_z", [(6.5, 60.0), (20.0, 60.0)])
@pytest.mark.parametrize("source", [(0.0, 0.0, 0.0), (0.3, -0.4, 0.0)])
def test_field_behind_a_ball_lens_is_that_of_the_path_fermat_gives(assemble, tmp_path, distance, detector_z, source):
    centre, radius = np.array([0.1, 0.0, distance]), 3.0
    xml = element_xml("sphere", "ball", Frame(centre, np.eye(3)), DIELECTRIC, radius=radius)
    text = bench(tmp_path, source, facing(detector_z), [xml], pitch=0.01, diffraction=False)
    assembly, _, field = rendered_unit(assemble, text)
    targets = assembly.detector.points()
    surfaces = ball_surfaces(centre, radius)
    start = thin_lens_start(source, targets, surfaces, INDEX * radius / (2 * (INDEX - 1)))
    length, amplitude = fermat(source, surfaces, targets, start)
    check_field(field, length, amplitude)


def test_two_lenses_and_a_plate_in_a_row_tilted_and_off_axis(assemble, tmp_path):
    source = np.array([0.2, -0.3, 0.0])
    first, second = LENSES["planoconvex"], LENSES["biconvex"]
    one, two = Frame(np.array([0.4, 0.0, 47.0]), tilted(2, 3, 0)), Frame(np.array([-0.3, 0.5, 80.0]), tilted(-3, 1, 9))
    plate = Frame(np.array([0.0, 0.0, 65.0]), tilted(15, -10, 30))
    elements = [
        element_xml("lens", "b_second", two, diameter=20.0, ior=INDEX, **second),
        element_xml("cube", "plate", plate, DIELECTRIC, size=(8, 9, 1.5)),
        element_xml("lens", "a_first", one, diameter=20.0, ior=INDEX, **first),
    ]
    sides = [plate.origin + sign * 1.5 * plate.axes[:, 2] for sign in (-1, 1)]
    surfaces = [
        *lens_surfaces(one.origin, one.axes, index=INDEX, **first),
        Refractor(sides[0], plate.axes, 0.0, 0.0, INDEX),
        Refractor(sides[1], plate.axes, 0.0, 0.0, 1.0),
        *lens_surfaces(two.origin, two.axes, index=INDEX, **second),
    ]
    for elements_in_order in (elements, elements[::-1]):
        text = bench(tmp_path, source, facing(100.0), elements_in_order, diffraction=False)
        assembly, frame, field = rendered_unit(assemble, text)
        assert "target - a_first - a_first - plate - plate - b_second - b_second - detector" in frame.plan[0]
        targets = assembly.detector.points()
        length, amplitude = fermat(source, surfaces, targets, np.tile(targets[:, :2].T, (len(surfaces), 1)))
        check_field(field, length, amplitude)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (20.0, 0.0, 0.0), (25.0, -20.0, 40.0)])
def test_plate_lengthens_the_path_as_snells_law_says(assemble, tmp_path, turn):
    source, thickness, frame = np.array([0.3, 0.2, 0.0]), 4.0, Frame(np.array([0.0, 0.0, 20.0]), tilted(*turn))
    xml = element_xml("cube", "plate", frame, DIELECTRIC, size=(10, 10, thickness / 2))
    assembly, _, field = rendered_unit(assemble, bench(tmp_path, source, facing(60.0), [xml], diffraction=False))
    away = assembly.detector.points() - source
    along, across = away @ frame.axes[:, 2], np.linalg.norm(np.cross(away, frame.axes[:, 2]), axis=1)

    def path(gap, offset):
        """Length over a plate: sine s outside with (gap - t) tan + t tan' = offset."""

        def miss(s):
            return (gap - thickness) * s / np.sqrt(1 - s * s) + thickness * s / np.sqrt(INDEX**2 - s * s) - offset

        s = brentq(miss, 0.0, 0.999, xtol=1e-16, rtol=1e-15)
        return (gap - thickness) / np.sqrt(1 - s * s) + thickness * INDEX**2 / np.sqrt(INDEX**2 - s * s)

    length = np.array([path(*pair) for pair in zip(along, across, strict=True)])
    assert waves_rms(field, np.exp(1j * K * length)) <= LENS_PHASE


# Mirrors


def reflected(points, frame):
    """Image of points (.., 3) in the plane z = 0 of a frame."""
    normal = frame.axes[:, 2]
    return points - 2 * ((points - frame.origin) @ normal)[..., None] * normal


def looking_along(origin, heading):
    """A detector at ``origin`` that faces light coming along ``heading``."""
    from scene_builder import frame_along

    return frame_along(-np.asarray(heading), np.asarray(origin, float), np.array([0.0, 1.0, 0.0]))


@pytest.mark.parametrize("shape, size", [("rectangle", (9, 7, 1)), ("disk", (8, 8, 1))])
@pytest.mark.parametrize("turn", [(0, 135, 0), (150, 31, 17)])
def test_field_over_a_plane_mirror_is_that_of_the_image_source(assemble, tmp_path, shape, size, turn):
    mirror = Frame(np.array([0.3, -0.2, 40.0]), tilted(*turn))
    heading = reflected(np.array([0.0, 0, 1]) + mirror.origin, mirror) - mirror.origin
    detector = looking_along(mirror.origin + 31.7 * heading, heading)
    source = np.array([0.2, -0.1, 0.03])
    xml = element_xml(shape, "mirror", mirror, MIRROR, size=size)
    wall = element_xml(
        "rectangle",
        "wall",
        Frame(0.5 * detector.origin, looking_along([0, 0, 0], detector.origin / np.linalg.norm(detector.origin)).axes),
        BLACK,
        size=(6, 6, 1),
    )
    text = bench(tmp_path, source, detector, [xml, wall], tolerance=1e-7, diffraction=False)
    assembly, frame, field = rendered_unit(assemble, text)
    exact = spherical(reflected(source, mirror), assembly.detector.points(), WAVELENGTH)
    assert waves_rms(field, exact) <= MIRROR_PHASE
    assert np.max(np.abs(np.abs(field / exact) - 1)) <= MIRROR_AMPLITUDE
    assert any("unfolded" in line for line in frame.plan)


def test_field_over_two_mirrors_is_that_of_the_image_of_the_image(assemble, tmp_path):
    first, second = Frame(np.array([0.0, 0, 30]), tilted(0, 135, 0)), Frame(np.array([25.0, 0, 30]), tilted(31, -40, 0))
    for mirror in (first, second):
        assert np.linalg.det(mirror.axes) == pytest.approx(1)
    heading = (
        reflected(reflected(np.array([0.0, 0, 1]) + first.origin, first) - first.origin + second.origin, second)
        - second.origin
    )
    detector = looking_along(second.origin + 28 * heading, heading)
    source = np.array([-0.1, 0.2, 0.0])
    elements = [element_xml("rectangle", n, m, MIRROR, size=(7, 7, 1)) for n, m in (("z1", first), ("a2", second))]
    assembly, frame, field = rendered_unit(
        assemble, bench(tmp_path, source, detector, elements, tolerance=1e-7, diffraction=False)
    )
    image = reflected(reflected(source, first), second)
    exact = spherical(image, assembly.detector.points(), WAVELENGTH)
    assert any("target - z1 - a2 - detector" in line for line in frame.plan)
    direct = (
        spherical(source, assembly.detector.points(), WAVELENGTH)
        if any("way: target - detector" in line for line in frame.plan)
        else 0
    )
    assert waves_rms(field, exact + direct) <= MIRROR_PHASE


def test_field_over_a_convex_mirror_is_that_of_the_path_fermat_gives(assemble, tmp_path):
    centre, radius, source = np.array([12.0, 0.0, 45.0]), 12.0, np.array([0.1, 0.2, 0.0])
    detector = looking_along([-40.0, 0.0, 40.0], [-1.0, 0.0, 0.0])
    wall = element_xml(
        "rectangle",
        "wall",
        Frame(np.array([-20.0, 0, 20]), looking_along([0, 0, 0], np.array([-1, 0, 1]) / 2**0.5).axes),
        BLACK,
        size=(5, 5, 1),
    )
    xml = element_xml("sphere", "ball", Frame(centre, np.eye(3)), MIRROR, radius=radius)
    assembly, _, field = rendered_unit(assemble, bench(tmp_path, source, detector, [xml, wall], diffraction=False))
    targets = assembly.detector.points()
    towards = -np.array([1.0, 0, 1.0]) / 2**0.5  # from the centre, about half way between source and detector
    axes = np.stack([np.array([0.0, 1, 0]), np.cross(-towards, [0.0, 1, 0]), -towards], axis=1)
    mirror = Refractor(centre + radius * towards, axes, 1 / radius, 0.0, 1.0)
    length, amplitude = fermat(source, [mirror], targets, np.zeros((2, len(targets))))
    check_field(field, length, np.abs(amplitude))


# Blockers, and what is left out


def test_light_behind_an_opaque_plate_is_missing_and_the_rest_is_free(assemble, tmp_path):
    source = np.array([0.0, 0.0, 0.0])
    blocker = element_xml("rectangle", "card", Frame(np.array([5.0, 0, 20]), np.eye(3)), BLACK, size=(5, 5, 1))
    assembly, frame, field = rendered_unit(
        assemble, bench(tmp_path, source, facing(60.0), [blocker], pixels=(41, 21), diffraction=False)
    )
    points = assembly.detector.points()
    shaded = points[:, 0] > 1e-6
    exact = spherical(source, points, WAVELENGTH)
    clear = np.abs(points[:, 0]) > 0.02
    assert np.all(field[shaded & clear] == 0)
    assert np.linalg.norm((field - exact)[~shaded & clear]) <= FIELD * np.linalg.norm(exact)


def test_wall_of_the_folded_scene_leaves_only_the_mirrors_light(shipped):
    assembly = shipped("folded", width=60, height=40, tolerance=1e-6)
    frame = simulate_frame(assembly, Pose(x=0.01, ry=0.05))
    mirror = Frame(np.array([0.0, 0, 40.0]), tilted(0, 135, 0))
    places = reflected(assembly.detector.points(), mirror)
    exact = sum(
        c * spherical(p, places, WAVELENGTH)
        for p, c in zip(frame.scatterers.position, frame.scatterers.amplitude, strict=True)
    )
    assert np.linalg.norm(frame.image.field.ravel() - exact) <= FIELD * np.linalg.norm(exact)


def fails(name):
    def called(*arguments, **options):
        raise AssertionError(f"{name} was called")

    return called


def test_free_space_launches_no_ray_traces_nothing_and_diffracts_nothing(shipped, monkeypatch):
    for module, name in (
        (plan, "find_routes"),
        (plan, "rays_over"),
        (fields, "aim"),
        (fields, "TracedLeg"),
        (fields, "nodes_on"),
        (fields, "edge_sum"),
    ):
        monkeypatch.setattr(module, name, fails(name))
    frame = simulate_frame(shipped("tilted_laser", width=16, height=12))
    assert "free space" in frame.plan[0] and np.all(frame.image.intensity > 0)


def test_mirrors_alone_trace_no_lens_and_diffract_nothing(shipped, monkeypatch):
    for name in ("TracedLeg", "RayleighSommerfeld", "nodes_on", "edge_sum"):
        monkeypatch.setattr(fields, name, fails(name))
    frame = simulate_frame(shipped("folded", width=24, height=16))
    assert any("unfolded: plane mirror mirror" in line for line in frame.plan)
    assert not any("traced" in line or "diffracted at" in line for line in frame.plan)


def test_an_aperture_far_larger_than_the_light_diffracts_nothing(shipped, monkeypatch):
    for name in ("TracedLeg", "RayleighSommerfeld", "nodes_on", "edge_sum"):
        monkeypatch.setattr(fields, name, fails(name))
    assembly = shipped("integrated_sensor", width=24, height=16, aperture_radius=5, tolerance=1e-6)
    frame = simulate_frame(assembly)
    exact = sum(
        c * spherical(p, assembly.detector.points(), WAVELENGTH)
        for p, c in zip(frame.scatterers.position, frame.scatterers.amplitude, strict=True)
    )
    assert np.linalg.norm(frame.image.field.ravel() - exact) <= FIELD * np.linalg.norm(exact)
    assert any("diffracts nothing" in line for line in frame.plan)


def test_plan_is_kept_with_the_image(shipped):
    header = simulate.simulate(shipped("folded", width=8, height=8)).header
    unfolded, *_ = [stage for stage in header["plan"] if stage["kind"] == "unfolded"]
    assert unfolded["elements"] == ["mirror"] and unfolded["way"] == "target - mirror - detector"
    done, *_ = [stage for stage in header["plan"] if stage["kind"] == "sum"]
    assert done["how"]["points"] == 64 and 0 < done["error"] < 1e-4 and done["seconds"] > 0


# Refusals


@pytest.mark.parametrize(
    "shape, named",
    [
        (
            element_xml("cylinder", "rod", Frame(np.array([0.0, 0, 20]), np.eye(3)), DIELECTRIC, radius=2.0),
            ("rod", "dielectric"),
        ),
        (
            element_xml("rectangle", "film", Frame(np.array([0.0, 0, 20]), np.eye(3)), DIELECTRIC, size=(5, 5, 1)),
            ("film",),
        ),
        (element_xml("cube", "block", Frame(np.array([0.0, 0, 20]), np.eye(3)), MIRROR, size=(5, 5, 1)), ("block",)),
        (element_xml("sphere", "egg", Frame(np.array([0.0, 0, 20]), np.eye(3)), DIELECTRIC, size=(2, 2, 3)), ("egg",)),
        (
            element_xml("disk", "oval", Frame(np.array([0.0, 0, 20]), tilted(180, 0, 0)), MIRROR, size=(2, 3, 1)),
            ("oval",),
        ),
        (
            element_xml(
                "rectangle", "frosted", Frame(np.array([0.0, 0, 20]), np.eye(3)), '<bsdf type="roughdielectric"/>'
            ),
            ("frosted",),
        ),
        (
            element_xml(
                "rectangle",
                "half",
                Frame(np.array([0.0, 0, 20]), np.eye(3)),
                '<bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="diffuse"/></bsdf>',
            ),
            ("half",),
        ),
    ],
)
def test_what_cannot_be_handled_is_refused_by_name(assemble, tmp_path, shape, named):
    with pytest.raises((SceneError, RuntimeError, ValueError)) as caught:
        simulate_frame(assemble(bench(tmp_path, (0, 0, 0), facing(60.0), [shape])))
    for word in named:
        assert word in str(caught.value).lower()


@pytest.mark.parametrize("scene, values", [("imaging", {}), ("telecentric", {}), ("ball_lens", {})])
def test_geometric_light_at_a_focus_is_refused_with_the_reason(shipped, scene, values):
    with pytest.raises(SceneError, match="focus|caustic") as caught:
        simulate_frame(shipped(scene, diffraction="false", width=16, height=16, point_sources=10, **values))
    assert "diffraction" in str(caught.value)


def test_several_rays_to_one_pixel_are_refused_and_not_one_of_them_shown(assemble, tmp_path):
    # Spherical aberration: three rays of an unstopped ball lens meet near its axis before the paraxial image.
    xml = element_xml("sphere", "ball", Frame(np.array([0.0, 0, 20.0]), np.eye(3)), DIELECTRIC, radius=3.0)
    with pytest.raises(SceneError, match="several rays"):
        simulate_frame(assemble(bench(tmp_path, (0, 0, 0), facing(24.0), [xml], pitch=0.01, diffraction=False)))


# Stages against each other


def test_rays_converge_to_the_exact_field_through_lens_and_stop_as_their_number_grows(shipped):
    values = dict(
        width=32,
        height=24,
        pixel_pitch=0.02,
        point_sources=1,
        detector_distance=140,
        stop_radius=4,
        diffraction="false",
    )
    exact = simulate_frame(shipped("imaging", tolerance=1e-6, **values))
    assembly = shipped("imaging", method="rays", **values)
    errors = []
    for rays in (16, 36, 400):
        field = simulate_frame(assembly.with_options(rays_per_source=rays)).image.field
        errors.append(np.linalg.norm(field - exact.image.field) / np.linalg.norm(exact.image.field))
    assert np.all(np.diff(errors) < 0) and errors[-1] < 1e-6, errors
