"""Displacement of a pattern that one opening diffracts, averaged over surfaces: spot and opening as waves see them.

Light from P on the surface comes to D by all points Q of the opening. For scatterers of independent phase, of power
p(P) a place, field E and derivatives E_a at D, by motions and by steps along u and v, are circular Gaussian, with

    <E_a E_b*> = sum over P of p(P) sum over Q, Q' of r_a A e^{ikV}(P, Q, D) [r_b A e^{ikV}(P, Q', D)]*,

r the rate at which the path's phasor changes. About the middle of the spot V is quadratic in P and r linear, p is a
Gaussian, so that the sum over P is known, and what is left is a sum over pairs of points in the opening. The
displacement is what a fit of intensity's change by its slopes finds in the mean, see `measurement.velocity`. Where the
spot is much larger than what the opening resolves it is that of the rays alone, see `ray_bundle`; where it is not, the
light of the opening's edge, which goes far beside its rays, misses the spot, and tilts move the pattern less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.pairs import all_pairs
from ..optics.aim import AimedPaths, aim
from ..optics.sequence import Sequence
from ..plan.legs import leg
from ..plan.way import Channel
from ..propagation.opening_quadrature import estimated_nodes, opening_nodes
from ..scene.assembly import Assembly
from ..theory.bundle import displacement_of_covariances
from .lit_surface import LitSurface, path_changes, path_motions
from .ray_bundle import RayBundle

MOST_NODES = 1500
"""Points of the opening, pairs of which are summed: enough for a spot some ten times as wide as what it resolves."""

_QUADRATURE = 1e-3
"""Error of the integral over the opening, relative to its scale."""

_SMALLEST, _LESS = 0.02, 0.7
"""Least part of the spot's radius that tells of the whole, and how much smaller a second spot is that tells of it."""

_RESOLVED = 3.0
"""Phase [rad] of light from ``_EDGE`` of the spot against that from its middle, at the opening's edge, at least."""

_EDGE = 1.5
"""Radii of the spot [1/e^2] for which the integral resolves the light."""

_STEP = 0.5
"""Step in spot radii of the differences that tell how rays change over the spot."""


@dataclass(frozen=True)
class _Opening:
    """Light from the spot at n points of the opening.

    nodes: (n, 3); waves: (n,) complex, amplitude from the spot's middle times the point's area; slopes: (n, 2) of the
    path along the spot's tangents, bends: (n, 2, 2) their slopes [1/mm]; rates: (n, 6) of the light's logarithm by the
    motions, for the spot's middle, rates_over: (n, 6, 2) their slopes over the spot; path: (n,) [mm].
    """

    nodes: np.ndarray
    waves: np.ndarray
    path: np.ndarray
    slopes: np.ndarray
    bends: np.ndarray
    rates: np.ndarray
    rates_over: np.ndarray


def beside_rays(
    assembly: Assembly, channel: Channel, bundle_of: Callable[[LitSurface], RayBundle]
) -> np.ndarray | None:
    """(2, 6) what diffraction at the channel's one opening adds to the displacement by rays [mm/mm, mm/rad].

    bundle_of: the rays from a lit surface over the channel. A spot that is wide against what the opening resolves
    takes many points, and smaller ones tell of it: what the layer along the opening's edge adds, as wide as the spot's
    light is coherent there, falls as 1/w with the spot's radius, and what the spot's own fading adds as 1/w^2.
    None where the opening has too many waves from its middle to its edge, as a pinhole far from any image: the fringes
    of its edge are another matter, see the README. None, too, where rays are not found.
    """
    if len(channel.openings) != 1:
        return None
    surface = LitSurface.of(assembly)
    try:
        bundle = bundle_of(surface)
        share = _share(assembly, channel, surface, bundle)
        if share is None:
            return None
        if share == 1:
            return _added(assembly, channel, surface, bundle)
        smaller = [surface.shrunk(part * share) for part in (1.0, _LESS)]
        added = [_added(assembly, channel, one, bundle_of(one)) for one in smaller]
    except InputError:
        return None
    if any(one is None for one in added):
        return None
    first = (added[0] - _LESS**2 * added[1]) / (1 - _LESS)
    return share * first + share**2 * (added[0] - first)


def _added(assembly: Assembly, channel: Channel, surface: LitSurface, bundle: RayBundle) -> np.ndarray | None:
    rays, waves = bundle.displacement(at_middle=False), _displacement(assembly, channel, surface, bundle)
    return None if rays is None or waves is None else waves - rays


def _share(assembly: Assembly, channel: Channel, surface: LitSurface, bundle: RayBundle) -> float | None:
    """Part of the spot's radius, at most 1, for which ``MOST_NODES`` are enough.

    None where they are for none, and where the opening does not resolve the spot, whose image is no pattern then.
    """
    lit = bundle.lit_places()
    if lit is None:
        return None
    _, places, offsets = lit
    spot, bend = _gradients(assembly, channel, surface, _pixels(channel, places), offsets)
    plane, share = channel.openings[0].plane, 1.0
    if spot * max(plane.outline.half_size) < _RESOLVED or estimated_nodes(plane.outline, bend) > MOST_NODES:
        return None
    while opening_nodes(plane.outline, plane.frame, share * spot + bend, _QUADRATURE)[0].size > MOST_NODES:
        share *= 0.85
        if share < _SMALLEST:
            return None
    return share


def _pixels(channel: Channel, places: np.ndarray) -> np.ndarray:
    """World points (m, 3) at places (m, 2) from the detector's middle."""
    return channel.grid.centre + places[:, :1] * channel.grid.u + places[:, 1:] * channel.grid.v


def _displacement(assembly: Assembly, channel: Channel, surface: LitSurface, bundle: RayBundle) -> np.ndarray | None:
    """(2, 6) displacement [mm/mm, mm/rad] of the pattern of a spot whose light the opening diffracts."""
    lit = bundle.lit_places()
    if lit is None:
        return None
    about, places, offsets = lit
    pixels, opening = _pixels(channel, places), channel.openings[0]
    gradient = sum(_gradients(assembly, channel, surface, pixels, offsets))
    nodes, areas = opening_nodes(opening.plane.outline, opening.plane.frame, gradient, _QUADRATURE)
    if nodes.size > 2 * MOST_NODES:
        return None
    light = _lit_opening(assembly, channel, surface, nodes.points(), areas)
    k, spread = assembly.beam.wavenumber, np.linalg.inv(surface.metric) / 4
    apart = light.slopes[:, None] - light.slopes[None]
    coherence = np.exp(-0.5 * k**2 * np.einsum("pqi,ij,pqj->pq", apart, spread, apart))
    moments = _moments(light, coherence, spread, k, offsets, *_behind(channel, nodes.points(), pixels))
    return _fitted(moments, places - about)


def _moments(opening: _Opening, coherence, spread, k, offsets, paths, waves, slopes) -> np.ndarray:
    """(m, 9, 9) <E_a E_b*> at m places: a, b the field, its steps along u and v, and the motions; motions not with one
    another. paths, waves (m, n), slopes (m, n, 2): from the opening's points to the places."""
    count = len(offsets)
    bent = np.einsum("nij,mj->mni", opening.bends, offsets)
    tilts = opening.slopes + bent
    phase = k * (opening.path + paths - 0.5 * np.einsum("mni,mi->mn", bent, offsets))
    field = opening.waves * waves * np.exp(1j * phase)
    rows = np.stack([field, *(1j * k * np.moveaxis(slopes, 2, 0) * field)], axis=1)  # (m, 3, n)
    # One product with the coherence of all that it is wanted of.
    whole = np.concatenate([rows, *(rows * tilts[:, None, :, i] for i in range(2))], axis=1).reshape(count * 9, -1)
    parts = np.concatenate([whole.real, -whole.imag]) @ coherence
    whole = (parts[: count * 9] + 1j * parts[count * 9 :]).reshape(count, 3, 3, -1)
    other, tilted = whole[:, 0], whole[:, 1:]  # (m, 3, n), (m, 2, 3, n)
    over = 1j * k * np.einsum("nqi,ij->nqj", opening.rates_over, spread)
    rates = field[..., None] * (opening.rates + np.einsum("nqj,mnj->mnq", over, tilts))
    moments = np.zeros((count, 9, 9), complex)
    moments[:, :3, :3] = np.einsum("man,mbn->mab", rows, other)
    moments[:, 3:, :3] = np.einsum("mnq,mbn->mqb", rates, other) - np.einsum(
        "mn,nqj,mjbn->mqb", field, over, tilted, optimize=True
    )
    moments[:, :3, 3:] = moments[:, 3:, :3].conj().transpose(0, 2, 1)
    return moments


def _fitted(moments: np.ndarray, places: np.ndarray) -> np.ndarray | None:
    """(2, 6) from moments (m, 9, 9) at places (m, 2) from where the pattern is told [mm]."""
    power = moments[:, 0, 0].real
    if not power.max() > 0:
        return None
    moments = moments / power[:, None, None]
    mean = moments[:, :, 0]
    covariance = (moments - mean[:, :, None] * mean[:, None].conj()).real
    return displacement_of_covariances(covariance[:, 1:3, 1:3], covariance[:, 1:3, 3:], power, places)


def _aimed(channel: Channel, before, after, sources: np.ndarray, targets: np.ndarray) -> AimedPaths:
    """Rays of all pairs on a leg; InputError where one is not found."""
    between, end = leg(channel, before, after)
    found = aim(Sequence((*between, end)), *all_pairs(sources, targets))
    if not np.all(found.converged):
        raise InputError("no ray")
    return found


def _gradients(
    assembly: Assembly, channel: Channel, surface: LitSurface, pixels: np.ndarray, offsets: np.ndarray
) -> tuple[float, float]:
    """Largest gradient [rad/mm] over the opening of the phase from the spot's rim against its middle, and of that to
    pixels (m, 3) from where (m, 2) their rays come."""
    opening = channel.openings[0]
    frame, outline = opening.plane.frame, opening.plane.outline
    share = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    x, y = (part.ravel() for part in np.meshgrid(share, share))
    keep = np.hypot(x, y) <= 1.01 if outline.is_round else np.ones(len(x), bool)
    half = outline.half_size
    looked = frame.to_world(np.stack([
        outline.centre[0] + 0.99 * half[0] * x[keep], outline.centre[1] + 0.99 * half[1] * y[keep], 0 * x[keep]
    ], axis=1))  # fmt: skip
    radii = np.linalg.inv(np.linalg.cholesky(surface.metric).T)
    around = surface.points(_EDGE * np.concatenate([np.zeros((1, 2)), radii.T, -radii.T]))
    across = frame.axes[:, :2]
    index = opening.index
    arriving = index * _aimed(channel, None, opening, around, looked).arrival.reshape(len(around), -1, 3) @ across
    spot = np.linalg.norm(arriving[1:] - arriving[0], axis=2).max()
    some = np.unique(np.linspace(0, len(pixels) - 1, 9).astype(int))
    rays = _aimed(channel, None, opening, surface.points(offsets[some]), looked).arrival
    leaving = _aimed(channel, opening, None, looked, pixels[some]).launch.reshape(-1, len(some), 3).transpose(1, 0, 2)
    bend = index * np.linalg.norm((rays.reshape(len(some), -1, 3) - leaving) @ across, axis=2).max()
    return assembly.beam.wavenumber * spot, assembly.beam.wavenumber * bend


def _lit_opening(assembly: Assembly, channel: Channel, surface: LitSurface, nodes, areas) -> _Opening:
    radii = _STEP * np.linalg.inv(np.linalg.cholesky(surface.metric).T).T
    along = np.concatenate([np.zeros((1, 2)), radii, -radii])
    starts, count = surface.points(along), len(nodes)
    rays = _aimed(channel, None, channel.openings[0], starts, nodes)
    launch = rays.launch.reshape(5, count, 3)
    tilts = -launch @ surface.tangents.T
    k = assembly.beam.wavenumber
    rates = np.stack([1j * k * path_changes(assembly, np.broadcast_to(p, (count, 3)), l)
                      for p, l in zip(starts, launch, strict=True)])  # fmt: skip
    # The light moves with the beam, not with the material: its strength on a scatterer changes.
    motions = path_motions(assembly, starts) @ surface.tangents.T  # (5, 6, 2)
    rates += np.einsum("sqi,ij,sj->sq", motions, -2 * surface.fading, along)[:, None]
    turn = np.linalg.inv(radii)

    def over(values: np.ndarray) -> np.ndarray:
        """Slopes (..., 2) along the tangents of values (5, ...) at the five starts."""
        return np.moveaxis(values[1:3] - values[3:5], 0, -1) / 2 @ turn.T

    return _Opening(
        nodes, rays.complex_amplitude[:count] * areas, rays.optical_path_length[:count], tilts[0], over(tilts),
        rates[0], over(rates),
    )


def _behind(channel: Channel, nodes: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Paths (m, n), amplitudes (m, n) and slopes along u and v (m, n, 2) from points of the opening to the pixels."""
    opening, grid = channel.openings[0], channel.grid
    rays = _aimed(channel, opening, None, nodes, pixels)
    shape = len(nodes), len(pixels)
    waves = rays.complex_amplitude * np.abs(rays.launch @ opening.normal)
    index = channel.interactions[-1].index_after if channel.interactions else 1.0
    slopes = index * rays.arrival @ np.stack([grid.u, grid.v], axis=1)
    slopes = slopes.reshape(*shape, 2).transpose(1, 0, 2)
    return rays.optical_path_length.reshape(shape).T, waves.reshape(shape).T, slopes
