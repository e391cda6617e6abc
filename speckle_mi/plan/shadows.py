"""Shadows on the detector and on openings: of rims on the way, and of shapes that stand beside or in it.

A way of the light through elements has the rims of these as smooth clearances; every other shape of the scene may still
stand between two of its surfaces. Both are judged ray by ray, and each scatterer has its own shadow: many share those
of the patches of the spot that they lie in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt

from ..geometry.pairs import all_pairs
from ..geometry.plane import PlaneGrid
from ..optics.aim import aim
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.trace import trace
from ..propagation.chebyshev import chebyshev_nodes, interpolation_matrix
from ..propagation.coherent_sum import CERTAINTY
from ..scene.tracer import NOTHING, TARGET
from .fresnel import edge_wave, fresnel_distance
from .places import detector_places
from .setup import Setup
from .visibility import shapes_beside, unblocked
from .way import Channel, Rim

SHADOWS_ON_DETECTOR, SHADOWS_ON_OPENING = 1024, 64
"""Most shadows that are told apart: of single scatterers, or of patches of the spot."""

_FEW_SHADOWS, _RIM_PIXELS = 64, 2
"""Patches whose shadows tell where scatterers differ at all, and by how many pixels more the rest may."""

SAFE_MARGIN = 0.02
"""Relative clearance 1 - r^2/R^2 of the outermost rays from which on a rim is taken to cast no shadow."""

_NODES = 24
"""Nodes a side on the detector from which rays and the clearance of rims are interpolated."""

_SOURCES_AT_ONCE = 32
"""Sources whose rays are aimed together."""


_NEAREST = 1.5
"""Fresnel parameter of the nearest shape that is looked for beside light that goes free."""

HALF_LIT = 0.5
"""Part of the light's amplitude at the very edge of a shadow."""


def wave_of_shadow(lit: np.ndarray, step: float, inside: np.ndarray | None = None) -> float:
    """Rms wave of the edge of shadows, relative to the light beside them, where these are cast.

    lit: (m, rows, columns) whether pixels are lit from places on the spot; step: Fresnel parameter of a pixel; inside:
    (rows, columns) those that count, all by default. At the distance x from the edge of a shadow it is the edge's wave,
    half of the light at the most, for an edge half way.
    """
    counts, power = np.ones(lit.shape[1:], dtype=bool) if inside is None else inside, 0.0
    for one in lit:
        v = step * np.maximum(np.maximum(distance_transform_edt(one), distance_transform_edt(~one)) - 0.5, 0.0)
        power += np.mean(np.minimum(HALF_LIT, edge_wave(v[counts])) ** 2)
    return float(min(1.0, CERTAINTY * np.sqrt(power / max(np.mean(lit[:, counts]) * len(lit), 1e-300))))


def extremes(points: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The middle and the outermost of points (n, 3) in eight directions across axes z, (at most 9, 3)."""
    middle = points.mean(axis=0)
    angle = np.pi / 4 * np.arange(8)
    directions = np.outer(np.cos(angle), axes[:, 0]) + np.outer(np.sin(angle), axes[:, 1])
    outermost = [points[np.argmax(points @ direction)] for direction in directions]
    return np.unique(np.array([middle, *outermost]), axis=0)


def shadowed_sum(
    sources: np.ndarray,
    lit_from: Callable[[np.ndarray, np.ndarray | None], Iterable[np.ndarray]],
    sum_over: Callable[[np.ndarray, np.ndarray], np.ndarray],
    whole: np.ndarray,
    most: int,
) -> tuple[np.ndarray, float, float]:
    """A field with every scatterer's shadow in it, the share of places in shadow, and the error of sharing shadows.

    sources: (n, 3); lit_from(places (g, 3), only) -> for each of them bool of the shape of the field, right where
    ``only`` is (None: everywhere); sum_over(group, places) -> the field of the scatterers with the indices ``group`` at
    the places (bool) alone, 1-D; whole: the field of all without shadows. Up to ``most`` scatterers have each their own
    shadow, more share those of as many patches of the spot; the error is then what four times fewer patches change,
    relative L2.
    """
    few = list(lit_from(_middles(_groups(sources, min(most, _FEW_SHADOWS)), sources), None))
    mixed = np.any(few, axis=0) & ~np.all(few, axis=0)
    # Where patches of the spot agree, so do all scatterers, but for a rim of a pixel or so.
    near = binary_dilation(mixed, iterations=_RIM_PIXELS) if mixed.ndim == 2 else mixed
    steady = np.where(few[0] & ~near, whole, 0.0)
    field, share = _with_own_shadows(_groups(sources, most), sources, lit_from, sum_over, steady, whole, near)
    if len(sources) <= most:
        return field, share, 0.0
    coarse, _ = _with_own_shadows(_groups(sources, max(most // 4, 1)), sources, lit_from, sum_over, steady, whole, near)
    return field, share, float(np.linalg.norm(field - coarse) / max(np.linalg.norm(field), 1e-300))


def _with_own_shadows(groups, sources, lit_from, sum_over, steady, whole, near) -> tuple[np.ndarray, float]:
    """``steady`` with the field at the places ``near`` a shadow's edge, and the share of places that shadows touch."""
    field = steady.copy()
    if np.any(near):
        lit = np.array([np.packbits(seen[near]) for seen in lit_from(_middles(groups, sources), near)])
        everywhere = np.unpackbits(np.bitwise_and.reduce(lit, axis=0), count=np.count_nonzero(near)).view(bool)
        field[near] = np.where(everywhere, whole[near], 0.0)
        for group, packed in zip(groups, lit, strict=True):
            seen = np.zeros_like(near)
            seen[near] = np.unpackbits(packed, count=everywhere.size).view(bool) & ~everywhere
            if np.any(seen):
                field[seen] += sum_over(group, seen)
    return field, float(np.mean((field != whole) | (whole == 0)))


def _middles(groups: list[np.ndarray], sources: np.ndarray) -> np.ndarray:
    return np.array([sources[group].mean(axis=0) for group in groups])


def _groups(sources: np.ndarray, most: int) -> list[np.ndarray]:
    """Index arrays of scatterers that share a shadow: each alone, or in at most ``most`` patches of the spot."""
    if len(sources) <= most:
        return [np.array([k]) for k in range(len(sources))]
    centred = sources - sources.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1][:, ::-1][:, :2]
    place = centred @ axes
    side = int(np.sqrt(most))
    span = np.ptp(place, axis=0)
    cell = np.minimum((place - place.min(axis=0)) / np.where(span > 0, span, 1) * side, side - 1).astype(int)
    label = cell[:, 0] * side + cell[:, 1]
    return [np.flatnonzero(label == value) for value in np.unique(label)]


# Shadows on the detector, where the light is not diffracted


def is_clear(setup: Setup, channel: Channel, sources: np.ndarray, axes: np.ndarray) -> bool:
    """Whether nothing casts a shadow on the detector, judged by the outermost rays."""
    if not (channel.rims or setup.assembly.elements):
        return True
    rays = rays_to_detector(channel, extremes(sources, axes))
    return bool(np.all(rays.margins > SAFE_MARGIN)) and not rays.part.shapes_beside(setup, rays.points)


def shapes_beside_way(setup: Setup, channel: Channel, sources: np.ndarray) -> list[str]:
    """Names of the shapes that may stand in a way's light from sources (n, 3) to the detector without being on it."""
    if not setup.assembly.elements:
        return []
    rays = rays_to_detector(channel, sources)
    return rays.part.shapes_beside(setup, rays.points)


def clearance_of_shapes(setup: Setup, rays: WayRays, counts: Callable[[float], bool]) -> tuple[float, list[str]]:
    """How far shapes beside rays of a part of a way keep off, and the names of those that come nearest.

    The first is the largest of rising Fresnel parameters v = d sqrt(2 / (lambda L)) that is kept, 0 for none; d is the
    distance from the rays, L at most a quarter of the part, where its edge lies half way. Looked for as far as a
    parameter ``counts``, and no farther than all that stands there; names are empty where nothing is found.
    """
    length = float(np.max(np.linalg.norm(np.diff(rays.points, axis=0), axis=2).sum(axis=0)))
    v, kept, farthest = _NEAREST, 0.0, _extent(setup, rays)
    while True:
        aside = fresnel_distance(v, length / 4, setup.assembly.beam.wavelength)
        near = rays.part.shapes_beside(setup, rays.points, aside)
        if near and not np.all(rays.part.unblocked(setup, rays.points, aside)):
            return kept, near
        if not counts(v) or aside > farthest:
            return v, []
        kept, v = v, 2 * v


def _extent(setup: Setup, rays: WayRays) -> float:
    """Size [mm] of a box around rays and all elements."""
    points = np.concatenate([rays.points.reshape(-1, 3), *(element.body.bounds for element in setup.assembly.elements)])
    return float(np.linalg.norm(np.nanmax(points, axis=0) - np.nanmin(points, axis=0)))


def rays_to_detector(channel: Channel, sources: np.ndarray) -> WayRays:
    """Rays of a way from all sources (n, 3) to places all over the detector."""
    return WayRays.over(WayPart.whole(channel), sources, detector_places(channel.grid))


def lit_pixels(
    setup: Setup,
    channel: Channel,
    sources: np.ndarray,
    grid: PlaneGrid,
    only: np.ndarray | None = None,
    rims: bool = True,
) -> Iterator[np.ndarray]:
    """For each of sources (n, 3), whether each pixel (rows, columns) is lit from it: no shape, and no rim, in the way.

    only: pixels to look at, all by default; rims: whether these count.
    """
    return WayPart.whole(channel).lit(setup, sources, grid, grid.shape, rims, only)


@dataclass(frozen=True)
class WayPart:
    """The part of an unfolded way from one of its places to a later one.

    Place 0 is the source, place i the i-th surface, the last the detector; places: those of this part, its ends
    included; interactions: at the inner ones; end: the plane where it ends.
    """

    channel: Channel
    places: tuple[int, ...]
    interactions: tuple[Interaction, ...]
    end: Interaction

    @classmethod
    def whole(cls, channel: Channel) -> WayPart:
        return cls.between(channel, None, None)

    @classmethod
    def between(cls, channel: Channel, start: Rim | None, end: Rim | None) -> WayPart:
        """From the source (None) or a rim to a later rim or the detector (None)."""
        count = len(channel.interactions)
        first, last = start.position if start else 0, end.position if end else count
        # An opening is a place of its own: its plane is not passed a second time.
        inner = [
            i
            for i in range(first, last)
            if not (start and i == start.number and channel.interactions[i].action == "pass")
        ]
        places = (start.number + 1 if start else 0, *(i + 1 for i in inner), end.number + 1 if end else count + 1)
        plane = end.end if end else detector_plane(channel.grid)
        own = {rim.number for rim in (start, end) if rim}
        return cls(channel, places, tuple(_without_rim(channel.interactions[i], i in own) for i in inner), plane)

    def rays(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (p, n, 3) of the rays from sources to targets (n, 3), ends included, and clearances (r, n) of rims."""
        if not self.interactions:
            return np.stack([sources, targets]), np.empty((0, len(targets)))
        sequence = Sequence((*self.interactions, self.end))
        aimed = aim(sequence, sources, targets)
        launch = np.where(aimed.converged[:, None], aimed.launch, targets - sources)
        points = trace(sequence, sources, launch).points
        points[:, ~aimed.converged] = np.nan  # no ray, which nothing stands in the way of
        return np.concatenate([sources[None], points]), np.where(aimed.converged, aimed.margins, -1.0)

    def shapes_beside(self, setup: Setup, points: np.ndarray, clear: float = 0.0) -> list[str]:
        """Names of the shapes that are not on this part, but may stand in it or within ``clear`` [mm] of its rays.

        points: (p, n, 3) of the rays.
        """
        return shapes_beside(setup, self._touched, self.folded(setup.assembly.detector, points), clear)

    def unblocked(self, setup: Setup, points: np.ndarray, clear: float = 0.0) -> np.ndarray:
        """Whether each of the rays with the points (p, n, 3) is free of shapes that are not on this part, (n,).

        clear: distance [mm] aside of the rays at which is looked.
        """
        return unblocked(setup, self._touched, self.folded(setup.assembly.detector, points), clear)

    def lit(
        self,
        setup: Setup,
        sources: np.ndarray,
        grid: PlaneGrid,
        shape: tuple[int, int],
        rims: bool,
        only: np.ndarray | None = None,
    ) -> Iterator[np.ndarray]:
        """Whether places of a detector are lit from each of sources (n, 3): bool of ``shape``, edge to edge pixel.

        Rays and clearances are interpolated from few that are traced. only: where shapes are looked for, bool of
        ``shape``.
        """
        chosen = np.ones(shape, dtype=bool) if only is None else only
        if not self.interactions:
            targets = _places(grid, *(np.linspace(-1, 1, count) if count > 1 else np.zeros(1) for count in shape))
            targets = targets[chosen.ravel()]
            for source in sources:
                lit = chosen.copy()
                lit[chosen] = self.unblocked(setup, np.stack([np.broadcast_to(source, targets.shape), targets]))
                yield lit
            return
        nodes = chebyshev_nodes(_NODES)
        targets = _places(grid, nodes, nodes)
        rows, columns = (interpolation_matrix(_NODES, np.linspace(-1, 1, count)) for count in shape)
        for some in np.array_split(sources, -(-len(sources) // _SOURCES_AT_ONCE)):
            points, margins = self.rays(*all_pairs(some, targets))
            points = points.reshape(len(points), len(some), len(targets), 3)
            margins = margins.reshape(-1, len(some), _NODES, _NODES)
            for number in range(len(some)):
                lit = chosen.copy()
                if rims:
                    for margin in margins[:, number]:
                        lit &= _interpolated(rows, margin, columns) >= 0
                if self.shapes_beside(setup, points[:, number]):
                    coarse = np.moveaxis(points[:, number], 2, 1).reshape(-1, _NODES, _NODES)
                    fine = np.stack([_interpolated(rows, values, columns)[chosen] for values in coarse])
                    fine = np.moveaxis(fine.reshape(len(points), 3, -1), 1, 2)
                    lit[chosen] &= self.unblocked(setup, fine)
                yield lit

    @property
    def _touched(self) -> tuple[int, ...]:
        """The element at each place: the target, those of the way, nothing at the detector."""
        elements = (TARGET, *(number for number, *_ in self.channel.route.steps), NOTHING)
        return tuple(elements[place] for place in self.places)

    def folded(self, detector: PlaneGrid, points: np.ndarray) -> np.ndarray:
        """Points (p, n, 3) of rays where they are in the scene, whose detector is given."""
        seen = [*(i.surface.frame for i in self.channel.interactions), detector_plane(self.channel.grid).surface.frame]
        real = [
            *(i.surface.frame for i in self.channel.route.interactions),
            detector_plane(detector).surface.frame,
        ]
        folded = np.array(points)
        for row, place in enumerate(self.places):
            if place > 0:
                folded[row] = real[place - 1].to_world(seen[place - 1].to_local(points[row]))
        return folded


@dataclass(frozen=True)
class WayRays:
    """Rays of a part of a way: points (p, n, 3), ends included [mm], and margins (r, n), clearances of rims."""

    part: WayPart
    points: np.ndarray
    margins: np.ndarray

    @classmethod
    def over(cls, part: WayPart, starts: np.ndarray, ends: np.ndarray) -> WayRays:
        """From all of starts (n, 3) to all of ends (m, 3)."""
        return cls(part, *part.rays(*all_pairs(starts, ends)))


def _without_rim(interaction: Interaction, is_own: bool) -> Interaction:
    """An interaction without an outline where that is the opening at which the part begins or ends."""
    return replace(interaction, surface=replace(interaction.surface, outline=None)) if is_own else interaction


def _interpolated(rows: np.ndarray, values: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """From nodes (n, n) to places (rows, columns)."""
    return rows @ values @ columns.T


def _places(grid: PlaneGrid, down: np.ndarray, along: np.ndarray) -> np.ndarray:
    """World points (m n, 3) on the detector, row by row, at shares (m,), (n,) of the way from middle to edge pixels."""
    a, b = (
        0.5 * grid.pitch * (count - 1) * share for count, share in zip(grid.shape[::-1], (along, down), strict=True)
    )
    return (grid.centre + b[:, None, None] * grid.v + a[None, :, None] * grid.u).reshape(-1, 3)
