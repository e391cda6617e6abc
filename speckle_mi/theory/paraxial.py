"""Paraxial optics of a rotationally symmetric system: magnification, image distance, entrance and exit pupil.

Rays are columns (height [mm], index times angle).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .directions import require_positive


@dataclass(frozen=True)
class CardinalPoints:
    """Focal lengths and planes [mm]; front planes are measured from the input plane, rear ones from the output plane.

    Positions are positive in the direction of the light. focal_length is the rear one, n'/power; > 0 converges.
    """

    focal_length: float
    front_focal_length: float
    front_focus: float
    rear_focus: float
    front_principal: float
    rear_principal: float


def system_matrix(surfaces: Sequence[tuple[float, float, float]], index: float = 1.0) -> np.ndarray:
    """(2, 2) paraxial matrix of surfaces (curvature [1/mm], distance [mm], index), light first meets the first.

    curvature: + with the centre of curvature behind the surface, 0 plane; index: of the medium behind it; distance:
    to the next surface, for the last one to the output plane (0: its vertex). ``index``: before the first surface.
    Rays are (height, n angle); the determinant is 1.
    """
    matrix = np.eye(2)
    before = require_positive("index", index)
    for curvature, distance, behind in surfaces:
        behind = require_positive("index", behind)
        refraction = np.array([[1.0, 0.0], [-(behind - before) * curvature, 1.0]])
        matrix = np.array([[1.0, distance / behind], [0.0, 1.0]]) @ refraction @ matrix
        before = behind
    return matrix


def cardinal_points(matrix: np.ndarray, index: float = 1.0, index_image: float = 1.0) -> CardinalPoints:
    """Cardinal points of a `system_matrix` between media of the given indices. ValueError if it is afocal."""
    (a, _), (c, d) = np.asarray(matrix, dtype=np.float64)
    if c == 0:
        raise ValueError("the system is afocal (power 0): it has no focal length, use paraxial_image")
    focal, front_focal = -index_image / c, index / c
    front_focus, rear_focus = index * d / c, -index_image * a / c
    return CardinalPoints(focal, front_focal, front_focus, rear_focus, front_focus - front_focal, rear_focus - focal)


def paraxial_image(
    matrix: np.ndarray, object_distance: float, index: float = 1.0, index_image: float = 1.0
) -> tuple[float, float]:
    """(image distance [mm] behind the output plane, transverse magnification) of a plane before the input plane.

    object_distance [mm]: > 0 a real object before the system. Negative image distance: virtual image; negative
    magnification: inverted. ValueError for an object in the front focal plane, whose image is at infinity.
    """
    (a, b), (c, d) = np.asarray(matrix, dtype=np.float64)
    reduced = object_distance / index
    angle = c * reduced + d
    if abs(angle) <= 1e-12 * (abs(c * reduced) + abs(d)):
        raise ValueError(f"object_distance {object_distance} mm is the front focal plane: its image is at infinity")
    # The determinant of 1 makes A + C s'/n' equal to 1/(C s/n + D).
    return float(-index_image * (a * reduced + b) / angle), float(1 / angle)


def entrance_pupil(before_stop: np.ndarray, stop_radius: float, index: float = 1.0) -> tuple[float, float]:
    """(position [mm] behind the input plane, radius [mm]) of the stop's image in object space.

    before_stop: `system_matrix` from the input plane to the stop. (inf, inf): telecentric in object space.
    """
    (a, b), _ = np.asarray(before_stop, dtype=np.float64)
    return (float(index * b / a), abs(stop_radius / a)) if a != 0 else (np.inf, np.inf)


def exit_pupil(behind_stop: np.ndarray, stop_radius: float, index_image: float = 1.0) -> tuple[float, float]:
    """(position [mm] behind the output plane, radius [mm]) of the stop's image in image space.

    behind_stop: `system_matrix` from the stop to the output plane. (inf, inf): telecentric in image space.
    """
    (_, b), (_, d) = np.asarray(behind_stop, dtype=np.float64)
    return (float(-index_image * b / d), abs(stop_radius / d)) if d != 0 else (np.inf, np.inf)
