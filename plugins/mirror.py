r"""
.. _shape-mirror:

Mirror (:monosp:`mirror`)
-------------------------

.. pluginparameters::

 * - to_world
   - |transform|
   - Place of the vertex of the surface of revolution; its axis is the local z. Only rotation and translation.
   - |exposed|
 * - radius
   - |float|
   - Radius of curvature at the vertex [mm]; positive: centre of curvature on the +z side, 0: plane. (Default: 0)
   - |exposed|
 * - conic
   - |float|
   - Conic constant; 0: sphere, -1: paraboloid, below -1: hyperboloid. (Default: 0)
   - |exposed|
 * - aspheric
   - |string|
   - Coefficients of r^4, r^6, ... [mm^-3, mm^-5, ...], up to ten between commas. (Default: none)
   -
 * - diameter
   - |float|
   - Diameter of the mirror across the axis [mm]. (Required)
   - |exposed|
 * - off_axis
   - |float|
   - Distance of the mirror's middle from the axis, along the local x [mm]. (Default: 0)
   - |exposed|
 * - reflectance
   - |float|
   - Part of the intensity that is reflected, above 0 and at most 1. (Default: 1)
   - |exposed|
 * - bsdf
   - |bsdf|
   - A smooth conductor whose ``specular_reflectance`` is ``reflectance``, for other integrators. (Default: such a
     one, two-sided)
   -

A thin mirror of limited size that reflects on both sides: the part of the surface of revolution
:math:`z = c r^2 / (1 + \sqrt{1 - (1 + k) c^2 r^2}) + a_1 r^4 + a_2 r^6 + ...` that lies
in a cylinder along the local z. The local origin is the
vertex of the whole surface, whether or not the mirror holds it: a paraboloid has its focus at z = ``radius`` / 2 on the
local z axis for any ``off_axis``, and light along z meets it in a round spot of the full ``diameter``.

::

            z |
              |
              |              the mirror, seen along y
        focus x               ,
              |              /   ---
              |            ,'     |
              |         _,'       | diameter, measured along x
              |     _,-'         ---
       vertex o---'-----|------------> x
              |<------->|
               off_axis, to the middle of the diameter

A catalogue's paraboloid of reflected focal length F and off-axis angle A has ``radius`` = F (1 + cos A), ``conic`` = -1
and ``off_axis`` = F sin A.

.. tabs::
    .. code-tab:: xml

        <shape type="mirror">
            <float name="radius" value="200"/> <float name="conic" value="-1"/>
            <float name="diameter" value="25.4"/> <float name="off_axis" value="50"/>
        </shape>

    .. code-tab:: python

        'type': 'mirror', 'radius': 200.0, 'conic': -1.0, 'diameter': 25.4, 'off_axis': 50.0
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.outline import Circle, OffsetCircle
from speckle_mi.optics.even_asphere import MOST_COEFFICIENTS, EvenAsphere
from speckle_mi.optics.prescription import ROUNDING
from speckle_mi.optics.surface import Surface
from speckle_mi.scene.body import Body
from speckle_mi.scene.elements import Element
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, read_list, value_of
from ._mesh import ENCLOSING, SECTORS, evenly_in_slope, fill_mesh, moved_with, rounding_room, sector_angles, sheet_faces
from ._numbers import check_numbers, expose, has_bsdf, in_words, read_numbers
from ._placement import Placement

_LIMITS = {
    "radius": {"unit": "mm"},
    "conic": {"at_least": -1e4, "at_most": 1e4},  # beyond, a cone that turns round within a point
    "diameter": {"at_least": 1e-6, "at_most": 1e5, "unit": "mm"},
    "off_axis": {"at_least": -1e5, "at_most": 1e5, "unit": "mm"},
    "reflectance": {"above": 0.0, "at_most": 1.0},
}
_DEFAULTS = {"radius": 0.0, "conic": 0.0, "off_axis": 0.0, "reflectance": 1.0}

_RINGS = 96
"""Rings of vertices around the mirror's middle."""


class Mirror(mi.Mesh):
    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        read_numbers(self, props, _LIMITS, _DEFAULTS)
        self.aspheric = read_list(props, "aspheric", MOST_COEFFICIENTS)
        self._check()
        self.owns_bsdf = not has_bsdf(props)
        if self.owns_bsdf:
            reflectance = {"type": "uniform", "value": value_of(self.reflectance)}
            metal = {"type": "conductor", "specular_reflectance": reflectance}
            props["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": metal})
        super().__init__(props)
        vertices, normals = self._vertices()
        fill_mesh(self, self.placement.frame, vertices, sheet_faces(_RINGS, SECTORS), normals)

    def element(self) -> Element:
        """The mirror's surface inside its rim."""
        vertices, _ = self._vertices()
        body = Body.mesh(self.placement.frame.to_world(vertices), sheet_faces(_RINGS, SECTORS))
        amplitude = float(np.sqrt(value_of(self.reflectance)))
        return Element(self.id(), "mirror", (self._surface(self.placement.frame),), body, amplitude=amplitude)

    def _surface(self, frame: Frame) -> Surface:
        """The surface with its vertex at the origin of ``frame``."""
        radius, off_axis, rim = value_of(self.radius), value_of(self.off_axis), value_of(self.diameter) / 2
        outline = OffsetCircle(rim, (off_axis, 0.0)) if off_axis else Circle(rim)
        curvature, conic = 1.0 / radius if radius else 0.0, value_of(self.conic)
        if any(self.aspheric):
            return EvenAsphere(frame, curvature, conic, outline, self.aspheric)
        return Surface(frame, curvature, conic, outline)

    def _check(self) -> None:
        check_numbers(self, _LIMITS)
        surface = self._surface(Frame(np.zeros(3), np.eye(3)))
        widest, off_axis = surface.widest, value_of(self.off_axis)
        if surface.outline.reach <= widest * (1 + ROUNDING):
            return
        ends = f"where the surface of 'radius' = {value_of(self.radius):g} mm with 'conic' = {surface.conic:g} ends"
        if abs(off_axis) >= widest:
            raise SceneError(
                f"{self.where}: parameter 'off_axis' is {off_axis:g} mm, "
                f"must be less than {widest:.7g} mm in size, {ends}"
            )
        beside = f" at 'off_axis' = {off_axis:g} mm" if off_axis else ""
        raise SceneError(
            f"{self.where}: parameter 'diameter' is {value_of(self.diameter):g} mm, "
            f"must be at most {2 * (widest - abs(off_axis)):.7g} mm{beside}, {ends}"
        )

    def _vertices(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (n, 3) [mm] and normals (n, 3), towards +z, in the local frame: the middle, then ring after ring."""
        surface = self._surface(Frame(np.zeros(3), np.eye(3)))
        outline, angles = surface.outline, sector_angles()
        steps = evenly_in_slope(np.arange(_RINGS + 1) / _RINGS, outline.reach, surface.curvature, surface.conic)
        r = outline.half_size[0] * steps
        point = _around(outline.centre, r, angles)
        point[2] = surface.sag(point[0], point[1])
        normal = -surface.gradient(point)
        # The rim of the mesh lies a trace outside the diameter, at the height of the surface's own rim.
        extent = outline.reach + float(np.max(np.abs(point[2])))
        r[-1] = ENCLOSING * (r[-1] + rounding_room(self.placement.frame, extent))
        point[:2] = _around(outline.centre, r, angles)[:2]
        return point.T, (normal / np.linalg.norm(normal, axis=0)).T

    def traverse(self, callback) -> None:
        super().traverse(callback)
        expose(self, _LIMITS, callback)

    def parameters_changed(self, keys) -> None:
        keys = moved_with(self, keys, _LIMITS, self._check, self._vertices)
        if "reflectance" in keys and self.owns_bsdf:
            bsdf = mi.traverse(self.bsdf())
            for name in bsdf.keys():
                if name.endswith("specular_reflectance.value"):
                    bsdf[name] = value_of(self.reflectance)
            bsdf.update()
        super().parameters_changed(keys)

    def to_string(self) -> str:
        return f"Mirror[{in_words(self, _LIMITS)}]"


def _around(centre: tuple[float, float], r: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Places (3, 1 + (m - 1) s) at z = 0: ``centre``, then at every angle (s,) each of the distances r[1:] (m,)."""
    x = centre[0] + np.append(0.0, np.outer(r[1:], np.cos(angles)))
    y = centre[1] + np.append(0.0, np.outer(r[1:], np.sin(angles)))
    return np.stack([x, y, np.zeros_like(x)])


mi.register_shape("mirror", Mirror)
