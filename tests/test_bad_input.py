"""Bad images, flags and files, output that cannot be written: one clear line, status 2, no traceback, nothing lost."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from bad_scenes import is_clear
from conftest import SCENES

from speckle_mi.command_line import command
from speckle_mi.images.exr import read_field, write_field
from speckle_mi.images.field_image import FieldImage, FieldImageError

SCENE = str(SCENES / "tilted_laser.xml")
SMALL = ["-D", "width=24", "-D", "height=16", "-D", "pixel_pitch=0.03", "-D", "point_sources=20"]
BAD_INPUT = 2

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
    "render pose out of the world": ("render", [SCENE, "-o", "f.exr", "--pose", "x=1e12"], ["x", "1e+06"]),
    "sweep range out of the world": ("sweep", [SCENE, "--range", "1e12"], ["x", "1e+06"]),
    "render pose not a number": ("render", [SCENE, "-o", "f.exr", "--pose", "rx=nan"], ["rx", "finite"]),
    "render spp": ("render", [SCENE, "-o", "f.exr", "--spp", "-1"], ["--spp"]),
    "render spp huge": ("render", [SCENE, "-o", "f.exr", "--spp", "1000000000000", *SMALL], ["sub-pixels"]),
    "render per source": ("render", [SCENE, "-o", "f.exr", "--per-source", "-1"], ["--per-source"]),
    "render default": ("render", [SCENE, "-o", "f.exr", "-D", "nothing=1"], ["nothing", "beam_radius"]),
    "render default without value": ("render", [SCENE, "-o", "f.exr", "-D", "width"], ["name=value"]),
    "render default of a wrong type": ("render", [SCENE, "-o", "f.exr", "-D", "width=1.5"], ["1.5"]),
    "render default not finite": ("render", [SCENE, "-o", "f.exr", "-D", "pixel_pitch=nan"], ["pixel_pitch"]),
    "render per source huge": ("render", [SCENE, "-o", "f.exr", "--per-source", "99999999999999999999"], ["at most"]),
    "render per source not whole": ("render", [SCENE, "-o", "f.exr", "--per-source", "1.5"], ["--per-source", "'1.5'"]),
    "render spp empty": ("render", [SCENE, "-o", "f.exr", "--spp", ""], ["--spp", "''", "whole number"]),
    "render pose empty": ("render", [SCENE, "-o", "f.exr", "--pose", ""], ["--pose", "x=0.02"]),
    "render pose with a gap": ("render", [SCENE, "-o", "f.exr", "--pose", "x=1,,y=2"], ["x=1,,y=2"]),
    "render two poses": ("render", [SCENE, "-o", "f.exr", "--pose", "x=1", "--pose", "y=1"], ["--pose", "twice"]),
    "render misspelt": ("render", [SCENE, "-o", "f.exr", "--psoe", "x=1"], ["--psoe", "--help"]),
    "render no value": ("render", [SCENE, "-o"], ["-o", "expected one argument"]),
    "render no output": ("render", [SCENE], ["-o", "required"]),
    "render nameless": ("render", [SCENE, "-o", ""], ["''", "name of a file"]),
    "render a picture": ("render", [SCENE, "-o", "f.png"], ["f.png", ".exr"]),
    "render sources nameless": ("render", [SCENE, "-o", "f.exr", "--sources", ""], ["''", "name of a file"]),
    "render sources elsewhere": ("render", [SCENE, "-o", "f.exr", "--sources", "f.txt"], ["f.txt", ".npz"]),
    "render where nothing can be": ("render", [SCENE, "-o", "/proc/f.exr"], ["/proc", "written"]),
    "render default empty": ("render", [SCENE, "-o", "f.exr", "-D", "roughness="], ["roughness", "name=value"]),
    "render scene nameless": ("render", ["", "-o", "f.exr"], ["''", "scene"]),
    "render no scene": ("render", ["none.xml", "-o", "f.exr"], ["none.xml"]),
    "render a folder": ("render", [".", "-o", "f.exr"], ["."]),
    "render no folder": ("render", [SCENE, "-o", "no/f.exr"], ["no"]),
    "render into a folder": ("render", [SCENE, "-o", "."], ["folder"]),
    "render variant": ("render", [SCENE, "-o", "f.exr", "--variant", "scalar_rgb"], ["scalar_rgb", "llvm_ad_mono"]),
    "sweep motion": ("sweep", [SCENE, "--dof", "w"], ["w", "rx"]),
    "sweep range": ("sweep", [SCENE, "--range", "-1"], ["--range"]),
    "sweep range infinite": ("sweep", [SCENE, "--range", "inf"], ["--range"]),
    "sweep range beyond rounding": ("sweep", [SCENE, "--range", "5e-324"], ["--range", "at least"]),
    "sweep range not a number": ("sweep", [SCENE, "--range", "wide"], ["--range", "'wide'", "must be a number"]),
    "sweep motion with a gap": ("sweep", [SCENE, "--dof", "x,,y"], ["--dof", "''"]),
    "sweep nameless": ("sweep", [SCENE, "--out", ""], ["--out", "folder"]),
    "sweep where nothing can be": ("sweep", [SCENE, "--out", "/proc/x/y"], ["/proc", "written"]),
    "sweep below a file": ("sweep", [SCENE, "--out", SCENE + "/y"], ["tilted_laser.xml", "folder"]),
    "sweep steps": ("sweep", [SCENE, "--steps", "0"], ["--steps"]),
    "sweep steps huge": ("sweep", [SCENE, "--steps", "1000000000000"], ["frames", "must be at most"]),
    "sweep seeds": ("sweep", [SCENE, "--seeds", "-1"], ["--seeds"]),
    "sweep seeds huge": ("sweep", [SCENE, "--seeds", "1000000000000"], ["frames", "must be at most"]),
    "sweep window": ("sweep", [SCENE, "--window", "1"], ["--window"]),
    "sweep window huge": ("sweep", [SCENE, "--window", "100000", *SMALL], ["--window", "24"]),
    "converge nameless": ("converge", [SCENE, "--out", ""], ["--out", "folder"]),
    "converge where nothing can be": ("converge", [SCENE, "--out", "/proc"], ["/proc", "written"]),
    "converge seconds": ("converge", [SCENE, "--out", "o", "--seconds", "inf"], ["--seconds", "finite"]),
    "converge N1 not whole": ("converge", [SCENE, "--out", "o", "--point-sources", "1.5"], ["'1.5'", "whole"]),
    "converge N1 huge": ("converge", [SCENE, "--out", "o", "--point-sources", "1e16"], ["'1e16'", "1e+15"]),
    "converge N1 too many": ("converge", [SCENE, "--out", "o", "--point-sources", "1e15", *SMALL], ["at most 1e+08"]),
    "benchmark nameless": ("benchmark", ["--quick", "--out", ""], ["''", "name of a file"]),
    "benchmark elsewhere": ("benchmark", ["--quick", "--out", "b.txt"], ["b.txt", ".json"]),
    "stability nameless": ("stability", ["--out", ""], ["--out", "folder"]),
    "correlate nameless": ("correlate", ["", ""], ["''", "image"]),
    "correlate window empty": ("correlate", ["a.exr", "b.exr", "--window", ""], ["--window", "whole number"]),
    "correlate no file": ("correlate", ["a.exr", "b.exr"], ["a.exr"]),
    "correlate a folder": ("correlate", [".", "."], ["."]),
    "stability into a file": ("stability", ["--out", SCENE], ["tilted_laser.xml", "folder"]),
    "stability variant": ("stability", ["--variant", "none"], ["none", "llvm_ad_mono"]),
}


@pytest.mark.parametrize("fault", BAD_FLAGS)
def test_a_bad_flag_is_refused_in_one_line_and_leaves_nothing(run, tmp_path, fault):
    name, arguments, words = BAD_FLAGS[fault]
    refused(run(name, *arguments), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["render", "sweep", "correlate", "sysinfo", "stability"])
@pytest.mark.parametrize("arguments", [["--no-such-flag"], ["--steps", "many"], ["--out"]])
def test_an_unknown_or_unreadable_flag_ends_with_status_2(run, name, arguments):
    status, lines = run(name, *arguments)
    assert status == BAD_INPUT and len(lines) == 1 and lines[0].startswith("error:"), lines


def test_one_file_is_not_written_over_another_of_the_same_command(run, tmp_path):
    (tmp_path / "s.exr").write_text((SCENES / "tilted_laser.xml").read_text())
    refused(run("render", "s.exr", "-o", "./s.exr", "--force", *SMALL), "s.exr", "two files")
    assert (tmp_path / "s.exr").read_text().startswith("<?xml")


def test_of_defaults_of_one_name_the_last_counts(run, tmp_path):
    assert run("render", SCENE, "-o", "f.exr", "--quiet", *SMALL, "-D", "width=8") == (0, [])
    assert read_field(tmp_path / "f.exr").intensity.shape == (16, 8)




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
    "no such default": '<scene version="3.0.0"><integrator type="coherent">'
    '<float name="tolerance" value="$none"/></integrator></scene>',
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
    # Of images of two sizes what both show is compared, if the window fits into it.
    refused(run("correlate", image, "other.exr", "--window", "7"), "window = 7", "4 to 6 px")
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
    for start, name in ((("converge", SCENE), "converge.csv"), (("stability",), "stability.csv")):
        (tmp_path / "out" / name).write_text("mine")
        refused(run(*start, "--out", "out"), name, "--force")
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
    from speckle_mi.machine.files import write_json

    path = tmp_path / "summary.json"
    write_json(path, {"a": 1})
    monkeypatch.setattr("pathlib.Path.write_text", full_disk)
    with pytest.raises(OSError):
        write_json(path, {"a": 2})
    assert json.loads(path.read_text()) == {"a": 1} and len(list(tmp_path.iterdir())) == 1
