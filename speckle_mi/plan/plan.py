"""Decides which stages a scene needs: free space, unfolded mirrors, traced elements, diffraction at openings.

For every route of the light the plan says where it is diffracted and over what each leg of the way goes. A stage that
a scene does not need is left out; the plan says so, in words that are printed and kept with every result.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..geometry.outline import Circle
from ..geometry.plane import PlaneGrid
from ..optics.aim import aim
from ..optics.sequence import Sequence, detector_plane
from ..optics.surface import Surface
from ..optics.trace import RayStatus, trace
from ..optics.unfold import unfold
from .setup import Setup
from ..scene.errors import SceneError
from .routes import Route, find_routes, points_on
from .shadows import clearance_of_shapes, hidden_pixels, lit_pixels, shapes_before, shapes_beside_way
from .stage import (
    BESIDE,
    DIFFRACTED,
    FREE_SPACE,
    LEFT_OUT,
    NO_WAY,
    NOT_DIFFRACTED,
    SHADOWS,
    TRACED,
    UNFOLDED,
    WAY,
    Stage,
)
from .way import Channel, Rim, rims_of

CLEAR_OF_EDGE = 25.0
"""Fresnel parameter v of the nearest edge from which on it is not diffracted at: a straight edge's wave is then below
1 %."""

_CLEARANCES = (1.5, 3.0, 6.0, 12.0, CLEAR_OF_EDGE)
"""Fresnel parameters at which is looked for shapes beside the light; nearer than the first they cut it."""

NEAR_CAUSTIC = 1e-3
"""Cross section of a ray tube, relative to free space, below which geometric optics does not apply."""

_SAME_RAY = 1e-6
"""Angle [rad] up to which two rays to one place are the same."""

_RIM_POINTS = 48
_DETECTOR_SAMPLES = 9
_INSIDE_RIM = 1 - 1e-6

_LIMITING_SHARE = 0.01
"""Share of an opening's rim that must be the edge of the light for the opening to count as limiting it."""


@dataclass(frozen=True)
class Plan:
    """What is done for a scene. channels: one a route; stages: in order; warnings: one sentence each."""

    channels: tuple[Channel, ...]
    stages: tuple[Stage, ...]
    warnings: tuple[str, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """The stages in words."""
        return tuple(map(str, self.stages))


def make_plan(setup: Setup) -> Plan:
    """The plan for a scene with its target at a pose.

    Raises SceneError where the field cannot be computed as asked: geometric light at a caustic, or no opening that
    limits the light in a system with a focus on the detector.
    """
    if not setup.assembly.elements:
        free = Channel(Route((), (), 0), (), setup.assembly.detector, (), (), ())
        return Plan((free,), (Stage(FREE_SPACE, reason="nothing stands between target and detector, no ray is launched"),))
    arrivals = find_routes(setup, _spot_samples(setup))
    if not arrivals.routes:
        blocker = _main_blocker(arrivals.stopped)
        return Plan((), (Stage(NO_WAY, reason=blocker),), (f"no light reaches the detector: {blocker}",))
    channels = tuple(_channel(setup, route) for route in arrivals.routes)
    stages = [stage for channel in channels for stage in channel.stages]
    if arrivals.in_area:
        return Plan(channels, tuple(stages))
    blocker = _main_blocker(arrivals.stopped)
    stages.append(Stage(BESIDE))
    return Plan(channels, tuple(stages), (f"no geometric light reaches the detector: {blocker}",))


def _main_blocker(stopped) -> str:
    elements = [(count, name) for name, count in stopped.items() if name not in ("nothing", "target")]
    if not elements:
        return "every test ray passes it by"
    return f"most test rays end at {max(elements)[1]!r}"


def _channel(setup: Setup, route: Route) -> Channel:
    interactions, grid = unfold(route.interactions, setup.assembly.detector)
    rims = rims_of(setup.spot.point, route.names, interactions)
    bare = Channel(route, interactions, grid, (), rims, ())
    openings, decision = _openings(setup, bare)
    stages = [Stage(WAY), *_unfolded(route)]
    traced = [name for name, i in zip(route.names, interactions) if i.action != "pass"]
    if traced:
        stages.append(Stage(TRACED, tuple(dict.fromkeys(traced))))
    stages.append(decision)
    channel = replace(bare, openings=openings)
    if openings:
        channel = replace(channel, hidden=hidden_pixels(setup, channel))
    if setup.assembly.options.diffraction and setup.assembly.options.method != "rays":
        stages += _edges_beside(setup, channel, _spot_samples(setup))
    return replace(channel, stages=tuple(replace(stage, way=route.label) for stage in stages))


def _edges_beside(setup: Setup, channel: Channel, spots: np.ndarray) -> list[Stage]:
    """A stage on shapes that stand close to a way, or none; diffraction is computed only where light goes through.

    Raises SceneError where such a shape cuts the light.
    """
    wave = 1.0
    if channel.openings:
        names = shapes_before(setup, channel, spots)
    else:
        names = shapes_beside_way(setup, channel, spots)
        lit = np.array([*lit_pixels(setup, channel, spots, channel.grid, rims=False)] if names else [])
        if names and not np.any(lit):
            return []  # hidden altogether: stays dark
        if np.all(lit):
            v, names = clearance_of_shapes(setup, channel, spots, _CLEARANCES)
            wave = 1 / (np.pi * np.sqrt(2) * v) if v > 0 else 1.0
    if not names:
        return []
    named = " or ".join(map(repr, dict.fromkeys(names)))
    if wave == 1.0:
        raise SceneError(
            f"way {channel.route.label}: {named} cuts a part of its light, and the diffraction at that edge is not "
            "computed: put an aperture with the free part as its hole in its place, move it out of the light, or set "
            "diffraction to false for its geometric shadow"
        )
    return [Stage(LEFT_OUT, tuple(dict.fromkeys(names)), predicted_error=wave)]


def _unfolded(route: Route) -> list[Stage]:
    mirrors = [name for name, i in zip(route.names, route.interactions) if i.action == "reflect" and i.surface.is_plane]
    return [Stage(UNFOLDED, tuple(mirrors))] if mirrors else []


# Which openings limit the light


def _openings(setup: Setup, channel: Channel) -> tuple[tuple[Rim, ...], Stage]:
    """The openings to diffract at, and the stage that says so and why."""
    if not channel.rims:
        return (), _without_rims(setup, channel)
    geometric, why_not = _geometric_view(setup, channel)
    if not setup.assembly.options.diffraction:
        if geometric is None:
            raise SceneError(
                f"way {channel.route.label}: {why_not}, so that the geometric field which diffraction=false asks for "
                "does not exist all over it: set diffraction to true with an aperture in this way, block the way, or "
                "move the detector"
            )
        return (), Stage(SHADOWS, reason="as diffraction=false asks for")
    if geometric is not None:
        fringe, waves = np.array([_edge_wave(setup, channel, rim, geometric) for rim in channel.rims]).T
        if np.all(fringe >= CLEAR_OF_EDGE):
            nearest = channel.rims[int(np.argmin(fringe))]
            wave = float(waves.max())
            reason = (
                f"the nearest edge, of {nearest.name}, is clear of the light "
                f"(the edges' waves are about {wave:.1%} of the field)"
            )
            return (), Stage(NOT_DIFFRACTED, reason=reason, predicted_error=wave)
        candidates = [rim for rim, v in zip(channel.rims, fringe) if v < CLEAR_OF_EDGE]
    else:
        candidates = list(channel.rims)
    limiting = _limiting(setup.spot.point, channel, candidates)
    if not limiting:
        if geometric is not None:
            return (), Stage(NOT_DIFFRACTED, reason="no edge lies in the light")
        raise SceneError(f"way {channel.route.label}: {why_not} but no opening limits the light: put an aperture")
    screens = [rim for rim in limiting if rim.is_screen]
    if channel.has_power:
        # Between curved surfaces one opening is enough: the others clip its nodes as geometric shadows.
        chosen = (screens or limiting)[:1]
    else:
        chosen = sorted(limiting, key=lambda rim: rim.position)
    names = tuple(rim.name for rim in chosen)
    clipping = [rim.name for rim in limiting if rim not in chosen]
    if setup.assembly.options.method == "rays":
        return tuple(chosen), Stage(SHADOWS, names, reason="as rays are not diffracted")
    note = f"shadows of {', '.join(dict.fromkeys(clipping))} fall on it" if clipping else ""
    return tuple(chosen), Stage(DIFFRACTED, names, reason=note)


def _without_rims(setup: Setup, channel: Channel) -> Stage:
    if not channel.interactions:
        return Stage(FREE_SPACE, reason="the light meets nothing on this way")
    geometric, why_not = _geometric_view(setup, channel)
    if geometric is None:
        raise SceneError(f"way {channel.route.label}: {why_not} but no opening limits the light: put an aperture")
    return Stage(NOT_DIFFRACTED, reason="no edge lies on this way")


def _spot_samples(setup: Setup) -> np.ndarray:
    """The spot's middle and points around it as far as it is summed, (n, 3)."""
    target = setup.assembly.target
    if target.points is not None:
        places = setup.frame.to_world(target.points.points)
        return np.unique(
            np.concatenate([places.mean(axis=0)[None], places[np.argmax(places, 0)], places[np.argmin(places, 0)]]),
            axis=0,
        )
    size = setup.assembly.beam.cutoff if np.isfinite(setup.assembly.beam.radius) else np.inf
    size = min(size, 0.5 * float(np.ptp(target.surface.facets.bounds)))
    spot = setup.spot.point
    return np.array([spot, *(spot + size * sign * setup.frame.axes[:, k] for k in (0, 1) for sign in (-1, 1))])


def _detector_samples(grid: PlaneGrid) -> np.ndarray:
    side = -np.cos(np.pi * (np.arange(_DETECTOR_SAMPLES) + 0.5) / _DETECTOR_SAMPLES)
    a, b = (values.ravel() for values in np.meshgrid(side, side))
    half_u, half_v = grid.half_size
    return grid.centre + (half_u * a)[:, None] * grid.u + (half_v * b)[:, None] * grid.v


@dataclass(frozen=True)
class _View:
    """Rays from every sample of the spot to every sample of the detector: points (s, n, 3) at every interaction."""

    sources: np.ndarray
    targets: np.ndarray
    points: np.ndarray = field(repr=False)


def _geometric_view(setup: Setup, channel: Channel) -> tuple[_View | None, str]:
    """The rays from spot to detector; None and the reason where not every pair has exactly one, clear of a caustic."""
    sequence = Sequence((*channel.interactions, detector_plane(channel.grid)))
    spots, pixels = _spot_samples(setup), _detector_samples(channel.grid)
    sources, targets = np.repeat(spots, len(pixels), axis=0), np.tile(pixels, (len(spots), 1))
    aimed = aim(sequence, sources, targets)
    lost = aimed.status[~aimed.converged]
    found = aimed.converged
    focused = np.any(found) and (np.min(aimed.spread[found]) < NEAR_CAUSTIC or np.ptp(aimed.caustics[found]) > 0)
    if focused or (len(lost) and not np.any(found)):
        return None, "a focus or caustic lies at the detector"
    if len(lost):
        return None, "rays reach only a part of the detector (the way ends at a surface's edge or at total reflection)"
    if channel.has_power and _several_rays(channel, spots[0]):
        return None, "several rays reach the same pixel, inside a caustic,"
    traced = trace(sequence, sources, aimed.launch)
    return _View(sources, targets, traced.points), ""


def _several_rays(channel: Channel, spot: np.ndarray) -> bool:
    """Whether a fan of rays from the spot's middle finds a second ray to a pixel, besides the one aimed at it."""
    fan = points_on(channel.interactions[0].surface) - spot
    sequence = Sequence((*channel.interactions, detector_plane(channel.grid)))
    traced = trace(sequence, np.broadcast_to(spot, fan.shape), fan)
    grid, end = channel.grid, traced.points[-1] - channel.grid.centre
    half_u, half_v = grid.half_size
    lands = traced.valid & (np.abs(end @ grid.u) <= half_u) & (np.abs(end @ grid.v) <= half_v)
    if not np.any(lands):
        return False
    places = traced.points[-1, lands]
    aimed = aim(sequence, np.broadcast_to(spot, places.shape), places)
    directions = fan[lands] / np.linalg.norm(fan[lands], axis=1, keepdims=True)
    apart = np.linalg.norm(aimed.launch - directions, axis=1)
    return bool(np.any(apart[aimed.converged] > _SAME_RAY))


def _edge_wave(setup: Setup, channel: Channel, rim: Rim, view: _View) -> tuple[float, float]:
    """How far the rays keep from a rim, and how strong its wave is on the detector, relative to the field.

    The first is the smallest Fresnel parameter v = d sqrt(2 / (lambda L)) of a ray's distance d to the rim, negative
    outside it; 1/L is the curvature at the rim's plane of the path over it, that is of its two parts together. The wave
    of a straight edge is 1/(pi sqrt(2) v) of the field; those of all parts of a round rim of radius R, seen over a
    point at the distance r from its middle, add up to J0(k R r / L), of which the rms is taken.
    """
    hit = rim.plane.frame.to_local(view.points[rim.number])
    clearance = rim.plane.outline.clearance(hit[:, 0], hit[:, 1])
    nearest = int(np.argmin(clearance))
    pair = slice(nearest, nearest + 1)
    curvature = _curvature_over(channel, rim, view.sources[pair], view.targets[pair], view.points[rim.number, pair])
    v = float(clearance[nearest] * np.sqrt(2 * abs(curvature) / setup.assembly.beam.wavelength))
    wave = 1 / (np.pi * np.sqrt(2) * v) if v > 0 else 1.0
    if isinstance(rim.plane.outline, Circle):
        turns = setup.assembly.beam.wavenumber * rim.plane.outline.radius * np.hypot(hit[:, 0], hit[:, 1]) * abs(curvature)
        with np.errstate(divide="ignore"):
            wave = max(wave, float(np.sqrt(np.mean(np.minimum(1.0, 2 / (np.pi * turns))))))
    return v, wave


def _curvature_over(channel: Channel, rim: Rim, source: np.ndarray, target: np.ndarray, hit: np.ndarray) -> float:
    """Smallest curvature [1/mm] of the path source - point of the rim's plane - target around the ray's own point."""
    frame = rim.plane.frame
    local = frame.to_local(hit)
    middle = frame.to_world(local * [1, 1, 0])
    step = 1e-2 * min(rim.plane.outline.half_size)
    offsets = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) * step
    places = middle + offsets[:, :1] * frame.axes[:, 0] + offsets[:, 1:] * frame.axes[:, 1]
    length = np.zeros(len(places))
    for piece, reverse in _halves(channel, rim):
        ends = np.broadcast_to(target if reverse else source, places.shape)
        if reverse:
            aimed = aim(piece, places, ends)
        else:
            aimed = aim(piece, ends, places)
        length += aimed.optical_path_length
    second = [(length[k] + length[k + 1] - 2 * length[0]) / step**2 for k in (1, 3)]
    return float(np.nanmin(np.abs(second))) if np.any(np.isfinite(second)) else 0.0


def _halves(channel: Channel, rim: Rim) -> list[tuple[Sequence, bool]]:
    before = tuple(i for i in channel.interactions[: rim.position] if i.action != "pass")
    after = tuple(i for i in channel.interactions[rim.position :] if i.action != "pass")
    return [(Sequence((*before, rim.end)), False), (Sequence((*after, detector_plane(channel.grid))), True)]


def _limiting(spot: np.ndarray, channel: Channel, candidates: list[Rim]) -> list[Rim]:
    """Those rims that are the edge of the light from the spot's middle, the most limiting first."""
    sequence = Sequence((*channel.interactions, detector_plane(channel.grid)))
    shares = []
    for rim in candidates:
        places = _rim_points(rim.plane)
        before = tuple(i for i in channel.interactions[: rim.position] if i.action != "pass")
        source = np.broadcast_to(spot, places.shape)
        aimed = aim(Sequence((*before, rim.end)), source, places)
        reached = aimed.converged
        free = np.zeros(len(places), dtype=bool)
        if np.any(reached):
            traced = trace(sequence, source[reached], aimed.launch[reached])
            alive = traced.status <= RayStatus.OUTSIDE_OUTLINE
            free[reached] = alive & np.all(traced.margins >= -1e-4, axis=0)
        shares.append(np.mean(free))
    order = np.argsort(shares, kind="stable")[::-1]
    return [candidates[k] for k in order if shares[k] > _LIMITING_SHARE]


def _rim_points(plane: Surface) -> np.ndarray:
    """World points (n, 3) just inside an outline."""
    angle = 2 * np.pi * (np.arange(_RIM_POINTS) + 0.5) / _RIM_POINTS
    x, y = plane.outline.edge(angle)
    return plane.frame.to_world(_INSIDE_RIM * np.stack([x, y, 0 * x], axis=1))
