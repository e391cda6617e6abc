"""The optical elements of a scene, as exact surfaces in float64."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..optics.glass import Glass
from ..optics.sequence import Interaction
from ..optics.surface import Surface
from .body import Body

OUTSIDE = -1
"""Number of the medium that an element stands in, where its own are numbered from 0."""


@dataclass(frozen=True, eq=False)
class Element:
    """A shape of the scene.

    name: its id; kind: "opening" (a hole in a screen), "mirror", "glass" (also a coating with nothing behind it: one
    face with the medium around on either side) or "opaque"; faces: its optical surfaces;
    body: its form as rays meet it; media: refractive indices of what is inside glass, relative to the medium around;
    sides: of each face of glass the two media that it parts, by their numbers, ``OUTSIDE`` for the medium around;
    closed: whether the one face is a whole sphere; edged: whether the faces stand behind one another on one axis, with
    an edge between their rims, as those of a lens; screen_radius: where the screen around an opening ends [mm];
    amplitude: factor of the light's amplitude at each reflection by a mirror or refraction at a face of glass; glasses:
    what the media are made of, as far as that is known for other wavelengths; reflectances: of every face of glass the
    part of the intensity that it reflects, none where no face does; note: what of it does not count, in words.
    """

    name: str
    kind: str
    faces: tuple[Surface, ...]
    body: Body
    media: tuple[float, ...] = ()
    sides: tuple[tuple[int, int], ...] = ()
    closed: bool = False
    edged: bool = False
    screen_radius: float | None = None
    amplitude: float = 1.0
    glasses: tuple[Glass, ...] = ()
    reflectances: tuple[float, ...] = ()
    note: str = field(default="", compare=False)

    @property
    def size(self) -> float:
        """Diagonal of the shape's bounding box [mm]."""
        return self.body.size

    @property
    def index(self) -> float:
        """Refractive index of the first medium, 1 where there is none."""
        return self.index_of(0) if self.media else 1.0

    def index_of(self, medium: int) -> float:
        """Refractive index of a medium, relative to that around."""
        return 1.0 if medium == OUTSIDE else self.media[medium]

    def at(self, wavelength: float, around: float = 1.0) -> Element:
        """The same for light of a vacuum wavelength [mm], in a medium of index ``around``.

        Raises ValueError where a glass is not known at that wavelength.
        """
        if not self.glasses:
            return self
        return replace(self, media=tuple(glass.index(wavelength) / around for glass in self.glasses))

    def beyond(self, face: int, medium: int) -> int:
        """The medium on the other side of a face of glass."""
        one, other = self.sides[face]
        return other if medium == one else one

    def interaction(self, face: int, medium: int, root: int = 0) -> Interaction:
        """What happens to light at a face, coming in one of the media on its sides; of a coated one, what goes through.

        root: which of the two crossings of a closed face is meant, 0 the nearer one along the ray's line.
        """
        surface, crossing = self.faces[face], self._crossing(root)
        if self.kind == "mirror":
            return Interaction.reflect(surface, root=crossing, amplitude=self.amplitude)
        before, after = self.index_of(medium), self.index_of(self.beyond(face, medium))
        amplitude = self.amplitude * float(np.sqrt(1 - self.reflectance(face)))
        return Interaction.refract(surface, before, after, root=crossing, amplitude=amplitude)

    def interactions(self, face: int, medium: int, root: int = 0) -> tuple[Interaction, ...]:
        """All that light goes on by at a face, as in :meth:`interaction`: a coated one splits it."""
        through, reflectance = self.interaction(face, medium, root), self.reflectance(face)
        if reflectance == 0.0:
            return (through,)
        index, amplitude = self.index_of(medium), self.amplitude * float(np.sqrt(reflectance))
        back = Interaction.reflect(self.faces[face], index, self._crossing(root), amplitude)
        return tuple(replace(one, coated=True) for one in (through, back) if one.amplitude > 0.0)

    def reflectance(self, face: int) -> float:
        """Part of the intensity that a face of glass reflects: that of its coating."""
        return self.reflectances[face] if self.reflectances else 0.0

    def _crossing(self, root: int) -> str:
        return ("near", "far")[root] if self.closed else "vertex"

    def is_inside(self, point: np.ndarray, room: float) -> bool:
        """Whether a point (3,) lies inside the glass, by more than ``room``, relative to its size."""
        if self.closed:
            face = self.faces[0]
            centre = face.centre_of_curvature
            return float(np.linalg.norm(point - centre)) < (1 - room) / abs(face.curvature)
        if self.edged:
            layers = zip(self.faces, self.faces[1:], strict=False)
            return any(_depth(pair, point) > room * self.size for pair in layers)
        return _depth(self.faces, point) > room * self.size


def _depth(faces: tuple[Surface, ...], point: np.ndarray) -> float:
    """Depth [mm] of a point (3,) between faces, -inf where it is beside one of them."""
    middle = np.mean([face.frame.origin for face in faces], axis=0)
    depths = []
    for face in faces:
        (x, y, z), (_, _, inwards) = face.frame.to_local(np.array([point, middle]))
        if np.any(face.outline.margins(x, y) < 0):
            return -np.inf
        depths.append((z - face.sag(x, y)) * np.sign(inwards))
    return float(min(depths))
