"""The scene that is written is the scene that is loaded: every digit, every plugin, every text."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.scene.read import assembly_from_scene
from speckle_mi.scene.write import (
    Default,
    Typed,
    aimed,
    detector,
    direction,
    integrator,
    laser,
    material,
    on_axis,
    rough_target,
    scene_text,
    shape,
    write_points,
    write_scene,
)
from speckle_mi.validation.benchmark.specimen import SCENE

ROUNDING = 1e-14
"""Of unit vectors that one side turns by rotations and the other writes down as a matrix."""


def parts(**target):
    return (
        integrator(method="direct", diffraction=False),
        laser(aimed(50 * direction(35, 180)), beam_radius=0.12, wavefront_radius=-750.0),
        rough_target(**{"point_sources": 30} | target),
        detector(aimed(60 * direction(0)), 32, 24),
    )


def test_places_and_numbers_come_back_with_every_digit(assemble):
    random = np.random.default_rng(3)
    turned = Frame(random.normal(0, 1e-3, 3), rotation_matrix(random.normal(0, 0.1, 3)))
    radius = 0.1 + 1e-17 + random.random() / 3
    assembly = assemble(
        scene_text(
            integrator(),
            laser(aimed(50 * direction(35, 180)), wavelength=632.8160112345678, beam_radius=radius),
            rough_target(turned),
            detector(Frame(np.array([1 / 3, 0.1, 60.0]), aimed(60 * direction(7, 30)).axes), 8, 6, 1 / 300),
        )
    )
    assert assembly.beam.radius == radius and assembly.detector.pitch == 1 / 300
    np.testing.assert_array_equal(assembly.target.frame.origin, turned.origin)
    np.testing.assert_allclose(assembly.target.frame.axes, turned.axes, atol=ROUNDING)
    np.testing.assert_allclose(assembly.detector.centre, [1 / 3, 0.1, 60.0], atol=ROUNDING)


def test_a_written_scene_is_the_shipped_one(assemble, shipped):
    """The benchmark's text against scenes/tilted_laser.xml, which is written by hand with rotations."""
    written, by_hand = assemble(SCENE), shipped("tilted_laser")
    for one, other in ((written.beam, by_hand.beam), (written.detector, by_hand.detector)):
        for name, value in vars(other).items():
            np.testing.assert_allclose(getattr(one, name), value, atol=50 * ROUNDING, err_msg=name)
    assert written.target.surface.density == pytest.approx(by_hand.target.surface.density, rel=ROUNDING)
    assert (written.options, written.elements) == (by_hand.options, by_hand.elements)


def test_defaults_can_be_changed_where_the_scene_is_loaded(mitsuba):
    text = scene_text(
        integrator(tolerance=Default("tolerance", 1e-3)), *parts()[1:3],
        detector(aimed(60 * direction(0)), Default("width", 32), 24),
    )  # fmt: skip
    at_rest, changed = (
        assembly_from_scene(mitsuba.load_string(text, **given)) for given in ({}, {"width": "16", "tolerance": "1e-5"})
    )
    assert (at_rest.detector.shape, at_rest.options.tolerance) == ((24, 32), 1e-3)
    assert (changed.detector.shape, changed.options.tolerance) == ((24, 16), 1e-5)


def test_elements_keep_their_names_scales_and_materials(assemble):
    glass = material("dielectric", int_ior=1.5, ext_ior=1.0)
    card = material("diffuse", reflectance=Typed("spectrum", 0.2))
    assembly = assemble(
        scene_text(
            *parts(),
            shape("cube", "plate", on_axis(30.0), [glass], size=(8.0, 9.0, 1.5)),
            shape("aperture", "hole", on_axis(41.0), radius=0.5, shape="circle"),
            shape("disk", "card", Frame(np.array([90.0, 0, 10.0]), np.eye(3)), [card], size=(2.0, 2.0, 1.0)),
        )
    )
    kinds = {element.name: element.kind for element in assembly.elements}
    assert kinds == {"plate": "glass", "hole": "opening", "card": "opaque"}
    plate = next(element for element in assembly.elements if element.name == "plate")
    assert plate.index == 1.5 and plate.size == pytest.approx(2 * np.sqrt(8**2 + 9**2 + 1.5**2), rel=1e-6)


def test_a_scene_with_the_users_points_is_loaded_from_its_folder(mitsuba, tmp_path):
    folder = tmp_path / 'a "b" & <c>'
    folder.mkdir()
    random = np.random.default_rng(4)
    position, weights = random.normal(0, 0.1, (5, 3)), random.normal(size=5) + 1j * random.normal(size=5)
    write_points(folder / "points.csv", position, weights)
    relative = write_scene(folder / "scene.xml", *parts(points="points.csv"))
    absolute = write_scene(folder / "other.xml", *parts(points=folder / "points.csv"))
    for path in (relative, absolute):
        points = assembly_from_scene(mitsuba.load_file(str(path))).target.points
        np.testing.assert_array_equal(points.points, position)
        np.testing.assert_array_equal(points.weights, weights)
    assert sorted(path.name for path in folder.iterdir()) == ["other.xml", "points.csv", "scene.xml"]


def test_what_is_none_is_left_out_and_numpy_numbers_are_numbers():
    plugin = laser(on_axis(0.0), beam_radius=None, wavefront_radius=np.float64(-750), wavelength=np.float32(0.5))
    found = {child.get("name"): (child.tag, child.get("value")) for child in ElementTree.fromstring(plugin.xml())}
    assert "beam_radius" not in found
    assert found["wavefront_radius"] == ("float", "-750.0") and found["wavelength"] == ("float", "0.5")
    assert '<boolean name="lobe" value="true"/>' in rough_target(lobe=np.True_, point_sources=np.int64(3)).xml()
    again = plugin.with_values(wavefront_radius=None, beam_radius=1.0).xml()
    assert "wavefront_radius" not in again and "beam_radius" in again


def test_what_cannot_be_written_is_refused_by_name(tmp_path):
    with pytest.raises(TypeError, match="radius = .1, 2.: must be a number"):
        shape("aperture", "hole", on_axis(1.0), radius=[1, 2]).xml()
    with pytest.raises(ValueError, match="weights of shape .2,.*3 scatterers"):
        write_points(tmp_path / "points.csv", np.zeros((3, 3)), np.ones(2))
    with pytest.raises(ValueError, match=r"position of shape \(3, 2\)"):
        write_points(tmp_path / "points.csv", np.zeros((3, 2)))
    assert not list(tmp_path.iterdir())


def test_the_scene_of_the_modules_documentation_works(mitsuba, tmp_path, monkeypatch):
    from speckle_mi.scene import write

    example = [line[4:] for line in write.__doc__.splitlines() if line.startswith("    ")]
    monkeypatch.chdir(tmp_path)
    exec("\n".join(example), {})
    assert assembly_from_scene(mitsuba.load_file("scene.xml")).detector.shape == (480, 744)
