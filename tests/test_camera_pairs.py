"""Shifts and their uncertainties from pictures as a camera takes them, against the shifts that were made.

``pytest tests/test_camera_pairs.py`` judges a SAMPLE of the pairs; ``python tests/test_camera_pairs.py`` judges all 500
(or ``--pairs N``) and prints a table by brightness. It holds when the stated uncertainty is that of the errors within
STATED in every decade of electrons, no shift is off by FARTHEST uncertainties, hardly one is refused, and pictures that
share a camera and nothing else are never given a shift.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

from camera_pairs import ELECTRONS, UNRELATED_EVERY, WINDOW, CameraPair, camera_pair  # noqa: E402

from speckle_mi.measurement.correlator import correlate  # noqa: E402
from speckle_mi.measurement.shift import Shift  # noqa: E402

PAIRS, SAMPLE = 500, 60
"""Pairs that the command judges, and that a run of the tests does."""

FAINT = (10_159, 11_029, 12_264)
"""Unrelated pairs whose uneven gain makes a peak at zero that is significant by itself."""

STATED = 0.2
"""Relative error of the stated uncertainty that is promised."""

SPREAD_SIGMAS = 3.0
"""Standard errors that the rms of a finite number of errors is allowed on top."""

FARTHEST = 6.0
"""Error over uncertainty of the worst shift: what a fixed pattern pulls is further off, and no noise of 1,000 is."""

REFUSED = 0.01
"""Share of pairs that may be refused although they show one pattern."""


@dataclass(frozen=True)
class Judged:
    pair: CameraPair
    found: Shift

    @property
    def in_sigmas(self) -> np.ndarray:
        """Errors (2,) of the shift in units of the uncertainties that are stated for them."""
        error = np.subtract((self.found.u_px, self.found.v_px), self.pair.shift)
        return error / (self.found.sigma_u_px, self.found.sigma_v_px)


def judged(number: int) -> Judged:
    pair = camera_pair(number)
    return Judged(pair, correlate(pair.reference, pair.moved, WINDOW))


def rms(pairs: list[Judged]) -> float:
    return float(np.sqrt(np.mean([np.square(pair.in_sigmas) for pair in pairs])))


def allowed(pairs: list[Judged]) -> float:
    """Logarithm by which an rms error in units of its uncertainty may differ from 1."""
    return math.log(1 + STATED) + SPREAD_SIGMAS / math.sqrt(2 * 2 * len(pairs))


def measured_and_refused(pairs: list[Judged]) -> tuple[list[Judged], list[Judged]]:
    related = [pair for pair in pairs if pair.pair.shift is not None]
    return [p for p in related if p.found.ok], [p for p in related if not p.found.ok]


def invented(pairs: list[Judged]) -> list[Judged]:
    """Pairs that show two patterns and were given a shift."""
    return [pair for pair in pairs if pair.pair.shift is None and pair.found.ok]


@pytest.fixture(scope="module")
def sample() -> list[Judged]:
    return [judged(number) for number in range(SAMPLE)]


def test_the_uncertainty_of_a_camera_s_pictures_is_that_of_their_shifts(sample):
    measured, refused = measured_and_refused(sample)
    assert abs(math.log(rms(measured))) < allowed(measured)
    assert max(np.abs(pair.in_sigmas).max() for pair in measured) < FARTHEST
    assert len(refused) <= math.ceil(REFUSED * len(measured)), [pair.found.message for pair in refused]


def test_no_shift_is_made_of_what_stands_still(sample):
    assert sum(pair.pair.shift is None for pair in sample) == SAMPLE // UNRELATED_EVERY
    assert not invented(sample)


@pytest.mark.parametrize("number", FAINT)
def test_a_faint_peak_at_zero_is_not_taken_for_the_pattern(number):
    found = judged(number).found
    assert found.status == "fixed pattern" and found.significance > 1.0, found


def test_a_pair_is_the_same_whenever_it_is_drawn():
    one, two = camera_pair(3), camera_pair(3)
    assert np.array_equal(one.moved, two.moved) and one.shift == two.shift


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--pairs", type=int, default=PAIRS, help="pairs that are judged (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first one (default: %(default)s)")
    asked = parser.parse_args(arguments)
    pairs = [judged(number) for number in range(asked.first, asked.first + asked.pairs)]
    measured, refused = measured_and_refused(pairs)
    print("electrons a pixel   pairs   rms error / uncertainty   worst")
    held = True
    edges = np.geomspace(*ELECTRONS, 4)
    for least, most in zip(edges, edges[1:]):
        mine = [pair for pair in measured if least <= pair.pair.electrons < most]
        worst = max(np.abs(pair.in_sigmas).max() for pair in mine)
        held &= abs(math.log(rms(mine))) < allowed(mine) and worst < FARTHEST
        print(f"{least:7,.0f} to {most:6,.0f} {len(mine):9d} {rms(mine):25.2f} {worst:7.1f}")
    for pair in refused:
        print(f"refused: {pair.found.status}, {pair.found.message}")
    for pair in invented(pairs):
        print(f"unrelated, but given ({pair.found.u_px:.2f}, {pair.found.v_px:.2f}) px: still {pair.pair.still}")
    unrelated = sum(pair.pair.shift is None for pair in pairs)
    print(f"{len(refused)} of {len(measured) + len(refused)} refused; {len(invented(pairs))} of {unrelated} invented")
    return int(not held or len(refused) > REFUSED * len(pairs) or bool(invented(pairs)))


if __name__ == "__main__":
    raise SystemExit(main())
