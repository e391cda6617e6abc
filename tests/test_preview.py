"""The drawing of an assembly: what stands where, rays as they really go, files that are whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import SCENES
from matplotlib.image import imread

from speckle_mi.command_line import BAD_INPUT, DONE, command
from speckle_mi.experiments.layout import layout_of
from speckle_mi.preview import main

ROUNDING = 1e-9  # [mm], of rays traced in double precision.


def part(layout, name):
    (found,) = [one for one in layout.parts if one.name == name]
    return found


def segments(ray):
    return np.linalg.norm(np.diff(ray, axis=0), axis=1)


def test_chief_ray_runs_over_the_distances_of_the_scene(shipped):
    layout = layout_of({"detector": shipped("integrated_sensor")})
    ((way, rays),) = layout.rays.items()
    assert way == "target - aperture - detector"
    np.testing.assert_allclose(segments(rays[0]), [41.0, 34.0], atol=1e-6)
    assert dict(layout.facts)[way].startswith("41 + 34 mm")


def test_rays_are_drawn_where_mirrors_send_them(shipped):
    assembly = shipped("folded")
    layout = layout_of({"detector": assembly})
    (rays,) = layout.rays.values()
    mirror = assembly.elements[[element.name for element in assembly.elements].index("mirror")].faces[0].frame
    assert len(rays) == 5
    for ray in rays:
        place = assembly.detector.centre
        assert abs((ray[-1] - place) @ assembly.detector.normal) < ROUNDING
        assert abs(mirror.to_local(ray[1:2])[0, 2]) < ROUNDING
        before, behind = (step / np.linalg.norm(step) for step in np.diff(ray, axis=0))
        np.testing.assert_allclose(behind, before - 2 * (before @ mirror.axes[:, 2]) * mirror.axes[:, 2], atol=1e-9)


def test_marginal_rays_of_an_image_meet_in_it(shipped):
    layout = layout_of({"detector": shipped("imaging")})
    (rays,) = layout.rays.values()
    ends = np.array([ray[-1] for ray in rays])
    # Spherical aberration of the singlet at its stop: far less than the stop's radius of a millimetre or so.
    assert np.linalg.norm(ends - ends[0], axis=1).max() < 0.05


def test_a_lens_is_drawn_with_its_profile_and_a_stop_with_its_hole(shipped):
    assembly = shipped("imaging")
    layout = layout_of({"detector": assembly})
    lens = next(element for element in assembly.elements if element.kind == "glass")
    stop = next(element for element in assembly.elements if element.kind == "opening")
    for view in (0, 1):
        outline, *_ = part(layout, lens.name).lines[view]
        assert outline.closed
        for face in lens.faces:
            x, y, z = face.frame.to_local(outline.points).T
            on_face = np.abs(z - face.sag(x, y)) < ROUNDING
            assert np.count_nonzero(on_face) >= len(outline.points) // 2
        middle, radius = stop.faces[0].frame.origin, stop.faces[0].outline.radius
        gaps = [np.linalg.norm(line.points - middle, axis=1) for line in part(layout, stop.name).lines[view]]
        assert len(gaps) == 2 and all(abs(gap.min() - radius) < 0.02 * radius for gap in gaps)
        assert all(abs(gap.max() - stop.screen_radius) < ROUNDING for gap in gaps)


def test_beam_is_as_wide_as_it_is(shipped):
    assembly = shipped("integrated_sensor")
    ((axis, *edges),) = layout_of({"detector": assembly}).beams
    width = assembly.beam.radius
    assert len(edges) == 4
    for edge in edges:
        assert np.linalg.norm(edge.points[-1] - axis.points[-1]) == pytest.approx(width, rel=1e-9)


@pytest.mark.parametrize("name", sorted(path.stem for path in SCENES.glob("*.xml")))
def test_every_shipped_scene_is_drawn(mitsuba, tmp_path, name):
    assert command(main, [str(SCENES / f"{name}.xml"), "-o", str(tmp_path / "f.png"), "--quiet"]) == DONE
    picture = imread(tmp_path / "f.png")
    assert min(picture.shape[:2]) > 500 and len(np.unique(picture.reshape(-1, 4), axis=0)) > 20


def test_drawing_as_svg_names_every_part_and_warns_of_dark_ways(mitsuba, tmp_path, capsys):
    scene = tmp_path / "dark.xml"
    text = Path(SCENES / "integrated_sensor.xml").read_text()
    place = '<transform name="to_world"><scale value="30"/><translate z="60"/></transform>'
    wall = f'<shape type="rectangle" id="wall">{place}'
    scene.write_text(text.replace("</scene>", wall + '<bsdf type="diffuse"/></shape></scene>'))
    assert command(main, [str(scene), "-o", str(tmp_path / "f.svg")]) == DONE
    assert "warning: no light reaches the detector: most test rays end at" in capsys.readouterr().out
    assert (tmp_path / "f.svg").read_text().lstrip().startswith("<?xml")


def test_bad_output_is_refused(mitsuba, tmp_path, capsys):
    assert command(main, [str(SCENES / "folded.xml"), "-o", str(tmp_path / "f.bmp")]) == BAD_INPUT
    assert "must end in .png, .svg or .html" in capsys.readouterr().err and not list(tmp_path.iterdir())
