"""How soon a pattern is lost: closed forms of the correlation's decay."""

from __future__ import annotations

import numpy as np

from ..geometry.pose import Pose
from .directions import across_direction, beam_axes, frame_axes, require_positive, unit, wave_curvature


# Decorrelation: height of the peak of the intensity correlation, after the shift.


def beam_displacement_of_material(
    pose: Pose, spot: np.ndarray, origin: np.ndarray, axes: np.ndarray, source_direction: np.ndarray
) -> np.ndarray:
    """(3,) displacement [mm, world] across the beam of the material at the spot, by a motion of the target.

    (1 - l_S l_S^T)(P' - P), P' the place to which ``pose`` takes the material point P that lies at the spot; exact
    for finite rotations. Its length is the ``shift_perpendicular`` of `decorrelation_in_plane`.
    """
    axes = frame_axes(axes)
    arm = axes.T @ (np.asarray(spot, dtype=np.float64) - np.asarray(origin, dtype=np.float64))
    moved = axes @ (pose.translation + pose.rotation @ arm - arm)
    return across_direction(unit("source_direction", source_direction)) @ moved


def decorrelation_in_plane(shift_perpendicular: np.ndarray | float, beam_radius: float) -> np.ndarray:
    """Correlation exp(-a^2/w^2) after the material moved by a [mm] across a Gaussian beam of 1/e^2 radius w [mm]."""
    shift = np.asarray(shift_perpendicular, dtype=np.float64)
    return np.exp(-((shift / require_positive("beam_radius", beam_radius)) ** 2))


def decorrelation_elliptical_beam(shift: np.ndarray, beam_radii: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Correlation (n,) exp(-a_x^2/w_x^2 - a_y^2/w_y^2) after the material moved by ``shift`` (n, 3) [mm].

    beam_radii: (2,) 1/e^2 intensity radii [mm] along ``axes`` (2, 3), orthonormal directions across the beam. Its
    amplitude is exp(-p.W p), and the overlap of two such intensities a apart exp(-a.W a), W = diag(1/w^2).
    """
    radii = np.array([require_positive("beam_radii", radius) for radius in beam_radii])
    return np.exp(-np.sum((np.asarray(shift, dtype=np.float64) @ beam_axes(axes).T / radii) ** 2, axis=-1))


def decorrelation_axial(
    motion: np.ndarray | float, beam_radius: float, wavelength: float, detector_distance: float, wavefront_radius: float
) -> np.ndarray:
    """Correlation 1/(1 + b^2) after an axial motion a_z [mm], laser and detector along the normal of the target.

    b = (k w^2 a_z/4)(1/L_O^2 + 1/L_S^2): the paths' curvature changes across the Gaussian spot of radius w. All [mm].
    """
    distance = require_positive("detector_distance", detector_distance)
    curvature = 1 / distance**2 + wave_curvature(wavefront_radius) ** 2
    wavenumber = 2 * np.pi / require_positive("wavelength", wavelength)
    phase = (
        wavenumber * require_positive("beam_radius", beam_radius) ** 2 / 4 * np.asarray(motion, np.float64) * curvature
    )
    return 1 / (1 + phase**2)


def decorrelation_circular_pupil(shift: np.ndarray | float) -> np.ndarray:
    """Correlation {(2/pi)[acos s - s sqrt(1 - s^2)]}^2 when light moves by s diameters across a circular pupil.

    shift: s, pattern motion in the pupil over the pupil's diameter [1], either sign; zero correlation from |s| = 1.
    """
    s = np.minimum(np.abs(np.asarray(shift, dtype=np.float64)), 1.0)
    return (2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))) ** 2
