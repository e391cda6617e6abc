"""How fast a pattern moves and boils, from one frame and its derivatives.

As the target moves by dq, the intensity at a point changes by dI = 2 Re(E* dE) per unit, part of it because the pattern
moves: where it moves by S per unit unchanged, dI = -S . grad I. S minimises the mean of (dI + S . grad I)^2; what is
left is the pattern's boiling. To second order the intensity's correlation after the shift is

    c(q) = 1 - kappa q^2,    kappa = <boiling^2> / (2 Var I),

so that of a Gaussian law exp(-kappa q^2) half is left after sqrt(ln 2/kappa). For a fully developed pattern the field,
its derivative and its gradient are jointly Gaussian; then S is unbiased: boiling is uncorrelated with grad I.

Lengths are mm, motions mm or rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError

SPECKLES = (0.0, 40.0, 150.0)
"""Speckles from which the velocity may change over the detector as a polynomial of degree 0, 1, 2."""

BLOCK = 5.0
"""Side of the squares [speckle radii] whose contributions to the estimate are taken to be independent."""

FEWEST_BLOCKS = 8
"""Squares from which their spread tells an interval."""


@dataclass(frozen=True)
class PatternVelocity:
    """Velocities of one pattern for k motions.

    value: (k, 2) S along u, v in the middle of the detector [mm per unit]; covariance: (k, 2, 2) of it, NaN where the
    pattern holds too few speckles to tell; blocks: how many independent parts that rests on; boiling: (k,) share of the
    mean square of dI that is not motion; curvature: (k,) kappa [1/unit^2]; degree: of the velocity over the detector.
    """

    value: np.ndarray
    covariance: np.ndarray
    blocks: int
    boiling: np.ndarray
    curvature: np.ndarray
    degree: int


@dataclass(frozen=True)
class Flow:
    """Intensities on m places of a detector, their slopes and their changes, relative to the mean intensity.

    intensity: (m,); slopes: (2, m) along u and v [1/mm]; change: (k, m) by k motions [1/unit]; places: (m, 2) along u
    and v from the middle of the detector [mm].
    """

    intensity: np.ndarray
    slopes: np.ndarray
    change: np.ndarray
    places: np.ndarray

    @classmethod
    def of(cls, field: np.ndarray, by_motion: np.ndarray, along: np.ndarray, places: np.ndarray) -> Flow:
        """From the field (m,) and its derivatives by k motions (k, m) and along u and v (2, m) [1/mm], complex.

        places: (m, 2), spread evenly over the detector. Of several fields that do not interfere, whose intensities add
        up, each array has them along its first axis. Raises InputError where all are dark.
        """
        field = np.atleast_2d(field)
        by_motion, along = (values.reshape(len(field), -1, field.shape[1]) for values in (by_motion, along))
        intensity = np.sum(np.abs(field) ** 2, axis=0)
        mean = float(intensity.mean())
        if not mean > 0:
            raise InputError("no light reaches the detector: a dark pattern has no velocity")
        slopes, change = (
            2 / mean * np.sum((field.conj()[:, None] * values).real, axis=0) for values in (along, by_motion)
        )
        return cls(intensity / mean, slopes, change, np.asarray(places, dtype=np.float64))

    @property
    def radius(self) -> np.ndarray:
        """Radius (2,) of a speckle along u and v [mm], where |mu|^2 has fallen to 1/e: sigma^-1.

        <(dI/du)^2> = 2 <I>^2 sigma^2 with |mu|^2 = exp(-sigma^2 u^2).
        """
        return np.sqrt(2 / np.maximum(np.mean(self.slopes**2, axis=1), 1e-300))

    def speckles(self, area: float) -> float:
        """About how many speckles a detector of ``area`` [mm^2] holds."""
        return float(area / (np.pi * np.prod(self.radius)))

    def velocity(self, degree: int) -> PatternVelocity:
        """Velocity of the pattern, which may change over the detector as a polynomial of a degree of 0, 1 or 2.

        It does where the pattern turns or spreads (1) and where the detector is seen under a large angle (2). The
        covariance is that of a sum of independent parts: squares of ``BLOCK`` speckle radii.
        """
        x, y = (self.places / np.abs(self.places).max()).T
        powers = [np.ones_like(x), x, y, x * x, x * y, y * y][: (1, 3, 6)[degree]]
        moving = [power * slope for slope in self.slopes for power in powers]
        # A change of brightness, of all or in proportion, moves no feature.
        terms = np.stack([*moving, self.intensity, np.ones_like(x)])
        normal = np.linalg.pinv(terms @ terms.T, hermitian=True)
        fitted = self.change @ terms.T @ normal
        left = self.change - fitted @ terms
        middle = [0, len(powers)]
        blocks, covariance = _covariance(terms, left, normal, self.places, BLOCK * self.radius)
        lost = np.mean(left**2, axis=1)
        return PatternVelocity(
            value=-fitted[:, middle],
            covariance=covariance[:, middle][:, :, middle],
            blocks=blocks,
            boiling=lost / np.maximum(np.mean(self.change**2, axis=1), 1e-300),
            curvature=lost / (2 * float(np.var(self.intensity))),
            degree=degree,
        )


def _covariance(
    terms: np.ndarray, left: np.ndarray, normal: np.ndarray, places: np.ndarray, side: np.ndarray
) -> tuple[int, np.ndarray]:
    """Number of blocks of ``side`` (2,) [mm], and covariance (k, p, p) of coefficients from their independence."""
    cells = np.floor(places / side).astype(np.int64)
    _, block = np.unique(cells, axis=0, return_inverse=True)
    block = block.ravel()
    count = int(block.max()) + 1
    motions, size = len(left), len(terms)
    if count < FEWEST_BLOCKS:
        return count, np.full((motions, size, size), np.nan)
    order = np.argsort(block, kind="stable")
    starts = np.searchsorted(block[order], np.arange(count))
    # What each block adds to the normal equations of each motion, (k, p, blocks).
    pushes = np.add.reduceat((terms * left[:, None])[:, :, order], starts, axis=2)
    influence = normal @ pushes
    return count, influence @ influence.transpose(0, 2, 1) * (count / (count - 1))


def half_correlation(curvature: np.ndarray) -> np.ndarray:
    """Displacement at which a correlation of Gaussian law exp(-curvature q^2) has fallen to one half [unit]."""
    with np.errstate(divide="ignore"):
        return np.sqrt(np.log(2) / np.asarray(curvature, dtype=np.float64))
