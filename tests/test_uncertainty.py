"""What tolerances do to sensitivities: against the first-order formula, and back from an allowance to tolerances."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from conftest import SCENES
from scipy import stats
from test_commands import DONE, refused, run

from speckle_mi.studies.variance import probabilities, spread_of

SCENE = str(SCENES / "tilted_laser.xml")
SMALL = {"width": 32, "height": 24, "pixel_pitch": 0.1}
"""A detector of the same size with fewer pixels, of which all are looked at."""

OVER_SPOT = 3e-5
"""Relative difference of theory, which looks at all of the spot, from the closed form of its middle."""

LINEAR = 0.03
"""Relative difference from linear propagation that is allowed of small tolerances."""

INDEX = 0.05
"""Difference of a Sobol index from its exact value that is allowed."""


def exact(angle, distance, radius):
    """Sensitivities of the tilted laser by the closed forms of free space; angle [deg], lengths [mm]."""
    angle = np.radians(angle)
    along = np.cos(angle)
    return {
        "x.u": 1 + distance / radius * along**2,
        "y.v": -(1 + distance / radius),
        "z.u": distance / radius * along * np.sin(angle),
        "ry.u": distance * (1 + along) * np.pi / 180,
        "rz.v": distance * np.sin(angle) * np.pi / 180,
    }


def test_indices_of_a_function_with_known_ones():
    a, b = 7.0, 0.1
    drawn = probabilities(512, [1, 1, 1], seed=1)
    x = np.pi * (2 * drawn - 1)
    values = np.sin(x[..., 0]) + a * np.sin(x[..., 1]) ** 2 + b * x[..., 2] ** 4 * np.sin(x[..., 0])
    found = spread_of(values[None, ..., None], drawn, [1, 1, 1])
    first, second = 0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8
    both = b**2 * np.pi**8 * 8 / 225
    variance = first + second + both
    assert found.variance[0] == pytest.approx(variance, rel=0.03)
    np.testing.assert_allclose(found.first_order[:, 0] * variance, [first, second, 0], atol=INDEX * variance)
    np.testing.assert_allclose(found.total[:, 0] * variance, [first + both, second, both], atol=INDEX * variance)


def test_noise_of_surfaces_is_no_part_of_the_variance():
    drawn = probabilities(256, [1, 1])
    values = stats.norm.ppf(drawn) @ np.array([2.0, 1.0])
    noise = np.random.default_rng(3).normal(size=(2, *values.shape)) * 3
    found = spread_of((values + noise)[..., None], drawn, [1, 1])
    assert abs(found.variance[0] - 5) < 3 * found.variance_error[0]
    with_noise = values + noise[0]
    assert np.var(with_noise) > 12, "noise of one surface alone would count"
    assert abs(found.first_order[0, 0] - 0.8) < 3 * found.first_order_error[0, 0]


@pytest.fixture(scope="module")
def propagated(mitsuba):
    """Results of the tilted laser by tolerances."""
    from speckle_mi import propagate_tolerances
    from speckle_mi.studies.uncertainty import UncertaintySettings

    def propagated(tolerances, samples, frames=0):
        return propagate_tolerances(SCENE, tolerances, UncertaintySettings(samples, on_samples=frames), **SMALL)

    return propagated


def test_small_tolerances_propagate_linearly_through_the_first_order_formula(propagated):
    sizes = {"laser_angle": 0.1, "detector_distance": 0.05, "wavefront_radius": 10.0}
    kinds = {"laser_angle": ("normal", 1.0), "detector_distance": ("triangular", 6**-0.5),
             "wavefront_radius": ("uniform", 3**-0.5)}  # fmt: skip
    result = propagated({name: {kinds[name][0]: size} for name, size in sizes.items()}, 160, frames=2)
    middle, step = {"laser_angle": 35.0, "detector_distance": 60.0, "wavefront_radius": -750.0}, 1e-4
    for name, value in exact(*middle.values()).items():
        entry = result.entries[name]
        slopes = [
            (exact(*{**middle, one: middle[one] + step}.values())[name] - value) / step * sizes[one] * kinds[one][1]
            for one in sizes
        ]
        combined = math.hypot(*slopes)
        assert entry.nominal == pytest.approx(value, rel=OVER_SPOT) and entry.basis == "theory"
        assert entry.deviation == pytest.approx(combined, rel=LINEAR)
        assert entry.linear_deviation == pytest.approx(combined, rel=LINEAR)
        for one, slope in zip(sizes, slopes, strict=True):
            assert entry.linear[one] == pytest.approx(slope, abs=LINEAR * combined)
            assert entry.first_order[one][0] == pytest.approx((slope / combined) ** 2, abs=INDEX)
            assert entry.total[one][0] == pytest.approx((slope / combined) ** 2, abs=INDEX)
        low, high = entry.interval
        assert (high - low) / 2 == pytest.approx(1.96 * combined, rel=0.2)
    for name in ("ry.u", "rz.v"):  # of tilts frames have little scatter: they show the same
        frames, error = result.entries[name].frames
        assert frames == pytest.approx(result.entries[name].deviation, abs=3 * error) and error < 0.2 * frames
    assert result.entries["ry.u"].first_to_tighten[0] == "laser_angle"


def test_wavefront_radius_near_focus_has_the_indices_of_the_closed_form(propagated):
    bounds = (-75.0, -5.0)
    tolerances = {"wavefront_radius": {"bounds": list(bounds)}, "laser_angle": {"normal": 4.0},
                  "detector_distance": {"uniform": 20.0}}  # fmt: skip
    result = propagated(tolerances, 640)
    drawn = probabilities(1 << 14, [1, 1, 1], seed=5)
    radius = bounds[0] + (bounds[1] - bounds[0]) * drawn[..., 0]
    angle = 35 + 4 * stats.norm.ppf(drawn[..., 1])
    values = exact(angle, 60 + 20 * (2 * drawn[..., 2] - 1), radius)
    for name in ("x.u", "y.v", "z.u", "rz.v"):
        wanted = spread_of(values[name][None, ..., None], drawn, [1, 1, 1])
        entry = result.entries[name]
        assert entry.deviation == pytest.approx(wanted.deviation[0], rel=0.06)
        for number, one in enumerate(tolerances):
            assert entry.first_order[one][0] == pytest.approx(wanted.first_order[number, 0], abs=INDEX)
            assert entry.total[one][0] == pytest.approx(wanted.total[number, 0], abs=INDEX)
    assert result.entries["x.u"].linear_deviation < 0.7 * result.entries["x.u"].deviation, "far from linear"


def test_correlated_numbers_are_one_factor_and_may_cancel(propagated):
    # y.v depends on the ratio of these two alone.
    sizes = {"detector_distance": 0.06, "wavefront_radius": 0.75}
    tables = {name: {"normal": size} for name, size in sizes.items()}
    alone = propagated(tables, 24).entries["y.v"]
    tables |= {"correlated": [{"parameters": list(sizes), "coefficient": -0.999}]}
    together = propagated(tables, 24).entries["y.v"]
    assert list(together.total) == ["detector_distance + wavefront_radius"]
    assert together.linear_deviation == pytest.approx(alone.linear_deviation * math.sqrt(0.001), rel=0.05)
    assert together.deviation == pytest.approx(together.linear_deviation, rel=0.1)


def test_a_tolerance_that_matters_by_its_square_has_its_width_by_sampling(mitsuba, tmp_path):
    from speckle_mi.machine.journal import Journal
    from speckle_mi.studies.design import Design
    from speckle_mi.studies.together import Hands
    from speckle_mi.studies.tolerances import tolerances_of
    from speckle_mi.studies.uncertainty import UncertaintySettings, UncertaintyStudy
    from speckle_mi.studies.widths import allowed_widths

    design = Design.of(SCENE, [(name, str(value)) for name, value in SMALL.items()])
    tables = {"detector.ry": {"normal": 6.0}, "allowed": {"ry.u": 0.02}}
    settings = UncertaintySettings(24, surfaces=2, on_samples=0)
    with Journal(tmp_path) as done:
        study = UncertaintyStudy(design, tolerances_of(tables, design.nominal()), settings, Hands(done=done))
        result = study.result()
        # Along u of a detector turned by b: 1/cos b = 1 + b^2/2 of 1.905 mm/deg, deviation 1.905 sqrt(2)/2 s^2.
        wanted = math.sqrt(0.02 / (1.905 * math.sqrt(0.5))) * 180 / math.pi
        assert result.entries["ry.u"].linear_deviation < 1e-6
        assert allowed_widths(study, result).alone["detector.ry"] == pytest.approx(wanted, rel=0.06)


def test_a_variant_is_swept_as_a_sensor_is(mitsuba):
    from speckle_mi import Simulations, load_detectors
    from speckle_mi.studies.swept import swept_sensitivities

    simulations = Simulations(load_detectors(SCENE, width=64, height=48, pixel_pitch=0.02))
    measured, curvature, doubt, _ = swept_sensitivities(simulations, [3], np.array([-0.01, 0.01]))
    wanted = exact(35, 60, -750)
    assert measured.shape == (1, 1, 6, 6) and curvature.shape == (1, 1, 6) and doubt.shape == (1, 6, 6)
    for place, name in (((0, 0, 0, 4), "ry.u"), ((0, 0, 1, 5), "rz.v")):
        assert measured[place] == pytest.approx(wanted[name], rel=0.01)
    assert measured[0, 0, 0, 0] == pytest.approx(wanted["x.u"], abs=0.2)  # of one surface


def test_a_compensator_takes_off_what_it_is_adjusted_for(propagated):
    tables = {"detector_distance": {"normal": 0.5}}
    adjusted = {"parameter": "wavefront_radius", "bounds": [-900, -600], "condition": "y.v"}
    result = propagated({**tables, "compensator": [adjusted]}, 24)
    assert result.entries["y.v"].deviation < 1e-8 and result.entries["rz.v"].deviation > 1e-3
    sample = result.samples[5]
    # y.v = -(1 + L_O/L_S) stays if the radius goes with the distance.
    wanted = -750 / 60 * sample.values["detector_distance"]
    assert sample.found.adjusted[0] == pytest.approx(wanted, rel=1e-6)


def test_a_displaced_part_is_the_part_that_stands_there(mitsuba):
    from speckle_mi.studies.design import Design

    design = Design.of(SCENE)
    (by_default,) = design.assemblies({"detector_distance": 60.5}).values()
    (displaced,) = design.assemblies({"detector.z": -0.5}).values()  # its own axis looks at the target
    np.testing.assert_allclose(displaced.detector.centre, by_default.detector.centre, atol=1e-9)
    (turned,) = design.assemblies({"detector.ry": 2.0}).values()
    assert turned.detector.u @ by_default.detector.u == pytest.approx(math.cos(math.radians(2)), abs=1e-12)
    (converging,) = design.assemblies({"laser.wavefront_radius": -700.0}).values()
    (wanted,) = design.assemblies({"wavefront_radius": -700.0}).values()
    assert converging == wanted != by_default
    (lowered,) = design.assemblies({"target.z": 0.25}).values()
    assert lowered.target.frame.origin[2] == pytest.approx(0.25) and lowered.spot.point[2] == pytest.approx(0.25)


TOLERANCES = """
[laser_angle]
normal = 0.1
[wavefront_radius]
uniform = 20
[detector.ry]
triangular = 0.5
[allowed]
"z.u" = 0.0005
"""
FEW = ("-D", "width=32", "-D", "height=24", "-D", "pixel_pitch=0.1", "--samples", "80")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("uncertainty")
    (folder / "T.toml").write_text(TOLERANCES, encoding="utf-8")
    done = run("uncertainty", SCENE, "--tolerances", "T.toml", *FEW, "--out", "out", cwd=folder)
    assert done.returncode == DONE, done.stderr
    assert "How wide tolerances may be" in done.stdout and "wavefront_radius" in done.stdout
    return folder


def test_tolerances_for_an_allowance_give_the_allowance_back(folder):
    done = run("uncertainty", SCENE, "--tolerances", "out/allowed.toml", *FEW, "--out", "again", "--quiet", cwd=folder)
    assert done.returncode == DONE, done.stderr
    found = json.loads((folder / "again" / "uncertainty.json").read_text())
    entry = found["sensitivity"]["z"]["u"]
    assert entry["standard_uncertainty"] == pytest.approx(0.0005, rel=0.05)
    shares = entry["total"]
    assert shares["laser_angle"] == pytest.approx(shares["wavefront_radius"], abs=0.1)
    first = json.loads((folder / "out" / "uncertainty.json").read_text())
    assert first["inverse"]["together"]["uncertainty"]["z.u"] == pytest.approx(0.0005, rel=0.01)
    # Alone: all others as given, the wavefront radius takes what they leave.
    by_angle = first["sensitivity"]["z"]["u"]["linear"]["contributions"]["laser_angle"]
    own = first["sensitivity"]["z"]["u"]["linear"]["contributions"]["wavefront_radius"]
    wanted = 20 * math.sqrt(0.0005**2 - by_angle**2) / abs(own)
    assert first["inverse"]["alone"]["wavefront_radius"] == pytest.approx(wanted, rel=1e-3)


def test_parts_of_the_uncertainty_stand_apart_in_the_results(folder):
    found = json.loads((folder / "out" / "uncertainty.json").read_text())
    entry = found["sensitivity"]["x"]["u"]
    parts = entry["parts"]
    assert parts["camera"] is None and parts["surfaces"] > 10 * parts["tolerances"]
    assert entry["combined"] == pytest.approx(math.hypot(parts["surfaces"], parts["tolerances"]))
    with open(folder / "out" / "samples.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == found["samples"] and {row["block"] for row in rows} >= {"A", "B", "laser_angle"}
    import xarray

    with xarray.open_dataset(folder / "out" / "results.nc") as data:
        place = {"detector": "detector", "motion": "z", "axis": "u"}
        told = found["sensitivity"]["z"]["u"]
        for name in ("standard_uncertainty", "nominal"):
            assert float(data[name].sel(place)) == pytest.approx(told[name])
        share = data["total"].sel(place).sel(factor="wavefront_radius")
        assert float(share) == pytest.approx(told["total"]["wavefront_radius"])
        of_rows = data["theory"].sel(place).values
        np.testing.assert_allclose(of_rows, [float(row["theory z.u"]) for row in rows])
        assert [str(one) for one in data["parameter"].values] == list(found["tolerances"])
        assert data["standard_uncertainty"].attrs["units"].startswith("mm/mm")
    assert {path.name for path in (folder / "out").glob("*.png")} == {"budget.png", "sobol.png"}


def test_a_study_that_is_done_again_does_nothing_twice(folder):
    held = (folder / "out" / "jobs" / "jobs.jsonl").stat()
    before = json.loads((folder / "out" / "uncertainty.json").read_text())
    done = run("uncertainty", SCENE, "--tolerances", "T.toml", *FEW, "--out", "out", "--quiet", cwd=folder)
    assert done.returncode == DONE, done.stderr
    assert (folder / "out" / "jobs" / "jobs.jsonl").stat().st_size == held.st_size
    after = json.loads((folder / "out" / "uncertainty.json").read_text())
    assert after["sensitivity"] == before["sensitivity"] and after["inverse"] == before["inverse"]
    other = run("uncertainty", SCENE, "--tolerances", "T.toml", *FEW[:-1], "160", "--out", "out", cwd=folder)
    refused(other, "holds results of other settings")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[laser_angel]\nnormal = 1", "laser_angel: the scene has no such number, must be one of wavelength, laser_angle"),
        ("[laser_angle]\nnormal = -1", "[laser_angle]: normal = -1: must be a number above 0"),
        ("[laser_angle]\ngaussian = 1", "must say exactly one of normal (a standard deviation), uniform"),
        ("[laser_angle]\nbounds = [3, 1]", "bounds = [3, 1]: must be two numbers [a, b], a below b"),
        ("", "holds no tolerance"),
        ("[laser_angle", "is no TOML file"),
        ("[laser_angle]\nnormal = 1\n[allowed]\n'z.w' = 1", "allowed z.w: must be one of the motions x, y, z, rx, ry, rz"),
        ("[laser_angle]\nnormal = 1\n[[correlated]]\nparameters = ['laser_angle', 'seed']\ncoefficient = 1",
         "seed: has no tolerance, must be one of laser_angle"),
        ("[laser_angle]\nnormal = 1\n[wavelength]\nnormal = 1\n[[correlated]]\n"
         "parameters = ['laser_angle', 'wavelength']\ncoefficient = 1", "positive definite"),
        ("[laser_angle]\nnormal = 1\n[[compensator]]\nparameter = 'focus'\nbounds = [1, 2]\ncondition = 'ry.u'",
         "focus: the scene has no such number"),
    ],
)  # fmt: skip
def test_bad_tolerances_are_refused_in_one_line_that_says_what_there_is(mitsuba, text, words, tmp_path):
    from speckle_mi.errors import InputError
    from speckle_mi.studies.design import Design
    from speckle_mi.studies.tolerances import read_tolerances
    from speckle_mi.studies.uncertainty import UncertaintyStudy

    (tmp_path / "T.toml").write_text(text, encoding="utf-8")
    design = Design.of(SCENE)
    with pytest.raises(InputError) as caught:
        UncertaintyStudy(design, read_tolerances(str(tmp_path / "T.toml"), design.nominal()))
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_the_command_refuses_what_it_cannot_do_and_leaves_nothing(tmp_path):
    (tmp_path / "T.toml").write_text("[laser_angle]\nnormal = 1", encoding="utf-8")
    given = ("uncertainty", SCENE, "--tolerances", "T.toml", "--out", "out")
    refused(run(*given, "--samples", "0", cwd=tmp_path), "--samples 0: must be 1 to")
    refused(run("uncertainty", SCENE, "--tolerances", "none.toml", "--out", "out", cwd=tmp_path), "none.toml")
    assert not (tmp_path / "out").exists()
