"""How well sensitivities are to be known: asked for in words, and how many surfaces that takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.pose import is_rotation
from ..measurement.sensitivity import Sensitivity

MOST_SURFACES = 10_000
"""Surfaces beyond which more are not tried."""

MOST_AT_ONCE = 4.0
"""Factor by which surfaces are added at most before it is looked anew: the scatter of few is not known well."""

ROOM = 1.1
"""Factor on the surfaces that an interval is predicted to need."""

EXAMPLES = "1%, 0.01mm/mm, 0.02mm/deg or several of them with commas"
AXES = ("u", "v")


@dataclass(frozen=True)
class Precision:
    """Largest half widths of 95 % intervals along the detector's axes.

    relative: to the largest sensitivity to a motion of the same kind; per_mm, per_degree: [mm/mm, mm/deg]. None is any.
    """

    relative: float | None = None
    per_mm: float | None = None
    per_degree: float | None = None

    @classmethod
    def parse(cls, text: str) -> Precision:
        """From ``"1%"``, ``"0.01mm/mm"``, ``"0.02mm/deg"`` or several with commas. Raises InputError."""
        found: dict[str, float] = {}
        for item in (part.strip() for part in text.split(",")):
            name, number = next(
                ((name, item.removesuffix(unit)) for name, unit in _UNITS.items() if item.endswith(unit)), ("", item)
            )
            try:
                value = float(number) * (0.01 if name == "relative" else 1.0)
            except ValueError:
                value = math.nan
            if not name or not 0 < value < math.inf or name in found:
                raise InputError(f"--precision {text!r}: must be {EXAMPLES}, each above 0 and once")
            found[name] = value
        return cls(**found)

    def lacking(self, fits: dict[str, dict[str, Sensitivity]]) -> tuple[float, str]:
        """How many times wider than asked for the widest interval is, and the entry that has it, as ``x to u``."""
        widest, where = 0.0, ""
        for dof, fitted in fits.items():
            for axis in AXES:
                low, high = fitted[axis].ci95
                ratio = 0.5 * (high - low) / self._wanted(dof, fits)
                if not ratio <= widest:  # an interval that is not known is too wide
                    widest, where = (ratio if np.isfinite(ratio) else math.inf), f"{dof} to {axis}"
        return widest, where

    def _wanted(self, dof: str, fits: dict[str, dict[str, Sensitivity]]) -> float:
        """Half width [mm/mm or mm/deg] that is wanted for a motion, inf for any."""
        wanted = (self.per_degree if is_rotation(dof) else self.per_mm) or math.inf
        if self.relative is not None:
            alike = [fitted for other, fitted in fits.items() if is_rotation(other) == is_rotation(dof)]
            largest = max(abs(fitted[axis].value) for fitted in alike for axis in AXES)
            wanted = min(wanted, self.relative * largest)
        return max(wanted, 1e-300)

    def surfaces(self, count: int, lacking: float) -> int:
        """How many surfaces to have in all, where ``count`` have intervals ``lacking`` times as wide as asked for."""
        more = min(ROOM * lacking**2, MOST_AT_ONCE)
        return min(max(math.ceil(more * count), count + 1), MOST_SURFACES)


_UNITS = {"relative": "%", "per_mm": "mm/mm", "per_degree": "mm/deg"}
