"""Scenes that cannot be meant: one clear line that says what, where, what it is and what it may be."""

from __future__ import annotations

import re

import numpy as np
import pytest
from bad_scenes import ABOVE, CAMERA, PARTS, is_clear, on_axis, refusal, scene_with, with_parameter
from scene_builder import detector_frame, detector_xml, direction, frame_along, laser_xml, target_xml

from speckle_mi.scene.read import assembly_from_scene
from speckle_mi.scene.errors import one_line
from speckle_mi.field.simulation import simulate_frame

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
    ("laser", "float", "wavefront_radius", "1e300"),
    ("laser", "float", "wavefront_radius", "-1e-300"),
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
    ("target", "float", "seed", "0.5"),
    ("target", "string", "lobe", "yes"),
    ("integrator", "integer", "rays_per_source", "0"),
    ("lens", "float", "conic1", "-1e5"),
    ("lens", "float", "conic2", "1e5"),
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


@pytest.mark.parametrize("part, name", [("laser", "wavelength"), ("detector", "pixel_pitch")])
def test_a_missing_required_parameter_is_named(mitsuba, part, name):
    text = re.sub(rf'<\w+ name="{name}" value="[^"]*"/>', "", PARTS[part])
    line = refusal(mitsuba, scene_with(**{part: text}))
    assert name in line and "missing" in line, line


@pytest.mark.parametrize("part", PARTS)
def test_a_misspelt_name_is_quoted(mitsuba, part):
    plugin = re.search(r'type="(\w+)"', PARTS[part]).group(1)
    is_clear(refusal(mitsuba, with_parameter(part, "float", "wavelenght", "1")), "wavelenght", plugin, "must")


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


@pytest.mark.parametrize("part, plugin", [("target", "rough_target"), ("detector", "detector")])
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


@pytest.mark.parametrize("kind", UNKNOWN)
def test_what_cannot_be_taken_into_account_is_refused_by_name(mitsuba, kind):
    assert "odd" in refusal(mitsuba, scene_with(second=UNKNOWN[kind]))


def test_a_laser_that_lights_the_back_of_the_target_is_refused(mitsuba):
    below = frame_along(direction(0), -50 * direction(0), np.array([1.0, 0, 0]))
    assert "back" in refusal(mitsuba, scene_with(laser=laser_xml(below)))


def test_a_laser_along_the_surface_is_refused(mitsuba):
    along = frame_along(-direction(90), 50 * direction(90), np.array([0, 1.0, 0]))
    assert "surface" in refusal(mitsuba, scene_with(laser=laser_xml(along)))


def test_screens_that_lie_in_each_other_are_refused(mitsuba):
    second = PARTS["aperture"].replace('id="aperture"', 'id="second"').replace('value="0.5"', 'value="0.4"')
    is_clear(refusal(mitsuba, scene_with(second=second)), "aperture", "second", "one plane", "must")


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
    "out of the world": b"0,0,1e9",
    "of no strength that an image holds": b"0,0,0,1e300,0",
}


@pytest.mark.parametrize("kind", POINTS)
def test_a_bad_list_of_points_is_refused(mitsuba, tmp_path, kind):
    path = tmp_path / "points.csv"
    path.write_bytes(POINTS[kind])
    is_clear(refusal(mitsuba, with_parameter("target", "string", "points", str(path))), "points.csv", "must")


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
    "far.ply": PLY_HEAD + b"0 0 0\n1e9 0 0\n0 1 0\n3 0 1 2\n",
    "flat.ply": PLY_HEAD + b"0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n",
    "huge.ply": PLY_HEAD.replace(b"vertex 3", b"vertex 3000000000") + b"0 0 0\n",
    "empty.obj": b"",
    "text.obj": b"nothing here",
    "head.ply": b"ply\n",
    "index.obj": b"v 0 0 0\nv 1 0 0\nf 1 2 9\n",
    "mesh.stl": b"solid\n",
}


@pytest.mark.parametrize("name", MESHES)
def test_a_bad_mesh_is_refused(mitsuba, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(MESHES[name])
    is_clear(refusal(mitsuba, with_parameter("target", "string", "filename", str(path))), name)


def test_a_mesh_and_a_size_together_are_refused(mitsuba, tmp_path):
    (tmp_path / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert "filename" in refusal(mitsuba, scene_with(target=target_xml(filename=str(tmp_path / "one.obj"), width=4.0)))


@pytest.mark.parametrize("kind", ["aperture", "blocker", "target"])
def test_a_shape_too_far_out_for_single_precision_is_refused_by_name(mitsuba, kind):
    """Rays start off a surface by what rounding moves it; 90 m out that is more than between target and screen."""
    far = {
        "aperture": {"aperture": PARTS["aperture"].replace('"9.0"', '"90000.0"')},
        "blocker": {"lens": '<shape type="rectangle" id="blocker">'
                            '<transform name="to_world"><translate x="30001" z="5"/>'
                            '</transform><bsdf type="diffuse"/></shape>'},
        "target": {"target": target_xml(width=70000.0)},
    }  # fmt: skip
    is_clear(refusal(mitsuba, scene_with(**{"lens": ""} | far[kind])), kind, "30000 mm")


def test_a_shape_just_inside_thirty_metres_is_taken(mitsuba):
    far = {"aperture": PARTS["aperture"].replace('"9.0"', '"29000.0"'), "lens": ""}
    assert len(assembly_from_scene(mitsuba.load_string(scene_with(**far))).elements) == 1
