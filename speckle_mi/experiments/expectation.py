"""What first-order theory expects of an assembly: sensitivities along every axis, and decorrelation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import theory
from ..field.simulation import plan_of
from ..geometry.outline import Circle
from ..geometry.plane import PlaneGrid
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation
from ..optics.sequence import Sequence, detector_plane
from ..optics.trace import trace
from ..plan.plan import Plan
from ..plan.way import Channel
from ..scene.assembly import Assembly
from .chief_ray import SeenAxes, axes_as_seen, launch_to, opening_middle
from .diffracted_pattern import beside_rays
from .lit_surface import LitSurface
from .ray_bundle import STEP, RayBundle

PATTERN_AXES = ("u", "v", "x", "y")
CENTRE_AXES = ("cog_u", "cog_v")

SAME = 1e-3
"""Relative difference of what two lasers' patterns do up to which they are said to do the same."""

AXES = (*PATTERN_AXES, *CENTRE_AXES)
"""Axes along which motion of the image is reported: the detector's, the target's, the detector's for the centre of
gravity."""


def expected_sensitivity(assembly: Assembly, plan: Plan | None = None) -> dict[str, np.ndarray | None]:
    """Sensitivities (6,) [mm/mm, mm/deg] to the six motions for every axis, None where there is no theory.

    There is none where the light comes by several ways, or no ray leads from the spot to the detector's middle. Of
    several lasers or lines there is where all of them expect the same. plan: of the assembly at rest, where it is known
    already.
    """
    expected: dict[str, np.ndarray | None] = dict.fromkeys(AXES)
    if assembly.further:
        parts = [expected_sensitivity(part) for part in assembly.named_parts]
        return {axis: _common([part[axis] for part in parts]) for axis in AXES}
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
    if assembly.further:
        return _common([expected_correlation(part, dof, displacements) for part in assembly.named_parts])
    channels = (plan or plan_of(assembly)).channels
    if len(channels) != 1:
        return None
    if not channels[0].has_power:
        return _beam_correlation(assembly, dof, displacements)
    return _pupil_correlation(assembly, channels[0], dof, displacements)


def _common(parts: list[np.ndarray | None]) -> np.ndarray | None:
    """What all parts of the light expect, to ``SAME`` of the largest; None where they differ or one has none."""
    if any(part is None for part in parts):
        return None
    whole = np.array(parts)
    return parts[0] if np.all(np.ptp(whole, axis=0) <= SAME * np.abs(whole).max(initial=1e-300)) else None


def _is_spot_of_beam(assembly: Assembly) -> bool:
    """Whether what scatters lies under a beam of finite width, and is not the user's points or all there is."""
    return assembly.target.points is None and not assembly.beam.is_uniform


def _beam_correlation(assembly: Assembly, dof: str, displacements: np.ndarray) -> np.ndarray | None:
    if not _is_spot_of_beam(assembly):
        return None
    target, beam = assembly.target, assembly.beam
    across = [
        theory.beam_displacement_of_material(
            Pose(**{dof: float(displacement)}),
            assembly.spot.point,
            target.frame.origin,
            target.frame.axes,
            -beam.axis,
        )
        for displacement in displacements
    ]
    return theory.decorrelation_elliptical_beam(np.array(across), beam.radii, beam.across)


def _pupil_correlation(assembly: Assembly, channel: Channel, dof: str, displacements: np.ndarray) -> np.ndarray | None:
    if len(channel.openings) != 1 or not isinstance(channel.openings[0].plane.outline, Circle):
        return None
    per_motion = _at_opening(assembly, channel)
    if per_motion is None:
        return None
    radius = channel.openings[0].plane.outline.radius
    moved = np.linalg.norm(per_motion[:, DEGREES_OF_FREEDOM.index(dof)])
    size = np.abs(displacements) * (np.pi / 180 if is_rotation(dof) else 1.0)
    return theory.decorrelation_circular_pupil(np.minimum(moved * size / (2 * radius), 1.0))


def _pattern_displacement(assembly: Assembly, channel: Channel) -> np.ndarray | None:
    """(2, 6) displacement [mm/mm, mm/rad] of the pattern on the detector.

    Behind openings it is that of all the light on the detector, elsewhere that in the detector's middle.
    """
    launch = launch_to(channel, assembly.spot.point[None], opening_middle(channel))
    if launch is None:
        return None

    def bundle_of(surface: LitSurface) -> RayBundle:
        end = detector_plane(channel.grid)
        return RayBundle(assembly, channel.interactions, channel.rims, end, channel.grid, launch[0], surface)

    rays = bundle_of(LitSurface.of(assembly)).displacement(at_middle=not channel.openings)
    diffraction = None if rays is None else beside_rays(assembly, channel, bundle_of)
    return rays if diffraction is None else rays + diffraction


def _at_opening(assembly: Assembly, channel: Channel) -> np.ndarray | None:
    """(2, 6) displacement [mm/mm, mm/rad] of the light in the middle of the first opening, along its x and y."""
    opening = channel.openings[0]
    launch = launch_to(channel, assembly.spot.point[None], opening_middle(channel))
    if launch is None:
        return None
    frame, side = opening.plane.frame, 2 * opening.plane.outline.reach
    grid = PlaneGrid(frame.origin, frame.axes[:, 0], frame.axes[:, 1], side, (1, 1))
    before = channel.interactions[: opening.position]
    rims = tuple(rim for rim in channel.rims if rim.number < opening.position)
    return RayBundle(assembly, before, rims, opening.end, grid, launch[0]).displacement(at_middle=True)


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
