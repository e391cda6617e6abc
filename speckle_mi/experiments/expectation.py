"""What first-order theory expects of an assembly: sensitivities along every axis, and decorrelation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import theory
from ..field.simulation import plan_of
from ..geometry.outline import Circle
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation
from ..optics.sequence import Sequence, detector_plane
from ..optics.trace import trace
from ..plan.plan import Plan
from ..plan.way import Channel
from ..scene.assembly import Assembly
from .chief_ray import STEP, ChiefRay, SeenAxes, Zones, axes_as_seen, chief_ray, launch_to, opening_middle

PATTERN_AXES = ("u", "v", "x", "y")
CENTRE_AXES = ("cog_u", "cog_v")

AXES = (*PATTERN_AXES, *CENTRE_AXES)
"""Axes along which motion of the image is reported: the detector's, the target's, the detector's for the centre of
gravity."""


def expected_sensitivity(assembly: Assembly, plan: Plan | None = None) -> dict[str, np.ndarray | None]:
    """Sensitivities (6,) [mm/mm, mm/deg] to the six motions for every axis, None where there is no theory.

    There is none where the light comes by several ways, or no ray leads from the spot to the detector's middle.
    plan: of the assembly at rest, where it is known already.
    """
    expected: dict[str, np.ndarray | None] = dict.fromkeys(AXES)
    plan = plan or plan_of(assembly)
    if len(plan.channels) != 1:
        return expected
    channel = plan.channels[0]
    pattern, centre = _pattern_displacement(assembly, channel), _centre_displacement(assembly, channel)
    if pattern is not None:
        along = on_all_axes(theory.per_degree(pattern), assembly, axes_as_seen(assembly, plan))
        expected |= zip(PATTERN_AXES, along, strict=True)
    if centre is not None:
        expected |= zip(CENTRE_AXES, theory.per_degree(centre), strict=True)
    return expected


def expected_by_way(assembly: Assembly, plan: Plan | None = None) -> dict[str, dict[str, np.ndarray | None]]:
    """What :func:`expected_sensitivity` says of the light of each way alone, by the way's words.

    Where light comes by several ways each has a pattern of its own, and the detector sees their interference.
    """
    plan = plan or plan_of(assembly)
    return {
        channel.route.label: expected_sensitivity(assembly, replace(plan, channels=(channel,)))
        for channel in plan.channels
    }


def on_all_axes(matrix: np.ndarray, assembly: Assembly, seen: SeenAxes) -> np.ndarray:
    """Displacements (2, k) along u, v completed by their projection on the target's x, y: (4, k).

    seen: the detector's axes as the target sees them.
    """
    return np.concatenate([matrix, theory.project_on_target(matrix, seen.u, seen.v, assembly.target.frame.axes)])


def expected_correlation(
    assembly: Assembly, dof: str, displacements: np.ndarray, plan: Plan | None = None
) -> np.ndarray | None:
    """Peak correlation (n,) that a motion leaves, None where there is no theory.

    Without a lens the material's motion across the Gaussian beam counts; with one, the motion of the light across the
    circular pupil. plan: of the assembly at rest, where it is known already.
    """
    channels = (plan or plan_of(assembly)).channels
    if len(channels) != 1:
        return None
    if not channels[0].has_power:
        return _beam_correlation(assembly, dof, displacements)
    return _pupil_correlation(assembly, channels[0], dof, displacements)


def _is_spot_of_beam(assembly: Assembly) -> bool:
    """Whether what scatters lies under a beam of finite width, and is not the user's points or all there is."""
    return assembly.target.points is None and bool(np.isfinite(assembly.beam.radius))


def _beam_correlation(assembly: Assembly, dof: str, displacements: np.ndarray) -> np.ndarray | None:
    if not _is_spot_of_beam(assembly):
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
        per_motion = _imaged(assembly, chief_ray(assembly, channel, system, u, v, Zones.middle(channel)))
    if per_motion is None:
        return None
    moved = np.linalg.norm(per_motion[:, DEGREES_OF_FREEDOM.index(dof)])
    size = np.abs(displacements) * (np.pi / 180 if is_rotation(dof) else 1.0)
    return theory.decorrelation_circular_pupil(np.minimum(moved * size / (2 * plane.outline.radius), 1.0))


def _light_at_spot(assembly: Assembly) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Spot, origin and axes of the target, direction to the source and the wavefront's radius there: what theory takes.

    The spot lies beside the beam's axis where it is the middle of the user's own points.
    """
    spot, frame, beam = assembly.spot.point, assembly.target.frame, assembly.beam
    return spot, frame.origin, frame.axes, beam.directions_to_source(spot[None])[0], beam.wavefront_radius_at(spot)


def _free_space(assembly: Assembly, place: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(2, 6) displacement [mm/mm, mm/rad] of the free-space pattern at a place, along u and v."""
    return theory.first_order_displacement(*_light_at_spot(assembly), place, u, v, assembly.spot.normal)


def _pattern_displacement(assembly: Assembly, channel: Channel) -> np.ndarray | None:
    grid = channel.grid
    if not channel.has_power:
        return _free_space(assembly, grid.centre, grid.u, grid.v)
    system = Sequence((*channel.interactions, detector_plane(grid)))
    return _imaged(assembly, chief_ray(assembly, channel, system, grid.u, grid.v, Zones.over_opening(channel)))


def _imaged(assembly: Assembly, view: ChiefRay | None) -> np.ndarray | None:
    """(2, 6) displacement [mm/mm, mm/rad] of the pattern that a system forms at the end of a chief ray."""
    if view is None:
        return None
    return theory.system_displacement(
        *_light_at_spot(assembly), view.sight, view.across, view.magnification, view.lever, assembly.spot.normal
    )


def _centre_displacement(assembly: Assembly, channel: Channel) -> np.ndarray | None:
    """(2, 6) motion of the light's centre of gravity: the spot, seen through the middle of the one opening.

    None where the beam is no spot that slides over the surface: uniform light, and the user's own points.
    """
    if len(channel.openings) != 1 or not _is_spot_of_beam(assembly):
        return None
    target, beam = assembly.target, assembly.beam
    if not channel.has_power:
        return theory.centre_of_gravity_aperture(
            assembly.spot.point, target.frame.origin, target.frame.axes, -beam.axis,
            channel.openings[0].plane.frame.origin, channel.grid.centre, channel.grid.u, channel.grid.v,
            assembly.spot.normal,
        )
    slide = theory.spot_displacement(
        assembly.spot.point, target.frame.origin, target.frame.axes, -beam.axis, assembly.spot.normal
    )
    steps = np.concatenate([[np.zeros(3)], STEP * np.eye(3)])
    landing = _landings_through_opening(channel, assembly.spot.point + steps)
    return None if landing is None else ((landing[1:] - landing[0]) / STEP).T @ slide


def _landings_through_opening(channel: Channel, sources: np.ndarray) -> np.ndarray | None:
    """Where the rays from sources (n, 3) through the opening's middle end on the detector, (n, 2) along u and v."""
    launch = launch_to(channel, sources, opening_middle(channel))
    if launch is None:
        return None
    ends = trace(Sequence((*channel.interactions, detector_plane(channel.grid))), sources, launch).points[-1]
    return np.stack([ends @ channel.grid.u, ends @ channel.grid.v], axis=1)
