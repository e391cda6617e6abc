"""Several detectors in one scene: bit for bit what scenes of one each give, known to every command by their ids."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from conftest import SCENES
from scene_builder import detector_frame, detector_xml, direction, free_space, integrator_xml
from test_commands import ENTRY, refused, run

from speckle_mi.experiments import sweep
from speckle_mi.experiments.frame_measurement import FrameMeasurement, SweptScene
from speckle_mi.experiments.jobs import Job, Work
from speckle_mi.experiments.kept_images import KeptImages
from speckle_mi.experiments.sweep_result import SweepResult, SweepSettings
from speckle_mi.field.detectors import Simulations
from speckle_mi.field.simulation import Simulation
from speckle_mi.geometry.pose import Pose
from speckle_mi.images.exr import read_field
from speckle_mi.machine.journal import Journal
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.read import assemblies_from_scene, assembly_from_scene

SCENE = str(SCENES / "two_cameras.xml")
SMALL = ["-D", "width=64", "-D", "height=48", "-D", "pixel_pitch=0.02", "-D", "point_sources=40"]
DONE = 0

STOP = (
    '<shape type="aperture" id="stop"><transform name="to_world"><translate z="40"/></transform>'
    '<float name="radius" value="0.4"/><float name="outer_radius" value="4"/></shape>'
)
MIRROR = (
    '<shape type="rectangle" id="mirror"><transform name="to_world"><scale value="10"/><rotate x="1" angle="90"/>'
    '<translate y="-20" z="20"/></transform><bsdf type="conductor"/></shape>'
)
SEEN_BY = {
    "near": (direction(0), 60, {"bit_depth": 8, "mean_electrons": 300}),
    "far": (direction(24, 40), 90, {"read_noise": 2, "fill_factor": 0.5}),
    "bare": (direction(8, -60), 70, {}),
}
GEOMETRIC = MIRROR + '<integrator type="coherent"><boolean name="diffraction" value="false"/></integrator>'
ASSEMBLIES = {"free space": "", "behind a stop": STOP, "beside a mirror": GEOMETRIC}


def what_was_done(header: dict) -> dict:
    """A header but for the plan, which says how long its stages took."""
    return {name: value for name, value in header.items() if name != "plan"}


def detectors(*names: str) -> str:
    return "".join(
        detector_xml(detector_frame(SEEN_BY[name][0], SEEN_BY[name][1]), 40, 24 + 8 * len(name), 0.02, id=name,
                     camera=SEEN_BY[name][2])
        for name in names
    )  # fmt: skip


def scene(extra: str, *names: str) -> str:
    """One laser and one target, seen by some of the detectors."""
    text = free_space(direction(30, 10), extra=extra, target={"point_sources": 60})
    if "<integrator" in extra:
        text = text.replace(integrator_xml(), "")
    first, last = text.index("<sensor"), text.index("</sensor>") + len("</sensor>")
    return text[:first] + detectors(*names) + text[last:]


@pytest.mark.parametrize("kind", ASSEMBLIES)
def test_detectors_of_one_scene_see_bit_for_bit_what_each_sees_alone(load, kind):
    together = Simulations(assemblies_from_scene(load(scene(ASSEMBLIES[kind], *SEEN_BY))))
    assert list(together.by_detector) == list(SEEN_BY)
    for pose, seed in ((None, None), (Pose(x=0.01, ry=0.02), 3)):
        frames = together.frames(pose, seed)
        for name in SEEN_BY:
            alone = Simulation(assembly_from_scene(load(scene(ASSEMBLIES[kind], name)))).frame(pose, seed)
            found = frames[name]
            assert what_was_done(found.image.header) == what_was_done(alone.image.header)
            assert np.array_equal(found.image.field, alone.image.field) and np.any(alone.image.field)
            assert np.array_equal(found.image.intensity, alone.image.intensity)
            assert np.array_equal(found.scatterers.amplitude, alone.scatterers.amplitude)
            assert (found.image.dn is None) == (alone.image.dn is None) == (name == "bare")
            assert found.image.dn is None or np.array_equal(found.image.dn, alone.image.dn)


def test_the_target_is_lit_once_for_all_detectors(load, monkeypatch):
    from speckle_mi.scattering.rough_surface import RoughSurface

    made, scatterers = [], RoughSurface.scatterers
    monkeypatch.setattr(RoughSurface, "scatterers", lambda *given: made.append(1) or scatterers(*given))
    Simulations(assemblies_from_scene(load(scene("", *SEEN_BY)))).frames(Pose(x=0.01), 5)
    assert len(made) == 1


def test_a_detector_is_chosen_by_its_id(load):
    loaded = load(scene("", *SEEN_BY))
    (name, assembly), = assemblies_from_scene(loaded, "far").items()
    assert name == "far" and assembly == assembly_from_scene(loaded, "far") == assemblies_from_scene(loaded)["far"]
    for choose in (lambda: assemblies_from_scene(loaded, "left"), lambda: assembly_from_scene(loaded, "left")):
        with pytest.raises(SceneError, match="'left'.*must be one of 'near', 'far', 'bare'"):
            choose()
    with pytest.raises(SceneError, match="3 of <sensor type='detector'>: 'near', 'far', 'bare', must have exactly one"):
        assembly_from_scene(loaded)


@pytest.mark.parametrize("name, said", [("", "each must have an id"), ("a/b", "'a/b'.*letters"), ("..", "letters")])
def test_several_detectors_need_ids_that_can_name_files(load, name, said):
    with pytest.raises(SceneError, match=said):
        assemblies_from_scene(load(scene("", "near", "far").replace('id="far"', f'id="{name}"')))
    (only,) = assemblies_from_scene(load(scene("", "far").replace('id="far"', f'id="{name}"')))
    assert only == name


def test_assemblies_that_differ_in_more_than_the_detector_are_no_detectors_of_one_scene(load):
    one, other = (assembly_from_scene(load(scene(extra, "near"))) for extra in ("", STOP))
    with pytest.raises(ValueError, match="'b'.*more than its detector"):
        Simulations({"a": one, "b": other})
    with pytest.raises(ValueError, match="at least one"):
        Simulations({})


# Sweeps


SETTINGS = SweepSettings(("x", "ry"), np.array([-0.01, 0.0, 0.01]), (0, 1), 24)


@pytest.fixture(scope="module")
def two(load):
    return assemblies_from_scene(load(scene("", "near", "bare")))


@pytest.fixture(scope="module")
def swept(two, tmp_path_factory):
    frames, results = tmp_path_factory.mktemp("frames"), {name: SweepResult() for name in two}
    sweep.run_sweeps(two, SETTINGS, frames, results, quiet=True, pictures=None)
    return frames, results


def rows(result: SweepResult) -> list[tuple]:
    """What was measured in every frame, but for the time it took."""
    return [tuple(v for k, v in vars(record).items() if k != "seconds") for record in result.records]


def test_a_sweep_of_two_detectors_measures_what_a_sweep_of_each_does(two, swept, tmp_path):
    frames, results = swept
    for name, assembly in two.items():
        alone = SweepResult()
        sweep.run_sweep(assembly, SETTINGS, tmp_path, alone, quiet=True)
        assert rows(alone) == rows(results[name]) and len(alone.records) == 14
        assert alone.numerical_error == results[name].numerical_error
        for path in tmp_path.glob("*.exr"):
            one, other = read_field(path), read_field(frames / f"{path.stem}.{name}.exr")
            assert np.array_equal(one.measured, other.measured)
            assert what_was_done(one.header) == what_was_done(other.header)


def test_a_camera_takes_two_pictures_of_a_target_that_has_not_moved(swept):
    frames, results = swept
    for name in ("near", "bare"):
        rest, again = (read_field(frames / f"seed0_{kind}.{name}.exr") for kind in ("reference", "x_001"))
        assert np.array_equal(rest.intensity, again.intensity)
        assert np.array_equal(rest.measured, again.measured) == (name == "bare")
    still = [r for r in results["near"].records if r.dof == "x" and r.displacement == 0]
    assert all(record.ncc < 1 and record.sigma_u_um > 0 for record in still)


def test_a_sweep_goes_on_from_finished_frames_whose_images_are_there(two, swept, tmp_path):
    _, whole = swept
    arguments = {"settings": SETTINGS, "frames": tmp_path, "quiet": True}
    with Journal(tmp_path / "jobs") as done:
        first = {name: SweepResult() for name in two}
        sweep.run_sweeps(two, results=first, done=done, **arguments)
        count = len(done)
    before = {path.name: (path.stat().st_mtime_ns, read_field(path).field) for path in tmp_path.glob("*.exr")}
    (tmp_path / "seed1_ry_002.bare.exr").unlink()  # interrupted between the two
    damaged = tmp_path / "seed0_x_002.near.exr"
    damaged.write_bytes(damaged.read_bytes()[:-500])
    results = {name: SweepResult() for name in two}
    with Journal(tmp_path / "jobs") as done:
        sweep.run_sweeps(two, results=results, done=done, **arguments)
        assert len(done) == count == 14
    assert {name: rows(result) for name, result in results.items()} == {n: rows(r) for n, r in whole.items()}
    assert all(np.array_equal(results[name].example, whole[name].example) for name in two)
    after = {path.name: (path.stat().st_mtime_ns, read_field(path).field) for path in tmp_path.glob("*.exr")}
    assert before.keys() == after.keys()
    written = {name for name in before if before[name][0] != after[name][0]}
    assert written == {f"{name}.{detector}.exr" for name in ("seed1_ry_002", "seed0_x_002") for detector in two}
    assert all(np.array_equal(before[name][1], after[name][1]) for name in before)


def test_frames_of_another_camera_are_not_gone_on_from(two, swept, load, tmp_path):
    frames, _ = swept
    other = assemblies_from_scene(load(scene("", "near", "bare").replace("300", "301")))
    first = next(sweep.frames_of_sweep(SETTINGS))
    keys = set()
    for assemblies, there in ((two, True), (other, False)):
        keys.add(Job(Work(FrameMeasurement, SweptScene.of(assemblies, 24)), first.task).key)
        with KeptImages(frames, assemblies, "all", None) as images:
            assert images.are_there(first.name, first.task, True) is there
    assert len(keys) == 2


@pytest.mark.parametrize("keep, kept", [("none", 0), ("first", 14), ("all", 28)])
def test_images_stay_as_asked_and_rows_whatever_stays(two, swept, tmp_path, keep, kept):
    results = {name: SweepResult() for name in two}
    with Journal(tmp_path / "jobs") as done:
        sweep.run_sweeps(two, SETTINGS, tmp_path, results, quiet=True, done=done, keep=keep)
        assert len(list(tmp_path.glob("*.exr"))) == kept and len(done) == 14
    assert {name: rows(result) for name, result in results.items()} == {n: rows(r) for n, r in swept[1].items()}


# Programs


def test_a_program_has_all_detectors_of_a_scene_file(mitsuba):
    import speckle_mi as smi

    given = {"width": 64, "height": 48, "point_sources": 40}
    both = smi.Simulations(smi.load_detectors(SCENE, **given))
    frames = both.frames(smi.Pose(z=0.01))
    assert list(frames) == ["left", "right"] and frames["left"].image.measured.max() <= 255
    with pytest.raises(SceneError, match="load_detectors"):
        smi.load_scene(SCENE, **given)


# Commands


def test_render_writes_a_file_for_each_detector(tmp_path):
    done = run("render", SCENE, "-o", "f.exr", "--sources", "f.npz", "--images", "png", *SMALL, cwd=tmp_path)
    assert done.returncode == DONE, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        f"f.{name}.{kind}" for name in ("left", "right") for kind in ("exr", "npz", "png")
    )
    alone = run("render", SCENE, "-o", "f.exr", "--detector", "right", *SMALL, cwd=tmp_path)
    assert alone.returncode == DONE, alone.stderr
    one, other = read_field(tmp_path / "f.exr"), read_field(tmp_path / "f.right.exr")
    assert np.array_equal(one.field, other.field) and np.array_equal(one.dn, other.dn)
    refused(run("render", SCENE, "-o", "f.exr", "--detector", "up", *SMALL, cwd=tmp_path), "'up'", "'left', 'right'")
    mine = tmp_path / "g.right.png"
    mine.write_text("a drawing")
    refused(run("render", SCENE, "-o", "g.exr", "--images", "png", *SMALL, cwd=tmp_path), "g.right.png", "--force")
    assert mine.read_text() == "a drawing" and not list(tmp_path.glob("g.*.exr"))


@pytest.fixture(scope="module")
def commanded(tmp_path_factory):
    """A sweep and sensitivities of both cameras, by the commands."""
    folder = tmp_path_factory.mktemp("commanded")
    asked = ["--dof", "x,z", "--seeds", "2", *SMALL]
    steps = ["--range", "0.05", "--steps", "3", "--images", "tiff"]
    done = run("sweep", SCENE, *asked, *steps, "--out", "out", cwd=folder)
    assert done.returncode == DONE, done.stderr
    done = run("sensitivity", SCENE, *asked, "--out", "s.json", cwd=folder)
    assert done.returncode == DONE, done.stderr
    return folder, done.stdout


def test_sweep_names_the_detector_in_its_table_and_summary(commanded):
    folder, _ = commanded
    with open(folder / "out" / "sweep.csv", newline="", encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert len(table) == 2 * 2 * (1 + 2 * 3) and [row["detector"] for row in table[:4]] == ["left", "right"] * 2
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert list(summary["detectors"]) == ["left", "right"] and "sensitivity" not in summary
    across, away = ([s["sensitivity"][dof]["u"] for s in summary["detectors"].values()] for dof in ("x", "z"))
    for entries, signs in ((across, (1, 1)), (away, (1, -1))):
        for entry, sign in zip(entries, signs, strict=True):
            assert ENTRY <= set(entry) and entry["theory"] * sign > 0
            assert entry["value"] == pytest.approx(entry["theory"], rel=0.1)
    for name, one in summary["detectors"].items():
        assert {"axes", "plan", "numerical_error", "decorrelation", "warnings", "scene", "identity"} <= set(one)
        assert {f"speckle.{name}.png", f"shift_x_u.{name}.png"} <= {p.name for p in (folder / "out").iterdir()}
        assert len(list((folder / "out" / "frames").glob(f"*.{name}.tiff"))) == 14


def test_shifts_of_a_sweep_are_those_of_the_pictures_it_saved(commanded):
    import tifffile

    from speckle_mi.measurement.compare import compare

    folder, _ = commanded
    with open(folder / "out" / "sweep.csv", newline="", encoding="utf-8") as file:
        row = next(r for r in csv.DictReader(file) if r["detector"] == "right" and r["dof"] == "z" and r["seed"] == "1")
    before, after = (
        tifffile.imread(folder / "out" / "frames" / f"seed1_{name}.right.tiff") for name in ("reference", "z_000")
    )
    assert before.dtype == np.uint8
    assert float(row["shift_u_um"]) == pytest.approx(compare(before, after, 0.02)["shift_u_um"], rel=1e-9)


def test_sensitivities_of_all_detectors_tell_motions_apart_that_one_cannot(commanded):
    folder, printed = commanded
    found = json.loads((folder / "s.json").read_text())
    assert list(found["detectors"]) == ["left", "right"]
    assert len(found["observability"]["singular_values"]) == 2 and found["observability"]["condition"] < 3
    assert not found["observability"]["unseen"]
    assert "condition number" in printed and "detector right" in printed
    one = found["detectors"]["left"]
    assert one["sensitivity"]["z"]["u"]["value"] == pytest.approx(0.5, abs=0.01)  # the sine of 30 degrees


@pytest.mark.parametrize("summary", ["s.json", "out/summary.json"])
def test_pose_takes_a_summary_of_several_detectors_by_their_ids(commanded, summary):
    folder, _ = commanded
    sensitivity = json.loads((folder / summary).read_text())["detectors"]
    motion = {"x": 0.004, "z": -0.01}
    table = [
        {"detector": name, **{f"shift_{axis}_um": 1e3 * sum(
            one["sensitivity"][dof][axis]["value"] * size for dof, size in motion.items()) for axis in "uv"}}
        for name, one in reversed(sensitivity.items())
    ]  # fmt: skip
    with open(folder / "shifts.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, table[0])
        writer.writeheader()
        writer.writerows(table)
    done = run("pose", summary, "shifts.csv", "--dof", "x,z", "--out", "m.json", cwd=folder)
    assert done.returncode == DONE, done.stderr
    assert json.loads((folder / "m.json").read_text())["motions"][0]["motion"] == pytest.approx(motion, rel=1e-6)


def test_a_command_for_one_detector_says_how_to_choose_it(tmp_path):
    refused(run("converge", SCENE, "--out", "c", cwd=tmp_path), "'left', 'right'", "--detector")
    bare = str(SCENES / "tilted_laser.xml")
    refused(run("render", bare, "-o", "f.exr", "--images", "png", cwd=tmp_path), "--images", "bit_depth")
    assert not list(tmp_path.iterdir())


def test_a_world_of_one_detector_has_no_name_in_its_files(load, tmp_path):
    assembly = assembly_from_scene(load(scene("", "bare")))
    result = SweepResult()
    sweep.run_sweep(assembly, SweepSettings(("x",), np.array([-0.01, 0.01]), (0,), 24), tmp_path, result, quiet=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "seed0_reference.exr", "seed0_x_000.exr", "seed0_x_001.exr",
    ]  # fmt: skip
