"""A second published simulation: Hamarova, Smid, Horvath and Hrabovsky, The Scientific World Journal 2014, 704368 (DOI
10.1155/2014/704368), Table 1: a beam that diverges from a waist of 60 um, by the Fresnel integral on a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.experiments.one_frame import measured_sensitivity
from speckle_mi.field.simulation import Simulation
from speckle_mi.geometry.pose import Pose
from speckle_mi.measurement.correlator import Correlator

MOVED = np.arange(10, 101, 10)  # Of the object, along x [um].
THEIR_THEORY = np.array([31.8, 63.5, 95.3, 127.0, 158.8, 190.5, 222.3, 254.0, 285.8, 317.5])  # [um]
THEIR_SHIFT = np.array([31.5, 62.9, 94.4, 125.9, 157.4, 188.8, 220.3, 251.8, 283.3, 314.8])  # [um]
THEIR_CORRELATION = 0.984  # At 100 um.
THEIR_SPECKLE = 264.9, 225.5  # [um], along x' and y'.
THEIR_STEP = 0.01  # What their shifts lack of their theory, relative.

SURFACES = 6


@pytest.fixture(scope="module")
def assembly(shipped):
    return shipped("diverging_beam")


@pytest.fixture(scope="module")
def images(assembly):
    """Of each surface the image at rest, and those at three displacements along x."""
    found = []
    for seed in range(SURFACES):
        simulation = Simulation(assembly.with_seed(seed))
        found.append([simulation.frame(Pose(x=1e-3 * moved)).image.intensity for moved in (0, 10, 50, 100)])
    return found


def test_theory_is_theirs(assembly):
    expected = expected_sensitivity(assembly)
    np.testing.assert_allclose(expected["u"][0] * MOVED, THEIR_THEORY, atol=0.051)  # as they round it
    assert abs(expected["v"][1]) == pytest.approx(3.0, rel=1e-4)  # their 30.0 um for 10 um along y


def test_shifts_are_theirs_within_their_grid(assembly, images):
    pixel = 1e3 * assembly.detector.pitch
    for rest, *moved in images:
        correlator = Correlator(rest)
        for image, one in zip(moved, (0, 4, 9), strict=True):
            shift = correlator.shift(image)
            assert pixel * shift.u_px == pytest.approx(THEIR_SHIFT[one], rel=2 * THEIR_STEP)
            assert pixel * shift.u_px == pytest.approx(THEIR_THEORY[one], rel=0.01)  # one surface's own scatter
        assert shift.ncc == pytest.approx(THEIR_CORRELATION, abs=0.015)


def test_mean_sensitivity_is_that_of_theory(assembly):
    found = measured_sensitivity(Simulation(assembly), ("x", "y"))
    for dof, axis in (("x", "u"), ("y", "v")):
        fit = found.fits[dof][axis]
        assert fit.ci95[0] < fit.theory < fit.ci95[1] and fit.ci95[1] - fit.ci95[0] < 0.03


def test_speckle_is_as_large_as_theirs(assembly, images):
    """Its mean size is the width at which the correlation of the intensity has fallen to 1/e: 2 lambda z / (pi w) across
    the plane of incidence, along it divided by the cosine."""
    size = np.mean([sizes(rest, 1e3 * assembly.detector.pitch) for rest, *_ in images], axis=0)
    plain = 1e3 * 2 * 632.8e-6 * 400 / (math.pi * 0.675)
    np.testing.assert_allclose(size, [plain / math.cos(math.pi / 6), plain], rtol=0.05)
    np.testing.assert_allclose(size, THEIR_SPECKLE, rtol=0.08)


def sizes(intensity, pixel):
    """Widths along columns and rows of the correlation of an intensity at 1/e [um]."""
    deviation = intensity - intensity.mean(dtype=float)
    correlation = np.fft.ifft2(np.abs(np.fft.fft2(deviation)) ** 2).real
    widths = []
    for line in (correlation[0] / correlation[0, 0], correlation[:, 0] / correlation[0, 0]):
        k = int(np.argmax(line < math.exp(-1)))
        widths.append(2 * pixel * (k - 1 + (line[k - 1] - math.exp(-1)) / (line[k - 1] - line[k])))
    return widths
