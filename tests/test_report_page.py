"""A sweep's report in a real browser: whole by itself, its numbers those of the summary, its pictures those of the
frames."""

from __future__ import annotations

import base64
import io
import json
import re

import numpy as np
import pytest
from browser import NAMES, Browser, browser_path
from PIL import Image
from scene_builder import direction, free_space

from speckle_mi.command_line import DONE, command
from speckle_mi.experiments.slides import Slides
from speckle_mi.images.exr import read_field
from speckle_mi.images.field_image import FieldImage
from speckle_mi.sweep import main

LARGEST = 8_000_000  # Bytes of a report that is handed on.
HALF_A_LEVEL = 0.5 / 255
MOTIONS, STEPS = ("x", "ry"), 5

needs_browser = pytest.mark.skipif(browser_path() is None, reason=f"none of {', '.join(NAMES)} is installed")


@pytest.fixture(scope="module")
def swept(mitsuba, tmp_path_factory):
    """Folder of a sweep of a scene whose name has to be written carefully in a page."""
    folder = tmp_path_factory.mktemp("report")
    scene = folder / "a <b> & c.xml"
    detector = {"width": 96, "height": 80, "pixel_pitch": 0.012}
    scene.write_text(free_space(direction(30), detector=detector, target={"point_sources": 40}))
    line = [str(scene), "--dof", ",".join(MOTIONS), "--steps", str(STEPS), "--range", "0.1", "--seeds", "3", "--quiet"]
    assert command(main, [*line, "--out", str(folder / "out")]) == DONE
    return folder / "out"


@pytest.fixture(scope="module")
def text(swept):
    return (swept / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture
def page(browser, swept):
    """The report, opened anew."""
    browser.resize(1200, 900)
    browser.prefer("light")
    browser.open(swept / "report.html")
    return browser


def blocks(text, kind):
    """Data that the page carries in the script elements within elements of a class."""
    found = re.findall(rf'class="{kind}">.*?<script type="application/json">(.*?)</script>', text, re.DOTALL)
    return [json.loads(one) for one in found]


def planes(spec, frame):
    values = np.asarray(Image.open(io.BytesIO(base64.b64decode(frame["png"]))))
    return values.reshape(-1, spec["rows"], spec["columns"])


def test_a_report_is_one_small_file_that_names_no_other(text):
    assert len(text.encode()) < LARGEST
    addresses = re.findall(r'(?:src|href|action|data)\s*=\s*"([^"]*)"', text) + re.findall(r"url\(([^)]*)\)", text)
    assert all(address.startswith(("data:", "#")) for address in addresses)
    assert "http:" not in text.replace("http://www.w3.org/2000/svg", "") and "https:" not in text
    assert "<b>" not in text and "a &lt;b&gt; &amp; c.xml" in text


def test_a_report_names_the_command_that_made_it(swept, text):
    shown = re.search(r"<pre>(python -m speckle_mi.sweep .*?)</pre>", text)[1]
    assert "--dof x,ry --steps 5 --range 0.1 --seeds 3" in shown and str(swept) in shown


def test_pictures_are_those_of_the_frames(swept, text):
    (spec,) = blocks(text, "slides")
    for dof in MOTIONS:
        frames = spec["motions"][dof]
        assert [frame["rest"] for frame in frames] == [False, False, True, False, False]
        for number, frame in enumerate(frames):
            image = read_field(swept / "frames" / f"seed0_{dof}_{number:03d}.exr")
            rest = read_field(swept / "frames" / "seed0_reference.exr")
            light, phase = planes(spec, frame)
            white = np.quantile(rest.intensity, 0.995)
            shown = np.sqrt(np.clip(image.intensity / white, 0, 1))
            assert np.abs(light / 255 - shown).max() <= 1.001 * HALF_A_LEVEL
            turned = np.exp(1j * (phase * (2 * np.pi / 256) - np.pi)) * np.conj(image.field)
            assert np.abs(np.angle(turned)).max() <= 1.001 * np.pi / 256


@needs_browser
def test_no_error_and_nothing_fetched(page, swept):
    assert page.console == []
    others = [address for address in page.requests if not address.startswith("data:")]
    assert others == [(swept / "report.html").resolve().as_uri()]


@needs_browser
def test_tables_carry_the_numbers_of_the_summary(page, swept):
    summary = json.loads((swept / "summary.json").read_text())
    for axes in (("u", "v"), ("x", "y")):
        rows = page.value(
            f"[...document.querySelectorAll('table[data-table=\"sensitivity {axes[0]} {axes[1]}\"] tbody tr')].map("
            "row => [row.cells[0].textContent, ...[...row.cells].slice(2).map("
            "cell => ({...cell.dataset, t: cell.textContent}))])"
        )
        assert [row[0] for row in rows] == list(MOTIONS)
        for dof, *cells in rows:
            for axis, (value, theory, bias, scatter) in zip(axes, (cells[:4], cells[4:]), strict=True):
                told = summary["sensitivity"][dof][axis]
                assert [float(value[name]) for name in ("value", "low", "high")] == [told["value"], *told["ci95"]]
                assert value["t"].startswith(f"{told['value']:+.4f} ± {np.diff(told['ci95'])[0] / 2:.4f}")
                for cell, name in ((theory, "theory"), (bias, "bias"), (scatter, "scatter_um")):
                    assert float(cell["value"]) == told[name]


@needs_browser
def test_the_slider_moves_the_picture(page, text):
    (spec,) = blocks(text, "slides")
    seen = []
    for place, frame in enumerate(spec["motions"]["x"]):
        page.value(f"""(() => {{ const slider = document.querySelector('.slides input');
            slider.value = {place}; slider.dispatchEvent(new Event('input')); }})()""")
        page.settle()
        data = page.value("""(() => { const canvas = document.querySelector('canvas.light');
            return [...canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data]; })()""")
        grey = np.array(data).reshape(spec["rows"], spec["columns"], 4)[:, :, 0]
        assert np.abs(grey - 255 * (planes(spec, frame)[0] / 255.0) ** 2).max() <= 1
        assert page.value("document.querySelector('.where').textContent") == frame["words"]
        seen.append(grey)
    assert all(np.any(one != other) for one, other in zip(seen, seen[1:], strict=False))


@needs_browser
def test_plots_are_read_and_enlarged_with_the_pointer(page, swept):
    figure = "document.querySelector('#shifts figure')"
    page.value(f"{figure}.scrollIntoView()")
    page.settle()
    left, top, width = page.value(f"""(() => {{ const box = {figure}.querySelector('svg').getBoundingClientRect();
        return [box.left, box.top, box.width]; }})()""")
    rows = [line.split(",") for line in (swept / "sweep.csv").read_text().splitlines()]
    column, last = rows[0].index("shift_u_um"), [row for row in rows if row[:2] == ["x", "0.05"]]
    mean = np.mean([float(row[column]) for row in last])
    page.pointer("mouseMoved", left + width - 15, top + 60)
    page.settle()
    said = page.value(f"{figure}.querySelector('.readout').textContent")
    assert said.startswith("x = 0.05 mm: ") and f"u {float(f'{mean:.4g}'):g} ±" in said
    labels = f"[...{figure}.querySelectorAll('svg .tick[text-anchor=middle]')].map(one => one.textContent)"
    before = page.value(labels)
    page.drag((left + 0.55 * width, top + 60), (left + 0.9 * width, top + 60))
    after = [float(label.replace("−", "-")) for label in page.value(labels)]
    assert len(before) >= 3 and min(after) >= 0 and max(after) < 0.05 and len(after) >= 2
    page.value(f"{figure}.querySelector('.reset').click()")
    assert page.value(labels) == before


@needs_browser
def test_colours_follow_the_reader_and_words_stand_out(page):
    def contrast():
        levels = page.value("""['backgroundColor', 'color'].map(name => getComputedStyle(document.body)[name]
            .match(/[0-9.]+/g).slice(0, 3).map(x => x / 255)
            .map(x => x <= 0.04 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4))""")
        paper, ink = (float(np.dot(level, [0.2126, 0.7152, 0.0722])) for level in levels)
        return paper, (max(paper, ink) + 0.05) / (min(paper, ink) + 0.05)

    bright = contrast()
    page.prefer("dark")
    dark = contrast()
    assert dark[0] < 0.05 < 0.9 < bright[0] and min(dark[1], bright[1]) > 7  # the strictest demand of WCAG 2
    page.value("document.querySelector('#theme').click()")
    assert contrast() == bright


@needs_browser
def test_a_telephone_shows_all_of_it_without_scrolling_sideways(page):
    page.resize(390, 844, is_phone=True)
    page.settle()
    assert page.value("document.documentElement.scrollWidth") <= 390


@needs_browser
def test_it_prints(page):
    """On white, whatever the reader likes on a screen, and no wider than a sheet of A4 between its margins."""
    page.resize(718, 1000)
    page.prefer("dark", media="print")
    assert page.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.value("getComputedStyle(document.body).color") == "rgb(0, 0, 0)"
    assert page.value("document.documentElement.scrollWidth") <= 718
    page.prefer("light")
    paper = page.paper()
    assert paper.startswith(b"%PDF") and paper.count(b"/Type /Page\n") + paper.count(b"/Type /Page ") >= 2


@pytest.mark.parametrize("detectors, steps", [(1, 10), (1, 1000), (12, 10), (40, 1000)])
def test_pictures_of_many_frames_and_detectors_stay_small(detectors, steps):
    places = np.linspace(-0.1, 0.1, steps)
    ones = np.ones((480, 744), np.float32)
    image = FieldImage(ones, ones.astype(np.complex64), dn=ones)
    slides = Slides(("x", "y", "z", "rx", "ry", "rz"), places, seed=0, share=1 / detectors)
    slides.add(None, 0.0, 0, image)
    for dof in slides.dofs:
        for place in places:
            slides.add(dof, float(place), 0, image)
            slides.add(dof, float(place), 1, image)
    assert slides.missing == 0
    every = [slides.rest, *(slide for motion in slides.motions.values() for slide in motion)]
    assert len(every) == 1 + 6 * len(slides.displacements) and slides.displacements[0] == places[0]
    size = sum(plane.nbytes for slide in every for plane in (slide.light, slide.phase, slide.amplitude))
    assert detectors * (size + slides.overview.nbytes) * 4 / 3 < 0.8 * LARGEST


@pytest.mark.parametrize("shape", [(1, 1), (1, 4096), (3, 5)])
def test_pictures_of_any_detector_lie_on_it(shape):
    rng = np.random.default_rng(0)
    image = FieldImage(rng.random(shape, np.float32), None)
    slides = Slides(("z",), np.array([-1.0, 1.0]), seed=4)
    slides.add("z", -1.0, 4, image)  # before the one at rest, as after an interruption
    slides.add(None, 0.0, 4, image)
    slides.add("z", 1.0, 4, image)
    assert slides.missing == 1 and slides.rest.phase is None
    rows, columns = slides.rest.light.shape
    assert slides.corner[0] + rows <= shape[0] and slides.corner[1] + columns <= shape[1]
    assert slides.rest.light.max() > 0 and np.abs(slides.overview / 255.0).max() <= 1
