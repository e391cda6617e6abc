"""The mesh of a lens: its first and last surface and the edge between their rims, as other integrators see it."""

from __future__ import annotations

import numpy as np

from speckle_mi.geometry.frames import Frame
from speckle_mi.optics.edge import edge_profile, rim_height
from speckle_mi.optics.surface import Surface
from speckle_mi.scene.write import ORIGIN
from ._mesh import ENCLOSING, SECTORS, evenly_in_slope, ring_faces, rings, rounding_room, sector_angles, sheet_faces

RINGS = 96
"""Rings of vertices on each surface."""


def lens_vertices(surfaces: tuple[Surface, ...], frame: Frame, bands: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [mm] and normals (n, 3) in the local frame: front, back, edge, each with its own.

    surfaces: in the local frame; frame: the lens's place; bands: how many the edge has, of which some may be empty.
    """
    angles = sector_angles()
    corners = edge_profile(surfaces)
    room = rounding_room(frame, float(np.max(np.abs(corners))))
    points, normals = [], []
    for surface, outward in ((surfaces[0], -1.0), (surfaces[-1], 1.0)):
        radius, vertex = surface.outline.reach, surface.frame.origin[2]
        r = radius * evenly_in_slope(np.arange(1, RINGS + 1) / RINGS, radius, surface.curvature, surface.conic)
        place = rings(np.stack([r, np.zeros(RINGS)], axis=-1), angles).T
        place[2] = np.repeat(surface.sag(r, 0.0), SECTORS) if surface.has_flat_rim else surface.sag(place[0], place[1])
        normal = -outward * surface.gradient(place)
        # The rim of the mesh lies a trace outside the diameter, at the height of the surface's own rim.
        place[:2, -SECTORS:] *= ENCLOSING * (radius + room) / radius
        place[2] += vertex
        points += [[[0.0, 0.0, vertex]], place.T]
        normals += [[[0.0, 0.0, outward]], (normal / np.linalg.norm(normal, axis=0)).T]
    corners = corners * [ENCLOSING, 1.0] + [ENCLOSING * room, 0.0]
    pairs = list(zip(corners, corners[1:], strict=False))
    if not all(surface.has_flat_rim for surface in surfaces):
        return _with_bent_edge(surfaces, points, normals, ENCLOSING * (surfaces[0].outline.reach + room))
    for pair in pairs + [(corners[-1], corners[-1])] * (bands - len(pairs)):
        points.append(rings(np.array(pair), angles))
        (r1, z1), (r2, z2) = pair
        across = [1.0, 0.0] if r1 == r2 else [0.0, np.sign(r1 - r2)]
        normals.append(rings(np.array([across, across]), angles))
    return np.concatenate(points), np.concatenate(normals)


def _with_bent_edge(surfaces: tuple[Surface, ...], points: list, normals: list, radius: float):
    """Vertices and normals with an edge between rims of one diameter that do not lie in planes."""
    angles, reach = sector_angles(), surfaces[0].outline.reach
    around = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    heights = [rim_height(one, ORIGIN, *(reach * around.T))[:, None] for one in surfaces]
    outward = np.concatenate([around, np.zeros((SECTORS, 1))], axis=1)
    for pair in zip(heights, heights[1:], strict=False):
        points += [np.concatenate([radius * around, height], axis=1) for height in pair]
        normals += [outward, outward]
    return np.concatenate(points), np.concatenate(normals)


def bands_of(surfaces: tuple[Surface, ...]) -> int:
    """How many bands the edge of a lens may have, whatever the numbers of its surfaces."""
    return 2 * len(surfaces) - 1 if len({one.outline.reach for one in surfaces}) > 1 else len(surfaces) - 1


def lens_faces(bands: int) -> np.ndarray:
    """Faces of front, back and edge, normals out of the glass."""
    vertices = 1 + RINGS * SECTORS
    sheet = sheet_faces(RINGS, SECTORS)
    # Front to back is what outwards is on the other two, with the edge turned inside out.
    band = ring_faces(2, SECTORS)[:, ::-1]
    edge = [2 * vertices + 2 * SECTORS * number + band for number in range(bands)]
    return np.concatenate([sheet[:, ::-1], vertices + sheet, *edge])
