"""What a sweep tells of itself: what its intervals rest on, what is not known, and how many surfaces there are."""

from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import SCENES
from scene_builder import direction, free_space

from speckle_mi.experiments.sweep_result import SweepResult
from speckle_mi.report.console import RESIDUALS
from speckle_mi.scene.write import write_points
from speckle_mi.sweep import main

FAST = ["--dof", "x", "--range", "0.02", "--steps", "2"]
SMALL = ["-D", "width=64", "-D", "height=48", "-D", "pixel_pitch=0.03", "-D", "point_sources=10"]


def swept(folder, scene, *arguments) -> dict:
    """The summary of a sweep."""
    main([str(scene), "--out", str(folder / "out"), *FAST, *arguments])
    return json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))


@pytest.fixture
def scene_of_points(tmp_path):
    """A scene file with the user's own scatterers."""
    write_points(tmp_path / "points.csv", np.random.default_rng(1).normal(0, (0.1, 0.1, 1e-3), (50, 3)))
    scene = tmp_path / "scene.xml"
    target = {"points": "points.csv", "roughness": None, "point_sources": None}
    scene.write_text(free_space(direction(35, 180), target=target, detector={"pixel_pitch": 0.03}), encoding="utf-8")
    return scene


def test_points_of_the_user_are_one_surface_whatever_the_seed(mitsuba, scene_of_points, tmp_path, capsys):
    summary = swept(tmp_path, scene_of_points)
    assert summary["frames"] == 3, "one reference and two displacements, not eight of each"
    assert summary["sensitivity"]["x"]["u"]["basis"] == "residuals"
    low, high = summary["sensitivity"]["x"]["u"]["ci95"]
    assert high > low, "an interval of no width would say that the sensitivity is known exactly"
    assert "one surface" in capsys.readouterr().out


def test_several_surfaces_of_the_users_points_are_refused_in_one_line(mitsuba, scene_of_points, tmp_path):
    with pytest.raises(ValueError, match="^--seeds 4: must be 1, .*points.*one surface[^\n]*$"):
        swept(tmp_path, scene_of_points, "--seeds", "4")
    assert not (tmp_path / "out").exists()
    assert swept(tmp_path, scene_of_points, "--seeds", "1")["frames"] == 3


def test_an_interval_of_one_surface_is_marked_and_one_of_several_is_not(mitsuba, tmp_path, capsys):
    scene = SCENES / "tilted_laser.xml"
    (tmp_path / "one").mkdir()
    alone = swept(tmp_path / "one", scene, *SMALL, "--seeds", "1")
    assert alone["sensitivity"]["x"]["u"]["basis"] == "residuals" and alone["sensitivity"]["x"]["u"]["note"]
    text = capsys.readouterr().out
    assert f"{RESIDUALS} one surface: the interval is from its residuals" in text and text.count(RESIDUALS) > 4
    (tmp_path / "two").mkdir()
    several = swept(tmp_path / "two", scene, *SMALL, "--seeds", "2")
    assert several["sensitivity"]["x"]["u"]["basis"] == "surfaces"
    assert RESIDUALS not in capsys.readouterr().out


def test_the_error_of_rays_is_not_known_and_said_so(mitsuba, tmp_path, capsys):
    rays = free_space(
        direction(35, 180), integrator={"method": "rays", "rays_per_source": 100}, target={"point_sources": 4}
    )
    (tmp_path / "scene.xml").write_text(rays, encoding="utf-8")
    assert swept(tmp_path, tmp_path / "scene.xml", "--seeds", "1")["numerical_error"] is None
    assert "numerical error of the field not known" in capsys.readouterr().out


def test_one_frame_of_unknown_error_leaves_that_of_the_sweep_unknown():
    result = SweepResult()
    for error in (1e-5, np.nan, 1e-4):
        result.note({"plan": [], "numerical_error": error, "warnings": []})
    assert np.isnan(result.numerical_error)


def test_the_papers_figures_are_printed_beside_the_papers_scene_alone(mitsuba, tmp_path, capsys):
    scene = SCENES / "tilted_laser.xml"
    (tmp_path / "paper").mkdir()
    assert swept(tmp_path / "paper", scene, "--seeds", "1")["paper"]["figures"]["x"]["paper"] == 0.94
    assert "|x| 0.94" in capsys.readouterr().out
    (tmp_path / "other").mkdir()
    assert swept(tmp_path / "other", scene, "--seeds", "1", "-D", "wavelength=532")["paper"] is None
    assert "|x|" not in capsys.readouterr().out
