"""What a sensor resolves: the scatter of its shifts against what each pair of images states of it, and the smallest
displacement that can be told from none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from .sensitivity import CONFIDENCE

QUANTILE = float(special.ndtri(0.5 + CONFIDENCE / 2))
"""Standard uncertainties that a shift must exceed to be told from zero, with 95 % confidence."""


@dataclass(frozen=True)
class Resolution:
    """Of the shifts along one axis that one motion causes. NaN where it is not known.

    scatter_um: rms over displacements of the standard deviation over surfaces; predicted_um: of the standard
    uncertainties that the images state; noise_um: standard uncertainty of a shift at no displacement, by the camera and
    the registration; per_displacement: its growth with the displacement, as the pattern decorrelates [mm/mm or mm/deg];
    smallest: displacement whose shift is ``QUANTILE`` times its own standard uncertainty, 0 where nothing but
    decorrelation disturbs it, inf where no shift is so clear [mm or deg].
    """

    scatter_um: float
    predicted_um: float
    noise_um: float
    per_displacement: float
    smallest: float


def resolution_of(displacements: np.ndarray, shifts: np.ndarray, sigma: np.ndarray, sensitivity: float) -> Resolution:
    """The resolution along an axis from the shifts of several surfaces.

    displacements: (n,) [mm or deg]; shifts, sigma: (surfaces, n) shifts and their stated standard uncertainties [um],
    NaN where not measured; sensitivity: [mm/mm or mm/deg]. The variance at a displacement d is taken as the larger of
    what surfaces show and what images state, and fitted by noise^2 + (growth d)^2, so that
    smallest = q noise/sqrt(S^2 - q^2 growth^2).
    """
    measured = np.isfinite(shifts) & np.isfinite(sigma)
    moved = (displacements != 0) & measured.any(axis=0)
    count = measured[:, moved].sum(axis=0)
    if not count.size:
        return Resolution(*(float("nan"),) * 5)
    values, there = np.where(measured, shifts, 0.0)[:, moved], measured[:, moved]
    stated = np.where(measured, np.square(sigma), 0.0)[:, moved].sum(axis=0) / count
    mean = values.sum(axis=0) / count
    spread = np.where(there, values - mean, 0.0)
    shown = np.where(count > 1, np.square(spread).sum(axis=0) / np.maximum(count - 1, 1), np.nan)
    noise, growth = _line(np.square(displacements[moved]), np.fmax(shown, stated), stated)
    slope = 1e-6 * (1e6 * sensitivity**2 - QUANTILE**2 * growth)  # squares of mm, growth of um, per unit
    noise_um, smallest = float(np.sqrt(noise)), float("inf")
    if slope > 0.0:
        smallest = 1e-3 * QUANTILE * noise_um / float(np.sqrt(slope))
    several = count > 1
    return Resolution(
        scatter_um=float(np.sqrt(shown[several].mean())) if several.any() else float("nan"),
        predicted_um=float(np.sqrt(stated.mean())),
        noise_um=noise_um,
        per_displacement=1e-3 * float(np.sqrt(growth)),
        smallest=smallest if np.isfinite(sensitivity) else float("nan"),
    )


def _line(squares: np.ndarray, variance: np.ndarray, stated: np.ndarray) -> tuple[float, float]:
    """Intercept and slope, neither negative, of variances against squared displacements.

    Their relative precision is the same for all: weighted by the ``stated`` ones, which scatter less.
    """
    if not (scale := float(variance.max())) > 0.0:
        return 0.0, 0.0
    weight = np.square(scale / np.maximum(stated, 1e-9 * scale))
    total, first, second = weight.sum(), (weight * squares).sum(), (weight * squares**2).sum()
    product, mean = (weight * variance * squares).sum(), (weight * variance).sum()
    determinant = total * second - first**2
    if determinant > 1e-12 * total * second:
        slope, level = (total * product - first * mean) / determinant, (second * mean - first * product) / determinant
        if slope >= 0.0 and level >= 0.0:
            return float(level), float(slope)
        if level < 0.0:
            return 0.0, float(product / second)
    return float(mean / total), 0.0
