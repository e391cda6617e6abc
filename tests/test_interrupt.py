"""Ctrl-C and SIGTERM at any moment: one line, status 130, nothing half-written, what is finished kept and resumed."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import SCENES
from test_commands import SMALL, run

from speckle_mi.images.exr import read_field
from speckle_mi.machine.interrupt import INTERRUPTED

SCENE = str(SCENES / "tilted_laser.xml")
SWEEP = ["--dof", "x,ry", "--range", "0.02", "--steps", "3", "--seeds", "2", "--out", "out", "--quiet", *SMALL]

INTERRUPTS_ITSELF = """
import os, signal, sys
import speckle_mi.command_line, speckle_mi.machine.files
from speckle_mi.machine.interrupt import keeping, scratch_folder
def main(arguments):
    with keeping(lambda: open("kept", "w").close()), scratch_folder() as folder:
        with speckle_mi.machine.files.replacing("result.txt") as path:
            path.write_text("half")
            assert len(os.listdir()) == 1 and folder.is_dir()
            print(folder, flush=True)
            os.kill(os.getpid(), signal.{stop})
            {waits}
sys.exit(speckle_mi.command_line.command(main, []))
"""
WAITS = {
    "in Python": "while True: pass",
    "outside Python": "import time; time.sleep(60)",
    "in code that swallows exceptions": """
            while True:
                try: pass
                except BaseException: pass""",
}


@pytest.mark.parametrize("stop", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("waits", WAITS)
def test_an_interrupted_command_keeps_what_it_can_and_leaves_no_fragment(tmp_path, stop, waits):
    script = INTERRUPTS_ITSELF.format(stop=stop, waits=WAITS[waits])
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == INTERRUPTED, done.stderr
    assert done.stderr == "interrupted: what is finished has been kept\n"
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
    assert not Path(done.stdout.strip()).exists()


HEAVY = ("numpy", "mitsuba", "drjit", "OpenEXR", "matplotlib", "rich", "finufft")
"""What takes long to import."""


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", ["render", "sweep", "converge", "correlate", "stability", "benchmark", "sysinfo"])
def test_a_command_that_is_still_importing_ends_in_one_line(name, tmp_path, stop):
    """The signal comes with the first import of what takes long: by then, every command answers it."""
    arguments = {"render": ["none.xml", "-o", "f.exr", "--pose", "x=1"], "sweep": ["none.xml"],
                 "converge": ["none.xml", "--out", "o"], "correlate": ["a.exr", "b.exr"]}.get(name, [])  # fmt: skip
    script = (
        "import os, runpy, sys\n"
        "class Stops:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name in {HEAVY}: os.kill(os.getpid(), {int(stop)})\n"
        "sys.meta_path.insert(0, Stops())\n"
        f"sys.argv[1:] = {arguments}\n"
        f"runpy.run_module('speckle_mi.{name}', run_name='__main__')\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == INTERRUPTED, done.stderr
    assert done.stderr.count("\n") == 1 and "interrupted" in done.stderr


def test_a_host_that_calls_a_command_gets_its_signals_back():
    script = """
import signal, threading
from speckle_mi.command_line import command
def host(*_): pass
signal.signal(signal.SIGINT, host)
inside = []
def main(arguments):
    inside.append(signal.getsignal(signal.SIGINT) is not host)
assert command(main, []) == 0 and inside == [True]
other = threading.Thread(target=command, args=(main, []))
other.start(); other.join()
print(signal.getsignal(signal.SIGINT) is host, signal.getsignal(signal.SIGTERM) is signal.SIG_DFL, inside[1])
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "True True False", done.stderr


def test_an_interrupted_sweep_goes_on_from_its_finished_frames(tmp_path):
    whole = run("sweep", SCENE, *SWEEP, cwd=tmp_path)
    assert whole.returncode == 0, whole.stderr
    out = tmp_path / "out"
    frames = sorted((out / "frames").glob("*.exr"))
    before = {path.name: path.read_bytes() for path in frames}
    summary, rows = json.loads((out / "summary.json").read_text()), rows_but_for_time(out)
    # As an interrupt leaves it: some frames, no summary; one of the frames is of another surface, one damaged.
    (out / "summary.json").unlink()
    kept, foreign, damaged = frames[0], frames[1], frames[2]
    age = time.time() - 1000
    for path in frames[3:]:
        path.unlink()
    foreign.write_bytes(before[frames[-1].name])
    damaged.write_bytes(before[damaged.name][:-20])
    os.utime(kept, (age, age))
    again = run("sweep", SCENE, *SWEEP, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert kept.stat().st_mtime == pytest.approx(age, abs=1)
    # The fields are the same whether taken over or computed again; only what was measured of the run differs.
    for path in sorted((out / "frames").glob("*.exr")):
        assert (read_field(path).intensity == _image(before[path.name], tmp_path).intensity).all(), path.name
    found = json.loads((out / "summary.json").read_text())
    assert found["sensitivity"] == summary["sensitivity"] and found["frames"] == summary["frames"]
    assert rows_but_for_time(out) == rows


def _image(content: bytes, folder):
    path = folder / "before.exr"
    path.write_bytes(content)
    return read_field(path)


def rows_but_for_time(out) -> list[dict]:
    with open(out / "sweep.csv", newline="", encoding="utf-8") as file:
        return [{name: value for name, value in row.items() if name != "seconds"} for row in csv.DictReader(file)]


def test_an_interrupt_while_a_loop_is_recorded_is_still_one(mitsuba):
    import drjit as dr

    from speckle_mi.machine.backend import arrays
    from speckle_mi.machine.interrupt import raised_as_such

    number = arrays().UInt32

    def interrupted(_):
        raise KeyboardInterrupt

    @raised_as_such()
    def frame():
        dr.while_loop((number(0),), lambda i: i < number(10), interrupted)

    with pytest.raises(KeyboardInterrupt):
        frame()
    with pytest.raises(RuntimeError, match="^other$"), raised_as_such():
        raise RuntimeError("other")
