"""Best designs: the angle without cross-talk, theory's trade-offs, limits, and trials that are kept."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from conftest import SCENES
from test_commands import DONE, refused, run

LASER, BOTH = (str(SCENES / f"{name}.xml") for name in ("tilted_laser", "both_tilted"))
SMALL = {"width": 32, "height": 24, "pixel_pitch": 0.1}


@pytest.fixture(scope="module")
def optimise(mitsuba):
    from speckle_mi.studies.optimisation import optimise_scene

    return lambda scene, free, goal, trials: optimise_scene(scene, free, goal, trials, **SMALL)


def test_the_angle_without_cross_talk_of_the_tilted_laser_is_the_normal(optimise):
    found = optimise(LASER, "laser_angle=-20:40", {"minimise": ["z.x"]}, 50)
    (best,) = found.front
    assert best.values["laser_angle"] == pytest.approx(0, abs=1e-3)
    # Frames of other surfaces agree: their interval holds zero.
    assert found.measured[0]["z.x"].interval[0] == 0


def test_a_tilted_detector_takes_the_cross_talk_of_a_tilted_laser_off(optimise):
    # z moves the pattern along x by sin 2a/(2 L_O) of the detector's angle less sin 2a/(2 |L_S|) of the laser's.
    (best,) = optimise(BOTH, "detector_angle=-10:20", {"minimise": "z.x"}, 50).front
    wanted = -math.degrees(0.5 * math.asin(60 / 750 * math.sin(math.radians(35))))
    assert best.values["detector_angle"] == pytest.approx(wanted, abs=2e-3)


def test_trade_offs_are_those_of_theory(optimise):
    goal = {"minimise": ["crosstalk.z"], "maximise": ["rz.y"], "extent.z": {"at_most": 80}}
    found = optimise(LASER, "laser_angle=5:60,detector_distance=40:90", goal, 160)
    # A closer detector at the largest angle, or the closest one at smaller angles, beats all between.
    angle, distance = np.radians(np.linspace(5, 60, 400))[:, None], np.linspace(40, 80, 200)
    crosstalk = distance / 750 * np.sin(angle) * np.cos(angle) / (1 - distance / 750)
    rotation = distance * np.sin(angle) * np.pi / 180
    assert len(found.front) > 15
    for trial in found.front:
        cost, gain = (trial.figures[name].best for name in ("crosstalk.z", "rz.y"))
        best = rotation[crosstalk <= cost].max()
        assert gain <= best * 1.01
        assert trial.values["detector_distance"] <= 80
    ratios = [one.figures["rz.y"].best / rotation[crosstalk <= one.figures["crosstalk.z"].best * 1.0001].max()
              for one in found.front]  # fmt: skip
    assert np.median(ratios) > 0.96
    assert found.front[0].values["laser_angle"] == pytest.approx(5, abs=0.5)
    assert found.front[-1].figures["rz.y"].best == pytest.approx(rotation.max(), rel=0.02)


def test_the_best_within_limits_is_found_in_whatever_corner_it_lies(optimise):
    goal = {"maximise": ["ry.u"], "clearance": {"at_least": 40}, "crosstalk.z": {"at_most": 0.04}}
    (best,) = optimise(LASER, "laser_angle=5:60,detector_distance=40:90", goal, 80).front
    assert best.values == pytest.approx({"laser_angle": 5, "detector_distance": 90}, rel=1e-3)
    assert best.figures["ry.u"].best == pytest.approx(90 * (1 + math.cos(math.radians(5))) * math.pi / 180, rel=1e-3)


def test_limits_that_nothing_keeps_to_are_told_with_the_closest(optimise):
    from speckle_mi.errors import InputError

    goal = {"maximise": ["ry.u"], "crosstalk.z": {"at_most": 1e-4}}
    with pytest.raises(InputError, match="keeps to all limits .crosstalk.z at most 0.0001, closest 0.0[0-9]+, at laser"):
        optimise(LASER, "laser_angle=20:50", goal, 12)


def test_frames_tell_where_theory_does_not(optimise):
    found = optimise(LASER, "beam_radius=0.08:0.16", {"maximise": ["decorrelation.x"]}, 10)
    # A wider beam is left later: w sqrt(ln 2)/cos 35 degrees.
    (best,) = found.front
    assert best.values["beam_radius"] > 0.14
    wanted = best.values["beam_radius"] * math.sqrt(math.log(2)) / math.cos(math.radians(35))
    assert best.figures["decorrelation.x"].value == pytest.approx(wanted, rel=0.1)


FLAGS = ("--free", "laser_angle=5:60", "--goal", "G.toml", "--trials", "24", "--seeds", "3")
SCENE_FLAGS = ("-D", "width=32", "-D", "height=24", "-D", "pixel_pitch=0.1")


def test_every_trial_is_kept_and_an_interrupted_run_goes_on(tmp_path):
    (tmp_path / "G.toml").write_text('minimise = ["crosstalk.z"]\nmaximise = ["rz.y"]\n', encoding="utf-8")
    given = ("optimise", LASER, *FLAGS, *SCENE_FLAGS, "--out", "out")
    done = run(*given, cwd=tmp_path)
    assert done.returncode == DONE, done.stderr
    assert "best trade-offs" in done.stdout
    out = tmp_path / "out"
    first, table = json.loads((out / "optimum.json").read_text()), (out / "trials.csv").read_text()
    with open(out / "trials.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == first["trials"] == 24 and sum(int(row["best"]) for row in rows) == len(first["best"])
    import xarray

    with xarray.open_dataset(out / "results.nc") as data:
        angles = data["value"].sel(parameter="laser_angle").values
        np.testing.assert_allclose(angles, [float(row["laser_angle"]) for row in rows])
        rotation = data["result"].sel(figure="rz.y").values
        np.testing.assert_allclose(rotation, [float(row["rz.y"]) for row in rows])
    # As if it had been stopped half-way: the second half of what it had found is not there.
    journal = out / "jobs" / "jobs.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[: len(lines) // 2]) + lines[-1][:40])
    for name in ("optimum.json", "trials.csv"):
        (out / name).unlink()
    assert run(*given, "--quiet", cwd=tmp_path).returncode == DONE
    assert (out / "trials.csv").read_text() == table
    again = json.loads((out / "optimum.json").read_text())
    assert again["best"] == first["best"]
    assert len(journal.read_text().splitlines()) == len(lines)


def test_optuna_proposes_trials_within_the_bounds(mitsuba):
    from speckle_mi.studies.design import Design
    from speckle_mi.studies.goals import free_numbers, goals_of
    from speckle_mi.studies.optimisation import OptimisationStudy

    design = Design.of(LASER, [(name, str(value)) for name, value in SMALL.items()])
    free, goals = free_numbers("laser_angle=-20:40,detector.rx=-1:1"), goals_of({"minimise": ["z.x"]}, ["detector"])
    found = [OptimisationStudy(design, free, goals, 30, 3, sampler="optuna").result() for _ in range(2)]
    assert found[0].front[0].values == found[1].front[0].values and len(found[0].trials) == 30
    assert abs(found[0].front[0].values["laser_angle"]) < 5
    assert all(-20 <= one.values["laser_angle"] <= 40 for one in found[0].trials)


@pytest.mark.parametrize(
    ("goal", "free", "words"),
    [
        ("minimise = []", "laser_angle=5:60", "has 0 goals, must have 1 to 4"),
        ("minimise = ['noise']", "laser_angle=5:60", "minimise noise: is no figure, must be one such as"),
        ("minimise = ['z.x']\n[speed]\nat_most = 1", "laser_angle=5:60", "[speed]: is no figure"),
        ("minimise = ['z.x']", "theta=5:60", "theta: the scene has no such number, must be one of wavelength"),
        ("minimise = ['z.x']", "laser_angle=60:5", "must be name=low:high, such as laser_angle=20:50"),
        ("minimise = ['z.x']", "laser_angle=5:60,laser_angle=1:2", "is given twice"),
    ],
)
def test_bad_goals_and_bounds_are_refused_in_one_line(mitsuba, tmp_path, goal, free, words):
    from speckle_mi.errors import InputError
    from speckle_mi.optimise import main

    (tmp_path / "G.toml").write_text(goal, encoding="utf-8")
    given = [LASER, "--free", free, "--goal", str(tmp_path / "G.toml"), "--out", str(tmp_path / "out")]
    with pytest.raises(InputError) as caught:
        main(given)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert not list((tmp_path / "out").glob("*.*"))


def test_the_command_refuses_what_it_cannot_do(tmp_path):
    (tmp_path / "G.toml").write_text("minimise = ['z.x']", encoding="utf-8")
    given = ("optimise", LASER, "--free", "laser_angle=5:60", "--goal", "G.toml", "--out", "out")
    refused(run(*given, "--trials", "4", cwd=tmp_path), "--trials 4: must be 8 to")
