"""What detectors tell apart, and motions from their shifts."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from conftest import SCENES
from scene_builder import direction, free_space
from test_commands import DONE, refused, run

from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM
from speckle_mi.measurement.observability import estimated_motion, observability

MOTION = np.array([0.004, -0.003, 0.006, 0.005, -0.004, 0.006])
"""All six at once [mm, deg], of which a pattern of the scene below loses little."""

STANDARD_UNCERTAINTIES = 4.0
COARSE = {"width": 124, "height": 80, "pixel_pitch": 0.036, "tolerance": 0.01}
"""Of the integrated sensor, whose light fills the same area with fewer pixels."""

AWAY = 1.5
"""How far its target moves [mm]: the pattern is lost many times over."""

STATED_AT_MOST = 0.02
"""Uncertainty [mm or deg] that a motion of some thousandths must not be hidden in."""


def test_a_combination_that_no_detector_sees_is_named():
    """Of one detector that sees x + y along u and z along v, x - y is not seen and z is known."""
    seen = observability(np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0]]), np.ones(3))
    np.testing.assert_allclose(seen.singular_values, [2.0, np.sqrt(2), 0.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(seen.unseen), [[np.sqrt(0.5), np.sqrt(0.5), 0.0]], atol=1e-12)
    assert np.isinf(seen.condition) and list(seen.known) == [False, False, True]


def test_condition_is_of_shifts_for_the_displacements_named():
    seen = observability(np.diag([1.0, 0.5]), np.array([0.1, 0.4]))
    assert seen.condition == pytest.approx(2.0)


def test_motions_are_recovered_with_the_uncertainty_that_they_have():
    """Of 300 noisy measurements, errors divided by their uncertainty have the variance 1."""
    random = np.random.default_rng(3)
    matrix, motion = random.normal(size=(6, 4)), np.array([0.1, -0.2, 0.05, 0.3])
    sigma = np.array([1e-3, 2e-3, 1e-3, 3e-3, 2e-3, 1e-3])
    errors = []
    for _ in range(300):
        shifts = matrix @ motion + sigma * random.normal(size=6)
        found = estimated_motion(matrix, np.zeros((6, 4)), shifts, sigma, np.full(4, 0.1))
        errors.append((found.motion - motion) / np.sqrt(np.diag(found.covariance)))
    assert found.freedom == 2
    np.testing.assert_allclose(np.mean(np.square(errors), axis=0), 1.0, atol=4 * np.sqrt(2 / 300))


def test_what_cannot_be_told_apart_is_not_known():
    found = estimated_motion(np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0]]), np.zeros((2, 3)), np.array([0.1, 0.4]),
                             np.full(2, 1e-3), np.ones(3))  # fmt: skip
    assert np.isnan(found.motion[:2]).all() and found.motion[2] == pytest.approx(0.2)
    assert np.sqrt(found.covariance[2, 2]) == pytest.approx(0.5e-3)


def test_the_scatter_of_one_surface_is_part_of_the_uncertainty():
    found = estimated_motion(np.eye(2), 0.05 * np.eye(2), np.array([0.2, 0.0]), np.full(2, 1e-3), np.ones(2))
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(np.hypot(0.01, 1e-3))
    assert np.sqrt(found.covariance[1, 1]) == pytest.approx(1e-3)


# Three detectors that look at one spot


@pytest.fixture(scope="module")
def three_detectors(tmp_path_factory):
    """Scenes of one laser and target that differ in where the detector stands."""
    folder = tmp_path_factory.mktemp("detectors")
    for name, sight, distance in (("left", direction(-35, 0), 60), ("right", direction(10, 30), 45),
                                  ("top", direction(20, -30), 80)):  # fmt: skip
        scene = free_space(
            direction(20, 15), sight, detector_distance=distance, laser={"beam_radius": 0.25, "wavefront_radius": 60},
            target={"point_sources": 150}, detector={"width": 300, "height": 300, "pixel_pitch": 0.006},
        )  # fmt: skip
        (folder / f"{name}.xml").write_text(scene)
    return folder


def test_a_known_motion_of_all_six_is_recovered_from_rendered_images(three_detectors, mitsuba):
    from speckle_mi import Correlator, Pose, Simulation
    from speckle_mi.scene.read import assembly_from_scene

    folder, rows = three_detectors, []
    for name in ("left", "right", "top"):
        done = run("sensitivity", f"{name}.xml", "--seeds", "6", "--out", f"{name}.json", cwd=folder)
        assert done.returncode == DONE, done.stderr
        simulation = Simulation(assembly_from_scene(mitsuba.load_file(str(folder / f"{name}.xml"))))
        rest, moved = (
            simulation.frame(pose, seed=77).image.intensity
            for pose in (Pose(), Pose(**dict(zip(DEGREES_OF_FREEDOM, MOTION, strict=True))))
        )
        shift = Correlator(rest).shift(moved)
        um = 1e3 * simulation.assembly.detector.pitch
        rows.append({"detector": name, "shift_u_um": shift.u_px * um, "shift_v_um": shift.v_px * um,
                     "sigma_u_um": shift.sigma_u_px * um, "sigma_v_um": shift.sigma_v_px * um})  # fmt: skip
    with open(folder / "shifts.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    done = run("pose", "left.json", "right.json", "top.json", "shifts.csv", "--range", "0.02", "--out", "motion.json",
               cwd=folder)  # fmt: skip
    assert done.returncode == DONE, done.stderr
    assert "condition number" in " ".join(done.stdout.split())
    found = json.loads((folder / "motion.json").read_text())
    assert len(found["singular_values"]) == 6 and not found["unseen"]
    motion, sigma = (np.array(list(found["motions"][0][name].values())) for name in ("motion", "sigma"))
    assert np.all(np.abs(motion - MOTION) < STANDARD_UNCERTAINTIES * sigma), (motion, sigma)
    assert np.all(sigma < STATED_AT_MOST), sigma


# A detector behind an aperture: the centre of gravity of the light


@pytest.fixture(scope="module")
def behind_an_aperture(tmp_path_factory):
    """A folder with the integrated sensor's sweep, and its pictures at rest and after it came nearer."""
    folder = tmp_path_factory.mktemp("aperture")
    scene = str(SCENES / "integrated_sensor.xml")
    coarse = [f"-D{name}={value}" for name, value in COARSE.items()]
    done = run("sweep", scene, *coarse, "--dof", "x,z", "--range", "0.2", "--steps", "2", "--seeds", "6",
               "--out", "swept", "--keep", "none", cwd=folder)  # fmt: skip
    assert done.returncode == DONE, done.stderr
    for name, pose in (("rest", "x=0"), ("moved", f"z={AWAY}")):
        done = run("render", scene, *coarse, "-Dseed=40", "--pose", pose, "-o", f"{name}.exr", cwd=folder)
        assert done.returncode == DONE, done.stderr
    return folder


def test_the_centre_of_gravity_tells_how_far_a_target_came_nearer_whose_pattern_is_lost(behind_an_aperture):
    folder = behind_an_aperture
    correlated = run("correlate", "rest.exr", "moved.exr", "--csv", cwd=folder)
    assert ",ok," not in correlated.stdout
    (folder / "shifts.csv").write_text(correlated.stdout)
    done = run("pose", "swept/summary.json", "shifts.csv", "--dof", "x,z", "--out", "motion.json", cwd=folder)
    assert done.returncode == DONE, done.stderr
    found = json.loads((folder / "motion.json").read_text())["motions"][0]
    assert found["motion"]["x"] is None  # only the pattern knows of it
    error, sigma = found["motion"]["z"] - AWAY, found["sigma"]["z"]
    assert abs(error) < STANDARD_UNCERTAINTIES * sigma and sigma < 0.1 * AWAY, (error, sigma)


def test_where_nothing_was_measured_there_is_no_motion(tmp_path):
    entry = {"value": 1.0, "ci95": [0.9, 1.1]}
    (tmp_path / "x.json").write_text(json.dumps({"sensitivity": {"x": {"u": entry, "v": entry}}}))
    (tmp_path / "shifts.csv").write_text("shift_u_um,shift_v_um,status\n,,not significant\n")
    refused(run("pose", "x.json", "shifts.csv", "--dof", "x", cwd=tmp_path), "of motion 1 no shift was measured")


@pytest.mark.parametrize(
    "files, said",
    [
        (("shifts.csv",), "there must be a summary"),
        (("nothing.json", "shifts.csv"), "nothing.json"),
        (("empty.json", "shifts.csv"), "empty.json: is no summary"),
        (("x.json", "shifts.csv"), "x.json: holds no sensitivity to y"),
        (("x.json", "shifts.csv", "--dof", "x"), "shifts.csv: has no column shift_u_um"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, files, said):
    (tmp_path / "empty.json").write_text("{}")
    entry = {"value": 1.0, "ci95": [0.9, 1.1]}
    (tmp_path / "x.json").write_text(json.dumps({"sensitivity": {"x": {"u": entry, "v": entry}}}))
    (tmp_path / "shifts.csv").write_text("a,b\n1,2\n")
    refused(run("pose", *files, cwd=tmp_path), said)
