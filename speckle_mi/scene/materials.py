"""What the BSDFs of a scene say of its glasses and mirrors, and of the medium that everything stands in.

All indices are relative to air, which is the reference: a medium whose index is within ``AIR`` of 1 counts as 1, and a
glass then has its index relative to its own ``ext_ior``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from .errors import SceneError
from .parameters import describe_shape, value_of

AIR = 1e-3
"""How far from 1 the index around a glass may be and still mean air (1.000277 in Mitsuba's table) or vacuum."""

_ROUNDING = 1e-6
"""Relative difference of two indices that is only single precision."""


@dataclass(frozen=True)
class Dielectric:
    """inside: index of refraction of a glass; outside: of the medium it stands in, None where that is not known.

    Where it is not known, ``inside`` is relative to it.
    """

    inside: float
    outside: float | None

    @property
    def index(self) -> float:
        """Index relative to the medium around."""
        return self.inside if self.outside is None else self.inside / self.outside

    @property
    def medium(self) -> float | None:
        """Index of the medium around, 1 for air."""
        return 1.0 if self.outside is not None and abs(self.outside - 1.0) <= AIR else self.outside


def innermost(bsdf: mi.BSDF) -> mi.BSDF:
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


def glass_of(shape: mi.Shape, target: mi.Shape) -> Dielectric | None:
    """The glass that a shape's dielectric makes of it, None for another material and where a plugin made its own.

    Exact where the scene's file was read with ``target``; where the dielectric was changed since, the index is the
    decimal number that single precision has rounded.
    """
    bsdf = innermost(shape.bsdf())
    if bsdf.class_name() != "SmoothDielectric" or getattr(shape, "owns_bsdf", False):
        return None
    quotient = float(str(np.float32(mi.traverse(bsdf)["eta"])))
    stated = target.stated_indices.get(shape.id(), [])
    agreeing = [pair for pair in stated if np.isclose(pair[0] / pair[1], quotient, rtol=_ROUNDING, atol=0)]
    inside, outside = quotient, None
    if agreeing:
        inside, outside = agreeing[0]
    elif stated:
        outside = stated[0][1]
        inside = quotient * outside
    if shape.has_flipped_normals():
        inside, outside = (1 / inside, None) if outside is None else (outside, inside)
    return Dielectric(inside, outside)


def medium_around(shapes: Iterable[mi.Shape], target: mi.Shape) -> float:
    """Index of the medium that the whole scene stands in, 1 for air: the ``ext_ior`` of its dielectrics.

    Raises SceneError where they differ.
    """
    known = [(shape, glass.medium) for shape in shapes if (glass := glass_of(shape, target)) and glass.medium]
    for shape, medium in known[1:]:
        first, other = known[0]
        if not np.isclose(medium, other, rtol=_ROUNDING, atol=0):
            raise SceneError(
                f"{describe_shape(first)} stands in a medium of index {other:g} and {describe_shape(shape)} in one of "
                f"{medium:g}: 'ext_ior' must be the same of all dielectrics, that of the medium around everything"
            )
    return known[0][1] if known else 1.0


def strength(shape: mi.Shape, name: str) -> float:
    """``specular_reflectance`` or ``specular_transmittance`` of a shape's BSDF, 0 to 1; 1 where nothing is said.

    Raises SceneError where it is no constant.
    """
    bsdf = innermost(shape.bsdf())
    parameters = mi.traverse(bsdf)
    said = [key for key in parameters.keys() if key.split(".")[0] == name]
    if not said:
        return 1.0
    where = f"{describe_shape(shape)}: {name!r} of its {bsdf.class_name()}"
    values = np.unique(np.asarray(parameters[said[0]], dtype=np.float32)) if said == [f"{name}.value"] else np.empty(0)
    if len(values) != 1:
        raise SceneError(f"{where} is a texture or a spectrum, must be one number from 0 to 1")
    value = float(str(values[0]))
    if not 0.0 <= value <= 1.0:
        raise SceneError(f"{where} is {value:g}, must be 0 to 1")
    return value


def require_dielectric(shape: mi.Shape, index: float, target: mi.Shape, medium: float) -> None:
    """SceneError where a lens is given a BSDF that contradicts it: no dielectric, or one of another index."""
    if shape.owns_bsdf:
        return
    glass = glass_of(shape, target)
    wanted = f"must be a dielectric of 'int_ior' = {index:.7g}, its 'ior', or be left out"
    if glass is None:
        material = innermost(shape.bsdf()).class_name()
        raise SceneError(f"{shape.where}: its BSDF is a {material}, {wanted} (a curved mirror is a shape 'mirror')")
    expected = (index,) if glass.outside is not None else (index, index / medium)
    if not any(np.isclose(glass.inside, one, rtol=_ROUNDING, atol=0) for one in expected):
        raise SceneError(f"{shape.where}: its BSDF is a dielectric of index {glass.inside:.7g}, {wanted}")


def require_conductor(shape: mi.Shape) -> None:
    """SceneError where a mirror is given a BSDF that contradicts it: no conductor, or one of another reflectance."""
    if shape.owns_bsdf:
        return
    material, reflectance = innermost(shape.bsdf()).class_name(), value_of(shape.reflectance)
    wanted = f"must be a conductor of 'specular_reflectance' = {reflectance:.7g}, its 'reflectance', or be left out"
    if material != "SmoothConductor":
        raise SceneError(f"{shape.where}: its BSDF is a {material}, {wanted}")
    if not np.isclose(strength(shape, "specular_reflectance"), reflectance, rtol=_ROUNDING, atol=0):
        raise SceneError(
            f"{shape.where}: its BSDF reflects {strength(shape, 'specular_reflectance'):.7g} of the light, {wanted}"
        )
