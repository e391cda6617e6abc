"""Sensitivities from one frame: derivative fields, the pattern's velocity, its boiling, and what the command says."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from derivative_scenes import DERIVATIVE_TOLERANCE, compared, judged
from interval_coverage import LEAST, MOST, coverage
from scene_builder import (
    detector_frame,
    detector_xml,
    direction,
    frame_along,
    free_space,
    integrator_xml,
    laser_xml,
    scene_of,
    target_xml,
)
from scipy import stats
from test_commands import DONE, refused, run

from speckle_mi import Pose, theory
from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.experiments.one_frame import OneFrame, sampled_pixels, sensitivity_of
from speckle_mi.experiments.precision import Precision
from speckle_mi.field.derivatives import EVERY_PAIR, LOOSEST
from speckle_mi.geometry.plane import PlaneGrid
from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM
from speckle_mi.measurement.velocity import Flow, half_correlation

STANDARD_ERRORS = 4.0
RELATIVE = 0.01
"""First-order theory holds within this part of a motion's sensitivity, or within so many standard errors."""

SAMPLED_SCENES = (0, 3, 6, 1, 5)
"""Of the random scenes, a run of the tests; ``python tests/derivative_scenes.py`` judges all."""

LOBE = '<bsdf type="roughconductor"><float name="alpha" value="0.4"/></bsdf>'


@pytest.fixture(scope="module")
def simulate(mitsuba):
    from speckle_mi.field.simulation import Simulation

    return Simulation


@pytest.mark.parametrize("number", SAMPLED_SCENES)
def test_derivative_fields_are_the_central_differences_of_rendered_fields(mitsuba, number):
    differences = judged(number)
    assert max(differences.values()) < DERIVATIVE_TOLERANCE, differences


@pytest.mark.parametrize("laser", [{}, {"beam_radius": np.inf, "wavefront_radius": 40.0}], ids=["Gaussian", "uniform"])
def test_derivatives_hold_with_a_lobe_and_with_uniform_light(assemble, laser):
    values = {"point_sources": 60, "width": 0.3, "height": 0.3, "bsdf": LOBE, "lobe": True}
    detector = {"width": 20, "height": 16, "pixel_pitch": 0.05}
    laser = {name: value for name, value in laser.items() if np.isfinite(value)} | (
        {"beam_radius": None} if laser else {}
    )
    scene = free_space(direction(20, 10), direction(-15), target=values, detector=detector, laser=laser)
    differences = compared(assemble(scene))
    assert max(differences.values()) < DERIVATIVE_TOLERANCE, differences


def test_a_pattern_that_moves_unchanged_has_its_velocity_and_does_not_boil():
    flow = _flow(boiling=0.0)
    found = flow.velocity(1)
    np.testing.assert_allclose(found.value, [[0.7, -0.3]], atol=1e-9)
    assert found.boiling[0] < 1e-12


def test_a_pattern_that_turns_and_spreads_has_the_velocity_of_its_middle():
    flow = _flow(boiling=0.0)
    x, y = flow.places.T
    turning = -(0.7 + 0.2 * x - 0.4 * y) * flow.slopes[0] - (-0.3 + 0.4 * x + 0.1 * y) * flow.slopes[1]
    found = replace(flow, change=turning[None]).velocity(1)
    np.testing.assert_allclose(found.value, [[0.7, -0.3]], atol=1e-9)


def test_boiling_tells_the_curvature_of_the_correlation():
    """Of E and E + q F, F an independent pattern of the strength s, intensities correlate by 1/(1 + s^2 q^2)."""
    strength, patterns = 0.8, 30
    curvature = [_flow(strength, seed).velocity(1).curvature[0] for seed in range(patterns)]
    error = np.std(curvature, ddof=1) / np.sqrt(patterns)
    fitted_away = 0.03 * strength**2  # eight numbers from some three hundred speckles
    assert abs(np.mean(curvature) - strength**2) < STANDARD_ERRORS * error + fitted_away
    assert error < 0.05 * strength**2
    assert half_correlation(np.log(2)) == pytest.approx(1.0)


def test_the_covariance_is_that_of_repeated_patterns():
    """Over independent patterns the velocity scatters as each one says of itself, to the accuracy of 60 of them."""
    found = [_flow(0.8, seed).velocity(1) for seed in range(60)]
    scatter = np.var([one.value[0] for one in found], axis=0)
    own = np.mean([np.diag(one.covariance[0]) for one in found], axis=0)
    np.testing.assert_allclose(own, scatter, rtol=0.6)
    assert abs(np.mean([one.value[0, 0] for one in found]) - 0.7) < STANDARD_ERRORS * np.sqrt(scatter[0] / len(found))


def _flow(boiling: float, seed: int = 0) -> Flow:
    """A Gaussian random field of plane waves that moves by (0.7, -0.3) per unit and boils."""
    random = np.random.default_rng(seed)
    waves = 300
    k = 2 * np.pi * 5.0 * random.normal(size=(waves, 2))
    amplitude, other = (random.normal(size=(2, waves, 2)) @ [1, 1j]) / np.sqrt(2 * waves)
    side = (np.arange(40) + random.random((40, 40))) / 40 - 0.5
    places = np.stack([side.ravel(), ((np.arange(40)[:, None] + random.random((40, 40))) / 40 - 0.5).ravel()], axis=1)
    phasors = np.exp(1j * places @ k.T)
    field, along = phasors @ amplitude, np.array([phasors @ (1j * k[:, axis] * amplitude) for axis in (0, 1)])
    change = -(0.7 * along[0] - 0.3 * along[1]) + boiling * phasors @ other
    return Flow.of(field, change[None], along, places)


@pytest.mark.parametrize("name", ["tilted_laser", "tilted_detector", "both_tilted", "folded"])
def test_one_frame_agrees_with_theory_for_all_motions(shipped, simulate, name):
    require_theory(simulate(shipped(name)), seeds=12)


@pytest.mark.parametrize("name", ["imaging", "telecentric", "ball_lens"])
def test_one_frame_agrees_with_theory_behind_lenses(shipped, simulate, name):
    require_theory(simulate(shipped(name, **SMALL[name])), seeds=3)


SMALL = {
    "imaging": {"width": 60, "height": 60, "beam_radius": 0.05, "point_sources": 600},
    "telecentric": {"width": 40, "height": 40, "beam_radius": 0.035, "point_sources": 300},
    "ball_lens": {"width": 48, "height": 48, "beam_radius": 0.024, "point_sources": 600},
}
"""The shipped scenes with a small spot: several scatterers in what the lens resolves, as theory takes for granted.

Of single scatterers a lens makes single points, which no tilt moves."""


def require_theory(simulation, seeds: int, dofs: tuple[str, ...] = DEGREES_OF_FREEDOM) -> None:
    measurement = OneFrame(simulation)
    measurement.measure(range(seeds))
    found = sensitivity_of(simulation, measurement.result, dofs)
    # Of few surfaces, their scatter is not known well: what their own speckles say counts as well.
    own = np.sqrt(np.mean([np.trace(one.covariance, axis1=1, axis2=2) for one in measurement.result.linear], axis=0))
    for dof, fitted in found.fits.items():
        size = np.hypot(fitted["u"].theory, fitted["v"].theory)
        speckles = own[DEGREES_OF_FREEDOM.index(dof)] * (np.pi / 180 if dof.startswith("r") else 1.0)
        for axis in "uvxy":
            error = max(found.scatter[dof][axis], speckles) / np.sqrt(seeds)
            allowed = max(RELATIVE * size, STANDARD_ERRORS * error)
            assert abs(fitted[axis].bias) <= allowed, (dof, axis, fitted[axis])


def test_decorrelation_is_that_of_the_material_s_motion_across_the_beam(shipped, simulate):
    """Half of the correlation is lost after w sqrt(ln 2) across the beam; in the plane of incidence 1/cos later."""
    simulation = simulate(shipped("tilted_laser"))
    measurement = OneFrame(simulation)
    measurement.measure(range(6))
    length = sensitivity_of(simulation, measurement.result, ("x", "y", "z")).decorrelation_length
    half = simulation.assembly.beam.radius * np.sqrt(np.log(2))
    angle = np.radians(35)
    for dof, expected in (("x", half / np.cos(angle)), ("y", half), ("z", half / np.sin(angle))):
        assert length[dof] == pytest.approx(expected, rel=0.05)


def test_intervals_hold_theory_as_often_as_they_say(shipped, simulate):
    """95 % intervals of 25 repetitions of four surfaces, all motions; the entries of one are not independent.

    ``python tests/interval_coverage.py`` judges every entry alone, by 200 repetitions.
    """
    found = coverage(simulate(shipped("tilted_laser")), 25)
    assert len(found) == 12
    assert LEAST <= np.mean(list(found.values())) <= MOST
    rotations = [share for (dof, _), share in found.items() if dof in ("rx", "rz")]
    assert LEAST <= np.mean(rotations) < 1.0, "numerical error is no part of them that is seen"


@pytest.mark.parametrize("name, defaults, error", [("tilted_laser", {}, EVERY_PAIR), ("ball_lens", {
    "width": 16, "height": 16, "beam_radius": 0.012, "point_sources": 100}, LOOSEST)])  # fmt: skip
def test_intervals_hold_the_error_that_fields_are_computed_to(shipped, simulate, name, defaults, error):
    """That of a pass over all pairs in free space, and the tolerance behind elements."""
    simulation = simulate(shipped(name, **defaults))
    measurement = OneFrame(simulation)
    measurement.measure(range(2))
    assert measurement.result.error == error
    size, entries = {}, {}
    for factor in (1.0, 1e4):
        fits = sensitivity_of(simulation, replace(measurement.result, error=factor * error), ("x",)).fits["x"]
        entries[factor], size[factor] = np.ptp(fits["u"].ci95) / 2, np.hypot(fits["u"].value, fits["v"].value)
    wanted = np.sqrt(entries[1.0] ** 2 + (1e8 - 1) * (error * size[1.0]) ** 2)
    assert entries[1e4] == pytest.approx(wanted, rel=0.05)


def test_pixels_are_sampled_one_a_cell_whatever_the_size_of_the_detector():
    grid = PlaneGrid(np.zeros(3), np.eye(3)[0], np.eye(3)[1], 0.01, (480, 744))
    pixels = sampled_pixels(grid, 1500)
    assert len(np.unique(pixels)) == len(pixels) == pytest.approx(1500, rel=0.05)
    rows, columns = np.divmod(pixels, 744)
    counts = np.histogram2d(rows, columns, bins=(4, 4))[0]
    assert counts.min() > 0.8 * counts.mean()
    few = PlaneGrid(np.zeros(3), np.eye(3)[0], np.eye(3)[1], 0.01, (3, 5))
    assert len(sampled_pixels(few, 1500)) == 15


def test_expected_and_measured_sensitivities_have_the_same_units(shipped, simulate):
    simulation = simulate(shipped("tilted_laser"))
    found = simulation.derivatives(np.array([0, 5000]))
    per_degree = theory.per_degree(np.ones((1, 6)))[0]
    assert found.by_motion.shape == (6, 2) and found.along.shape == (2, 2)
    assert per_degree[3] == pytest.approx(np.pi / 180)
    assert expected_sensitivity(simulation.assembly)["u"][4] == pytest.approx(1.905, rel=1e-3)


def test_derivatives_are_of_the_frame_s_own_field(shipped, simulate):
    simulation = simulate(shipped("tilted_laser", width="60", height="40"))
    pixels = np.arange(0, 2400, 17)
    frame = simulation.frame(Pose(), 3).image.field.ravel()[pixels]
    assert np.linalg.norm(simulation.derivatives(pixels, 3).field - frame) < 1e-4 * np.linalg.norm(frame)


def test_rays_have_no_derivatives_and_say_so(shipped, simulate):
    from speckle_mi.errors import InputError

    assembly = shipped("tilted_laser").with_options(method="rays")
    with pytest.raises(InputError, match="method 'rays' has no derivatives"):
        simulate(assembly).derivatives(np.array([0]))


# Precision


@pytest.mark.parametrize(
    "text, expected",
    [
        ("1%", Precision(relative=0.01)),
        ("0.01mm/mm", Precision(per_mm=0.01)),
        ("2%, 0.02mm/deg", Precision(relative=0.02, per_degree=0.02)),
    ],
)
def test_precision_is_read_with_its_unit(text, expected):
    assert Precision.parse(text) == expected


@pytest.mark.parametrize("text", ["", "1", "0%", "-1%", "nan%", "1mm", "1%,2%", "x%"])
def test_what_is_no_precision_is_refused(text):
    from speckle_mi.errors import InputError

    with pytest.raises(InputError, match="--precision"):
        Precision.parse(text)


# The command


def test_the_command_writes_the_names_of_a_summary(tmp_path):
    from conftest import SCENES

    done = run("sensitivity", str(SCENES / "tilted_laser.xml"), "--dof", "x,ry", "--seeds", "3", "--precision", "8%",
               "--out", "found.json", cwd=tmp_path)  # fmt: skip
    assert done.returncode == DONE, done.stderr
    assert "On the detector" in done.stdout and "Projected on the target's axes" in done.stdout
    summary = json.loads((tmp_path / "found.json").read_text())
    assert {"axes", "sensitivity", "boiling", "decorrelation_length", "seconds", "plan"} <= summary.keys()
    entry = summary["sensitivity"]["x"]["u"]
    assert {"value", "ci95", "theory", "bias", "scatter_um", "unit"} <= entry.keys()
    assert entry["unit"] == "mm/mm" and abs(entry["value"] - entry["theory"]) < 0.1
    widths = [np.ptp(summary["sensitivity"]["x"][axis]["ci95"]) / 2 for axis in "uv"]
    assert max(widths) <= 0.08 * abs(entry["value"])
    assert summary["sensitivity"]["x"]["cog_u"]["value"] is None


@pytest.mark.parametrize(
    "flags, said",
    [
        (("--dof", "q"), "--dof 'q'"),
        (("--seeds", "0"), "--seeds 0"),
        (("--precision", "3mm"), "--precision '3mm'"),
        (("--seeds", "1", "--precision", "1%"), "--seeds 1"),
        (("--range", "0"), "--range 0"),
        (("--out", "x.txt"), "x.txt"),
    ],
)
def test_the_command_says_in_one_line_what_is_wrong(tmp_path, flags, said):
    from conftest import SCENES

    done = run("sensitivity", str(SCENES / "tilted_laser.xml"), *flags, cwd=tmp_path)
    refused(done, said)


@pytest.mark.parametrize(
    "scene, dofs, width, defaults",
    [
        ("tilted_laser", "x,y,z,rx,ry,rz", 0.01, {}),
        ("folded", "x,y,z,rx,ry,rz", 0.01, {}),
        ("imaging", "x,ry", 0.004, {"width": 248, "height": 160}),
    ],
)
def test_one_frame_says_what_a_sweep_of_small_range_measures(tmp_path, scene, dofs, width, defaults):
    """Entries along u and v, those that are 0 included: within 1 % of the motion's largest, or chance."""
    from conftest import SCENES

    summaries = []
    for command, flags, out in (
        ("sweep", ("--range", str(width), "--steps", "2", "--seeds", "4", "--keep", "none", "--out", "swept"),
         "swept/summary.json"),
        ("sensitivity", ("--seeds", "8", "--out", "frame.json"), "frame.json"),
    ):  # fmt: skip
        given = [f"-D{name}={value}" for name, value in defaults.items()]
        done = run(command, str(SCENES / f"{scene}.xml"), *given, "--dof", dofs, *flags, cwd=tmp_path)
        assert done.returncode == DONE, done.stderr
        summaries.append(json.loads((tmp_path / out).read_text())["sensitivity"])
    swept, found = summaries
    for dof in swept:
        largest = max(abs(found[dof][axis]["value"]) for axis in "uv")
        for axis in "uv":
            errors = [np.ptp(one[dof][axis]["ci95"]) / 2 / quantile
                      for one, quantile in ((swept, stats.t.ppf(0.975, 3)), (found, stats.t.ppf(0.975, 7)))]  # fmt: skip
            difference = abs(swept[dof][axis]["value"] - found[dof][axis]["value"])
            assert difference < max(0.01 * largest, 4 * np.hypot(*errors)), (dof, axis, difference, errors)


def test_a_program_asks_for_sensitivities_in_one_line(shipped, simulate):
    import speckle_mi

    assembly = shipped("tilted_laser")
    found = speckle_mi.one_frame_sensitivity(assembly, ("ry",), surfaces=3)
    assert found.fits["ry"]["u"].value == pytest.approx(found.fits["ry"]["u"].theory, rel=1e-3)
    same = speckle_mi.Simulation(assembly).sensitivity(("ry",), surfaces=3)
    assert same.fits["ry"]["u"].value == found.fits["ry"]["u"].value


@pytest.mark.parametrize(
    "flags, said", [(("--seeds", "3"), "--seeds 3"), (("--precision", "1%"), "one surface"), ((), "")]
)
def test_the_user_s_own_points_are_one_surface_with_an_interval_of_its_speckles(tmp_path, flags, said):
    places = np.random.default_rng(0).uniform(-0.1, 0.1, (200, 2))
    np.savetxt(tmp_path / "points.csv", np.column_stack([places, np.zeros(200)]), delimiter=",")
    scene = free_space(direction(20), target={"points": "points.csv"}, detector={"width": 300, "height": 200})
    (tmp_path / "scene.xml").write_text(scene)
    done = run("sensitivity", "scene.xml", "--out", "found.json", *flags, cwd=tmp_path)
    if said:
        refused(done, said)
        return
    entry = json.loads((tmp_path / "found.json").read_text())["sensitivity"]["x"]["u"]
    assert entry["basis"] == "residuals" and entry["ci95"][0] < entry["theory"] < entry["ci95"][1]


def test_a_dark_detector_is_refused(tmp_path):
    place = frame_along(-direction(20), 50 * direction(20) + np.array([30.0, 0, 0]))
    scene = scene_of(integrator_xml(), laser_xml(place), target_xml(), detector_xml(detector_frame(direction(0), 60.0)))
    (tmp_path / "dark.xml").write_text(scene)
    refused(run("sensitivity", "dark.xml", cwd=tmp_path), "no light reaches the detector")
