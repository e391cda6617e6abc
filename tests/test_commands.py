"""The commands as a user types them: exit status, one line for an error, and the files they leave behind."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import SCENES

from speckle_mi.images.exr import read_field

SCENE = str(SCENES / "tilted_laser.xml")
SMALL = [
    "-D",
    "width=64",
    "-D",
    "height=48",
    "-D",
    "pixel_pitch=0.03",
    "-D",
    "point_sources=30",
    "-D",
    "beam_radius=0.2",
]
SWEEP = ["--dof", "x,ry", "--range", "0.02", "--steps", "3", "--seeds", "2"]
COLUMNS = [
    "dof",
    "displacement",
    "unit",
    "seed",
    "shift_u_um",
    "shift_v_um",
    "shift_x_um",
    "shift_y_um",
    "ncc",
    "cog_u_um",
    "cog_v_um",
    "contrast",
    "seconds",
    "status",
    "sigma_u_um",
    "sigma_v_um",
]
AXES = {"u", "v", "x", "y", "cog_u", "cog_v"}
ENTRY = {
    "value", "ci95", "theory", "bias", "scatter_um", "unit", "basis", "frames_used", "frames_dropped", "note",
}  # fmt: skip
DONE, FAULT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def run(command, *arguments, cwd, blocked=()):
    """Runs ``python -m speckle_mi.<command>``, with the import of modules ``blocked``."""
    start = ["-m", f"speckle_mi.{command}"]
    if blocked:
        script = f"import sys, runpy; sys.modules.update({{name: None for name in {tuple(blocked)!r}}}); "
        script += f"sys.argv[0] = {command!r}; runpy.run_module('speckle_mi.{command}', run_name='__main__')"
        start = ["-c", script]
    return subprocess.run(
        [sys.executable, *start, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=300
    )


def refused(done, *words):
    """The one line on stderr of a command that refuses its input."""
    assert done.returncode == BAD_INPUT, (done.returncode, done.stderr)
    lines = done.stderr.strip().splitlines()
    assert "Traceback" not in done.stderr
    assert len(lines) == 1, done.stderr
    for word in words:
        assert word in lines[0], lines[0]
    return lines[0]


# render


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Images at rest and moved, and the sources of the moved one."""
    folder = tmp_path_factory.mktemp("render")
    rest = run("render", SCENE, "-o", "rest.exr", *SMALL, cwd=folder)
    moved = run(
        "render", SCENE, "-o", "moved.exr", "--pose", "x=0.02,ry=0.01", "--sources", "moved.npz", *SMALL, cwd=folder
    )
    assert rest.returncode == moved.returncode == DONE, rest.stderr + moved.stderr
    return folder, moved


def test_render_writes_an_image_and_says_what_it_did(rendered):
    folder, done = rendered
    image = read_field(folder / "moved.exr")
    assert image.intensity.shape == (48, 64) and image.field is not None
    assert image.header["pose"] == "x=0.02,ry=0.01"
    assert "plan:" in done.stdout and "moved.exr" in done.stdout and not done.stderr
    assert sorted(path.name for path in folder.iterdir()) == ["moved.exr", "moved.npz", "rest.exr"]


def test_sources_of_render_add_up_to_its_field(rendered):
    folder, _ = rendered
    s, image = np.load(folder / "moved.npz"), read_field(folder / "moved.exr")
    assert {"position", "amplitude", "pixel_origin", "u", "v", "pitch", "wavelength"} == set(s.files)
    rows, columns = np.indices(image.intensity.shape)
    pixel = s["pixel_origin"] + s["pitch"] * (columns[..., None] * s["u"] + rows[..., None] * s["v"])
    r = np.linalg.norm(pixel[:, :, None] - s["position"], axis=-1)
    field = (s["amplitude"] * np.exp(2j * np.pi / s["wavelength"] * r) / r).sum(axis=-1)
    tolerance = 1e-4  # the scene's own
    assert np.linalg.norm(image.field - field) < tolerance * np.linalg.norm(field)


def test_render_quietly_prints_nothing(tmp_path):
    done = run("render", SCENE, "-o", "f.exr", "--quiet", *SMALL, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (DONE, "", "")


BAD_RENDERS = {
    "no such scene": (["none.xml", "-o", "f.exr"], ["none.xml"]),
    "a folder as scene": ([".", "-o", "f.exr"], []),
    "no such folder": ([SCENE, "-o", "nowhere/f.exr"], ["nowhere"]),
    "no such motion": ([SCENE, "-o", "f.exr", "--pose", "w=1"], ["w", "rx"]),
    "no number": ([SCENE, "-o", "f.exr", "--pose", "x=far"], ["far"]),
    "not finite": ([SCENE, "-o", "f.exr", "--pose", "x=nan"], ["x"]),
    "no such default": ([SCENE, "-o", "f.exr", "-D", "beam=1"], ["beam", "beam_radius"]),
    "no value": ([SCENE, "-o", "f.exr", "-D", "beam_radius"], ["beam_radius"]),
    "value out of range": ([SCENE, "-o", "f.exr", "-D", "beam_radius=-1"], ["beam_radius", "-1"]),
    "value of wrong type": ([SCENE, "-o", "f.exr", "-D", "width=wide"], ["wide", "line"]),
    "negative samples": ([SCENE, "-o", "f.exr", "--spp", "-1"], ["--spp", "-1"]),
    "no such variant": ([SCENE, "-o", "f.exr", "--variant", "llvm_ad_rgb"], ["llvm_ad_rgb", "llvm_ad_mono"]),
}


@pytest.mark.parametrize("fault", BAD_RENDERS)
def test_render_refuses_in_one_line(tmp_path, fault):
    arguments, words = BAD_RENDERS[fault]
    refused(run("render", *arguments, cwd=tmp_path), *words)
    assert list(tmp_path.iterdir()) == []


def test_render_refuses_a_file_that_is_not_a_scene_in_one_line(tmp_path):
    (tmp_path / "scene.xml").write_text('<scene version="3.0.0"><shape type="sphear"/></scene>')
    refused(run("render", "scene.xml", "-o", "f.exr", cwd=tmp_path), "sphear")
    (tmp_path / "scene.xml").write_text("<scene")
    refused(run("render", "scene.xml", "-o", "f.exr", cwd=tmp_path), "scene.xml")


@pytest.mark.parametrize("command", ["render", "sweep", "correlate"])
def test_wrong_flags_exit_with_status_2_and_no_traceback(tmp_path, command):
    done = run(command, "--no-such-flag", cwd=tmp_path)
    assert done.returncode == BAD_INPUT and "Traceback" not in done.stderr and done.stderr


@pytest.mark.parametrize("command", ["render", "sweep", "correlate", "sysinfo"])
def test_help_needs_no_renderer(tmp_path, command):
    done = run(command, "--help", cwd=tmp_path)
    assert done.returncode == DONE and f"python -m speckle_mi.{command}" in done.stdout


# correlate


def test_correlate_prints_the_shift_as_json_without_mitsuba(rendered):
    folder, _ = rendered
    done = run("correlate", "rest.exr", "moved.exr", cwd=folder, blocked=("mitsuba", "drjit"))
    assert done.returncode == DONE, done.stderr
    result = json.loads(done.stdout)
    assert {"shift_u_um", "shift_v_um", "ncc", "status"} <= set(result)
    # Theory: 0.946 mm/mm * 0.02 mm + 1.905 mm/deg * 0.01 deg = 38 um; the window is small.
    assert result["status"] == "ok" and result["shift_u_um"] == pytest.approx(38, abs=4)
    assert result["shift_v_um"] == pytest.approx(0, abs=4)


def test_correlate_of_an_image_with_itself_is_no_shift(rendered):
    folder, _ = rendered
    result = json.loads(run("correlate", "rest.exr", "rest.exr", "--window", "32", cwd=folder).stdout)
    assert (result["shift_u_px"], result["shift_v_px"], result["ncc"]) == (0, 0, 1)


def test_correlate_refuses_in_one_line(rendered):
    folder, _ = rendered
    refused(run("correlate", "rest.exr", "none.exr", cwd=folder), "none.exr")
    refused(run("correlate", "moved.npz", "rest.exr", cwd=folder), "moved.npz")
    refused(run("correlate", "rest.exr", "moved.exr", "--window", "1000", cwd=folder), "1000")


# sysinfo


def test_sysinfo_names_versions_llvm_variants_and_cores(tmp_path):
    done = run("sysinfo", cwd=tmp_path)
    assert done.returncode == DONE and not done.stderr
    for word in ("speckle_mi", "mitsuba", "drjit", "LLVM", "llvm_ad_mono", "cores"):
        assert word in done.stdout


# sweep


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A tiny sweep's folder and what it printed."""
    folder = tmp_path_factory.mktemp("sweep")
    done = run("sweep", SCENE, *SWEEP, "--out", "out", *SMALL, cwd=folder)
    assert done.returncode == DONE, done.stderr
    return folder / "out", done


def test_sweep_leaves_frames_tables_and_plots(swept):
    out, _ = swept
    frames = sorted((out / "frames").glob("*.exr"))
    assert len(frames) == 2 * (1 + 2 * 3)
    assert {"sweep.csv", "summary.json", "speckle.png", "decorrelation.png"} <= {path.name for path in out.iterdir()}
    plots = [path for path in out.glob("*.png")]
    assert len([path for path in plots if path.name.startswith("shift_")]) >= 4
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in plots)
    assert not list(out.glob(".*")) and not list((out / "frames").glob(".*"))
    header = read_field(frames[0]).header
    assert {
        "wavelength_nm",
        "pixel_pitch_mm",
        "pose",
        "seed",
        "scene_hash",
        "method",
        "tolerance",
        "phase_sign",
        "version",
    } <= set(header)


def test_sweep_table_has_a_row_a_frame(swept):
    out, _ = swept
    with open(out / "sweep.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[: len(COLUMNS)] == COLUMNS
    assert len(rows) == 14
    moved = [row for row in rows if row["dof"] in ("x", "ry")]
    assert len(moved) == 12 and {row["unit"] for row in moved if row["dof"] == "ry"} == {"deg"}
    assert sorted({float(row["displacement"]) for row in moved}) == pytest.approx([-0.01, 0, 0.01])
    assert {row["seed"] for row in rows} == {"0", "1"}
    at_rest = [row for row in moved if float(row["displacement"]) == 0]
    assert all(float(row["shift_u_um"]) == 0 and float(row["ncc"]) == 1 for row in at_rest)


def test_sweep_summary_says_what_was_found(swept):
    out, _ = swept
    summary = json.loads((out / "summary.json").read_text())
    np.testing.assert_allclose([summary["axes"]["u"], summary["axes"]["v"]], [[1, 0, 0], [0, -1, 0]], atol=1e-9)
    assert all(isinstance(line, str) for line in summary["plan"]) and summary["plan"]
    assert summary["seconds_per_frame"] > 0 and 0 <= summary["numerical_error"] < 1e-3
    assert set(summary["sensitivity"]) == {"x", "ry"}
    for dof, unit in (("x", "mm/mm"), ("ry", "mm/deg")):
        entries = summary["sensitivity"][dof]
        assert set(entries) == AXES
        for axis, entry in entries.items():
            assert ENTRY <= set(entry) and entry["unit"] == unit
            assert (entry["theory"] is None) == axis.startswith("cog"), axis
            low, high = entry["ci95"]
            assert low <= entry["value"] <= high
    along = summary["sensitivity"]["x"]["u"]
    assert along["theory"] == pytest.approx(0.9463, abs=1e-4) and along["value"] == pytest.approx(0.9463, rel=0.1)
    assert along["bias"] == pytest.approx(along["value"] - along["theory"])
    np.testing.assert_allclose(
        summary["sensitivity"]["x"]["y"]["value"], -summary["sensitivity"]["x"]["v"]["value"], atol=1e-12
    )


def test_sweep_table_agrees_with_correlating_its_frames(swept):
    out, _ = swept
    from speckle_mi.measurement.compare import compare

    with open(out / "sweep.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    row = next(r for r in rows if r["dof"] == "ry" and r["seed"] == "1" and float(r["displacement"]) > 0)
    images = [read_field(out / "frames" / name) for name in ("seed1_reference.exr", "seed1_ry_002.exr")]
    result = compare(images[0].intensity, images[1].intensity, 0.03)
    for name in ("shift_u_um", "shift_v_um", "ncc"):
        assert float(row[name]) == pytest.approx(result[name], rel=1e-6, abs=1e-6)


def test_sweep_prints_theory_and_the_three_errors(swept):
    _, done = swept
    for word in ("plan:", "theory", "scatter", "numerical error", "0.94"):
        assert word in done.stdout, word
    assert "paper" not in done.stdout, "its camera is not the paper's"
    assert "Traceback" not in done.stderr


def test_sweep_does_not_overwrite_other_settings_unless_forced(swept):
    out, _ = swept
    before = (out / "summary.json").read_text()
    other = ["--dof", "x", "--range", "0.02", "--steps", "2", "--seeds", "1", "--out", "out", "--quiet"]
    refused(run("sweep", SCENE, *other, *SMALL, cwd=out.parent), "out", "--force")
    assert (out / "summary.json").read_text() == before
    # The same settings may be repeated.
    again = run("sweep", SCENE, *SWEEP, "--out", "out", "--quiet", *SMALL, cwd=out.parent)
    assert (again.returncode, again.stdout) == (DONE, ""), again.stderr
    forced = run("sweep", SCENE, *other, "--force", *SMALL, cwd=out.parent)
    assert forced.returncode == DONE, forced.stderr
    assert len(list((out / "frames").glob("*.exr"))) == 3


BAD_SWEEPS = {
    "unknown motion": (["--dof", "x,w"], ["w"]),
    "motion twice": (["--dof", "x,x"], ["x,x"]),
    "no motion": (["--dof", ""], ["--dof"]),
    "no range": (["--range", "0"], ["--range"]),
    "range not finite": (["--range", "nan"], ["--range"]),
    "one step": (["--steps", "1"], ["--steps"]),
    "no surface": (["--seeds", "0"], ["--seeds"]),
    "tiny window": (["--window", "2"], ["--window"]),
    "window too large": (["--window", "5000"], ["5000"]),
}


@pytest.mark.parametrize("fault", BAD_SWEEPS)
def test_sweep_refuses_in_one_line(tmp_path, fault):
    arguments, words = BAD_SWEEPS[fault]
    refused(run("sweep", SCENE, *arguments, "--out", "out", "--quiet", *SMALL, cwd=tmp_path), *words)


def test_sweep_leaves_a_folder_with_other_files_alone(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "letter.txt").write_text("mine")
    refused(run("sweep", SCENE, *SWEEP, "--out", "out", "--quiet", *SMALL, cwd=tmp_path), "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["letter.txt"]


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_sweep_ends_soon_and_keeps_its_finished_frames(tmp_path, stop):
    arguments = ["--seeds", "500", "--out", "out", *SMALL]
    process = subprocess.Popen(
        [sys.executable, "-m", "speckle_mi.sweep", SCENE, *arguments], cwd=tmp_path,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )
    frames = tmp_path / "out" / "frames"
    try:
        deadline = time.monotonic() + 120
        while len(list(frames.glob("[!.]*.exr"))) < 5 and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(stop)
        _, errors = process.communicate(timeout=20)
    finally:
        if process.poll() is None:
            process.kill()
    assert process.returncode == INTERRUPTED, errors
    assert "Traceback" not in errors
    finished = list(frames.glob("*.exr"))
    assert len(finished) >= 5 and not list(frames.glob(".*"))
    for path in finished:
        assert read_field(path).intensity.shape == (48, 64)
    with open(tmp_path / "out" / "sweep.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert 4 <= len(rows) <= len(finished)


def test_commands_run_from_any_folder_with_nothing_set(tmp_path):
    """A fresh environment without PYTHONPATH or a chosen LLVM."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "DRJIT_LIBLLVM_PATH")}
    done = subprocess.run(
        [sys.executable, "-m", "speckle_mi.render", SCENE, "-o", "f.exr", "--quiet", *SMALL],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120,
    )
    assert done.returncode == DONE, done.stderr


# Whose fault it is

ENDS_WITH = """
import sys
from speckle_mi.command_line import command
from speckle_mi.errors import InputError
from speckle_mi.scene.errors import SceneError
def main(arguments):
    raise {error}
sys.exit(command(main, {arguments}))
"""


@pytest.mark.parametrize(
    "error",
    ["ValueError('axes of shape (2,)')", "TypeError('no')", "RuntimeError('kernel')", "AssertionError()"],
)
def test_a_fault_of_the_program_is_not_called_the_users_input(error):
    done = subprocess.run(
        [sys.executable, "-c", ENDS_WITH.format(error=error, arguments=[])], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == FAULT
    assert done.stderr.startswith(f"internal error: {error.partition('(')[0]}") and done.stderr.count("\n") == 1
    assert "report" in done.stderr and "--debug" in done.stderr
    script = ENDS_WITH.format(error=error, arguments=["--debug"])
    shown = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60).stderr
    assert "Traceback" in shown and shown.endswith(done.stderr)


@pytest.mark.parametrize("error", ["InputError('window = 3')", "SceneError('no laser')", "OSError(28, 'No space left')"])
def test_what_the_user_can_put_right_is_bad_input(error):
    script = ENDS_WITH.format(error=error, arguments=[])
    refused(subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60))
