"""The plane pieces that a surface consists of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.frames import Frame
from ..geometry.rotation import vectors_across

PARALLEL = 1e-9
"""Cosine to a facet's normal below which a ray runs along the facet."""

ON_EDGE = 1e-9
"""Distance beyond a facet's edge, relative to the surface's size, up to which a ray still meets it."""

PAIRS_AT_ONCE = 1_000_000
"""Pairs of ray and facet that are looked at together: some 30 MB."""


@dataclass(frozen=True)
class Facets:
    """Plane convex pieces of a surface in the target frame.

    origin, e1, e2, normal: (f, 3) [mm], e1 and e2 orthonormal in the facet; bounds: (f, 4) smallest and largest
    coordinate along e1 and e2 [mm]; edges: (f, 4, 3) half-planes (p, q, r): inside where p a + q b <= r; area: (f,)
    [mm^2].
    """

    origin: np.ndarray
    e1: np.ndarray
    e2: np.ndarray
    normal: np.ndarray
    bounds: np.ndarray
    edges: np.ndarray
    area: np.ndarray

    @property
    def count(self) -> int:
        return len(self.origin)

    @classmethod
    def rectangle(cls, width: float, height: float) -> Facets:
        """A patch centred at the origin in the plane z = 0, normal +z."""
        a, b = width / 2, height / 2
        return cls(
            origin=np.zeros((1, 3)),
            e1=np.array([[1.0, 0, 0]]),
            e2=np.array([[0, 1.0, 0]]),
            normal=np.array([[0, 0, 1.0]]),
            bounds=np.array([[-a, a, -b, b]]),
            edges=np.array([[[1.0, 0, a], [-1, 0, a], [0, 1, b], [0, -1, b]]]),
            area=np.array([width * height]),
        )

    @classmethod
    def triangles(cls, corners: np.ndarray) -> Facets:
        """Triangles (f, 3 corners, 3) [mm], normals by the right-hand rule; those without area are left out."""
        p0, p1, p2 = np.moveaxis(np.asarray(corners, dtype=np.float64), 1, 0)
        normal = np.cross(p1 - p0, p2 - p0)
        length = np.linalg.norm(normal, axis=1)
        keep = length > 1e-14 * np.max(np.ptp(corners.reshape(-1, 3), axis=0)) ** 2
        p0, p1, p2, normal = p0[keep], p1[keep], p2[keep], normal[keep] / length[keep, None]
        e1 = (p1 - p0) / np.linalg.norm(p1 - p0, axis=1, keepdims=True)
        e2 = np.cross(normal, e1)
        plane = np.stack(
            [np.stack([np.einsum("ij,ij->i", p - p0, e) for e in (e1, e2)], axis=-1) for p in (p0, p1, p2)], axis=1
        )  # (f, corner, 2)
        along = np.roll(plane, -1, axis=1) - plane
        outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
        offset = np.einsum("fck,fck->fc", outward, plane)
        edges = np.concatenate([outward, offset[..., None]], axis=-1)
        never = np.broadcast_to(np.array([[[0.0, 0.0, 1.0]]]), (len(p0), 1, 3))
        lower, upper = plane.min(axis=1), plane.max(axis=1)
        bounds = np.stack([lower[:, 0], upper[:, 0], lower[:, 1], upper[:, 1]], axis=1)
        return cls(p0, e1, e2, normal, bounds, np.concatenate([edges, never], axis=1), area=length[keep] / 2)

    def first_met(
        self, frame: Frame, origin: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Where a ray first meets the surface with its frame at ``frame``: point [mm] and unit normal (3,), world.

        origin: (3,) [mm]; direction: (3,) of unit length. None where it meets no facet.
        """
        points, facet = self.first_met_by(frame, origin[None], direction)
        return None if facet[0] < 0 else (points[0], frame.axes @ self.normal[facet[0]])

    def first_met_by(
        self, frame: Frame, origins: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where parallel rays first meet the surface: points (n, 3) [mm], world, and numbers of the facets (n,).

        origins: (n, 3) [mm]; direction: (3,) of unit length. NaN and -1 where a ray meets no facet.
        """
        starts, axis = frame.to_local(origins), frame.axes.T @ direction
        distance, facet = np.full(len(starts), np.inf), np.full(len(starts), -1)
        for rays, facets in self._pairs_that_may_meet(starts, axis):
            length = self._distance_to(facets, starts[rays], axis)
            order = np.argsort(length, kind="stable")[::-1]  # the nearest is written last, and stays
            order = order[np.isfinite(length[order])]
            distance[rays[order]], facet[rays[order]] = length[order], facets[order]
        return frame.to_world(starts + np.where(facet < 0, np.nan, distance)[:, None] * axis), facet

    @cached_property
    def _circles(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles (f, 3) and radii (f,) of spheres around the facets, edges with their slack included [mm]."""
        half = 0.5 * (self.bounds[:, 1::2] - self.bounds[:, 0::2])
        middle = self.bounds[:, 0::2] + half
        middle = self.origin + middle[:, :1] * self.e1 + middle[:, 1:] * self.e2
        return middle, np.linalg.norm(half, axis=1) + 2 * self._slack

    def _pairs_that_may_meet(self, starts: np.ndarray, axis: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Pairs of ray and facet (p,), some rays at a time, where the ray passes the sphere around the facet."""
        middle, reach = self._circles
        across = vectors_across(axis)
        places, seen = (middle @ across.T).T, (starts @ across.T).T
        near = np.ones(self.count, dtype=bool)
        for place, ray in zip(places, seen, strict=True):
            near &= (place + reach >= ray.min()) & (place - reach <= ray.max())
        near = np.flatnonzero(near)
        places, squared = places[:, near], reach[near] ** 2
        step = max(1, PAIRS_AT_ONCE // max(1, len(near)))
        for first in range(0, len(starts), step):
            u, v = (seen[k, first : first + step, None] - places[k] for k in (0, 1))
            rays, facets = np.nonzero(u * u + v * v <= squared)
            yield rays + first, near[facets]

    def _distance_to(self, facets: np.ndarray, starts: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Length (p,) along local rays from starts (p, 3) to facets of given numbers (p,), inf where they miss."""
        origin, normal = self.origin[facets], self.normal[facets]
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = normal @ axis
            distance = np.einsum("pk,pk->p", normal, origin - starts) / slope
        distance[np.abs(slope) < PARALLEL] = np.nan
        hit = starts + distance[:, None] * axis - origin
        a, b = (np.einsum("pk,pk->p", hit, basis[facets])[:, None] for basis in (self.e1, self.e2))
        edges = self.edges[facets]
        # Edge normals of triangles are not of unit length, which only makes the slack finer or coarser.
        inside = np.all(edges[..., 0] * a + edges[..., 1] * b <= edges[..., 2] + self._slack, axis=1)
        return np.where(inside & (distance > 0), distance, np.inf)

    @cached_property
    def _slack(self) -> float:
        """Distance beyond an edge [mm] up to which a ray still meets a facet."""
        return ON_EDGE * float(np.max(np.abs(self.bounds), initial=0.0))
