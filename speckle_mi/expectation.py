"""What first-order theory expects of an assembly: sensitivities along every axis, and decorrelation."""

from __future__ import annotations

import numpy as np

from . import theory
from .assembly import Assembly
from .geometry import DEGREES_OF_FREEDOM, Pose

PATTERN_AXES = ("u", "v", "x", "y")
CENTRE_AXES = ("cog_u", "cog_v")
AXES = (*PATTERN_AXES, *CENTRE_AXES)
"""Axes along which motion of the image is reported: the detector's, the target's, and those of its centre of gravity."""


def on_all_axes(matrix: np.ndarray, assembly: Assembly) -> np.ndarray:
    """Displacements (2, k) along u, v completed by their projection on the target's x, y: (4, k)."""
    grid, frame = assembly.detector, assembly.target.frame
    return np.concatenate([matrix, theory.project_on_target(matrix, grid.u, grid.v, frame.axes)])


def expected_sensitivity(assembly: Assembly) -> dict[str, np.ndarray | None]:
    """Sensitivities (6,) [mm/mm, mm/deg] to the six motions for every axis, None where there is no theory."""
    target, beam, grid = assembly.target, assembly.beam, assembly.detector
    matrix = theory.per_degree(
        theory.first_order_displacement(
            spot=target.spot,
            origin=target.frame.origin,
            axes=target.frame.axes,
            source_direction=-beam.axis,
            wavefront_radius=beam.wavefront_radius,
            detector_centre=grid.centre,
            u=grid.u,
            v=grid.v,
            normal=target.spot_normal,
        )
    )
    expected: dict[str, np.ndarray | None] = dict(zip(PATTERN_AXES, on_all_axes(matrix, assembly), strict=True))
    return expected | dict.fromkeys(CENTRE_AXES)


def expected_correlation(assembly: Assembly, dof: str, displacements: np.ndarray) -> np.ndarray | None:
    """Peak correlation (n,) that the material's motion across the Gaussian beam leaves, None for uniform light."""
    if np.isinf(assembly.beam.radius) or dof not in DEGREES_OF_FREEDOM:
        return None
    target = assembly.target
    across = [
        np.linalg.norm(
            theory.beam_displacement_of_material(
                Pose(**{dof: float(displacement)}), target.spot, target.frame.origin, target.frame.axes, -assembly.beam.axis
            )
        )
        for displacement in displacements
    ]
    return theory.decorrelation_in_plane(np.array(across), assembly.beam.radius)
