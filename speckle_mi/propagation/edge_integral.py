"""Diffraction at one opening in free space as geometric light and a line integral along its edge.

Rayleigh and Sommerfeld's first integral over a plane hole is Kirchhoff's at the place looked at less Kirchhoff's at its
image in the screen, and each of them is, for a spherical wave, what comes straight through the hole and a wave from its
edge (Maggi and Rubinowicz; Born & Wolf, Principles of Optics, 7th ed., section 8.9):

    E(D) = G(D) + 1/(4 pi) sum_edge e^{ik(r + s)}/(r s) [(s x r) . dl/(r s + s . r) - the same at the image],

r from the source to a place of the edge, s from D to it; G the source's spherical wave where it comes through. Exactly
the integral over the area, at the cost of a line: what a stop many Fresnel zones wide needs.

Where D lies at the edge of the geometric light the integrand has a pole nearby. The edge is cut into panels with Gauss
nodes; those near the pole are done anew with nodes that crowd towards it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import numpy as np
from scipy.special import roots_legendre

from ..geometry.frames import Frame
from ..geometry.outline import Circle, Rectangle
from ..geometry.plane import PlaneGrid, PlanePoints
from ..machine.backend import arrays
from ..machine.progress import tell
from .area import Area, points_at
from .coherent_sum import ALONG_EDGE, CERTAINTY, FASTEST, How, SumResult
from .phasors import WRITE, phasor, unit_phasor
from .reference import Sample

PAIR_SECONDS = 8e-9
"""Of one place of the edge, one source and one point, on two cores."""

NODES_A_PANEL, TURNS_A_PANEL = 16, 4.0
"""Gauss nodes of a panel, and turns of the phase over it: resolved to 1e-9."""

FEWEST_PANELS = 8
"""Panels of a smooth part of the edge, however small it is."""

POLE_DISTANCE = 0.4
"""Distance of a pole from a panel, in its lengths, from which on its nodes resolve it to 1e-9."""

HALVINGS = 44
"""Most halvings of a panel towards a pole."""

AT_EDGE = 1e-12
"""Distance from the edge of the light, in lengths of the opening's edge, up to which a point counts as being on it."""

LEAST_SLOPE, LEAST_SLOPE_SHARE = 1e-3, 0.1
"""Slopes of light against the plane: the flatter it comes, the nearer is the pole; what nodes are crowded for."""

STEEPER = 1.1
"""Factor on the sampled rate of the phase along the edge, for what lies between the samples."""

CHECKED_POINTS = 12
"""Points on which the sum is compared with one over half as many panels again, in NumPy."""

ROUNDINGS = 4
"""In the last digit of a path, of its coordinates, roots and sums."""

PAIRS_AT_ONCE = 1 << 20
"""Pairs of edge's place and point that NumPy takes at once."""

LANES_AT_ONCE, FEWEST_LANES = 1 << 18, 1 << 12
"""Points that the kernel takes at once; with fewer than the latter the edge is shared out, so that all cores work."""


@dataclass(frozen=True)
class _Edge:
    """The edge of an opening in smooth parts of one unit of the parameter t each, counter-clockwise about local z."""

    outline: Circle | Rectangle

    @property
    def is_closed(self) -> bool:
        """Whether it is one smooth curve."""
        return isinstance(self.outline, Circle)

    @property
    def parts(self) -> int:
        return 1 if self.is_closed else 4

    @property
    def length(self) -> float:
        """Of the longest part [mm]."""
        if self.is_closed:
            return 2 * np.pi * self.outline.radius
        return 2 * max(self.outline.half_x, self.outline.half_y)

    @cached_property
    def _corners(self) -> np.ndarray:
        half_x, half_y = self.outline.half_x, self.outline.half_y
        return np.array([(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)])

    def places(self, part: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (..., 2) [mm] and their derivatives with respect to t, of parts (...) at t (...) in [0, 1]."""
        if self.is_closed:
            angle, radius = 2 * np.pi * t, self.outline.radius
            cosine, sine = radius * np.cos(angle), radius * np.sin(angle)
            return np.stack([cosine, sine], -1), 2 * np.pi * np.stack([-sine, cosine], -1)
        first, along = self._corners[part], np.roll(self._corners, -1, axis=0)[part] - self._corners[part]
        return first + t[..., None] * along, along + 0 * t[..., None]

    def nearest(self, part: int, xy: np.ndarray) -> np.ndarray:
        """t (n,) of a part's place that is nearest to places (n, 2)."""
        if self.is_closed:
            return np.arctan2(xy[:, 1], xy[:, 0]) / (2 * np.pi) % 1.0
        first, along = self._corners[part], self._corners[(part + 1) % 4] - self._corners[part]
        return np.clip((xy - first) @ along / (along @ along), 0.0, 1.0)


def estimated_places(outline: Circle | Rectangle, phase_gradient: float | tuple[float, float]) -> float:
    """About how many places of the edge the line integral takes, for a bound on the phase's gradient [rad/mm]."""
    edge, rate = _Edge(outline), float(np.max(phase_gradient)) / (2 * np.pi)
    return edge.parts * NODES_A_PANEL * max(FEWEST_PANELS, edge.length * rate / TURNS_A_PANEL)


def edge_sum(
    outline: Circle | Rectangle,
    frame: Frame,
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    wavelength: float,
) -> SumResult:
    """The field of the target's shape behind an opening in the plane z = 0 of ``frame`` with nothing else around.

    sources: (n, 3) [mm] before it; weights: (n,) complex; target: points behind it; wavelength [mm]. Its error is
    measured against half as many places on the edge again, in NumPy.
    """
    local = frame.to_local(sources)
    # Sources and targets may lie on either side.
    side = 1.0 if np.mean(local[:, 2]) < 0 else -1.0
    panels = _panels(_Edge(outline), frame, local, target, wavelength)
    points = target.points()
    field = np.zeros(len(points), dtype=np.complex128)
    line = _Line(_Edge(outline), panels, side, wavelength)
    for first in range(0, len(points), LANES_AT_ONCE):
        some = slice(first, first + LANES_AT_ONCE)
        field[some] = line.field(local, weights, frame.to_local(points[some]))
        tell("points", min(first + LANES_AT_ONCE, len(points)), len(points))
    sample = Sample.of(field, min(CHECKED_POINTS, len(field)))
    finer = _Line(_Edge(outline), -(-3 * panels // 2), side, wavelength)
    exact = finer.exact_field(local, weights, frame.to_local(points_at(target, sample.index).points()))
    error = sample.error(field[sample.index], exact)
    # Both know the paths to their last digits only.
    farthest = max(float(np.abs(line.nodes[0]).max()), float(np.abs(local).max()), float(np.abs(points).max()))
    error = np.hypot(error, ROUNDINGS * np.finfo(float).eps * 2 * np.pi * farthest / wavelength)
    pairs = float(len(line.nodes[0]) * len(sources) * len(points))
    shape = target.shape if isinstance(target, PlaneGrid) else (target.size,)
    return SumResult(field.reshape(shape), How(ALONG_EDGE, len(points), pairs, why=FASTEST), float(CERTAINTY * error))


def _panels(edge: _Edge, frame: Frame, local: np.ndarray, target: PlaneGrid | PlanePoints, wavelength: float) -> int:
    """Panels of each part of the edge that resolve the phase along it."""
    side = np.linspace(-1, 1, 5)
    places = np.stack([axis.ravel() for axis in np.meshgrid(side, side)], axis=1)
    ends = frame.to_local(Area.around(target).points(target, places).points())
    extremes = local[np.unique(np.concatenate([local.argmin(axis=0), local.argmax(axis=0)]))]
    t = np.linspace(0, 1, 65)
    rate = 0.0
    for part in range(edge.parts):
        q, dq = edge.places(np.full(t.shape, part), t)
        q = np.concatenate([q, np.zeros((len(q), 1))], axis=1)
        slopes = [_slopes(q, dq, some) for some in (extremes, ends)]
        rate = max(rate, float(np.max(np.abs(slopes[0][:, :, None] + slopes[1][:, None, :]))))
    return max(FEWEST_PANELS, int(np.ceil(STEEPER * rate / wavelength / TURNS_A_PANEL)))


def _slopes(q: np.ndarray, dq: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Derivatives (m, n) with respect to t of the distances of points (n, 3) from places (m, 3) of the edge."""
    apart = q[:, None] - points[None]
    return np.einsum("mnk,mk->mn", apart[..., :2], dq) / np.linalg.norm(apart, axis=2)


@dataclass(frozen=True)
class _Line:
    """An edge cut into ``panels`` panels a part; side: of the local z that light goes on to."""

    edge: _Edge
    panels: int
    side: float
    wavelength: float

    @cached_property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Places (m, 2) and line elements (m, 2) [mm], part after part, panel after panel."""
        x, w = roots_legendre(NODES_A_PANEL)
        part, panel = np.divmod(np.arange(self.edge.parts * self.panels), self.panels)
        t = (panel[:, None] + (x + 1) / 2) / self.panels
        q, dq = self.edge.places(np.broadcast_to(part[:, None], t.shape), t)
        return q.reshape(-1, 2), (dq * (w / 2 / self.panels)[:, None]).reshape(-1, 2)

    def field(self, sources: np.ndarray, weights: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """The field (m,) at targets (m, 3), all local."""
        field = self._wave_of_all(sources, weights, targets)
        for source, weight in zip(sources, weights, strict=True):
            field += weight * self._beside_edge_field(source, targets)
        return field

    def exact_field(self, sources: np.ndarray, weights: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """The same without the kernel: what it is judged by."""
        field, (q, dl) = np.zeros(len(targets), dtype=np.complex128), self.nodes
        step = max(1, PAIRS_AT_ONCE // len(q))
        for source, weight in zip(sources, weights, strict=True):
            field += weight * self._beside_edge_field(source, targets)
            for first in range(0, len(targets), step):
                some = slice(first, first + step)
                field[some] += weight * self._wave(source, targets[some], q[None], dl[None])
        return field

    def _hits(self, source: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Where straight light to targets (m, 3) comes through the plane, (m, 2)."""
        share = source[2] / (source[2] - targets[:, 2])
        return source[:2] + share[:, None] * (targets[:, :2] - source[:2])

    def _beside(self, source: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Targets (m, 3), those exactly at the edge of the light moved to its one side or the other.

        There half of the light is straight and half the edge's wave, whatever counts as inside: beside it that is so.
        """
        at_edge = np.abs(self.edge.outline.clearance(*self._hits(source, targets).T)) < AT_EDGE * self.edge.length
        share = source[2] / (source[2] - targets[at_edge, 2])
        moved = targets.copy()
        moved[at_edge, :2] += 2 * AT_EDGE * self.edge.length / share[:, None] * np.array([0.6, 0.8])
        return moved

    def _beside_edge_field(self, source: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Straight light (m,) and what panels near a pole bring with crowded nodes, less what they bring without."""
        beside = self._beside(source, targets)
        return self._straight(source, beside) + self._mended(source, targets, beside)

    def _straight(self, source: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """The source's spherical wave (m,) where it comes through the opening."""
        inside = self.edge.outline.clearance(*self._hits(source, targets).T) > 0
        distance = np.linalg.norm(targets - source, axis=1)
        return np.where(inside, unit_phasor(distance / self.wavelength) / distance, 0.0)

    def _wave(self, source: np.ndarray, targets: np.ndarray, q: np.ndarray, dl: np.ndarray) -> np.ndarray:
        """Sum (m,) over places q (m or 1, k, 2) with line elements dl of what they send to targets (m, 3)."""
        rx, ry, rz = q[..., 0] - source[0], q[..., 1] - source[1], -source[2]
        sx, sy, sz = q[..., 0] - targets[:, :1], q[..., 1] - targets[:, 1:2], -targets[:, 2:]
        r, s = np.sqrt(rx * rx + ry * ry + rz * rz), np.sqrt(sx * sx + sy * sy + sz * sz)
        factor = _factor(rx, ry, rz, sx, sy, sz, r * s, dl[..., 0], dl[..., 1], np.where)
        wave = unit_phasor((r + s) / self.wavelength) * (factor / (r * s))
        return self.side * wave.sum(axis=1) / (4 * np.pi)

    def _mended(self, source: np.ndarray, targets: np.ndarray, beside: np.ndarray) -> np.ndarray:
        """What panels near a pole bring with nodes that crowd towards it, less what they brought without, (m,).

        beside: the targets, none of them exactly at the edge of the light.
        """
        hits, change = self._hits(source, beside), np.zeros(len(targets), dtype=np.complex128)
        slope = np.abs(targets[:, 2] - source[2]) / np.linalg.norm(targets - source, axis=1)
        near = POLE_DISTANCE * self.edge.length / self.panels / np.maximum(slope, LEAST_SLOPE)
        some = np.flatnonzero(np.abs(self.edge.outline.clearance(*hits.T)) < near)
        for part in range(self.edge.parts if len(some) else 0):
            t = self.edge.nearest(part, hits[some])
            nearest = np.minimum((t * self.panels).astype(int), self.panels - 1)
            for panel in (nearest - 1, nearest, nearest + 1):
                pole = np.clip(t, panel / self.panels, (panel + 1) / self.panels)
                place, _ = self.edge.places(np.full(t.shape, part), pole)
                apart = np.linalg.norm(place - hits[some], axis=1)
                # Around a circle the panel before the first is the last, at t below 0.
                chosen = (apart < near[some]) & (self.edge.is_closed | ((panel >= 0) & (panel < self.panels)))
                if not np.any(chosen):
                    continue
                index = some[chosen]
                t_even, even, t_crowded, crowded = self._rules(panel[chosen], pole[chosen], float(apart[chosen].min()))
                change[index] -= self._panel_wave(part, t_even, even, source, targets[index])
                change[index] += self._panel_wave(part, t_crowded, crowded, source, beside[index])
        return change

    def _rules(self, panel: np.ndarray, pole: np.ndarray, apart: float) -> tuple[np.ndarray, ...]:
        """Nodes t and weights (n, k) over panels (n,): even, and crowded towards poles at t (n,), ``apart`` or more."""
        x, w = roots_legendre(NODES_A_PANEL)
        even = (panel[:, None] + (x + 1) / 2) / self.panels
        smallest = max(LEAST_SLOPE_SHARE * apart * self.panels / self.edge.length, 2.0**-HALVINGS)
        ends = np.concatenate([[0.0], 0.5 ** np.arange(max(1, int(np.ceil(-np.log2(smallest)))), -1, -1.0)])
        unit = (ends[:-1, None] + np.diff(ends)[:, None] * (x + 1) / 2).ravel()
        share = (np.diff(ends)[:, None] * w / 2).ravel()
        sides = [(end / self.panels - pole)[:, None] for end in (panel, panel + 1)]
        crowded = np.concatenate([pole[:, None] + side * unit for side in sides], axis=1)
        weights = np.concatenate([np.abs(side) * share for side in sides], axis=1)
        return even, np.broadcast_to(w / 2 / self.panels, even.shape), crowded, weights

    def _panel_wave(self, part: int, t: np.ndarray, weights: np.ndarray, source, targets: np.ndarray) -> np.ndarray:
        """What nodes t with weights (m, k) on a part of the edge send to targets (m, 3), each row to one."""
        wave, step = np.empty(len(t), dtype=np.complex128), max(1, PAIRS_AT_ONCE // t.shape[1])
        for first in range(0, len(t), step):
            some = slice(first, first + step)
            q, dq = self.edge.places(np.full(t[some].shape, part), t[some])
            wave[some] = self._wave(source, targets[some], q, dq * weights[some, :, None])
        return wave

    def _wave_of_all(self, sources: np.ndarray, weights: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """The edge's wave (m,) at targets (m, 3) over all nodes and sources, by the kernel."""
        ad, (q, dl) = arrays(), self.nodes
        count, places = len(targets), len(q)
        slices = max(1, min(places // NODES_A_PANEL, FEWEST_LANES // count))
        index = dr.arange(ad.UInt32, count * slices)
        lanes = dr.opaque(ad.UInt32, count)
        number = index // lanes
        target = [dr.gather(ad.Float64, ad.Float64(np.ascontiguousarray(axis)), index - number * lanes)
                  for axis in targets.T]  # fmt: skip
        sx0, sy0, sz = -target[0], -target[1], -target[2]
        per_slice = dr.opaque(ad.UInt32, -(-places // slices))
        first = number * per_slice
        last = dr.minimum(first + per_slice, dr.opaque(ad.UInt32, places))
        nodes = ad.Float64(np.ascontiguousarray(np.concatenate([q, dl], axis=1)).ravel())
        strengths = np.stack([weights.real, weights.imag], axis=1) * (self.side / (4 * np.pi))
        light = ad.Float64(np.ascontiguousarray(np.concatenate([sources, strengths], axis=1)).ravel())
        turns, all_sources = dr.opaque(ad.Float64, 1 / self.wavelength), dr.opaque(ad.UInt32, len(sources))

        def of_source(j, end, re, im):
            x, y, z, strength_re, strength_im = (dr.gather(ad.Float64, light, 5 * j + n) for n in range(5))

            def of_place(i, stop, re, im):
                qx, qy, dlx, dly = dr.gather(ad.Array4f64, nodes, i)
                rx, ry, rz, sx, sy = qx - x, qy - y, -z, sx0 + qx, sy0 + qy
                r, s = dr.norm(ad.Array3f64(rx, ry, rz)), dr.norm(ad.Array3f64(sx, sy, sz))
                factor = _factor(rx, ry, rz, sx, sy, sz, r * s, dlx, dly, dr.select) / (r * s)
                cosine, sine = phasor((r + s) * turns, ad.Float64)
                return i + 1, stop, dr.fma(factor, cosine, re), dr.fma(factor, sine, im)

            zero = dr.zeros(ad.Float64, dr.width(first))
            state = ad.UInt32(first), last, zero, zero + 0
            _, _, a, b = dr.while_loop(state, lambda i, stop, *_: i < stop, of_place)
            return j + 1, end, re + a * strength_re - b * strength_im, im + a * strength_im + b * strength_re

        zero = dr.zeros(ad.Float64, dr.width(first))
        start = dr.zeros(ad.UInt32, dr.width(first))
        _, _, re, im = dr.while_loop(
            (start, all_sources, zero, zero + 0), lambda j, end, *_: j < end, of_source, label="edge wave"
        )
        out = dr.empty(ad.Float64, 2 * count * slices)
        dr.scatter(out, ad.Array2f64(re, im), index, mode=WRITE)
        return np.ascontiguousarray(out.numpy()).view(np.complex128).reshape(slices, count).sum(axis=0)


def _factor(rx, ry, rz, sx, sy, sz, product, dlx, dly, select):
    """(s x r) . dl/(r s + s . r) at the target less the same at its image in the plane, where s_z has the other sign.

    product: r s; select: ``numpy.where`` or ``drjit.select``, for arrays of either.
    """
    in_plane, across = sx * rx + sy * ry, sx * ry - sy * rx

    def one(sz):
        x, y = sy * rz - sz * ry, sz * rx - sx * rz
        dot = in_plane + sz * rz
        # Near the edge of the light r and s are opposite, and r s + s . r is a small difference: take it from
        # (r s)^2 - (s . r)^2 = |s x r|^2.
        # With a place exactly on the straight line, the pole itself, the sum is mended; here it only has to be finite.
        small = (product - dot) / (x * x + y * y + across * across + 1e-300)
        inverse = select(dot < 0, small, 1 / (product + select(dot < 0, 0, dot)))
        return (x * dlx + y * dly) * inverse

    return one(sz) - one(-sz)
