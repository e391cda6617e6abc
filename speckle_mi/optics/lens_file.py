"""Lens files of vendors: sequential prescriptions of Zemax as text (.zmx), read as far as they describe a lens.

A file is a list of surfaces from the object to the image. What stands in glass, or between glasses, is the lens: the
surfaces before the first glass and behind the last, and those with air on both sides (a stop of its own, a reference
plane, a first surface doubled), part nothing and are left out; their distances are not.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import inf, isfinite, nan

from .glass import Glass, ModelGlass
from .glass_catalogue import glass_named

MOST_BYTES = 4_000_000
MOST_SURFACES = 200
"""Of a file, those of the system around the lens included."""

_UNITS = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "METER": 1000.0, "M": 1000.0}
_KINDS = ("STANDARD", "EVENASPH", "TOROIDAL", "BICONICX", "BICONIC")
_UNREAD = ("COAT", "SCOL", "POPS", "SLAB", "HIDE", "COMM", "PRIM")
_SURFACE = re.compile(r"SURF\s+(\d+)$")
_SAME = 1e-12


@dataclass
class FileSurface:
    """One surface as a file describes it.

    number: its own; kind: TYPE; curvature [1/mm]; conic; aspheric: coefficients of r^2, r^4, ... [mm^-1, mm^-3, ...];
    thickness: distance to the next [mm]; semi_diameter [mm], 0 where there is none; medium: its glass's name or model,
    None for air; is_stop: whether it is the system's stop; parameters: PARM values by number, as they stand; form:
    as a lens calls it.
    """

    number: int
    kind: str = "STANDARD"
    curvature: float = 0.0
    conic: float = 0.0
    thickness: float = 0.0
    semi_diameter: float = 0.0
    clear: float = 0.0
    medium: str | ModelGlass | None = None
    is_stop: bool = False
    parameters: dict[int, float] = field(default_factory=dict)
    aspheric: tuple[float, ...] = ()
    form: str = "rotational"


@dataclass(frozen=True)
class LensFile:
    """The lens of a file.

    surfaces: in order; thicknesses: between them [mm]; media: between them, a name, a model or None for air;
    catalogues: makers' names whose glasses the file means; left_out: what of the file does not count, in words.
    """

    surfaces: tuple[FileSurface, ...]
    thicknesses: tuple[float, ...]
    media: tuple[str | ModelGlass | None, ...]
    catalogues: tuple[str, ...]
    left_out: tuple[str, ...]

    def glass(self, number: int) -> Glass:
        """The medium behind surface ``number`` (from 0). Raises ValueError, with near names, for an unknown glass."""
        medium = self.media[number]
        if not isinstance(medium, str):
            return medium or glass_named("air")
        for maker in self.catalogues:
            try:
                return glass_named(f"{maker}/{medium}")
            except ValueError:
                continue
        return glass_named(medium)


def read_lens(data: bytes) -> LensFile:
    """The lens of a .zmx file. Raises ValueError, which names the surface, where it is none or cannot be expressed."""
    if len(data) > MOST_BYTES:
        raise ValueError(f"has {len(data)} bytes, must have at most {MOST_BYTES} for a lens")
    lines = _decoded(data).splitlines()
    unit, catalogues, surfaces, unread = _read(lines)
    if not surfaces:
        raise ValueError("has no surface (SURF), must be a sequential lens file of Zemax as text (.zmx)")
    for place, one in enumerate(surfaces):
        if one.number != place:
            raise ValueError(f"surface {place} is missing (after it comes {one.number}): the file is not whole")
    return _lens(surfaces, unit, catalogues, unread)


def _decoded(data: bytes) -> str:
    """The text of a file: UTF-8, UTF-16 of either order, with a mark or without, or Latin-1."""
    for mark, name in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"), (b"\xef\xbb\xbf", "utf-8")):
        if data.startswith(mark):
            return _text(data[len(mark) :], name)
    if data[1:400:2].count(0) > 0.3 * len(data[1:400:2]):
        return _text(data, "utf-16-le")
    if data[0:400:2].count(0) > 0.3 * len(data[0:400:2]):
        return _text(data, "utf-16-be")
    try:
        return _text(data, "utf-8")
    except UnicodeDecodeError:
        return _text(data, "latin-1")


def _text(data: bytes, encoding: str) -> str:
    text = data.decode(encoding, errors="strict" if encoding == "utf-8" else "replace")
    start = text[:4000]
    strange = sum(1 for one in start if (ord(one) < 32 and one not in "\t\r\n\f\x1a") or one == "\ufffd")
    if strange > 0.01 * len(start):
        raise ValueError("is binary, must be a sequential lens file of Zemax as text (.zmx; .zar, .zmf are archives)")
    return text


def _read(lines: list[str]) -> tuple[float, tuple[str, ...], list[FileSurface], dict[str, int]]:
    """Unit [mm], glass catalogues, surfaces, and how often what is not read occurs."""
    unit, catalogues, surfaces, unread = 1.0, (), [], {}
    for line in lines:
        words = line.split()
        if not words:
            continue
        key, values = words[0].upper(), words[1:]
        if match := _SURFACE.match(" ".join([key, *values])):
            if len(surfaces) >= MOST_SURFACES:
                raise ValueError(f"has more than {MOST_SURFACES} surfaces, must have fewer")
            surfaces.append(FileSurface(int(match[1])))
        elif key == "MODE" and values and values[0].upper() != "SEQ":
            raise ValueError(f"is not sequential (MODE {values[0]}), must be")
        elif key == "UNIT" and values:
            if values[0].upper() not in _UNITS:
                raise ValueError(f"has the unit {values[0]!r}, must have one of {', '.join(_UNITS)}")
            unit = _UNITS[values[0].upper()]
        elif key == "GCAT":
            catalogues = tuple(values)
        elif surfaces:
            _take(surfaces[-1], key, values, unread)
    return unit, catalogues, surfaces, unread


def _take(surface: FileSurface, key: str, values: list[str], unread: dict[str, int]) -> None:
    """One line of a surface."""
    if key == "TYPE" and values:
        surface.kind = values[0].upper()
    elif key == "CURV":
        surface.curvature = _number(surface, key, values)
    elif key == "CONI":
        surface.conic = _number(surface, key, values)
    elif key == "DISZ":
        surface.thickness = inf if values and values[0].upper().startswith("INF") else _number(surface, key, values)
    elif key == "DIAM":
        surface.semi_diameter = _number(surface, key, values)
    elif key == "CLAP" and len(values) > 1:
        surface.clear = _number(surface, key, values[1:])
    elif key == "GLAS" and values:
        surface.medium = _medium(surface, values)
    elif key == "PARM" and len(values) > 1:
        surface.parameters[int(_number(surface, key, values))] = _number(surface, key, values[1:])
    elif key == "STOP":
        surface.is_stop = True
    elif key in _UNREAD:
        unread[key] = unread.get(key, 0) + 1


def _number(surface: FileSurface, key: str, values: list[str]) -> float:
    try:
        number = float(values[0])
    except (IndexError, ValueError):
        number = nan
    if not isfinite(number):
        said = values[0][:20] if values else ""
        raise ValueError(f"surface {surface.number}: {key} is {said!r}, must be a finite number")
    return number


def _medium(surface: FileSurface, values: list[str]) -> str | ModelGlass | None:
    """A glass by name, by n_d and V (which some name ___BLANK), or None for what is called air."""
    name = values[0]
    is_model = (len(values) > 1 and values[1] == "1") or name.strip("_").upper() == "BLANK"
    if not is_model:
        return None if name.upper() in ("AIR", "VACUUM") else name
    if len(values) < 5:
        raise ValueError(f"surface {surface.number}: a model glass needs its n and V, must have them (GLAS)")
    n, abbe = _number(surface, "n of GLAS", values[3:]), _number(surface, "V of GLAS", values[4:])
    if not (1.0 <= n <= 10.0 and abbe >= 0):
        raise ValueError(f"surface {surface.number}: a glass of n = {n:g}, V = {abbe:g}, must be n = 1 to 10, V >= 0")
    return ModelGlass(n, abbe)


def _lens(surfaces: list[FileSurface], unit: float, catalogues, unread: dict[str, int]) -> LensFile:
    """What of a file's surfaces is a lens, in mm."""
    for one in surfaces:
        if isinstance(one.medium, str) and one.medium.upper() == "MIRROR":
            raise ValueError(f"surface {one.number} is a mirror, must refract (a mirror is a shape 'mirror')")
        if "BLACK" in one.kind:
            raise ValueError(f"surface {one.number} is a black box ({one.kind}), whose inside its vendor hides")
    inside = [place for place, one in enumerate(surfaces[:-1]) if one.medium is not None]
    if not inside:
        raise ValueError("has no glass (GLAS), must describe a lens: is the file whole?")
    first, last = inside[0], inside[-1] + 1
    if first == 0:
        raise ValueError("surface 0, the object, stands in glass, must stand in air")
    if last == len(surfaces) - 1:
        raise ValueError(f"surface {last} is the last and bounds a glass: the file is not whole (or images in glass)")
    kept, gaps, dropped = [], [], []
    for place in range(first, last + 1):
        one, before = surfaces[place], surfaces[place - 1].medium if place > first else None
        after = one.medium if place < last else None
        if place < last and not isfinite(one.thickness):
            raise ValueError(f"surface {one.number}: DISZ is infinite, must be finite inside a lens")
        _require_expressible(one)
        if before == after and kept:
            dropped.append(one.number)
            gaps[-1] += one.thickness * unit
            continue
        kept.append(_in_mm(one, unit))
        gaps.append(one.thickness * unit)
    media = tuple(one.medium for one in kept[:-1])
    left_out = _left_out(surfaces, first, last, dropped, unread)
    return LensFile(tuple(kept), tuple(gaps[:-1]), media, tuple(catalogues), left_out)


def _require_expressible(surface: FileSurface) -> None:
    if surface.kind not in _KINDS:
        raise ValueError(
            f"surface {surface.number} is of TYPE {surface.kind[:20]}, must be one of {', '.join(_KINDS)} in a lens"
        )
    if surface.kind not in ("STANDARD", "EVENASPH"):
        return _require_cylinder(surface)
    highest = 8 if surface.kind == "EVENASPH" else 0
    used = [number for number, value in surface.parameters.items() if value != 0.0 and highest]
    if any(number > highest or number < 1 for number in used):
        raise ValueError(f"surface {surface.number}: PARM {max(used)} is no even asphere's, must be 1 to {highest}")
    if surface.parameters.get(1, 0.0) != 0.0 and highest:
        raise ValueError(
            f"surface {surface.number}: an even asphere's coefficient of r^2 (PARM 1) is {surface.parameters[1]:g}, "
            "must be 0: put it into the radius"
        )


def _require_cylinder(surface: FileSurface) -> None:
    """Makes a toroid or biconic the cylinder, or the surface of revolution, that it is; ValueError where it is neither.

    CURV and CONI are those along y; PARM 1 is the radius along x (0: plane), and PARM 2 a biconic's conic there.
    """
    along_x = surface.parameters.get(1, 0.0)
    is_biconic = surface.kind != "TOROIDAL"
    conic_x = surface.parameters.get(2, 0.0) if is_biconic else 0.0
    more = [number for number, value in surface.parameters.items() if value and number > (2 if is_biconic else 1)]
    if more:
        raise ValueError(f"surface {surface.number}: PARM {more[0]} of {surface.kind} is not 0, must be for a cylinder")
    if surface.curvature and along_x:
        is_round = is_biconic and abs(surface.curvature * along_x - 1) < _SAME and surface.conic == conic_x
        if not is_round:
            raise ValueError(f"surface {surface.number} is a {surface.kind} of two radii, must have one: a cylinder")
    elif surface.curvature:
        surface.form = "cylinder_y"
    elif along_x:
        surface.form, surface.curvature, surface.conic = "cylinder_x", 1 / along_x, conic_x


def _in_mm(one: FileSurface, unit: float) -> FileSurface:
    """A surface in mm, its PARM values as coefficients of r^4, r^6, ..."""
    size = max((number for number, value in one.parameters.items() if value and one.kind == "EVENASPH"), default=0)
    aspheric = tuple(one.parameters.get(number, 0.0) * unit ** (1 - 2 * number) for number in range(2, size + 1))
    return FileSurface(
        one.number, one.kind, one.curvature / unit, one.conic, one.thickness * unit, one.semi_diameter * unit,
        one.clear * unit, one.medium, one.is_stop, one.parameters, aspheric, one.form,
    )  # fmt: skip


def _left_out(surfaces, first: int, last: int, dropped: list[int], unread: dict[str, int]) -> tuple[str, ...]:
    """What of a file does not count, in words."""
    found = [f"surface {number} (the same on both sides)" for number in dropped]
    found += [f"surface {one.number} (in air)" for one in [*surfaces[1:first], *surfaces[last + 1 : -1]]]
    stop = next((one.number for one in surfaces if one.is_stop), None)
    if stop is not None and not first <= stop <= last:
        found.append(f"the stop at surface {stop}")
    if "COAT" in unread:
        found.append("coatings")
    return tuple(found)
