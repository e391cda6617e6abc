"""What a killed process leaves half-written goes with the next run; what is being written stays."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile

import pytest
from conftest import SCENES
from test_commands import SMALL, run

from speckle_mi.machine.files import replacing, require_folder, require_output
from speckle_mi.machine.fragments import fragment_name, remove_abandoned
from speckle_mi.machine.interrupt import scratch_folder

SCENE = str(SCENES / "tilted_laser.xml")

WRITES = """
import sys, time
from speckle_mi.machine.files import replacing
from speckle_mi.machine.interrupt import scratch_folder
with scratch_folder() as scratch, replacing(sys.argv[1]) as path:
    path.write_text("half")
    (scratch / "points.csv").write_text("0,0,0")
    print(scratch, flush=True)
    time.sleep(60)
"""

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL here")


@pytest.fixture
def writer(tmp_path, monkeypatch):
    """A process in the middle of writing ``tmp_path/f.exr``, and its scratch folder; killed by the test or at its end."""
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    (tmp_path / "scratch").mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", WRITES, str(tmp_path / "f.exr")], stdout=subprocess.PIPE, text=True
    )
    yield process, process.stdout.readline().strip()
    process.kill()
    process.wait()


def fragments(folder) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_what_is_being_written_stays(writer, tmp_path):
    _, scratch = writer
    require_output(tmp_path / "f.exr")
    require_folder(tmp_path)
    with replacing(tmp_path / "f.exr") as path, scratch_folder():
        path.write_text("of another writer")
        remove_abandoned(tmp_path)
        assert len(fragments(tmp_path)) == 2 and os.path.isdir(scratch)
    assert len(fragments(tmp_path)) == 1


@pytest.mark.parametrize("is_waited_for", [True, False])
def test_the_next_run_removes_what_a_killed_one_left(writer, tmp_path, is_waited_for):
    process, scratch = writer
    process.send_signal(signal.SIGKILL)
    if is_waited_for:
        process.wait()
    else:  # it is no more, but its parent has not asked yet
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    assert len(fragments(tmp_path)) == 1 and os.path.isdir(scratch)
    require_output(tmp_path / "f.exr")
    assert fragments(tmp_path) == []
    with scratch_folder():
        assert not os.path.exists(scratch)


def test_a_command_removes_them_and_nothing_else(writer, tmp_path):
    process, _ = writer
    process.kill()
    process.wait()
    (left,) = fragments(tmp_path)
    place, number, began = left.split("-")[2:5]
    others = [
        left.replace(place, "0" * 8),  # of another machine
        left.replace(f"-{number}-{began}-", f"-{os.getpid()}-{began}-").replace(began, _began_of_this_process()),
        ".speckle_mi",
        ".f-0123abcd.exr",
        left.removeprefix("."),
    ]
    for name in others:
        (tmp_path / name).touch()
    done = run("render", SCENE, "-o", "f.exr", "--quiet", *SMALL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*others, "f.exr", "scratch"])


def test_a_number_that_another_process_has_by_now_does_not_keep_a_fragment(tmp_path):
    began = _began_of_this_process()
    if began == "0":
        pytest.skip("the system does not tell when a process began")
    (tmp_path / fragment_name("f", ".exr")).touch()
    earlier = fragment_name("f", ".exr").replace(f"-{began}-", f"-{int(began) - 1}-")
    (tmp_path / earlier).touch()
    remove_abandoned(tmp_path)
    assert len(fragments(tmp_path)) == 1 and not (tmp_path / earlier).exists()


def test_a_sweep_removes_them_among_its_frames(writer, tmp_path):
    process, _ = writer
    process.kill()
    process.wait()
    (left,) = fragments(tmp_path)
    sweep = ["--dof", "x", "--range", "0.02", "--steps", "2", "--seeds", "1", "--out", "out", "--quiet", *SMALL]
    assert run("sweep", SCENE, *sweep, cwd=tmp_path).returncode == 0
    (tmp_path / left).rename(tmp_path / "out" / "frames" / left)
    assert run("sweep", SCENE, *sweep, cwd=tmp_path).returncode == 0
    assert fragments(tmp_path / "out" / "frames") == []


def _began_of_this_process() -> str:
    return fragment_name("f").split("-")[4]
