"""Places on faces, openings and the detector that stand for all of them."""

from __future__ import annotations

import numpy as np

from ..geometry.frames import Frame
from ..geometry.plane import PlaneGrid
from ..geometry.rotation import vectors_across
from ..optics.surface import Surface

FINE = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0), 12
"""Rings on an opening, relative to its rim, and places a ring, where many are needed."""

DETECTOR_SIDE = 5
"""Places a side on the detector."""

_FAN_SIDE = 16


def hole_places(face: Surface, shares: tuple[float, ...], angles: int) -> np.ndarray:
    """World points (n, 3) on an opening: its middle, and rings at shares of the way to the rim."""
    angle = 2 * np.pi * np.arange(angles) / angles
    rim = np.array(face.outline.edge(angle)) - np.array(face.outline.centre)[:, None]
    local = [np.zeros((2, 1)) if share == 0 else share * rim for share in shares]
    x, y = np.concatenate(local, axis=1) + np.array(face.outline.centre)[:, None]
    return face.frame.to_world(np.stack([x, y, np.zeros_like(x)], axis=1))


def detector_places(grid: PlaneGrid, side: int = DETECTOR_SIDE) -> np.ndarray:
    """World points (side^2, 3) over the detector, from edge to edge."""
    share = np.linspace(-1, 1, side)
    half_u, half_v = grid.half_size
    a, b = (values.ravel() for values in np.meshgrid(share, share))
    return grid.centre + (half_u * a)[:, None] * grid.u + (half_v * b)[:, None] * grid.v


def on_pixels(grid: PlaneGrid, share: np.ndarray) -> np.ndarray:
    """Places on the detector at shares (k, 2) of its half sizes, to the middles of the outermost pixels."""
    half = 0.5 * grid.pitch * (np.array(grid.shape[::-1]) - 1)
    return grid.centre + (share[:, :1] * half[0]) * grid.u + (share[:, 1:] * half[1]) * grid.v


def on_face(face: Surface, closed: bool, share: np.ndarray) -> np.ndarray:
    """Places on a face inside its rim, or all over a closed one."""
    if closed:
        count = len(share)
        number = np.arange(2 * count) + 0.5
        z = 1 - number / count
        angle = np.pi * (1 + 5**0.5) * number
        ring = np.sqrt(1 - z * z)
        centre = face.centre_of_curvature
        return centre + np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1) / abs(face.curvature)
    # A square of shares on a round face: its corners are drawn in to the rim.
    disc = share * (np.maximum(np.abs(share).max(axis=1), 1e-300) / np.maximum(np.hypot(*share.T), 1e-300))[:, None]
    disc[np.all(share == 0, axis=1)] = 0
    half = np.array(face.outline.half_size)
    x, y = np.array(face.outline.centre)[:, None] + (half * (disc if face.outline.is_round else share)).T
    return face.frame.to_world(np.stack([x, y, face.sag(x, y)], axis=1))


def on_plane(frame: Frame, half: np.ndarray, share: np.ndarray, middle: tuple[float, float]) -> np.ndarray:
    """Places (k, 3) in a plane at shares (k, 2) of half sizes (2,) [mm] from a middle [mm]."""
    local = np.array(middle) + half * share
    return frame.to_world(np.column_stack([local, np.zeros(len(share))]))


def plane_at(
    face: Surface, closed: bool, seen_from: np.ndarray, share: np.ndarray
) -> tuple[Surface, np.ndarray]:
    """A plane through a face, or across a closed one seen from a place (3,), and the places (k, 3) of shares on it."""
    if face.is_plane:
        return face, on_face(face, False, share)
    if not closed:
        sag = float(face.sag(0.7 * face.outline.reach, 0.0))
        plane = Surface(Frame(face.frame.origin + sag * face.frame.axes[:, 2], face.frame.axes))
        return plane, on_plane(plane.frame, 0.9 * np.array(face.outline.half_size), share, face.outline.centre)
    radius = 1 / abs(face.curvature)
    centre = face.centre_of_curvature
    axis = (centre - seen_from) / max(np.linalg.norm(centre - seen_from), 1e-300)
    plane = Surface(Frame(centre, axes_along(axis)))
    return plane, on_plane(plane.frame, 0.9 * np.array([radius, radius]), share, (0.0, 0.0))


def points_on(face: Surface) -> np.ndarray:
    """World points (n, 3) spread over a face inside its rim, or over half of a sphere."""
    number = np.arange(_FAN_SIDE**2) + 0.5
    radius, angle = np.sqrt(number / _FAN_SIDE**2), np.pi * (1 + 5**0.5) * number
    half_x, half_y = face.outline.half_size if face.outline else (1 / face.curvature,) * 2
    x, y = half_x * radius * np.cos(angle), half_y * radius * np.sin(angle)
    return face.frame.to_world(np.stack([x, y, face.sag(x, y)], axis=1))


def axes_along(axis: np.ndarray) -> np.ndarray:
    """(3, 3) axes with z along a unit vector."""
    return np.column_stack([*vectors_across(axis), axis])
