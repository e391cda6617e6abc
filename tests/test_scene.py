"""Scenes as users write them: registration, parameters that change, other integrators."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scene_builder import (
    WORLD,
    detector_frame,
    direction,
    frame_along,
    free_space,
    laser_xml,
    parameters,
    scene_of,
    target_xml,
    transform,
)

from speckle_mi.machine import llvm
from speckle_mi.scene.read import assembly_from_scene
from speckle_mi.scene.errors import one_line
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.field.simulation import simulate

ABOVE = frame_along(-direction(0), 50 * direction(0), np.array([1.0, 0, 0]))
CAMERA = detector_frame(direction(0), 60.0)
# Registration, in fresh processes: the order of imports and of setting a variant is the user's.

LOAD = "mi.load_file(SCENE, width='8', height='8')"
ORDERS = {
    "speckle_mi first": "import speckle_mi, mitsuba as mi; mi.set_variant('llvm_ad_mono'); " + LOAD,
    "mitsuba first": "import mitsuba as mi, speckle_mi; mi.set_variant('llvm_ad_mono'); " + LOAD,
    "mitsuba used before": "import mitsuba as mi; mi.variants(); import speckle_mi; mi.set_variant('llvm_ad_mono'); "
    + LOAD,
    "after another variant": "import mitsuba as mi, speckle_mi; mi.set_variant('scalar_rgb'); "
    "mi.set_variant('llvm_ad_mono'); " + LOAD,
    "variant set twice": "import mitsuba as mi, speckle_mi; mi.set_variant('llvm_ad_mono'); "
    "mi.set_variant('scalar_rgb'); mi.set_variant('llvm_ad_mono'); " + LOAD,
    "from mitsuba import": "import speckle_mi; from mitsuba import set_variant, load_file; import mitsuba as mi; "
    "set_variant('llvm_ad_mono'); " + LOAD,
}


@pytest.mark.parametrize("order", ORDERS)
def test_plugins_are_known_whatever_is_imported_first(order, tmp_path):
    from conftest import SCENES

    script = f"SCENE = {str(SCENES / 'tilted_laser.xml')!r}\n{ORDERS[order]}\nimport numpy\n"
    script += "print(numpy.array(mi.render(" + LOAD + ")).shape)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith("(8, 8, 3)")


CAMERA_TOO = '<sensor type="perspective" id="odd"><float name="fov" value="30"/></sensor>'


def test_another_sensor_beside_the_detector_is_left_alone(mitsuba):
    assembly = assembly_from_scene(
        mitsuba.load_string(free_space(detector={"width": 24, "height": 16}, extra=CAMERA_TOO))
    )
    assert assembly.detector.shape == (16, 24)


def test_files_are_looked_for_beside_the_scene(mitsuba, tmp_path, monkeypatch):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "points.csv").write_text("0.01,0.02,0\n")
    (tmp_path / "scene" / "scene.xml").write_text(free_space(target={"points": "points.csv"}))
    monkeypatch.chdir(tmp_path)
    assembly = assembly_from_scene(mitsuba.load_file("scene/scene.xml"))
    np.testing.assert_allclose(assembly.target.points.points, [[0.01, 0.02, 0]])


def test_a_scene_may_be_given_as_a_dictionary(mitsuba):
    """The examples of the plugins' documentation; Python's transforms are of single precision."""
    look_at = mitsuba.ScalarTransform4f().look_at
    rng = np.random.default_rng(0)
    for _ in range(20):
        laser, eye = (
            direction(rng.uniform(0, 60), rng.uniform(0, 360)) * distance for distance in (50.0, 60.0)
        )
        scene = mitsuba.load_dict({
            "type": "scene",
            "integrator": {"type": "coherent", "method": "auto", "tolerance": 1e-4},
            "laser": {
                "type": "laser", "wavelength": 632.8, "beam_radius": 0.12, "wavefront_radius": -750.0,
                "to_world": look_at(origin=laser.tolist(), target=[0, 0, 0], up=[0, 1, 0.1]),
            },
            "target": {"type": "rough_target", "width": 4.0, "height": 4.0, "roughness": 0.8, "point_sources": 100},
            "detector": {
                "type": "detector", "pixel_pitch": 0.006, "film": {"type": "hdrfilm", "width": 24, "height": 16},
                "to_world": look_at(origin=eye.tolist(), target=[0, 0, 0], up=[0, 1, 0.1]),
            },
        })
        assembly = assembly_from_scene(scene)
        # look_at works in single precision: 1e-7 of the direction, and of 50 mm or more.
        np.testing.assert_allclose(assembly.beam.axis, -laser / 50, atol=1e-6)
        np.testing.assert_allclose(assembly.detector.centre, eye, atol=1e-5)
        np.testing.assert_allclose(assembly.spot.point, 0, atol=1e-4)
    assert np.array(mitsuba.render(scene)).shape == (16, 24, 3)


# Parameters that are exposed


@pytest.fixture
def scene(mitsuba):
    return mitsuba.load_string(free_space(direction(35, 180), detector={"width": 24, "height": 16}))


EXPOSED = {
    "target.x": 0.05, "target.y": -0.05, "target.z": 0.2, "target.rx": 0.1, "target.ry": 0.1, "target.rz": 1.0,
    "target.roughness": 0.5, "target.correlation_length": 20.0, "target.seed": 3,
    "laser.wavelength": 780.0, "laser.beam_radius": 0.2, "laser.wavefront_radius": 100.0, "detector.pixel_pitch": 0.01,
}


@pytest.mark.parametrize("name", EXPOSED)
def test_an_exposed_parameter_changes_the_image_as_the_scene_file_does(mitsuba, scene, name):
    part, _, parameter = name.partition(".")
    before = simulate(assembly_from_scene(scene)).field
    exposed = mitsuba.traverse(scene)
    assert name in exposed, sorted(exposed.keys())
    exposed[name] = EXPOSED[name]
    exposed.update()
    after = np.array(mitsuba.render(scene))
    changes = {part: {parameter: EXPOSED[name]}}
    if parameter in ("x", "y", "z", "rx", "ry", "rz"):
        changes = {}
    detector = {"width": 24, "height": 16} | changes.pop("detector", {})
    fresh = assembly_from_scene(mitsuba.load_string(free_space(direction(35, 180), detector=detector, **changes)))
    pose = Pose(**{parameter: EXPOSED[name]}) if parameter in ("x", "y", "z", "rx", "ry", "rz") else Pose()
    expected = simulate(fresh, pose).field
    assert not np.allclose(before, expected, rtol=0.01)
    np.testing.assert_array_equal(after[..., 1] + 1j * after[..., 2], expected.astype(np.complex64))


def test_an_exposed_place_changes_the_image(mitsuba, scene):
    exposed = mitsuba.traverse(scene)
    exposed["detector.to_world"] = mitsuba.Transform4f(exposed["detector.to_world"]) @ mitsuba.Transform4f().translate(
        [0, 0, -20]
    )
    exposed.update()
    np.testing.assert_allclose(assembly_from_scene(scene).detector.centre, [0, 0, 80], atol=1e-4)  # single precision
    exposed["target.to_world"] = mitsuba.Transform4f().translate([0, 0, 1])
    exposed.update()
    np.testing.assert_allclose(assembly_from_scene(scene).target.frame.origin, [0, 0, 1], atol=1e-6)


def test_the_mesh_moves_with_the_pose_for_other_integrators(mitsuba, scene):
    exposed = mitsuba.traverse(scene)
    exposed["target.x"] = 0.5
    exposed["target.rz"] = 90.0
    exposed.update()
    vertices = np.array(mitsuba.traverse(scene)["target.vertex_positions"]).reshape(-1, 3)
    np.testing.assert_allclose(vertices[0], [0.5 + 2, -2, 0], atol=1e-6)


def test_a_bad_value_of_an_exposed_parameter_is_refused(mitsuba, scene):
    values = {"target.roughness": (-1.0, 0.8), "laser.wavelength": (0.0, 632.8), "detector.pixel_pitch": (-0.1, 0.006)}
    for name, (bad, good) in values.items():
        exposed = mitsuba.traverse(scene)
        exposed[name] = bad
        with pytest.raises((ValueError, RuntimeError)) as caught:
            exposed.update()
        assert name.partition(".")[2] in one_line(caught.value)
        exposed[name] = good
        exposed.update()


# Other integrators


def test_the_target_renders_under_a_path_tracer(mitsuba):
    camera = Frame(np.array([0.0, 0, 20]), detector_frame(direction(0), 20.0).axes)
    text = scene_of(
        '<integrator type="path"/>',
        target_xml(WORLD, '<bsdf type="diffuse"><spectrum name="reflectance" value="0.5"/></bsdf>'),
        '<emitter type="constant"><spectrum name="radiance" value="1"/></emitter>',
        f'<sensor type="perspective">{transform(camera)}{parameters({"fov": 30.0})}'
        '<sampler type="independent"><integer name="sample_count" value="64"/></sampler>'
        f'<film type="hdrfilm">{parameters({"width": 33, "height": 33})}</film></sensor>',
    )
    image = np.array(mitsuba.render(mitsuba.load_string(text)))[..., 0]
    # The patch reflects half of the constant light, and fills 4 mm of 2 * 20 tan(15 deg) = 10.7 mm.
    assert image[16, 16] == pytest.approx(0.5, abs=0.05)
    assert image[1, 1] == pytest.approx(1.0, abs=0.01)
    assert np.mean(image < 0.75) == pytest.approx((4 / 10.72) ** 2, abs=0.05)


def test_the_laser_lights_the_target_for_a_path_tracer(mitsuba):
    camera = Frame(np.array([0.0, 0, 20]), detector_frame(direction(0), 20.0).axes)
    text = scene_of(
        '<integrator type="path"/>', laser_xml(ABOVE, beam_radius=1.0),
        target_xml(WORLD, '<bsdf type="diffuse"><spectrum name="reflectance" value="1"/></bsdf>'),
        f'<sensor type="perspective">{transform(camera)}{parameters({"fov": 5.0})}'
        '<sampler type="independent"><integer name="sample_count" value="16"/></sampler>'
        f'<film type="hdrfilm">{parameters({"width": 21, "height": 21})}<rfilter type="box"/></film></sensor>',
    )
    image = np.array(mitsuba.render(mitsuba.load_string(text)))[..., 0]
    # Irradiance 2 P/(pi w^2) on the axis, radiance of a Lambertian surface E/pi.
    assert image[10, 10] == pytest.approx(2 / np.pi**2, rel=0.05)
    assert image[10, 0] < 0.5 * image[10, 10]


# LLVM


def test_an_llvm_that_aborts_the_process_is_refused_with_what_to_do(monkeypatch):
    for version, said in (((15, 0, 7), "15.0.7"), ((18, 1, 8), "18.1.8"), (None, "no LLVM")):
        monkeypatch.setattr(llvm, "loaded_version", lambda version=version: version)
        with pytest.raises(llvm.LLVMError) as caught:
            llvm.require_usable()
        message = str(caught.value)
        assert said in message and "pip install karellen-llvm-core" in message and "\n" not in message
    monkeypatch.setattr(llvm, "loaded_version", lambda: (19, 1, 0))
    llvm.require_usable()


def test_an_unknown_variant_is_refused_with_the_alternatives(mitsuba):
    from speckle_mi.machine.backend import set_variant

    for name in ("llvm_ad_rgb", "scalar_rgb", "nonsense"):
        with pytest.raises(ValueError, match="llvm_ad_mono"):
            set_variant(name)


def test_the_size_of_a_screen_is_part_of_a_scenes_identity(mitsuba):
    """Plans are kept by it, and a screen that covers more may be in the way of other light."""
    stop = f'<shape type="aperture" id="stop">{transform(Frame(np.array([0, 0, 40.0]), np.eye(3)))}'
    hashes = {
        assembly_from_scene(
            mitsuba.load_string(free_space(extra=f"{stop}{parameters({'radius': 0.5, 'outer_radius': size})}</shape>"))
        ).fingerprint()
        for size in (10.0, 20.0)
    }
    assert len(hashes) == 2
