"""The shorter catalogue of stiff and extreme cases: every bound holds, every limit is told in words."""

from __future__ import annotations

import csv
import json
from dataclasses import fields

import pytest

FEWEST_CHECKS = 120
"""Checks of the quick catalogue, so that none is lost unnoticed."""


@pytest.fixture(scope="module")
def catalogue(mitsuba):
    """Every check of the quick catalogue."""
    from speckle_mi.validation.stability.catalogue import catalogue

    return list(catalogue(quick=True))


def test_every_case_keeps_its_bound_or_says_why_not(catalogue):
    broken = [
        f"{c.case}: {c.quantity}: {c.value} for {c.reference}, {c.error:.2g} > {c.bound:.2g} {c.message}"
        for c in catalogue
        if c.verdict != "ok" and c.verdict != "limit"
    ]
    assert not broken, "\n".join(broken)
    assert len(catalogue) >= FEWEST_CHECKS


def test_every_limit_has_a_message_of_one_line(catalogue):
    limits = [check for check in catalogue if check.verdict == "limit"]
    assert limits
    for check in limits:
        assert check.message and "\n" not in check.message and "Traceback" not in check.message, check


def test_the_catalogue_writes_its_table_and_tells_a_broken_bound_by_its_status(
    catalogue, tmp_path, monkeypatch, capsys
):
    from speckle_mi import stability
    from speckle_mi.validation.stability import catalogue as cases
    from speckle_mi.validation.stability.case import Check, within

    monkeypatch.setattr(cases, "catalogue", lambda *_, **__: iter(catalogue[:3]))
    assert stability.main(["--out", str(tmp_path / "out")]) == 0
    with open(tmp_path / "out" / "stability.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    held = json.loads((tmp_path / "out" / "stability.json").read_text())["checks"]
    assert len(rows) == len(held) == 3
    assert list(rows[0]) == list(held[0]) == [column.name for column in fields(Check)]
    assert "3 checks: 3 ok" in capsys.readouterr().out
    off = within("made up", "error", 1.0, 0.0, 1.0, 0.5)
    monkeypatch.setattr(cases, "catalogue", lambda *_, **__: iter([*catalogue[:3], off]))
    assert stability.main(["--quiet"]) == 1


def test_a_case_that_fails_in_an_unexpected_way_is_broken_and_does_not_stop_the_others():
    from speckle_mi.validation.stability.case import Case, checks_of

    def falls_over(quick):
        yield from ()
        raise ZeroDivisionError("by nought")

    (check,) = checks_of(Case(falls_over), quick=True)
    assert check.verdict == "broken" and "by nought" in check.message


def test_not_a_number_breaks_a_bound():
    from speckle_mi.validation.stability.case import compared

    assert compared("made up", "value", float("nan"), 1.0, 1e9).verdict == "broken"
