"""What glasses are made of, as far as light is concerned: their refractive index at a wavelength.

Indices are relative to air at 20 C and 1 atm, as catalogues give them. The vendors' formulas are taken at the laser's
wavelength as it is written: they mean that in air, which is shorter by 2.7e-4 of it, and in N-BK7 at 633 nm the
difference is 7e-6 of index, far less than from melt to melt (3e-4 to 1e-3).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Protocol

import numpy as np


class Glass(Protocol):
    """A medium whose refractive index is known at a wavelength [mm]."""

    def index(self, wavelength: float) -> float:
        """Refractive index relative to air; raises ValueError where it is not known."""


@dataclass(frozen=True)
class FixedIndex:
    """A medium of one refractive index at all wavelengths."""

    value: float

    def index(self, wavelength: float) -> float:
        return self.value


@dataclass(frozen=True)
class DispersiveGlass:
    """A glass with a dispersion formula.

    name: as messages call it; formula: 1 (n^2 = 1 + c0 + sum c l^2/(l^2 - c'^2), Sellmeier's), 2 (the same with c'
    instead of its square), 3 (n^2 = c0 + sum c l^c') or 5 (n = c0 + sum c l^c', Cauchy's), l in um, as
    refractiveindex.info numbers them; coefficients: c0, then pairs c, c'; reach: wavelengths [um] it holds between.
    """

    name: str
    formula: int
    coefficients: tuple[float, ...]
    reach: tuple[float, float]

    def index(self, wavelength: float) -> float:
        """Refractive index relative to air at a wavelength [mm]; raises ValueError outside ``reach``."""
        um = wavelength * 1e3
        low, high = self.reach
        if not low * (1 - 1e-9) <= um <= high * (1 + 1e-9):
            raise ValueError(
                f"glass {self.name!r} is known from {1e3 * low:g} to {1e3 * high:g} nm, not at {1e3 * um:g} nm: "
                "give an index ('ior') instead"
            )
        first, rest = self.coefficients[0], self.coefficients[1:]
        pairs = list(zip(rest[::2], rest[1::2], strict=True))
        if self.formula == 1:
            return sqrt(1 + first + sum(c * um**2 / (um**2 - d**2) for c, d in pairs))
        if self.formula == 2:
            return sqrt(1 + first + sum(c * um**2 / (um**2 - d) for c, d in pairs))
        total = first + sum(c * um**power for c, power in pairs)
        return sqrt(total) if self.formula == 3 else total


YELLOW = 587.5618e-6
"""Wavelength [mm] of helium's d line, at which catalogues state one index of a glass."""


def index_of(glass: Glass) -> float:
    """Index of a glass in yellow light, or as near to it as it is known: for what shows no colours."""
    low, high = glass.reach if isinstance(glass, DispersiveGlass) else (0.0, 1e9)
    return glass.index(min(max(YELLOW, low * 1e-3), high * 1e-3))


_MODEL_REACH = (400.0, 1100.0)
"""Wavelengths [nm] at which a model glass stands for a real one."""


@dataclass(frozen=True)
class ModelGlass:
    """A glass of which only the index n_d at 587.5618 nm and Abbe's number V are known.

    Conrady's formula n = A + B/l + C/l^3.5 (l in um) through n_d, with n_F - n_C = (n_d - 1)/V and the partial
    dispersion (n_g - n_F)/(n_F - n_C) = 0.6438 - 0.001682 V of normal glasses; its error is up to 5e-4 from 440 to
    850 nm and 1.5e-3 from 400 to 1100 nm. V = 0: the index is n_d at all wavelengths.
    """

    n_d: float
    abbe: float

    def index(self, wavelength: float) -> float:
        """Refractive index relative to air at a wavelength [mm]; raises ValueError outside 400 to 1100 nm."""
        nm, (low, high) = wavelength * 1e6, _MODEL_REACH
        if not self.abbe:
            return self.n_d
        if not low <= nm <= high:
            raise ValueError(
                f"a glass of which only n = {self.n_d:g} and V = {self.abbe:g} are known stands for a real one from "
                f"{low:g} to {high:g} nm, not at {nm:g} nm"
            )
        g, f, d, c = (np.array([um**-1.0, um**-3.5]) for um in (0.4358343, 0.4861327, 0.5875618, 0.6562725))
        spread = (self.n_d - 1) / self.abbe
        slopes = np.linalg.solve([f - c, g - f], [spread, spread * (0.6438 - 0.001682 * self.abbe)])
        um = wavelength * 1e3
        return float(self.n_d + slopes @ (np.array([um**-1.0, um**-3.5]) - d))
