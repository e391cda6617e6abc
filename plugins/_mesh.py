"""Triangle meshes of the plugins: tessellations in the local frame, and their way into Mitsuba.

The meshes are there for finding which surface a ray meets, and for pictures; phases come from the analytic surfaces.
Rims are tessellated on the safe side: a polygon encloses the circle it stands for, with room for the single precision
of Mitsuba's vertices, so that no facet decides differently from an analytic outline that lets a ray through.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import mitsuba as mi
import numpy as np

from speckle_mi.geometry.frames import Frame

SECTORS = 512
"""Corners of the polygon that stands for a circle: it is 2e-5 of the radius too large."""

ENCLOSING = 1.0 / np.cos(np.pi / SECTORS)
"""Ratio of a polygon's corner radius to the radius of the circle inscribed in it."""

_ROUNDINGS = 4
"""Single-precision roundings between a vertex and the decision whether a ray hits its triangle."""


def rounding_room(frame: Frame, extent: float) -> float:
    """Length [mm] that covers the single-precision rounding of a mesh within ``extent`` [mm] of the frame's origin."""
    return _ROUNDINGS * float(np.finfo(np.float32).eps) * (float(np.max(np.abs(frame.origin))) + extent)


def fill_mesh(
    mesh: mi.Mesh, frame: Frame, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None = None
) -> None:
    """Gives a mesh under construction its vertices (n, 3) [mm], faces (f, 3) and vertex normals (n, 3), all local."""
    parameters = mi.traverse(mesh)
    parameters["faces"] = mi.UInt32(np.ravel(faces).astype(np.uint32))
    parameters["vertex_positions"] = _single(frame.to_world(vertices))
    parameters["vertex_normals"] = mi.Float() if normals is None else _single(normals @ frame.axes.T)
    parameters["vertex_texcoords"] = mi.Float()
    parameters.update()


def move_mesh(mesh: mi.Mesh, frame: Frame, vertices: np.ndarray, normals: np.ndarray | None = None) -> list[str]:
    """Replaces vertices (n, 3) [mm] and normals (n, 3); their number stays. Returns the names of what has changed.

    For use in ``parameters_changed``, which hands the names on to ``mi.Mesh``.
    """
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = _single(frame.to_world(vertices))
    if normals is None:
        return ["vertex_positions"]
    parameters["vertex_normals"] = _single(normals @ frame.axes.T)
    return ["vertex_positions", "vertex_normals"]


def moved_with(
    shape: mi.Mesh, keys: Iterable[str], names: Iterable[str], check: Callable[[], None],
    tessellation: Callable[[], tuple[np.ndarray, ...]],
) -> list[str]:  # fmt: skip
    """Takes a shape's changed parameters over: its place, and where that or one of ``names`` has changed, its mesh.

    check: raises SceneError for numbers that do not go together; tessellation: gives what :func:`move_mesh` takes. For
    use in ``parameters_changed``, which hands the names of all that has changed, returned, on to ``mi.Mesh``.
    """
    keys = list(keys)
    shape.placement.parameters_changed(keys, shape.where)
    if {"to_world", *names}.intersection(keys):
        check()
        keys += move_mesh(shape, shape.placement.frame, *tessellation())
    return keys


def _single(vectors: np.ndarray):
    return mi.Float(vectors.ravel().astype(np.float32))


def sector_angles() -> np.ndarray:
    """Angles (SECTORS,) of a polygon's corners [rad]."""
    return 2 * np.pi * np.arange(SECTORS) / SECTORS


def rings(profiles: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Points (m * s, 3) of profiles (m, 2) in (r, z) [mm] turned to every angle (s,) about z, ring after ring."""
    x = np.multiply.outer(profiles[:, 0], np.cos(angles))
    y = np.multiply.outer(profiles[:, 0], np.sin(angles))
    z = np.broadcast_to(profiles[:, 1, None], x.shape)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def ring_faces(count: int, sectors: int) -> np.ndarray:
    """Faces (2 (count - 1) sectors, 3) between ``count`` rings of points.

    Rings are numbered from the first; seen with the rings counting outwards and z up, normals are +z.
    """
    ring, sector = np.meshgrid(np.arange(count - 1), np.arange(sectors), indexing="ij")
    following = (sector + 1) % sectors
    a, b = ring * sectors + sector, (ring + 1) * sectors + sector
    c, d = (ring + 1) * sectors + following, ring * sectors + following
    return np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)])


def sheet_faces(count: int, sectors: int) -> np.ndarray:
    """Faces (sectors + 2 (count - 1) sectors, 3) of a middle point and the ``count`` rings that follow, normals +z."""
    sector = np.arange(sectors)
    cap = np.stack([np.zeros(sectors, dtype=int), 1 + sector, 1 + (sector + 1) % sectors], axis=-1)
    return np.concatenate([cap, 1 + ring_faces(count, sectors)])


def evenly_in_slope(steps: np.ndarray, reach: float, curvature: float, conic: float) -> np.ndarray:
    """Steps (m,) from 0 to 1 of a radius, moved to be even in the sine of a surface's slope.

    A hemisphere is then as fine at its rim, at ``reach`` [mm] from the axis, as at its vertex.
    """
    sine = abs(curvature) * reach * np.sqrt(max(1 + conic, 0.0))
    widest = np.arcsin(min(sine, 1.0))
    return np.sin(steps * widest) / np.sin(widest) if widest > 0 else steps
