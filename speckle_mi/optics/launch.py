"""Launch directions: frames across them, small turns, and the Newton step that brings a ray to where it is aimed."""

from __future__ import annotations

import numpy as np

from .surface import dot

MAXIMUM_STEP = 0.3
"""Largest change of the launch direction [rad] in one Newton step."""


def launch_state(source: np.ndarray, direction: np.ndarray, e1: np.ndarray, e2: np.ndarray) -> np.ndarray:
    """Rays with tangents along two orthonormal launch angles: their Jacobian is per solid angle."""
    zero = np.zeros_like(source)
    return np.stack([source, direction, zero, zero, e1, e2], axis=1)


def transverse(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3, n) that make an orthonormal frame with unit ``direction`` (3, n).

    T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
    """
    x, y, z = direction
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x]), np.stack([b, sign + y * y * a, -y])


def turned(direction: np.ndarray, e1: np.ndarray, e2: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """``direction`` (3, n) turned by small ``angles`` (2, n) towards e1, e2; unit."""
    with np.errstate(invalid="ignore", over="ignore"):  # of rays that are lost
        turned = direction + angles[0] * e1 + angles[1] * e2
        return turned / np.sqrt(dot(turned, turned))


def newton_step(first: np.ndarray, second: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Newton step (2, n) [rad], at most ``MAXIMUM_STEP`` long; ``first``, ``second`` (2, n): the Jacobian's columns."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        determinant = first[0] * second[1] - first[1] * second[0]
        step = np.stack(
            [residual[0] * second[1] - residual[1] * second[0], first[0] * residual[1] - first[1] * residual[0]]
        )
        step /= determinant
        # On a caustic the Jacobian is singular: no step, rather than a meaningless one.
        step = np.where(np.isfinite(step), step, 0.0)
        norm = np.hypot(*step)
        return np.where(norm > MAXIMUM_STEP, step * (MAXIMUM_STEP / norm), step)
