"""Published figures of the assemblies in Opt. Eng. 61(6) 061410 (2022), DOI 10.1117/1.OE.61.6.061410.

Its sensitivities are magnitudes, given along the target's axes: k_x,t and k_z,t move the pattern along x, k_y,t along
y; rotations about x and z move it along y, about y along x. Two of its figures do not belong to the set-up they are
listed under: see ``DOUBTFUL``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.outline import Circle
from ..scene.assembly import Assembly


@dataclass(frozen=True)
class PublishedAssembly:
    """One of the paper's set-ups. Angles [deg] from the target's normal in its xz plane, distances [mm].

    aperture_distance: of the round hole of ``APERTURE_RADIUS`` along the normal, None without. figures: dof -> (axis
    along which the paper gives it, magnitude [mm/mm or mm/deg]).
    """

    name: str
    laser_angle: float
    detector_angle: float
    detector_distance: float
    figures: dict[str, tuple[str, float]]
    aperture_distance: float | None = None


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
    PublishedAssembly("integrated sensor", 39, 0, 75, {"z": ("cog_u", 0.67)}, aperture_distance=41),
)

DOUBTFUL = {
    (
        "both tilted",
        "rz",
    ): "0.63 belongs to laser and detector on the same side; on opposite sides it is 0 to first order",
}
"""Figures that contradict the rest of the paper, and why."""

WAVELENGTH = 632.8e-6
LASER_DISTANCE = 50.0
APERTURE_RADIUS = 0.5
PIXEL_PITCH, PIXELS = 6e-3, (480, 744)
"""What the set-ups have in common: wavelength, distance of the laser, hole and pixels [mm], (rows, columns)."""

WAVEFRONT_RADIUS = -750.0
"""Radius of curvature [mm] that reproduces the paper's tables."""

ANGLE, LENGTH = 0.05, 0.05
"""By how much a scene may differ from the paper's angles [deg] and distances [mm]: half a unit of their last digit."""

RELATIVE = 1e-3
"""By how much its wavelength, wavefront radius, hole and pixels may, which the paper gives to four digits or fewer."""


def published_assembly(assembly: Assembly) -> PublishedAssembly | None:
    """The paper's set-up that a scene reproduces, or None.

    It does where all agrees that the paper states or that a first-order displacement depends on: wavelength, where the
    laser and its wave's centre stand, a flat target lit at its origin (about which it turns), the detector's place and
    pixels, and what stands between. Mirror images count: the figures are magnitudes. What may differ is what the paper
    does not state and theory does not see: the beam's radius, roughness, scatterers, and how the field is summed.
    """
    if not (_has_the_light(assembly) and _has_the_target(assembly) and _has_the_camera(assembly)):
        return None
    return next((published for published in PUBLISHED if _stands_as(published, assembly)), None)


def _has_the_light(assembly: Assembly) -> bool:
    beam = assembly.beam
    return (
        not assembly.further
        and not beam.is_uniform
        and _close(beam.wavelength, WAVELENGTH)
        and all(_close(radius, WAVEFRONT_RADIUS) for radius in beam.wavefront_radii)
        and abs(beam.reference_path - LASER_DISTANCE) < LENGTH
    )


def _has_the_target(assembly: Assembly) -> bool:
    target = assembly.target
    at_origin = np.linalg.norm(assembly.spot.point - target.frame.origin) < LENGTH
    return target.points is None and target.is_flat and bool(at_origin)


def _has_the_camera(assembly: Assembly) -> bool:
    """Pixels as stated, square to the line of sight, their rows in the plane of incidence."""
    grid, frame = assembly.detector, assembly.target.frame
    sight = grid.centre - assembly.spot.point
    return (
        grid.shape == PIXELS
        and _close(grid.pitch, PIXEL_PITCH)
        and _along(grid.normal, sight)
        and _along(grid.v, frame.axes[:, 1])
    )


def _stands_as(published: PublishedAssembly, assembly: Assembly) -> bool:
    frame, grid = assembly.target.frame, assembly.detector
    to_laser = frame.axes.T @ -assembly.beam.axis
    to_detector = frame.axes.T @ (grid.centre - assembly.spot.point)
    distance = float(np.linalg.norm(to_detector))
    sides = []
    for direction in (to_laser, to_detector / distance):
        if abs(np.degrees(np.arcsin(np.clip(direction[1], -1, 1)))) > ANGLE:
            return False  # out of the plane of incidence
        sides.append(float(np.degrees(np.arctan2(direction[0], direction[2]))))
    on_one_side = sides[0] * sides[1] > ANGLE**2
    angles = np.abs(np.abs(sides) - (published.laser_angle, published.detector_angle))
    return (
        not on_one_side
        and bool(np.all(angles < ANGLE))
        and abs(distance - published.detector_distance) < LENGTH
        and _has_the_elements(published, assembly)
    )


def _has_the_elements(published: PublishedAssembly, assembly: Assembly) -> bool:
    """Nothing between target and detector but the hole, where there is one, round the target's normal."""
    if published.aperture_distance is None:
        return not assembly.elements
    if len(assembly.elements) != 1 or assembly.elements[0].kind != "opening":
        return False
    hole, frame = assembly.elements[0].faces[0], assembly.target.frame
    offset = frame.to_local(hole.frame.origin[None])[0] - (0.0, 0.0, published.aperture_distance)
    return (
        isinstance(hole.outline, Circle)
        and _close(hole.outline.radius, APERTURE_RADIUS)
        and bool(np.linalg.norm(offset) < LENGTH)
        and _along(hole.frame.axes[:, 2], frame.axes[:, 2])
    )


def _close(value: float, stated: float) -> bool:
    return abs(value - stated) <= RELATIVE * abs(stated)


def _along(direction: np.ndarray, other: np.ndarray) -> bool:
    """Whether two directions (3,) of any length are parallel or opposite."""
    sine = np.linalg.norm(np.cross(direction, other)) / (np.linalg.norm(direction) * np.linalg.norm(other))
    return bool(np.degrees(np.arcsin(min(sine, 1.0))) < ANGLE)
