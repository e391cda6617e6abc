"""Rotations and vectors across a direction. Angles are radians."""

from __future__ import annotations

import numpy as np


def rotation_matrix(rotation_vector: np.ndarray) -> np.ndarray:
    """Exact rotation about ``rotation_vector`` (3,) [rad] by its length (Rodrigues' formula), (3, 3)."""
    vector = np.asarray(rotation_vector, dtype=np.float64)
    angle = float(np.linalg.norm(vector))
    cross = cross_matrix(vector)
    # sin(a)/a and (1 - cos(a))/a^2 by sinc, which keep full precision down to a = 0.
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half * half * (cross @ cross)


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """(3, 3) matrix that multiplies by ``vector`` (3,) from the left: vector x."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def vectors_across(direction: np.ndarray) -> np.ndarray:
    """(2, 3) orthonormal rows that span the plane across the unit vector ``direction`` (3,)."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(direction, first)])
