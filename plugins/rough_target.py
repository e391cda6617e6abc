r"""
.. _shape-rough_target:

Rough target (:monosp:`rough_target`)
-------------------------------------

.. pluginparameters::

 * - to_world
   - |transform|
   - Place of the target at rest: its origin, and its normal +z. Only rotation and translation.
   - |exposed|
 * - width, height
   - |float|
   - Size of a plane patch along x and y [mm]. (Default: 4)
   -
 * - filename
   - |string|
   - PLY or OBJ file of a surface of any form instead of the patch [mm], faces wound so that their normals point
     outwards; relative to the scene file.
   -
 * - roughness
   - |float|
   - Rms height of the surface [um]. (Default: 0)
   - |exposed|
 * - correlation_length
   - |float|
   - Length at which the heights' Gaussian autocorrelation has fallen to 1/e [um]; 0: independent heights.
     (Default: 0)
   - |exposed|
 * - point_sources
   - |integer|
   - Scatterers expected inside the beam's 1/e^2 footprint at rest, or on the whole surface under a laser without
     ``beam_radius``. (Default: 100)
   -
 * - seed
   - |integer|
   - Which surface. (Default: 0)
   - |exposed|
 * - points
   - |string|
   - CSV file of the user's own scatterers instead: x, y, z [mm, target frame] and optionally re, im, which multiply
     the laser's field; no roughness is added. Relative to the scene file.
   -
 * - lobe
   - |boolean|
   - Whether scatterers radiate with the amplitude sqrt(f cos) of the target's BSDF f instead of evenly.
     (Default: false)
   -
 * - x, y, z, rx, ry, rz
   - |float|
   - Pose: displacement from rest [mm] and rotation vector [deg], in the target's own frame about its origin.
     Not read from the scene file but set by ``mi.traverse``. (Default: 0)
   - |exposed|

A rough surface as scatterers that belong to the material: the same seed gives the same scatterers at the same places of
the surface whatever its pose. It is also an ordinary mesh, which any integrator can render.

.. tabs::
    .. code-tab:: xml

        <shape type="rough_target">
            <float name="width" value="4"/> <float name="height" value="4"/>
            <float name="roughness" value="0.8"/>
            <integer name="point_sources" value="100"/>
        </shape>

    .. code-tab:: python

        'type': 'rough_target', 'width': 4.0, 'height': 4.0, 'roughness': 0.8, 'point_sources': 100
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM, Pose
from speckle_mi.scattering.facets import Facets
from speckle_mi.scattering.rough_surface import PointScatterers
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, read_boolean, read_integer, read_number, stored, value_of
from speckle_mi.scene.target_files import mesh_from_file, points_from_csv, resolve
from ._mesh import fill_mesh, move_mesh
from ._numbers import check_numbers, expose, read_numbers
from ._placement import Placement

_LIMITS = {
    "roughness": {"at_least": 0.0, "at_most": 1e6, "unit": "um"},
    "correlation_length": {"at_least": 0.0, "at_most": 1e9, "unit": "um"},
}
_SIZE = {"at_least": 1e-6, "at_most": 1e5, "unit": "mm"}

_SHORTEST = 1e-3
"""Least correlation length [um] other than 0: below the distance of atoms there is none."""

_LARGEST_SEED = 2**63 - 1


class RoughTarget(mi.Mesh):
    role = "rough_target"

    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        read_numbers(self, props, _LIMITS, dict.fromkeys(_LIMITS, 0.0))
        self._check()
        self.point_sources = read_integer(props, "point_sources", 100, at_least=1, at_most=10**15)
        seed = read_integer(props, "seed", 0, at_least=0, at_most=_LARGEST_SEED)
        self.seed = mi.UInt64(seed)
        self.lobe = read_boolean(props, "lobe", False)
        for name in DEGREES_OF_FREEDOM:
            setattr(self, name, stored(0.0))
        vertices, faces = self._read_form(props)
        self.points = self._read_points(props)
        self.precise_transforms: dict[str, np.ndarray] = {}
        self.stated_indices: dict[str, list[tuple[float, float]]] = {}
        self.bsdf_recipe: dict | None = None
        super().__init__(props)
        self.rest_mesh = vertices, faces
        fill_mesh(self, self._place(), vertices, faces)

    def pose(self) -> Pose:
        """Displacement from rest."""
        return Pose(**{name: value_of(getattr(self, name)) for name in DEGREES_OF_FREEDOM})

    def _read_form(self, props: mi.Properties) -> tuple[np.ndarray, np.ndarray]:
        if "filename" in props:
            if "width" in props or "height" in props:
                raise SceneError(
                    f"{self.where}: has both 'filename' and a size ('width', 'height'), must have one of them"
                )
            vertices, faces = mesh_from_file(resolve(props, "filename"), self.where)
            self.facets = Facets.triangles(vertices[faces])
            if self.facets.count == 0:
                raise SceneError(f"{self.where}: the faces of {props['filename']!r} have no area, must have some")
            return vertices, faces
        a = read_number(props, "width", 4.0, **_SIZE) / 2
        b = read_number(props, "height", 4.0, **_SIZE) / 2
        self.facets = Facets.rectangle(2 * a, 2 * b)
        return np.array([[-a, -b, 0], [a, -b, 0], [a, b, 0], [-a, b, 0]]), np.array([[0, 1, 2], [0, 2, 3]])

    def _read_points(self, props: mi.Properties) -> PointScatterers | None:
        if "points" not in props:
            return None
        return PointScatterers(*points_from_csv(resolve(props, "points"), self.where))

    def _check(self) -> None:
        check_numbers(self, _LIMITS)
        if 0 < value_of(self.correlation_length) < _SHORTEST:
            raise SceneError(
                f"{self.where}: parameter 'correlation_length' is {value_of(self.correlation_length):g} um, "
                f"must be 0 (independent heights) or at least {_SHORTEST:g} um"
            )

    def _place(self) -> Frame:
        return self.placement.frame.moved(self.pose())

    def traverse(self, callback) -> None:
        super().traverse(callback)
        expose(self, (*_LIMITS, "seed", *DEGREES_OF_FREEDOM), callback)

    def parameters_changed(self, keys) -> None:
        self._check()
        self.placement.parameters_changed(keys, self.where)
        keys = list(keys)
        if {"to_world", *DEGREES_OF_FREEDOM}.intersection(keys):
            keys += move_mesh(self, self._place(), self.rest_mesh[0])
        super().parameters_changed(keys)

    def to_string(self) -> str:
        return (
            f"RoughTarget[{self.facets.count} facets, roughness = {value_of(self.roughness)} um, "
            f"correlation_length = {value_of(self.correlation_length)} um, point_sources = {self.point_sources}, "
            f"seed = {int(value_of(self.seed))}, pose = '{self.pose()}']"
        )


mi.register_shape("rough_target", RoughTarget)
