"""Assemblies side by side: the paper's conclusion about its three, limits, design sweeps."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from conftest import SCENES
from test_commands import DONE, run

THREE = [str(SCENES / f"{name}.xml") for name in ("tilted_laser", "tilted_detector", "both_tilted")]
LASER, DETECTOR, BOTH = range(3)


@pytest.fixture(scope="module")
def three(mitsuba):
    from speckle_mi.studies.comparison import compare_scenes

    return compare_scenes(THREE)


def test_the_paper_s_conclusion_about_its_three_assemblies(three):
    by_use = {one.use: one for one in three.conclusions}
    in_plane = by_use["translation in the surface's plane"]
    assert in_plane.order == (LASER, BOTH, DETECTOR) and in_plane.best == 1 and in_plane.is_clear
    assert by_use["tilt"].alike
    assert by_use["translation out of it"].order[0] == DETECTOR
    assert set(by_use["rotation in the plane"].order[:2]) == {LASER, DETECTOR}
    assert by_use["rotation in the plane"].best == 2
    assert [one.candidate.scene for one in three.in_order] == ["tilted_laser", "both_tilted", "tilted_detector"]


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("x.x", (0.946, 0.591, 0.837)), ("y.y", (0.92, 0.92, 0.92)), ("z.x", (0.0376, 0.470, 0.310)),
     ("rx.y", (1.905, 1.905, 1.9975)), ("ry.x", (1.905, 1.905, 1.9975)), ("rz.y", (0.6006, 0.6006, 0.0))],
)  # fmt: skip
def test_the_paper_s_tables_are_in_their_intervals(three, name, wanted):
    for one, value in zip(three.compared, wanted, strict=True):
        figure = one.figures[name]
        assert figure.theory == pytest.approx(value, abs=6e-4)
        low, high = figure.interval
        # 95 % intervals: of 18 one may miss, by little.
        assert low - 0.5 * (high - low) <= figure.theory <= high + 0.5 * (high - low)


def test_derived_figures_are_what_the_matrix_says(three):
    laser = three.compared[LASER].figures
    assert laser["crosstalk.z"].theory == pytest.approx(laser["z.x"].theory / laser["y.y"].theory, rel=1e-6)
    assert laser["condition.x+y"].theory == pytest.approx(laser["x.x"].theory / laser["y.y"].theory, rel=1e-6)
    detector = three.compared[DETECTOR].figures
    # On the detector, which is tilted by 35 degrees, not on the target.
    assert detector["least.x+y"].theory == pytest.approx(detector["x.x"].theory / math.cos(math.radians(35)), rel=1e-6)
    # The beam's law: exp(-a^2/w^2) of the material's motion across the beam, w = 0.12 mm, at 35 degrees.
    across = 0.12 * math.sqrt(math.log(2))
    for number, angle in ((LASER, 35), (DETECTOR, 0)):
        low, high = three.compared[number].figures["decorrelation.x"].interval
        assert low < across / math.cos(math.radians(angle)) < high


def test_resolution_is_the_scatter_that_one_frame_states(mitsuba):
    import speckle_mi as smi
    from speckle_mi.studies.comparison import compare_scenes

    fits = smi.Simulation(smi.load_scene(THREE[LASER])).sensitivity(("y",)).fits["y"]
    found = compare_scenes(THREE[:1]).compared[0].figures["y.y"]
    assert found.value == pytest.approx(abs(fits["y"].value), rel=1e-6)
    low, high = fits["y"].ci95
    assert np.ptp(found.interval) == pytest.approx(high - low, rel=0.02)


def test_geometry_s_figures(mitsuba):
    from speckle_mi.studies.design import Design
    from speckle_mi.studies.room import clearance, extent

    (assembly,) = Design.of(THREE[LASER]).assemblies({}).values()
    angle, half = math.radians(35), (744 * 0.006 / 2, 480 * 0.006 / 2)
    np.testing.assert_allclose(extent([assembly]), [50 * math.sin(angle) + half[0], 2 * half[1], 60], atol=1e-6)
    laser = 50 * np.array([-math.sin(angle), 0, math.cos(angle)])
    assert clearance([assembly]) == pytest.approx(math.hypot(laser[0] + half[0], 60 - laser[2]) - 0.12, abs=1e-6)


def test_parts_of_a_study_make_the_whole_and_workers_find_the_same(mitsuba, tmp_path):
    from speckle_mi.experiments.execution import Shard, executor_of
    from speckle_mi.machine.journal import Journal
    from speckle_mi.studies.comparison import ComparisonStudy, Swept, candidates_of
    from speckle_mi.studies.design import Design
    from speckle_mi.studies.together import ALONE, Hands, LeftToOthers

    design = Design.of(THREE[LASER], [("width", "32"), ("height", "24"), ("pixel_pitch", "0.1")])
    swept = [Swept.parse("laser_angle", "25:35:3")]

    def study(hands):
        return ComparisonStudy(candidates_of({"one": design}, swept), None, 3, swept=swept, hands=hands)

    def figures(found):
        return [(name, one.value, one.interval, one.theory) for compared in found.compared
                for name, one in compared.figures.items() if name != "seconds"]  # fmt: skip

    wanted = repr(figures(study(ALONE).result()))
    for number, is_last in ((2, False), (1, True)):
        shard = Shard(number, 2)
        with Journal(tmp_path, shard.journal) as done:
            if is_last:
                assert repr(figures(study(Hands(None, done, shard)).result())) == wanted
            else:
                with pytest.raises(LeftToOthers, match="2 of 3 variants are others' to do"):
                    study(Hands(None, done, shard)).result()
    with executor_of("local:1") as executor:
        assert repr(figures(study(Hands(executor)).result())) == wanted


REQUIREMENT = """
["crosstalk.z"]
at_most = 0.1
[ry.u]
at_least = 1.0
at_most = 2.2
"""
SWEEP = ("-D", "laser_angle=25:35:3", "-D", "width=32", "-D", "height=24", "-D", "pixel_pitch=0.1", "--seeds", "3")


def test_a_design_sweep_is_a_table_a_curve_and_a_ranking(tmp_path):
    (tmp_path / "R.toml").write_text(REQUIREMENT, encoding="utf-8")
    done = run("compare", THREE[LASER], *SWEEP, "--require", "R.toml", "--out", "out", cwd=tmp_path)
    assert done.returncode == DONE, done.stderr
    assert "laser_angle 25" in done.stdout and "meets" in done.stdout
    with open(tmp_path / "out" / "comparison.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["laser_angle"]) for row in rows] == [25, 30, 35]
    for row in rows:
        angle = math.radians(float(row["laser_angle"]))
        assert float(row["z.x theory"]) == pytest.approx(0.08 * math.sin(angle) * math.cos(angle), rel=1e-4)
        assert float(row["ry.x low"]) < 60 * (1 + math.cos(angle)) * math.pi / 180 < float(row["ry.x high"])
    found = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert found["ranking"][0] == "tilted_laser laser_angle 25" and found["candidates"][0]["verdict"] == "meets"
    assert (tmp_path / "out" / "comparison.png").stat().st_size > 10_000
    import xarray

    with xarray.open_dataset(tmp_path / "out" / "results.nc") as data:
        point = data.sel(scene="tilted_laser", laser_angle=30.0)
        assert float(point["expected"].sel(figure="z.x")) == pytest.approx(float(rows[1]["z.x theory"]))
        assert float(point["rank"]) == int(rows[1]["rank"])
        along = point["theory"].sel(detector="detector", axis="x", motion="ry")
        assert float(along) == pytest.approx(float(rows[1]["ry.x theory"]))
        assert float(point["measured"].mean("surface").sel(axis="x", motion="ry")[0]) == pytest.approx(
            float(rows[1]["ry.x"]), rel=1e-9
        )
        assert str(data["sensitivity_unit"].sel(motion="rx").values) == "mm/deg"
        assert data.attrs["scene_text"] == (SCENES / "tilted_laser.xml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("requirement", "flags", "words"),
    [
        ("[speed]\nat_most = 1", (), "[speed]: is no figure, must be one such as z.u, crosstalk.z.u"),
        ("['crosstalk.z']\nbelow = 1", (), "says below, must say at_most or at_least"),
        ("['crosstalk.z']\nat_least = 2\nat_most = 1", (), "is above at_most = 1: nothing meets it"),
        ("", (), "asks for nothing"),
        (None, ("-D", "laser_angle=20:50"), "laser_angle=20:50: must be first:last:count"),
        (None, ("-D", "theta=20:50:7"), "theta: the scene has no such number, must be one of wavelength"),
        (None, ("-D", "laser_angle=20:x:7"), "must be first:last:count"),
        (None, ("--seeds", "2"), "must be at least 3"),
    ],
)
def test_impossible_requirements_and_unknown_names_are_refused(mitsuba, tmp_path, requirement, flags, words):
    from speckle_mi.compare import main
    from speckle_mi.errors import InputError

    given = [THREE[LASER], *flags, "--out", str(tmp_path / "out")]
    if requirement is not None:
        (tmp_path / "R.toml").write_text(requirement, encoding="utf-8")
        given += ["--require", str(tmp_path / "R.toml")]
    with pytest.raises(InputError) as caught:
        main(given)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert not list((tmp_path / "out").glob("*.*"))
