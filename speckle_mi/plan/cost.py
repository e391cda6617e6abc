"""What a frame will cost, known before it is begun: seconds and memory, from the nodes and legs of its plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.outline import Circle, Rectangle
from ..machine.memory import excess
from ..machine.run_times import duration
from ..propagation.costs import RECORDED
from ..propagation.edge_integral import PAIR_SECONDS, estimated_places
from ..propagation.opening_quadrature import MOST_NODES, estimated_nodes
from ..scattering.rough_surface import RoughSurface
from ..scene.assembly import Assembly
from .way import Channel, PhaseGradient, Rim

LONG = 600.0
"""Seconds of a frame from which on it is only begun when that is asked for."""

WORTH_SAYING = 5.0
"""Seconds of a frame from which on the user is told beforehand."""

NODE_BYTES, NODE_SECONDS = 160, 1e-6
"""Memory of a node of an opening: its place, area and field, and what a sum over it takes beside; time to place it."""

_EXPANSION_RANK = 20
"""Terms that a NUFFT of many sources is taken to need where nothing is known of its paths."""

_EXPANSION_SECONDS = 0.3
"""Finding an expansion, or a traced path's."""

_TRACED_TERM_SECONDS = 1e-7
"""Of one term of a traced path at one source or place: its NUFFT in double precision, and its series."""

_SERIES_SECONDS = 5e-7
"""Of a traced path's series at one source or place."""


@dataclass(frozen=True)
class Cost:
    """Of one frame: seconds and peak memory [bytes], estimated."""

    seconds: float
    memory: float

    def __str__(self) -> str:
        """In words."""
        return f"about {duration(self.seconds)} and {self.memory / 1e9:.2g} GB a frame"


def cost_of(assembly: Assembly, channels: tuple[Channel, ...]) -> Cost:
    """The cost of a frame over all ways of a plan."""
    scatterers, pixels = expected_scatterers(assembly), assembly.detector.size
    seconds, memory = 0.0, 40.0 * pixels + 80.0 * scatterers
    for channel in channels:
        if is_along_edge(channel, scatterers, pixels):
            seconds += edge_seconds(channel, scatterers, pixels)
            continue
        # Rays are not diffracted: their openings have no gradients, and take no nodes.
        openings = zip(channel.openings, channel.gradients, strict=False)
        nodes = [estimated_nodes(rim.plane.outline, gradient.bound, gradient.tilt) for rim, gradient in openings]
        counts = [scatterers, *nodes, pixels]
        for number, (sources, points) in enumerate(zip(counts[:-1], counts[1:], strict=True)):
            terms = _terms(channel.gradients, number)
            seconds += _leg_seconds(sources, points, bool(channel.leg(number)), terms)
        seconds += NODE_SECONDS * sum(nodes)
        memory += NODE_BYTES * sum(nodes)
    return Cost(assembly.sub_pixels**2 * seconds, memory)


def opening_cost(assembly: Assembly, nodes: float) -> Cost:
    """Of one more opening of so many nodes on a way over elements."""
    scatterers, pixels = expected_scatterers(assembly), assembly.detector.size
    legs = _leg_seconds(scatterers, nodes, True) + _leg_seconds(nodes, pixels, True)
    return Cost(assembly.sub_pixels**2 * (NODE_SECONDS * nodes + legs), NODE_BYTES * nodes)


def edge_seconds(channel: Channel, sources: float, points: int) -> float:
    """Of the integral along the edge of a channel's one opening; inf where there is none with only space around it."""
    if len(channel.gradients) != 1 or channel.leg(0) or channel.leg(1):
        return np.inf
    return rim_seconds(channel.openings[0], channel.gradients[0], sources, points)


def rim_seconds(rim: Rim, gradient: PhaseGradient, sources: float, points: int) -> float:
    """Of the integral along a rim with only space around it; inf where it has no formula for that."""
    if not isinstance(rim.plane.outline, (Circle, Rectangle)):
        return np.inf
    along = gradient.bound if gradient.tilt is None else gradient.tilt
    return PAIR_SECONDS * estimated_places(rim.plane.outline, along) * sources * points


def is_along_edge(channel: Channel, sources: float, points: int) -> bool:
    """Whether the integral over a channel's one opening is done along its edge, as that takes less time."""
    along = edge_seconds(channel, sources, points)
    if along == np.inf:
        return False
    rim, gradient = channel.openings[0], channel.gradients[0]
    nodes = estimated_nodes(rim.plane.outline, gradient.bound, gradient.tilt)
    legs = _leg_seconds(sources, nodes, False) + _leg_seconds(nodes, points, False)
    return nodes > MOST_NODES or along < NODE_SECONDS * nodes + legs


def expected_scatterers(assembly: Assembly) -> float:
    """About how many scatterers are summed."""
    target, beam = assembly.target, assembly.beam
    if target.points is not None:
        return float(len(target.points.points))
    surface: RoughSurface = target.surface
    area = float(np.sum(surface.facets.area))
    if not beam.is_uniform:
        slope = max(abs(float(assembly.spot.normal @ beam.axis)), 1e-3)
        area = min(area, np.pi * np.prod(beam.cutoffs) / slope)
    return surface.density * area


def _terms(gradients: tuple[PhaseGradient, ...], number: int) -> int:
    """Terms of the expansion on a leg, as sampled for the opening before or behind it."""
    if not gradients:
        return _EXPANSION_RANK
    return gradients[number - 1].terms[1] if number else gradients[0].terms[0]


def _leg_seconds(sources: float, points: float, traced: bool, terms: int = _EXPANSION_RANK) -> float:
    """A sum from points to points: every pair, or an expansion where that is faster or the only way."""
    if traced:
        return _EXPANSION_SECONDS + (_TRACED_TERM_SECONDS * terms + _SERIES_SECONDS) * (sources + points)
    expanded = _EXPANSION_SECONDS + RECORDED.nufft_point * terms * (sources + points)
    return min(sources * points * RECORDED.grid_pair, expanded)


def require_affordable(cost: Cost, force: bool) -> None:
    """InputError for a frame that needs more memory than there is, or, unless forced, more than ``LONG`` seconds."""
    if too_much := excess(cost.memory):
        raise InputError(f"a frame would {too_much}: put a smaller opening, a larger tolerance or fewer pixels")
    if cost.seconds > LONG and not force:
        raise InputError(
            f"a frame would take {cost}, more than {duration(LONG)}: --force begins it all the same; a smaller "
            "opening, a larger tolerance, fewer pixels or scatterers make it shorter"
        )
