"""The field that one channel of the plan brings to the detector: sums from points to points, opening after opening."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .assembly import Assembly
from .geometry import Frame, PlaneGrid, PlanePoints
from .legs import TracedLeg
from .lobe import lobe_towards
from .openings import opening_nodes
from .optics.aim import aim
from .optics.surfaces import Circle, Interaction, Sequence, Surface
from .optics.trace import RayStatus, trace
from .parameters import SceneError
from .plan import Channel, Rim, detector_plane
from .propagation import FreeSpace, RayleighSommerfeld, SumResult, coherent_sum
from .propagation.chebyshev import chebyshev_nodes, interpolation_matrix
from .ray_method import ray_field
from .surface import Scatterers

_SOURCES_WITH_OWN_SHADOW = 64
"""Up to so many scatterers have each their own shadow; more share those of as many patches of the spot."""

_SAFE_MARGIN = 0.02
"""Relative clearance 1 - r^2/R^2 of the outermost rays from which on a rim is taken to cast no shadow."""

_MARGIN_NODES = 24
"""Nodes a side on the detector from which the clearance of rims is interpolated."""

_GRADIENT_SAFETY = 1.05
"""Factor on the sampled phase gradient, for what lies between the samples."""

_RING_SAMPLES, _ANGLE_SAMPLES = 5, 12


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
            nodes, areas = _nodes(channel, number, rim, _extremes(sources, axes), targets, wavelength, tolerance)
        except ValueError as error:
            raise SceneError(
                f"opening {rim.name!r}: {error}; put a smaller stop, or set diffraction to false where there is no focus"
            ) from None
        path = _path(channel, number, Interaction.through(Surface(rim.plane.frame), rim.index), opening, wavelength)
        result = _summed(channel, path, sources, weights, nodes, wavelength, options.method, tolerance)
        values = result.field
        if number == 0:
            values = values * _unshadowed(middle, channel, rim, nodes) * _lobe(assembly, frame, middle, channel, rim, nodes)
        lines.append(f"sum to {rim.name}, {nodes.size} nodes: {result.plan}")
        errors.append(result.numerical_error)
        sources, weights, axes = nodes.points(), values * areas, rim.plane.frame.axes
        towards = np.mean(targets, axis=0) - rim.plane.frame.origin
        normal = rim.plane.frame.axes[:, 2]
        opening = (normal if normal @ towards > 0 else -normal, rim.index)
    path = _path(channel, stops, detector_plane(channel.grid), opening, wavelength)
    if stops or _is_clear(channel, sources, axes, grid):
        result = _summed(channel, path, sources, weights, grid, wavelength, options.method, tolerance)
        values, plan, error = result.field.reshape(grid.shape), result.plan, result.numerical_error
    else:
        values, plan, error = _shadowed_sum(assembly, channel, path, sources, weights, grid)
    if not stops:
        values = values * _lobe(assembly, frame, middle, channel, None, grid)
    lines.append(f"sum to the detector: {plan}")
    return ChannelField(values, tuple(lines), float(np.sqrt(np.sum(np.square([*errors, error])))))


def _summed(channel: Channel, path, *arguments) -> SumResult:
    """The coherent sum; where a traced path finds no ray, SceneError that says on which way and what to do."""
    try:
        return coherent_sum(path, *arguments)
    except ValueError as error:
        if not isinstance(path, TracedLeg):
            raise
        raise SceneError(
            f"way {channel.route.label}: {error}: put an aperture that keeps the light off the edges, or move the detector"
        ) from None


def ray_channel(
    assembly: Assembly, frame: Frame, scatterers: Scatterers, channel: Channel, grid: PlaneGrid
) -> ChannelField:
    """The field by the paper's own method: random rays, their paths interpolated on the pixels."""
    sequence = Sequence(channel.interactions) if channel.interactions else None
    rays = assembly.options.rays_per_source
    result = ray_field(sequence, grid, scatterers.position, scatterers.amplitude, assembly.beam.wavelength, rays)
    values = result.field * _lobe(assembly, frame, assembly.spot_at(frame)[0], channel, None, grid)
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
    channel: Channel, number: int, rim: Rim, sources: np.ndarray, targets: np.ndarray, wavelength: float, tolerance: float
) -> tuple[PlanePoints, np.ndarray]:
    """Nodes and areas on an opening that resolve the phase of all light from sources to targets over it."""
    samples = _opening_samples(rim.plane)
    plane = Interaction.through(Surface(rim.plane.frame), rim.index)
    before = Sequence((*channel.leg(number), plane))
    end = (
        Interaction.through(Surface(channel.openings[number + 1].plane.frame), channel.openings[number + 1].index)
        if number + 1 < len(channel.openings) else detector_plane(channel.grid)
    )
    after = Sequence((*channel.leg(number + 1), end))
    coming = aim(before, np.tile(sources, (len(samples), 1)), np.repeat(samples, len(sources), axis=0)).arrival
    going = aim(after, np.repeat(samples, len(targets), axis=0), np.tile(targets, (len(samples), 1))).launch
    tangents = rim.plane.frame.axes[:, :2]
    k = 2 * np.pi * rim.index / wavelength
    coming = k * (coming @ tangents).reshape(len(samples), -1, 1, 2)
    going = k * (going @ tangents).reshape(len(samples), 1, -1, 2)
    gradient = (coming - going).reshape(len(samples), -1, 2)
    if not np.isfinite(gradient).any():
        raise ValueError("no ray leads over it from the spot to the detector")
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
        outline, rim.plane.frame, _GRADIENT_SAFETY * largest, tolerance, _GRADIENT_SAFETY * tilt if grows_evenly else None
    )


def _opening_samples(plane: Surface) -> np.ndarray:
    """World points (n, 3) spread over an opening: its centre, and rings out to the rim."""
    outline = plane.outline
    share = np.arange(1, _RING_SAMPLES + 1) / _RING_SAMPLES
    angle = 2 * np.pi * np.arange(_ANGLE_SAMPLES) / _ANGLE_SAMPLES
    x, y = (np.outer(share, f(angle)).ravel() for f in (np.cos, np.sin))
    if isinstance(outline, Circle):
        x, y = outline.radius * x, outline.radius * y
    else:
        largest = np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
        stretch = np.tile(1 / largest, _RING_SAMPLES)
        x, y = outline.half_x * x * stretch, outline.half_y * y * stretch
    x, y = np.append(0.0, x), np.append(0.0, y)
    return plane.frame.to_world(np.stack([x, y, np.zeros_like(x)], axis=1))


def _extremes(points: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The middle and the outermost of points (n, 3) in eight directions across axes z, (at most 9, 3)."""
    middle = points.mean(axis=0)
    angle = np.pi / 4 * np.arange(8)
    directions = np.outer(np.cos(angle), axes[:, 0]) + np.outer(np.sin(angle), axes[:, 1])
    outermost = [points[np.argmax(points @ direction)] for direction in directions]
    return np.unique(np.array([middle, *outermost]), axis=0)


def _next_targets(channel: Channel, number: int, grid: PlaneGrid) -> np.ndarray:
    """Samples of the next opening, or of the detector, (n, 3)."""
    if number + 1 < len(channel.openings):
        return _opening_samples(channel.openings[number + 1].plane)
    half_u, half_v = 0.5 * grid.pitch * grid.shape[1], 0.5 * grid.pitch * grid.shape[0]
    side = np.linspace(-1, 1, 5)
    a, b = (values.ravel() for values in np.meshgrid(side, side))
    return grid.centre + (half_u * a)[:, None] * grid.u + (half_v * b)[:, None] * grid.v


# Shadows of outlines that light is not diffracted at


def _margins(channel: Channel, first: int, last: int, end: Interaction, source: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Clearance (r, n) of the rims among interactions first to last, on rays from one source (3,) to targets (n, 3)."""
    sequence = Sequence((*channel.interactions[first:last], end))
    aimed = aim(sequence, np.broadcast_to(source, targets.shape), targets)
    return np.where(aimed.converged, aimed.margins, -1.0)


def _unshadowed(middle: np.ndarray, channel: Channel, rim: Rim, nodes: PlanePoints) -> np.ndarray | float:
    """1 where the first opening's nodes are lit from the spot's middle over all rims that light is not diffracted at."""
    chosen = {opening.number for opening in channel.openings}
    rows = [row for row, (number, _) in enumerate(Sequence(channel.interactions).rims) if number not in chosen]
    if not rows:
        return 1.0
    end = Interaction.through(Surface(rim.plane.frame), rim.index)
    points = nodes.points()
    source = np.broadcast_to(middle, points.shape)
    before = aim(Sequence((*channel.leg(0), end)), source, points)
    lit = before.converged
    # Where the ray goes on behind the opening decides about the rims there.
    whole = trace(Sequence((*channel.interactions, detector_plane(channel.grid))), source[lit], before.launch[lit])
    lit[lit] = (whole.status <= RayStatus.OUTSIDE_OUTLINE) & np.all(whole.margins[rows] >= 0, axis=0)
    return lit.astype(float)


def _is_clear(channel: Channel, sources: np.ndarray, axes: np.ndarray, grid: PlaneGrid) -> bool:
    """Whether no rim casts a shadow on the detector, judged by the outermost rays."""
    if not channel.rims:
        return True
    targets = _next_targets(channel, len(channel.openings), grid)
    end = detector_plane(channel.grid)
    return all(
        np.all(_margins(channel, 0, len(channel.interactions), end, source, targets) > _SAFE_MARGIN)
        for source in _extremes(sources, axes)
    )


def _shadowed_sum(
    assembly: Assembly, channel: Channel, path, sources: np.ndarray, weights: np.ndarray, grid: PlaneGrid
) -> tuple[np.ndarray, str, float]:
    """Geometric field with the shadows of all rims, each scatterer's (or patch of the spot's) at its own place."""
    options, wavelength = assembly.options, assembly.beam.wavelength
    result = coherent_sum(path, sources, weights, grid, wavelength, options.method, options.tolerance)
    field = result.field.reshape(grid.shape).copy()
    groups = _groups(sources)
    lit = np.array([_lit_pixels(channel, sources[group].mean(axis=0), grid) for group in groups])
    edge = lit.any(axis=0) & ~lit.all(axis=0)
    field[~lit.all(axis=0)] = 0.0
    if np.any(edge):
        rows, columns = np.nonzero(edge)
        inside = lit[:, rows, columns]
        for group, seen in zip(groups, inside, strict=True):
            if not np.any(seen):
                continue
            places = PlanePoints(grid.origin, grid.u, grid.v, grid.pitch * columns[seen], grid.pitch * rows[seen])
            part = coherent_sum(path, sources[group], weights[group], places, wavelength, options.method, options.tolerance)
            field[rows[seen], columns[seen]] += part.field
    return field, f"{result.plan}; {1 - lit.all(axis=0).mean():.1%} of the pixels in full or partial shadow", result.numerical_error


def _groups(sources: np.ndarray) -> list[np.ndarray]:
    """Index arrays of scatterers that share a shadow: each alone, or patches of a lattice over the spot."""
    if len(sources) <= _SOURCES_WITH_OWN_SHADOW:
        return [np.array([k]) for k in range(len(sources))]
    centred = sources - sources.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1][:, ::-1][:, :2]
    place = centred @ axes
    side = int(np.sqrt(_SOURCES_WITH_OWN_SHADOW))
    span = np.ptp(place, axis=0)
    cell = np.minimum((place - place.min(axis=0)) / np.where(span > 0, span, 1) * side, side - 1).astype(int)
    label = cell[:, 0] * side + cell[:, 1]
    return [np.flatnonzero(label == value) for value in np.unique(label)]


def _lit_pixels(channel: Channel, source: np.ndarray, grid: PlaneGrid) -> np.ndarray:
    """Whether each pixel (rows, columns) is lit from one source (3,): no rim in the way, interpolated clearances."""
    place = chebyshev_nodes(_MARGIN_NODES)
    a, b = (0.5 * grid.pitch * (count - 1) * place for count in (grid.shape[1], grid.shape[0]))
    targets = (grid.centre + b[:, None, None] * grid.v + a[None, :, None] * grid.u).reshape(-1, 3)
    margins = _margins(channel, 0, len(channel.interactions), detector_plane(channel.grid), source, targets)
    rows, columns = (interpolation_matrix(_MARGIN_NODES, np.linspace(-1, 1, count)) for count in grid.shape)
    clearance = rows @ margins.reshape(-1, _MARGIN_NODES, _MARGIN_NODES) @ columns.T
    return np.all(clearance >= 0, axis=0)


def _lobe(
    assembly: Assembly, frame: Frame, middle: np.ndarray, channel: Channel, rim: Rim | None, places: PlaneGrid | PlanePoints
) -> np.ndarray | float:
    """Amplitude of the target's radiation along the rays from the spot's middle to places, 1.0 for even radiation."""
    if not assembly.target.lobe:
        return 1.0
    points = places.points()
    towards = points - middle
    if channel.leg(0):
        end = detector_plane(channel.grid) if rim is None else Interaction.through(Surface(rim.plane.frame), rim.index)
        towards = aim(Sequence((*channel.leg(0), end)), np.broadcast_to(middle, points.shape), points).launch
    amplitude = lobe_towards(assembly, frame, towards)
    return amplitude.reshape(places.shape) if isinstance(places, PlaneGrid) else amplitude
