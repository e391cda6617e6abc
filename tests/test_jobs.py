"""A study's results do not depend on who does its jobs, nor on how often it was killed on the way."""

from __future__ import annotations

import signal
import subprocess
import sys

import numpy as np
import pytest

from speckle_mi.errors import InputError
from speckle_mi.experiments.jobs import InProcess, Job, Work, run
from speckle_mi.machine.journal import Journal

PHASES = 2 * np.pi * np.array([0.1, 0.37, 0.9])


class FieldOfThreeWaves:
    """The jobs of these tests: the field of three waves at a place, as plain data."""

    prepared = 0

    def __init__(self, phases: np.ndarray) -> None:
        self.phases = phases
        FieldOfThreeWaves.prepared += 1

    def __call__(self, place: float) -> dict:
        waves = np.exp(1j * self.phases * place)
        return {"field": waves, "intensity": float(np.abs(waves.sum()) ** 2), "dark": place == 0.5, "phase": np.nan}


def study(places=np.linspace(0, 1, 9)) -> list[Job]:
    work = Work(FieldOfThreeWaves, PHASES)
    return [Job(work, float(place)) for place in places]


def same(one: dict, other: dict) -> bool:
    return one["intensity"] == other["intensity"] and np.array_equal(one["field"], other["field"])


def test_a_job_is_known_by_its_content():
    here, other = study(), study()
    assert [job.key for job in here] == [job.key for job in other] and len({job.key for job in here}) == 9
    assert Job(Work(FieldOfThreeWaves, PHASES * (1 + 1e-16 * np.array([0, 0, 4]))), 0.0).key != here[0].key
    assert Job(Work(dict, PHASES), 0.0).key != here[0].key


def test_this_process_does_jobs_in_order_and_prepares_a_work_once():
    before = FieldOfThreeWaves.prepared
    found = list(run(study(), InProcess()))
    assert [job.item for job, _ in found] == [job.item for job in study()] and FieldOfThreeWaves.prepared == before + 1


def test_results_in_a_journal_are_those_that_were_computed_to_the_last_bit(tmp_path):
    plain = dict((job.key, result) for job, result in run(study()))
    with Journal(tmp_path / "jobs") as done:
        first = list(run(study(), done=done))
    assert all(same(result, plain[job.key]) and np.isnan(result["phase"]) for job, result in first)
    read = Journal(tmp_path / "jobs")
    assert all(same(read[key], plain[key]) and read[key]["field"].dtype == complex for key in plain)


def test_what_a_journal_holds_is_not_done_again(tmp_path):
    with Journal(tmp_path) as done:
        list(run(study()[2:5], done=done))
    before = FieldOfThreeWaves.prepared
    with Journal(tmp_path) as done:
        assert len(list(run(study()[2:5], done=done))) == 3 and FieldOfThreeWaves.prepared == before
        assert {job.key for job, _ in run(study(), done=done)} == {job.key for job in study()}
        assert len(done) == 9


def test_where_the_first_job_is_refused_no_folder_is_left(tmp_path):
    with pytest.raises(InputError), Journal(tmp_path / "results" / "jobs"):
        raise InputError("no such number")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("cut", [1, 7, 40])
def test_a_line_that_a_kill_left_half_written_is_cut_off_and_its_job_done_again(tmp_path, cut):
    with Journal(tmp_path) as done:
        list(run(study(), done=done))
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    with Journal(tmp_path) as done:
        assert len(done) == 8 and path.read_bytes().endswith(b"\n")
        list(run(study(), done=done))
    assert path.read_bytes() == whole


def test_a_damaged_line_costs_its_job_alone(tmp_path):
    with Journal(tmp_path) as done:
        list(run(study(), done=done))
    (path,) = tmp_path.iterdir()
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:3], b"\xff\xfe{}\n", *lines[4:]]))
    assert len(Journal(tmp_path)) == 8


ADDS = """
import sys, time
from speckle_mi.machine.journal import Journal
with Journal(sys.argv[1], sys.argv[2]) as done:
    done.add(sys.argv[2], 1.0)
    print("added", flush=True)
    time.sleep(60)
"""


def test_a_journal_belongs_to_one_living_process_and_others_add_beside_it(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", ADDS, str(tmp_path), "a"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "added\n"
        with pytest.raises(InputError, match="another run is adding"), Journal(tmp_path, "a"):
            pass
        with Journal(tmp_path, "b") as done:
            done.add("b", 2.0)
            assert done["a"] == 1.0
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    with Journal(tmp_path, "a") as done:
        assert len(done) == 2


def test_only_plain_data_is_a_result(tmp_path):
    with Journal(tmp_path) as done, pytest.raises(TypeError, match="set.*plain data"):
        done.add("key", {1, 2})
    assert len(Journal(tmp_path)) == 0
    with pytest.raises(ValueError, match="open"):
        Journal(tmp_path).add("key", 1.0)
