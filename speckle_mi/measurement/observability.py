"""What detectors can tell apart: motions from shifts, how well each is known, and which motion is not seen at all.

Shifts s of d detectors, two each, belong to a motion q by s = J q, J (2d, k) the sensitivities of one below the other.
Motions have different units, so J is looked at per a displacement that the user names for each: J D, D diagonal. Its
singular values are shifts [mm] for combinations of motions of that size; their ratio is the condition number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError

UNSEEN = 1e-3
"""Singular value relative to the largest below which a combination of motions is not seen."""

TOUCHED = 1e-2
"""Share of a motion in what is not seen from which it is not known itself."""

_ITERATIONS = 4
"""Of the weights: scatter grows with the motion that is looked for."""


@dataclass(frozen=True)
class Observability:
    """singular_values: (k,) [mm], largest first; condition: their ratio, inf where something is not seen; seen: (r, k)
    and unseen: (k - r, k) combinations of motions, unit vectors in units of ``scale``, (k,) [mm or deg]."""

    singular_values: np.ndarray
    condition: float
    seen: np.ndarray
    unseen: np.ndarray
    scale: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """(k,) whether each motion can be told from all others."""
        return np.all(np.abs(self.unseen) < TOUCHED, axis=0)


def observability(matrix: np.ndarray, scale: np.ndarray) -> Observability:
    """Of sensitivities (2d, k) [mm/mm, mm/deg] for motions of the size ``scale`` (k,) [mm, deg]."""
    matrix, scale = np.asarray(matrix, np.float64), np.asarray(scale, np.float64)
    if matrix.ndim != 2 or scale.shape != matrix.shape[1:] or not np.all(np.isfinite(matrix)) or not np.all(scale > 0):
        raise ValueError(f"matrix {matrix.shape} and scale {scale.shape}: must be (2d, k) finite and (k,) above 0")
    _, found, rows = np.linalg.svd(matrix * scale, full_matrices=True)
    values = np.zeros(len(scale))
    values[: len(found)] = found
    is_seen = values > UNSEEN * max(values[0], 1e-300)
    condition = float(values[0] / values[-1]) if np.all(is_seen) else np.inf
    return Observability(values, condition, rows[is_seen], rows[~is_seen], scale)


@dataclass(frozen=True)
class MotionEstimate:
    """motion: (k,) [mm or deg] and covariance: (k, k) of it; NaN for a motion that cannot be told from others;
    misfit: sum of squares of what the shifts leave over their uncertainty, and freedom: its degrees of freedom."""

    motion: np.ndarray
    covariance: np.ndarray
    misfit: float
    freedom: int


def estimated_motion(
    matrix: np.ndarray, scatter: np.ndarray, shifts: np.ndarray, sigma: np.ndarray, scale: np.ndarray
) -> MotionEstimate:
    """The motion that shifts tell of, by weighted least squares.

    matrix: (2d, k) sensitivities [mm/mm, mm/deg]; scatter: (2d, k) by which those of one surface differ; shifts: (2d,)
    and sigma: (2d,) their standard uncertainty [mm]; scale: (k,) as in :func:`observability`. A shift's variance is
    sigma^2 + sum over motions of (scatter q)^2. What is not seen is taken to be 0 and reported as not known.
    Raises InputError where shifts are not measured.
    """
    if not (np.all(np.isfinite(shifts)) and np.all(np.isfinite(sigma)) and np.all(sigma >= 0)):
        raise InputError("shifts: each must be a number with an uncertainty of at least 0")
    seen = observability(matrix, scale)
    reduced = (matrix * scale) @ seen.seen.T
    motion = np.zeros(len(scale))
    for _ in range(_ITERATIONS):
        variance = sigma**2 + (scatter**2) @ motion**2
        # Shifts without any stated uncertainty count alike.
        weight = 1 / np.sqrt(np.maximum(variance, 1e-12 * max(variance.max(), 1e-300))) if variance.any() else (
            np.ones(len(sigma))
        )
        solution, *_ = np.linalg.lstsq(reduced * weight[:, None], shifts * weight, rcond=None)
        motion = scale * (seen.seen.T @ solution)
    normal = reduced * weight[:, None]
    spread = np.linalg.pinv(normal.T @ normal)
    covariance = scale[:, None] * (seen.seen.T @ spread @ seen.seen) * scale
    left = (shifts - reduced @ solution) * weight
    unknown = ~seen.known
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan
    return MotionEstimate(
        np.where(unknown, np.nan, motion), covariance, float(left @ left), max(len(shifts) - len(seen.seen), 0)
    )
