"""What a sensor resolves: noise that is there at rest, scatter that grows as the pattern decorrelates."""

from __future__ import annotations

import numpy as np
import pytest

from speckle_mi.measurement.resolution import QUANTILE, resolution_of

STEPS = np.linspace(-0.1, 0.1, 10)  # mm


def sweep(noise_um: float, growth: float, sensitivity: float, surfaces: int, seed: int = 0):
    """Shifts [um] of a sensor whose variance is noise^2 + (growth d)^2, and what the images state of it."""
    sigma = np.hypot(noise_um, 1e3 * growth * STEPS)
    random = np.random.default_rng(seed)
    return 1e3 * sensitivity * STEPS + sigma * random.normal(size=(surfaces, len(STEPS))), np.tile(sigma, (surfaces, 1))


def test_noise_and_its_growth_tell_the_smallest_displacement():
    """S d = q sqrt(noise^2 + (growth d)^2), here from the stated variances alone, which are exact."""
    shifts, sigma = sweep(0.4, 0.02, 0.9, 1)
    found = resolution_of(STEPS, shifts, sigma, 0.9)
    assert found.noise_um == pytest.approx(0.4, rel=1e-6) and found.per_displacement == pytest.approx(0.02, rel=1e-6)
    shift_um, own = 1e3 * 0.9 * found.smallest, np.hypot(0.4, 1e3 * 0.02 * found.smallest)
    assert shift_um == pytest.approx(QUANTILE * own, rel=1e-9)
    assert found.predicted_um == pytest.approx(np.sqrt(np.mean(sigma**2))) and np.isnan(found.scatter_um)


def test_of_many_surfaces_the_scatter_is_what_images_state():
    found = resolution_of(STEPS, *sweep(0.4, 0.02, 0.9, 2000), 0.9)
    assert found.scatter_um == pytest.approx(found.predicted_um, rel=0.02)
    assert found.noise_um == pytest.approx(0.4, rel=0.1)


def test_surfaces_that_scatter_more_than_images_state_count():
    shifts, sigma = sweep(0.4, 0.02, 0.9, 500)
    assert resolution_of(STEPS, shifts, 0.5 * sigma, 0.9).noise_um == pytest.approx(0.4, rel=0.1)


def test_what_only_decorrelates_is_told_from_zero_at_once_or_never():
    shifts, sigma = sweep(0.0, 0.02, 0.9, 1)
    assert resolution_of(STEPS, shifts, sigma, 0.9).smallest == pytest.approx(0.0, abs=1e-9)
    assert resolution_of(STEPS, shifts, sigma, 0.02).smallest == np.inf


def test_what_was_not_measured_has_no_resolution():
    nothing = np.full((2, len(STEPS)), np.nan)
    assert np.isnan(resolution_of(STEPS, nothing, nothing, np.nan).smallest)
