"""The form of a shape as rays meet it, copied out of Mitsuba's scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ANALYTIC = ("sphere", "disk", "rectangle", "cylinder")
"""Forms of Mitsuba that are given by a transform alone."""


@dataclass(frozen=True, eq=False)
class Body:
    """A shape's geometry in the world.

    form: "mesh" or one of ``ANALYTIC``; to_world: (4, 4) of an analytic form [mm]; vertices (n, 3) [mm] and faces
    (m, 3) of a mesh; bounds: (2, 3) lowest and highest corner of its box [mm].
    """

    form: str
    bounds: np.ndarray
    to_world: np.ndarray | None = None
    vertices: np.ndarray | None = None
    faces: np.ndarray | None = None

    @classmethod
    def mesh(cls, vertices: np.ndarray, faces: np.ndarray) -> Body:
        """Triangles with corners ``vertices`` (n, 3) [mm], numbered by ``faces`` (m, 3)."""
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        bounds = np.array([vertices.min(axis=0), vertices.max(axis=0)])
        return cls("mesh", bounds, vertices=vertices, faces=np.ascontiguousarray(faces, dtype=np.uint32))

    @property
    def size(self) -> float:
        """Diagonal of the box [mm]."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @property
    def reach(self) -> float:
        """Largest coordinate [mm]."""
        return float(np.max(np.abs(self.bounds)))


def body_of(shape, to_world: np.ndarray | None) -> Body | None:
    """A copy of a Mitsuba shape's geometry, None where its form cannot be copied.

    to_world: (4, 4) of an analytic form, in double precision.
    """
    import mitsuba as mi

    parameters = mi.traverse(shape)
    if "vertex_positions" in parameters and "faces" in parameters:
        vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
        return Body.mesh(vertices, np.array(parameters["faces"]).reshape(-1, 3))
    form = shape.class_name().lower()
    if form not in ANALYTIC:
        return None
    box = shape.bbox()
    return Body(form, np.array([box.min, box.max], dtype=np.float64), to_world=to_world)
