"""The plane pieces that a surface consists of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.frames import Frame

PARALLEL = 1e-9
"""Cosine to a facet's normal below which a ray runs along the facet."""

ON_EDGE = 1e-9
"""Distance beyond a facet's edge, relative to the surface's size, up to which a ray still meets it."""


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
        start, axis = frame.to_local(origin[None])[0], frame.axes.T @ direction
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = self.normal @ axis
            distance = np.einsum("fk,fk->f", self.normal, self.origin - start) / slope
        distance[np.abs(slope) < PARALLEL] = np.nan
        hit = start + distance[:, None] * axis - self.origin
        a, b = (np.einsum("fk,fk->f", hit, basis) for basis in (self.e1, self.e2))
        slack = ON_EDGE * np.max(np.abs(self.bounds))
        # Edge normals of triangles are not of unit length, which only makes the slack finer or coarser.
        inside = np.all(self.edges[..., 0] * a[:, None] + self.edges[..., 1] * b[:, None]
                        <= self.edges[..., 2] + slack, axis=1)  # fmt: skip
        inside &= distance > 0
        if not np.any(inside):
            return None
        first = int(np.nanargmin(np.where(inside, distance, np.inf)))
        return frame.to_world((start + distance[first] * axis)[None])[0], frame.axes @ self.normal[first]
