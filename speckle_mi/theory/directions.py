"""Directions, axes and sizes as the closed forms take them, checked."""

from __future__ import annotations

import numpy as np

from ..errors import InputError

UNIT_TOLERANCE = 1e-6
"""How far the length of a direction, or a right angle, may be off [1]; scene files give about seven digits."""

GRAZING_COSINE = 1e-9
"""Cosine to a surface normal [1] below which light counts as travelling along the surface."""


def across_direction(direction: np.ndarray) -> np.ndarray:
    """(3, 3) projection 1 - l l^T on the plane across a unit vector."""
    return np.eye(3) - np.outer(direction, direction)


def wave_curvature(wavefront_radius: float) -> float:
    """1/L_S [1/mm]; 0 for a collimated beam."""
    radius = float(wavefront_radius)
    if radius == 0 or np.isnan(radius):
        raise ValueError(f"wavefront_radius = {radius} mm: must not be 0 (+ diverging, - converging, inf collimated)")
    return 1 / radius


def wave_hessian(wavefront_radius: float | np.ndarray, to_laser: np.ndarray) -> np.ndarray:
    """(3, 3) second derivatives [1/mm] of the path of light that comes from along a unit vector: Q_S = (1 - l l^T)/L_S.

    wavefront_radius: L_S [mm], or the matrix itself (`astigmatic_wave`), of which the part across the light counts.
    """
    across = across_direction(to_laser)
    if np.ndim(wavefront_radius) == 0:
        return wave_curvature(wavefront_radius) * across
    matrix = np.asarray(wavefront_radius, dtype=np.float64)
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)) or not np.allclose(matrix, matrix.T):
        raise ValueError(
            f"wavefront_radius {text(matrix)}: must be a radius [mm] or a symmetric (3, 3) matrix of finite curvatures"
        )
    return across @ matrix @ across


def astigmatic_wave(wavefront_radii: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(3, 3) second derivatives a_1 a_1^T/R_1 + a_2 a_2^T/R_2 [1/mm] of the path of an astigmatic wave.

    wavefront_radii: (2,) signed radii of curvature [mm]; axes: (2, 3) orthonormal principal directions a in the wave.
    Stands for ``wavefront_radius`` wherever a displacement is asked for.
    """
    axes = beam_axes(axes)
    return sum(wave_curvature(radius) * np.outer(a, a) for radius, a in zip(wavefront_radii, axes, strict=True))


def beam_axes(axes: np.ndarray) -> np.ndarray:
    """(2, 3) orthonormal rows, the principal directions of a beam, checked."""
    axes = np.asarray(axes, dtype=np.float64)
    if axes.shape != (2, 3) or not np.allclose(axes @ axes.T, np.eye(2), atol=UNIT_TOLERANCE):
        raise ValueError(f"axes {text(axes)}: must be (2, 3), two orthonormal directions across the beam")
    return axes


def require_positive(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name} = {value}: must be positive")
    return float(value)


def require_lit(to_laser: np.ndarray, normal: np.ndarray) -> None:
    """ValueError where light along a unit vector (3,) grazes the surface of unit ``normal`` (3,)."""
    if abs(to_laser @ normal) < GRAZING_COSINE:
        raise InputError(f"grazing illumination: source_direction {text(to_laser)} lies in the surface, must leave it")


def unit(name: str, vector: np.ndarray) -> np.ndarray:
    vector = np.asarray(vector, dtype=np.float64)
    length = np.linalg.norm(vector) if vector.shape == (3,) else np.nan
    if not abs(length - 1) <= UNIT_TOLERANCE:
        raise ValueError(f"{name} {text(vector)}: must be a unit vector of 3 components, its length is {length:.6g}")
    return vector / length


def detector_axes(u: np.ndarray, v: np.ndarray, name_u: str = "u", name_v: str = "v") -> np.ndarray:
    """(3, 2) columns u, v."""
    u, v = unit(name_u, u), unit(name_v, v)
    if abs(u @ v) > UNIT_TOLERANCE:
        raise ValueError(f"{name_u} {text(u)}, {name_v} {text(v)}: must be at right angles, have cosine {u @ v:.3g}")
    return np.column_stack([u, v])


def frame_axes(axes: np.ndarray) -> np.ndarray:
    axes = np.asarray(axes, dtype=np.float64)
    if axes.shape != (3, 3) or not np.allclose(axes.T @ axes, np.eye(3), atol=UNIT_TOLERANCE):
        raise ValueError(f"axes {text(axes)}: must be (3, 3) with orthonormal columns, the target's x, y, z")
    return axes


def text(array: np.ndarray) -> str:
    return np.array2string(np.asarray(array, dtype=np.float64), precision=6, separator=", ").replace("\n", "")
