"""Published figures of the assemblies in Opt. Eng. 61(6) 061410 (2022), DOI 10.1117/1.OE.61.6.061410.

Its sensitivities are magnitudes, given along the target's axes: k_x,t and k_z,t move the pattern along x, k_y,t along
y; rotations about x and z move it along y, about y along x. Two of its figures do not belong to the set-up they are
listed under: see ``DOUBTFUL``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.assembly import Assembly


@dataclass(frozen=True)
class PublishedAssembly:
    """One of the paper's set-ups. Angles [deg] from the target's normal in its xz plane, distances [mm].

    figures: dof -> (axis along which the paper gives it, magnitude [mm/mm or mm/deg]).
    """

    name: str
    laser_angle: float
    detector_angle: float
    detector_distance: float
    figures: dict[str, tuple[str, float]]


def _figures(
    translation: tuple[float, float, float], rotation: tuple[float, float, float]
) -> dict[str, tuple[str, float]]:
    axes = {"x": "x", "y": "y", "z": "x", "rx": "y", "ry": "x", "rz": "y"}
    values = dict(zip(("x", "y", "z"), translation)) | dict(zip(("rx", "ry", "rz"), rotation))
    return {dof: (axes[dof], value) for dof, value in values.items()}


PUBLISHED = (
    PublishedAssembly("tilted laser", 35, 0, 60, _figures((0.94, 0.92, 0.04), (1.905, 1.905, 0.6))),
    PublishedAssembly("tilted detector", 0, 35, 60, _figures((0.59, 0.92, 0.47), (1.905, 1.905, 0.6))),
    PublishedAssembly("both tilted", 17.5, 17.5, 60, _figures((0.83, 0.92, 0.31), (1.998, 1.998, 0.63))),
    PublishedAssembly("integrated sensor", 39, 0, 75, {"z": ("cog_u", 0.67)}),
)

DOUBTFUL = {
    (
        "both tilted",
        "rz",
    ): "0.63 belongs to laser and detector on the same side; on opposite sides it is 0 to first order",
}
"""Figures that contradict the rest of the paper, and why."""

WAVEFRONT_RADIUS = -750.0
"""Radius of curvature [mm] that reproduces the paper's tables."""


def published_assembly(assembly: Assembly) -> PublishedAssembly | None:
    """The paper's set-up that a scene reproduces, by its geometry, or None."""
    frame, grid, beam = assembly.target.frame, assembly.detector, assembly.beam
    if not np.isclose(beam.wavefront_radius, WAVEFRONT_RADIUS, rtol=1e-3):
        return None
    to_laser = frame.axes.T @ -beam.axis
    to_detector = frame.to_local(grid.centre[None])[0]
    distance = np.linalg.norm(to_detector)
    directions = [to_laser, to_detector / distance]
    if any(abs(direction[1]) > 1e-3 for direction in directions):
        return None
    laser, detector = (np.degrees(np.arctan2(direction[0], direction[2])) for direction in directions)
    if laser * detector > 1e-6:
        return None  # the same side of the normal: not one of the paper's
    for published in PUBLISHED:
        wanted = (published.laser_angle, published.detector_angle, published.detector_distance)
        if np.allclose((abs(laser), abs(detector), distance), wanted, atol=0.05):
            return published
    return None
