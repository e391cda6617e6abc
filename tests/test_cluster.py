"""The same results to the last bit whoever does the jobs: one thread, several, processes of which one is killed, parts."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from conftest import SCENES
from kill_and_resume import killed_and_resumed
from test_commands import SMALL, run

from speckle_mi.errors import InputError
from speckle_mi.experiments.execution import Shard, executor_of
from speckle_mi.experiments.frame_measurement import FrameMeasurement, FrameTask, SweptScene
from speckle_mi.experiments.jobs import InProcess, Job, Work
from speckle_mi.experiments.sweep import run_sweeps
from speckle_mi.experiments.sweep_result import SweepResult, SweepSettings
from speckle_mi.geometry.pose import Pose
from speckle_mi.machine.journal import Journal

SETTINGS = SweepSettings(("x", "ry"), np.array([-0.01, -0.005, 0.005, 0.01]), (0, 1, 2), 24)
SCENE = str(SCENES / "tilted_laser.xml")

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL here")


@pytest.fixture(scope="module")
def assembly(shipped):
    return shipped("tilted_laser", width=64, height=48, beam_radius=0.3, point_sources=50)


def swept(assembly, folder: Path, executor=None, **named) -> SweepResult:
    result = SweepResult()
    with Journal(folder / "jobs", named.pop("journal", "jobs")) as done:
        run_sweeps({"": assembly}, SETTINGS, folder, {"": result}, True, executor, done, "first", **named)
    return result


def rows(result: SweepResult) -> list[tuple]:
    return [tuple(v for k, v in vars(record).items() if k != "seconds") for record in result.records]


@pytest.fixture(scope="module")
def alone(assembly, tmp_path_factory):
    """What one thread of one process finds."""
    return swept(assembly, tmp_path_factory.mktemp("alone"), InProcess())


def same(one: SweepResult, other: SweepResult) -> bool:
    slides = zip(
        *([slide for dof in SETTINGS.dofs for slide in result.slides.motions[dof]] for result in (one, other)),
        strict=True,
    )
    return (
        rows(one) == rows(other)
        and np.array_equal(one.example, other.example)
        and one.numerical_error == other.numerical_error
        and all(np.array_equal(a.phase, b.phase) and np.array_equal(a.light, b.light) for a, b in slides)
    )


@pytest.mark.parametrize("threads", [2, 3])
def test_several_threads_find_what_one_does(assembly, alone, tmp_path, threads):
    assert same(swept(assembly, tmp_path, InProcess(threads)), alone)


def test_workers_find_what_one_process_does_though_one_is_killed(assembly, alone, tmp_path):
    pytest.importorskip("distributed")
    with executor_of("local:2") as cluster:
        killed = []

        class Kills:
            """Hands jobs on, and kills a worker once some are done."""

            def results(self, jobs):
                for number, found in enumerate(cluster.results(jobs)):
                    if number == 5:
                        workers = cluster.workers()
                        killed.append(next(iter(workers)))
                        os.kill(workers[killed[0]], signal.SIGKILL)
                    yield found

        assert same(swept(assembly, tmp_path / "killed", Kills()), alone) and killed
        assert same(swept(assembly, tmp_path / "again", cluster), alone)
        too_wide = Work(FrameMeasurement, SweptScene.of({"": assembly}, 5000))
        with pytest.raises(InputError, match="window = 5000: must be 4 to 64 px"):
            list(cluster.results([Job(too_wide, FrameTask(Pose(), 0))]))


def test_parts_of_a_sweep_make_the_whole(assembly, alone, tmp_path):
    left = []
    for number in (2, 3, 1):
        result, shard = SweepResult(), Shard(number, 3)
        with Journal(tmp_path / "jobs", shard.journal) as done:
            named = {"done": done, "keep": "first", "shard": shard}
            left.append(run_sweeps({"": assembly}, SETTINGS, tmp_path, {"": result}, True, **named))
    assert left == [18, 9, 0] and same(result, alone)
    assert len(list(tmp_path.glob("*.exr"))) == 9


@pytest.mark.parametrize("total, count", [(488, 7), (5, 8), (1, 1)])
def test_each_job_is_one_parts(total, count):
    parts = [Shard(number, count) for number in range(1, count + 1)]
    takers = [[part.number for part in parts if part.takes(place, total)] for place in range(total)]
    assert all(len(taken) == 1 for taken in takers) and takers == sorted(takers)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--scheduler", "nobody"], ["nobody", "local:N", "tcp://"]),
        (["--scheduler", "local:0"], ["local:0", "local:1"]),
        (["--scheduler", "tcp://127.0.0.1:1"], ["127.0.0.1:1", "no scheduler"]),
        (["--shard", "3/2"], ["3/2", "2/8"]),
        (["--shard", "1/2", "--precision", "1%"], ["--precision", "--shard"]),
        (["--shard", "1/2", "--force"], ["--force", "--shard"]),
        (["--precision", "1"], ["--precision", "1%"]),
        (["--precision", "1%", "--seeds", "1"], ["--seeds", "2"]),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_is(tmp_path, arguments, words):
    done = run("sweep", SCENE, *arguments, "--out", "out", "--quiet", *SMALL, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert all(word in done.stderr for word in words) and not (tmp_path / "out" / "settings.json").exists()


def test_a_sweep_that_is_killed_at_any_instant_goes_on_to_the_same_rows(tmp_path):
    assert killed_and_resumed(tmp_path, 2) == []
