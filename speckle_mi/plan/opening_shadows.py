"""Shadows on the openings of a way, and what hides an opening from the detector.

A rim that is not diffracted at, or an opaque shape, may cut the light on its way to the first opening: each scatterer
then has its geometric shadow there, and the wave of the edge is an error. Behind an opening light is no ray any more:
pixels from which a part of it is hidden are told.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ..geometry.pairs import all_pairs
from ..geometry.plane import PlaneGrid
from ..optics.aim import aim
from ..optics.sequence import Sequence, detector_plane
from ..optics.trace import RayStatus, trace
from ..propagation.chebyshev import TensorSeries, tensor_polynomials
from .cost import is_along_edge
from .fresnel import fresnel_parameter
from .places import FINE, detector_places, hole_places
from .setup import Setup
from .shadows import SAFE_MARGIN, WayPart, WayRays, extremes, wave_of_shadow
from .way import Channel, Rim

_COARSE = 96
"""Places a side on the detector at which the view from an opening is judged."""

_ANGLE_SAMPLES = 12

_FEW_RAYS, _DEGREE, _SEED = 2000, 14, 8
"""Rays over an opening beyond which they are taken from a polynomial of that degree, and seed of those it is fitted to.

Half of them are fitted, half judge the fit."""

_NO_RAY = -1.0
"""Clearance of all rims where no ray leads over a place."""

_DOUBT = 10.0
"""Factor on the largest difference of the polynomial from rays, within which a rim's side is in doubt."""

_ALMOST_RIM = 0.97
"""Part of the way to an opening's rim from where the view of the detector must be free."""

_ACROSS = 64
"""Places across the longer side of an opening at which shadows on it are looked at."""


def lit_nodes(
    setup: Setup, channel: Channel, rim: Rim, sources: np.ndarray, points: np.ndarray
) -> Iterator[np.ndarray]:
    """For each of sources (m, 3), whether points (n, 3) of the first opening are lit, past rims and shapes."""
    part = WayPart.between(channel, None, rim)
    for source in sources:
        starts = np.broadcast_to(source, points.shape)
        lit = np.all(_clearance_at(channel, rim, source, points) >= 0, axis=0)
        if channel.cut_by:
            lit &= part.unblocked(setup, part.rays(starts, points)[0])
        yield lit


def has_shadow(channel: Channel, rim: Rim, sources: np.ndarray, axes: np.ndarray) -> bool:
    """Whether a shape, or a rim not diffracted at, may cast a shadow on the first opening from sources (n, 3)."""
    outermost, samples = extremes(sources, axes), hole_places(rim.plane, *FINE)
    clear = np.all(_clearance_over(channel, rim, *all_pairs(outermost, samples)) > SAFE_MARGIN)
    return bool(channel.cut_by) or not clear


def is_summed_along_edge(
    setup: Setup, channel: Channel, sources: np.ndarray, scatterers: float, pixels: int
) -> bool:
    """Whether the integral over the one opening of a way is done along its edge, for scatterers at sources (n, 3).

    scatterers, pixels: how many, which tells what takes less time. The edge's formula is that of even radiation and
    of an opening without shadows on it.
    """
    return (
        setup.assembly.target.lobe is None
        and is_along_edge(channel, scatterers, pixels)
        and not has_shadow(channel, channel.openings[0], sources, setup.frame.axes)
    )


def _clearance_at(channel: Channel, rim: Rim, source: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Clearances (r, n) of the rims not diffracted at on rays from a source (3,) over points of an opening (n, 3).

    Of many points a polynomial through some of them, and rays only where it leaves in doubt which side of a rim it is.
    """
    starts = np.broadcast_to(source, points.shape)
    if len(points) <= _FEW_RAYS:
        return _clearance_over(channel, rim, starts, points)
    some = np.random.default_rng(_SEED).choice(len(points), _FEW_RAYS, replace=False)
    known = _clearance_over(channel, rim, starts[some], points[some])
    at = rim.plane.frame.to_local(points)[:, :2]
    at = (2 * at - at.max(axis=0) - at.min(axis=0)) / np.maximum(np.ptp(at, axis=0), 1e-300)
    clearance, doubt = np.empty((len(known), len(points))), np.ones(len(points), dtype=bool)
    if len(known) and not np.any(np.all(known == _NO_RAY, axis=0)):
        index = np.array([(a, b) for a in range(_DEGREE + 1) for b in range(_DEGREE + 1 - a)])
        fitted, judged = some[::2], some[1::2]
        coefficients = np.linalg.lstsq(tensor_polynomials(index, at[fitted]).T, known[:, ::2].T, rcond=None)[0]
        series = TensorSeries(index, coefficients)
        error = _DOUBT * np.abs(series(at[judged]).T - known[:, 1::2]).max(axis=1, keepdims=True)
        clearance[:] = series(at).T
        doubt = np.any(np.abs(clearance) <= error, axis=0)
    clearance[:, doubt] = _clearance_over(channel, rim, starts[doubt], points[doubt])
    return clearance


def _clearance_over(channel: Channel, rim: Rim, source: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Clearances (r, n) of the rims not diffracted at on rays from sources over points of an opening, (n, 3) each."""
    chosen = {opening.number for opening in channel.openings}
    rows = [row for row, (number, _) in enumerate(Sequence(channel.interactions).rims) if number not in chosen]
    if not rows:
        return np.empty((0, len(points)))
    before = aim(Sequence((*channel.leg(0), rim.end)), source, points)
    clearance = np.full((len(rows), len(points)), _NO_RAY)
    reached = np.flatnonzero(before.converged)
    # Where the ray goes on behind the opening decides about the rims there.
    whole = trace(
        Sequence((*channel.interactions, detector_plane(channel.grid))), source[reached], before.launch[reached]
    )
    alive = whole.status <= RayStatus.OUTSIDE_OUTLINE
    clearance[:, reached[alive]] = whole.margins[np.ix_(rows, alive)]
    return clearance


def rays_to_opening(setup: Setup, channel: Channel) -> WayRays:
    """Rays from the spot to places all over the first opening."""
    first = channel.openings[0]
    return WayRays.over(WayPart.between(channel, None, first), setup.spots, hole_places(first.plane, *FINE))


def rays_from_opening(setup: Setup, channel: Channel) -> WayRays:
    """Rays from places all over the last opening to the detector."""
    last = channel.openings[-1]
    part = WayPart.between(channel, last, None)
    return WayRays.over(part, hole_places(last.plane, *FINE), detector_places(channel.grid))


def shapes_between_openings(setup: Setup, channel: Channel) -> list[str]:
    """Names of shapes that cut the light on its way from the first opening to the last."""
    names = []
    for first, second in pairwise(channel.openings):
        places = (hole_places(rim.plane, *FINE) for rim in (first, second))
        names += shapes_in_the_way(setup, WayRays.over(WayPart.between(channel, first, second), *places))
    return names


def shapes_in_the_way(setup: Setup, rays: WayRays) -> list[str]:
    """Names of shapes that may stand in rays, not all of which are free; none where all are."""
    free = np.all(rays.part.unblocked(setup, rays.points))
    return [] if free else rays.part.shapes_beside(setup, rays.points)


def wave_on_opening(setup: Setup, channel: Channel) -> float:
    """Rms wave of the edges of shadows of shapes on the first opening, relative to the light there."""
    rim, spots = channel.openings[0], setup.spots
    outline, axes = rim.plane.outline, rim.plane.frame.axes
    half_x, half_y = outline.half_size
    pitch = 2 * max(half_x, half_y) / _ACROSS
    columns, rows = (max(1, round(2 * half / pitch)) for half in (half_x, half_y))
    corner = rim.plane.frame.to_world(0.5 * pitch * np.array([[1.0 - columns, 1.0 - rows, 0.0]]))[0]
    grid = PlaneGrid(corner, axes[:, 0], axes[:, 1], pitch, (rows, columns))
    x, y, _ = rim.plane.frame.to_local(grid.points()).T
    inside = np.all(outline.margins(x, y) >= 0, axis=0).reshape(grid.shape)
    lit = np.array([*WayPart.between(channel, None, rim).lit(setup, spots, grid, grid.shape, rims=False)])
    length = float(np.linalg.norm(rim.plane.frame.origin - spots[0]))
    return wave_of_shadow(lit, fresnel_parameter(pitch, length, setup.assembly.beam.wavelength), inside)


def hidden_pixels(setup: Setup, channel: Channel) -> np.ndarray | None:
    """Pixels (rows, columns) that a rim or a shape hides from a part of the last opening, None where there are none."""
    part, grid = WayPart.between(channel, channel.openings[-1], None), channel.grid
    if not part.interactions and not setup.assembly.elements:
        return None
    outer = hole_places(channel.openings[-1].plane, (0.0, _ALMOST_RIM), _ANGLE_SAMPLES)
    shape = tuple(min(_COARSE, count) for count in grid.shape)
    hidden = ~np.all(list(part.lit(setup, outer, grid, shape, rims=True)), axis=0)
    if not np.any(hidden):
        return None
    rows, columns = (
        np.rint(np.linspace(0, few - 1, count)).astype(int) for few, count in zip(shape, grid.shape, strict=True)
    )
    return hidden[np.ix_(rows, columns)]
