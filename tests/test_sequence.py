"""Frames in time: how much an exposure blurs, poses that are rendered exactly, tracks that keep their drift."""

from __future__ import annotations

import csv
import json
import math
import stat
import sys

import numpy as np
import pytest
from PIL import Image
from scene_builder import detector_frame, detector_xml, direction, free_space

from speckle_mi import render
from speckle_mi.command_line import BAD_INPUT, DONE, command
from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.experiments.tracking import Track
from speckle_mi.experiments.trajectory import formula_of, read_motion
from speckle_mi.field.blur import Shutter
from speckle_mi.field.simulation import Simulation
from speckle_mi.geometry.pose import Pose
from speckle_mi.images.exr import read_field
from speckle_mi.sequence import main

BEAM, DISTANCE, WAVENUMBER = 0.12, 60.0, 2 * math.pi / 632.8e-6  # [mm], [mm], [1/mm]
BLUR = 0.02  # Of the contrast, from theory: what 8 surfaces leave of the statistics is half of it.
CAMERA = {"mean_electrons": 500, "bit_depth": 8, "full_well": 4000}

SMALL = {"width": 64, "height": 48, "pixel_pitch": 0.02}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("sequence") / "scene.xml"
    path.write_text(free_space(detector=SMALL | {"camera": CAMERA}, target={"point_sources": 20}))
    return path


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


# Blur


def square_exposure(a):
    """Contrast of speckle that is integrated while its intensity's correlation falls as exp(-(a t)^2), t from 0 to 1:
    C^2 = 2 int (1 - t) exp(-(a t)^2) dt (Goodman, Speckle Phenomena in Optics, ch. 4)."""
    return math.sqrt(math.sqrt(math.pi) * math.erf(a) / a - (1 - math.exp(-a * a)) / a**2)


@pytest.mark.parametrize("dof, speed", [("ry", 2.0), ("x", 3.0)])
def test_contrast_of_blurred_speckle_falls_as_a_square_exposure_says(assemble, dof, speed):
    """A tilt by t moves the pattern by 2 z t and leaves it as it is; a shift across a collimated beam moves it by as
    much, and takes other scatterers into the beam: the correlation falls by exp(-(k d w / 2z)^2), and by exp(-(d/w)^2)
    besides."""
    # `speed`: of the pattern, in lengths over which the correlation falls to 1/e, in an exposure.
    rate = WAVENUMBER * BEAM / (2 * DISTANCE)
    rate = rate * 2 * DISTANCE * math.pi / 180 if dof == "ry" else math.hypot(rate, 1 / BEAM)
    assembly = assemble(free_space(
        detector={"width": 96, "height": 96, "pixel_pitch": 0.08}, target={"point_sources": 150},
        laser={"beam_radius": BEAM, "wavefront_radius": math.inf}, integrator={"tolerance": 1e-2},
    ))  # fmt: skip
    seen = []
    for seed in range(8):
        shutter = Shutter({"detector": assembly.with_seed(seed)}, exposure=1.0)
        frames = shutter.frames(lambda t: Pose(**{dof: speed / rate * (t - 0.5)}), 0.0, 0)
        seen.append(frames["detector"].image.intensity)
    seen = np.array(seen, dtype=float)
    assert seen.std() / seen.mean() == pytest.approx(square_exposure(speed), rel=BLUR)


def test_blur_is_the_mean_of_what_is_seen_in_the_meantime(assemble):
    assembly = assemble(free_space(detector=SMALL))
    motion = formula_of(["x=0.05,20"], ["ry=3"], [])
    frame = Shutter({"detector": assembly}, 0.01).frames(motion.at, 0.03, 0)["detector"]
    simulation, many = Simulation(assembly), 100
    moments = 0.03 + 0.01 * (np.arange(many) + 0.5) / many
    mean = np.mean([simulation.frame(motion.at(float(t))).image.intensity for t in moments], axis=0, dtype=float)
    # The plain mean itself is good to the square of its step.
    assert np.abs(frame.image.intensity - mean).max() < 1e-3 * mean.mean()
    assert frame.blur_error < 1e-3 and frame.moments > 1 and frame.image.field is None


def test_more_speed_takes_more_moments_and_rest_takes_one(assemble):
    shutter = Shutter({"detector": assemble(free_space(detector=SMALL))}, 0.01)
    motions = [formula_of([], [f"ry={speed}"], []) for speed in (0, 2, 20)]
    moments = [shutter.frames(motion.at, 0.0, 0)["detector"].moments for motion in motions]
    assert moments[0] == 1 < moments[1] < moments[2]


# Frames


def test_frames_without_blur_are_the_rendered_poses_bit_for_bit(mitsuba, scene, tmp_path):
    table = tmp_path / "motion.csv"
    table.write_text("time_s,x,rz\n0.1,0,0\n0.105,0.0123,0.5\n0.11,0.02,0.7\n")
    line = ["--motion", str(table), "--rate", "200", "--exposure", "0", "--out", str(tmp_path / "out"), "--quiet"]
    assert command(main, [str(scene), *line]) == DONE
    truth = rows_of(tmp_path / "out" / "truth.csv")
    assert [(float(row["x"]), float(row["rz"])) for row in truth] == [(0, 0), (0.0123, 0.5), (0.02, 0.7)]
    for number, pose in enumerate(("x=0", "x=0.0123,rz=0.5", "x=0.02,rz=0.7")):
        alone = tmp_path / f"{number}.exr"
        render_line = [str(scene), "-o", str(alone), "--pose", pose, "--shot", str(number), "--quiet"]
        assert command(render.main, render_line) == DONE
        one, other = read_field(alone), read_field(tmp_path / "out" / "frames" / f"frame_{number:05d}.exr")
        for name in ("intensity", "field", "dn"):
            assert np.array_equal(getattr(one, name), getattr(other, name))
        picture = np.asarray(Image.open(tmp_path / "out" / "frames" / f"frame_{number:05d}.png"))
        assert np.array_equal(picture, one.dn)


def test_truth_has_the_middle_of_every_exposure(mitsuba, scene, tmp_path):
    line = ["--ramp", "x=2", "--spin", "rz=10", "--rate", "50", "--exposure", "0.01", "--frames", "3"]
    assert command(main, [str(scene), *line, "--out", str(tmp_path / "out"), "--quiet"]) == DONE
    for number, row in enumerate(rows_of(tmp_path / "out" / "truth.csv")):
        middle = number / 50 + 0.005
        assert float(row["time_s"]) == pytest.approx(middle) and float(row["x"]) == pytest.approx(2 * middle)
        assert float(row["rz"]) == pytest.approx(10 * 360 / 60 * middle)
        assert float(row["end_s"]) - float(row["begin_s"]) == pytest.approx(0.01)
        image = read_field(tmp_path / "out" / "frames" / f"frame_{number:05d}.exr")
        assert image.field is None and image.header["exposure_s"] == 0.01 and int(row["moments"]) > 1


def test_several_detectors_and_a_video(mitsuba, tmp_path, capsys, monkeypatch):
    """A stand-in for ffmpeg writes what it is given: as many frames as there are, of the size that is told."""
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(f"#!{sys.executable}\nimport sys\nopen(sys.argv[-1], 'wb').write(sys.stdin.buffer.read())\n")
    program.chmod(program.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setenv("PATH", str(program.parent), prepend=":")
    path = tmp_path / "two.xml"
    second = detector_xml(detector_frame(direction(20), 80.0), **SMALL, id="far")
    path.write_text(free_space(detector=SMALL | {"id": "near"}, target={"point_sources": 20}, extra=second))
    out = tmp_path / "out"
    line = [str(path), "--sine", "y=0.04,7", "--rate", "100", "--frames", "5", "--json", "--out", str(out)]
    assert command(main, line) == DONE
    told = json.loads(capsys.readouterr().out)
    assert set(told["detectors"]) == {"near", "far"} and told["frames"] == 5
    assert json.loads((out / "sequence.json").read_text()) == told
    assert {row["detector"] for row in rows_of(out / "track.csv")} == {"near", "far"}
    for name in told["detectors"]:
        assert len(list((out / "frames").glob(f"*.{name}.exr"))) == 5
        with Image.open(out / f"preview.{name}.gif") as video:
            assert video.n_frames == 5 and video.size == (64, 48)
        assert (out / f"preview.{name}.mp4").stat().st_size == 5 * 64 * 48
        assert (out / f"track.{name}.png").stat().st_size > 1000


# Tracks


def test_track_over_fifty_decorrelation_lengths_keeps_its_drift(assemble):
    """The beam's radius is the length over which a shift of the material decorrelates the pattern to 1/e."""
    step, count = BEAM / 5, 251
    assembly = assemble(free_space(
        detector={"width": 96, "height": 96, "pixel_pitch": 0.04}, integrator={"tolerance": 1e-3},
        target={"point_sources": 50, "width": 20, "height": 4}, laser={"beam_radius": BEAM},
    ))  # fmt: skip
    assert (count - 1) * step >= 50 * BEAM
    slope = np.array([expected_sensitivity(assembly)[axis][0] for axis in "uv"])
    places = step * (np.arange(count) - count // 2)
    deviations = []
    for seed in (0, 1):
        simulation, track = Simulation(assembly.with_seed(seed)), Track()
        for place in places:
            track.add(simulation.frame(Pose(x=float(place))).image.intensity)
        found = 0.04 * np.array([[point.u, point.v] for point in track.points])
        drift = 0.04 * np.array([[point.sigma_u, point.sigma_v] for point in track.points])
        error = found - np.outer(places - places[0], slope)
        assert all(point.status == "ok" for point in track.points) and len(track.references) > 25
        assert np.all(np.abs(error[1:]) < 3 * drift[1:])
        deviations += [*(error[count // 2] / drift[count // 2]), *(error[-1] / drift[-1])]
        # Over many lengths errors add up as a random walk's steps.
        assert drift[-1] / drift[count // 4] == pytest.approx([2, 2], rel=0.25)
    assert 0.3 < np.sqrt(np.mean(np.square(deviations))) < 1.5  # neither hopeful nor needlessly wide


def test_a_track_that_is_lost_says_so_and_goes_on(assemble):
    simulation, track = Simulation(assemble(free_space(detector=SMALL))), Track()
    for seed in (0, 0, 1, 1):
        track.add(simulation.frame(Pose(), seed).image.intensity)
    first, second, lost, after = track.points
    assert second.status == "ok" and (second.u, second.v) == pytest.approx((0, 0), abs=1e-6)
    assert lost.status.startswith("lost: ") and math.isnan(lost.u) and math.isinf(lost.sigma_u)
    assert after.status == "ok" and after.reference == 2 and math.isinf(after.sigma_u)


# Motions


def test_motions_between_samples_are_straight_and_samples_are_exact(tmp_path):
    table = tmp_path / "m.csv"
    table.write_text("time_s, rx, z\n0, 1, 0\n0.1, 2, 0.3\n0.3, 2, -0.1\n")
    motion = read_motion(table)
    assert motion.at(0.1) == Pose(rx=2, z=0.3) == motion.at(0.1 + 1e-12)
    assert motion.at(0.05).rx == pytest.approx(1.5) and motion.at(0.2).z == pytest.approx(0.1)


def test_formulas_add_up():
    motion = formula_of(["z=0.01,50", "z=0.02,25,90"], ["x=0.5"], ["rz=600"])
    assert motion.at(0.005) == Pose(
        x=0.0025, rz=18.0, z=0.01 * math.sin(math.pi / 2) + 0.02 * math.sin(math.pi / 4 + math.pi / 2)
    )


@pytest.mark.parametrize(
    "flags, said",
    [
        ([], "--motion M.csv, --sine z=0.01,50, --ramp x=0.1 or --spin rz=600 must be given"),
        (["--sine", "q=1,2"], "'q' must be one of x, y, z, rx, ry, rz"),
        (["--sine", "z=1"], "must be finite numbers as in z=0.01,50"),
        (["--spin", "x=5"], "x is no rotation, must be one of rx, ry, rz"),
        (["--ramp", "x=1", "--rate", "0"], "--rate 0: must be a finite number"),
        (["--ramp", "x=1", "--exposure", "1"], "--exposure 1: must be 0 to 0.01 s"),
        (["--ramp", "x=1", "--frames", "0"], "--frames 0: must be 1 to"),
        (["--ramp", "x=1", "--renew", "1"], "--renew 1: must be a correlation between 0 and 1"),
        (["--motion", "m.csv", "--ramp", "x=1"], "must be given without --sine"),
    ],
)
def test_bad_flags_are_refused_in_one_line(scene, tmp_path, capsys, flags, said):
    out = tmp_path / "out"
    assert command(main, [str(scene), *flags, "--out", str(out)]) == BAD_INPUT
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1 and not out.exists()


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "must begin with the names of its columns"),
        ("time,x\n0,1\n", "must begin with the names of its columns"),
        ("time_s,q\n0,1\n", "column 'q' must be time_s or one of x, y, z, rx, ry, rz"),
        ("time_s,x\n", "has no samples"),
        ("time_s,x\n0,1\n0,2\n", "line 3: time_s must rise"),
        ("time_s,x\n0,1\n1\n", "line 3: has 1 cells, must have 2"),
        ("time_s,x\n0,nan\n", "line 2: x 'nan' must be a finite number of mm"),
        ("time_s,x\n0,1\n0.001,1\n", "--exposure 0.005: must be at most the 0.001 s that the motion lasts"),
    ],
)
def test_bad_tables_are_refused_in_one_line(mitsuba, scene, tmp_path, capsys, text, said):
    table, out = tmp_path / "m.csv", tmp_path / "out"
    table.write_text(text)
    assert command(main, [str(scene), "--motion", str(table), "--exposure", "0.005", "--out", str(out)]) == BAD_INPUT
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1 and not out.exists()
