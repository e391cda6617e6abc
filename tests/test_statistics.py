"""Statistics of synthetic speckle whose coherence is known exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import fft

from speckle_mi.measurement.speckle_statistics import autocovariance, contrast, speckle_count, speckle_size

SIGMAS = 4.0
"""Statistical tolerances are this many standard errors; the seeds are fixed."""


def speckle_pair(
    shape: tuple[int, int],
    size: tuple[float, float],
    seed: int,
    shift: tuple[float, float] = (0.0, 0.0),
    correlation: float = 1.0,
    angle: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Fully developed speckle before and after an exact shift, |mu|^2 = exp[-4 ln2 (u^2/size_u^2 + v^2/size_v^2)].

    size = (u, v) FWHM [px], shift = (u, v) [px]. A filtered complex Gaussian spectrum, band-limited for sizes of 4 px
    and more, so a phase ramp shifts the pattern exactly. With ``correlation`` c < 1 a share of an independent field is
    mixed in, so the intensities correlate by c. ``angle`` [rad] turns the speckles' axes from u toward v.
    The images are cut out of larger periodic ones: nothing re-enters.
    """
    margins = [int(4 * max(size) + abs(s)) for s in shift[::-1]]
    period = tuple(fft.next_fast_len(n + 2 * margin) for n, margin in zip(shape, margins))
    fv, fu = fft.fftfreq(period[0])[:, None], fft.fftfreq(period[1])[None, :]
    # mu is the square root of |mu|^2; the power spectrum its transform; the filter the square root of that.
    long, cross = fu * math.cos(angle) + fv * math.sin(angle), fv * math.cos(angle) - fu * math.sin(angle)
    amplitude = np.exp(-(np.pi**2) * ((long * size[0]) ** 2 + (cross * size[1]) ** 2) / (4 * np.log(2)))
    mean_intensity = 2.0 * np.sum(amplitude**2) / (period[0] * period[1]) ** 2
    generator = np.random.default_rng(seed)

    def spectrum() -> np.ndarray:
        return amplitude * (generator.standard_normal(period) + 1j * generator.standard_normal(period))

    before = spectrum()
    after = before * np.exp(-2j * np.pi * (fu * shift[0] + fv * shift[1]))
    if correlation < 1.0:
        after = math.sqrt(correlation) * after + math.sqrt(1.0 - correlation) * spectrum()
    inside = tuple(slice(margin, margin + n) for n, margin in zip(shape, margins))
    reference, moved = (np.abs(fft.ifft2(field, workers=2)[inside]) ** 2 / mean_intensity for field in (before, after))
    return reference, moved


def gaussian_speckle(shape: tuple[int, int], size: tuple[float, float], seed: int) -> np.ndarray:
    """One image of the speckle of `speckle_pair`, mean intensity 1."""
    return speckle_pair(shape, size, seed)[0]


def gaussian_count(shape: tuple[int, int], size: tuple[float, float]) -> float:
    """Speckles in an image: area over the integral of |mu|^2, pi size_u size_v/(4 ln2)."""
    return shape[0] * shape[1] * 4 * np.log(2) / (np.pi * size[0] * size[1])


@pytest.mark.parametrize("size", [4.0, 8.0])
def test_fully_developed_speckle_has_contrast_one(size):
    image = gaussian_speckle((600, 800), (size, size), seed=1)
    # C^2 = <I^2>/<I>^2 - 1 scatters by at most about 2/sqrt(count) for exponential I, and C by half of that.
    assert abs(contrast(image) - 1.0) < SIGMAS / math.sqrt(gaussian_count(image.shape, (size, size)))


def test_intensity_of_fully_developed_speckle_is_exponential():
    image = gaussian_speckle((800, 800), (4.0, 4.0), seed=2)  # in units of the ensemble's mean
    count = gaussian_count(image.shape, (4.0, 4.0))
    for level in (0.1, 0.5, 1.0, 2.0, 4.0):
        expected = math.exp(-level)
        standard_error = math.sqrt(expected * (1 - expected) / count)
        assert abs(np.mean(image > level) - expected) < SIGMAS * standard_error


def test_sum_of_independent_patterns_lowers_contrast_by_root_two():
    one, two = (gaussian_speckle((600, 800), (5.0, 5.0), seed) for seed in (3, 4))
    relative = SIGMAS / math.sqrt(gaussian_count((600, 800), (5.0, 5.0)))
    assert contrast(one + two) == pytest.approx(1 / math.sqrt(2), rel=relative)


@pytest.mark.parametrize("size", [(4.0, 4.0), (4.0, 9.0), (15.0, 6.0), (24.0, 24.0)])
def test_speckle_size_is_the_width_of_the_coherence_factor(size):
    image = gaussian_speckle((900, 1000), size, seed=5)
    # The width of a covariance estimated from n speckles scatters by about 1/sqrt(n).
    relative = SIGMAS / math.sqrt(gaussian_count(image.shape, size))
    assert speckle_size(image) == pytest.approx(size, rel=relative)


def test_autocovariance_is_the_squared_coherence_factor_without_a_taper_by_overlap():
    size = (6.0, 10.0)
    image = gaussian_speckle((700, 900), size, seed=6)
    covariance = autocovariance(image)
    assert covariance.shape == (1399, 1799)
    assert covariance[699, 899] == 1.0
    u, v = np.meshgrid(np.arange(-12, 13), np.arange(-12, 13))
    expected = np.exp(-4 * np.log(2) * ((u / size[0]) ** 2 + (v / size[1]) ** 2))
    error = covariance[699 - 12 : 699 + 13, 899 - 12 : 899 + 13] - expected
    assert np.abs(error).max() < SIGMAS / math.sqrt(gaussian_count(image.shape, size))


def test_autocovariance_is_the_mean_over_overlapping_pixels():
    image = np.random.default_rng(7).random((9, 13))
    pattern = image - image.mean()
    covariance = autocovariance(image)
    for dv, du in [(0, 1), (3, -2), (-8, 12), (5, 0)]:
        here = pattern[max(dv, 0) : 9 + min(dv, 0), max(du, 0) : 13 + min(du, 0)]
        there = pattern[max(-dv, 0) : 9 + min(-dv, 0), max(-du, 0) : 13 + min(-du, 0)]
        expected = np.mean(here * there) / np.mean(pattern**2)
        assert covariance[8 + dv, 12 + du] == pytest.approx(expected, abs=1e-12)  # float64 transforms


def test_a_periodic_pattern_keeps_its_covariance_at_every_whole_period():
    u = np.arange(120)
    image = 1 + np.cos(2 * np.pi * u / 12) + np.zeros((40, 1))
    covariance = autocovariance(image)
    assert covariance[39, 119 + 12 * np.arange(-5, 6)] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("size", [(5.0, 5.0), (4.0, 12.0), (20.0, 20.0)])
def test_speckle_count_is_area_over_the_area_of_coherence(size):
    image = gaussian_speckle((900, 1000), size, seed=8)
    count = gaussian_count(image.shape, size)
    assert speckle_count(image) == pytest.approx(count, rel=SIGMAS / math.sqrt(count))


def test_white_noise_has_one_speckle_a_pixel():
    image = np.random.default_rng(9).exponential(size=(300, 400))
    assert speckle_count(image) == pytest.approx(120000, rel=0.05)  # 24 lags of the lobe, each +- 1/sqrt(120000)
    assert all(size < 2.0 for size in speckle_size(image))


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e30, 1e150])
def test_statistics_do_not_depend_on_the_unit_of_intensity(scale):
    image = gaussian_speckle((64, 96), (5.0, 7.0), seed=10)
    assert speckle_size(image * scale) == pytest.approx(speckle_size(image), rel=1e-12)
    assert contrast(image * 1e30) == pytest.approx(contrast(image), rel=1e-12)


@pytest.mark.parametrize("shape", [(1, 1), (40, 50), (1, 64)])
def test_an_image_without_contrast_has_no_size_and_no_count(shape):
    image = np.full(shape, 3.0, dtype=np.float32)
    assert contrast(image) == 0.0
    assert np.isnan(speckle_size(image)).all()
    assert math.isnan(speckle_count(image))


def test_a_dark_image_has_no_contrast_to_speak_of():
    assert math.isnan(contrast(np.zeros((4, 5))))


def test_speckle_larger_than_the_image_has_no_size():
    image = gaussian_speckle((24, 24), (60.0, 60.0), seed=11)
    assert np.isnan(speckle_size(image)).all()


def test_a_line_detector_has_a_size_along_its_line_only():
    image = gaussian_speckle((1, 4096), (6.0, 6.0), seed=12)
    u, v = speckle_size(image)
    count = 4096 / (6.0 * math.sqrt(math.pi / (4 * math.log(2))))
    assert u == pytest.approx(6.0, rel=SIGMAS / math.sqrt(count))
    assert math.isnan(v)
    assert speckle_count(image) == pytest.approx(count, rel=SIGMAS / math.sqrt(count))


@pytest.mark.parametrize("statistic", [contrast, autocovariance, speckle_size, speckle_count])
def test_pixels_that_are_not_finite_are_refused_with_their_number(statistic):
    image = np.ones((6, 7))
    image[2, 3], image[4, 4] = np.nan, np.inf
    with pytest.raises(ValueError, match="2 of 42 pixels"):
        statistic(image)


@pytest.mark.parametrize("image", [np.ones(5), np.ones((2, 3, 4)), np.ones((0, 4)), np.ones((3, 3), complex)])
def test_what_is_not_an_image_is_refused(image):
    with pytest.raises(ValueError, match="intensity"):
        contrast(image)
