"""The example scenes that come with the package."""

from __future__ import annotations

import re
from pathlib import Path


def folder() -> Path:
    """Where they are: beside the package in a source tree, inside it in an installation."""
    tree = Path(__file__).resolve().parents[2] / "scenes"
    return tree if (tree / "tilted_laser.xml").is_file() else Path(__file__).resolve().parent / "examples"


def scenes() -> dict[str, Path]:
    """Names of the scenes and their files, those of ready parts as ``parts/NAME``."""
    found = {path.stem: path for path in sorted(folder().glob("*.xml"))}
    return found | {f"parts/{path.stem}": path for path in sorted(folder().glob("parts/*.xml"))}


def summary(path: Path) -> str:
    """What a scene shows: the first sentence of the comment that it begins with, without its source."""
    comment = re.search(r"<!--(.*?)-->", path.read_text(encoding="utf-8"), re.DOTALL)
    text = " ".join(comment[1].partition("\n\n")[0].split()) if comment else ""
    text = re.sub(r"\s*\(Opt\. Eng\.[^)]*\([^)]*\)[^)]*\)", "", text)
    return re.split(r"\.(?:\s|$)", text, maxsplit=1)[0]
