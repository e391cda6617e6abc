"""The optical elements of a scene, as exact surfaces in float64."""

from __future__ import annotations

from dataclasses import dataclass

from ..optics.sequence import Interaction
from ..optics.surface import Surface
from .body import Body


@dataclass(frozen=True, eq=False)
class Element:
    """A shape of the scene.

    name: its id; kind: "opening" (a hole in a screen), "mirror", "glass" or "opaque"; faces: its optical surfaces;
    body: its form as rays meet it; index: refractive index inside glass, relative to the medium around; closed: whether
    the one face is a whole sphere; screen_radius: where the screen around an opening ends [mm]; amplitude: factor of
    the light's amplitude at each reflection by a mirror or refraction at a face of glass.
    """

    name: str
    kind: str
    faces: tuple[Surface, ...]
    body: Body
    index: float = 1.0
    closed: bool = False
    screen_radius: float | None = None
    amplitude: float = 1.0

    @property
    def size(self) -> float:
        """Diagonal of the shape's bounding box [mm]."""
        return self.body.size

    def interaction(self, face: int, inside: bool, root: int = 0) -> Interaction:
        """What happens to light at a face, coming from inside the glass or from outside.

        root: which of the two crossings of a closed face is meant, 0 the nearer one along the ray's line.
        """
        surface, crossing = self.faces[face], ("near", "far")[root] if self.closed else "vertex"
        if self.kind == "mirror":
            return Interaction.reflect(surface, root=crossing, amplitude=self.amplitude)
        before, after = (self.index, 1.0) if inside else (1.0, self.index)
        return Interaction.refract(surface, before, after, root=crossing, amplitude=self.amplitude)
