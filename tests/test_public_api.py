"""What a program or a notebook sees: public names, the list of commands, example scenes."""

from __future__ import annotations

import inspect
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from conftest import SCENES
from test_commands import BAD_INPUT, DONE, refused, run

import speckle_mi

NAMES = {"load_scene", "Assembly", "Pose", "Simulation", "FieldImage", "read_image", "Correlator", "fit_sensitivity",
         "propagate_tolerances", "compare_scenes", "optimise_scene",
         "expected_sensitivity", "one_frame_sensitivity", "theory", "Simulations", "load_detectors"}  # fmt: skip


def test_the_public_names_are_these_and_each_is_documented():
    assert set(speckle_mi.__all__) == NAMES <= set(dir(speckle_mi))
    for name in NAMES:
        public = getattr(speckle_mi, name)
        assert inspect.getdoc(public), name
        assert inspect.ismodule(public) == (name == "theory"), name
    with pytest.raises(AttributeError, match="Simulation"):
        _ = speckle_mi.simulation_of


def test_nothing_is_imported_before_it_is_used(tmp_path):
    script = (
        "import sys, speckle_mi\n"
        "heavy = {'numpy', 'scipy', 'mitsuba', 'drjit', 'matplotlib', 'OpenEXR', 'rich', 'finufft'}\n"
        "assert not heavy & set(sys.modules)\n"
        "speckle_mi.Correlator, speckle_mi.Pose, speckle_mi.theory, speckle_mi.fit_sensitivity\n"
        "assert not {'mitsuba', 'drjit', 'matplotlib'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_a_few_lines_load_render_and_correlate(mitsuba):
    """The pattern of a tilted laser moves with the target: by the paper's 0.946 mm a mm along x, to a few percent."""
    level = mitsuba.log_level()
    small = {"width": 96, "height": 96, "pixel_pitch": 0.012, "point_sources": 300}
    assembly = speckle_mi.load_scene(SCENES / "tilted_laser.xml", **small)
    assert isinstance(assembly, speckle_mi.Assembly) and mitsuba.log_level() == level
    simulation = speckle_mi.Simulation(assembly)
    rest, moved = (simulation.frame(speckle_mi.Pose(x=x)).image for x in (0.0, 0.01))
    assert isinstance(rest, speckle_mi.FieldImage) and rest.intensity.shape == (96, 96)
    shift = speckle_mi.Correlator(rest.intensity).shift(moved.intensity)
    expected = speckle_mi.expected_sensitivity(assembly)["u"][0] * 0.01 / assembly.detector.pitch
    scatter_of_one_surface = 0.3  # px
    assert abs(expected) > 0.5 and shift.u_px == pytest.approx(expected, abs=scatter_of_one_surface)


def test_what_is_wrong_with_a_scene_is_an_error_that_says_so(mitsuba, tmp_path):
    from speckle_mi.errors import InputError
    from speckle_mi.scene.errors import SceneError

    with pytest.raises(InputError, match="point_source.*no such <default>.*point_sources"):
        speckle_mi.load_scene(SCENES / "tilted_laser.xml", point_source=3)
    with pytest.raises(FileNotFoundError, match="none.xml"):
        speckle_mi.load_scene(tmp_path / "none.xml")
    with pytest.raises(InputError, match="llvm_ad_mono"):
        speckle_mi.load_scene(SCENES / "tilted_laser.xml", variant="scalar_rgb")
    (tmp_path / "bad.xml").write_text('<scene version="3.0.0"><shape type="rough_target"><float name="width" value="-1"/>')
    with pytest.raises(SceneError):
        speckle_mi.load_scene(tmp_path / "bad.xml")


# Commands


def module(*arguments, cwd) -> subprocess.CompletedProcess:
    start = [sys.executable, "-m", "speckle_mi", *arguments]
    return subprocess.run(start, cwd=cwd, capture_output=True, text=True, timeout=120)


def test_the_package_lists_its_commands_and_runs_them(tmp_path):
    from test_architecture import COMMANDS

    listed = module(cwd=tmp_path)
    assert listed.returncode == DONE
    for name in COMMANDS - {"__main__"}:
        (line,) = [line for line in listed.stdout.splitlines() if line.split()[:1] == [name]]
        assert len(line.split()) > 3, "and says what it does"
    assert module("--help", cwd=tmp_path).stdout == listed.stdout
    help_of_one = module("render", "--help", cwd=tmp_path)
    assert help_of_one.stdout == run("render", "--help", cwd=tmp_path).stdout != ""
    assert module("render", "none.xml", "-o", "f.exr", cwd=tmp_path).returncode == BAD_INPUT
    refused(module("rnder", cwd=tmp_path), "'rnder'", "render")


def test_the_example_scenes_are_found_and_listed(tmp_path):
    listed = run("scenes", cwd=tmp_path)
    folder, *lines = listed.stdout.splitlines()
    names = sorted(path.stem for path in Path(folder).glob("*.xml"))
    parts = sorted(f"parts/{path.stem}" for path in Path(folder).glob("parts/*.xml"))
    assert names == sorted(path.stem for path in SCENES.glob("*.xml")) and parts
    assert [line.split()[0] for line in lines] == names + parts
    assert all(len(line.split()) > 4 for line in lines)


def test_an_example_scene_is_copied_and_never_over_another_file(tmp_path):
    for arguments, place in ((["imaging"], "imaging.xml"), (["folded.xml", "--to", "new/er"], "new/er/folded.xml")):
        done = run("scenes", *arguments, cwd=tmp_path)
        assert done.returncode == DONE and done.stdout.strip() == place
        assert (tmp_path / place).read_bytes() == (SCENES / Path(place).name).read_bytes()
    (tmp_path / "imaging.xml").write_text("mine")
    refused(run("scenes", "imaging", cwd=tmp_path), "imaging.xml", "--force")
    assert (tmp_path / "imaging.xml").read_text() == "mine"
    assert run("scenes", "imaging", "--force", cwd=tmp_path).returncode == DONE
    refused(run("scenes", "imagin", cwd=tmp_path), "'imagin'", "imaging")
    refused(run("scenes", "--to", "new", cwd=tmp_path), "--to", "NAME")


# Notebooks


LONG = {
    "render": "begun.write_text('yes')\nmi.render(scene, spp=10_000)\nend.write_text('yes')",
    "frame": "begun.write_text('yes')\nfor seed in range(10_000):\n    simulation.frame(seed=seed)\nend.write_text('yes')",
}


@pytest.mark.parametrize("long", LONG)
def test_a_notebook_loads_renders_is_interrupted_and_renders_again(tmp_path, long):
    """Interrupting a kernel raises KeyboardInterrupt in the cell that runs, and the next one works.

    Mitsuba makes a RuntimeError, with it as the cause, of any error in an integrator that is written in Python.
    """
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    from jupyter_client.manager import KernelManager

    cells = [
        "import mitsuba as mi, numpy as np, pathlib, speckle_mi\n"
        "mi.set_variant('llvm_ad_mono')\n"
        f"scene = mi.load_file({str(SCENES / 'tilted_laser.xml')!r}, width=64, height=48, point_sources=200)\n"
        "begun, end = pathlib.Path('begun'), pathlib.Path('end')",
        "before = np.array(mi.render(scene))\n"
        f"simulation = speckle_mi.Simulation(speckle_mi.load_scene({str(SCENES / 'tilted_laser.xml')!r}, width=64))",
        LONG[long],
        "assert np.array_equal(before, np.array(mi.render(scene))), 'another image than before'\n"
        "print('light' if before.max() > 0 else 'dark', end.exists())",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    kernel = KernelManager(kernel_name="python3")
    client = nbclient.NotebookClient(
        notebook, km=kernel, timeout=90, allow_errors=True, resources={"metadata": {"path": str(tmp_path)}}
    )
    interrupts = threading.Thread(target=_interrupt_after, args=(tmp_path / "begun", kernel.interrupt_kernel))
    interrupts.start()
    client.execute()
    interrupts.join()
    loads, renders, interrupted, again = (cell.outputs for cell in notebook.cells)
    assert [output for output in loads + renders if output.output_type == "error"] == []
    (error,) = (output for output in interrupted if output.output_type == "error")
    assert error.ename == {"render": "RuntimeError", "frame": "KeyboardInterrupt"}[long]
    assert "KeyboardInterrupt" in "".join(error.traceback)
    assert "".join(output.get("text", output.get("evalue", "")) for output in again).strip() == "light False"


def _interrupt_after(begun: Path, interrupt, deadline: float = 60.0, into_it: float = 1.0) -> None:
    """Interrupts a little after a file is there, in the middle of what it announces [s]."""
    end = time.monotonic() + deadline
    while not begun.exists() and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(into_it)
    interrupt()
