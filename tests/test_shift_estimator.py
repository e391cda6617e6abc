"""Shifts to a thousandth of a pixel, their stated uncertainty, and deformations: against exactly known motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from speckle_mi.measurement.compare import Comparison
from speckle_mi.measurement.correlator import Correlator, correlate
from speckle_mi.validation.shifts.peers import PEERS, ic_gn, installed
from speckle_mi.validation.shifts.speckle import shifted_pair, with_photons
from speckle_mi.validation.shifts.study import OURS, compare_shifts, table

FINE, COARSE = 2e-3, 2e-4
"""rms error [px] of noise-free speckle of 2.5 and of 4 px in a window of 64 px that is promised."""

STATED = 0.2
"""Relative error of the stated uncertainty that is promised."""

SPREAD_SIGMAS = 4.0
"""Standard errors that an rms over a finite number of pairs is allowed."""

WORSE, UNSHARED = 1.1, 0.4
"""Error, relative to that of any other program, that is promised; and the share of its errors that the best of them
does not have in common with ours, since both see the same noise."""


def errors(size, photons, correlation, pairs, window=64, seed=0):
    """Errors and stated uncertainties (pairs, 2) [px] of exactly shifted pairs."""
    random = np.random.default_rng(seed)
    found, stated = [], []
    for number in range(pairs):
        shift = random.uniform(-6.0, 6.0, 2)
        images = shifted_pair((window + 40,) * 2, size, tuple(shift), number, correlation)
        result = correlate(*(with_photons(image, photons, random) for image in images), window)
        assert result.ok, result.message
        found.append(np.subtract((result.u_px, result.v_px), shift))
        stated.append((result.sigma_u_px, result.sigma_v_px))
    return np.array(found), np.array(stated)


@pytest.mark.parametrize("size, limit", [(2.5, FINE), (4.0, COARSE)])
def test_noise_free_speckle_is_measured_to_a_fraction_of_a_thousandth(size, limit):
    error, _ = errors(size, None, 1.0, pairs=8)
    assert np.sqrt(np.mean(error**2)) < limit


@pytest.mark.parametrize(
    "size, photons, correlation",
    [(4.0, 10.0, 1.0), (2.5, 100.0, 1.0), (8.0, 100.0, 1.0), (4.0, 10_000.0, 1.0), (4.0, None, 0.9), (3.0, 100.0, 0.7)],
)
def test_the_stated_uncertainty_is_the_spread_of_the_shifts(size, photons, correlation):
    pairs = 100
    error, stated = errors(size, photons, correlation, pairs)
    ratio = np.sqrt(np.mean(stated**2) / np.mean(error**2))
    assert abs(math.log(ratio)) < math.log(1 + STATED) + SPREAD_SIGMAS / math.sqrt(2 * 2 * pairs)
    # No sign is preferred: the mean error is within its own standard error.
    assert np.abs(error.mean(axis=0)).max() < SPREAD_SIGMAS * np.sqrt(np.mean(error**2) / pairs)


def test_a_coarse_pattern_in_noise_is_measured_better_than_without_a_weight_of_its_frequencies():
    """IC-GN takes all frequencies alike; of 6 px speckle with 10 photons a pixel most of them hold noise alone."""
    random = np.random.default_rng(3)
    ours, theirs = [], []
    for seed in range(20):
        shift = random.uniform(-3.0, 3.0, 2)
        pair = [with_photons(image, 10.0, random) for image in shifted_pair((110, 110), 6.0, tuple(shift), seed)]
        found = correlate(*pair, 64)
        ours.append(np.subtract((found.u_px, found.v_px), shift))
        theirs.append(np.subtract(ic_gn(*pair, 64), shift))
    assert np.mean(np.square(ours)) < np.mean(np.square(theirs))


def test_errors_of_u_and_v_correlate_where_the_speckle_is_oblique():
    from test_statistics import speckle_pair

    random = np.random.default_rng(1)
    pair = [with_photons(i, 50.0, random) for i in speckle_pair((160, 160), (14.0, 4.0), 1, (2.2, -1.3), angle=0.6)]
    found = correlate(*pair, 96)
    # Along the speckle's long axis (u + 0.68 v) little is known: there both errors have the same sign.
    assert 0.3 < found.correlation_uv < 1.0


# --- deformation -----------------------------------------------------------------------------------------------------


def waves(shape, seed, size=4.0, count=600):
    """Directions (count, 2) [rad/px] and amplitudes of plane waves whose sum is speckle of about ``size`` px."""
    random = np.random.default_rng(seed)
    angle, radius = random.uniform(0, 2 * np.pi, count), np.sqrt(random.uniform(0, 1, count))
    k = 2 * np.pi * 0.5145 / size * radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return k, random.standard_normal(count) + 1j * random.standard_normal(count)


def seen(shape, k, amplitude, matrix, shift):
    """Intensity (rows, columns) of the waves' pattern after x -> matrix x + shift about the middle."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in shape)
    u, v = np.meshgrid(u, v)
    before = np.linalg.inv(matrix) @ np.stack([u.ravel() - shift[0], v.ravel() - shift[1]])
    return np.abs(np.exp(1j * before.T @ k.T) @ amplitude).reshape(shape) ** 2


ROTATION, STRAIN = 0.011, (3e-3, -4e-3, 1e-3)


@pytest.fixture(scope="module")
def deformed():
    shape = (110, 110)
    k, amplitude = waves(shape, 5)
    turn = np.array([[math.cos(ROTATION), -math.sin(ROTATION)], [math.sin(ROTATION), math.cos(ROTATION)]])
    matrix = turn @ (np.eye(2) + [[STRAIN[0], STRAIN[2]], [STRAIN[2], STRAIN[1]]])
    return seen(shape, k, amplitude, np.eye(2), (0, 0)), seen(shape, k, amplitude, matrix, (2.3, -1.6))


def test_strain_and_rotation_are_found_from_one_pair(deformed):
    result = Comparison(deformed[0], None, 64, fit="affine").with_moved(deformed[1])
    assert result["rotation_deg"] == pytest.approx(math.degrees(ROTATION), rel=5e-3)
    found = [result[f"strain_{name}"] for name in ("uu", "vv", "uv")]
    np.testing.assert_allclose(found, STRAIN, atol=1e-4)
    assert (result["fit_shift_u_px"], result["fit_shift_v_px"]) == pytest.approx((2.3, -1.6), abs=2e-3)


def test_strain_has_its_uncertainty(deformed):
    random = np.random.default_rng(2)
    found, stated = [], []
    for _ in range(12):
        pair = [with_photons(image / image.mean(), 100.0, random) for image in deformed]
        result = Comparison(pair[0], None, 64, fit="affine").with_moved(pair[1])
        found.append([result[f"strain_{name}"] for name in ("uu", "vv", "uv")])
        stated.append([result[f"sigma_strain_{name}"] for name in ("uu", "vv", "uv")])
    ratio = np.sqrt(np.mean(np.square(stated)) / np.mean(np.square(np.subtract(found, STRAIN))))
    assert abs(math.log(ratio)) < math.log(1 + STATED) + SPREAD_SIGMAS / math.sqrt(2 * 36)


def test_a_fit_that_is_not_asked_for_keeps_shape(deformed):
    rotation = Comparison(deformed[0], None, 64, fit="rotation").with_moved(deformed[1])
    assert abs(rotation["strain_uu"]) < 1e-12 and rotation["sigma_strain_uu"] == 0.0
    assert rotation["rotation_deg"] == pytest.approx(math.degrees(ROTATION), rel=0.1)


def test_a_pattern_with_a_dark_middle_can_be_fitted_too():
    reference, moved = shifted_pair((200, 200), 4.0, (2.3, 3.4), 1)
    reference[84:116, 84:116] = 0.0
    result = Comparison(reference, None, 12, fit="rotation").with_moved(moved)
    assert result["status"] == "ok" and min(result["window"]) > 100
    assert abs(result["rotation_deg"]) < 0.02
    assert (result["fit_shift_u_px"], result["fit_shift_v_px"]) == pytest.approx((2.3, 3.4), abs=0.02)


def test_what_is_no_fit_is_refused(deformed):
    with pytest.raises(ValueError, match="bend"):
        Comparison(deformed[0], None, 64, fit="bend")


def turned(angle, seed=7):
    k, amplitude = waves((130, 130), seed, count=300)
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    matrix = np.array([[cosine, -sine], [sine, cosine]])
    return [seen((130, 130), k, amplitude, *motion) for motion in ((np.eye(2), (0, 0)), (matrix, (3, -2)))]


@pytest.mark.parametrize("angle", [12.0, -25.0, 170.0])
def test_a_pattern_turned_beyond_the_window_is_said_to_be(angle):
    found = correlate(*turned(angle), 64)
    assert found.status == "rotated" and math.isnan(found.u_px)
    assert f"{angle:.0f}." in found.message or f"{angle - math.copysign(1, angle):.0f}.9" in found.message


# --- beside others ---------------------------------------------------------------------------------------------------


def test_the_comparison_with_others_has_a_row_for_each_noise():
    rows = list(compare_shifts((64,), (4.0,), (None, 100.0), {64: 2}, {"IC-GN": ic_gn}))
    assert [row.photons for row in rows] == [None, 100.0]
    assert rows[0].rms[OURS] < COARSE < rows[1].rms[OURS]
    heads, cells = table(rows)
    assert "IC-GN" in heads and len(cells) == 3 and all(len(line) == len(heads) for line in cells)


@pytest.mark.parametrize("size, photons", [(2.5, None), (2.5, 100.0), (5.0, 1000.0), (8.0, 10.0)])
def test_no_other_program_measures_a_shift_better(size, photons):
    assert set(installed()) == set(PEERS), "the extra `test` has them all"
    pairs = 20
    (row,) = compare_shifts((64,), (size,), (photons,), {64: pairs})
    by_chance = 1 + SPREAD_SIGMAS * UNSHARED / math.sqrt(2 * 2 * pairs)
    for name in PEERS:
        assert row.rms[OURS] < WORSE * by_chance * row.rms[name], name


# --- masks -----------------------------------------------------------------------------------------------------------


def test_what_a_mask_hides_does_not_count():
    shift = (3.3, -2.4)
    reference, moved = shifted_pair((150, 150), 4.0, shift, 1)
    mask = np.ones((150, 150), dtype=bool)
    mask[50:90, 60:110] = False  # a stop stands before the sensor
    hidden = [np.where(mask, image, 7.0) for image in (reference, moved)]
    found = Correlator(hidden[0], 80, mask=mask).shift(hidden[1])
    assert found.ok and (found.u_px, found.v_px) == pytest.approx(shift, abs=0.02)
    with pytest.raises(ValueError, match="mask: shape"):
        Correlator(reference, mask=mask[1:])
    with pytest.raises(ValueError, match="no pixel"):
        Correlator(reference, mask=np.zeros_like(mask))
