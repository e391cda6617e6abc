"""How a window of a pattern was moved, turned, scaled and sheared, from one pair of images.

The inverse compositional Gauss-Newton iteration of :mod:`registration` on a group of mappings: steps are elements of
its Lie algebra and are composed, so that a rotation stays one. Images are interpolated by quintic splines, since the
displacement is another at every pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg, ndimage

from .registration import Subset, score_variance

FITS = ("shift", "rotation", "scale", "affine")
"""What can be fitted: the shift; with the rotation; with rotation and scale; with all of the first-order strain."""

ITERATIONS, CONVERGED = 50, 1e-5
"""Most steps, and the step that is the last [px at the window's corner]."""

FARTHEST = 1.0
"""Share of the margin by which a corner may move against the start."""

_SHIFTS = [np.array(m, dtype=float) for m in ([[0, 0, 1], [0, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 1], [0, 0, 0]])]
_TURN = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0]], dtype=float)
_SCALE = np.diag([1.0, 1.0, 0.0])
_ENTRIES = [np.pad(np.eye(4)[i].reshape(2, 2), ((0, 1), (0, 1))) for i in range(4)]
_GENERATORS = {
    "shift": _SHIFTS,
    "rotation": [*_SHIFTS, _TURN],
    "scale": [*_SHIFTS, _TURN, _SCALE],
    "affine": [*_SHIFTS, *_ENTRIES],
}


@dataclass(frozen=True)
class Deformation:
    """How a window was deformed. Coordinates (u, v) from its middle; u along columns, v along rows.

    shift: (u, v) [px] of the middle; rotation [rad], from u toward v; strain: (uu, vv, uv) [1], the stretch that
    precedes the rotation, less one. sigma_*: standard uncertainties, 0 for what was not fitted. correlation: of the two
    windows after the mapping.
    """

    shift: tuple[float, float]
    sigma_shift: tuple[float, float]
    rotation: float
    sigma_rotation: float
    strain: tuple[float, float, float]
    sigma_strain: tuple[float, float, float]
    correlation: float


def fit_deformation(
    subset: Subset, moved: np.ndarray, displacement: tuple[int, int], start: np.ndarray, fit: str
) -> Deformation | None:
    """Mapping of a window onto a moved pattern (rows, columns), from a start near it; None where there is none.

    displacement: whole (v, u) [px]; start: (3, 3) mapping of (u, v, 1) from the window's middle on top of that.
    """
    generators = _GENERATORS[fit]
    rows, columns = subset.window
    v, u = (np.arange(n) - (n - 1) / 2 for n in subset.window)
    u, v = np.meshgrid(u, v)
    places = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    coefficients = ndimage.spline_filter(subset.filtered(moved, displacement), 5, mode="mirror")
    middle = np.array([m + (w - 1) / 2 for m, w in zip(subset.margin[::-1], subset.window[::-1])])
    gradient_v, gradient_u = subset.gradients
    gradients = []
    for generator in generators:
        along_u, along_v, _ = (row.reshape(rows, columns) for row in generator @ places)
        gradients.append(subset.along(gradient_u * along_u + gradient_v * along_v))
    matrix = np.array([[float(np.sum(a * b)) for b in gradients] for a in gradients])
    if not np.linalg.cond(matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))) < 1e8:
        return None
    inverse = np.linalg.inv(matrix)
    corner = np.array([1.0, 1.0] + [max(rows, columns) / 2] * (len(generators) - 2))
    mapping = start.astype(float)
    for _ in range(ITERATIONS):
        at_u, at_v = (mapping @ places)[:2] + middle[:, None]
        values = ndimage.map_coordinates(coefficients, [at_v, at_u], order=5, mode="mirror", prefilter=False)
        values = subset.centred(values.reshape(rows, columns))
        energy, product = float(np.sum(values**2)), float(np.sum(values * subset.values))
        if product <= 0.0:
            return None
        residual = (product / energy) * values - subset.values
        step = inverse @ [float(np.sum(g * residual)) for g in gradients]
        mapping = mapping @ linalg.expm(-sum(s * g for s, g in zip(step, generators)))
        if not np.abs((mapping - start)[:2] @ [columns / 2, rows / 2, 1]).max() < FARTHEST * max(subset.margin):
            return None
        if np.abs(step * corner).max() < CONVERGED:
            break
    unshared = (product / energy) * (values - (product / subset.energy) * subset.values)
    # What both images share sets the slope; the gradients hold the reference's noise besides.
    slope = inverse * (energy * subset.energy / product**2)
    covariance = slope @ score_variance(gradients, unshared, subset.reach) @ slope.T
    return _described(mapping, displacement, covariance, generators, product / math.sqrt(energy * subset.energy))


def _described(
    mapping: np.ndarray, displacement: tuple[int, int], covariance: np.ndarray, generators: list, correlation: float
) -> Deformation:
    linear = mapping[:2, :2]
    rotation = math.atan2(linear[1, 0] - linear[0, 1], linear[0, 0] + linear[1, 1])
    cosine, sine = math.cos(rotation), math.sin(rotation)
    stretch = np.array([[cosine, sine], [-sine, cosine]]) @ linear - np.eye(2)
    # A small step G acts before the mapping: strain and rotation by their first order in it.
    readings = [
        [g[0, 2], g[1, 2], (g[1, 0] - g[0, 1]) / 2, g[0, 0], g[1, 1], (g[0, 1] + g[1, 0]) / 2] for g in generators
    ]
    readings = np.array(readings).T
    sigma = np.sqrt(np.maximum(np.diag(readings @ covariance @ readings.T), 0.0))
    return Deformation(
        (float(mapping[0, 2] + displacement[1]), float(mapping[1, 2] + displacement[0])),
        (float(sigma[0]), float(sigma[1])),
        rotation,
        float(sigma[2]),
        (float(stretch[0, 0]), float(stretch[1, 1]), float((stretch[0, 1] + stretch[1, 0]) / 2)),
        tuple(map(float, sigma[3:])),
        min(float(correlation), 1.0),
    )
