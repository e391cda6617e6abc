r"""
.. _shape-lens:

Lens (:monosp:`lens`)
---------------------

.. pluginparameters::

 * - to_world
   - |transform|
   - Place of the front vertex; the axis is the local z and runs into the glass. Only rotation and translation.
   - |exposed|
 * - radius1, radius2
   - |float|
   - Radii of curvature of the front and the back surface at their vertices [mm]; positive: centre of curvature on
     the +z side, 0: plane. (Default: 0)
   - |exposed|
 * - conic1, conic2
   - |float|
   - Conic constants; 0: sphere, -1: paraboloid, below -1: hyperboloid. (Default: 0)
   - |exposed|
 * - thickness
   - |float|
   - Distance of the two vertices [mm]. (Required)
   - |exposed|
 * - diameter
   - |float|
   - Clear diameter of both surfaces [mm]. (Required)
   - |exposed|
 * - ior
   - |float|
   - Index of refraction at the laser's wavelength, at least 1; relative to air in air, else to vacuum. (Required)
   - |exposed|
 * - bsdf
   - |bsdf|
   - A smooth dielectric whose ``int_ior`` is ``ior``; its ``specular_transmittance`` counts at each surface, and its
     ``ext_ior`` says what everything stands in. (Default: a smooth dielectric of this index)
   -

A thick lens of two surfaces of revolution, :math:`z = c r^2 / (1 + \sqrt{1 - (1 + k) c^2 r^2})` from each vertex, and a
cylindrical rim. It stands in air, or in the ``ext_ior`` of the scene's dielectrics where that is another medium.

.. tabs::
    .. code-tab:: xml

        <shape type="lens">
            <float name="radius1" value="50"/> <float name="radius2" value="-50"/>
            <float name="thickness" value="5"/> <float name="diameter" value="20"/> <float name="ior" value="1.5151"/>
        </shape>

    .. code-tab:: python

        'type': 'lens', 'radius1': 50.0, 'radius2': -50.0, 'thickness': 5.0, 'diameter': 20.0, 'ior': 1.5151
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.outline import Circle
from speckle_mi.optics.surface import Surface
from speckle_mi.scene.body import Body
from speckle_mi.scene.elements import Element
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, value_of
from ._mesh import (
    ENCLOSING,
    SECTORS,
    evenly_in_slope,
    fill_mesh,
    move_mesh,
    ring_faces,
    rings,
    rounding_room,
    sector_angles,
    sheet_faces,
)
from ._numbers import check_numbers, expose, has_bsdf, in_words, read_numbers
from ._placement import Placement

_LENGTH = {"at_least": 1e-6, "at_most": 1e5, "unit": "mm"}

_CONIC = {"at_least": -1e4, "at_most": 1e4}
"""Beyond, a surface is a cone that turns round within a point."""

_LIMITS = {
    "radius1": {"unit": "mm"},
    "radius2": {"unit": "mm"},
    "conic1": _CONIC,
    "conic2": _CONIC,
    "thickness": _LENGTH,
    "diameter": _LENGTH,
    "ior": {"at_least": 1.0, "at_most": 10.0},
}
_DEFAULTS = {"radius1": 0.0, "radius2": 0.0, "conic1": 0.0, "conic2": 0.0}

_RINGS = 96
"""Rings of vertices on each surface."""

_GAP_SAMPLES = 4097
"""Radii at which the thickness of the glass is looked at."""

_ROUNDING = 1e-12
"""Relative excess of a diameter over a full hemisphere that is only rounding."""


class Lens(mi.Mesh):
    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        read_numbers(self, props, _LIMITS, _DEFAULTS)
        self._check()
        self.owns_bsdf = not has_bsdf(props)
        if self.owns_bsdf:
            props["bsdf"] = mi.load_dict({"type": "dielectric", "int_ior": self.index, "ext_ior": 1.0})
        super().__init__(props)
        vertices, normals = self._vertices()
        fill_mesh(self, self.placement.frame, vertices, _faces(), normals)

    @property
    def index(self) -> float:
        """Index of refraction of the glass."""
        return value_of(self.ior)

    def element(self) -> Element:
        """The glass between its two surfaces."""
        vertices, _ = self._vertices()
        body = Body.mesh(self.placement.frame.to_world(vertices), _faces())
        return Element(self.id(), "glass", self.surfaces(), body, index=self.index)

    def surfaces(self) -> tuple[Surface, Surface]:
        """Front and back surface in the world, each with its vertex and rim."""
        front = self.placement.frame
        back = Frame(front.origin + value_of(self.thickness) * front.axes[:, 2], front.axes)
        rim = Circle(value_of(self.diameter) / 2)
        return tuple(Surface(frame, *self._form(side), rim) for frame, side in ((front, 1), (back, 2)))

    def _form(self, side: int) -> tuple[float, float]:
        """Curvature [1/mm] and conic constant of the front (1) or back (2) surface."""
        radius, conic = (value_of(getattr(self, f"{name}{side}")) for name in ("radius", "conic"))
        return (1.0 / radius if radius else 0.0), conic

    def _check(self) -> None:
        check_numbers(self, _LIMITS)
        diameter, thickness = value_of(self.diameter), value_of(self.thickness)
        for side in (1, 2):
            curvature, conic = self._form(side)
            if (1 + conic) * (curvature * diameter / 2) ** 2 > 1 + _ROUNDING:
                raise SceneError(
                    f"{self.where}: parameter 'diameter' is {diameter:g} mm, must be at most "
                    f"{2 / np.sqrt((1 + conic) * curvature**2):.7g} mm, the widest that 'radius{side}' = "
                    f"{value_of(getattr(self, f'radius{side}')):g} mm with 'conic{side}' = {conic:g} allows"
                )
        r = diameter / 2 * np.sin(np.linspace(0, np.pi / 2, _GAP_SAMPLES))
        sag = [_sag(r, *self._form(side))[0] for side in (1, 2)]
        glass = thickness + sag[1] - sag[0]
        if np.min(glass) < -_ROUNDING * diameter:
            at = int(np.argmin(glass))
            raise SceneError(
                f"{self.where}: the surfaces cross inside the diameter of {diameter:g} mm (thickness {glass[at]:.4g} "
                f"mm at {r[at]:.4g} mm from the axis), must not: 'thickness' {thickness:g} mm must be at least "
                f"{thickness - glass[at]:.7g} mm, or 'diameter' smaller"
            )

    def _vertices(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (n, 3) [mm] and normals (n, 3) in the local frame: front, back, rim, each with its own."""
        radius, thickness, angles = value_of(self.diameter) / 2, value_of(self.thickness), sector_angles()
        reach = radius + thickness
        edge = ENCLOSING * (radius + rounding_room(self.placement.frame, reach))
        points, normals, ends = [], [], []
        for side, vertex, outward in ((1, 0.0, -1.0), (2, thickness, 1.0)):
            curvature, conic = self._form(side)
            r = radius * evenly_in_slope(np.arange(1, _RINGS + 1) / _RINGS, radius, curvature, conic)
            z, slope = _sag(r, curvature, conic)
            # The rim of the mesh lies a trace outside the diameter, at the height of the surface's own rim.
            profile = np.stack([np.append(r[:-1], edge), vertex + z], axis=-1)
            tilt = np.concatenate([-outward * slope[:, :1], outward * slope[:, 1:]], axis=-1)
            points += [[[0.0, 0.0, vertex]], rings(profile, angles)]
            normals += [[[0.0, 0.0, outward]], rings(tilt, angles)]
            ends.append(profile[-1])
        points.append(rings(np.array(ends), angles))
        normals.append(rings(np.array([[1.0, 0.0], [1.0, 0.0]]), angles))
        return np.concatenate(points), np.concatenate(normals)

    def traverse(self, callback) -> None:
        super().traverse(callback)
        expose(self, _LIMITS, callback)

    def parameters_changed(self, keys) -> None:
        keys = list(keys)
        self.placement.parameters_changed(keys, self.where)
        if {"to_world", *_LIMITS}.intersection(keys):
            self._check()
            keys += move_mesh(self, self.placement.frame, *self._vertices())
        if "ior" in keys and self.owns_bsdf:
            bsdf = mi.traverse(self.bsdf())
            bsdf["eta"] = self.index
            bsdf.update()
        super().parameters_changed(keys)

    def to_string(self) -> str:
        return f"Lens[{in_words(self, _LIMITS)}]"


def _sag(r: np.ndarray, curvature: float, conic: float) -> tuple[np.ndarray, np.ndarray]:
    """Height (n,) [mm] of a surface above its vertex plane at radii r (n,), and (sine, cosine) (n, 2) of its slope."""
    root = np.sqrt(np.maximum(1 - (1 + conic) * (curvature * r) ** 2, 0.0))
    length = np.hypot(curvature * r, root)
    return curvature * r * r / (1 + root), np.stack([curvature * r / length, root / length], axis=-1)


def _faces() -> np.ndarray:
    """Faces of front, back and rim, normals out of the glass."""
    vertices = 1 + _RINGS * SECTORS
    sheet = sheet_faces(_RINGS, SECTORS)
    # Front to back is what outwards is on the other two, with the rim turned inside out.
    rim = ring_faces(2, SECTORS)[:, ::-1]
    return np.concatenate([sheet[:, ::-1], vertices + sheet, 2 * vertices + rim])


mi.register_shape("lens", Lens)
