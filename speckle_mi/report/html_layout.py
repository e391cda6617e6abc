"""The assembly to turn in space, as one page that works by itself."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np

from ..experiments.layout import Layout
from ..experiments.layout_3d import Pattern, Solid
from ..machine.files import replacing
from .drawing import WAYS
from .html import Section, json_block, page, paragraphs, png, table

_DIGITS = 7
"""Of coordinates: a nanometre in a decimetre."""

_POSES = {"free": "aslant", "side": "from the side", "above": "from above", "front": "along the normal"}

_HELP = (
    "Drag to turn, with the shift key or two fingers to move; the wheel, or two fingers apart, to come nearer. "
    "A double click brings a place into the middle."
)


def write_space(
    path: str | os.PathLike, layout: Layout, solids: Sequence[Solid], patterns: Mapping[str, Pattern], title: str,
    notes: Sequence[str] = (),
) -> None:  # fmt: skip
    """Writes the page, whole or not at all. patterns: light on detectors, by name; notes: what has to be said."""
    poses = "".join(f'<option value="{name}">{words}</option>' for name, words in _POSES.items())
    body = (
        f'<figure class="space"><div class="controls"><label>look <select class="pose">{poses}</select></label>'
        '<label>at <select class="focus"></select></label><label><input type="checkbox" class="names" checked> names'
        "</label></div>"
        f'{json_block(_spec(layout, solids, patterns))}<canvas tabindex="0" aria-label="the assembly"></canvas>'
        f"<figcaption>{_HELP}</figcaption></figure>"
    )
    lead = paragraphs([f"Warning: {one}" for one in layout.warnings], "warning") + paragraphs(notes, "note")
    sections = [
        Section("In space", body, "space"),
        Section("In numbers", table((), layout.facts, name="facts"), "facts"),
    ]
    with replacing(path) as temporary:
        temporary.write_text(page(title, lead, sections, scripts=("space.js",)), "utf-8")


def _spec(layout: Layout, solids: Sequence[Solid], patterns: Mapping[str, Pattern]) -> dict:
    """Everything in the drawing's frame: along the target's normal, along its x, along its y, from its origin."""

    def local(points: np.ndarray) -> list:
        flat = (np.atleast_2d(points) - layout.origin) @ layout.axes
        return [[float(f"{value:.{_DIGITS}g}") for value in point] for point in flat]

    lines = [{"kind": "ray", "colour": WAYS[number % len(WAYS)], "chief": place == 0, "points": local(ray)}
             for number, rays in enumerate(layout.rays.values()) for place, ray in enumerate(rays)]  # fmt: skip
    lines += [{"kind": "ended", "points": local(one.ray)} for one in layout.problems if one.ray is not None]
    return {
        "solids": [
            {"name": one.name, "kind": one.kind, "polygons": [local(polygon) for polygon in one.polygons],
             "rims": [local(rim) for rim in one.rims], "place": local(one.place)[0]}
            for one in solids
        ],
        "lines": lines,
        "arrows": _arrows(layout, solids, patterns, local),
        "problems": [{"place": local(one.place)[0], "words": one.words} for one in layout.problems],
        "patterns": [_pattern(one, local) for one in patterns.values()],
    }  # fmt: skip


def _pattern(pattern: Pattern, local) -> dict:
    """Corner of the first pixel, the sides, and the picture."""
    grid, (half_u, half_v) = pattern.grid, pattern.grid.half_size
    corners = grid.centre + np.array([[-half_u, -half_v], [half_u, -half_v], [-half_u, half_v]]) @ [grid.u, grid.v]
    shown = np.round((pattern.shown / 255.0) ** 2 * 255).astype(np.uint8)
    return {"corners": local(corners), "png": png(shown)}


def _arrows(layout: Layout, solids: Sequence[Solid], patterns: Mapping[str, Pattern], local) -> list[dict]:
    """The target's axes, and the directions of columns and rows of every detector."""
    points = np.concatenate([polygon for one in solids if one.kind != "laser" for polygon in one.polygons])
    size = 0.1 * float(np.linalg.norm(np.ptp(points, axis=0)))
    normal, x, y = layout.axes.T
    found = [(layout.origin, size * axis, name) for axis, name in ((x, "x"), (y, "y"), (normal, "z"))]
    for one in solids:
        if one.kind == "detector":
            first, second, third = one.polygons[0][:3]
            found += [(first, second - first, "u"), (first, third - second, "v")]
    return [{"from": local(start)[0], "to": local(start + along)[0], "name": name} for start, along, name in found]
