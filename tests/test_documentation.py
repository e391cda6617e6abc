"""The documentation is true: its commands run, its code runs, its tables and pictures are those of the program."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from conftest import ROOT, SCENES
from documented import blocks, grown
from PIL import Image

from speckle_mi.command_line import BAD_INPUT, DONE, command
from speckle_mi.document import main
from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM

PAGES = [ROOT / "README.md", SCENES / "README.md", SCENES / "gallery" / "README.md", ROOT / "plugins" / "README.md",
         ROOT / "speckle_mi" / "README.md"]  # fmt: skip
LARGEST = 250_000  # Bytes of a picture.


def run(line):
    """Runs a command line as it stands, in the current folder: ours in this process."""
    python, *words = shlex.split(line)
    assert python == "python", line
    if words[0] == "-m":
        name = words[1].removeprefix("speckle_mi.")
        assert command(importlib.import_module(f"speckle_mi.{name}").main, words[2:]) == DONE, line
        return
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"{line}\n{done.stderr}"


@pytest.fixture
def here(mitsuba, tmp_path, monkeypatch):
    """An empty folder with the example scenes in it, the current one."""
    monkeypatch.chdir(tmp_path)
    os.symlink(SCENES, tmp_path / "scenes")
    return tmp_path


# Pages


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_pictures_and_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    anchors = set(re.findall(r'<a id="([\w-]+)">', text))
    for is_picture, address in re.findall(r"(!?)\[[^\]]*\]\(([^)\s]+)\)", text):
        if address.startswith("http"):
            continue
        if address.startswith("#"):
            assert address[1:] in anchors
            continue
        path = page.parent / address.partition("#")[0]
        assert path.is_file(), address
        if is_picture:
            assert path.stat().st_size < LARGEST
            with Image.open(path) as image:
                assert image.width <= 1000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_every_command_that_is_named_is_there(page):
    text = page.read_text(encoding="utf-8")
    named = set(re.findall(r"python -m speckle_mi\.(\w+)", text))
    assert all((ROOT / "speckle_mi" / f"{name}.py").is_file() for name in named)
    scenes = set(re.findall(r"scenes/([\w/]+)\.xml", text))
    assert all((SCENES / f"{name}.xml").is_file() for name in scenes)


# README.md


def test_the_commands_of_the_readme_run(here):
    """But for its first two blocks, which install the package and run the tests."""
    install, tests, *others = [text for language, text in blocks(ROOT / "README.md") if language == "sh"]
    assert "pip install" in install and "speckle_mi.sweep scenes/tilted_laser.xml" in install and "pytest" in tests
    for text in others:
        for line in text.splitlines():
            run(line)
    assert json.loads((here / "two.json").read_text())["detectors"]
    assert (here / "results" / "shaken" / "truth.csv").is_file()


def test_the_programs_of_the_readme_run(here):
    run("python -m speckle_mi.render scenes/tilted_laser.xml -o F.exr --sources F.npz -D width=32 -D height=24")
    programs = [text for language, text in blocks(ROOT / "README.md") if language == "python"]
    head = "import matplotlib; matplotlib.use('Agg')\nimport numpy\nrow, column = 3, 5\n"
    # The check of a field by hand gives the field of the file.
    checked = (
        "from speckle_mi.images.exr import read_field\n"
        "if 'E' in globals(): assert abs(E / read_field('F.exr').field[row, column] - 1) < 1e-3"
    )
    assert len(programs) >= 3
    for number, text in enumerate(programs):
        (here / f"{number}.py").write_text(f"{head}{text}\n{checked}\n")
        run(f"python {number}.py")


# scenes/README.md


def test_a_sensor_is_written_in_six_steps(here):
    scene = ""
    for language, text in blocks(SCENES / "README.md"):
        if language == "xml":
            scene = grown(scene, text)
            (here / "sensor.xml").write_text(scene)
        else:
            for line in text.splitlines():
                run(line)
    assert scene.count("<sensor") == 1 and scene.count("<emitter") == 1
    for number in (1, 2, 3, 5, 6):
        assert (here / f"step{number}.png").stat().st_size > 10_000
    assert {"report.html", "shift_x_u.png"} <= {path.name for path in (here / "results").iterdir()}


# plugins/README.md


def test_the_reference_is_the_plugins_documentation(tmp_path):
    assert command(main, ["--plugins", str(tmp_path / "f.md"), "--quiet"]) == DONE
    text = (tmp_path / "f.md").read_text()
    assert text == (ROOT / "plugins" / "README.md").read_text()
    for path in (ROOT / "plugins").glob("[!_]*.py"):
        documentation = ast.get_docstring(ast.parse(path.read_text()))
        assert f"`{path.stem}`" in text
        for names in re.findall(r"^ \* - (.+)$", documentation, re.MULTILINE):
            assert f"| `{names}` |" in text
    assert ":math:" not in text and "``" not in re.sub("```", "", text)


def test_the_examples_of_the_reference_can_be_read():
    for language, text in blocks(ROOT / "plugins" / "README.md"):
        if language == "xml":
            assert len(ElementTree.fromstring(f"<scene>{text}</scene>")) >= 1
        else:
            ast.parse("{" + text + "}", mode="eval")


# scenes/gallery


def test_the_gallery_shows_every_scene_beside_its_theory(shipped):
    text = (SCENES / "gallery" / "README.md").read_text()
    sections = dict(re.findall(r'<a id="(\w+)"></a>(.*?)(?=<a id=|\Z)', text, re.DOTALL))
    assert sections.keys() == {path.stem for path in SCENES.glob("*.xml")}
    for name in sections:
        assert (SCENES / "gallery" / f"{name}.png").is_file() and f"({name}_speckle.png)" in sections[name]
    for name in ("tilted_laser", "folded", "diverging_beam"):
        expected = expected_sensitivity(shipped(name))
        rows = {row[0]: row for line in sections[name].splitlines() if line.startswith("| ")
                if (row := [cell.strip() for cell in line.strip("|").split("|")])}  # fmt: skip
        for column, dof in enumerate(DEGREES_OF_FREEDOM):
            shown = float(rows[dof][3]), float(rows[dof][5])
            assert shown == pytest.approx([expected["u"][column], expected["v"][column]], abs=1.01e-4)


def test_a_gallery_is_made_of_the_scenes_that_are_asked_for(mitsuba, tmp_path, capsys):
    line = ["--gallery", str(tmp_path / "g"), "--seeds", "2", "--quiet"]
    assert command(main, [*line, "--scenes", "tilted_laser"]) == DONE
    found = {path.name for path in (tmp_path / "g").iterdir()}
    assert found == {"README.md", "tilted_laser.png", "tilted_laser_speckle.png"}
    assert command(main, [*line, "--scenes", "tilted_lazer"]) == BAD_INPUT
    assert command(main, []) == BAD_INPUT
    error = capsys.readouterr().err
    assert "'tilted_lazer': there is no such scene, must be one of ball_lens" in error
    assert "--plugins F.md, --gallery DIR or both must be given" in error


def test_pages_are_found_from_the_first():
    text = Path(PAGES[0]).read_text()
    for page in PAGES[1:]:
        assert f"({page.relative_to(ROOT)})" in text
