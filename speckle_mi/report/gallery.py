"""A gallery of scenes: each one's drawing, speckle image and sensitivities, as Markdown with small pictures."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from ..experiments.layout import layout_of
from ..experiments.one_frame import OneFrameSensitivity, measured_sensitivity
from ..experiments.slides import around_light
from ..field.simulation import Simulation
from ..geometry.pose import sensitivity_unit
from ..images.levels import white_level
from ..machine.files import replacing
from ..measurement.sensitivity import Sensitivity
from ..scene.assembly import Assembly
from .console import number, with_interval
from .drawing import draw_layout

_WIDTH, _COLOURS = 960, 48
"""Of a drawing [px], and in it."""

_SIDE = 220
"""Of the part of a speckle image that is shown [px]."""


@dataclass(frozen=True)
class GalleryEntry:
    """One scene: name; what it shows, in a sentence; its assemblies by detector; and the first one's sensitivities."""

    name: str
    summary: str
    assemblies: Mapping[str, Assembly]
    found: OneFrameSensitivity


def make_entry(
    folder: Path, name: str, summary: str, assemblies: Mapping[str, Assembly], surfaces: int
) -> GalleryEntry:
    """Draws a scene's pictures into ``folder`` and measures its first detector on some surfaces."""
    _draw(folder / f"{name}.png", assemblies, name)
    simulation = Simulation(next(iter(assemblies.values())))
    _speckle(folder / f"{name}_speckle.png", simulation.frame().image.measured)
    return GalleryEntry(name, summary, assemblies, measured_sensitivity(simulation, surfaces=surfaces))


def write_gallery(path: Path, entries: list[GalleryEntry], command: str) -> None:
    """Writes the page."""
    surfaces = len(entries[0].found.result.seeds)
    parts = [
        "# Gallery",
        f"Every example scene: its drawing, the middle of its speckle image ({_SIDE} pixels a side at most), and its "
        f"sensitivities on the detector from one frame of each of {surfaces} surfaces, with 95 % "
        f"intervals, beside theory. Made by `{command}`.",
        ", ".join(f"[{one.name}](#{one.name})" for one in entries),
        *(_section(one) for one in entries),
    ]
    with replacing(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _section(one: GalleryEntry) -> str:
    which = f" Detector `{next(iter(one.assemblies))}`:" if len(one.assemblies) > 1 else ""
    lines = [
        f'<a id="{one.name}"></a>\n\n## {one.name}\n',
        f"{one.summary} (`scenes/{one.name}.xml`).{which}\n",
        f"![drawing of {one.name}]({one.name}.png)\n",
        f"![speckle of {one.name}]({one.name}_speckle.png)\n",
        "| motion | unit | u | theory | v | theory |",
        "|---|---|---|---|---|---|",
    ]
    for dof, fitted in one.found.fits.items():
        cells = [f"{with_interval(fitted[axis])} | {_theory(fitted[axis])}" for axis in "uv"]
        lines.append(f"| {dof} | {sensitivity_unit(dof)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _theory(fit: Sensitivity) -> str:
    return number(fit.theory)


def _draw(path: Path, assemblies: Mapping[str, Assembly], title: str) -> None:
    """The drawing in few colours, so that it is small."""
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "drawing.png"
        draw_layout(whole, layout_of(assemblies), title)
        with Image.open(whole) as image:
            small = image.convert("RGB")
    size = _WIDTH, round(small.height * _WIDTH / small.width)
    small = small.resize(size, Image.Resampling.LANCZOS)
    _save(path, small.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE))  # keeps colours of few pixels


def _speckle(path: Path, measured: np.ndarray) -> None:
    rows, columns = (min(size, _SIDE) for size in measured.shape)
    row, column = around_light(measured, (rows, columns))
    cut = measured[row : row + rows, column : column + columns]
    levels = np.round(255 * np.clip(cut / white_level(cut), 0, 1)).astype(np.uint8)
    _save(path, Image.fromarray(levels).quantize(_COLOURS))


def _save(path: Path, image: Image.Image) -> None:
    with replacing(path) as temporary:
        image.save(temporary, format="png", optimize=True)
