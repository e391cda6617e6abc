"""Slopes, intervals and scatter, against simulations whose truth is known."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from speckle_mi.measurement.sensitivity import Sensitivity, fit_sensitivity, shift_weights
from speckle_mi.theory.decorrelation import decorrelation_in_plane
from speckle_mi.theory.speckle import shift_scatter

STEPS = np.linspace(-0.1, 0.1, 10)
SLOPE = 0.946  # mm/mm
EXACT = 1e-12  # Slopes of order 1 in float64.


def decorrelating_sweep(rng, surfaces, steps=STEPS, beam_radius=0.12, measured_peak=0.01):
    """Shifts [um] and peak correlations of surfaces that leave a Gaussian beam, noise as of a correlation peak.

    Half of a frame's variance is shared by all frames of the surface that moved to the same side.
    """
    peak = decorrelation_in_plane(steps, beam_radius)
    sigma_um = 6.0 * shift_scatter(6.0, 64, peak)
    own, shared = rng.normal(size=(surfaces, steps.size)), rng.normal(size=(surfaces, 2))
    noise = np.sqrt(0.5) * (own + shared[:, (steps > 0).astype(int)])
    seen = np.clip(peak + measured_peak * rng.normal(size=noise.shape), 1e-3, 1)
    return 1e3 * SLOPE * steps + sigma_um * noise, seen


def assert_covers_as_often_as_it_says(hits, trials):
    """The count of intervals that hold the truth lies in the central 99.8 % of a binomial with p = 0.95."""
    low, high = stats.binom.ppf([0.001, 0.999], trials, 0.95)
    assert low <= hits <= high, f"{hits} of {trials} intervals hold the truth, expected {low:.0f} to {high:.0f}"


@pytest.mark.parametrize("surfaces", [2, 3, 8])
def test_95_percent_intervals_hold_the_truth_95_percent_of_the_time(surfaces):
    rng, trials = np.random.default_rng(surfaces), 3000
    fits = [fit_sensitivity(STEPS, *decorrelating_sweep(rng, surfaces)) for _ in range(trials)]
    assert {fit.basis for fit in fits} == {"surfaces"}
    assert_covers_as_often_as_it_says(sum(fit.ci95[0] <= SLOPE <= fit.ci95[1] for fit in fits), trials)


def test_intervals_keep_their_coverage_when_frames_are_lost():
    rng, trials, hits = np.random.default_rng(5), 3000, 0
    for _ in range(trials):
        shifts, peak = decorrelating_sweep(rng, 6)
        shifts[rng.random(shifts.shape) < 0.3 * (1 - peak)] = np.nan
        low, high = fit_sensitivity(STEPS, shifts, peak).ci95
        hits += low <= SLOPE <= high
    assert_covers_as_often_as_it_says(hits, trials)


def test_residuals_of_one_surface_cover_when_its_frames_are_independent():
    rng, trials, hits = np.random.default_rng(6), 3000, 0
    for _ in range(trials):
        peak = decorrelation_in_plane(STEPS, 0.12)
        noise = 6.0 * shift_scatter(6.0, 64, peak) * rng.normal(size=STEPS.size)
        fit = fit_sensitivity(STEPS, (1e3 * SLOPE * STEPS + noise)[None], peak[None])
        assert fit.basis == "residuals" and "one surface" in fit.note
        hits += fit.ci95[0] <= SLOPE <= fit.ci95[1]
    assert_covers_as_often_as_it_says(hits, trials)


def test_slope_is_unbiased_and_weights_beat_plain_least_squares_over_decorrelating_frames():
    rng, steps = np.random.default_rng(7), np.linspace(-0.2, 0.2, 20)
    sweeps = [decorrelating_sweep(rng, 4, steps) for _ in range(500)]
    weighted = np.array([fit_sensitivity(steps, *sweep).value for sweep in sweeps])
    plain = np.array([fit_sensitivity(steps, sweep[0]).value for sweep in sweeps])
    four_standard_errors = 4 * weighted.std() / np.sqrt(weighted.size)
    assert abs(weighted.mean() - SLOPE) < four_standard_errors
    assert weighted.var() < 0.5 * plain.var()


def test_interval_narrows_with_the_number_of_surfaces():
    rng = np.random.default_rng(8)
    width = lambda surfaces: np.mean(  # noqa: E731
        [np.diff(fit_sensitivity(STEPS, *decorrelating_sweep(rng, surfaces)).ci95)[0] for _ in range(200)]
    )
    ratio = width(8) / width(32)
    expected = 2 * stats.t.ppf(0.975, 7) / stats.t.ppf(0.975, 31)
    mean_of_two_hundred_widths = 0.1  # relative; the width of eight surfaces varies by a quarter.
    assert abs(ratio / expected - 1) < mean_of_two_hundred_widths


def test_equal_surfaces_count_equally_and_values_are_millimetres_per_unit():
    slopes = np.array([1.0, 1.2, 1.1, 0.9])
    fit = fit_sensitivity(STEPS, 1e3 * slopes[:, None] * STEPS, theory=1.0, unit="mm/deg")
    half = stats.t.ppf(0.975, 3) * slopes.std(ddof=1) / 2
    np.testing.assert_allclose([fit.value, *fit.ci95], [1.05, 1.05 - half, 1.05 + half], rtol=EXACT)
    np.testing.assert_allclose(fit.bias, 0.05, rtol=1e-10)
    assert (fit.unit, fit.frames_used, fit.frames_dropped, fit.note) == ("mm/deg", 40, 0, "")


def test_scatter_is_the_rms_over_displacements_of_the_spread_over_surfaces():
    steps = np.array([-0.1, 0.0, 0.1, 0.2])
    shifts = np.array([[-1.0, 0.0, 5.0, np.nan], [1.0, 0.0, 9.0, 3.0], [0.0, 0.0, np.nan, np.nan]])
    expected = np.sqrt((1.0**2 + 8.0) / 2)  # Zero displacement and single surfaces have no spread to give.
    fit = fit_sensitivity(steps, shifts)
    np.testing.assert_allclose(fit.scatter_um, expected, rtol=EXACT)
    assert (fit.frames_used, fit.frames_dropped) == (6, 3)


def test_lost_surface_and_lost_frames_do_not_disturb_the_rest():
    shifts = 1e3 * np.array([[1.0], [1.2], [5.0]]) * STEPS
    shifts[2] = np.nan
    shifts[0, :4] = np.nan
    fit = fit_sensitivity(STEPS, shifts)
    assert 1.0 < fit.value < 1.2 and fit.basis == "surfaces"
    assert (fit.frames_used, fit.frames_dropped) == (16, 14)
    uncorrelated = np.ones_like(shifts)
    uncorrelated[1] = 0.0
    alone = fit_sensitivity(STEPS, shifts, uncorrelated)
    assert alone.basis == "residuals" and abs(alone.value - 1.0) < EXACT


def test_weight_is_the_inverse_variance_of_a_correlation_peak_above_its_floor():
    peak = np.array([[0.2, 0.5, 0.8]])
    weights = shift_weights(np.zeros((1, 3)), peak)
    variance = shift_scatter(5.0, 64, peak) ** 2
    floor = 0.005  # NOISE_FLOOR over the smallest (1 - c)/c here.
    np.testing.assert_allclose(weights * variance, (weights * variance)[0, 0], rtol=floor)
    lost = shift_weights(np.array([[np.nan, 1.0, 1.0, 1.0]]), np.array([[1.0, np.nan, 0.0, -0.3]]))
    np.testing.assert_array_equal(lost, 0)
    assert np.all(np.isfinite(shift_weights(np.zeros((1, 3)), np.array([[1.0, 1.0 + 1e-9, 1e-300]]))))


UNMEASURABLE = {
    "every frame lost": (STEPS, np.full((3, 10), np.nan), None),
    "zero correlation": (STEPS, np.ones((3, 10)), np.zeros((3, 10))),
    "zero displacement only": (np.zeros(2), np.ones((3, 2)), None),
    "no displacement": (np.zeros(0), np.zeros((3, 0)), None),
    "no surface": (STEPS, np.zeros((0, 10)), None),
    "displacement too small to divide by": (np.array([1e-320]), np.ones((2, 1)), None),
    "only a vanishing displacement": (np.array([1e-250, 1.0]), np.array([[1.0, np.nan], [1.0, np.nan]]), None),
}


@pytest.mark.parametrize("case", UNMEASURABLE)
def test_unmeasurable_sweep_gives_nan_and_says_why(case):
    fit = fit_sensitivity(*UNMEASURABLE[case], theory=1.0)
    assert np.isnan([fit.value, *fit.ci95, fit.bias]).all()
    assert fit.note and fit.basis == "none"
    report = fit.to_json()
    assert report["value"] is report["bias"] is None and report["ci95"] == [None, None] and report["theory"] == 1.0


def test_one_frame_of_one_surface_has_a_slope_but_no_interval():
    fit = fit_sensitivity([0.1], [[95.0]])
    assert abs(fit.value - 0.95) < EXACT and np.isnan(fit.ci95).all()
    assert fit.basis == "none" and "no interval" in fit.note
    assert np.isnan(fit.scatter_um)


def test_two_displacements_of_one_surface_have_a_wide_but_finite_interval():
    fit = fit_sensitivity([-0.1, 0.1], [[-94.0, 96.0]])
    assert fit.ci95[0] < fit.value < fit.ci95[1] and np.isfinite(fit.ci95).all()


def test_report_is_plain_json_with_null_for_what_is_unknown():
    fit = fit_sensitivity(STEPS, 1e3 * STEPS[None], theory=np.nan)
    report = json.loads(json.dumps(fit.to_json(), allow_nan=False))
    assert list(report)[:6] == ["value", "ci95", "theory", "bias", "scatter_um", "unit"]
    assert report["basis"] == "residuals" and "one surface" in report["note"]
    assert report["theory"] is report["bias"] is report["scatter_um"] is None
    assert isinstance(fit, Sensitivity) and abs(report["value"] - 1) < EXACT


def test_arrays_that_do_not_fit_together_are_refused_by_name():
    with pytest.raises(ValueError, match=r"shifts of shape \(10,\).*surfaces, 10"):
        fit_sensitivity(STEPS, STEPS)
    with pytest.raises(ValueError, match="correlation of shape"):
        fit_sensitivity(STEPS, STEPS[None], np.ones((2, 10)))
    with pytest.raises(ValueError, match="displacements.*finite"):
        fit_sensitivity([np.nan], [[1.0]])
