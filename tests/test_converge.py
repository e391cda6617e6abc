"""The convergence study: errors fall as accuracy is asked for, on any scene, and what it cannot measure it says."""

from __future__ import annotations

import csv
import json
from dataclasses import fields

import numpy as np
import pytest
from conftest import SCENES

from speckle_mi.converge import main
from speckle_mi.validation.convergence.exact import exact_field
from speckle_mi.validation.convergence.frame import (
    DOES_NOT_APPLY,
    LEFT_OUT,
    MEASURED,
    Row,
    Setting,
    with_point_sources,
)
from speckle_mi.validation.convergence.prediction import Predictor
from speckle_mi.validation.convergence.scatter import Scatter
from speckle_mi.geometry.pose import Pose
from speckle_mi.field.simulation import simulate_frame

SMALL = ["-D", "width=64", "-D", "height=48", "-D", "pixel_pitch=0.03", "-D", "beam_radius=0.2"]
AMPLE = "600"
"""Seconds that a study on so few pixels does not need: nothing is left out, however busy the machine."""
FLOAT32 = 1e-6
"""Relative error that the single-precision kernels keep: what tolerances above it may stop at."""

SAMPLING = 3.0
"""An error measured on some hundred pixels may exceed the requested one of the whole field by chance."""


def study(folder, scene: str, *arguments: str) -> tuple[list[dict], dict]:
    """Runs the command; rows of converge.csv and the content of converge.json."""
    main([str(SCENES / f"{scene}.xml"), "--out", str(folder), "--quick", "--quiet", *arguments])
    with open(folder / "converge.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return rows, json.loads((folder / "converge.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def free_space(mitsuba, tmp_path_factory):
    folder = tmp_path_factory.mktemp("free_space")
    return folder, *study(folder, "tilted_laser", "--point-sources", "10,100", "--seconds", AMPLE, *SMALL)


@pytest.fixture(scope="module")
def imaging(mitsuba, tmp_path_factory):
    folder = tmp_path_factory.mktemp("imaging")
    small = ("-D", "width=48", "-D", "height=36", "-D", "beam_radius=0.05", "-D", "stop_radius=1")
    return folder, *study(folder, "imaging", "--point-sources", "10", "--seconds", AMPLE, *small)


def measured(rows, method: str, point_sources: int) -> list[dict]:
    return [r for r in rows if (r["method"], r["point_sources"], r["status"]) == (method, str(point_sources), MEASURED)]


def errors(rows) -> np.ndarray:
    return np.array([float(row["field_error"]) for row in rows])


def test_a_study_leaves_its_table_its_figures_and_both_plots(free_space):
    folder, rows, content = free_space
    assert sorted(path.name for path in folder.iterdir()) == [
        "converge.csv",
        "converge.json",
        "converge.png",
        "statistics.png",
    ]
    assert list(rows[0]) == [column.name for column in fields(Row)]
    assert {row["method"] for row in rows} == {"auto", "direct", "fast", "rays"}
    assert {"processor", "cores", "mitsuba", "numpy"} <= set(content["system"])
    assert len(content["rows"]) == len(rows) and content["plan"]
    for row in rows:
        assert row["status"] in (MEASURED, LEFT_OUT, DOES_NOT_APPLY)
        assert row["note"] or row["status"] == MEASURED


@pytest.mark.parametrize("method", ["auto", "fast"])
@pytest.mark.parametrize("point_sources", [10, 100])
def test_error_of_the_field_stays_below_the_tolerance(free_space, method, point_sources):
    rows = measured(free_space[1], method, point_sources)
    asked = np.array([float(row["tolerance"]) for row in rows])
    assert len(rows) >= 3
    assert np.all(errors(rows) <= SAMPLING * asked)
    assert errors(rows)[-1] <= errors(rows)[0]


def test_direct_sum_is_exact_to_single_precision(free_space):
    assert errors(measured(free_space[1], "direct", 10)) < FLOAT32


def test_error_of_rays_falls_with_their_number(free_space):
    """Interpolating the path through more rays a source converges to the exact sum."""
    rows = measured(free_space[1], "rays", 10)
    assert [int(row["rays_per_source"]) for row in rows] == [16, 64]
    assert errors(rows)[1] < 0.1 * errors(rows)[0]
    phases = [float(row["phase_error_wavelengths"]) for row in rows]
    assert phases[1] < 0.1 * phases[0]


def test_shift_follows_first_order_theory_and_the_exact_frames(free_space):
    """A direct sum measures the exact shift; one surface scatters about theory by a part of a pixel."""
    _, rows, content = free_space
    (row,) = measured(rows, "direct", 100)
    pixel = 30.0
    assert float(row["shift_error_um"]) < 1e-3 * pixel
    assert float(row["shift_theory_error_um"]) < 0.3 * pixel
    assert content["theory_shift_um"][0] == pytest.approx(0.9463 * 1e3 * content["displacement"]["mm"], rel=1e-3)


def test_scatter_over_surfaces_is_reported_for_a_translation_and_a_rotation(free_space):
    statistics = free_space[2]["statistics"]
    assert {entry["dof"] for entry in statistics} == {"x", "ry"}
    for entry in statistics:
        assert len(entry["slopes"]) >= 2
        assert entry["spread"] == pytest.approx(np.std(entry["slopes"], ddof=1))


def test_mean_over_surfaces_scatters_like_one_over_the_root_of_their_number():
    """Slopes of independent surfaces, normally distributed: groups of n scatter by sigma/sqrt(n)."""
    slopes = np.random.default_rng(5).normal(1.0, 0.1, 3000)
    sizes, spread, own = Scatter("x", "u", "mm/mm", 0.01, 100, slopes.tolist(), 1.0, 0.1, 1.0).of_means()
    assert list(sizes[:3]) == [1, 2, 4]
    assert np.all(np.abs(spread * np.sqrt(sizes) / 0.1 - 1) < 4 * own)


def test_rays_in_focus_do_not_apply_and_the_study_says_so(imaging):
    """The detector meets a caustic in the image plane: the other methods go on."""
    _, rows, _ = imaging
    (row,) = [row for row in rows if row["method"] == "rays"]
    assert row["status"] == DOES_NOT_APPLY and "caustic" in row["note"]
    assert measured(rows, "auto", 10)


def test_error_behind_a_lens_falls_with_the_tolerance(imaging):
    _, rows, content = imaging
    rows = measured(rows, "auto", 10)
    asked = np.array([float(row["tolerance"]) for row in rows])
    assert len(rows) >= 2
    assert np.all(errors(rows) <= SAMPLING * asked)
    assert np.all(np.diff(errors(rows)) < 0)
    assert "sum on the sampled pixels" in content["exact"]["10"]["origin"]


@pytest.mark.parametrize("name, small", [("ball_lens", {"width": 24, "height": 18, "stop_radius": 0.1}),
                                         ("fig4_aperture", {"width": 40, "height": 40, "pixel_pitch": 0.03}),
                                         ("folded", {"width": 40, "height": 40})])  # fmt: skip
def test_the_exact_field_agrees_with_the_whole_frame(shipped, name, small):
    """The field summed on some pixels alone is that of the same pixels of the detector, to the tolerance of both."""
    assembly = shipped(name, **small)
    exact = exact_field(with_point_sources(assembly, 2), 1e-6)
    frame = simulate_frame(Setting("auto", 2, 1e-5).of(assembly), Pose())
    error, phase = exact.errors(frame.image.field)
    assert exact.scatterers == frame.scatterers.count
    assert error < SAMPLING * 1e-5
    assert phase < error


def test_number_of_point_sources_sets_the_density_of_scatterers(shipped):
    """Ten times N1 puts ten times the scatterers under the beam, to the root of their number."""
    assembly = shipped("tilted_laser", width=16, height=16)
    counts = [simulate_frame(with_point_sources(assembly, n), Pose()).scatterers.count for n in (100, 1000)]
    assert counts[1] == pytest.approx(10 * counts[0], rel=5 / np.sqrt(counts[0]))


@pytest.mark.parametrize("name, value", [("--seconds", "0"), ("--point-sources", "ten"), ("--point-sources", "0")])
def test_bad_settings_are_refused_by_name(tmp_path, name, value):
    with pytest.raises(ValueError, match=name):
        main([str(SCENES / "tilted_laser.xml"), "--out", str(tmp_path / "out"), name, value])


def test_a_mean_is_off_theory_only_where_chance_does_not_explain_it():
    """Student's t: of 24 surfaces a mean 2 standard errors off is chance, one 5 off is not; of 2, hardly any is."""
    slopes = np.random.default_rng(3).normal(size=24)
    slopes = 0.9 + 0.05 * (slopes - slopes.mean()) / slopes.std(ddof=1)

    def scatter(count: int, errors_off: float) -> Scatter:
        own = slopes[:count] - slopes[:count].mean() + 0.9
        spread = float(own.std(ddof=1))
        theory = 0.9 - errors_off * spread / np.sqrt(count)
        return Scatter("x", "u", "mm/mm", 0.01, 100, own.tolist(), 0.9, spread, theory)

    assert scatter(24, 2.0).off_theory is None
    assert scatter(24, 5.0).off_theory == pytest.approx(5 * scatter(24, 5.0).error_of_mean)
    assert scatter(2, 5.0).off_theory is None


def test_rays_behind_an_opening_that_diffracts_say_that_they_do_not_apply(mitsuba, tmp_path):
    """They are measured all the same: the paper's way leaves a tenth of the field wrong, however many rays it takes."""
    small = ("-D", "width=64", "-D", "height=48", "-D", "pixel_pitch=0.03", "--point-sources", "3", "--seconds", AMPLE)
    rows, _ = study(tmp_path, "integrated_sensor", *small)
    rays = measured(rows, "rays", 3)
    assert len(rays) == 2 and all("does not apply: openings diffract" in row["note"] for row in rays)
    assert np.all(errors(rays) > 0.1)
    assert errors(measured(rows, "auto", 3))[-1] < 1e-4


def row(point_sources: int, seconds: float | None) -> Row:
    """A row that was measured, or left out."""
    status = LEFT_OUT if seconds is None else MEASURED
    return Row("", "", "auto", point_sources, None, None, 1e-4, status, seconds_median=seconds)


@pytest.mark.parametrize("method, grown", [("direct", 100.0), ("rays", 100.0), ("fast", 10.0)])
def test_time_of_a_frame_grows_with_its_pairs_or_with_the_root_of_few_scatterers(method, grown):
    predictor = Predictor(method, pixels=10_000)
    assert predictor.seconds(0, 10) == 0.0 and not predictor.knows(0)
    predictor.learn(0, row(10, 0.5))
    assert predictor.knows(0) and predictor.seconds(0, 1000) == pytest.approx(0.5 * grown)


def test_a_finer_accuracy_is_not_predicted_faster_than_the_coarser_one_but_for_rays():
    for method, least in (("auto", 3.0), ("rays", 0.0)):
        predictor = Predictor(method, pixels=100)
        predictor.learn(0, row(1000, 3.0))
        assert predictor.seconds(1, 1000) == least and predictor.seconds(1, 10) == 0.0
    left_out = Predictor("auto", pixels=100)
    left_out.assume(0, 1000, 2.0)
    left_out.learn(0, row(2000, None))
    assert left_out.seconds(1, 2000) == 4.0, "what was left out would have taken that long"
