"""The edge of a lens or a plate: what stands around its glass between the rims of its faces.

Between two rims the glass ends at a cylinder of the larger one's radius, and flat rings lead from there to the smaller.
Around a rectangular plate it is four planes.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ..geometry.frames import Frame
from .surface import Surface


def edge_profile(faces: tuple[Surface, ...]) -> np.ndarray:
    """Corners (m, 2) of the edge as (distance from the axis, height along the first face's axis) [mm], from rim to rim.

    faces: round, centred, behind one another on one axis.
    """
    frame = faces[0].frame
    radius = [face.outline.reach for face in faces]
    height = [float(face.sag(r, 0.0) + (face.frame.origin - frame.origin) @ frame.axes[:, 2])
              for face, r in zip(faces, radius, strict=True)]  # fmt: skip
    corners = [(radius[0], height[0])]
    for one in range(len(faces) - 1):
        wider = max(radius[one], radius[one + 1])
        corners += [(wider, height[one]), (wider, height[one + 1])]
    corners.append((radius[-1], height[-1]))
    kept = corners[:1] + [b for a, b in zip(corners, corners[1:], strict=False) if a != b]
    return np.array(kept)


def edge_crossing(faces: tuple[Surface, ...], origin: np.ndarray, direction: np.ndarray, room: float) -> np.ndarray:
    """Distance (n,) [mm] at which lines from origin along unit direction (n, 3) meet the edge, inf where they do not.

    room: what is nearer than this [mm] to the start, or to the rim of a face, is not met.
    """
    frame = faces[0].frame
    p, d = frame.to_local(origin).T, (direction @ frame.axes).T
    found = np.full(len(origin), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        if not faces[0].outline.is_round:
            for length in _with_sides(p, d, faces, room):
                found = np.where(length > room, np.fmin(found, length), found)
            return found
        if not all(face.has_flat_rim for face in faces):
            for pair in zip(faces, faces[1:], strict=False):
                for length in _between(p, d, pair, frame, room):
                    found = np.where(length > room, np.fmin(found, length), found)
            return found
        corners = edge_profile(faces)
        for (r1, z1), (r2, z2) in zip(corners, corners[1:], strict=False):
            if r1 == r2:
                crossings = _with_cylinder(p, d, r1, min(z1, z2) + room, max(z1, z2) - room)
            else:
                crossings = [_with_ring(p, d, z1, min(r1, r2), max(r1, r2))]
            for length in crossings:
                found = np.where(length > room, np.fmin(found, length), found)
    return found


def rim_height(face: Surface, frame: Frame, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights (n,) [mm] above a frame's origin of a face, whose axes are the frame's, at local x, y (n,)."""
    return face.sag(x, y) + (face.frame.origin - frame.origin) @ frame.axes[:, 2]


def _between(p: np.ndarray, d: np.ndarray, pair, frame: Frame, room: float) -> list[np.ndarray]:
    """Crossings with the cylinder between two rims of one diameter that do not lie in planes."""
    found = []
    for length in _with_cylinder(p, d, pair[0].outline.reach, -np.inf, np.inf):
        x, y, z = p + length * d
        one, two = (rim_height(face, frame, x, y) for face in pair)
        found.append(np.where((z > np.minimum(one, two) + room) & (z < np.maximum(one, two) - room), length, np.inf))
    return found


def _with_sides(p: np.ndarray, d: np.ndarray, faces: tuple[Surface, ...], room: float) -> list[np.ndarray]:
    """Crossings with the four sides between the first and the last of plane faces of one rectangular rim."""
    half = faces[0].outline.half_size
    height = float((faces[-1].frame.origin - faces[0].frame.origin) @ faces[0].frame.axes[:, 2])
    low, high = min(0.0, height) + room, max(0.0, height) - room
    found = []
    for axis, side in product((0, 1), (-1, 1)):
        length = (side * half[axis] - p[axis]) / d[axis]
        across, z = p[1 - axis] + length * d[1 - axis], p[2] + length * d[2]
        found.append(np.where((np.abs(across) <= half[1 - axis]) & (z > low) & (z < high), length, np.inf))
    return found


def _with_cylinder(p: np.ndarray, d: np.ndarray, radius: float, low: float, high: float) -> list[np.ndarray]:
    a, b, c = d[0] ** 2 + d[1] ** 2, p[0] * d[0] + p[1] * d[1], p[0] ** 2 + p[1] ** 2 - radius**2
    root = np.sqrt(b * b - a * c)
    lengths = [(-b - root) / a, (-b + root) / a]
    return [np.where((p[2] + t * d[2] > low) & (p[2] + t * d[2] < high), t, np.inf) for t in lengths]


def _with_ring(p: np.ndarray, d: np.ndarray, height: float, inner: float, outer: float) -> np.ndarray:
    length = (height - p[2]) / d[2]
    r = np.hypot(p[0] + length * d[0], p[1] + length * d[1])
    return np.where((r > inner) & (r <= outer), length, np.inf)
