"""Closed forms of a pattern's statistics: contrast, size, coherence, and the scatter of a measured shift."""

from __future__ import annotations

import numpy as np

from ..geometry.rotation import vectors_across
from .directions import across_direction, beam_axes, detector_axes, require_lit, require_positive, unit


# Statistics of the pattern.


def contrast_of_equal_phasors(count: np.ndarray | int) -> np.ndarray:
    """Contrast sqrt(1 - 1/N) of the intensity of N >= 1 equal phasors of random phase [3]."""
    count = np.asarray(count, dtype=np.float64)
    if not np.all(count >= 1):
        raise ValueError(f"number of phasors {count}: must be 1 or more")
    return np.sqrt(1 - 1 / count)


def intensity_pdf(intensity: np.ndarray, mean: float = 1.0) -> np.ndarray:
    """Probability density exp(-I/<I>)/<I> of fully developed, polarised speckle; 0 below I = 0 [3]."""
    mean = require_positive("mean", mean)
    intensity = np.asarray(intensity, dtype=np.float64)
    return np.where(intensity >= 0, np.exp(-np.maximum(intensity, 0) / mean) / mean, 0.0)


def coherence_gaussian_beam(
    separation: np.ndarray | float, beam_radius: float, wavelength: float, distance: float
) -> np.ndarray:
    """|mu|^2 = exp[-(pi w r/(lambda z))^2] of points r [mm] apart at z [mm] from a spot of 1/e^2 radius w [mm].

    Beam, detector and target all face one another; `speckle_shape_gaussian_beam` is the formula for any tilt. [3]
    """
    blur = require_positive("wavelength", wavelength) * require_positive("distance", distance)
    scale = np.pi * require_positive("beam_radius", beam_radius) / blur
    return np.exp(-((scale * np.asarray(separation, dtype=np.float64)) ** 2))


def speckle_shape_gaussian_beam(
    beam_radius: float | np.ndarray,
    wavelength: float,
    spot: np.ndarray,
    normal: np.ndarray,
    source_direction: np.ndarray,
    detector_centre: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    axes: np.ndarray | None = None,
) -> np.ndarray:
    """(2, 2) matrix K [1/mm^2] of a speckle: |mu|^2 = exp(-d^T K d) for detector points d = (du, dv) [mm] apart.

    Any tilt of beam, target and detector. The path from a surface point p [mm, from the spot] to the two points
    differs by p . g, g = t Q_O T d; the footprint on the surface is Gaussian with exp(-2 p^T F^-1 p),
    F = w^2 (t (1 - l_S l_S^T) t^T)^-1; then |mu|^2 = exp[-(pi/lambda)^2 g^T F g] [3]. Of an elliptical beam beam_radius
    is (2,) along its ``axes`` (2, 3), orthonormal directions a across it, and F the inverse of
    t (a_x a_x^T/w_x^2 + a_y a_y^T/w_y^2) t^T. The curvature of the light's wavefront has no part in it.
    Raises ValueError for grazing light or a detector at the spot.
    """
    sight = np.asarray(detector_centre, dtype=np.float64) - np.asarray(spot, dtype=np.float64)
    distance = require_positive("detector distance", float(np.linalg.norm(sight)))
    to_laser, normal = unit("source_direction", source_direction), unit("normal", normal)
    require_lit(to_laser, normal)
    tangents = vectors_across(normal)
    if axes is None:
        inverse_square = across_direction(to_laser) / require_positive("beam_radius", beam_radius) ** 2
    else:
        scaled = beam_axes(axes) / np.array([[require_positive("beam_radius", radius)] for radius in beam_radius])
        inverse_square = scaled.T @ scaled
    footprint = np.linalg.inv(tangents @ inverse_square @ tangents.T)
    gradient = tangents @ across_direction(sight / distance) @ detector_axes(u, v) / distance
    return (np.pi / require_positive("wavelength", wavelength)) ** 2 * gradient.T @ footprint @ gradient


def speckle_size_gaussian_beam(
    beam_radius: float | np.ndarray,
    wavelength: float,
    spot: np.ndarray,
    normal: np.ndarray,
    source_direction: np.ndarray,
    detector_centre: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    axes: np.ndarray | None = None,
) -> np.ndarray:
    """(2,) full width at half maximum of |mu|^2 in cuts along u and along v [mm]; see `speckle_shape_gaussian_beam`.

    Everything along the normal: 2 sqrt(ln 2) lambda z/(pi w). inf along a direction in which the light grazes.
    """
    shape = speckle_shape_gaussian_beam(
        beam_radius, wavelength, spot, normal, source_direction, detector_centre, u, v, axes
    )
    with np.errstate(divide="ignore"):
        return 2 * np.sqrt(np.log(2) / np.diag(shape))


def coherence_gaussian_line(
    path_difference: np.ndarray | float, wavelength: float, linewidth: float
) -> np.ndarray:
    """Degree of coherence |gamma| = exp(-(pi dL dlambda/lambda^2)^2/(4 ln 2)) of light whose spectrum is a Gaussian.

    path_difference: dL [mm]; wavelength: lambda [mm]; linewidth: full width at half maximum dlambda [mm]. It is the
    visibility of the fringes of two equal waves. The contrast of speckle is the root of the mean of |gamma|^2 over the
    differences of all pairs of paths. [3]
    """
    width = np.pi * require_positive("linewidth", linewidth) / require_positive("wavelength", wavelength) ** 2
    return np.exp(-((width * np.asarray(path_difference, dtype=np.float64)) ** 2) / (4 * np.log(2)))


def contrast_of_incoherent_patterns(weights: np.ndarray) -> float:
    """Contrast sqrt(sum w^2)/sum w of the sum of independent developed patterns of mean intensities w [3].

    1/sqrt(N) of N equal ones.
    """
    weights = np.asarray(weights, dtype=np.float64)
    if weights.ndim != 1 or not np.all(weights >= 0) or not weights.sum() > 0:
        raise ValueError(f"weights {weights}: must be mean intensities, none negative and not all 0")
    return float(np.sqrt(np.sum(weights**2)) / weights.sum())


def shift_scatter(
    speckle_size_px: float, window_px: float, correlation: np.ndarray | float, factor: float = 0.6
) -> np.ndarray:
    """Standard deviation [px] of the measured shift of a pattern: K (s^2/n) sqrt((1 - c)/c).

    speckle_size_px: s; window_px: side n of the correlation window; correlation: peak c, inf from c <= 0;
    factor: K, about 0.6 for a Gaussian peak fit.
    """
    correlation = np.asarray(correlation, dtype=np.float64)
    lost = np.where(correlation > 0, (1 - correlation) / np.where(correlation > 0, correlation, 1.0), np.inf)
    scale = (
        factor * require_positive("speckle_size_px", speckle_size_px) ** 2 / require_positive("window_px", window_px)
    )
    return scale * np.sqrt(np.maximum(lost, 0.0))
