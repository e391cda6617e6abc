"""The blocks of code in a page of documentation, and the scene that one of them grows into."""

from __future__ import annotations

import re
from pathlib import Path

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_PART = re.compile(r'<(\w+) type="\w+" id="(\w+)">.*?</\1>', re.DOTALL)


def blocks(page: Path) -> list[tuple[str, str]]:
    """(language, text) of every block, in their order."""
    return _BLOCK.findall(page.read_text(encoding="utf-8"))


def grown(scene: str, block: str) -> str:
    """A scene with a block's parts: in the place of those of their names, else at its end; a whole scene is itself."""
    if block.startswith("<scene"):
        return block
    for default in re.findall(r"<default .*?/>", block):
        scene = scene.replace("<integrator", f"{default}\n  <integrator", 1)
    for part in _PART.finditer(block):
        old = [one for one in _PART.finditer(scene) if one[2] == part[2]]
        scene = scene.replace(old[0][0], part[0]) if old else scene.replace("</scene>", f"{part[0]}\n</scene>")
    return scene
