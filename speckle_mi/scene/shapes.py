"""What each of a scene's shapes means for light, as exact surfaces in float64."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..geometry.frames import Frame
from ..geometry.outline import Circle, Rectangle
from ..optics.surface import Surface
from .body import body_of
from .elements import Element
from .errors import SceneError
from .exact_transforms import precise_transform
from .parameters import describe_shape

_OPAQUE = ("SmoothDiffuse", "RoughConductor", "SmoothPlastic", "RoughPlastic", "Principled")
"""BSDFs that let no light through and do not reflect like a mirror."""

_PLACED = ("Rectangle", "Disk", "Sphere", "Cube", "Cylinder")
"""Forms whose transform in double precision is asked for."""

FARTHEST_SHAPE = 3e4
"""Largest coordinate [mm] of a shape that rays have to find; their places are single precision, 2 um there."""


def elements_of(scene: mi.Scene, target: mi.Shape) -> list[Element]:
    """All shapes of the scene but the target. Raises SceneError for one that cannot be taken into account."""
    # Mitsuba loads shapes in parallel: their order in the scene is not that of the file, nor always the same.
    shapes = sorted((shape for shape in scene.shapes() if shape is not target), key=lambda shape: shape.id())
    found = [shape.element() if hasattr(shape, "element") else _stock(shape, target) for shape in shapes]
    for shape in (*shapes, target) if found else ():
        _require_near(shape)
    return found


def _stock(shape: mi.Shape, target: mi.Shape) -> Element:
    """One of Mitsuba's own shapes by its form and material."""
    bsdf = _innermost(shape.bsdf())
    form, material = shape.class_name(), bsdf.class_name()
    to_world = precise_transform(shape, target) if form in _PLACED else None
    body = body_of(shape, to_world)
    if material in _OPAQUE:
        if body is None:
            raise SceneError(
                f"{describe_shape(shape)}: a {form} cannot be taken into account, must be a mesh (PLY, OBJ, cube) or a "
                "sphere, disk, rectangle or cylinder"
            )
        return Element(shape.id(), "opaque", (), body)
    if material == "SmoothConductor" and form in ("Rectangle", "Disk"):
        return Element(shape.id(), "mirror", (_plane(shape, to_world),), body)
    if material == "SmoothConductor" and form == "Sphere":
        return Element(shape.id(), "mirror", (_sphere(shape, to_world),), body, closed=True)
    if material == "SmoothDielectric" and form == "Sphere":
        return Element(shape.id(), "glass", (_sphere(shape, to_world),), body, index=_index(bsdf), closed=True)
    if material == "SmoothDielectric" and form == "Cube":
        return Element(shape.id(), "glass", _box(shape, to_world), body, index=_index(bsdf))
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


def _axes_and_scales(shape: mi.Shape, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origin (3,), unit axes (3, 3) and half sizes (3,) of a stock shape. SceneError when it is sheared."""
    scales = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.all(scales > 0) or not np.all(np.isfinite(matrix)):
        raise SceneError(f"{describe_shape(shape)}: 'to_world' is singular, must give the shape a size")
    axes = matrix[:3, :3] / scales
    if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-5):
        raise SceneError(f"{describe_shape(shape)}: 'to_world' shears, its axes must stay at right angles")
    return matrix[:3, 3], axes, scales


def _plane(shape: mi.Shape, matrix: np.ndarray) -> Surface:
    origin, axes, scales = _axes_and_scales(shape, matrix)
    if shape.class_name() == "Disk":
        if not np.isclose(scales[0], scales[1], rtol=1e-5):
            raise SceneError(f"{describe_shape(shape)}: is scaled to an ellipse, must stay a circle")
        return Surface(Frame(origin, axes), outline=Circle(float(scales[0])))
    return Surface(Frame(origin, axes), outline=Rectangle(float(scales[0]), float(scales[1])))


def _sphere(shape: mi.Shape, matrix: np.ndarray) -> Surface:
    origin, _, scales = _axes_and_scales(shape, matrix)
    if not np.allclose(scales, scales[0], rtol=1e-5):
        raise SceneError(f"{describe_shape(shape)}: is scaled to an ellipsoid, must stay a sphere")
    return Surface.sphere(origin, float(scales[0]))


def _box(shape: mi.Shape, matrix: np.ndarray) -> tuple[Surface, ...]:
    """The six faces of a cube (whose local coordinates run from -1 to 1), as planes with their outlines."""
    origin, axes, scales = _axes_and_scales(shape, matrix)
    faces = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in (-1.0, 1.0):
            frame = Frame(origin + side * scales[axis] * axes[:, axis], axes[:, [a, b, axis]])
            faces.append(Surface(frame, outline=Rectangle(float(scales[a]), float(scales[b]))))
    return tuple(faces)
