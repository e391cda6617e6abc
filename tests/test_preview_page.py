"""The assembly to turn in a browser, the light on its detector, and what is wrong drawn where it is wrong."""

from __future__ import annotations

import io
import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from browser import NAMES, Browser, browser_path
from conftest import SCENES
from PIL import Image
from scene_builder import direction, free_space

from speckle_mi.command_line import BAD_INPUT, DONE, command
from speckle_mi.experiments.layout import layout_of
from speckle_mi.experiments.layout_3d import patterns_of, solids_of
from speckle_mi.field.simulation import Simulation
from speckle_mi.geometry.pose import Pose
from speckle_mi.preview import main
from speckle_mi.scene.read import assemblies_from_scene, assembly_from_scene

ROUNDING = 1e-9  # [mm], of rays traced in double precision.
SINGLE = 1e-4  # [mm], of places of opaque shapes, which are met in single precision.

needs_browser = pytest.mark.skipif(browser_path() is None, reason=f"none of {', '.join(NAMES)} is installed")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def drawn(mitsuba, tmp_path_factory):
    """The page of a scene with a mirror and an opaque plate, and its text."""
    page = tmp_path_factory.mktemp("preview") / "folded.html"
    assert command(main, [str(SCENES / "folded.xml"), "-o", str(page), "--quiet"]) == DONE
    return page


def solids(assembly):
    layout = layout_of({"detector": assembly})
    return {one.name: one for one in solids_of({"detector": assembly}, layout)}


def test_faces_in_space_lie_on_the_surfaces(shipped):
    assembly = shipped("imaging")
    found = solids(assembly)
    lens = next(element for element in assembly.elements if element.kind == "glass")
    corners = np.concatenate(found[lens.name].polygons)
    on_some = np.zeros(len(corners), dtype=bool)
    for face in lens.faces:
        x, y, z = face.frame.to_local(corners).T
        inside = np.all(face.outline.margins(x, y) >= -ROUNDING, axis=0)
        on_some |= inside & (np.abs(z - face.sag(x, y)) < ROUNDING)
    assert np.all(on_some)
    stop = next(element for element in assembly.elements if element.kind == "opening")
    gaps = np.linalg.norm(np.concatenate(found[stop.name].polygons) - stop.faces[0].frame.origin, axis=1)
    assert gaps.min() == pytest.approx(stop.faces[0].outline.radius) and gaps.max() == pytest.approx(stop.screen_radius)


def test_beam_in_space_is_as_wide_as_it_is(shipped):
    assembly = shipped("tilted_laser")
    corners = np.concatenate(solids(assembly)["laser"].polygons)
    beam = assembly.beam
    along = (corners - beam.origin) @ beam.axis
    axis = beam.origin + along[:, None] * beam.axis
    radii = np.array([beam.radii_at(point)[0] for point in axis])
    np.testing.assert_allclose(np.linalg.norm(corners - axis, axis=1), radii, rtol=1e-9)


@pytest.mark.parametrize("name", sorted(path.stem for path in SCENES.glob("*.xml")))
def test_every_scene_stands_in_space_within_its_bodies(mitsuba, name):
    assembly, *_ = assemblies_from_scene(mitsuba.load_file(str(SCENES / f"{name}.xml")), None).values()
    found = solids(assembly) if assembly.elements else {}
    for element in assembly.elements:
        one = found[element.name]
        assert one.polygons and all(np.all(np.isfinite(polygon)) for polygon in one.polygons)
        low, high = element.body.bounds
        room = 1e-3 * element.size  # bodies of lenses are meshes
        corners = np.concatenate(one.polygons)
        assert np.all(corners >= low - room) and np.all(corners <= high + room)


def test_pattern_is_the_light_of_the_scene(shipped):
    assembly = shipped("tilted_laser")
    shown, said = patterns_of({"detector": assembly})
    intensity = Simulation(assembly).frame().image.intensity
    block = intensity.reshape(240, 2, 372, 2).mean(axis=(1, 3))
    levels = np.sqrt(np.clip(block / np.quantile(block, 0.995), 0, 1))
    assert said == "" and np.abs(shown["detector"].shown / 255 - levels).max() < 0.01


def test_light_of_a_dark_scene_is_drawn_to_where_it_ends(mitsuba, tmp_path):
    text = (SCENES / "integrated_sensor.xml").read_text()
    place = '<transform name="to_world"><scale value="30"/><translate z="60"/></transform>'
    wall = f'<shape type="rectangle" id="wall">{place}<bsdf type="diffuse"/></shape></scene>'
    layout = layout_of({"detector": assembly_from_scene(mitsuba.load_string(text.replace("</scene>", wall)))})
    ended = [one for one in layout.problems if one.ray is not None]
    at_wall = [one for one in ended if abs(one.place[2] - 60) < SINGLE]
    assert "light ends at wall" in [one.words for one in at_wall]
    assert all(one.ray[0] == pytest.approx(layout.origin) and one.ray[-1] == pytest.approx(one.place) for one in ended)
    # Those through the hole pass it inside its radius.
    for one in at_wall:
        assert abs(one.ray[1][2] - 41) < SINGLE and np.hypot(*one.ray[1][:2]) <= 0.5 + SINGLE
    assert layout.problems[-1].words == "no light reaches the detector"
    assert layout.problems[-1].place[2] == pytest.approx(75)


def test_a_beam_beside_the_target_is_drawn_as_missing_it(assemble):
    assembly = assemble(free_space(direction(30)))
    assert not layout_of({"detector": assembly}).problems
    layout = layout_of({"detector": replace(assembly, pose=Pose(x=30.0))})
    (problem,) = layout.problems
    assert problem.words == "the beam's axis (laser) misses the target" and problem.words in layout.warnings
    offset = problem.place - assembly.beam.origin
    assert np.linalg.norm(np.cross(offset, assembly.beam.axis)) < ROUNDING and abs(problem.place[2]) < ROUNDING


def test_a_detector_behind_the_target_is_said_to_stand_there(assemble):
    layout = layout_of({"detector": assemble(free_space(direction(30), direction(180)))})
    assert [one.words for one in layout.problems] == ["the detector stands behind the target"]


@needs_browser
def test_the_page_works_by_itself_and_turns_with_the_mouse(browser, drawn):
    browser.open(drawn)
    assert browser.console == []
    assert [one for one in browser.requests if not one.startswith("data:")] == [drawn.resolve().as_uri()]
    box = browser.value("""(() => { const box = document.querySelector('.space canvas').getBoundingClientRect();
        return [box.left + box.width / 2, box.top + box.height / 2]; })()""")
    before, first = browser.value("document.querySelector('.space').space.yaw"), browser.picture()
    browser.drag((box[0], box[1]), (box[0] + 120, box[1] + 40))
    space = "document.querySelector('.space').space"
    assert browser.value(f"{space}.yaw") == pytest.approx(before + 120 * 0.008) and browser.picture() != first
    for key in ("pose", "focus", "names"):
        assert browser.value(f"!!document.querySelector('.space .{key}')")
    assert browser.console == []


@needs_browser
def test_the_detector_from_its_front_shows_its_image(browser, mitsuba, tmp_path, shipped):
    """Columns run along u, rows along v, as they stand in space: the eye is where the light comes from."""
    page = tmp_path / "f.html"
    assert command(main, [str(SCENES / "tilted_laser.xml"), "-o", str(page), "--quiet"]) == DONE
    browser.open(page)
    number = json.loads(re.search(r'<script type="application/json">(.*?)</script>', page.read_text())[1])
    place = [one["name"] for one in number["solids"]].index("detector")
    browser.value(f"""(() => {{ const space = document.querySelector('.space').space;
        for (const [name, value] of [['pose', 'front'], ['focus', '{place}']]) {{
            const select = document.querySelector(`.space .${{name}}`);
            select.value = value; select.dispatchEvent(new Event('change')); }}
        space.names.checked = false; space.spec.arrows = []; space.spec.lines = [];
        space.items = space.items.filter(one => one.kind === 'pattern'); space.draw(); }})()""")
    browser.settle()
    left, top, width, height, scale = browser.value("""(() => { const space = document.querySelector('.space').space,
        b = space.canvas.getBoundingClientRect(); return [b.left, b.top, b.width, b.height, space.scale]; })()""")
    half = 0.5 * scale * 0.006 * 480
    area = left + width / 2 - half, top + height / 2 - half, left + width / 2 + half, top + height / 2 + half
    picture = Image.open(io.BytesIO(browser.picture())).convert("L").crop(tuple(map(round, area)))
    seen = np.asarray(picture.resize((240, 240)), dtype=float)
    intensity = Simulation(shipped("tilted_laser")).frame().image.intensity.reshape(240, 2, 372, 2).mean(axis=(1, 3))
    square = np.clip(intensity / np.quantile(intensity, 0.995), 0, 1)[:, 66:306]
    # u runs along the target's x, which is up in the drawing, v against its y, which is to the right.
    assert np.corrcoef(seen.ravel(), square.T[::-1, ::-1].ravel())[0, 1] > 0.95


def test_show_opens_the_page(mitsuba, tmp_path, monkeypatch, capsys):
    opened = tmp_path / "opened"
    script = tmp_path / "browser"
    script.write_text(f"#!{sys.executable}\nimport sys\nopen({str(opened)!r}, 'w').write(sys.argv[1])\n")
    script.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{script} %s")
    page = tmp_path / "f.html"
    assert command(main, [str(SCENES / "tilted_laser.xml"), "-o", str(page), "--show", "--quiet"]) == DONE
    assert opened.read_text() == page.as_uri()
    assert command(main, [str(SCENES / "tilted_laser.xml")]) == BAD_INPUT
    assert "-o F.png, F.svg or F.html must be given, or --show" in capsys.readouterr().err
