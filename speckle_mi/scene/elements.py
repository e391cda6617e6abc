"""The optical elements of a scene: what each Mitsuba shape means for light, as exact surfaces in float64."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ..geometry.frames import Frame
from ..geometry.outline import Circle, Rectangle
from ..optics.sequence import Interaction
from ..optics.surface import Surface
from .errors import SceneError
from .exact_transforms import precise_transform
from .parameters import describe_shape

_OPAQUE = ("SmoothDiffuse", "RoughConductor", "SmoothPlastic", "RoughPlastic", "Principled")
"""BSDFs that let no light through and do not reflect like a mirror."""

FARTHEST_SHAPE = 3e4
"""Largest coordinate [mm] of a shape that rays have to find; their places are single precision, 2 um there."""


@dataclass(frozen=True)
class Element:
    """A shape of the scene.

    name: its id; kind: "opening" (a hole in a screen), "mirror", "glass" or "opaque"; faces: its optical surfaces;
    index: refractive index inside glass; shape: the Mitsuba shape; closed: whether the one face is a whole sphere.
    """

    name: str
    kind: str
    faces: tuple[Surface, ...]
    shape: mi.Shape
    index: float = 1.0
    closed: bool = False

    @property
    def size(self) -> float:
        """Diagonal of the shape's bounding box [mm]."""
        return float(np.linalg.norm(np.array(self.shape.bbox().extents(), dtype=np.float64)))

    def describe(self) -> list:
        """Everything that determines what the element does to light, as JSON can hold it."""
        faces = [
            [repr(value) for value in (*face.frame.origin, *face.frame.axes.ravel(), face.curvature, face.conic)]
            + [repr(face.outline)]
            for face in self.faces
        ]
        box = [repr(float(x)) for x in (*self.shape.bbox().min, *self.shape.bbox().max)]
        return [self.name, self.kind, repr(self.index), faces, box]

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
        """What happens to light at a face, coming from inside the glass or from outside."""
        surface = self.faces[face]
        if self.kind == "mirror":
            return Interaction.reflect(surface, root="near" if self.closed else "vertex")
        root = ("far" if inside else "near") if self.closed else "vertex"
        before, after = (self.index, 1.0) if inside else (1.0, self.index)
        return Interaction.refract(surface, before, after, root=root)


def elements_of(scene: mi.Scene, target: mi.Shape) -> list[Element]:
    """All shapes of the scene but the target. Raises SceneError for one that cannot be taken into account."""
    # Mitsuba loads shapes in parallel: their order in the scene is not that of the file, nor always the same.
    found = sorted((_element(shape, target) for shape in scene.shapes() if shape is not target), key=lambda e: e.name)
    for shape in scene.shapes() if found else ():
        _require_near(shape)
    return found


def _element(shape: mi.Shape, target: mi.Shape) -> Element:
    kind = type(shape).__name__
    if kind == "Aperture":
        return Element(shape.id(), "opening", (shape.opening(),), shape)
    if kind == "Lens":
        return Element(shape.id(), "glass", shape.surfaces(), shape, index=shape.index)
    bsdf = _innermost(shape.bsdf())
    form = shape.class_name()
    material = bsdf.class_name()
    if material in _OPAQUE:
        return Element(shape.id(), "opaque", (), shape)
    if material == "SmoothConductor" and form in ("Rectangle", "Disk"):
        return Element(shape.id(), "mirror", (_plane(shape, target),), shape)
    if material == "SmoothConductor" and form == "Sphere":
        return Element(shape.id(), "mirror", (_sphere(shape, target),), shape, closed=True)
    if material == "SmoothDielectric" and form == "Sphere":
        return Element(shape.id(), "glass", (_sphere(shape, target),), shape, index=_index(bsdf), closed=True)
    if material == "SmoothDielectric" and form == "Cube":
        return Element(shape.id(), "glass", _box(shape, target), shape, index=_index(bsdf))
    raise SceneError(
        f"{describe_shape(shape)} with {material} cannot be taken into account: "
        "must be an aperture, a lens, a sphere or cube of dielectric, a rectangle, disk or sphere of conductor, "
        "or opaque (diffuse, plastic, roughconductor)"
    )


def _require_near(shape: mi.Shape) -> None:
    """SceneError where a shape ends so far out that rays in single precision would miss what lies close together."""
    box = shape.bbox()
    reach = float(np.max(np.abs([np.array(box.min), np.array(box.max)])))
    if not reach <= FARTHEST_SHAPE:
        raise SceneError(
            f"{describe_shape(shape)}: reaches {reach:.4g} mm from the world's origin, must stay within "
            f"{FARTHEST_SHAPE:g} mm: rays find their way in single precision, which is too coarse beyond"
        )


def _innermost(bsdf: mi.BSDF) -> mi.BSDF:
    """The BSDF inside ``twosided``."""
    if bsdf.class_name() != "TwoSidedBRDF":
        return bsdf
    held: list[mi.BSDF] = []

    class Collect(mi.TraversalCallback):
        def put(self, name, value, flags):
            if isinstance(value, mi.BSDF):
                held.append(value)

    bsdf.traverse(Collect())
    return held[0]


def _index(bsdf: mi.BSDF) -> float:
    """Refractive index of a dielectric; the decimal number the scene gave, which single precision has rounded."""
    return float(str(np.float32(mi.traverse(bsdf)["eta"])))


def _distance(face: Surface, local: np.ndarray) -> np.ndarray:
    """Distance [mm] of local points (n, 3) from the face, to first order, (n,)."""
    c, k = face.curvature, face.conic
    x, y, z = local.T
    implicit = 0.5 * (c * (x * x + y * y) + c * (1 + k) * z * z) - z
    return np.abs(implicit) / np.maximum(np.linalg.norm(face.gradient(local.T), axis=0), 1e-12)


def _axes_and_scales(shape: mi.Shape, target: mi.Shape) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origin (3,), unit axes (3, 3) and half sizes (3,) of a stock shape. SceneError when it is sheared."""
    matrix = precise_transform(shape, target)
    scales = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.all(scales > 0) or not np.all(np.isfinite(matrix)):
        raise SceneError(f"{describe_shape(shape)}: 'to_world' is singular, must give the shape a size")
    axes = matrix[:3, :3] / scales
    if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-5):
        raise SceneError(f"{describe_shape(shape)}: 'to_world' shears, its axes must stay at right angles")
    return matrix[:3, 3], axes, scales


def _plane(shape: mi.Shape, target: mi.Shape) -> Surface:
    origin, axes, scales = _axes_and_scales(shape, target)
    if shape.class_name() == "Disk":
        if not np.isclose(scales[0], scales[1], rtol=1e-5):
            raise SceneError(f"{describe_shape(shape)}: is scaled to an ellipse, must stay a circle")
        return Surface(Frame(origin, axes), outline=Circle(float(scales[0])))
    return Surface(Frame(origin, axes), outline=Rectangle(float(scales[0]), float(scales[1])))


def _sphere(shape: mi.Shape, target: mi.Shape) -> Surface:
    origin, _, scales = _axes_and_scales(shape, target)
    if not np.allclose(scales, scales[0], rtol=1e-5):
        raise SceneError(f"{describe_shape(shape)}: is scaled to an ellipsoid, must stay a sphere")
    return Surface.sphere(origin, float(scales[0]))


def _box(shape: mi.Shape, target: mi.Shape) -> tuple[Surface, ...]:
    """The six faces of a cube (whose local coordinates run from -1 to 1), as planes with their outlines."""
    origin, axes, scales = _axes_and_scales(shape, target)
    faces = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in (-1.0, 1.0):
            frame = Frame(origin + side * scales[axis] * axes[:, axis], axes[:, [a, b, axis]])
            faces.append(Surface(frame, outline=Rectangle(float(scales[a]), float(scales[b]))))
    return tuple(faces)
