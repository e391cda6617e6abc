"""What first-order theory expects of an assembly: sensitivities along every axis, and decorrelation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import theory
from ..field.simulation import plan_of
from ..geometry.outline import Circle
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation
from ..optics.aim import aim
from ..optics.sequence import Sequence, detector_plane
from ..optics.trace import trace
from ..plan.way import Channel
from ..scene.assembly import Assembly

PATTERN_AXES = ("u", "v", "x", "y")
CENTRE_AXES = ("cog_u", "cog_v")

AXES = (*PATTERN_AXES, *CENTRE_AXES)
"""Axes along which motion of the image is reported: the detector's, the target's, the detector's for the centre of
gravity."""

_ASTIGMATISM = 0.02
"""Relative difference of the two principal defoci up to which a system counts as one that images a plane."""

_ZONES = 6
"""Rings, and half the rays a ring, over which a system's lever is averaged."""

_STEP = 1e-4
"""Step [mm, rad] of the difference quotients along a chief ray."""


def expected_sensitivity(assembly: Assembly) -> dict[str, np.ndarray | None]:
    """Sensitivities (6,) [mm/mm, mm/deg] to the six motions for every axis, None where there is no theory.

    There is none where the light comes by several ways, or the detector sees a strongly astigmatic system.
    """
    expected: dict[str, np.ndarray | None] = dict.fromkeys(AXES)
    channels = plan_of(assembly).channels
    if len(channels) != 1:
        return expected
    pattern, centre = _pattern_displacement(assembly, channels[0]), _centre_displacement(assembly, channels[0])
    if pattern is not None:
        expected |= zip(PATTERN_AXES, on_all_axes(theory.per_degree(pattern), assembly), strict=True)
    if centre is not None:
        expected |= zip(CENTRE_AXES, theory.per_degree(centre), strict=True)
    return expected


def on_all_axes(matrix: np.ndarray, assembly: Assembly) -> np.ndarray:
    """Displacements (2, k) along u, v completed by their projection on the target's x, y: (4, k)."""
    grid, frame = assembly.detector, assembly.target.frame
    return np.concatenate([matrix, theory.project_on_target(matrix, grid.u, grid.v, frame.axes)])


def expected_correlation(assembly: Assembly, dof: str, displacements: np.ndarray) -> np.ndarray | None:
    """Peak correlation (n,) that a motion leaves, None where there is no theory.

    Without a lens the material's motion across the Gaussian beam counts; with one, the motion of the light across the
    circular pupil.
    """
    channels = plan_of(assembly).channels
    if len(channels) != 1:
        return None
    if not channels[0].has_power:
        return _beam_correlation(assembly, dof, displacements)
    return _pupil_correlation(assembly, channels[0], dof, displacements)


def _beam_correlation(assembly: Assembly, dof: str, displacements: np.ndarray) -> np.ndarray | None:
    if np.isinf(assembly.beam.radius):
        return None
    target = assembly.target
    across = [
        np.linalg.norm(
            theory.beam_displacement_of_material(
                Pose(**{dof: float(displacement)}),
                assembly.spot.point,
                target.frame.origin,
                target.frame.axes,
                -assembly.beam.axis,
            )
        )
        for displacement in displacements
    ]
    return theory.decorrelation_in_plane(np.array(across), assembly.beam.radius)


def _pupil_correlation(assembly: Assembly, channel: Channel, dof: str, displacements: np.ndarray) -> np.ndarray | None:
    if len(channel.openings) != 1 or not isinstance(channel.openings[0].plane.outline, Circle):
        return None
    plane = channel.openings[0].plane
    u, v = plane.frame.axes[:, 0], plane.frame.axes[:, 1]
    if not channel.leg(0):
        per_motion = _free_space(assembly, plane.frame.origin, u, v)
    else:
        system = Sequence((*channel.leg(0), channel.openings[0].end))
        per_motion = _imaged(assembly, _chief_ray(assembly, channel, system, u, v, _Zones.middle(channel)))
    if per_motion is None:
        return None
    moved = np.linalg.norm(per_motion[:, DEGREES_OF_FREEDOM.index(dof)])
    size = np.abs(displacements) * (np.pi / 180 if is_rotation(dof) else 1.0)
    return theory.decorrelation_circular_pupil(np.minimum(moved * size / (2 * plane.outline.radius), 1.0))


def _free_space(assembly: Assembly, place: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(2, 6) displacement [mm/mm, mm/rad] of the free-space pattern at a place, along u and v."""
    target, beam = assembly.target, assembly.beam
    return theory.first_order_displacement(
        assembly.spot.point,
        target.frame.origin,
        target.frame.axes,
        -beam.axis,
        beam.wavefront_radius,
        place,
        u,
        v,
        assembly.spot.normal,
    )


def _pattern_displacement(assembly: Assembly, channel: Channel) -> np.ndarray | None:
    grid = channel.grid
    if not channel.has_power:
        return _free_space(assembly, grid.centre, grid.u, grid.v)
    system = Sequence((*channel.interactions, detector_plane(grid)))
    return _imaged(assembly, _chief_ray(assembly, channel, system, grid.u, grid.v, _Zones.over_opening(channel)))


def _imaged(assembly: Assembly, view: _ChiefRay | None) -> np.ndarray | None:
    """(2, 6) displacement [mm/mm, mm/rad] of the pattern that a system forms at the end of a chief ray."""
    if view is None:
        return None
    defocus = np.linalg.solve(view.magnification, view.lever)
    mean = 0.5 * np.trace(defocus)
    if np.abs(defocus - mean * np.eye(2)).max() > _ASTIGMATISM * max(abs(mean), view.distance):
        return None
    target, beam = assembly.target, assembly.beam
    return theory.imaging_displacement(
        assembly.spot.point, target.frame.origin, target.frame.axes, -beam.axis, beam.wavefront_radius,
        view.sight, view.across[0], view.across[1], view.magnification, float(mean), assembly.spot.normal,
    )


def _centre_displacement(assembly: Assembly, channel: Channel) -> np.ndarray | None:
    """(2, 6) motion of the light's centre of gravity: the spot, seen through the middle of the one opening."""
    if len(channel.openings) != 1:
        return None
    target, beam = assembly.target, assembly.beam
    if not channel.has_power:
        return theory.centre_of_gravity_aperture(
            assembly.spot.point, target.frame.origin, target.frame.axes, -beam.axis, channel.openings[0].plane.frame.origin,
            channel.grid.centre, channel.grid.u, channel.grid.v, assembly.spot.normal,
        )
    slide = theory.spot_displacement(
        assembly.spot.point, target.frame.origin, target.frame.axes, -beam.axis, assembly.spot.normal
    )
    steps = np.concatenate([[np.zeros(3)], _STEP * np.eye(3)])
    landing = _landings_through_opening(channel, assembly.spot.point + steps)
    return None if landing is None else ((landing[1:] - landing[0]) / _STEP).T @ slide


@dataclass(frozen=True)
class _Zones:
    """Places that stand for equal areas of the first opening, and how much the ray through each moves the pattern.

    places: (n, 3) [mm]; weights: (n, 2), for phase slopes along the opening's x and y; axes: (2, 3) these.

    What moves the pattern is the straight line that fits a phase over the opening best. Its slope along x is the mean
    of the local slopes, the motions of rays' ends, weighted by x_edge^2 - x^2, x_edge the rim at that y: integration
    by parts of the mean of phase times x.
    """

    places: np.ndarray
    weights: np.ndarray
    axes: np.ndarray

    @classmethod
    def middle(cls, channel: Channel) -> _Zones:
        """The opening's middle alone."""
        return cls(_opening_middle(channel), np.ones((1, 2)), np.eye(3)[:2])

    @classmethod
    def over_opening(cls, channel: Channel) -> _Zones:
        """All over the opening; the middle where light is not diffracted."""
        if not channel.openings:
            return cls.middle(channel)
        plane = channel.openings[0].plane
        if isinstance(plane.outline, Circle):
            share = np.sqrt((np.arange(_ZONES) + 0.5) / _ZONES)
            angle = 2 * np.pi * np.arange(2 * _ZONES) / (2 * _ZONES)
            x, y = (plane.outline.radius * np.outer(share, f(angle)).ravel() for f in (np.cos, np.sin))
            # x_edge^2 = R^2 - y^2, so that both weights are R^2 - r^2.
            weight_x = weight_y = np.repeat(1 - share**2, 2 * _ZONES)
        else:
            side = (np.arange(_ZONES) + 0.5) / _ZONES * 2 - 1
            a, b = (values.ravel() for values in np.meshgrid(side, side))
            x, y, weight_x, weight_y = plane.outline.half_x * a, plane.outline.half_y * b, 1 - a**2, 1 - b**2
        weights = np.stack([weight_x, weight_y], axis=1)
        places = plane.frame.to_world(np.stack([x, y, np.zeros_like(x)], axis=1))
        return cls(places, weights / weights.mean(axis=0), plane.frame.axes[:, :2].T)

    def mean(self, motion: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """The pattern's motion (k, 2) along the columns of ``plane`` (3, 2) from that of the rays' ends (n, k, 2)."""
        if len(self.places) == 1:
            return motion[0]
        turn = self.axes @ plane  # from the opening's axes to the detector's, which need not be parallel
        local = motion @ np.linalg.inv(turn)
        return np.mean(local * self.weights[:, None, :], axis=0) @ turn


@dataclass(frozen=True)
class _ChiefRay:
    """The ray from the spot through the opening's middle, and what its neighbours do, taken together over the opening.

    sight: (3,) its direction at the spot; across: (2, 3) unit vectors across it; magnification, lever: (2, 2) motion of
    a ray's end on the detector per shift [mm/mm] and per tilt [mm/rad] of its beginning; distance: to the opening [mm].
    With aberrations both are those of the part of a phase change that is linear over the opening, see :class:`_Zones`:
    a tilt shifts the light across the pupil, so that the lever is the straight line fitted to the rays' ends.
    """

    sight: np.ndarray
    across: np.ndarray
    magnification: np.ndarray
    lever: np.ndarray
    distance: float


def _chief_ray(
    assembly: Assembly, channel: Channel, system: Sequence, u: np.ndarray, v: np.ndarray, over: _Zones
) -> _ChiefRay | None:
    """The chief ray through ``system``, its end measured along u and v, with the rays over zones of the opening."""
    spot = assembly.spot.point
    launch = _launch_to(channel, spot[None], _opening_middle(channel))
    zones = _launch_to(channel, spot[None], over.places)
    if launch is None or zones is None:
        return None
    sight = launch[0]
    first = np.cross(sight, assembly.target.frame.axes[:, 1])
    if np.linalg.norm(first) < 1e-3:
        first = np.cross(sight, assembly.target.frame.axes[:, 0])
    first /= -np.linalg.norm(first)
    across = np.stack([first, np.cross(sight, first)])
    shifts = np.concatenate([np.outer([1.0, -1.0], a) for a in across]) * _STEP
    moved = trace(system, np.tile(spot + shifts, (len(zones), 1)), np.repeat(zones, 4, axis=0)).points[-1]
    tilted = trace(system, np.broadcast_to(spot, zones.shape), zones).points[-1]
    if not (np.all(np.isfinite(moved)) and np.all(np.isfinite(tilted))):
        return None
    plane = np.stack([u, v], axis=1)
    ends = (moved @ plane).reshape(len(zones), 4, 2)
    magnification = over.mean((ends[:, 0::2] - ends[:, 1::2]) / (2 * _STEP), plane).T
    # Slopes at the spot: the transverse part of a direction over its part along the chief ray.
    slopes = (zones @ across.T) / (zones @ sight)[:, None]
    lever = _line(slopes, tilted @ plane) if len(zones) > 1 else _lever_of_one(system, spot, sight, across, plane)
    distance = float(np.linalg.norm(_opening_middle(channel) - spot))
    return _ChiefRay(sight, across, magnification, lever, distance)


def _line(slopes: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(2, 2) matrix of the straight line that fits ends (n, 2) against slopes (n, 2) best."""
    fitted, *_ = np.linalg.lstsq(np.column_stack([slopes, np.ones(len(slopes))]), ends, rcond=None)
    return fitted[:2].T


def _lever_of_one(
    system: Sequence, spot: np.ndarray, sight: np.ndarray, across: np.ndarray, plane: np.ndarray
) -> np.ndarray:
    """(2, 2) motion of one ray's end per tilt [mm/rad], where no opening limits the light."""
    tilts = np.concatenate([np.outer([1.0, -1.0], a) for a in across]) * _STEP
    ends = trace(system, np.broadcast_to(spot, tilts.shape), sight + tilts).points[-1] @ plane
    return ((ends[0::2] - ends[1::2]) / (2 * _STEP)).T


def _opening_middle(channel: Channel) -> np.ndarray:
    """(1, 3) the middle of the first opening, or of the detector [mm]."""
    return channel.openings[0].plane.frame.origin[None] if channel.openings else channel.grid.centre[None]


def _launch_to(channel: Channel, sources: np.ndarray, places: np.ndarray) -> np.ndarray | None:
    """Directions (n, 3) of the rays from sources to places on the first opening or the detector; one of them repeated.

    None where a place has no ray.
    """
    end = channel.openings[0].end if channel.openings else detector_plane(channel.grid)
    count = max(len(sources), len(places))
    sources, places = (np.broadcast_to(points, (count, 3)) for points in (sources, places))
    aimed = aim(Sequence((*channel.leg(0), end)), sources, places)
    return aimed.launch if np.all(aimed.converged) else None


def _landings_through_opening(channel: Channel, sources: np.ndarray) -> np.ndarray | None:
    """Where the rays from sources (n, 3) through the opening's middle end on the detector, (n, 2) along u and v."""
    launch = _launch_to(channel, sources, _opening_middle(channel))
    if launch is None:
        return None
    ends = trace(Sequence((*channel.interactions, detector_plane(channel.grid))), sources, launch).points[-1]
    return np.stack([ends @ channel.grid.u, ends @ channel.grid.v], axis=1)
