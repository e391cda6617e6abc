"""The optical elements of a scene, as exact surfaces in float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..optics.sequence import Interaction
from ..optics.surface import Surface
from .body import Body


@dataclass(frozen=True, eq=False)
class Element:
    """A shape of the scene.

    name: its id; kind: "opening" (a hole in a screen), "mirror", "glass" or "opaque"; faces: its optical surfaces; body:
    its form as rays meet it; index: refractive index inside glass; closed: whether the one face is a whole sphere;
    screen_radius: where the screen around an opening ends [mm]; amplitude: factor of the light's amplitude at each
    reflection by a mirror or refraction at a face of glass.
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

    def faces_at(self, points: np.ndarray) -> np.ndarray:
        """Number (n,) of the face that points (n, 3) on the shape's mesh belong to, -1 for the rim of a lens."""
        distance = np.empty((len(self.faces), len(points)))
        for number, face in enumerate(self.faces):
            local = face.frame.to_local(points)
            distance[number] = _distance(face, local)
            if face.outline is not None:
                outside = np.any(face.outline.margins(local[:, 0], local[:, 1]) < -1e-3, axis=0)
                distance[number, outside] = np.inf
        nearest = np.argmin(distance, axis=0)
        return np.where(distance[nearest, np.arange(len(points))] < 1e-3 * self.size, nearest, -1)

    def interaction(self, face: int, inside: bool) -> Interaction:
        """What happens to light at a face, coming from inside the glass or closed mirror or from outside."""
        surface = self.faces[face]
        root = ("far" if inside else "near") if self.closed else "vertex"
        if self.kind == "mirror":
            return Interaction.reflect(surface, root=root, amplitude=self.amplitude)
        before, after = (self.index, 1.0) if inside else (1.0, self.index)
        return Interaction.refract(surface, before, after, root=root, amplitude=self.amplitude)


def _distance(face: Surface, local: np.ndarray) -> np.ndarray:
    """Distance [mm] of local points (n, 3) from the face, to first order, (n,)."""
    c, k = face.curvature, face.conic
    x, y, z = local.T
    implicit = 0.5 * (c * (x * x + y * y) + c * (1 + k) * z * z) - z
    return np.abs(implicit) / np.maximum(np.linalg.norm(face.gradient(local.T), axis=0), 1e-12)
