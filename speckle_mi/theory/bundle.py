"""Displacement of a speckle pattern from the rays that meet where it is looked at: any optics, any surface.

Light comes to a place D of the detector by many rays, each from another point P of the lit surface. Let V(P, D) be the
optical path, and psi(P) that of the light from the laser. A motion of the target moves P by a(P) and changes the path
of its ray by (grad psi + grad_P V).a(P); a step S of the place changes it by grad_D V.S. The pattern at D reappears at
D + S where both changes leave the rays' phases as they are to one another: a constant is of no account. So S minimises

    the variance over the rays of    (grad psi + grad_P V).a + S.grad_D V,

every ray counted by the light that it brings. For circular Gaussian light that is the mean of the velocity which fits
the change of intensity best. Where the rays differ by their place on the surface, as in free space, the variance can
vanish: then for every direction s in the surface

    s.[V_PD S + d/dP((grad psi + grad_P V).a)] = 0,

which is I. Yamaguchi's condition (Optica Acta 28, 1359-1376 (1981), doi:10.1080/713820454) for a point characteristic.
In focus V is no function of P and D, but its rays still are: they differ by their place in the pupil. What is left of
the variance is the pattern's boiling.
"""

from __future__ import annotations

import numpy as np


def bundle_displacement(
    slopes: np.ndarray, changes: np.ndarray, weights: np.ndarray, places: np.ndarray | None = None
) -> np.ndarray | None:
    """Displacement of the pattern per unit of k motions, from the rays that meet at each of m places of the detector.

    slopes: (m, n, 2) grad_D V along the detector's u and v of n rays a place, index times direction cosines;
    changes: (m, n, k) path changes (grad psi + grad_P V).a of each motion [mm/unit]; weights: (m, n) power of the rays,
    0 for none; places: (m, 2) along u and v from the detector's middle [mm], with three or more of which the
    displacement may change linearly over the detector: it is that of the middle.

    Every place counts by the square of its intensity, as in a fit to the change of intensity. Returns (2, k) [mm/unit],
    None where no light comes or all of it comes by one ray, so that there is no pattern.
    """
    power = weights.sum(axis=1)
    lit = power > 0
    if not np.any(lit):
        return None
    share = weights[lit] / power[lit, None]
    slopes, changes = (_less_mean(values[lit], share) for values in (slopes, changes))
    by_slopes = np.einsum("mn,mni,mnj->mij", share, slopes, slopes)
    by_changes = np.einsum("mn,mni,mnk->mik", share, slopes, changes)
    return displacement_of_covariances(by_slopes, by_changes, power[lit], None if places is None else places[lit])


def displacement_of_covariances(
    by_slopes: np.ndarray, by_changes: np.ndarray, power: np.ndarray, places: np.ndarray | None = None
) -> np.ndarray | None:
    """The same from what :func:`bundle_displacement` takes of the rays that meet at m places.

    by_slopes: (m, 2, 2) covariance of the slopes; by_changes: (m, 2, k) of slopes and changes; power: (m,), above 0.
    """
    importance, count = power**2 / np.sum(power**2), len(power)
    powers = np.ones((count, 1))
    if places is not None and count >= 3:
        scale = max(float(np.abs(places).max()), 1e-300)
        powers = np.column_stack([powers, places / scale])
    size = powers.shape[1]
    normal = np.einsum("m,mij,ma,mb->iajb", importance, by_slopes, powers, powers).reshape(2 * size, 2 * size)
    if not np.trace(normal) > 0:
        return None
    right = np.einsum("m,mik,ma->iak", importance, by_changes, powers).reshape(2 * size, -1)
    return -(np.linalg.pinv(normal, hermitian=True) @ right)[[0, size]]


def _less_mean(values: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Values (m, n, k) less their mean over the rays of each place."""
    return values - np.einsum("mn,mnk->mk", share, values)[:, None]
