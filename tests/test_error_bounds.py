"""The stated error of the sums is a bound and within three times the true one: a sample of ``error_bounds.py``."""

from __future__ import annotations

import pytest
from error_bounds import outcome

LOOSEST = 3.0
"""Stated error over the true one that is promised; twice what is measured is stated."""


@pytest.mark.parametrize("number", [0, 1, 2, 3, 4, 6, 7])
def test_the_stated_error_bounds_the_true_one_and_is_near_it(assemble, tmp_path, number):
    found = outcome(number, assemble, tmp_path)
    assert 1.0 <= found.ratio <= LOOSEST, found
