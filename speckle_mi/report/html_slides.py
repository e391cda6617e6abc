"""A page's pictures of a sweep: speckle image and complex field, with a slider over the displacements."""

from __future__ import annotations

import numpy as np

from ..experiments.slides import Slide, Slides
from ..experiments.sweep_result import SweepResult, SweepSettings
from ..geometry.pose import unit_of
from .html import json_block, paragraphs, png, text

_FIELD = (
    '<figure><canvas class="field"></canvas><canvas class="turn"></canvas><figcaption>complex field: colour is phase, '
    "from −π to π as in the strip; brightness is amplitude</figcaption></figure>"
)


def slides(result: SweepResult, settings: SweepSettings, pitch: float) -> str:
    """The first surface's pictures with their slider; pitch [mm] of the detector. They must have one at rest."""
    held: Slides = result.slides
    rows, columns = held.rest.light.shape
    spec = {
        "rows": rows,
        "columns": columns,
        "motions": {dof: _frames(dof, held, result, settings) for dof in settings.dofs},
    }
    motions = "".join(f"<option>{text(dof)}</option>" for dof in settings.dofs)
    size = f"{columns} x {rows} pixels, {1e3 * pitch * columns:.4g} x {1e3 * pitch * rows:.4g} µm"
    field = ""
    if held.rest.phase is not None:
        field = _FIELD
    lines = [f"Surface {settings.seeds[0]}, window around the light's middle: {size}. White is one level in all."]
    if held.missing:
        lines.append(f"{held.missing} frames were there from an earlier run and have no picture here.")
    return (
        paragraphs(lines, "note")
        + f'<div class="slides">{json_block(spec)}<div class="controls"><label>motion <select class="motion">{motions}'
        '</select></label><input type="range" min="0" step="1" aria-label="displacement"><button class="play" '
        'type="button">play</button></div><p class="where"></p><div class="pictures"><figure>'
        f'<canvas class="light"></canvas><figcaption>speckle image</figcaption></figure>{field}{_overview(held)}'
        "</div></div>"
    )


def _frames(dof: str, held: Slides, result: SweepResult, settings: SweepSettings) -> list[dict]:
    """A motion's pictures in order of displacement, one at rest among them."""
    found = {record.displacement: record for record in result.records
             if record.dof == dof and record.seed == settings.seeds[0]}  # fmt: skip
    kept, frames = held.motions.get(dof, []), []
    if all(slide.displacement for slide in kept):
        frames.append({"rest": True, "at": 0.0, "words": "at rest", "png": _png(held.rest)})
    for slide in kept:
        words = f"{dof} = {slide.displacement:+.4g} {unit_of(dof)}"
        record = found.get(slide.displacement)
        if record is not None and np.isfinite(record.shift_u_um):
            words += f": shift u {record.shift_u_um:+.2f} µm, v {record.shift_v_um:+.2f} µm"
        if record is not None and np.isfinite(record.ncc):
            words += f", correlation {record.ncc:.3f}"
        frames.append({"rest": slide.displacement == 0, "at": slide.displacement, "words": words.replace("-", "−"),
                       "png": _png(slide)})  # fmt: skip
    return sorted(frames, key=lambda frame: frame["at"])


def _png(slide: Slide) -> str:
    """The planes over one another, as the page's script takes them apart."""
    return png(np.vstack([plane for plane in (slide.light, slide.phase, slide.amplitude) if plane is not None]))


def _overview(held: Slides) -> str:
    """The whole image at rest, with the window's frame on it."""
    values = np.round((held.overview / 255.0) ** 2 * 255).astype(np.uint8)
    shape = np.array(values.shape) * held.reduced
    top, left = 100 * np.array(held.corner) / shape
    height, width = 100 * np.array(held.rest.light.shape) / shape
    where = f"left:{left:.2f}%;top:{top:.2f}%;width:{width:.2f}%;height:{height:.2f}%"
    reduced = f", every pixel the mean of {held.reduced} x {held.reduced}" if held.reduced > 1 else ""
    return (
        f'<figure><div class="framed"><img alt="the whole detector" src="data:image/png;base64,{png(values)}">'
        f'<i style="{where}"></i></div><figcaption>the whole detector at rest{reduced}; framed: the window</figcaption>'
        "</figure>"
    )
