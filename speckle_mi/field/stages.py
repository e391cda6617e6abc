"""The field that one channel of the plan brings to the detector: sums from points to points, opening after opening."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..geometry.frames import Frame
from ..geometry.outline import Circle
from ..geometry.plane import PlaneGrid, PlanePoints
from ..optics.aim import aim
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.traced_path import TracedLeg
from ..plan.shadows import (
    SHADOWS_ON_DETECTOR,
    SHADOWS_ON_OPENING,
    detector_samples,
    extremes,
    has_shadow,
    is_clear,
    lit_nodes,
    lit_pixels,
    opening_samples,
    shadowed_sum,
    shapes_beside_way,
)
from ..plan.way import Channel, Rim
from ..propagation.coherent_sum import SumResult, coherent_sum
from ..propagation.opening_quadrature import opening_nodes
from ..propagation.paths import FreeSpace, RayleighSommerfeld
from ..propagation.reference import reference_sum
from ..scattering.rough_surface import Scatterers
from ..scene.assembly import Assembly
from ..scene.errors import SceneError
from .lobe import lobe_towards
from .ray_method import ray_field

_DARK = 1e-4
"""Share of the power on pixels with an obstructed view of the opening from which it is refused: 1 % of the field, the
wave of an edge that is otherwise left out."""

_FEW_PAIRS = 300_000
"""Pairs of scatterer and pixel below which their plain sum takes less time than the search for a better way."""

_GRADIENT_SAFETY = 1.05
"""Factor on the sampled phase gradient, for what lies between the samples."""


@dataclass(frozen=True)
class ChannelField:
    """field: complex (rows, columns); lines: how the sums were done; error: estimated relative L2 error."""

    field: np.ndarray
    lines: tuple[str, ...]
    error: float


def channel_field(
    assembly: Assembly, frame: Frame, scatterers: Scatterers, channel: Channel, grid: PlaneGrid
) -> ChannelField:
    """The field on ``grid``, which is the channel's unfolded detector or a part of it, with the target at ``frame``."""
    options, wavelength = assembly.options, assembly.beam.wavelength
    sources, weights, axes, opening = scatterers.position, scatterers.amplitude, frame.axes, None
    middle, _ = assembly.spot_at(frame)
    lines, errors = [], []
    stops = len(channel.openings)
    tolerance = max(options.tolerance / (stops + 1), 1e-8)
    for number, rim in enumerate(channel.openings):
        targets = _next_targets(channel, number, grid)
        try:
            nodes, areas = _nodes(channel, number, rim, extremes(sources, axes), targets, wavelength, tolerance)
        except InputError as error:
            raise SceneError(
                f"opening {rim.name!r}: {error}; "
                "put a smaller stop, or set diffraction to false where there is no focus"
            ) from None
        path = _path(channel, number, rim.end, opening, wavelength)
        result = _summed(channel, path, sources, weights, nodes, wavelength, options.method, tolerance)
        values = result.field
        if number == 0:
            if has_shadow(channel, rim, sources, axes):
                how = wavelength, options.method, tolerance
                values, shared = _with_shadows_on(nodes, channel, rim, path, sources, weights, values, *how)
                errors.append(shared)
            values = values * _lobe(assembly, frame, middle, channel, rim, nodes)
        lines.append(f"sum to {rim.name}, {nodes.size} nodes: {result.plan}")
        errors.append(result.numerical_error)
        sources, weights, axes = nodes.points(), values * areas, rim.plane.frame.axes
        towards = np.mean(targets, axis=0) - rim.plane.frame.origin
        normal = rim.plane.frame.axes[:, 2]
        opening = (normal if normal @ towards > 0 else -normal, rim.index)
    path = _path(channel, stops, detector_plane(channel.grid), opening, wavelength)
    if stops or is_clear(assembly, channel, sources, axes):
        result = _summed(channel, path, sources, weights, grid, wavelength, options.method, tolerance)
        values, plan, error = result.field.reshape(grid.shape), result.plan, result.numerical_error
    else:
        values, plan, error = _shadowed_field(assembly, channel, path, sources, weights, grid)
    if channel.hidden is not None:
        _require_dark(channel, values)
    if not stops:
        values = values * _lobe(assembly, frame, middle, channel, None, grid)
    lines.append(f"sum to the detector: {plan}")
    return ChannelField(values, tuple(lines), float(np.sqrt(np.sum(np.square([*errors, error])))))


def _summed(channel: Channel, path, *arguments) -> SumResult:
    """The coherent sum; where a traced path finds no ray, SceneError that says on which way and what to do."""
    try:
        return coherent_sum(path, *arguments)
    except InputError as error:
        if not isinstance(path, TracedLeg):
            raise
        raise SceneError(
            f"way {channel.route.label}: {error}: "
            "put an aperture that keeps the light off the edges, or move the detector"
        ) from None


def ray_channel(
    assembly: Assembly, frame: Frame, scatterers: Scatterers, channel: Channel, grid: PlaneGrid
) -> ChannelField:
    """The field by the paper's own method: fans of rays, their paths interpolated on the pixels."""
    sequence = Sequence(channel.interactions) if channel.interactions else None
    rays = assembly.options.rays_per_source
    sources, weights = scatterers.position, scatterers.amplitude
    result = ray_field(sequence, grid, sources, weights, assembly.beam.wavelength, rays)
    values = result.field
    if shapes_beside_way(assembly, channel, extremes(sources, frame.axes)):
        values, *_ = shadowed_sum(
            sources,
            lambda places, only: lit_pixels(assembly, channel, places, grid, only, rims=False),
            lambda group, seen: ray_field(
                sequence, grid, sources[group], weights[group], assembly.beam.wavelength, rays
            ).field[seen],
            values,
            SHADOWS_ON_DETECTOR,
        )
    values = values * _lobe(assembly, frame, assembly.spot_at(frame)[0], channel, None, grid)
    line = f"rays: {rays} a source, {result.rays_traced} in all, reach {result.covered:.1%} of the pixels"
    return ChannelField(values, (line, *result.warnings), math.nan)


def _path(channel: Channel, number: int, end: Interaction, opening, wavelength: float):
    """What leads from point set ``number`` of the channel to the next, which lies in the plane ``end``."""
    between = channel.leg(number)
    if between:
        return TracedLeg(Sequence((*between, end)), wavelength, opening)
    return FreeSpace() if opening is None else RayleighSommerfeld(opening[0], wavelength)


# Quadrature of an opening


def _nodes(
    channel: Channel,
    number: int,
    rim: Rim,
    sources: np.ndarray,
    targets: np.ndarray,
    wavelength: float,
    tolerance: float,
) -> tuple[PlanePoints, np.ndarray]:
    """Nodes and areas on an opening that resolve the phase of all light from sources to targets over it."""
    samples = opening_samples(rim.plane)
    is_last = number + 1 == len(channel.openings)
    end = detector_plane(channel.grid) if is_last else channel.openings[number + 1].end
    before, after = Sequence((*channel.leg(number), rim.end)), Sequence((*channel.leg(number + 1), end))
    coming = aim(before, np.tile(sources, (len(samples), 1)), np.repeat(samples, len(sources), axis=0)).arrival
    going = aim(after, np.repeat(samples, len(targets), axis=0), np.tile(targets, (len(samples), 1))).launch
    tangents = rim.plane.frame.axes[:, :2]
    k = 2 * np.pi * rim.index / wavelength
    coming = k * (coming @ tangents).reshape(len(samples), -1, 1, 2)
    going = k * (going @ tangents).reshape(len(samples), 1, -1, 2)
    gradient = (coming - going).reshape(len(samples), -1, 2)
    if not np.isfinite(gradient).any():
        raise InputError("no ray leads over it from the spot to the detector")
    outline = rim.plane.outline
    if not isinstance(outline, Circle):
        bound = _GRADIENT_SAFETY * np.nanmax(np.abs(gradient), axis=(0, 1))
        return opening_nodes(outline, rim.plane.frame, (float(bound[0]), float(bound[1])), tolerance)
    local = rim.plane.frame.to_local(samples)[:, :2]
    radius = np.hypot(*local.T)
    length = np.nanmax(np.hypot(gradient[..., 0], gradient[..., 1]), axis=1)
    around = np.stack([-local[:, 1], local[:, 0]], axis=1) / np.maximum(radius, 1e-300)[:, None]
    azimuthal = np.nanmax(np.abs(np.einsum("snk,sk->sn", gradient, around)), axis=1)
    tilt = max(float(length[radius == 0].max()), float(azimuthal.max()))
    largest = float(length.max())
    grows_evenly = np.all(length <= (tilt + (largest - tilt) * radius / outline.radius) * _GRADIENT_SAFETY + 1e-9)
    return opening_nodes(
        outline,
        rim.plane.frame,
        _GRADIENT_SAFETY * largest,
        tolerance,
        _GRADIENT_SAFETY * tilt if grows_evenly else None,
    )


def _next_targets(channel: Channel, number: int, grid: PlaneGrid) -> np.ndarray:
    """Samples of the next opening, or of the detector, (n, 3)."""
    if number + 1 < len(channel.openings):
        return opening_samples(channel.openings[number + 1].plane)
    return detector_samples(grid)


# Shadows


def _with_shadows_on(
    nodes: PlanePoints,
    channel: Channel,
    rim: Rim,
    path,
    sources: np.ndarray,
    weights: np.ndarray,
    whole: np.ndarray,
    *how,
) -> tuple[np.ndarray, float]:
    """The field at the nodes of the first opening with the shadows of rims that are not diffracted at, and its error.

    whole: (n,) the field without them. The error is that of scatterers that share their shadow.
    """
    points = nodes.points()

    def sum_over(group: np.ndarray, seen: np.ndarray) -> np.ndarray:
        places = replace(nodes, a=nodes.a[seen], b=nodes.b[seen])
        return _summed(channel, path, sources[group], weights[group], places, *how).field

    field, _, error = shadowed_sum(
        sources, lambda places, _: lit_nodes(channel, rim, places, points), sum_over, whole, SHADOWS_ON_OPENING
    )
    return field, error


def _shadowed_field(
    assembly: Assembly, channel: Channel, path, sources: np.ndarray, weights: np.ndarray, grid: PlaneGrid
) -> tuple[np.ndarray, str, float]:
    """Geometric field with all shadows, each scatterer's (or patch of the spot's) at its own place."""
    how = assembly.beam.wavelength, assembly.options.method, assembly.options.tolerance
    result = _summed(channel, path, sources, weights, grid, *how)
    pixels = grid.points()

    def sum_over(group: np.ndarray, seen: np.ndarray) -> np.ndarray:
        if isinstance(path, FreeSpace) and len(group) * np.count_nonzero(seen) < _FEW_PAIRS:
            return reference_sum(path, sources[group], weights[group], pixels[seen.ravel()], assembly.beam.wavelength)
        rows, columns = np.nonzero(seen)
        places = PlanePoints(grid.origin, grid.u, grid.v, grid.pitch * columns, grid.pitch * rows)
        return _summed(channel, path, sources[group], weights[group], places, *how).field

    whole = result.field.reshape(grid.shape)
    field, share, error = shadowed_sum(
        sources,
        lambda places, only: lit_pixels(assembly, channel, places, grid, only),
        sum_over,
        whole,
        SHADOWS_ON_DETECTOR,
    )
    line = f"{result.plan}; {share:.1%} of the pixels in full or partial shadow"
    return field, line, float(np.hypot(result.numerical_error, error))


def _require_dark(channel: Channel, values: np.ndarray) -> None:
    """SceneError where light falls on pixels that a rim or a shape hides from a part of the last opening."""
    power = np.abs(values) ** 2
    share = float(power[channel.hidden].sum() / max(power.sum(), 1e-300))
    if share > _DARK:
        raise SceneError(
            f"way {channel.route.label}: {share:.2%} of the light behind {channel.openings[-1].name!r} falls where "
            "a rim or a shape hides a part of that opening, and the diffraction there is not computed: make that "
            "element wider, move it out of the light, or the detector smaller"
        )


def _lobe(
    assembly: Assembly,
    frame: Frame,
    middle: np.ndarray,
    channel: Channel,
    rim: Rim | None,
    places: PlaneGrid | PlanePoints,
) -> np.ndarray | float:
    """Amplitude of the target's radiation along the rays from the spot's middle to places, 1.0 for even radiation."""
    if not assembly.target.lobe:
        return 1.0
    points = places.points()
    towards = points - middle
    if channel.leg(0):
        end = detector_plane(channel.grid) if rim is None else rim.end
        towards = aim(Sequence((*channel.leg(0), end)), np.broadcast_to(middle, points.shape), points).launch
    amplitude = lobe_towards(assembly, frame, towards)
    return amplitude.reshape(places.shape) if isinstance(places, PlaneGrid) else amplitude
