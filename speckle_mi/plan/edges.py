"""At which edges light is diffracted, and how strong the waves of those are that are left out.

Between the spot, the openings that are diffracted at and the detector lie the rims of all other elements. The light
keeps off a rim by a Fresnel parameter v = d sqrt(2 / (lambda L)), d the distance of a ray from it and 1/L the curvature
there of the path over it: the wave of a straight edge is 1/(pi sqrt(2) v) of the field. A rim whose wave counts is
diffracted at where the integral over it is affordable; else the wave is stated as an error of the field.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.outline import Circle
from ..geometry.pairs import all_pairs
from ..optics.aim import aim
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.trace import RayStatus, trace
from ..optics.wavefront import arriving_curvature, leaving_curvature
from ..propagation.opening_quadrature import estimated_nodes
from .cost import expected_scatterers, rim_seconds
from .fresnel import edge_wave, fresnel_distance, fresnel_parameter
from .gradients import phase_gradient
from .legs import LightOver, leg, light_over, rays_over, straight_on
from .places import detector_places, hole_places
from .relay import Relayed, with_windows
from .setup import Setup
from .way import Channel, PhaseGradient, Rim

CUTS = 1.5
"""Fresnel parameter of the nearest ray below which a rim cuts into the light: no share of its wave says how much."""

SHARE = 0.3
"""Part of the tolerance that the wave of an edge may have and still be left out."""

AFFORDABLE_NODES, AFFORDABLE_SECONDS = 500_000, 2.0
"""Nodes, or seconds along its edge, up to which a rim that only touches the light is diffracted at."""

CERTAINLY_TOO_MANY = 4 * AFFORDABLE_NODES
"""Nodes by the bend of the light alone from which on no closer look is needed."""

_HOLE_SHARES, _HOLE_ANGLES = (0.0, 0.5, 1.0), 8

_RIM_POINTS = 48
_INSIDE_RIM = 1 - 1e-6
_LIMITING_SHARE = 0.01
"""Share of an opening's rim that must be the edge of the light for the opening to count as limiting it."""

_IN_PLANE = 1e-6
"""Distance [mm] of a rim's plane from where the light comes from or goes to within which no wave has room to spread."""


@dataclass(frozen=True)
class EdgeWave:
    """Of a rim: v, smallest Fresnel parameter, negative where rays lie outside; wave on the detector over the field.

    steepness: at least, of the light's phase over the rim's plane [rad/mm].
    """

    rim: Rim
    v: float
    wave: float
    steepness: float = 0.0


def chosen_edges(
    setup: Setup, channel: Channel, spots: np.ndarray, first: list[Rim]
) -> tuple[Relayed, tuple[EdgeWave, ...]]:
    """The rims to diffract at with windows between them, in order, and the waves of those that are left out.

    spots: (m, 3) places that stand for the spot; first: rims that are diffracted at in any case.
    """
    openings = list(first)
    unaffordable: set[int] = set()
    alone: Rim | None = None
    light: dict[tuple, _Light] = {}
    over: dict[Rim | None, LightOver | None] = {None: None}
    known: dict[tuple, EdgeWave] = {}
    windowed: dict[tuple[Rim, ...], Relayed] = {}

    def relayed_at(rims: list[Rim]) -> Relayed:
        key = tuple(sorted(rims, key=lambda rim: rim.position))
        if key not in windowed:
            windowed[key] = with_windows(setup, channel, list(key), spots)
        return windowed[key]

    def wave(rim: Rim, before: Rim | None, after: Rim | None) -> EdgeWave:
        if (before, after) not in light:
            light[before, after] = _light_between(channel, before, after, spots)
        if (rim, before, after) not in known:
            if before not in over:
                holes = hole_places(before.plane, (0.0, 1.0), 6)
                over[before] = light_over(channel, None, spots, before, holes)
            between = light[before, after], over[before]
            known[rim, before, after] = _edge_wave(setup, channel, rim, before, after, *between, spots)
        return known[rim, before, after]

    while True:
        relayed = relayed_at(openings)
        chosen = list(relayed.openings)
        rest = [rim for rim in channel.rims if rim.number not in {one.number for one in chosen}]
        waves = [_between_rims(setup, channel, rim, twin) if (twin := _twin(chosen, rim)) is not None
                 else wave(rim, *_neighbours(chosen, rim)) for rim in rest]  # fmt: skip
        wanted = [one for one in waves if _counts(setup, one)
                  and (one.v < CUTS or one.rim.number not in unaffordable)]  # fmt: skip
        if not wanted:
            return relayed, tuple(waves)
        # A stop keeps the light off the rims of glasses: what these do is asked again once the stop is chosen.
        nearest = min(wanted, key=lambda one: (one.v >= CUTS and not one.rim.is_screen, one.v))
        too_steep = estimated_nodes(nearest.rim.plane.outline, nearest.steepness) > CERTAINLY_TOO_MANY
        if nearest.v < CUTS or (not too_steep and _is_affordable(
            setup, channel, nearest.rim, relayed_at([*openings, nearest.rim]).openings, spots)):
            if alone is not None:  # it could be afforded only as long as there was no other
                openings.remove(alone)
                unaffordable.add(alone.number)
                alone = None
            openings.append(nearest.rim)
        elif not chosen and _is_affordable_alone(setup, channel, nearest.rim, spots):
            alone = nearest.rim
            openings.append(alone)
        else:
            unaffordable.add(nearest.rim.number)


def _twin(chosen: list[Rim], rim: Rim) -> Rim | None:
    """The chosen rim of the same glass's other face, which is one pupil with this one."""
    return next((one for one in chosen if not rim.is_screen and one.name == rim.name
                 and abs(one.number - rim.number) == 1 and one.plane.outline == rim.plane.outline), None)  # fmt: skip


def _between_rims(setup: Setup, channel: Channel, rim: Rim, twin: Rim) -> EdgeWave:
    """What the second rim of a glass does to light that the first has cut, along a seam of width s = sqrt(lambda t/2).

    t is the distance of the two. Of the field in the pupil that is about a third of the root of the seam's share of the
    area; it spreads over angles of lambda/s, of which the detector takes its part. The rim casts a geometric shadow.
    """
    apart = float(np.linalg.norm(rim.plane.frame.origin - twin.plane.frame.origin))
    seam = fresnel_distance(1.0, apart, setup.assembly.beam.wavelength)
    in_pupil = np.sqrt(2 * seam / min(rim.plane.outline.half_size)) / 3
    distance = float(np.linalg.norm(channel.grid.centre - rim.plane.frame.origin))
    spread = setup.assembly.beam.wavelength / max(seam, 1e-300) * distance
    taken = min(1.0, 2 * max(channel.grid.half_size) / spread)
    return EdgeWave(rim, np.inf, float(min(1.0, in_pupil * np.sqrt(taken))))


def limiting_rims(spot: np.ndarray, channel: Channel) -> list[Rim]:
    """Those rims that are the edge of the light from the spot's middle, the most limiting first."""
    sequence = Sequence((*channel.interactions, detector_plane(channel.grid)))
    shares = []
    for rim in channel.rims:
        places = _rim_points(rim, _RIM_POINTS)
        source = np.broadcast_to(spot, places.shape)
        before, end = leg(channel, None, rim)
        aimed = aim(Sequence((*before, end)), source, places)
        reached = aimed.converged
        free = np.zeros(len(places), dtype=bool)
        if np.any(reached):
            traced = trace(sequence, source[reached], aimed.launch[reached])
            alive = traced.status <= RayStatus.OUTSIDE_OUTLINE
            free[reached] = alive & np.all(traced.margins >= -1e-4, axis=0)
        shares.append(np.mean(free))
    order = np.argsort(shares, kind="stable")[::-1]
    return [channel.rims[k] for k in order if shares[k] > _LIMITING_SHARE]


def _counts(setup: Setup, one: EdgeWave) -> bool:
    return one.v < CUTS or (np.isfinite(one.v) and one.wave > SHARE * setup.assembly.options.tolerance)


def _is_affordable(setup: Setup, channel: Channel, rim: Rim, chosen: Iterable[Rim], spots: np.ndarray) -> bool:
    """Whether a rim can be diffracted at beside the other chosen ones."""
    others = [one for one in chosen if one is not rim]
    gradient = _sampled_gradient(setup, channel, rim, *_neighbours(others, rim), spots)
    return gradient is not None and (
        estimated_nodes(rim.plane.outline, gradient.bound, gradient.tilt) <= AFFORDABLE_NODES
    )


def _is_affordable_alone(setup: Setup, channel: Channel, rim: Rim, spots: np.ndarray) -> bool:
    """Whether the integral along a rim is affordable, as the only one on its way and with only space around it."""
    (leading, _), (trailing, _) = leg(channel, None, rim), leg(channel, rim, None)
    if leading or trailing or setup.assembly.target.lobe is not None:
        return False
    gradient = _sampled_gradient(setup, channel, rim, None, None, spots)
    scatterers, pixels = expected_scatterers(setup.assembly), channel.grid.size
    return gradient is not None and rim_seconds(rim, gradient, scatterers, pixels) <= AFFORDABLE_SECONDS


def _sampled_gradient(
    setup: Setup, channel: Channel, rim: Rim, before: Rim | None, after: Rim | None, spots: np.ndarray
) -> PhaseGradient | None:
    """The phase gradient over a rim between two openings as sampled coarsely; None where no ray leads over it."""
    ends = _ends(channel, before, spots), _ends(channel, after, None)
    try:
        return phase_gradient(channel, rim, before, after, *ends, setup.assembly.beam.wavelength, 1.0)
    except InputError:
        return None


def all_affordable(setup: Setup, channel: Channel, spots: np.ndarray) -> bool:
    """Whether a way over openings alone can be diffracted at all of them."""
    screens = sorted((rim for rim in channel.rims if rim.is_screen), key=lambda rim: rim.position)
    if len(screens) == 1 and _is_affordable_alone(setup, channel, screens[0], spots):
        return True
    return all(_is_affordable(setup, channel, rim, screens, spots) for rim in screens)


def _neighbours(chosen: list[Rim], rim: Rim) -> tuple[Rim | None, Rim | None]:
    """The chosen rims before and behind a rim."""
    earlier = [one for one in chosen if (one.position, one.number) < (rim.position, rim.number)]
    later = [one for one in chosen if (one.position, one.number) > (rim.position, rim.number)]
    return (earlier[-1] if earlier else None), (later[0] if later else None)


def _ends(channel: Channel, rim: Rim | None, spots: np.ndarray | None) -> np.ndarray:
    """Places on an opening, or (None) on the spot or the detector."""
    if rim is not None:
        return hole_places(rim.plane, _HOLE_SHARES, _HOLE_ANGLES)
    return detector_places(channel.grid) if spots is None else spots


@dataclass(frozen=True)
class _Light:
    """Rays from places on one opening, or the spot, to places on the next, or the detector.

    starts, launch: (n, 3); places: (s, n, 3) of the starts, of what they meet between, and of the ends.
    """

    starts: np.ndarray
    launch: np.ndarray
    places: np.ndarray

    def hits(self, rim: Rim, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the rays cross a rim's plane behind their ``number``-th face, and their unit directions there, (n, 3).

        Rays that go no way between the faces cross it where they are, in no direction (NaN).
        """
        start, along = self.places[number], self.places[number + 1] - self.places[number]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        direction = along / np.where(length > _IN_PLANE, length, np.nan)
        frame = rim.plane.frame
        ahead = (frame.origin - start) @ frame.axes[:, 2] / (direction @ frame.axes[:, 2])
        return np.where(np.isfinite(ahead[:, None]), start + ahead[:, None] * direction, start), direction


def _light_between(channel: Channel, before: Rim | None, after: Rim | None, spots: np.ndarray) -> _Light:
    """The rays that there are from one opening to the next, without the rims between them."""
    sources, targets = _ends(channel, before, spots), _ends(channel, after, None)
    aimed = rays_over(channel, before, after, sources, targets)
    starts, launch = all_pairs(sources, targets)[0][aimed.converged], aimed.launch[aimed.converged]
    faces, end = leg(channel, before, after)
    met = trace(Sequence((*faces, end)), starts, launch).points
    return _Light(starts, launch, np.concatenate([starts[None], met]))


def _edge_wave(
    setup: Setup, channel: Channel, rim: Rim, before: Rim | None, after: Rim | None, light: _Light,
    over: LightOver | None, spots: np.ndarray,
) -> EdgeWave:  # fmt: skip
    """How far the light from one neighbour to the next keeps from a rim, and how strong its wave is on the detector.

    light: between these two; over: light straight from the spot over the one before, None where that is the spot.
    """
    sources, targets = _ends(channel, before, spots), _ends(channel, after, None)
    (leading, _), (trailing, end) = leg(channel, before, rim), leg(channel, rim, after)
    for places, between in ((sources, leading), (targets, trailing)):
        if (
            all(_lies_in(rim, one) for one in between)
            and np.abs(rim.plane.frame.to_local(places)[:, 2]).max() < _IN_PLANE
        ):
            return EdgeWave(rim, np.inf, 0.0)
    if not len(light.starts):
        return EdgeWave(rim, np.inf, 0.0)  # no light between these two comes over it
    hits, onward = light.hits(rim, len(leading))
    x, y, _ = rim.plane.frame.to_local(hits).T
    outline = rim.plane.outline
    nearest = int(np.nanargmin(outline.clearance(x, y)))
    ray = light.starts[nearest], light.launch[nearest], hits[nearest], onward[nearest], light.places[-1, nearest]
    curvature = _curvature(rim, leading, trailing, end, *ray)
    scale = np.sqrt(2 * curvature / setup.assembly.beam.wavelength)
    v = float(outline.clearance(x, y)[nearest] * scale)
    if v <= 0:
        return EdgeWave(rim, v, 1.0)
    waves = _waves(outline, x, y, scale, setup.assembly.beam.wavenumber * curvature)
    wave = float(np.sqrt(np.mean(np.minimum(waves, 1.0) ** 2)))
    passed = _share_coming(setup, channel, rim, over) * _share_going_on(setup, channel, rim, after)
    steepness = setup.assembly.beam.wavenumber * curvature * (outline.reach + float(np.nanmax(np.hypot(x, y))))
    return EdgeWave(rim, v, wave * passed, steepness)


def _lies_in(rim: Rim, interaction: Interaction) -> bool:
    """Whether an interaction's surface is the rim's own plane."""
    surface = interaction.surface
    height = np.abs(rim.plane.frame.to_local(surface.frame.origin[None])[0, 2])
    along = np.abs(surface.frame.axes[:, 2] @ rim.plane.frame.axes[:, 2])
    return surface.is_plane and height < _IN_PLANE and along > 1 - _IN_PLANE**2


def _waves(outline, x: np.ndarray, y: np.ndarray, scale: float, bend: float) -> np.ndarray:
    """Strength (n,) of a rim's wave for rays through (x, y), relative to the light they carry.

    scale: v per distance [1/mm]; bend: second derivative of the phase over the rim's plane [rad/mm^2]. Of a rectangle
    the waves of its four sides; of a circle that of the nearest part, or of all parts together, J0(bend R r), whichever
    is larger.
    """
    if isinstance(outline, Circle):
        # Each ray stands for all of its part of the light: J0 is as large as 1 on the axis alone.
        apart = np.sqrt((np.var(x) + np.var(y)) / (2 * len(x)))
        turns = bend * outline.radius * np.maximum(np.hypot(x, y), apart)
        with np.errstate(divide="ignore", invalid="ignore"):
            together = np.sqrt(np.minimum(1.0, 2 / (np.pi * turns)))
        return np.maximum(edge_wave(scale * (outline.radius - np.hypot(x, y))), together)
    half_x, half_y = outline.half_size
    sides = [half_x - x, half_x + x, half_y - y, half_y + y]
    return np.sqrt(sum(edge_wave(scale * side) ** 2 for side in sides))


def _share_coming(setup: Setup, channel: Channel, rim: Rim, over: LightOver | None) -> float:
    """How strong light is at a rim behind an opening: off the straight light, as much as the edge throws there.

    That is the edge's wave at the distance of the rim from the light, from the opening on.
    """
    if over is None:
        return 1.0
    before, hits = over.opening, straight_on(channel, over, rim)
    if not len(hits):
        return 1.0
    x, y, _ = rim.plane.frame.to_local(hits).T
    length = float(np.linalg.norm(rim.plane.frame.origin - before.plane.frame.origin))
    aside = float(np.min(rim.plane.outline.clearance(x, y)))
    return float(edge_wave(fresnel_parameter(aside, length, setup.assembly.beam.wavelength)))


def _share_going_on(setup: Setup, channel: Channel, rim: Rim, after: Rim | None) -> float:
    """What of a rim's wave goes on from the next opening to the detector: all, or what the edge throws there.

    A wave from the rim comes to the opening from aside and leaves it to the other side: where that misses the detector,
    the opening's own edge throws its wave there.
    """
    if after is None:
        return 1.0
    grid = channel.grid
    length = float(np.linalg.norm(grid.centre - after.plane.frame.origin))
    from_rim = light_over(channel, rim, _rim_points(rim, 8), after, hole_places(after.plane, (0.0, 1.0), 4))
    hits = straight_on(channel, from_rim, None)
    offset = (hits - grid.centre) @ np.stack([grid.u, grid.v], axis=1)
    beyond = np.maximum(np.abs(offset) - np.array(grid.half_size), 0.0)
    # Where no ray comes over the opening, as far aside as it is to the detector.
    aside = float(np.min(np.hypot(*beyond.T), initial=length))
    return float(edge_wave(fresnel_parameter(aside, length, setup.assembly.beam.wavelength)))


def _curvature(rim: Rim, leading, trailing, end, source, launch, hit, onward, target) -> float:
    """Smallest curvature [1/mm] of the path source - point of the rim's plane - target, along the plane's axes.

    source, hit, target: (3,) of a ray, launch, onward: (3,) its directions at the source and at the rim's plane.
    """
    before = arriving_curvature(Sequence((*leading, rim.end)), source, launch)
    behind = leaving_curvature(Sequence((*trailing, end)), rim.plane.frame, hit, onward)
    second = np.diag(before + behind)
    if np.all(np.isfinite(second)):
        return float(np.min(np.abs(second)))
    # Where what lies close by lets no ray through aside, the nearer of the two ends tells how waves spread.
    return float(1 / max(np.linalg.norm(hit - source), 1e-12) + 1 / max(np.linalg.norm(target - hit), 1e-12))


def _rim_points(rim: Rim, count: int) -> np.ndarray:
    """World points (n, 3) just inside an outline."""
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    x, y = rim.plane.outline.edge(angle)
    return rim.plane.frame.to_world(_INSIDE_RIM * np.stack([x, y, 0 * x], axis=1))
