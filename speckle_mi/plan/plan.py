"""Decides which stages a scene needs: free space, unfolded mirrors, traced elements, diffraction at openings.

For every route of the light the plan says where it is diffracted and over what each leg of the way goes. A stage that
a scene does not need is left out; the plan says so, in words that are printed and kept with every result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..geometry.plane import PlaneGrid
from ..optics.unfold import unfold
from ..propagation.coherent_sum import CERTAINTY
from ..propagation.opening_quadrature import MOST_NODES, estimated_nodes
from .setup import Setup
from ..scene.errors import SceneError
from .branches import branches_of, has_other_rays
from .cost import expected_scatterers, opening_cost
from .edges import SHARE, EdgeWave, all_affordable, chosen_edges, limiting_rims
from .fresnel import edge_wave, fresnel_parameter
from .gradients import phase_gradients
from .legs import onward_of, rays_over
from .opening_shadows import (
    hidden_pixels,
    is_summed_along_edge,
    rays_from_opening,
    rays_to_opening,
    shapes_between_openings,
    shapes_in_the_way,
    wave_on_opening,
)
from .relay import NEAR_CAUSTIC
from .routes import Route, find_routes
from .shadows import (
    HALF_LIT,
    WayRays,
    clearance_of_shapes,
    lit_pixels,
    rays_to_detector,
    wave_of_shadow,
)
from .stage import (
    BESIDE,
    CLEAR,
    CUT,
    DIFFRACTED,
    FREE_SPACE,
    LEFT_OUT,
    NO_WAY,
    NOT_DIFFRACTED,
    OTHER_WAY,
    RELAYED,
    SHADOWS,
    TRACED,
    UNFOLDED,
    WAY,
    Stage,
)
from .strength import Strength, reached_share, strength_of
from .way import Channel, PhaseGradient, Rim, rims_of, with_slack

_WEAK = 0.5
"""Amplitude of a way, relative to the strongest one's, up to which it is left out rather than the scene refused."""

_DETECTOR_SAMPLES = 9


@dataclass(frozen=True)
class Plan:
    """What is done for a scene. channels: one a route; stages: in order; warnings: one sentence each."""

    channels: tuple[Channel, ...]
    stages: tuple[Stage, ...]
    warnings: tuple[str, ...] = ()

    @property
    def left_out(self) -> float:
        """What ways that are left out amount to, relative to the field."""
        errors = [stage.predicted_error for stage in self.stages if stage.kind == OTHER_WAY]
        return float(np.sqrt(np.sum(np.square(errors))))

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
        nothing = "nothing stands between target and detector, no ray is launched"
        return Plan((free,), (Stage(FREE_SPACE, reason=nothing),))
    spots = setup.spots
    arrivals = find_routes(setup, spots)
    blocker = _main_blocker(arrivals.stopped)
    if not arrivals.routes:
        return Plan((), (Stage(NO_WAY, reason=blocker),), (f"no light reaches the detector: {blocker}",))
    bare = [branch for route in arrivals.routes for branch in branches_of(setup, _bare(setup, route))]
    strengths = [strength_of(setup, one) for one in bare]
    lit = arrivals.in_area and any(strength.lit for strength in strengths)
    channels, stages = _channels(setup, bare, strengths) if lit else ([_channel(setup, one) for one in bare], [])
    if arrivals.goes_on:
        stages.append(_further_ways(bare, strengths))
    stages = [*(stage for channel in channels for stage in channel.stages), *stages]
    warnings = tuple(f"{one.name}: {one.note}" for one in setup.assembly.elements if one.note)
    if not lit:
        stages.append(Stage(BESIDE))
        warnings += (f"no geometric light reaches the detector: {blocker}",)
    return Plan(tuple(channels), tuple(stages), warnings)


def _further_ways(bare: list[Channel], strengths: list[Strength]) -> Stage:
    """A stage on ways over more surfaces than are looked into, as between two mirrors that face each other.

    Their light falls as the inverse of the number n of surfaces: beyond N of them the sum of 1/n^2 is 1/N, so that
    they amount to sqrt(N) times those of N surfaces.
    """
    straight = max(strength.amplitude for strength in strengths)
    longest = max(len(channel.route.steps) for channel in bare)
    last = [s.amplitude for channel, s in zip(bare, strengths, strict=True) if len(channel.route.steps) == longest]
    error = min(1.0, float(np.sqrt(longest * np.sum(np.square(last)))) / straight)
    return Stage(OTHER_WAY, way=f"ways over more than {longest} surfaces", predicted_error=error)


def _is_devious(channel: Channel) -> bool:
    """Whether light is totally reflected inside a glass on a way, or twice inside a hollow mirror, one after the other.

    Nobody builds a sensor on that, and there is no end of it.
    """
    steps = channel.route.steps
    twice = any(a == b and a[2] == "reflect" for a, b in zip(steps, steps[1:], strict=False))
    return twice or any(interaction.reflects_inside for interaction in channel.route.interactions)


def _channels(setup: Setup, bare: list[Channel], strengths: list[Strength]) -> tuple[list[Channel], list[Stage]]:
    """The ways of straight light and those that count beside it, and stages that say what the others amount to.

    A way of diffracted light alone is left out where the edges throw less than a share of the tolerance on the
    detector, where no diffraction is asked for, or where its integral is not affordable or cannot be done; one of weak
    straight light where it cannot be done; light that is totally reflected inside a glass, as along the inside of a
    plate, beside light that is not.
    """
    options = setup.assembly.options
    straight = max(strength.amplitude for strength in strengths if strength.lit)
    plain = any(strength.lit and not _is_devious(one) for one, strength in zip(bare, strengths, strict=True))
    kept, stages = [], []
    for channel, strength in zip(bare, strengths, strict=True):
        share = strength.amplitude / straight
        if plain and _is_devious(channel):
            share *= reached_share(channel, setup.spots)
            stages.append(Stage(OTHER_WAY, way=channel.route.label, predicted_error=share))
        elif strength.lit:
            # Branches of one way may meet in a caustic, where none of them is weak.
            needed = share > _WEAK or len(channel.branches) > 1
            planned = _channel(setup, channel) if needed else _possible(setup, channel)
            if planned:
                kept.append(planned)
            else:
                stages.append(Stage(OTHER_WAY, way=channel.route.label, predicted_error=share))
        elif options.diffraction and options.method != "rays":
            counts = share > SHARE * options.tolerance and all_affordable(setup, channel, setup.spots)
            planned = _possible(setup, channel) if counts else None
            if planned:
                kept.append(planned)
            else:
                names = tuple(rim.name for rim in channel.rims if rim.is_screen)
                stages.append(Stage(OTHER_WAY, names, way=channel.route.label, predicted_error=share))
    return kept, stages


def _possible(setup: Setup, bare: Channel) -> Channel | None:
    """A way with what is done for it, None where it cannot be done or its openings need too many nodes."""
    try:
        channel = _channel(setup, bare)
    except SceneError:
        return None
    scatterers, pixels = expected_scatterers(setup.assembly), channel.grid.size
    if is_summed_along_edge(setup, channel, setup.spots, scatterers, pixels):
        return channel
    nodes = [
        estimated_nodes(rim.plane.outline, gradient.bound, gradient.tilt)
        for rim, gradient in zip(channel.openings, channel.gradients, strict=False)
    ]
    return channel if max(nodes, default=0.0) < 0.5 * MOST_NODES else None


def _main_blocker(stopped) -> str:
    elements = [(count, name) for name, count in stopped.items() if name not in ("nothing", "target")]
    if not elements:
        return "every test ray passes it by"
    return f"most test rays end at {max(elements)[1]!r}"


def _bare(setup: Setup, route: Route) -> Channel:
    """A route with plane mirrors unfolded, before anything is decided."""
    interactions, grid = unfold(with_slack(route.interactions), setup.assembly.detector)
    return Channel(route, interactions, grid, (), rims_of(setup.spot.point, route.names, interactions, grid.centre), ())


def _channel(setup: Setup, bare: Channel) -> Channel:
    route, interactions = bare.route, bare.interactions
    openings, decisions = _openings(setup, bare)
    stages = [Stage(WAY), *_unfolded(route)]
    traced = [name for name, i in zip(route.names, interactions) if i.bends]
    if traced:
        stages.append(Stage(TRACED, tuple(dict.fromkeys(traced))))
    stages += decisions
    channel = replace(bare, openings=openings)
    if openings and setup.assembly.options.method != "rays":
        channel = replace(channel, gradients=_gradients(setup, channel), onward=onward_of(setup, channel))
    to_opening = rays_to_opening(setup, channel) if openings else None
    if to_opening:
        cut_by = tuple(dict.fromkeys(shapes_in_the_way(setup, to_opening)))
        channel = replace(channel, hidden=hidden_pixels(setup, channel), cut_by=cut_by)
        if channel.gradients and channel.hidden is not None and np.all(channel.hidden):
            raise SceneError(_all_hidden(setup, channel))
    if setup.assembly.options.diffraction and setup.assembly.options.method != "rays":
        stages += _edges_beside(setup, channel, to_opening)
    left_out = [stage.predicted_error for stage in stages if stage.predicted_error is not None]
    return replace(
        channel,
        stages=tuple(replace(stage, way=route.label) for stage in stages),
        left_out=float(np.sqrt(np.sum(np.square(left_out)))),
    )


def _all_hidden(setup: Setup, channel: Channel) -> str:
    """Why a way cannot be computed behind whose last opening something hides a part of it from every pixel."""
    names = shapes_in_the_way(setup, rays_from_opening(setup, channel))
    what = " or ".join(repr(name) for name in dict.fromkeys(names) if name not in channel.route.names) or "a rim"
    return (
        f"way {channel.route.label}: {what} hides a part of {channel.openings[-1].name!r} from every pixel, and "
        "diffraction at its edge is not computed: make it wider, so that it blocks this way, or move it out of it"
    )


def _gradients(setup: Setup, channel: Channel) -> tuple[PhaseGradient, ...]:
    """How steep the light's phase is over every opening. Raises SceneError where no light leads over one."""
    try:
        tolerance = setup.assembly.options.tolerance / (len(channel.openings) + 1)
        return phase_gradients(channel, setup.spots, setup.assembly.beam.wavelength, tolerance)
    except InputError as error:
        raise SceneError(
            f"way {channel.route.label}: {error}; "
            "put a smaller stop, or set diffraction to false where there is no focus"
        ) from None


def _edges_beside(setup: Setup, channel: Channel, to_opening: WayRays | None) -> list[Stage]:
    """A stage on shapes that stand close to a way, or none; diffraction is computed only where light goes through.

    A shape that cuts the light casts its geometric shadow, on the first opening or, of a way without openings, on the
    detector, and the wave of its edge is stated. Raises SceneError where one cuts the light between openings.
    to_opening: rays to the first opening, None for a way without.
    """
    spots = setup.spots
    if to_opening:
        if names := shapes_between_openings(setup, channel):
            named = " or ".join(map(repr, dict.fromkeys(names)))
            raise SceneError(
                f"way {channel.route.label}: {named} cuts a part of its light behind an opening, and the diffraction "
                "at that edge is not computed: put an aperture with the free part as its hole in its place, move it "
                "out of the light, or set diffraction to false for its geometric shadow"
            )
        if channel.cut_by:
            return [Stage(CUT, channel.cut_by, predicted_error=wave_on_opening(setup, channel))]
        return _wave_beside(setup, to_opening)
    rays = rays_to_detector(channel, spots)
    names = rays.part.shapes_beside(setup, rays.points)
    lit = np.array([*lit_pixels(setup, channel, spots, channel.grid, rims=False)] if names else [])
    if names and not np.any(lit):
        return []  # hidden altogether: stays dark
    if names and not np.all(lit):
        length = float(np.linalg.norm(channel.grid.centre - spots[0]))
        step = fresnel_parameter(channel.grid.pitch, length, setup.assembly.beam.wavelength)
        return [Stage(CUT, tuple(dict.fromkeys(names)), predicted_error=wave_of_shadow(lit, step))]
    return _wave_beside(setup, rays)


def _wave_beside(setup: Setup, rays: WayRays) -> list[Stage]:
    """A stage on the wave of the nearest edge of shapes beside rays that all go free; none where it does not count."""
    enough = SHARE * setup.assembly.options.tolerance
    v, names = clearance_of_shapes(setup, rays, lambda v: edge_wave(v) > enough)
    if not names:
        return []
    return [Stage(LEFT_OUT, tuple(dict.fromkeys(names)), predicted_error=min(HALF_LIT, float(edge_wave(v))))]


def _unfolded(route: Route) -> list[Stage]:
    mirrors = [name for name, i in zip(route.names, route.interactions) if i.action == "reflect" and i.surface.is_plane]
    return [Stage(UNFOLDED, tuple(mirrors))] if mirrors else []


# Which openings limit the light


def _openings(setup: Setup, channel: Channel) -> tuple[tuple[Rim, ...], list[Stage]]:
    """The openings to diffract at, and the stages that say so and why."""
    if not channel.rims:
        return (), [_without_rims(setup, channel)]
    why_not = _why_not_geometric(setup, channel)
    options = setup.assembly.options
    if not options.diffraction:
        if why_not:
            raise SceneError(
                f"way {channel.route.label}: {why_not}, so that the geometric field which diffraction=false asks for "
                "does not exist all over it: set diffraction to true with an aperture in this way, block the way, or "
                "move the detector"
            )
        return (), [Stage(SHADOWS, reason="as diffraction=false asks for")]
    first = _first_opening(setup, channel, why_not) if why_not else []
    relayed, waves = chosen_edges(setup, channel, setup.spots, first)
    chosen = relayed.openings
    if options.method == "rays":
        names = tuple(rim.name for rim in chosen)
        return chosen, [Stage(SHADOWS, names, reason="as rays are not diffracted")]
    diffracting = tuple(rim.name for rim in chosen if rim not in relayed.windows)
    stages = [Stage(DIFFRACTED, diffracting)] if diffracting else []
    if relayed.windows:
        names = tuple(rim.name for rim in relayed.windows)
        stages.append(Stage(RELAYED, names))
    left = max(waves, key=lambda one: one.wave, default=None)
    if left is not None and left.wave > 0:
        total = min(1.0, CERTAINTY * float(np.sqrt(sum(one.wave**2 for one in waves))))
        reason = (
            f"the nearest edge, of {left.rim.name}, is clear of the light "
            f"(the edges' waves are at most about {100 * total:.2g}% of the field{_what_it_takes(setup, left)})"
        )
        kind = CLEAR if chosen else NOT_DIFFRACTED
        stages.append(Stage(kind, (left.rim.name,), reason=reason, predicted_error=total))
    elif not chosen:
        stages.append(Stage(NOT_DIFFRACTED, reason="no edge lies in the light"))
    return chosen, stages


def _what_it_takes(setup: Setup, left: EdgeWave) -> str:
    """What diffraction at an edge would cost that is left out although it counts; empty where it does not count."""
    tolerance = setup.assembly.options.tolerance
    if not np.isfinite(left.v) or left.wave <= SHARE * tolerance:
        return ""
    nodes = estimated_nodes(left.rim.plane.outline, left.steepness)
    return (
        f"; diffraction at it would take {opening_cost(setup.assembly, nodes)} or more, a tolerance of "
        f"{_rounded_up(left.wave / SHARE)} does without"
    )


def _rounded_up(value: float) -> str:
    """A figure of two digits that is not below ``value``."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.ceil(value / unit) * unit:.2g}"


def _first_opening(setup: Setup, channel: Channel, why: str) -> list[Rim]:
    """The opening that limits the light where geometric optics does not hold on the detector."""
    limiting = limiting_rims(setup.spot.point, channel)
    if not limiting:
        raise SceneError(f"way {channel.route.label}: {why} but no opening limits the light: put an aperture")
    return ([rim for rim in limiting if rim.is_screen] or limiting)[:1]


def _without_rims(setup: Setup, channel: Channel) -> Stage:
    if not channel.interactions:
        return Stage(FREE_SPACE, reason="the light meets nothing on this way")
    if why_not := _why_not_geometric(setup, channel):
        raise SceneError(f"way {channel.route.label}: {why_not} but no opening limits the light: put an aperture")
    return Stage(NOT_DIFFRACTED, reason="no edge lies on this way")


def _detector_samples(grid: PlaneGrid) -> np.ndarray:
    side = -np.cos(np.pi * (np.arange(_DETECTOR_SAMPLES) + 0.5) / _DETECTOR_SAMPLES)
    a, b = (values.ravel() for values in np.meshgrid(side, side))
    half_u, half_v = grid.half_size
    return grid.centre + (half_u * a)[:, None] * grid.u + (half_v * b)[:, None] * grid.v


def _why_not_geometric(setup: Setup, channel: Channel) -> str:
    """Why geometric optics does not hold all over the detector, empty where it does.

    It holds where every pair of places on spot and detector has exactly one ray, clear of a caustic.
    """
    aimed = rays_over(channel, None, None, setup.spots, _detector_samples(channel.grid), rims=True)
    found = aimed.converged
    focused = np.any(found) and (np.min(aimed.spread[found]) < NEAR_CAUSTIC or np.ptp(aimed.caustics[found]) > 0)
    if focused or not np.any(found):
        return "a focus or caustic lies at the detector"
    if not np.all(found):
        return "rays reach only a part of the detector (the way ends at a surface's edge or at total reflection)"
    if channel.has_power and has_other_rays(setup, channel):
        return "several rays reach the same pixel, inside a caustic,"
    return ""
