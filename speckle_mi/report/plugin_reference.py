"""The reference of what a scene can name, as Markdown, from the plugins' own documentation."""

from __future__ import annotations

import ast
import re
from pathlib import Path

KINDS = {"integrator": "Integrator", "emitter": "Emitters", "shape": "Shapes", "sensor": "Sensor"}
"""What plugins are, in the order in which they are listed."""

_NAME = re.compile(
    r"\.\. _(?P<kind>\w+)-(?P<name>\w+):\n\n(?P<title>.+?) \(:monosp:`\w+`\)\n-+\n\n(?P<body>.*)", re.DOTALL
)
_TABLE, _CODE = ".. pluginparameters::", ".. tabs::"


def folder() -> Path:
    """Where the plugins are: beside the package in a source tree, inside it in an installation."""
    package = Path(__file__).resolve().parents[1]
    tree = package.parent / "plugins"
    return tree if (tree / "coherent.py").is_file() else package / "plugins"


def plugin_reference() -> str:
    """The whole page. Raises ValueError for a plugin whose documentation is not in the form of the others."""
    found: dict[str, list[tuple[str, str, str]]] = {kind: [] for kind in KINDS}
    for path in sorted(folder().glob("[!_]*.py")):
        documentation = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        head = _NAME.match(documentation)
        if head is None or head["kind"] not in found:
            raise ValueError(f"{path.name}: has no documentation in the form of the other plugins")
        found[head["kind"]].append((head["name"], head["title"], _markdown(head["body"])))
    parts = [
        "# What a scene can name",
        "The plugins' own documentation, put together by `python -m speckle_mi.document --plugins plugins/README.md`. "
        "Lengths are millimetres, wavelengths nanometres, roughness and correlation length micrometres, angles "
        "degrees. Stock shapes of Mitsuba keep their meaning: a `sphere` with a `dielectric` is a ball lens, a "
        "`rectangle` or `disk` with a `conductor` a mirror, anything opaque a blocker. *exposed*: `mi.traverse` shows "
        "the value.",
        ", ".join(f"[`{name}`](#{name})" for kind in found.values() for name, *_ in kind),
    ]
    for kind, plugins in found.items():
        parts.append(f"## {KINDS[kind]}")
        for name, title, body in plugins:
            parts += [f'<a id="{name}"></a>\n\n### {title}: `{name}`', body]
    return "\n\n".join(parts) + "\n"


def _markdown(body: str) -> str:
    """Tables, code and paragraphs of one plugin."""
    parts, lines = [], body.splitlines()
    while lines:
        line = lines.pop(0)
        if line == _TABLE:
            parts.append(_table(_indented(lines)))
        elif line == _CODE:
            parts += _code(_indented(lines))
        elif line.strip():
            paragraph = [line]
            while lines and lines[0].strip() and not lines[0].startswith(".. "):
                paragraph.append(lines.pop(0))
            parts.append(_inline("\n".join(paragraph)))
    return "\n\n".join(parts)


def _indented(lines: list[str]) -> list[str]:
    """Takes the lines that belong to a directive."""
    taken = []
    while lines and (not lines[0].strip() or lines[0].startswith(" ")):
        taken.append(lines.pop(0))
    return taken


def _table(lines: list[str]) -> str:
    rows: list[list[str]] = []
    for line in filter(str.strip, lines):
        text = line.strip()
        if text.startswith("* - "):
            rows.append([text.removeprefix("* - ")])
        elif text == "-" or text.startswith("- "):
            rows[-1].append(text.removeprefix("-").strip())
        else:
            rows[-1][-1] += f" {text}"
    written = ["| parameter | type | meaning | |", "|---|---|---|---|"]
    for name, kind, meaning, exposed in rows:
        cells = f"`{name}`", kind.strip("|"), _inline(meaning).replace("|", r"\|"), exposed.strip("|")
        written.append(f"| {' | '.join(cells)} |")
    return "\n".join(written)


def _code(lines: list[str]) -> list[str]:
    """A fenced block for each language."""
    blocks: list[tuple[str, list[str]]] = []
    for line in lines:
        if (head := line.strip()).startswith(".. code-tab:: "):
            blocks.append((head.removeprefix(".. code-tab:: "), []))
        elif blocks:
            blocks[-1][1].append(line.removeprefix(" " * 8))
    return ["```{}\n{}\n```".format(language, "\n".join(text).strip("\n")) for language, text in blocks]


def _inline(text: str) -> str:
    text = re.sub(r":math:`([^`]*)`", r"$\1$", text)
    text = re.sub(r":\w+:`~?([^`]*)`", r"`\1`", text)
    return text.replace("``", "`")
