"""What scripts rely on: every command prints what it found as JSON, and shows an example with its help."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import shlex

import pytest
from conftest import SCENES
from scene_builder import direction, free_space
from test_architecture import COMMANDS

from speckle_mi.command_line import DONE, command

NAMES = sorted(COMMANDS - {"__main__"})


def main_of(name):
    return importlib.import_module(f"speckle_mi.{name}").main


@pytest.fixture(scope="module")
def folder(mitsuba, tmp_path_factory):
    """A scene and two images of it."""
    folder = tmp_path_factory.mktemp("scripts")
    detector = {"width": 48, "height": 40, "pixel_pitch": 0.03}
    (folder / "scene.xml").write_text(free_space(direction(30), detector=detector, target={"point_sources": 20}))
    for name, pose in (("rest", "x=0"), ("moved", "x=0.02")):
        line = [str(folder / "scene.xml"), "-o", str(folder / f"{name}.exr"), "--pose", pose, "--quiet"]
        assert command(main_of("render"), line) == DONE
    return folder


def told(name, line):
    """What a command prints, which must be one JSON text and nothing besides."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert command(main_of(name), shlex.split(line)) == DONE
    return json.loads(printed.getvalue())


def test_what_is_found_is_printed_as_json(folder):
    scene = folder / "scene.xml"
    swept = told("sweep", f"{scene} --dof x --steps 2 --seeds 2 --json --out {folder / 'swept'}")
    assert swept == json.loads((folder / "swept" / "summary.json").read_text())
    measured = told("sensitivity", f"{scene} --dof x --seeds 3 --json --out {folder / 'one.json'}")
    assert measured == json.loads((folder / "one.json").read_text())
    assert told("render", f"{scene} -o {folder / 'f.exr'} --json")["output"] == str(folder / "f.exr")
    assert told("correlate", f"{folder / 'rest.exr'} {folder / 'moved.exr'} --json")["status"] == "ok"
    both = told("correlate", f"{folder / 'rest.exr'} {folder / 'moved.exr'} {folder / 'rest.exr'} --json")
    assert [row["moved"] for row in both] == [str(folder / f"{name}.exr") for name in ("moved", "rest")]
    assert told("view", f"{folder / 'rest.exr'} --json")["contrast"] > 0.5
    drawn = told("preview", f"{scene} -o {folder / 'f.svg'} --json")
    assert drawn["facts"]["detector"].startswith("48 x 40 pixels") and drawn["problems"] == []
    assert told("sysinfo", "--json")["speckle_mi"] and told("__main__", "--json").keys() == set(NAMES)
    assert set(told("scenes", "--json")["scenes"]) >= {path.stem for path in SCENES.glob("*.xml")}
    assert told("scenes", f"imaging --to {folder / 'new'} --json") == {"written": str(folder / "new" / "imaging.xml")}


@pytest.mark.parametrize("name", NAMES)
def test_help_shows_an_example_that_the_command_takes(name):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), pytest.raises(SystemExit):
        main_of(name)(["--help"])
    text = printed.getvalue()
    (shown,) = [line for line in text.splitlines() if line.startswith(f"  python -m speckle_mi.{name} ")]
    assert "--json" in text and "example:" in text
    flags = [word for word in shlex.split(shown) if word.startswith("-") and word not in ("-m", "-o")]
    assert all(flag in text.replace(shown, "") for flag in flags)
