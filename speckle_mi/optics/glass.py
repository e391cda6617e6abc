"""What glasses are made of, as far as light is concerned: their refractive index at a wavelength."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


class Glass(Protocol):
    """A medium whose refractive index, relative to air, is known at a vacuum wavelength [mm]."""

    def index(self, wavelength: float) -> float:
        """Raises ValueError where it is not known there."""


@dataclass(frozen=True)
class FixedIndex:
    """A medium of one refractive index at all wavelengths."""

    value: float

    def index(self, wavelength: float) -> float:
        return self.value
