"""The order in which light meets surfaces, and what happens at each."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from ..geometry.frames import Frame
from ..geometry.plane import PlaneGrid
from .surface import Surface


@dataclass(frozen=True, eq=False)
class Interaction:
    """What happens to light at a surface.

    action: "refract" (Snell's law), "reflect" (mirror), "pass" (a place the light goes straight through: an aperture, a
    reference plane, the detector); index_before, index_after: refractive indices of the segments on its way in and out;
    root: which crossing of the surface is meant, see ``Surface.intersect``; amplitude: factor of the light's amplitude
    here, the square root of the reflectance or transmittance; near: (3,) where on the surface its light is, in its own
    frame [mm], None for its middle; slack: how far [mm] it may lie behind the one before, as where a stop cuts through
    the curved face of a lens; coated: whether it splits the light, so that reflection in a glass is meant. Build with
    ``Interaction.refract``, ``.reflect``, ``.through``.
    """

    surface: Surface
    action: Literal["refract", "reflect", "pass"]
    index_before: float = 1.0
    index_after: float = 1.0
    root: Literal["vertex", "near", "far"] = "vertex"
    amplitude: float = 1.0
    near: np.ndarray | None = None
    slack: float = 0.0
    coated: bool = False

    def __post_init__(self) -> None:
        if self.action not in ("refract", "reflect", "pass"):
            raise ValueError(f"interaction {self.action!r}: must be one of refract, reflect, pass")
        if self.root not in ("vertex", "near", "far"):
            raise ValueError(f"root {self.root!r}: must be one of vertex, near, far")
        if not (self.index_before > 0.0 and self.index_after > 0.0):
            raise ValueError(
                f"refractive indices {self.index_before}, {self.index_after}: must be positive (a mirror is 'reflect')"
            )
        if not 0.0 <= self.amplitude < np.inf:
            raise ValueError(f"amplitude factor {self.amplitude}: must be finite and not negative")
        if self.action != "refract" and self.index_before != self.index_after:
            raise ValueError(
                f"{self.action} with indices {self.index_before}, {self.index_after}: "
                "the medium changes only by refraction"
            )
        if self.root != "vertex" and not self.surface.is_closed:
            raise ValueError(
                f"root {self.root!r} needs a closed surface: a sphere or spheroid (curvature not 0, conic > -1)"
            )

    @property
    def bends(self) -> bool:
        """Whether light may go on in another direction than it came."""
        return self.action == "reflect" or self.index_before != self.index_after

    @property
    def is_nothing(self) -> bool:
        """Whether a face does nothing to light: between equal media, without loss or coating."""
        return self.action == "refract" and not self.bends and not self.coated and self.amplitude == 1.0

    @property
    def reflects_inside(self) -> bool:
        """Whether light is reflected within a glass where no coating is meant to, as at total reflection."""
        return self.action == "reflect" and self.index_before != 1.0 and not self.coated

    @property
    def place(self) -> np.ndarray:
        """(3,) where its light is, world [mm]."""
        return self.surface.middle if self.near is None else self.surface.frame.to_world(self.near[None])[0]

    @classmethod
    def refract(
        cls, surface: Surface, index_before: float, index_after: float, root: str = "vertex", amplitude: float = 1.0
    ) -> Interaction:
        """Refraction from ``index_before`` into ``index_after``."""
        return cls(surface, "refract", index_before, index_after, root, amplitude)

    @classmethod
    def reflect(
        cls, surface: Surface, index: float = 1.0, root: str = "vertex", amplitude: float = 1.0
    ) -> Interaction:
        """Mirror inside a medium of ``index``. The mirror's own phase, the same for all rays, is left out."""
        return cls(surface, "reflect", index, index, root, amplitude)

    @classmethod
    def through(cls, surface: Surface, index: float = 1.0) -> Interaction:
        """A surface that changes nothing: an opening, a reference plane, the detector."""
        return cls(surface, "pass", index, index)


def amplitude_of(interactions: Iterable[Interaction]) -> float:
    """Factor of the light's amplitude over a way: the product of its interactions' own."""
    return math.prod(interaction.amplitude for interaction in interactions)


def detector_plane(grid: PlaneGrid) -> Interaction:
    """The detector's plane as the end of a sequence."""
    return Interaction.through(Surface(Frame(grid.centre, np.stack([grid.u, grid.v, grid.normal], axis=1))))


@dataclass(frozen=True, eq=False)
class Sequence:
    """Interactions in the order in which light meets them.

    Raises ValueError when empty or when one interaction's medium is not the next one's.
    """

    interactions: tuple[Interaction, ...]
    rims: tuple[tuple[int, int], ...] = field(init=False)
    """One (interaction, component) per row of every ``margins`` array; a circle has one, a rectangle two (x, y)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "interactions", tuple(self.interactions))
        if not self.interactions:
            raise ValueError("optical sequence is empty: it must at least hold the plane where the light ends")
        for i, (one, two) in enumerate(zip(self.interactions, self.interactions[1:], strict=False)):
            if one.index_after != two.index_before:
                raise ValueError(
                    f"optical sequence: light leaves surface {i + 1} in a medium of index {one.index_after} but comes "
                    f"to surface {i + 2} in one of {two.index_before}, must be the same"
                )
        rims = [
            (i, j)
            for i, one in enumerate(self.interactions)
            if one.surface.outline
            for j in range(one.surface.outline.size)
        ]
        object.__setattr__(self, "rims", tuple(rims))

    @property
    def size(self) -> int:
        return len(self.interactions)

    @cached_property
    def changes(self) -> tuple[tuple[np.ndarray | None, np.ndarray], ...]:
        """What takes places from one surface's frame to the next one's, from the world on: rotation (3, 3), shift (3,).

        Frames with the same axes have no rotation, so that nothing is rounded.
        """
        axes, origin, found = np.eye(3), np.zeros(3), []
        for frame in (interaction.surface.frame for interaction in self.interactions):
            rotation = frame.axes.T @ axes
            same = np.array_equal(rotation, np.eye(3))
            found.append((None if same else rotation, frame.axes.T @ (origin - frame.origin)))
            axes, origin = frame.axes, frame.origin
        return tuple(found)

    @property
    def amplitude(self) -> float:
        """Factor of the light's amplitude over the whole sequence, see :func:`amplitude_of`."""
        return amplitude_of(self.interactions)

    @property
    def last(self) -> Interaction:
        return self.interactions[-1]
