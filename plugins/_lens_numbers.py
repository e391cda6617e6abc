"""The numbered parameters of a lens: how many surfaces they describe, their names, limits and defaults."""

from __future__ import annotations

import re
from collections.abc import Collection

import mitsuba as mi

from speckle_mi.optics.glass import Glass
from speckle_mi.optics.glass_catalogue import glass_named
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, read_text

MOST_SURFACES = 40
"""Surfaces of one lens: more are a mistake."""

_OF_SURFACES = ("radius", "conic", "aspheric", "form", "diameter")
_OF_MEDIA = ("thickness", "ior", "glass")
_NUMBERED = re.compile(rf"({'|'.join((*_OF_SURFACES, *_OF_MEDIA))})([1-9]\d*)")

ROTATIONAL = "rotational"
FORMS = (ROTATIONAL, "cylinder_x", "cylinder_y")

LENGTH = {"at_least": 1e-6, "at_most": 1e5, "unit": "mm"}
CONIC = {"at_least": -1e4, "at_most": 1e4}
"""Beyond, a surface is a cone that turns round within a point."""

INDEX = {"at_least": 1.0, "at_most": 10.0}


class LensNumbers:
    """Which numbers describe a lens: what ``props`` name decides.

    surfaces: how many there are; limits: those of every number, by its name; defaults: of those that need not be given;
    glasses: by the numbers of the surfaces before them, the parameters that name a glass. ``known``: the surfaces
    behind which the glass is known without any.
    """

    def __init__(self, props: mi.Properties, known: Collection[int] = ()) -> None:
        self._where = describe(props)
        self._given = set(props.keys())
        self.surfaces, self._last = self._count()
        if self.surfaces > MOST_SURFACES:
            raise SceneError(
                f"{self._where}: {self._last!r} makes {self.surfaces} surfaces, must be at most {MOST_SURFACES}"
            )
        self.limits: dict[str, dict] = {}
        self.defaults: dict[str, float] = {}
        for number in range(1, self.surfaces + 1):
            self._take(f"radius{number}", {"unit": "mm"}, 0.0)
        for number in range(1, self.surfaces + 1):
            self._take(f"conic{number}", CONIC, 0.0)
        for number in range(1, self.surfaces):
            self._take(self.of_medium("thickness", number), LENGTH)
        names = [self.diameter(number) for number in range(1, self.surfaces + 1)]
        for name in dict.fromkeys(names):
            self._take(name, LENGTH)
        self.glasses: dict[int, str] = {}
        for number in range(1, self.surfaces):
            index, glass = self.of_medium("ior", number), self.of_medium("glass", number)
            if glass in self._given and index in self._given:
                raise SceneError(f"{self._where}: has {index!r} and {glass!r}, must have one of them")
            if glass in self._given:
                self.glasses[number] = glass
            elif number not in known:
                self._take(index, INDEX)

    @property
    def all(self) -> range:
        """Numbers of the surfaces."""
        return range(1, self.surfaces + 1)

    def check_forms(self, forms: list[str], aspheric: list[tuple[float, ...]]) -> None:
        """SceneError for a cylinder with aspheric coefficients, or in a lens of several diameters."""
        for number, form in enumerate(forms, start=1):
            if form == ROTATIONAL:
                continue
            if aspheric[number - 1]:
                raise SceneError(
                    f"{self._where}: has 'form{number}' = {form!r} and 'aspheric{number}', must have one of them: an "
                    "asphere is rotational"
                )
            if len({self.diameter(one) for one in self.all}) > 1:
                raise SceneError(
                    f"{self._where}: 'form{number}' is {form!r} and the surfaces have diameters of their own, must "
                    "have one 'diameter': the edge of a cylinder is not level"
                )

    def of_medium(self, kind: str, number: int) -> str:
        """Name of the thickness or index between surface ``number`` and the next."""
        numbered = f"{kind}{number}"
        if kind in self._given and numbered in self._given:
            raise SceneError(f"{self._where}: has {kind!r} and {numbered!r}, must have one of them")
        if kind in self._given and self.surfaces > 2:
            raise SceneError(
                f"{self._where}: parameter {kind!r} is that of a lens of two surfaces, must be {kind + '1'!r} to "
                f"'{kind}{self.surfaces - 1}': {self._last!r} makes {self.surfaces} surfaces"
            )
        return numbered if self.surfaces > 2 or numbered in self._given else kind

    def diameter(self, number: int) -> str:
        """Name of the clear diameter of surface ``number``."""
        numbered = f"diameter{number}"
        return numbered if numbered in self._given else "diameter"

    def _take(self, name: str, limits: dict, *default: float) -> None:
        self.limits[name] = limits
        if default:
            self.defaults[name] = default[0]

    def _count(self) -> tuple[int, str]:
        """How many surfaces there are, and the parameter that says so."""
        found = [(2, "")]
        for name in self._given:
            if match := _NUMBERED.fullmatch(name):
                kind, number = match[1], int(match[2])
                found.append((number + (kind in _OF_MEDIA), name))
        return max(found)


def read_glass(props: mi.Properties, parameter: str) -> Glass:
    """A glass by name. SceneError with near names where there is none."""
    name = read_text(props, parameter)
    try:
        return glass_named(name)
    except ValueError as error:
        raise SceneError(f"{describe(props)}: parameter {parameter!r}: {error}") from None
