"""Bad input of every kind: one clear line that says what, where and what it may be; status 2, and no traceback."""

from __future__ import annotations

import json
import os
import re

import numpy as np
import pytest
from conftest import SCENES
from scene_builder import detector_frame, detector_xml, direction, frame_along, integrator_xml, laser_xml, parameters
from scene_builder import scene_of, target_xml, transform

from speckle_mi.assembly import assembly_from_scene
from speckle_mi.cli import command, one_line
from speckle_mi.exr import FieldImage, FieldImageError, read_field, write_field
from speckle_mi.geometry import Frame
from speckle_mi.simulate import simulate_frame

SCENE = str(SCENES / "tilted_laser.xml")
SMALL = ["-D", "width=24", "-D", "height=16", "-D", "pixel_pitch=0.03", "-D", "point_sources=20"]
BAD_INPUT = 2
LONGEST_LINE = 400

ABOVE = frame_along(-direction(0), 50 * direction(0), np.array([1.0, 0, 0]))
CAMERA = detector_frame(direction(0), 60.0)


def on_axis(z):
    return transform(Frame(np.array([0.0, 0.0, z]), np.eye(3)))


LENS = {"radius1": 50.0, "radius2": -50.0, "conic1": 0.0, "conic2": 0.0, "thickness": 5.0, "diameter": 20.0, "ior": 1.5}
PARTS = {
    "integrator": integrator_xml(),
    "laser": laser_xml(ABOVE),
    "target": target_xml(),
    "detector": detector_xml(CAMERA, width=16, height=8),
    "lens": f'<shape type="lens" id="lens">{on_axis(25.0)}{parameters(LENS)}</shape>',
    "aperture": f'<shape type="aperture" id="aperture">{on_axis(40.0)}{parameters({"radius": 0.5, "outer_radius": 9.0})}</shape>',
}


def scene_with(**changes):
    return scene_of(*(PARTS | changes).values())


def with_parameter(part, kind, name, value):
    text = re.sub(rf'<\w+ name="{name}" value="[^"]*"/>', "", PARTS[part])
    head, end, tail = text.rpartition("</")
    return scene_with(**{part: f'{head}<{kind} name="{name}" value="{value}"/>{end}{tail}'})


def is_clear(line, *words):
    assert "\n" not in line and "Traceback" not in line and len(line) < LONGEST_LINE, line
    for word in words:
        assert word in line, line


def refusal(mitsuba, text):
    """The line with which a scene is refused before anything is computed."""
    with pytest.raises((RuntimeError, ValueError)) as caught:
        assembly_from_scene(mitsuba.load_string(text))
    return one_line(caught.value)


# Every number of every plugin

POSITIVE = {
    "laser": ["wavelength", "beam_radius"],
    "target": ["width", "height"],
    "detector": ["pixel_pitch"],
    "lens": ["thickness", "diameter"],
    "aperture": ["radius", "outer_radius"],
}
OTHER = {
    "laser": ["wavefront_radius"],
    "target": ["roughness", "correlation_length"],
    "lens": ["radius1", "radius2", "conic1", "conic2", "ior"],
    "integrator": ["tolerance"],
}
NUMBERS = [(part, name) for table in (POSITIVE, OTHER) for part, names in table.items() for name in names]
MAY_BE_INFINITE = {"beam_radius", "wavefront_radius"}


@pytest.mark.parametrize("part, name", NUMBERS)
@pytest.mark.parametrize(
    "kind, value", [("string", "nan"), ("float", "nan"), ("string", "wide"), ("boolean", "true"), ("string", "")]
)
def test_what_is_not_a_number_is_named(mitsuba, part, name, kind, value):
    is_clear(refusal(mitsuba, with_parameter(part, kind, name, value)), name, "must be")


@pytest.mark.parametrize("part, name", [entry for entry in NUMBERS if entry[1] not in MAY_BE_INFINITE])
@pytest.mark.parametrize("kind, value", [("string", "inf"), ("float", "-inf"), ("float", "1e400")])
def test_infinity_is_refused_where_it_means_nothing(mitsuba, part, name, kind, value):
    is_clear(refusal(mitsuba, with_parameter(part, kind, name, value)), name, "must be")


@pytest.mark.parametrize("part, name", [(part, name) for part, names in POSITIVE.items() for name in names])
@pytest.mark.parametrize("value", ["0", "-1", "1e30", "1e-30", ""])
def test_sizes_are_positive_and_of_this_world(mitsuba, part, name, value):
    """An empty number is what Mitsuba reads as zero."""
    is_clear(refusal(mitsuba, with_parameter(part, "float", name, value)), name, "must be")


OUT_OF_RANGE = [
    ("laser", "string", "beam_radius", "-inf"),
    ("laser", "float", "wavefront_radius", "0"),
    ("target", "float", "roughness", "-1"),
    ("target", "float", "roughness", "1e30"),
    ("target", "float", "correlation_length", "-1"),
    ("target", "float", "correlation_length", "1e-30"),
    ("target", "float", "correlation_length", "1e30"),
    ("lens", "float", "ior", "0.5"),
    ("lens", "float", "ior", "0"),
    ("lens", "float", "ior", "1e30"),
    ("integrator", "float", "tolerance", "0"),
    ("integrator", "float", "tolerance", "1e-30"),
    ("integrator", "float", "tolerance", "2"),
    ("integrator", "integer", "rays_per_source", "3"),
    ("integrator", "integer", "rays_per_source", "1000000000000"),
    ("integrator", "string", "rays_per_source", "many"),
    ("integrator", "float", "rays_per_source", "20.5"),
    ("integrator", "string", "method", "Auto"),
    ("integrator", "integer", "method", "1"),
    ("integrator", "string", "diffraction", "true"),
    ("target", "integer", "point_sources", "0"),
    ("target", "float", "point_sources", "1.5"),
    ("target", "float", "point_sources", "nan"),
    ("target", "integer", "seed", "-1"),
    ("target", "string", "seed", "first"),
    ("target", "integer", "lobe", "1"),
    ("target", "float", "filename", "1"),
    ("target", "string", "filename", "none.ply"),
    ("target", "string", "points", "none.csv"),
    ("target", "string", "points", ""),
    ("aperture", "string", "shape", "ring"),
    ("aperture", "float", "shape", "1"),
    ("aperture", "float", "width", "1"),
    ("aperture", "float", "outer_radius", "0.5"),
    ("lens", "float", "diameter", "200"),
    ("lens", "float", "thickness", "0.1"),
]


@pytest.mark.parametrize("part, kind, name, value", OUT_OF_RANGE, ids=lambda value: str(value))
def test_a_value_out_of_range_or_of_a_wrong_type_is_named(mitsuba, part, kind, name, value):
    line = refusal(mitsuba, with_parameter(part, kind, name, value))
    is_clear(line, name)
    assert re.search(r"must|not a file|given by", line), line


@pytest.mark.parametrize(
    "kind, value", [("integer", "1.5"), ("integer", "9" * 20), ("float", "1,5"), ("boolean", "yes")]
)
def test_text_that_the_parser_cannot_read_is_quoted_with_its_line(mitsuba, kind, value):
    is_clear(refusal(mitsuba, with_parameter("target", kind, "seed", value)), value, "line")


@pytest.mark.parametrize("part", PARTS)
def test_a_misspelt_name_is_quoted(mitsuba, part):
    is_clear(refusal(mitsuba, with_parameter(part, "float", "wavelenght", "1")), "wavelenght")


def test_a_misspelt_plugin_is_quoted(mitsuba):
    for part, plugin in {
        "laser": "laser",
        "target": "rough_target",
        "detector": "detector",
        "lens": "lens",
        "integrator": "coherent",
    }.items():
        is_clear(
            refusal(mitsuba, scene_with(**{part: PARTS[part].replace(f'type="{plugin}"', 'type="lazer"')})), "lazer"
        )


# Parts


@pytest.mark.parametrize(
    "part, word", [("laser", "laser"), ("target", "rough_target"), ("integrator", "coherent"), ("detector", "detector")]
)
def test_a_missing_part_is_named(mitsuba, part, word):
    is_clear(refusal(mitsuba, scene_with(**{part: ""})), word, "must")


@pytest.mark.parametrize("part, plugin", [("laser", "laser"), ("target", "rough_target"), ("detector", "detector")])
def test_a_part_that_is_there_twice_is_named(mitsuba, part, plugin):
    # Mitsuba makes one of two parts that are alike in everything but their names.
    second = re.sub(r'id="\w+"', 'id="other"', PARTS[part]).replace('value="0.006"', 'value="0.003"')
    is_clear(refusal(mitsuba, scene_with(second=second)), "2 of", plugin, "other")
    is_clear(refusal(mitsuba, scene_with(second=PARTS[part])), "duplicate", part)


DEGENERATE = {
    "zero scale": "0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 1",
    "non-uniform scale": "1 0 0 0 0 2 0 0 0 0 1 0 0 0 0 1",
    "shear": "1 1 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    "mirror": "-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    "singular": "1 0 0 0 0 1 0 0 0 0 0 0 0 0 0 1",
    "not a number": "nan 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    "infinite": "1 0 0 inf 0 1 0 0 0 0 1 0 0 0 0 1",
    "out of this world": "1 0 0 1e300 0 1 0 0 0 0 1 0 0 0 0 1",
    "too few numbers": "1 0 0",
}


@pytest.mark.parametrize("part", ["laser", "target", "detector", "lens", "aperture"])
@pytest.mark.parametrize("kind", DEGENERATE)
def test_a_degenerate_transform_is_refused(mitsuba, part, kind):
    text = re.sub(r"<matrix.*?/>", f'<matrix value="{DEGENERATE[kind]}"/>', PARTS[part])
    line = refusal(mitsuba, scene_with(**{part: text}))
    is_clear(line, "matrix" if kind == "too few numbers" else "to_world", "must")


@pytest.mark.parametrize("kind", ["zero scale", "singular", "not a number"])
@pytest.mark.parametrize(
    "form, material",
    [("sphere", "dielectric"), ("cube", "dielectric"), ("rectangle", "conductor"), ("disk", "conductor")],
)
def test_a_degenerate_transform_of_a_stock_shape_is_refused(mitsuba, form, material, kind):
    place = f'<transform name="to_world"><matrix value="{DEGENERATE[kind]}"/><translate z="30"/></transform>'
    line = refusal(mitsuba, scene_with(odd=f'<shape type="{form}" id="odd">{place}<bsdf type="{material}"/></shape>'))
    is_clear(line, "odd", "to_world")


@pytest.mark.parametrize(
    "look", ['origin="0,0,50" target="0,0,50" up="0,1,0"', 'origin="0,0,50" target="0,0,0" up="0,0,1"']
)
def test_a_lookat_without_a_direction_is_refused(mitsuba, look):
    text = re.sub(r"<matrix.*?/>", f"<lookat {look}/>", PARTS["laser"])
    is_clear(refusal(mitsuba, scene_with(laser=text)), "lookat", "line")


def test_a_detector_or_a_spot_inside_glass_is_refused(mitsuba):
    is_clear(
        refusal(mitsuba, scene_with(detector=detector_xml(detector_frame(direction(0), 28.0), 8, 8))), "inside", "lens"
    )
    is_clear(refusal(mitsuba, scene_with(lens=PARTS["lens"].replace(on_axis(25.0), on_axis(-1.0)))), "inside", "lens")


# Too much


@pytest.mark.parametrize("columns, rows", [(10**6, 10**6), (2 * 10**9, 100)])
def test_a_trillion_pixels_are_refused_with_the_estimate(mitsuba, columns, rows):
    is_clear(refusal(mitsuba, scene_with(detector=detector_xml(CAMERA, columns, rows))), "detector", str(columns), "GB")


@pytest.mark.parametrize("columns, rows", [(0, 4), (-4, 4), (5 * 10**9, 1)])
def test_impossible_numbers_of_pixels_are_refused(mitsuba, columns, rows):
    is_clear(refusal(mitsuba, scene_with(detector=detector_xml(CAMERA, columns, rows))), str(columns))


@pytest.mark.parametrize("laser", [{}, {"beam_radius": None}])
def test_a_trillion_scatterers_are_refused_with_the_estimate(mitsuba, laser):
    parts = {"target": target_xml(point_sources=10**12), "laser": laser_xml(ABOVE, **laser), "lens": "", "aperture": ""}
    with pytest.raises(ValueError) as caught:
        simulate_frame(assembly_from_scene(mitsuba.load_string(scene_with(**parts))))
    is_clear(one_line(caught.value), "scatterers", "GB", "point_sources")


def test_a_billion_sub_pixels_are_refused(mitsuba):
    line = refusal(mitsuba, scene_with(detector=detector_xml(CAMERA, 8, 8, samples=10**9)))
    is_clear(line, "sub-pixels", "1000000000", "must be at most")


# Files that a scene names

POINTS = {
    "empty": b"",
    "only a heading": b"x,y,z\n",
    "two columns": b"1,2\n",
    "ragged": b"1,2,3\n1,2,3,4,5\n",
    "words": b"x,y,z\n1,2,three\n",
    "not a number": b"1,2,nan\n",
    "infinite": b"1,inf,3\n",
    "binary": bytes(range(256)),
    "cut short": b"0,0,0\n1,2",
}


@pytest.mark.parametrize("kind", POINTS)
def test_a_bad_list_of_points_is_refused(mitsuba, tmp_path, kind):
    path = tmp_path / "points.csv"
    path.write_bytes(POINTS[kind])
    is_clear(refusal(mitsuba, with_parameter("target", "string", "points", str(path))), "points.csv", "must")


PLY_HEAD = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
)
MESHES = {
    "empty.ply": b"",
    "text.ply": b"hello\n",
    "header.ply": PLY_HEAD,
    "short.ply": PLY_HEAD + b"0 0 0\n1 0 0\n",
    "nan.ply": PLY_HEAD + b"0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n",
    "index.ply": PLY_HEAD + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n",
    "flat.ply": PLY_HEAD + b"0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n",
    "huge.ply": PLY_HEAD.replace(b"vertex 3", b"vertex 3000000000") + b"0 0 0\n",
    "empty.obj": b"",
    "index.obj": b"v 0 0 0\nv 1 0 0\nf 1 2 9\n",
    "mesh.stl": b"solid\n",
}


@pytest.mark.parametrize("name", MESHES)
def test_a_bad_mesh_is_refused(mitsuba, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(MESHES[name])
    is_clear(refusal(mitsuba, with_parameter("target", "string", "filename", str(path))), name)


# Field images

IMAGE = FieldImage(np.ones((4, 6), np.float32), np.ones((4, 6), complex), {"pixel_pitch_mm": 0.006})


@pytest.fixture
def image(tmp_path):
    path = tmp_path / "image.exr"
    write_field(path, IMAGE)
    return path


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.95, 0.999])
def test_a_truncated_image_is_refused_in_one_line_and_nothing_else_is_printed(image, share, capfd):
    content = image.read_bytes()
    image.write_bytes(content[: int(share * len(content))])
    with pytest.raises(FieldImageError) as caught:
        read_field(image)
    is_clear(str(caught.value), "image.exr")
    assert capfd.readouterr() == ("", "")


def test_an_image_whose_header_promises_more_than_the_file_holds_is_refused(image):
    content = image.read_bytes()
    place = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    window = np.array([0, 0, 999_999, 999_999], "<i4").tobytes()
    image.write_bytes(content[:place] + window + content[place + 16 :])
    with pytest.raises(FieldImageError) as caught:
        read_field(image)
    is_clear(str(caught.value), "image.exr", "cannot be read")


def test_a_folder_or_another_file_is_not_an_image(tmp_path):
    for path, content in ((tmp_path, None), (tmp_path / "a.exr", b"not an image"), (tmp_path / "none.exr", None)):
        if content:
            path.write_bytes(content)
        with pytest.raises(FieldImageError) as caught:
            read_field(path)
        is_clear(str(caught.value), path.name)


# Commands, in this process: what they print and their exit status


@pytest.fixture
def run(mitsuba, tmp_path, monkeypatch, capfd):
    """Runs a command in a folder of its own; gives status and the lines on stderr."""
    import importlib
    import signal

    monkeypatch.chdir(tmp_path)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def run(name, *arguments):
        main = importlib.import_module(f"speckle_mi.{name}").main
        try:
            status = command(main, [str(argument) for argument in arguments])
        except SystemExit as stopped:  # of argparse
            status = stopped.code
        return status, capfd.readouterr().err.strip().splitlines()

    yield run
    for number, handler in before.items():
        signal.signal(number, handler)


def refused(done, *words):
    status, lines = done
    assert status == BAD_INPUT and len(lines) == 1, (status, lines)
    is_clear(lines[0], *words)


BAD_FLAGS = {
    "render pose": ("render", [SCENE, "-o", "f.exr", "--pose", "q=1"], ["q"]),
    "render pose twice": ("render", [SCENE, "-o", "f.exr", "--pose", "x=1,x=2"], ["twice"]),
    "render pose infinite": ("render", [SCENE, "-o", "f.exr", "--pose", "rx=inf"], ["rx", "finite"]),
    "render pose not a number": ("render", [SCENE, "-o", "f.exr", "--pose", "rx=nan"], ["rx", "finite"]),
    "render spp": ("render", [SCENE, "-o", "f.exr", "--spp", "-1"], ["--spp"]),
    "render spp huge": ("render", [SCENE, "-o", "f.exr", "--spp", "1000000000000", *SMALL], ["sub-pixels"]),
    "render per source": ("render", [SCENE, "-o", "f.exr", "--per-source", "-1"], ["--per-source"]),
    "render default": ("render", [SCENE, "-o", "f.exr", "-D", "nothing=1"], ["nothing", "beam_radius"]),
    "render default without value": ("render", [SCENE, "-o", "f.exr", "-D", "width"], ["name=value"]),
    "render default of a wrong type": ("render", [SCENE, "-o", "f.exr", "-D", "width=1.5"], ["1.5"]),
    "render default not finite": ("render", [SCENE, "-o", "f.exr", "-D", "pixel_pitch=nan"], ["pixel_pitch"]),
    "render no scene": ("render", ["none.xml", "-o", "f.exr"], ["none.xml"]),
    "render a folder": ("render", [".", "-o", "f.exr"], ["."]),
    "render no folder": ("render", [SCENE, "-o", "no/f.exr"], ["no"]),
    "render into a folder": ("render", [SCENE, "-o", "."], ["folder"]),
    "render variant": ("render", [SCENE, "-o", "f.exr", "--variant", "scalar_rgb"], ["scalar_rgb", "llvm_ad_mono"]),
    "sweep motion": ("sweep", [SCENE, "--dof", "w"], ["w", "rx"]),
    "sweep range": ("sweep", [SCENE, "--range", "-1"], ["--range"]),
    "sweep range infinite": ("sweep", [SCENE, "--range", "inf"], ["--range"]),
    "sweep steps": ("sweep", [SCENE, "--steps", "0"], ["--steps"]),
    "sweep steps huge": ("sweep", [SCENE, "--steps", "1000000000000"], ["frames", "must be at most"]),
    "sweep seeds": ("sweep", [SCENE, "--seeds", "-1"], ["--seeds"]),
    "sweep seeds huge": ("sweep", [SCENE, "--seeds", "1000000000000"], ["frames", "must be at most"]),
    "sweep window": ("sweep", [SCENE, "--window", "1"], ["--window"]),
    "sweep window huge": ("sweep", [SCENE, "--window", "100000", *SMALL], ["--window", "24"]),
    "correlate no file": ("correlate", ["a.exr", "b.exr"], ["a.exr"]),
    "correlate a folder": ("correlate", [".", "."], ["."]),
    "stability into a file": ("stability.__main__", ["--out", SCENE], ["tilted_laser.xml", "folder"]),
    "stability variant": ("stability.__main__", ["--variant", "none"], ["none", "llvm_ad_mono"]),
}


@pytest.mark.parametrize("fault", BAD_FLAGS)
def test_a_bad_flag_is_refused_in_one_line_and_leaves_nothing(run, tmp_path, fault):
    name, arguments, words = BAD_FLAGS[fault]
    refused(run(name, *arguments), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["render", "sweep", "correlate", "sysinfo", "stability.__main__"])
@pytest.mark.parametrize("arguments", [["--no-such-flag"], ["--steps", "many"], ["--out"]])
def test_an_unknown_or_unreadable_flag_ends_with_status_2(run, name, arguments):
    status, lines = run(name, *arguments)
    assert status == BAD_INPUT and lines and not any("Traceback" in line for line in lines)


XML = {
    "empty": "",
    "no XML": "hello",
    "unclosed": '<scene version="3.0.0">',
    "no version": "<scene/>",
    "no such version": '<scene version="new"/>',
    "nothing in it": '<scene version="3.0.0"/>',
    "a shape alone": '<shape version="3.0.0" type="sphere"/>',
    "no such plugin": '<scene version="3.0.0"><shape type="sphear"/></scene>',
    "no such file": '<scene version="3.0.0"><include filename="none.xml"/></scene>',
    "no such reference": '<scene version="3.0.0"><ref id="none"/></scene>',
    "no such default": '<scene version="3.0.0"><integrator type="coherent"><float name="tolerance" value="$none"/></integrator></scene>',
    "very deep": '<scene version="3.0.0">' + '<shape type="sphere">' * 3000,
    "a null": '<scene version="3.0.0">\0</scene>',
}


@pytest.mark.parametrize("kind", XML)
def test_broken_xml_is_refused_in_one_line(run, tmp_path, kind):
    (tmp_path / "scene.xml").write_text(XML[kind])
    refused(run("render", "scene.xml", "-o", "f.exr"))
    assert not (tmp_path / "f.exr").exists()


def test_a_scene_that_is_no_text_is_refused(run, tmp_path):
    (tmp_path / "scene.xml").write_bytes(bytes(range(256)) * 4)
    refused(run("render", "scene.xml", "-o", "f.exr"))


def test_with_debug_the_traceback_is_shown(run):
    status, lines = run("render", SCENE, "-o", "f.exr", "--debug", "-D", "beam_radius=-1")
    assert status == BAD_INPUT and any("Traceback" in line for line in lines)
    is_clear(lines[-1], "error:", "beam_radius")


def test_a_damaged_image_is_refused_by_correlate(run, tmp_path, image):
    damaged = tmp_path / "damaged.exr"
    damaged.write_bytes(image.read_bytes()[:-10])
    refused(run("correlate", image, damaged), "damaged.exr", "cut short")


def test_images_that_do_not_fit_together_are_refused(run, tmp_path, image):
    write_field(tmp_path / "other.exr", FieldImage(np.ones((5, 6), np.float32), np.ones((5, 6), complex), {}))
    refused(run("correlate", image, "other.exr"), "shape")
    write_field(tmp_path / "pitch.exr", FieldImage(IMAGE.intensity, IMAGE.field, {"pixel_pitch_mm": 0.003}))
    refused(run("correlate", image, "pitch.exr"), "pitch")
    write_field(tmp_path / "nan.exr", FieldImage(np.full((4, 6), np.nan, np.float32), IMAGE.field, {}))
    refused(run("correlate", image, "nan.exr"), "moved image", "finite")


# Nothing lost: output that cannot be written


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_folder_without_permission_is_named(run, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    refused(run("render", SCENE, "-o", "locked/f.exr", *SMALL), "locked")


def test_a_file_where_a_folder_should_be_is_named(run, tmp_path):
    (tmp_path / "out").write_text("mine")
    refused(run("sweep", SCENE, "--out", "out", *SMALL), "out", "folder")
    refused(run("sweep", SCENE, "--out", "out/deeper", *SMALL), "out")
    refused(run("render", SCENE, "-o", "out/f.exr", *SMALL), "out")
    assert (tmp_path / "out").read_text() == "mine"


def test_an_image_of_other_settings_is_not_overwritten_unless_forced(run, tmp_path):
    first = ["render", SCENE, "-o", "f.exr", "--sources", "s.npz", "--quiet", *SMALL]
    assert run(*first) == (0, [])
    held = {name: (tmp_path / name).read_bytes() for name in ("f.exr", "s.npz")}
    for other in (["--pose", "x=0.1"], ["--spp", "4"], ["--per-source", "2"], ["-D", "beam_radius=0.1"]):
        refused(run(*first, *other), "f.exr", "other settings", "--force")
    refused(run("render", SCENE, "-o", "g.exr", "--sources", "s.npz", "--pose", "x=0.1", *SMALL), "s.npz", "--force")
    assert {name: (tmp_path / name).read_bytes() for name in held} == held
    assert run(*first) == (0, []) and run(*first, "--pose", "x=0.1", "--force") == (0, [])
    assert (tmp_path / "f.exr").read_bytes() != held["f.exr"] and (tmp_path / "s.npz").read_bytes() != held["s.npz"]


def test_files_of_other_programs_are_not_overwritten_unless_forced(run, tmp_path):
    (tmp_path / "f.exr").write_text("mine")
    refused(run("render", SCENE, "-o", "f.exr", *SMALL), "f.exr", "--force")
    (tmp_path / "out").mkdir()
    for command, name in (("converge", "converge.csv"), ("stability.__main__", "stability.csv")):
        (tmp_path / "out" / name).write_text("mine")
        refused(run(command, *([SCENE] if command == "converge" else []), "--out", "out"), name, "--force")
    (tmp_path / "b.json").write_text("{}")
    refused(run("benchmark", "--quick", "--out", "b.json"), "b.json", "--force")


def test_a_device_is_not_replaced_by_a_file(run):
    refused(run("render", SCENE, "-o", os.devnull, *SMALL), "device")


def full_disk(*_, **__):
    raise OSError(28, "No space left on device", "f.exr")


def test_a_full_disk_leaves_the_old_image_and_no_fragment(run, tmp_path, monkeypatch):
    import OpenEXR

    assert run("render", SCENE, "-o", "f.exr", "--quiet", *SMALL) == (0, [])
    before = (tmp_path / "f.exr").read_bytes()
    monkeypatch.setattr(OpenEXR.File, "write", full_disk)
    refused(run("render", SCENE, "-o", "f.exr", "--pose", "x=0.1", "--force", "--quiet", *SMALL), "no space left")
    assert (tmp_path / "f.exr").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["f.exr"]


def test_a_disk_that_fills_up_during_a_sweep_keeps_its_finished_frames_and_their_table(run, tmp_path, monkeypatch):
    import OpenEXR

    write, written = OpenEXR.File.write, []

    def fills_up(file, name):
        if len(written) == 3:
            full_disk()
        written.append(name)
        write(file, name)

    monkeypatch.setattr(OpenEXR.File, "write", fills_up)
    refused(
        run("sweep", SCENE, "--seeds", "2", "--dof", "x", "--steps", "4", "--out", "out", "--quiet", *SMALL),
        "no space left",
    )
    frames = sorted((tmp_path / "out" / "frames").iterdir())
    assert len(frames) == 3
    for path in frames:
        assert read_field(path).intensity.shape == (16, 24)
    rows = (tmp_path / "out" / "sweep.csv").read_text().splitlines()
    assert len(rows) == 1 + len(frames)
    assert not (tmp_path / "out" / "summary.json").exists()


def test_a_full_disk_leaves_the_old_table(run, tmp_path, monkeypatch):
    from speckle_mi.files import write_json

    path = tmp_path / "summary.json"
    write_json(path, {"a": 1})
    monkeypatch.setattr("pathlib.Path.write_text", full_disk)
    with pytest.raises(OSError):
        write_json(path, {"a": 2})
    assert json.loads(path.read_text()) == {"a": 1} and len(list(tmp_path.iterdir())) == 1
