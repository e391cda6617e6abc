"""Scenes as users write them: registration, refusals in one clear line, parameters that change, other integrators."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
from scene_builder import WORLD, detector_frame, detector_xml, direction, frame_along, free_space
from scene_builder import integrator_xml, laser_xml, parameters, scene_of, target_xml, transform

from speckle_mi import llvm
from speckle_mi.assembly import assembly_from_scene
from speckle_mi.cli import one_line
from speckle_mi.geometry import Frame, Pose
from speckle_mi.simulate import simulate

ABOVE = frame_along(-direction(0), 50 * direction(0), np.array([1.0, 0, 0]))
CAMERA = detector_frame(direction(0), 60.0)
PARTS = {
    "integrator": integrator_xml(),
    "laser": laser_xml(ABOVE),
    "target": target_xml(),
    "detector": detector_xml(CAMERA, width=24, height=16),
}


def scene_with(**changes):
    """The plain scene with parts replaced, left out (empty) or added."""
    return scene_of(*(PARTS | changes).values())


def refusal(mitsuba, text):
    """The line with which the commands refuse a scene."""
    with pytest.raises((RuntimeError, ValueError)) as caught:
        assembly_from_scene(mitsuba.load_string(text))
    line = one_line(caught.value)
    assert "\n" not in line and "Traceback" not in line and len(line) < 400
    return line


# Registration, in fresh processes: the order of imports and of setting a variant is the user's.

LOAD = "mi.load_file(SCENE, width='8', height='8')"
ORDERS = {
    "speckle_mi first": "import speckle_mi, mitsuba as mi; mi.set_variant('llvm_ad_mono'); " + LOAD,
    "mitsuba first": "import mitsuba as mi, speckle_mi; mi.set_variant('llvm_ad_mono'); " + LOAD,
    "mitsuba used before": "import mitsuba as mi; mi.variants(); import speckle_mi; mi.set_variant('llvm_ad_mono'); " + LOAD,
    "after another variant": "import mitsuba as mi, speckle_mi; mi.set_variant('scalar_rgb'); mi.set_variant('llvm_ad_mono'); " + LOAD,
    "variant set twice": "import mitsuba as mi, speckle_mi; mi.set_variant('llvm_ad_mono'); mi.set_variant('scalar_rgb'); "
    "mi.set_variant('llvm_ad_mono'); " + LOAD,
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


# Refusals


def changed(part, old, new):
    assert old in PARTS[part], (part, old)
    return scene_with(**{part: PARTS[part].replace(old, new, 1)})


def with_parameter(part, kind, name, value):
    """The plain scene with one parameter of a part set; an earlier one of that name is replaced."""
    text = re.sub(rf'<\w+ name="{name}" value="[^"]*"/>', "", PARTS[part])
    head, end, tail = text.rpartition("</")
    return scene_with(**{part: f'{head}<{kind} name="{name}" value="{value}"/>{end}{tail}'})


OUT_OF_RANGE = [
    ("laser", "float", "wavelength", "0"),
    ("laser", "float", "wavelength", "-632.8"),
    ("laser", "string", "wavelength", "nan"),
    ("laser", "string", "wavelength", "red"),
    ("laser", "float", "beam_radius", "0"),
    ("laser", "float", "beam_radius", "-1"),
    ("laser", "string", "beam_radius", "nan"),
    ("laser", "boolean", "beam_radius", "true"),
    ("laser", "float", "wavefront_radius", "0"),
    ("laser", "string", "wavefront_radius", "nan"),
    ("target", "float", "roughness", "-0.1"),
    ("target", "string", "roughness", "inf"),
    ("target", "float", "correlation_length", "-1"),
    ("target", "integer", "point_sources", "0"),
    ("target", "integer", "point_sources", "-5"),
    ("target", "float", "point_sources", "10.5"),
    ("target", "integer", "seed", "-1"),
    ("target", "float", "seed", "0.5"),
    ("target", "float", "width", "0"),
    ("target", "float", "height", "-2"),
    ("target", "string", "lobe", "yes"),
    ("target", "string", "filename", "missing.ply"),
    ("target", "string", "points", "missing.csv"),
    ("detector", "float", "pixel_pitch", "0"),
    ("detector", "float", "pixel_pitch", "-0.006"),
    ("detector", "string", "pixel_pitch", "small"),
    ("integrator", "string", "method", "exact"),
    ("integrator", "float", "tolerance", "0"),
    ("integrator", "float", "tolerance", "1"),
    ("integrator", "string", "tolerance", "nan"),
    ("integrator", "integer", "diffraction", "1"),
    ("integrator", "integer", "rays_per_source", "0"),
]


@pytest.mark.parametrize("part, kind, name, value", OUT_OF_RANGE, ids=lambda value: str(value))
def test_a_parameter_out_of_range_or_of_a_wrong_type_is_named(mitsuba, part, kind, name, value):
    line = refusal(mitsuba, with_parameter(part, kind, name, value))
    assert name in line and re.search(r"must|not a file", line), line


@pytest.mark.parametrize("part", PARTS)
def test_a_misspelt_parameter_is_named(mitsuba, part):
    line = refusal(mitsuba, with_parameter(part, "float", "wavelenght", "1"))
    assert "wavelenght" in line, line


@pytest.mark.parametrize("part, name", [("laser", "wavelength"), ("detector", "pixel_pitch")])
def test_a_missing_required_parameter_is_named(mitsuba, part, name):
    text = re.sub(rf'<\w+ name="{name}" value="[^"]*"/>', "", PARTS[part])
    line = refusal(mitsuba, scene_with(**{part: text}))
    assert name in line and "missing" in line, line


@pytest.mark.parametrize("part, word", [("laser", "laser"), ("target", "rough_target"), ("integrator", "coherent")])
def test_a_missing_part_is_named(mitsuba, part, word):
    assert word in refusal(mitsuba, scene_with(**{part: ""}))


def test_a_missing_detector_is_named(mitsuba):
    assert "detector" in refusal(mitsuba, scene_with(detector=""))


@pytest.mark.parametrize("part", ["laser", "target", "detector"])
def test_a_part_that_is_there_twice_is_named(mitsuba, part):
    plugin = {"laser": "laser", "target": "rough_target", "detector": "detector"}[part]
    line = refusal(mitsuba, scene_with(second=re.sub(r'id="\w+"', 'id="other"', PARTS[part])))
    assert "2 of <" in line and plugin in line, line


UNKNOWN = {
    "a glass rod": '<shape type="cylinder" id="odd"><transform name="to_world"><translate z="30"/></transform>'
    '<bsdf type="dielectric"/></shape>',
    "a bent mirror": '<shape type="cylinder" id="odd"><transform name="to_world"><translate z="30"/></transform>'
    '<bsdf type="conductor"/></shape>',
    "frosted glass": '<shape type="sphere" id="odd"><transform name="to_world"><translate z="30"/></transform>'
    '<bsdf type="roughdielectric"/></shape>',
    "a medium's boundary": '<shape type="sphere" id="odd"><transform name="to_world"><translate z="30"/></transform>'
    '<medium name="interior" type="homogeneous"/><bsdf type="null"/></shape>',
    "a lamp": '<emitter type="point" id="odd"/>',
    "a glowing shape": '<shape type="sphere" id="odd"><transform name="to_world"><translate x="90"/></transform>'
    '<emitter type="area" id="odd"/></shape>',
}
CAMERA_TOO = '<sensor type="perspective" id="odd"><float name="fov" value="30"/></sensor>'


@pytest.mark.parametrize("kind", UNKNOWN)
def test_what_cannot_be_taken_into_account_is_refused_by_name(mitsuba, kind):
    assert "odd" in refusal(mitsuba, scene_with(second=UNKNOWN[kind]))


def test_another_sensor_beside_the_detector_is_left_alone(mitsuba):
    assembly = assembly_from_scene(mitsuba.load_string(scene_with(second=CAMERA_TOO)))
    assert assembly.detector.shape == (16, 24)


DEGENERATE = {
    "scaled": '<transform name="to_world"><scale value="2"/></transform>',
    "flattened": '<transform name="to_world"><scale x="1" y="1" z="0"/></transform>',
    "sheared": '<transform name="to_world"><matrix value="1 0.1 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform>',
    "mirrored": '<transform name="to_world"><scale x="-1"/></transform>',
    "not a number": '<transform name="to_world"><matrix value="nan 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform>',
}


@pytest.mark.parametrize("part, plugin", [("laser", "laser"), ("target", "rough_target"), ("detector", "detector")])
@pytest.mark.parametrize("kind", DEGENERATE)
def test_a_transform_that_does_more_than_rotate_and_translate_is_refused(mitsuba, part, plugin, kind):
    text = re.sub(r"<transform.*?</transform>", DEGENERATE[kind], PARTS[part], count=1, flags=re.S)
    line = refusal(mitsuba, scene_with(**{part: text}))
    assert plugin in line and ("to_world" in line or "transform" in line.lower()), line


def test_a_laser_that_lights_the_back_of_the_target_is_refused(mitsuba):
    below = frame_along(direction(0), -50 * direction(0), np.array([1.0, 0, 0]))
    assert "back" in refusal(mitsuba, scene_with(laser=laser_xml(below)))


def test_a_laser_along_the_surface_is_refused(mitsuba):
    along = frame_along(-direction(90), 50 * direction(90), np.array([0, 1.0, 0]))
    assert "surface" in refusal(mitsuba, scene_with(laser=laser_xml(along)))


@pytest.mark.parametrize(
    "content, word",
    [("", "no scatterer"), ("x,y\n1,2\n", "line 2"), ("0,0,0\n1,2,three\n", "line 2"), ("0,0,0\n1,2,3,4,5\n", "line 2"),
     ("0,0,nan\n", "line 1"), ("\xff\xfe\x00".encode("latin-1"), "points.csv")],
)
def test_a_points_file_that_cannot_be_used_is_refused_by_its_line(mitsuba, tmp_path, content, word):
    path = tmp_path / "points.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    line = refusal(mitsuba, scene_with(target=target_xml(points=str(path))))
    assert word in line and "points.csv" in line, line


@pytest.mark.parametrize("name, content", [("empty.ply", ""), ("text.obj", "nothing here"), ("mesh.stl", "solid"), ("bad.ply", "ply\n")])
def test_a_mesh_that_cannot_be_read_is_refused_by_name(mitsuba, tmp_path, name, content):
    (tmp_path / name).write_text(content)
    assert name in refusal(mitsuba, scene_with(target=target_xml(filename=str(tmp_path / name))))


def test_a_mesh_and_a_size_together_are_refused(mitsuba, tmp_path):
    (tmp_path / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert "filename" in refusal(mitsuba, scene_with(target=target_xml(filename=str(tmp_path / "one.obj"), width=4.0)))


def test_files_are_looked_for_beside_the_scene(mitsuba, tmp_path, monkeypatch):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "points.csv").write_text("0.01,0.02,0\n")
    (tmp_path / "scene" / "scene.xml").write_text(scene_with(target=target_xml(points="points.csv")))
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
        np.testing.assert_allclose(assembly.beam.axis, -laser / 50, atol=1e-6)
        np.testing.assert_allclose(assembly.detector.centre, eye, atol=1e-5)
        np.testing.assert_allclose(assembly.target.spot, 0, atol=1e-4)
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
    exposed["detector.to_world"] = mitsuba.Transform4f(exposed["detector.to_world"]) @ mitsuba.Transform4f().translate([0, 0, -20])
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


def test_the_users_own_llvm_is_left_in_place(tmp_path):
    own = llvm.packaged_library()
    if own is None:
        pytest.skip("no packaged LLVM here")
    script = "import os, speckle_mi; print(os.environ['DRJIT_LIBLLVM_PATH'])"
    for given, expected in (("/somewhere/libLLVM.so", "/somewhere/libLLVM.so"), (None, str(own))):
        import os

        environment = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
        environment |= {"DRJIT_LIBLLVM_PATH": given} if given else {}
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment, timeout=60)
        assert done.stdout.strip() == expected, done.stderr


def test_an_unknown_variant_is_refused_with_the_alternatives(mitsuba):
    from speckle_mi.backend import set_variant

    for name in ("llvm_ad_rgb", "scalar_rgb", "nonsense"):
        with pytest.raises(ValueError, match="llvm_ad_mono"):
            set_variant(name)
