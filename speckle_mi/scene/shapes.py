"""What each of a scene's shapes means for light, as exact surfaces in float64."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np

from ..geometry.frames import Frame
from ..geometry.outline import Circle, Rectangle
from ..optics.surface import Surface
from .body import body_of
from .elements import OUTSIDE, Element
from .errors import SceneError
from .exact_transforms import precise_transform
from .materials import glass_of, innermost, require_conductor, require_dielectric, strength
from .parameters import describe_shape

_OPAQUE = ("SmoothDiffuse", "RoughConductor", "SmoothPlastic", "RoughPlastic", "Principled")
"""BSDFs that let no light through and do not reflect like a mirror."""

_PLACED = ("Rectangle", "Disk", "Sphere", "Cube", "Cylinder")
"""Forms whose transform in double precision is asked for."""

_OPTICAL = {
    ("SmoothConductor", "Rectangle"): ("mirror", "specular_reflectance"),
    ("SmoothConductor", "Disk"): ("mirror", "specular_reflectance"),
    ("SmoothConductor", "Sphere"): ("mirror", "specular_reflectance"),
    ("SmoothDielectric", "Sphere"): ("glass", "specular_transmittance"),
    ("SmoothDielectric", "Cube"): ("glass", "specular_transmittance"),
}
"""Kind of element that a material and a form make, and what its BSDF calls the part of the intensity that goes on."""

FARTHEST_SHAPE = 3e4
"""Largest coordinate [mm] of a shape that rays have to find; their places are single precision, 2 um there."""


def shapes_of(scene: mi.Scene, target: mi.Shape) -> list[mi.Shape]:
    """All shapes of the scene but the target, in the order of their ids."""
    # Mitsuba loads shapes in parallel: their order in the scene is not that of the file, nor always the same.
    return sorted((shape for shape in scene.shapes() if shape is not target), key=lambda shape: shape.id())


def elements_of(shapes: list[mi.Shape], target: mi.Shape, medium: float, wavelength: float) -> list[Element]:
    """What shapes are to light of a vacuum wavelength [mm] in a medium of index ``medium``.

    Raises SceneError for one that cannot be taken into account.
    """
    found = [
        _of_plugin(shape, target, medium, wavelength) if hasattr(shape, "element") else _stock(shape, target)
        for shape in shapes
    ]
    for shape in (*shapes, target) if found else ():
        _require_near(shape)
    return found


def _of_plugin(shape: mi.Shape, target: mi.Shape, medium: float, wavelength: float) -> Element:
    """One of this package's own shapes, which knows its surfaces but not what it stands in."""
    element = shape.element()
    if element.kind == "glass":
        element = _at(element, shape, wavelength)
        require_dielectric(shape, element.index, target, medium)
        amplitude = np.sqrt(strength(shape, "specular_transmittance"))
        media = tuple(index / medium for index in element.media)
        return replace(element, media=media, amplitude=float(amplitude))
    if element.kind == "mirror":
        require_conductor(shape)
    return element


def _stock(shape: mi.Shape, target: mi.Shape) -> Element:
    """One of Mitsuba's own shapes by its form and material."""
    form, material = shape.class_name(), innermost(shape.bsdf()).class_name()
    to_world = precise_transform(shape, target) if form in _PLACED else None
    body = body_of(shape, to_world)
    if material in _OPAQUE:
        if body is None:
            raise SceneError(
                f"{describe_shape(shape)}: a {form} cannot be taken into account, must be a mesh (PLY, OBJ, cube) or a "
                "sphere, disk, rectangle or cylinder"
            )
        return Element(shape.id(), "opaque", (), body)
    if (material, form) not in _OPTICAL:
        raise SceneError(
            f"{describe_shape(shape)} with {material} cannot be taken into account: "
            "must be an aperture, a lens, a mirror, a beam_splitter, a sphere or cube of dielectric, a rectangle, "
            "disk or sphere of conductor, or opaque (diffuse, plastic, roughconductor)"
        )
    kind, name = _OPTICAL[material, form]
    faces = _FACES[form](shape, to_world)
    amplitude = float(np.sqrt(strength(shape, name)))
    if amplitude == 0.0:
        return Element(shape.id(), "opaque", (), body)
    glass = glass_of(shape, target)
    media = () if glass is None else (glass.index,)
    sides = ((OUTSIDE, 0),) * len(faces) if media else ()
    return Element(shape.id(), kind, faces, body, media, sides, closed=form == "Sphere", amplitude=amplitude)


def _at(element: Element, shape: mi.Shape, wavelength: float) -> Element:
    """An element for light of a vacuum wavelength [mm]. SceneError where its glass is not known there."""
    try:
        return element.at(wavelength)
    except ValueError as error:
        raise SceneError(f"{describe_shape(shape)}: {error}") from None


def _require_near(shape: mi.Shape) -> None:
    """SceneError where a shape ends so far out that rays in single precision would miss what lies close together."""
    box = shape.bbox()
    reach = float(np.max(np.abs([np.array(box.min), np.array(box.max)])))
    if not reach <= FARTHEST_SHAPE:
        raise SceneError(
            f"{describe_shape(shape)}: reaches {reach:.4g} mm from the world's origin, must stay within "
            f"{FARTHEST_SHAPE:g} mm: rays find their way in single precision, which is too coarse beyond"
        )


def _axes_and_scales(shape: mi.Shape, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origin (3,), unit axes (3, 3) and half sizes (3,) of a stock shape. SceneError when it is sheared."""
    scales = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.all(scales > 0) or not np.all(np.isfinite(matrix)):
        raise SceneError(f"{describe_shape(shape)}: 'to_world' is singular, must give the shape a size")
    axes = matrix[:3, :3] / scales
    if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-5):
        raise SceneError(f"{describe_shape(shape)}: 'to_world' shears, its axes must stay at right angles")
    return matrix[:3, 3], axes, scales


def _plane(shape: mi.Shape, matrix: np.ndarray) -> tuple[Surface]:
    origin, axes, scales = _axes_and_scales(shape, matrix)
    if shape.class_name() == "Disk":
        if not np.isclose(scales[0], scales[1], rtol=1e-5):
            raise SceneError(f"{describe_shape(shape)}: is scaled to an ellipse, must stay a circle")
        return (Surface(Frame(origin, axes), outline=Circle(float(scales[0]))),)
    return (Surface(Frame(origin, axes), outline=Rectangle(float(scales[0]), float(scales[1]))),)


def _sphere(shape: mi.Shape, matrix: np.ndarray) -> tuple[Surface]:
    origin, _, scales = _axes_and_scales(shape, matrix)
    if not np.allclose(scales, scales[0], rtol=1e-5):
        raise SceneError(f"{describe_shape(shape)}: is scaled to an ellipsoid, must stay a sphere")
    return (Surface.sphere(origin, float(scales[0])),)


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


_FACES = {"Rectangle": _plane, "Disk": _plane, "Sphere": _sphere, "Cube": _box}
"""Optical surfaces of a stock shape."""
