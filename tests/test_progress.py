"""How far a long computation has come: shown where a command listens, and nowhere else."""

from __future__ import annotations

import time

import pytest

from speckle_mi.machine import progress


@pytest.fixture
def at_once(monkeypatch):
    monkeypatch.setattr(progress, "SHOWN_AFTER", -1.0)


def test_nothing_happens_where_nobody_listens(capfd):
    progress.tell("rows", 1, 2)
    assert capfd.readouterr() == ("", "")


def test_a_loop_has_a_bar_from_its_start_to_its_end(at_once):
    with progress.progress_bars(quiet=True) as bars:
        progress.tell("rows", 1, 3)
        progress.tell("layers", 5, 6)
        shown = {(task.description, task.completed, task.total) for task in bars.tasks}
        assert shown == {("rows", 1, 3), ("layers", 5, 6)}
        progress.tell("rows", 2, 3)
        progress.tell("layers", 6, 6)
        assert [(task.description, task.completed) for task in bars.tasks] == [("rows", 2)]
        progress.tell("rows", 3, 3)
        assert bars.tasks == []


def test_a_short_loop_has_none():
    with progress.progress_bars(quiet=True) as bars:
        progress.tell("rows", 1, 2)
        assert bars.tasks == []


@pytest.mark.parametrize("quiet", [True, False])
@pytest.mark.parametrize("terminal", [True, False])
def test_bars_or_lines_are_shown_on_stderr_unless_quiet(at_once, monkeypatch, capfd, quiet, terminal):
    monkeypatch.setenv("TTY_COMPATIBLE", str(int(terminal)))
    monkeypatch.setattr(progress, "SECONDS_A_LINE", 0.05)
    with progress.progress_bars(quiet):
        progress.tell("pairs", 1, 2)
        time.sleep(0.5)
    out, err = capfd.readouterr()
    assert out == "" and ("pairs" in err) is not quiet
    assert ("pairs 1 of 2" in err) is (not quiet and not terminal)


def test_a_short_run_whose_output_is_kept_says_nothing(capfd):
    with progress.progress_bars(quiet=False):
        progress.tell("pairs", 1, 2)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("method, loop", [("rays", "sources"), ("direct", "pairs")])
def test_the_loops_of_a_frame_tell_how_far_they_are(mitsuba, monkeypatch, method, loop):
    from bad_scenes import ABOVE, scene_with
    from scene_builder import integrator_xml, laser_xml

    from speckle_mi.scene.read import assembly_from_scene
    from speckle_mi.field.simulation import simulate_frame

    told = []
    monkeypatch.setattr(progress._Bars, "tell", lambda self, *what: told.append(what))
    text = scene_with(lens="", aperture="", laser=laser_xml(ABOVE), integrator=integrator_xml(method=method))
    with progress.progress_bars(quiet=True):
        simulate_frame(assembly_from_scene(mitsuba.load_string(text)).with_options(rays_per_source=16))
    steps = [(done, total) for what, done, total in told if what == loop]
    assert steps and steps[-1][0] == steps[-1][1]
