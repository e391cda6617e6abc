"""Reports of studies: pages that work by themselves and carry the numbers of the studies' JSON."""

from __future__ import annotations

import json
import re

import pytest
from browser import NAMES, Browser, browser_path
from conftest import SCENES

from speckle_mi import compare, optimise, uncertainty
from speckle_mi.command_line import DONE, command

LASER, BOTH = str(SCENES / "tilted_laser.xml"), str(SCENES / "both_tilted.xml")
SMALL = ["-D", "width=64", "-D", "height=48"]


@pytest.fixture(scope="module")
def studies(mitsuba, tmp_path_factory):
    """Folders of three small studies, by name."""
    folder = tmp_path_factory.mktemp("studies")
    (folder / "T.toml").write_text("[laser_angle]\nnormal = 0.5\n[detector_distance]\nuniform = 1\n")
    (folder / "G.toml").write_text('minimise = ["crosstalk.z"]\nmaximise = ["rz.y"]\n["extent.z"]\nat_most = 80\n')
    (folder / "R.toml").write_text('rank_by = "crosstalk.z"\n["crosstalk.z"]\nat_most = 0.1\n')
    bounds = "laser_angle=5:60,detector_distance=40:90"
    lines = {
        uncertainty: ["uncertainty", LASER, *SMALL, "--tolerances", "T.toml", "--samples", "16", "--frames", "0"],
        compare: ["compare", LASER, BOTH, *SMALL, "--require", "R.toml", "--seeds", "3"],
        optimise: ["optimise", LASER, *SMALL, "--free", bounds, "--goal", "G.toml", "--trials", "60"],
    }
    for module, (name, *line) in lines.items():
        line = [str(folder / word) if word.endswith(".toml") else word for word in line]
        assert command(module.main, [*line, "--out", str(folder / name), "--quiet"]) == DONE
    return folder


def content(studies, name):
    (path,) = [path for path in (studies / name).glob("*.json") if path.name != "settings.json"]
    return json.loads(path.read_text())


def values(text, table):
    """data-value of every cell of a table, by row."""
    (body,) = re.findall(rf'data-table="{table}".*?<tbody>(.*?)</tbody>', text, re.DOTALL)
    return {re.search(r"<th>(.*?)</th>", row)[1]: list(map(float, re.findall(r'data-value="([^"]+)"', row)))
            for row in body.split("<tr>")[1:]}  # fmt: skip


def test_budget_and_sobol_indices_are_those_of_the_study(studies):
    told, text = content(studies, "uncertainty"), (studies / "uncertainty" / "report.html").read_text()
    entry = told["sensitivity"]["ry"]["u"]
    found = values(text, "budget")["ry\u00a0→\u00a0u"]
    assert found[:3] == [entry["nominal"], entry["mean"], entry["standard_uncertainty"]] and entry["combined"] in found
    for kind in ("first_order", "total"):
        wanted = [entry[kind][name] for name in told["factors"] if entry[kind].get(name) is not None]
        assert values(text, kind)["ry\u00a0→\u00a0u"] == wanted and wanted


def test_ranking_and_figures_are_those_of_the_study(studies):
    told, text = content(studies, "compare"), (studies / "compare" / "report.html").read_text()
    ranked = sorted(told["candidates"], key=lambda one: one["rank"])
    assert list(values(text, "ranking")) == [one["scene"] for one in ranked]
    wanted = [one["figures"]["crosstalk.z"]["value"] for one in ranked]
    assert values(text, "figures")["crosstalk.z"] == wanted


def test_best_designs_and_their_trade_off_are_those_of_the_study(studies):
    told, text = content(studies, "optimise"), (studies / "optimise" / "report.html").read_text()
    found = values(text, "best")
    assert len(found) == len(told["best"]) > 1
    for number, one in enumerate(told["best"], 1):
        assert found[str(number)][:2] == [one["values"][name] for name in told["free"]]
    front = json.loads(re.search(r'class="plot">.*?<script type="application/json">(.*?)</script>', text, re.DOTALL)[1])
    (series,) = front["views"][0]["panels"][0]["series"]
    assert series["x"] == sorted(series["x"]) and len(series["x"]) == len(told["best"])


@pytest.mark.skipif(browser_path() is None, reason=f"none of {', '.join(NAMES)} is installed")
def test_pages_of_studies_work_by_themselves(studies, tmp_path):
    with Browser(tmp_path) as browser:
        for name in ("uncertainty", "compare", "optimise"):
            page = studies / name / "report.html"
            browser.open(page)
            assert browser.console == [] and page.stat().st_size < 8_000_000
            assert [one for one in browser.requests if not one.startswith("data:")] == [page.resolve().as_uri()]
            shown = browser.value("document.querySelector('#command pre').textContent")
            assert f"python -m speckle_mi.{name} " in shown
            assert browser.value("[...document.images].every(one => one.naturalWidth > 0)")
            browser.resize(390, 844, is_phone=True)
            browser.settle()
            assert browser.value("document.documentElement.scrollWidth") <= 390
            browser.resize(1200, 900)
