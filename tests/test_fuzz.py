"""Damaged scenes, field images and pictures by the thousand: refused in one line or read, never a crash or a hang.

Examples are drawn in batches and judged in a process of their own, where an abort does not take the tests along.
"""

from __future__ import annotations

import base64
import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bad_scenes import PARTS, scene_with
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from speckle_mi.images.exr import write_field
from speckle_mi.images.field_image import FieldImage

WORKER = Path(__file__).with_name("fuzz_worker.py")
BATCH = 250
BATCHES = {"scene": 4, "exr": 5, "picture": 4}
"""Batches of each kind: 3,250 examples together."""

SLOWEST = 10.0
"""Seconds of computing that a single example may take; it takes milliseconds."""

PATIENCE = 240
"""Seconds for a batch, start of the process included, after which it counts as hung."""


def judged(kind: str, examples: list[bytes], folder: Path) -> list[list]:
    """(outcome, message, seconds) of every example; fails where the process does not live to the end."""
    given_path, outcome_path = folder / "examples.jsonl", folder / "outcomes.jsonl"
    given_path.write_text("".join(json.dumps(base64.b64encode(e).decode()) + "\n" for e in examples), encoding="ascii")
    try:
        done = subprocess.run(
            [sys.executable, str(WORKER), kind, str(given_path), str(outcome_path)],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        ending = f"status {done.returncode}: {done.stderr[-500:]}"
    except subprocess.TimeoutExpired:
        ending = "hung"
    outcomes = [json.loads(line) for line in outcome_path.read_text(encoding="utf-8").splitlines()]
    assert len(outcomes) == len(examples), f"{ending}; the last example was {examples[len(outcomes)]!r}"
    return outcomes


def all_is_well(examples: list[bytes], outcomes: list[list]) -> None:
    for example, (outcome, message, seconds) in zip(examples, outcomes, strict=True):
        assert outcome in ("refused", "accepted"), (message, example)
        assert "\n" not in message and "Traceback" not in message and len(message) < 1000, (message, example)
        assert outcome == "accepted" or message, example
        assert seconds < SLOWEST, (seconds, example)


# Scenes

ODD_VALUES = [
    "",
    "0",
    "-0",
    "-1",
    "1e308",
    "1e-308",
    "1e400",
    "nan",
    "inf",
    "-inf",
    "0x10",
    "1,5",
    "1.5.5",
    "true",
    "$x",
    "9" * 30,
    "\u00b5",
    "'",
    "None",
    "../../..",
    "circle",
    "auto",
    "1 2 3",
    "0 0 0 0",
    "%s%s%n",
]
SCENE_TEXT = scene_with()
STARTS = [SCENE_TEXT, scene_with(lens="", aperture=""), *(scene_with(**{part: ""}) for part in PARTS)]


def _pieces(text: str, mark: str) -> list[tuple[int, int]]:
    """Where the values of an attribute stand in a scene."""
    import re

    return [match.span(1) for match in re.finditer(rf'{mark}="([^"]*)"', text)]


@st.composite
def damaged_scenes(draw) -> bytes:
    text = draw(st.sampled_from(STARTS))
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["value", "name", "type", "cut", "character", "double", "bytes"]))
        if kind in ("value", "name", "type"):
            places = _pieces(text, kind)
            if places:
                first, last = draw(st.sampled_from(places))
                new = draw(
                    st.sampled_from(ODD_VALUES) | st.text(max_size=6) | st.floats().map(repr) | st.integers().map(str)
                )
                text = text[:first] + new.replace('"', "") + text[last:]
        elif text:
            a = draw(st.integers(0, len(text) - 1))
            b = min(len(text), a + draw(st.integers(1, 80)))
            if kind == "cut":
                text = text[:a] + text[b:]
            elif kind == "double":
                text = text[:b] + text[a:b] + text[b:]
            elif kind == "character":
                text = text[:a] + draw(st.sampled_from(list('<>&"/=\0 \n') + ["]]>", "<!--", "<?"])) + text[a + 1 :]
            else:
                text = text[:a]
    return text.encode("utf-8", errors="replace")


# Images


@pytest.fixture(scope="session")
def whole_images(tmp_path_factory) -> list[bytes]:
    """Field images as they are written, and as other programs compress them."""
    import OpenEXR

    folder = tmp_path_factory.mktemp("whole")
    random = np.random.default_rng(0)
    intensity = random.random((6, 8), dtype=np.float32)
    write_field(folder / "own.exr", FieldImage(intensity, intensity + 1j, {"pose": "", "wavelength_nm": 632.8}))
    kinds = (
        OpenEXR.ZIP_COMPRESSION,
        OpenEXR.PIZ_COMPRESSION,
        OpenEXR.RLE_COMPRESSION,
        OpenEXR.DWAA_COMPRESSION,
        OpenEXR.PXR24_COMPRESSION,
    )
    for number, compression in enumerate(kinds):
        with OpenEXR.File({"compression": compression, "type": OpenEXR.scanlineimage}, {"Y": intensity}) as file:
            file.write(str(folder / f"other{number}.exr"))
    return [path.read_bytes() for path in sorted(folder.iterdir())]


@pytest.fixture(scope="session")
def whole_pictures() -> list[bytes]:
    """Pictures of every kind that cameras and other programs write."""
    import imagecodecs
    import tifffile
    from PIL import Image

    random = np.random.default_rng(1)
    deep = random.integers(0, 4096, (16, 20), dtype=np.uint16)
    colours = random.integers(0, 65536, (16, 20, 3), dtype=np.uint16)
    grey = (deep >> 4).astype(np.uint8)
    palette = np.tile(np.arange(256, dtype=np.uint16) * 257, (3, 1))
    tiffs = [
        (deep, {"compression": "lzw", "predictor": True}),
        (deep, {"compression": "zstd"}),
        (deep, {"compression": "deflate", "tile": (16, 16)}),
        (grey, {"photometric": "palette", "colormap": palette}),
        (grey, {"photometric": "miniswhite", "compression": "packbits"}),
        (np.moveaxis(colours, -1, 0), {"photometric": "rgb", "planarconfig": "separate"}),
        (deep.astype(np.float32), {"bigtiff": True}),
    ]
    whole = [imagecodecs.png_encode(colours)]
    for values, options in tiffs:
        buffer = io.BytesIO()
        tifffile.imwrite(buffer, values, **options)
        whole.append(buffer.getvalue())
    for values, kind in ((grey, "PNG"), (deep, "PNG"), (grey, "JPEG"), (grey, "BMP"), (grey, "GIF"), (grey, "WEBP")):
        buffer = io.BytesIO()
        Image.fromarray(values).save(buffer, kind)
        whole.append(buffer.getvalue())
    return whole


@st.composite
def damaged_images(draw, whole: list[bytes]) -> bytes:
    content = bytearray(draw(st.sampled_from(whole)))
    for _ in range(draw(st.integers(1, 4))):
        kind = draw(st.sampled_from(["byte", "header", "cut", "out", "size", "noise"]))
        place = draw(st.integers(0, max(len(content) - 1, 0)))
        if kind == "byte" and content:
            content[place] = draw(st.integers(0, 255))
        elif kind == "header" and content:
            content[place % min(len(content), 400)] = draw(st.sampled_from([0, 1, 127, 128, 255]))
        elif kind == "cut":
            del content[place:]
        elif kind == "out":
            del content[place : place + draw(st.integers(1, 30))]
        elif kind == "size":
            window = content.find(b"dataWindow\0box2i\0")
            if window >= 0:
                corner = window + 21 + 4 * draw(st.integers(0, 3))
                content[corner : corner + 4] = draw(st.integers(-(2**31), 2**31 - 1)).to_bytes(4, "little", signed=True)
        else:
            content[place:place] = draw(st.binary(max_size=20))
    return bytes(content)


def drawn(strategy, number: int) -> list[bytes]:
    """A batch of examples, the same for the same number."""
    held: list[bytes] = []

    @seed(number)
    @settings(max_examples=BATCH, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(strategy)
    def collect(example):
        held.append(example)

    collect()
    return held[:BATCH]


@pytest.mark.parametrize("number", range(BATCHES["scene"]))
def test_a_damaged_scene_is_refused_in_one_line_or_read(tmp_path, number):
    examples = drawn(damaged_scenes(), number)
    assert len(examples) == BATCH
    all_is_well(examples, judged("scene", examples, tmp_path))


@pytest.mark.parametrize("number", range(BATCHES["exr"]))
def test_a_damaged_image_is_refused_in_one_line_or_read(tmp_path, whole_images, number):
    examples = drawn(damaged_images(whole_images), number)
    assert len(examples) == BATCH
    all_is_well(examples, judged("exr", examples, tmp_path))


@pytest.mark.parametrize("number", range(BATCHES["picture"]))
def test_a_damaged_picture_is_refused_in_one_line_or_read(tmp_path, whole_pictures, number):
    examples = drawn(damaged_images(whole_pictures), number)
    assert len(examples) == BATCH
    all_is_well(examples, judged("picture", examples, tmp_path))


def test_the_judge_lets_whole_files_pass(tmp_path, whole_images, whole_pictures):
    for kind, whole in (("exr", whole_images), ("picture", whole_pictures)):
        assert [outcome for outcome, *_ in judged(kind, whole, tmp_path)] == ["accepted"] * len(whole)
    assert judged("scene", [scene_with().encode()], tmp_path)[0][0] == "accepted"
