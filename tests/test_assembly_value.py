"""A scene is a value: what it gives depends on what it holds, not on what was done before, in which process or thread."""

from __future__ import annotations

import multiprocessing
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from exact_optics import BLACK, MIRROR, bench, element_xml, facing, spherical, tilted
from scene_builder import detector_frame, direction, free_space
from test_surface_mesh import shaft, write_mesh

from speckle_mi.field.simulation import Simulation, simulate_frame
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.scene.assembly import Assembly
from speckle_mi.scene.read import assembly_from_scene

WAVELENGTH = 632.8e-6
THREADS = 8
SMALL = {"width": 24, "height": 16}
SPREAD = np.array([[0.0, 0.0, 0.0], [0.4, 0.1, 0.0], [-0.3, 0.2, 0.01], [0.1, -0.5, -0.01]])
TOLERANCE = 1e-4  # Relative L2 error that the scenes ask of their fields.


def card(x: float, z: float, size: float = 10.0) -> str:
    """An opaque square whose edge is at x, all of it on the larger x."""
    return element_xml("rectangle", "card", Frame(np.array([x + size, 0.0, z]), np.eye(3)), BLACK, size=(size, size, 1))


def shaded(tmp_path, x: float, z: float = 25.0) -> str:
    """Four scatterers, half of the detector in the geometric shadow of a card."""
    return bench(tmp_path, SPREAD, facing(60), [card(x, z)], pixels=(48, 8), diffraction=False)


def folded_points(tmp_path) -> str:
    """Scatterers of the user's own, 5 mm behind the target's plane, seen in a mirror; a wall stops straight light."""
    mirror = Frame(np.array([0.0, 0.0, 40.0]), tilted(0, 135, 0))
    place = detector_frame(direction(90), 30.0)
    wall = Frame(np.array([8.0, 0, 13]), tilted(0, 90, 0))
    elements = [
        element_xml("rectangle", "mirror", mirror, MIRROR, size=(8, 8, 1)),
        element_xml("rectangle", "wall", wall, BLACK, size=(12, 12, 1)),
    ]
    detector = Frame(place.origin + [0, 0, 40.0], place.axes)
    return bench(tmp_path, SPREAD - [0.0, 0.0, 5.0], detector, elements, diffraction=False)


def image_of(mitsuba, scene) -> np.ndarray:
    return np.array(mitsuba.render(scene))


def changed(mitsuba, scene, **values) -> None:
    """Sets parameters of a scene, ``__`` for the dot in their names."""
    parameters = mitsuba.traverse(scene)
    for name, value in values.items():
        parameters[name.replace("__", ".")] = value
    parameters.update()


# The user's scene stays as it is


def test_a_render_leaves_the_users_shapes_their_names_and_parameters(mitsuba, tmp_path):
    scene = mitsuba.load_string(folded_points(tmp_path))
    names, keys = [shape.id() for shape in scene.shapes()], set(mitsuba.traverse(scene).keys())
    image_of(mitsuba, scene)
    assert {"wall", "mirror"} < set(names) and [shape.id() for shape in scene.shapes()] == names
    assert set(mitsuba.traverse(scene).keys()) == keys


def test_points_seen_in_a_mirror_give_the_same_bits_in_every_render(mitsuba, tmp_path):
    scene = mitsuba.load_string(folded_points(tmp_path))
    first, second = image_of(mitsuba, scene), image_of(mitsuba, scene)
    assert first[..., 0].max() > 0
    np.testing.assert_array_equal(first, second)


KEYS = {
    "laser": {"to_world", "wavelength", "beam_radius", "wavefront_radius"},
    "target": {"to_world", "roughness", "correlation_length", "seed", "x", "y", "z", "rx", "ry", "rz", "faces",
               "vertex_positions", "vertex_normals", "vertex_texcoords", "bsdf.reflectance.value"},
    "detector": {"to_world", "pixel_pitch", "film.size", "film.crop_size", "film.crop_offset"},
}  # fmt: skip
"""What programs outside set in scenes."""


def test_what_can_be_set_in_a_scene_keeps_its_names(mitsuba):
    keys = set(mitsuba.traverse(mitsuba.load_string(free_space())).keys())
    assert {f"{part}.{name}" for part, names in KEYS.items() for name in names} <= keys


# What is moved, moves


def test_a_shadow_goes_where_the_part_that_casts_it_is_moved(mitsuba, tmp_path):
    scene = mitsuba.load_string(shaded(tmp_path, 0.0))
    at_first = image_of(mitsuba, scene)
    place = mitsuba.traverse(scene)["card.to_world"]
    moved = mitsuba.Transform4f().translate([0.25, 0.0, 0.0]) @ mitsuba.Transform4f(place)
    changed(mitsuba, scene, card__to_world=moved)
    after = image_of(mitsuba, scene)
    fresh = image_of(mitsuba, mitsuba.load_string(shaded(tmp_path, 0.25)))
    np.testing.assert_array_equal(after, fresh)
    lit_before, lit_after = (np.count_nonzero(image[..., 0].mean(axis=0)) for image in (at_first, after))
    # The card's edge at z = 25 mm shades the detector at 60 mm: 0.25 mm there are 0.6 mm here, 12 pixels.
    assert lit_after - lit_before == pytest.approx(0.25 * 60 / 25 / 0.05, abs=1)


def test_a_target_behind_a_wall_is_dark_whatever_was_rendered_before(mitsuba, tmp_path):
    """Points that stand before a wall, and behind it after a move by -10 mm."""
    wall = element_xml("rectangle", "wall", Frame(np.array([0.0, 0, -5.0]), np.eye(3)), BLACK, size=(9, 9, 1))
    text = bench(tmp_path, SPREAD, facing(60), [wall], diffraction=False)
    scene, fresh = mitsuba.load_string(text), mitsuba.load_string(text)
    at_rest = image_of(mitsuba, scene)
    for one in (scene, fresh):
        changed(mitsuba, one, target__z=-10.0)
    assert at_rest[..., 0].min() > 0
    with pytest.warns(UserWarning, match="wall"):
        np.testing.assert_array_equal(image_of(mitsuba, scene), 0)
    with pytest.warns(UserWarning, match="wall"):
        np.testing.assert_array_equal(image_of(mitsuba, fresh), 0)


def test_a_pose_gives_the_same_bits_whatever_was_rendered_before(assemble, tmp_path):
    assembly = assemble(folded_points(tmp_path))
    moved, used = Pose(z=-10.0), Simulation(assembly)
    for pose in (Pose(), Pose(z=5.0), moved):
        found = used.frame(pose)
    alone = simulate_frame(assembly, moved)
    assert np.abs(alone.image.field).max() > 0
    np.testing.assert_array_equal(found.image.field, alone.image.field)


@pytest.mark.parametrize("move", ["target__x", "target__rz", "detector__pixel_pitch", "laser__wavelength"])
def test_there_and_back_gives_the_same_bits(mitsuba, move):
    scene = mitsuba.load_string(free_space(direction(35, 180), detector=SMALL))
    rest = mitsuba.traverse(scene)[move.replace("__", ".")]
    rest = type(rest)(rest)
    before = image_of(mitsuba, scene)
    changed(mitsuba, scene, **{move: rest * 1.5 + 0.125})
    assert not np.array_equal(image_of(mitsuba, scene), before)
    changed(mitsuba, scene, **{move: rest})
    np.testing.assert_array_equal(image_of(mitsuba, scene), before)


def test_a_part_moved_there_and_back_gives_the_same_bits(mitsuba, tmp_path):
    scene = mitsuba.load_string(shaded(tmp_path, 0.3))
    before, place = image_of(mitsuba, scene), mitsuba.Transform4f(mitsuba.traverse(scene)["card.to_world"])
    changed(mitsuba, scene, card__to_world=mitsuba.Transform4f().translate([0.5, 0.0, 0.0]) @ place)
    assert not np.array_equal(image_of(mitsuba, scene), before)
    changed(mitsuba, scene, card__to_world=place)
    np.testing.assert_array_equal(image_of(mitsuba, scene), before)


# What is told


def test_a_renders_warnings_are_pythons(mitsuba):
    scene = mitsuba.load_string(free_space(direction(35, 180), detector=SMALL))
    changed(mitsuba, scene, target__x=10.0)
    with pytest.warns(UserWarning, match="no light: the beam misses the target"):
        assert not image_of(mitsuba, scene).any()


# A value


def test_opaque_shapes_of_equal_extent_make_different_assemblies(assemble, tmp_path):
    place = Frame(np.array([3.0, 0.0, 25.0]), np.eye(3))
    disk, square, again = (
        assemble(bench(tmp_path, SPREAD, facing(60), [element_xml(form, "card", place, BLACK, size=(2, 2, 1))]))
        for form in ("disk", "rectangle", "disk")
    )
    assert np.array_equal(disk.elements[0].body.bounds, square.elements[0].body.bounds)
    assert disk != square and disk.fingerprint() != square.fingerprint()
    assert disk == again and hash(disk) == hash(again) and disk.fingerprint() == again.fingerprint()


@pytest.mark.parametrize(
    "change",
    [{"target": {"roughness": 0.9}}, {"laser": {"beam_radius": 0.13}}, {"detector": {"pixel_pitch": 0.007}},
     {"integrator": {"tolerance": 1e-5}}, {"target": {"seed": 1}}, {"detector_distance": 60.0 + 1e-9}],
)  # fmt: skip
def test_whatever_changes_the_field_makes_another_assembly(assemble, change):
    one, other = assemble(free_space()), assemble(free_space(**change))
    assert one == assemble(free_space()) and one != other and hash(one) != hash(other)


SHAFT = {"radius": 0.5, "sides": 24}
METAL = {"type": "roughconductor", "material": "Al", "alpha": 0.25}
FAR = 6000.0
"""Distance of the detector from a shaft [mm], from where a facet's places are seen in one direction to 1e-4."""


def shaft_scene(tmp_path, **target) -> str:
    """A shaft of flat sides under a collimated beam that is about as wide, each side with the lobe of a metal."""
    path = write_mesh(tmp_path / "shaft.ply", shaft(length=2.0, **SHAFT))
    bsdf = '<bsdf type="{type}"><string name="material" value="{material}"/><float name="alpha" value="{alpha}"/></bsdf>'
    lobed = {"filename": str(path), "roughness": 0.3, "point_sources": 30, "lobe": True, "bsdf": bsdf.format(**METAL)}
    return free_space(
        direction(30, 180), direction(10, 0), laser={"beam_radius": 0.2, "wavefront_radius": None},
        target=lobed | target, detector_distance=FAR, detector=SMALL | {"pixel_pitch": FAR / 600},
    )  # fmt: skip


SCENES = {"folded points": folded_points, "shadow": lambda folder: shaded(folder, 0.3), "shaft": shaft_scene}


def field_of(assembly: Assembly) -> np.ndarray:
    return simulate_frame(assembly).image.field


def field_and_hash_of(pickled: bytes) -> tuple[np.ndarray, str, int]:
    """What another process makes of an assembly that was sent to it."""
    assembly = pickle.loads(pickled)
    return field_of(assembly), assembly.fingerprint(), hash(assembly)


@pytest.mark.parametrize("name", SCENES)
def test_an_assembly_restored_from_its_bytes_is_equal_and_gives_the_same_bits(assemble, tmp_path, name):
    assembly = assemble(SCENES[name](tmp_path))
    restored = pickle.loads(pickle.dumps(assembly))
    assert restored == assembly and hash(restored) == hash(assembly)
    field = field_of(assembly)
    assert np.abs(field).max() > 0
    np.testing.assert_array_equal(field_of(restored), field)


def test_an_assembly_gives_the_same_bits_in_a_process_that_never_saw_its_scene(assemble, tmp_path):
    assemblies = [assemble(make(tmp_path)) for make in SCENES.values()]
    for file in tmp_path.iterdir():
        file.unlink()
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        there = pool.map(field_and_hash_of, [pickle.dumps(assembly) for assembly in assemblies])
    for assembly, (field, fingerprint, number) in zip(assemblies, there, strict=True):
        np.testing.assert_array_equal(field, field_of(assembly))
        assert fingerprint == assembly.fingerprint() and number == hash(assembly)


@pytest.mark.parametrize("name", SCENES)
def test_eight_threads_at_once_give_the_bits_of_one(assemble, tmp_path, name):
    assembly = assemble(SCENES[name](tmp_path))
    expected, shared = field_of(assembly), Simulation(assembly)
    with ThreadPoolExecutor(THREADS) as threads:
        found = [threads.submit(shared.frame) for _ in range(THREADS)]
        found += [threads.submit(simulate_frame, assembly) for _ in range(THREADS)]
        for future in found:
            np.testing.assert_array_equal(future.result().image.field, expected)


# Every scatterer has the lobe of its own facet


def normals_of_shaft(position: np.ndarray, radius: float, sides: int) -> np.ndarray:
    """Outward normals (n, 3) of the flat sides that places (n, 3) lie on, the axis of the shaft at z = -radius."""
    step = 2 * np.pi / sides
    angle = np.arctan2(position[:, 0], position[:, 2] + radius)
    middle = (np.floor(angle / step) + 0.5) * step
    return np.stack([np.sin(middle), np.zeros(len(middle)), np.cos(middle)], axis=1)


def lobe_of_metal(mitsuba, normals, to_light, directions) -> np.ndarray:
    """sqrt(f cos) (n, m) of a rough metal with unit normals (n, 3), lit from (n, 3), towards (n, m, 3)."""
    across = np.cross([0.0, 1.0, 0.0], normals)
    axes = np.stack([across, np.cross(normals, across), normals], axis=1)
    incoming = np.einsum("nij,nj->ni", axes, to_light)
    outgoing = np.einsum("nij,nmj->nmi", axes, directions)
    interaction = mitsuba.SurfaceInteraction3f()
    interaction.wi = mitsuba.Vector3f(np.repeat(incoming, directions.shape[1], axis=0).T.astype(np.float32))
    towards = mitsuba.Vector3f(outgoing.reshape(-1, 3).T.astype(np.float32))
    values = np.array(mitsuba.load_dict(METAL).eval(mitsuba.BSDFContext(), interaction, towards)[0])
    return np.sqrt(np.maximum(values, 0)).reshape(directions.shape[:2])


def test_light_of_a_curved_target_is_the_sum_of_lobes_about_every_facets_own_normal(mitsuba, assemble, tmp_path):
    assembly = assemble(shaft_scene(tmp_path, roughness=0.0))
    frame = simulate_frame(assembly)
    lit, pixels = frame.scatterers, assembly.detector.points()
    rays = pixels - lit.position[:, None]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    to_light = assembly.beam.directions_to_source(lit.position)
    waves = lit.amplitude[:, None] * spherical(lit.position[:, None], pixels, WAVELENGTH)
    own = normals_of_shaft(lit.position, **SHAFT)
    assert len(np.unique(own[:, 0].round(6))) >= 4
    one = np.broadcast_to(assembly.spot.normal, own.shape)
    by_own, by_one = (np.sum(lobe_of_metal(mitsuba, n, to_light, rays) * waves, axis=0) for n in (own, one))
    field = frame.image.field.ravel()
    assert np.linalg.norm(field - by_own) <= TOLERANCE * np.linalg.norm(by_own)
    assert np.linalg.norm(field - by_one) > 100 * TOLERANCE * np.linalg.norm(by_one)


def test_a_scene_is_read_the_same_after_its_render(mitsuba, tmp_path):
    scene = mitsuba.load_string(folded_points(tmp_path))
    before = assembly_from_scene(scene)
    image_of(mitsuba, scene)
    assert assembly_from_scene(scene) == before
