"""A page to hand on: one HTML file that needs nothing besides, for screens light and dark, telephones and paper."""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np
from PIL import Image

from ..machine.files import plain
from ..version import __version__

_DIGITS = 6
"""Digits of numbers that are drawn; tables carry all of them."""


@dataclass(frozen=True)
class Section:
    """heading; body: HTML; anchor: its place in the page's own links."""

    heading: str
    body: str
    anchor: str


@dataclass(frozen=True)
class Cell:
    """A table's cell: words, the number behind them in full, how strongly it is shaded, 0 to 1, an interval; bar: a
    part of the cell's width that is filled."""

    words: str
    value: float | None = None
    shade: float | None = None
    interval: tuple[float, float] | None = None
    bar: float | None = None


def page(
    title: str, lead: str, sections: Sequence[Section], data: Mapping[str, object] | None = None,
    scripts: Sequence[str] = (),
) -> str:  # fmt: skip
    """The whole page. lead: HTML below the title; data: named values that it carries for programs, as JSON; scripts:
    files of this folder besides the one that every page has."""
    links = "\n".join(f'<a href="#{one.anchor}">{text(one.heading)}</a>' for one in sections)
    bodies = "\n".join(
        f'<section id="{one.anchor}">\n<h2>{text(one.heading)}</h2>\n{one.body}\n</section>' for one in sections
    )
    code = "".join(f"<script>\n{_file(name)}</script>\n" for name in ("page.js", *scripts))
    carried = "\n".join(_json_block(value, f'id="{name}" ') for name, value in (data or {}).items())
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="speckle_mi {__version__}">
<link rel="icon" href="data:,">
<title>{text(title)}</title>
<style>
{_file("page.css")}</style>
</head>
<body>
<header><h1>{text(title)}</h1><button id="theme" type="button">light / dark</button></header>
{lead}
<nav>
{links}
</nav>
{bodies}
<footer>speckle_mi {__version__}</footer>
{carried}
{code}</body>
</html>
"""


def text(words: object) -> str:
    """Words as HTML shows them."""
    return html.escape(str(words), quote=True)


def paragraphs(lines: Iterable[str], kind: str = "") -> str:
    """A paragraph for each line."""
    return "\n".join(f'<p class="{kind}">{text(line)}</p>' if kind else f"<p>{text(line)}</p>" for line in lines)


def table(heads: Sequence[str], rows: Sequence[Sequence[Cell | str]], caption: str = "", name: str = "") -> str:
    """A table; its first column names the rows. Cells that are words stand to the left."""
    named = f' data-table="{text(name)}"' if name else ""
    top = f"<thead><tr>{''.join(f'<th>{text(head)}</th>' for head in heads)}</tr></thead>" if heads else ""
    body = "\n".join(
        f"<tr><th>{text(row[0].words if isinstance(row[0], Cell) else row[0])}</th>{''.join(map(_cell, row[1:]))}</tr>"
        for row in rows
    )
    said = f"<caption>{text(caption)}</caption>" if caption else ""
    return f'<div class="wide"><table{named}>{said}{top}<tbody>\n{body}\n</tbody></table></div>'


def _cell(cell: Cell | str) -> str:
    if isinstance(cell, str):
        return f'<td class="text">{text(cell)}</td>'
    held = {"value": cell.value} | dict(zip(("low", "high"), cell.interval or (), strict=False))
    known = {name: float(one) for name, one in held.items() if one is not None and np.isfinite(one)}
    number = "".join(f' data-{name}="{one!r}"' for name, one in known.items())
    kind, part = ("bar", cell.bar) if cell.bar is not None else ("heat", cell.shade)
    shade = "" if part is None else f' class="{kind}" style="--h:{min(max(part, 0), 1):.3f}"'
    return f"<td{number}{shade}>{text(cell.words)}</td>"


def plot(spec: Mapping[str, object]) -> str:
    """A figure that the page's script draws.

    spec: ``title``; ``x`` (what runs to the right, with its unit); ``symbol``, ``unit`` of it; ``views``, of which one
    is shown: each with ``panels`` of ``y``, ``height`` [px] and ``series``, which have ``look`` (``mean``: marks,
    ``curve``, ``thin``: several faint lines ``ys``, ``lost``: crosses), ``hue`` (0 or 1), ``x``, ``y``, errors ``e``
    and the ``name`` they have in the key.
    """
    return (
        f'<figure class="plot"><h3>{text(spec["title"])}</h3><button class="reset" type="button" hidden>'
        f'whole range</button>{_json_block(spec)}<div class="canvas"></div><div class="key"></div>'
        '<div class="readout"></div></figure>'
    )


def numbers(values: Iterable[float]) -> list[float | None]:
    """Numbers to draw: few digits, None where there is none."""
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in map(float, values)]


def png(values: np.ndarray) -> str:
    """A grey picture (rows, columns) uint8 as PNG in base64."""
    held = io.BytesIO()
    Image.fromarray(values).save(held, format="png", optimize=False, compress_level=6)
    return base64.b64encode(held.getvalue()).decode("ascii")


def json_block(value: object) -> str:
    """Data in a page that its script reads."""
    return _json_block(value)


def _json_block(value: object, attributes: str = "") -> str:
    written = json.dumps(plain(value), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script {attributes}type="application/json">{written}</script>'


def _file(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")
