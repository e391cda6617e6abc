"""Shifts of synthetic speckle that was shifted exactly, and pairs that must not be given a shift."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import numpy as np
import pytest
from scipy import ndimage
from skimage.feature import match_template
from skimage.registration import phase_cross_correlation
from test_statistics import gaussian_speckle, speckle_pair

from speckle_mi.correlate import main
from speckle_mi.measurement.compare import compare
from speckle_mi.measurement.correlator import Correlator, correlate
from speckle_mi.measurement.speckle_statistics import centre_of_gravity
from speckle_mi.images.exr import write_field
from speckle_mi.images.field_image import FieldImage

BIAS = 0.005
"""Largest error [px] for exactly shifted speckle in a 256 px window: half of what a sensor designer is promised."""

SMALL_BIAS = 0.01
"""The same for 40 to 64 px windows, whose few speckles make the peak less regular."""

DECORRELATION_FACTOR = 0.6
"""K of sigma = K (s^2/n) sqrt((1-c)/c) px, the scatter of the shift of partly decorrelated speckle."""


def pair(shape, size, shift, seed, correlation=1.0):
    """Reference and moved image (rows, columns) of round speckle of ``size`` px moved by ``shift`` (u, v) px."""
    return speckle_pair(shape, (size, size), seed, shift, correlation)


def unrelated(shape, size, seed):
    return tuple(gaussian_speckle(shape, (size, size), 2 * seed + i) for i in (0, 1))


def error(found, shift):
    assert found.status == "ok", found.message
    return np.abs(np.subtract((found.u_px, found.v_px), shift)).max()


# --- where the features went -------------------------------------------------------------------------------------


def test_shift_is_positive_along_increasing_column_and_row():
    reference, _ = pair((200, 300), 5.0, (0.0, 0.0), seed=1)
    moved = np.roll(reference, (3, 7), axis=(0, 1))  # features go 3 rows down, 7 columns right
    found = correlate(reference, moved)
    assert (found.u_px, found.v_px, found.ncc) == (7.0, 3.0, 1.0)  # a copy: nothing to interpolate
    assert found.message == ""
    still = correlate(reference, reference)
    assert (still.u_px, still.v_px, still.ncc) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("size", [4.0, 6.0, 10.0, 20.0, 40.0])
def test_fractional_shifts_are_unbiased_for_any_speckle_size(size):
    for seed, shift in enumerate([(0.5, 0.5), (0.25, -0.5), (-3.1, 0.37), (12.75, -8.49)]):
        reference, moved = pair((400, 420), size, shift, seed)
        assert error(correlate(reference, moved), shift) < BIAS


@pytest.mark.parametrize("size", [4.0, 6.0])
def test_fractional_shifts_are_unbiased_in_a_small_window(size):
    for seed, shift in enumerate([(0.5, 0.5), (0.25, -0.5), (-3.1, 0.37), (5.75, -4.49)]):
        reference, moved = pair((100, 110), size, shift, seed)
        assert error(correlate(reference, moved, window=64), shift) < SMALL_BIAS


@pytest.mark.parametrize("angle", [0.0, 0.4, -0.8])
def test_oblique_elongated_speckle_is_unbiased(angle):
    """The peak's cross term couples u and v: a fit an axis at a time is off by tenths of a pixel."""
    for seed, shift in enumerate([(0.5, -0.5), (3.45, 2.3)]):
        reference, moved = speckle_pair((400, 400), (16.0, 4.0), seed, shift, angle=angle)
        assert error(correlate(reference, moved), shift) < BIAS


def test_single_precision_images_of_large_speckle_give_the_same_shift():
    reference, moved = pair((400, 420), 40.0, (0.5, 0.25), seed=4)
    single = correlate(reference.astype(np.float32), moved.astype(np.float32))
    assert error(single, (0.5, 0.25)) < BIAS


@pytest.mark.parametrize("gain, offset", [(1e-30, 0.0), (1e30, 0.0), (2.0, 1e4), (0.1, -0.5)])
def test_gain_and_background_do_not_move_the_peak(gain, offset):
    reference, moved = pair((150, 150), 5.0, (2.3, -1.6), seed=5)
    plain, changed = correlate(reference, moved), correlate(reference, gain * moved + offset)
    assert changed.u_px == pytest.approx(plain.u_px, abs=1e-6)
    assert changed.ncc == pytest.approx(plain.ncc, abs=1e-6)


def test_peak_height_and_place_agree_with_scikit_image():
    reference, moved = pair((200, 240), 6.0, (9.3, -4.8), seed=6, correlation=0.7)
    found = correlate(reference, moved, window=96)
    surface = match_template(moved, reference[52:148, 72:168])
    row, column = np.unravel_index(np.argmax(surface), surface.shape)
    assert (round(found.u_px), round(found.v_px)) == (column - 72, row - 52)
    assert surface.max() <= found.ncc + 1e-9
    # Between pixels the peak is higher by at most the fall of a Gaussian lobe over half a pixel in u and in v.
    assert found.ncc < surface.max() * 2 ** (2 * (0.5 / 3.0) ** 2)
    shift, _, _ = phase_cross_correlation(moved, reference, upsample_factor=20, normalization=None)
    # The plain cross-correlation is biased toward zero by its falling overlap, by several percent of the shift.
    assert (found.v_px, found.u_px) == pytest.approx(shift, abs=0.1 * 9.3)


def test_ncc_is_the_correlation_of_partly_decorrelated_speckle():
    for correlation in (0.9, 0.6, 0.3):
        reference, moved = pair((480, 744), 4.0, (5.2, -3.7), seed=7, correlation=correlation)
        found = correlate(reference, moved)
        speckles = 256**2 / (4.0**2 * math.pi / (4 * math.log(2)))
        assert found.ncc == pytest.approx(correlation, abs=4 / math.sqrt(speckles))
        sigma = DECORRELATION_FACTOR * 4.0**2 / 256 * math.sqrt((1 - correlation) / correlation)
        assert error(found, (5.2, -3.7)) < 4 * sigma


# --- far shifts --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shift", [(200.25, -30.4), (400.4, 100.3), (-500.2, 200.7), (243.8, 111.8), (0.3, -250.6)])
def test_shifts_far_beyond_half_the_window_are_found(shift):
    reference, moved = pair((480, 744), 5.0, shift, seed=8)
    assert error(correlate(reference, moved), shift) < BIAS


@pytest.mark.parametrize("shift", [(20.4, 30.3), (-35.2, 5.1), (3.4, -5.1)])
def test_small_detectors_find_far_shifts_too(shift):
    reference, moved = pair((64, 64), 4.0, shift, seed=9)
    assert error(correlate(reference, moved), shift) < SMALL_BIAS


def test_a_window_as_large_as_the_image_still_finds_a_shift():
    reference, moved = pair((128, 128), 4.0, (6.3, -9.7), seed=10)
    found = correlate(reference, moved, window=128)
    assert error(found, (6.3, -9.7)) < SMALL_BIAS
    assert found.window == (128 - 10 - 6, 128 - 6 - 6)  # the image less the shift, less 3 px to search on each side


@pytest.fixture(scope="module")
def large():
    """Images of 3 megapixels, larger than what is looked at pixel by pixel, and their shift."""
    shift = (700.3, -510.6)
    return *pair((1400, 2200), 4.0, shift, seed=14), shift


@pytest.mark.parametrize("window", [64, None])
def test_large_images_find_far_shifts_too(large, window):
    reference, moved, shift = large
    found = correlate(reference, moved, window)
    assert error(found, shift) < BIAS
    assert max(found.sigma_u_px, found.sigma_v_px) < BIAS


def test_the_middle_of_a_large_image_may_be_dark(large):
    reference, moved = (np.zeros((1500, 2400)) for _ in range(2))
    reference[:500, :600], moved[:500, :600] = pair((500, 600), 4.0, (4.3, -5.8), seed=15)
    found = correlate(reference, moved)
    assert error(found, (4.3, -5.8)) < 0.15  # the edge of the light stays where it is, and pulls


def test_unrelated_large_images_have_no_shift(large):
    reference, _, _ = large
    found = correlate(reference, pair(reference.shape, 4.0, (0.0, 0.0), seed=16)[0])
    assert found.status == "not significant" and math.isnan(found.u_px)


@pytest.mark.parametrize("shift", [33.3, 2333.3, -1500.6])
def test_a_line_detector_measures_along_its_line_only(shift):
    reference, moved = pair((1, 4096), 5.0, (shift, 0.0), seed=11)
    along = correlate(reference, moved)
    assert along.status == "ok" and math.isnan(along.v_px)
    assert along.u_px == pytest.approx(shift, abs=SMALL_BIAS)
    upright = correlate(reference.T, moved.T)
    assert upright.status == "ok" and math.isnan(upright.u_px)
    assert upright.v_px == pytest.approx(along.u_px, abs=1e-9)


def test_the_middle_of_the_detector_may_be_dark():
    reference, moved = pair((300, 300), 4.0, (4.3, 2.6), seed=12)
    v, u = np.mgrid[:300, :300]
    lit = (u < 110) & (v < 110)  # a stop's edge: the light stays where it is, the pattern moves in it
    found = correlate(reference * lit, moved * lit)
    # The fixed edge of the light belongs to the pattern and pulls a little toward zero.
    assert error(found, (4.3, 2.6)) < 0.15


def test_a_pattern_that_has_all_but_gone_has_left_the_detector():
    reference, moved = pair((480, 744), 5.0, (-600.0, -400.0), seed=13)
    found = correlate(reference, moved)
    assert found.status == "left the detector"
    assert "(-600, -400) px" in found.message and "3.2 %" in found.message
    assert math.isnan(found.u_px) and math.isnan(found.v_px)


# --- no shift ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "shape, size, window, pairs",
    [((64, 64), 4.0, None, 300), ((64, 64), 8.0, None, 150), ((128, 96), 4.0, None, 100), ((1, 512), 5.0, None, 200)],
)
def test_unrelated_patterns_are_not_given_a_shift(shape, size, window, pairs):
    found = [correlate(*unrelated(shape, size, seed), window) for seed in range(pairs)]
    false = [shift for shift in found if shift.status != "not significant"]
    assert len(false) <= 2  # one in a thousand: more than 2 of 300 would happen once in 250 times
    assert all(math.isnan(shift.u_px) and math.isfinite(shift.ncc) for shift in found if shift not in false)


@pytest.mark.parametrize("size", [4.0, 6.0, 10.0])
def test_strongly_decorrelated_speckle_is_still_found(size):
    for seed in range(5):
        reference, moved = pair((480, 744), size, (20.5, -10.3), 20 + seed, correlation=0.3)
        found = correlate(reference, moved)
        sigma = DECORRELATION_FACTOR * size**2 / 256 * math.sqrt(0.7 / 0.3)
        assert error(found, (20.5, -10.3)) < 4 * sigma


def test_too_few_speckles_prove_nothing():
    reference, moved = pair((64, 64), 40.0, (3.0, 1.0), seed=14)
    found = correlate(reference, moved)
    assert found.status == "not significant"
    assert "independent speckles" in found.message


def test_a_periodic_pattern_is_ambiguous():
    v, u = np.mgrid[:200, :300]

    def grid(du, dv):
        return (1 + np.cos(2 * np.pi * (u - du) / 17)) * (1 + np.cos(2 * np.pi * (v - dv) / 23))

    assert correlate(grid(0, 0), grid(3.3, 1.2)).status == "ambiguous"
    stripes = 1 + np.cos(2 * np.pi * u / 17)
    found = correlate(stripes, np.roll(stripes, 3, axis=1))
    assert found.status == "ambiguous"
    assert math.isnan(found.u_px) and found.ncc > 0.99


@pytest.mark.parametrize("level", [0.0, 1.0, 255.0, 1e30])
def test_a_constant_image_has_no_contrast(level):
    image = gaussian_speckle((64, 80), (4.0, 4.0), seed=15)
    flat = np.full(image.shape, level, dtype=np.float32)
    for name, images in {"moved": (image, flat), "reference": (flat, image)}.items():
        found = correlate(*images)
        assert found.status == "no contrast"
        assert name in found.message
        assert math.isnan(found.ncc) and math.isnan(found.u_px)


def test_a_saturated_image_is_followed_by_what_is_left_of_its_contrast():
    reference, moved = pair((200, 300), 5.0, (12.5, 3.25), seed=16)
    found = correlate(np.minimum(reference, 0.7), np.minimum(moved, 0.7))  # half of the pixels clipped
    # Clipping has corners, which alias: a shift of sampled corners is good to a few hundredths.
    assert error(found, (12.5, 3.25)) < 0.03
    assert correlate(np.minimum(reference, 1e-9), np.minimum(moved, 1e-9)).status in ("not significant", "no contrast")


def test_a_bright_pixel_is_not_a_pattern():
    reference, moved = pair((200, 300), 5.0, (12.5, 3.25), seed=17)
    alone = np.zeros((200, 300))
    alone[100, 150] = 1.0
    assert correlate(alone, np.roll(alone, 5, axis=1)).status == "not significant"
    for height in (1000.0, 30.0):  # a hot pixel stays where it is and must not pin the shift to zero
        found = correlate(reference + height * alone, moved + height * alone)
        assert error(found, (12.5, 3.25)) < SMALL_BIAS
        assert "1 pixel" in found.message


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_pixels_that_are_not_finite_are_refused_by_name_and_number(bad):
    image = gaussian_speckle((40, 50), (4.0, 4.0), seed=18)
    spoilt = image.copy()
    spoilt[3, 4:6] = bad
    with pytest.raises(ValueError, match="reference image: 2 of 2000 pixels"):
        correlate(spoilt, image)
    with pytest.raises(ValueError, match="moved image: 2 of 2000 pixels"):
        correlate(image, spoilt)


def test_images_of_different_shape_are_refused():
    with pytest.raises(ValueError, match=r"moved image: shape \(40, 51\) differs"):
        correlate(np.eye(40, 50), np.eye(40, 51))


@pytest.mark.parametrize("window", [0, 3, -5, 51])
def test_a_window_that_does_not_fit_is_refused(window):
    with pytest.raises(ValueError, match=rf"window = {window}: must be 4 to 50 px"):
        Correlator(np.eye(40, 50), window)


def test_the_default_window_leaves_room_to_search():
    def speckle(*shape):
        return np.random.default_rng(5).exponential(size=shape)

    assert Correlator(speckle(480, 744)).window == (256, 256)
    assert Correlator(speckle(64, 64)).window == (40, 40)
    assert Correlator(speckle(1, 4096)).window == (1, 256)
    assert Correlator(speckle(480, 744), 64).window == (64, 64)


def test_the_default_window_lies_inside_a_lit_disc():
    # An aperture lights a disc that stands still while its speckle moves: its edge must stay outside the window.
    rows, columns = np.mgrid[:480, :744]
    disc = np.hypot(rows - 239.5, columns - 371.5) < 110
    reference = disc * np.random.default_rng(5).exponential(size=(480, 744))
    side = Correlator(reference).window[0]
    assert 100 < side < 1.25 * np.sqrt(2) * 110  # at most a few dark pixels in the corners
    assert Correlator(reference, 256).window == (256, 256)


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (3, 3), (1, 5), (5, 7)])
def test_images_of_a_few_pixels_get_a_status_not_a_crash(shape):
    generator = np.random.default_rng(19)
    assert not correlate(generator.random(shape), generator.random(shape)).ok


# --- centre of gravity, and the command --------------------------------------------------------------------------


def test_centre_of_gravity_follows_a_spot_from_the_middle():
    v, u = np.mgrid[:80, :121]
    spot = np.exp(-((u - 70.25) ** 2 + (v - 30.5) ** 2) / 40.0)
    # 6.3 standard deviations to the nearest edge cut off 1e-9 of the light.
    assert centre_of_gravity(spot) == pytest.approx((70.25 - 60.0, 30.5 - 39.5), abs=1e-6)
    column, row = ndimage.center_of_mass(spot)[::-1]
    assert centre_of_gravity(spot) == pytest.approx((column - 60.0, row - 39.5), abs=1e-12)


def test_a_dark_image_has_no_centre_of_gravity():
    assert np.isnan(centre_of_gravity(np.zeros((5, 6)))).all()
    assert centre_of_gravity(np.ones((5, 6))) == pytest.approx((0.0, 0.0), abs=1e-15)


def test_lengths_are_pixels_times_pitch():
    reference, moved = pair((150, 160), 5.0, (4.25, -2.5), seed=20)
    result = compare(reference, moved, pitch=0.006)
    assert result["shift_u_um"] == pytest.approx(6.0 * 4.25, abs=6.0 * SMALL_BIAS)
    assert result["shift_v_um"] == pytest.approx(6.0 * -2.5, abs=6.0 * SMALL_BIAS)
    moved_by = result["cog_moved_u_um"] - result["cog_reference_u_um"]
    assert result["cog_shift_u_um"] == pytest.approx(moved_by, rel=1e-12)
    assert math.isnan(compare(reference, moved, pitch=None)["shift_u_um"])


@pytest.fixture
def write(tmp_path):
    def write(name, intensity, **header):
        path = tmp_path / name
        write_field(path, FieldImage(intensity.astype(np.float32), np.sqrt(intensity).astype(np.complex64), header))
        return str(path)

    return write


def test_the_command_prints_json(write, capsys):
    reference, moved = pair((150, 160), 5.0, (4.25, -2.5), seed=21)
    paths = [write(f"{i}.exr", image, pixel_pitch_mm=0.006) for i, image in enumerate((reference, moved))]
    assert main([*paths, "--window", "80"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["status"] == "ok" and result["window"] == [80, 80]
    assert result["shift_u_um"] == pytest.approx(25.5, abs=6.0 * SMALL_BIAS)


def test_the_command_writes_null_for_what_is_not_known(write, capsys):
    image = gaussian_speckle((60, 70), (4.0, 4.0), seed=22)
    assert main([write("a.exr", image), write("b.exr", np.zeros_like(image))]) == 0
    result = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert result["status"] == "no contrast"
    assert result["shift_u_px"] is None and result["contrast_moved"] is None and result["speckle_size_u_um"] is None


def test_the_command_refuses_images_of_different_pitch(write):
    image = gaussian_speckle((60, 70), (4.0, 4.0), seed=23)
    with pytest.raises(ValueError, match="0.005 and 0.006 mm"):
        main([write("a.exr", image, pixel_pitch_mm=0.006), write("b.exr", image, pixel_pitch_mm=0.005)])


def test_bad_input_is_one_line_and_status_two(tmp_path):
    (tmp_path / "a.exr").write_text("no image")
    arguments = [sys.executable, "-m", "speckle_mi.correlate", str(tmp_path / "a.exr"), str(tmp_path / "a.exr")]
    done = subprocess.run(arguments, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1 and "a.exr" in done.stderr
