"""The rays that meet at places of the detector, from all of the lit surface and through all of the openings.

A ray is told by four numbers: where it leaves the target's tangent plane, and its slope there. Of these the place on
the detector takes two. Which two are left depends on the optics: in free space the place on the surface, in focus the
place in the pupil, behind a cylinder one of each. They are found from the ray map linearised about the chief ray, as
the two directions in which rays that end at one place differ, measured in radii of the spot and of the rims that they
pass. The rays themselves are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.plane import PlaneGrid
from ..geometry.rotation import vectors_across
from ..optics.sequence import Interaction, Sequence
from ..optics.trace import RayStatus, trace
from ..plan.way import Rim
from ..scene.assembly import Assembly
from ..theory.bundle import bundle_displacement
from .lit_surface import LitSurface, path_changes

STEP = 1e-4
"""Step [mm, rad] of the difference quotients of the ray map."""

_SPOT_REACH = 2.1
"""Radii of the spot (1/e^2 of the intensity) up to which rays are looked at: 1.5e-4 of the power lies beyond."""

_RIM_REACH = 1.1
"""Radii of a rim up to which rays are looked at: bundles are not quite what their linear map says."""

_FREE = 1e-12
"""What the square of a slope counts that no rim limits, against those of spot radii."""

_RAYS, _PLACES = 15, 5
"""Rays along each of two directions of a bundle, and places along each side of what is lit of the detector. They weigh
the rays, on which the displacement depends as far as the optics has aberrations."""

_DIM = 0.03
"""Power relative to the largest below which a place is left out, which counts by its square."""

_FARTHEST = 1e3
"""Step [mm on the detector] beyond which a ray is given up."""

_ITERATIONS, _HIT = 12, 1e-7
"""Steps of Newton's method at most, and distance [mm] from a place that counts as hit."""


@dataclass(frozen=True)
class _Traced:
    """n rays: ends (n, 2) along u and v from the detector's middle [mm], rims (n, 2 k) their places on k rims in radii,
    start (n, 3) [mm], launch and arrival (n, 3), and whether they get through (n,)."""

    ends: np.ndarray
    rims: np.ndarray
    start: np.ndarray
    launch: np.ndarray
    arrival: np.ndarray
    free: np.ndarray


class RayBundle:
    """The rays from the lit surface over a way to a plane where the pattern is looked at."""

    def __init__(
        self, assembly: Assembly, interactions: tuple[Interaction, ...], rims: tuple[Rim, ...], end: Interaction,
        grid: PlaneGrid, sight: np.ndarray, surface: LitSurface | None = None,
    ) -> None:  # fmt: skip
        """interactions: of the way before the plane ``end``, with rims among them; grid: axes, middle and extent of
        what is looked at in that plane; sight: (3,) unit direction of a ray from the spot through the first opening's
        middle, or to the grid's; surface: what is lit, the assembly's own unless given."""
        self._assembly, self._surface = assembly, surface or LitSurface.of(assembly)
        self._sequence = Sequence((*interactions, end))
        self._rims = [(rim.number, rim.plane.outline) for rim in rims]
        self._grid, self._plane = grid, np.stack([grid.u, grid.v], axis=1)
        self._sight, self._across = sight, vectors_across(sight)
        self._linearise()

    def displacement(self, at_middle: bool) -> np.ndarray | None:
        """(2, 6) of the pattern in the middle of the grid [mm/mm, mm/rad]; None where its rays are not found.

        at_middle: whether rays are looked at that meet there; else at places all over the light on the detector, with
        a displacement that may change linearly over it, and that is told where the light comes closest to the middle.
        """
        if not self._regular:
            return None
        about, places = (np.zeros(2), np.zeros((1, 2))) if at_middle else self._lit_places()
        rays, weights = self._rays_to(places) if at_middle else self._to_light
        count = len(places)
        slopes = self._sequence.last.index_before * (rays.arrival @ self._plane)
        changes = path_changes(self._assembly, rays.start, rays.launch)
        slopes, changes = (
            np.where(rays.free[:, None], of_rays, 0.0).reshape(count, -1, of_rays.shape[1])
            for of_rays in (slopes, changes)
        )
        return bundle_displacement(slopes, changes, weights, places - about)

    @cached_property
    def _to_light(self) -> tuple[_Traced, np.ndarray]:
        """Rays to the places of the light on the detector, and their powers."""
        return self._rays_to(self._lit_places()[1])

    def lit_places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Where the pattern is told (2,), places (m, 2) all over the light on the detector and, as offsets (m, 2) along
        the surface's tangents, from where their light comes [mm]; None where rays are not found."""
        if not self._regular:
            return None
        about, places = self._lit_places()
        rays, weights = self._to_light
        power = weights.sum(axis=1)
        lit = power > _DIM * power.max(initial=0.0)
        if not np.any(lit):
            return None
        starts = np.where(rays.free[:, None], (rays.start - self._surface.point) @ self._surface.tangents.T, 0.0)
        offsets = np.einsum("mn,mni->mi", weights, starts.reshape(len(places), -1, 2))[lit] / power[lit, None]
        return about, places[lit], offsets

    def _trace(self, states: np.ndarray) -> _Traced:
        """Rays of states (n, 4): coordinates along the surface's tangents [mm], slopes across the chief ray."""
        start = self._surface.points(states[:, :2])
        heading = self._sight + states[:, 2:] @ self._across
        heading /= np.linalg.norm(heading, axis=1, keepdims=True)
        found = trace(self._sequence, start, heading)
        ends = (found.points[-1] - self._grid.centre) @ self._plane
        passed = [np.empty((len(states), 0))]
        for number, outline in self._rims:
            local = self._sequence.interactions[number].surface.frame.to_local(found.points[number])
            passed.append((local[:, :2] - outline.centre) / outline.half_size)
        free = (found.status == RayStatus.OK) & np.all(np.isfinite(ends), axis=1)
        return _Traced(ends, np.concatenate(passed, axis=1), start, heading, found.directions, free)

    def _linearise(self) -> None:
        """The chief ray's neighbours: where they end and pass rims, and the measure of how far they are from it."""
        steps = STEP * np.concatenate([np.zeros((1, 4)), np.eye(4), -np.eye(4)])
        near = self._trace(steps)
        to_end, to_rims = (((v[1:5] - v[5:]) / (2 * STEP)).T for v in (near.ends, near.rims))
        self._middle, self._to_end, self._to_rims = near.ends[0], to_end, to_rims
        self._regular = bool(np.all(np.isfinite(to_end)) and np.all(np.isfinite(to_rims)))
        if not self._regular:
            return
        metric = to_rims.T @ to_rims
        metric[:2, :2] += self._surface.metric
        metric[2:, 2:] += _FREE * np.trace(self._surface.metric) * np.eye(2)
        # In units of its root G the measure is the plain length.
        root = np.linalg.cholesky(metric).T
        self._unit = np.linalg.inv(root)
        left, size, right = np.linalg.svd(to_end @ self._unit)
        self._regular = bool(size[1] > 1e-9 * size[0])
        if self._regular:
            self._towards = self._unit @ right[:2].T @ np.diag(1 / size) @ left.T
            self._kept = self._unit @ self._turned(right[2:].T)
            self._extent = left * size

    def _turned(self, kept: np.ndarray) -> np.ndarray:
        """Directions (4, 2) in units of the measure, turned so that one goes most and one least over the spot."""
        on_spot = (self._unit @ kept)[:2]
        return kept @ np.linalg.eigh(on_spot.T @ self._surface.metric @ on_spot)[1]

    def _lit_places(self) -> tuple[np.ndarray, np.ndarray]:
        """The place (2,) in the light that is closest to the middle, and places (m, 2) spread over it [mm].

        It is the light on the detector, and all of it where none is.
        """
        half, edge = np.linalg.norm(self._extent, axis=1), np.array(self._grid.half_size)
        low, high = np.maximum(self._middle - half, -edge), np.minimum(self._middle + half, edge)
        if np.any(low >= high):
            low, high = self._middle - half, self._middle + half
        share = (np.arange(_PLACES) + 0.5) / _PLACES
        u, v = np.meshgrid(*(one + share * (other - one) for one, other in zip(low, high, strict=True)))
        return np.clip(0.0, low, high), np.stack([u.ravel(), v.ravel()], axis=1)

    def _rays_to(self, places: np.ndarray) -> tuple[_Traced, np.ndarray]:
        """Rays that end at places (m, 2), as many for each, and their powers (m, n)."""
        start = (places - self._middle) @ self._towards.T
        share = (np.arange(_RAYS) + 0.5) / _RAYS * 2 - 1
        apart = np.stack([part.ravel() for part in np.meshgrid(share, share, indexing="ij")], axis=1)
        reach = self._reach(start)
        states = start[:, None] + (apart * reach[:, None]) @ self._kept.T
        states, rays = self._aimed(states.reshape(-1, 4), np.repeat(places, len(apart), axis=0))
        hit = rays.free & (np.linalg.norm(rays.ends - np.repeat(places, len(apart), axis=0), axis=1) < _HIT)
        # A surface that radiates evenly has the radiance light/cos, which rays keep; they count by what they have of it
        # and by the slopes at the detector that they stand for.
        slopes = (rays.arrival @ self._plane).reshape(len(places), _RAYS, _RAYS, 2)
        across, along = np.gradient(slopes, axis=(1, 2))
        room = np.abs(across[..., 0] * along[..., 1] - across[..., 1] * along[..., 0]).reshape(len(places), -1)
        known = np.where(np.isfinite(room), room, np.nanmedian(np.where(np.isfinite(room), room, np.nan)))
        radiance = self._surface.light(states[:, :2]) / np.abs(rays.launch @ self._surface.normal)
        power = np.where(hit, radiance, 0.0).reshape(len(places), -1) * known * reach.prod(axis=1)[:, None]
        return rays, power

    def _reach(self, start: np.ndarray) -> np.ndarray:
        """(m, 2) how far bundles about the states ``start`` (m, 4) go along either kept direction within all limits."""
        on_spot = np.einsum("mi,ij,mj->m", start[:, :2], self._surface.metric, start[:, :2])
        kept = self._kept[:2]
        limits = [(_SPOT_REACH + np.sqrt(on_spot), np.sqrt(np.einsum("ik,ij,jk->k", kept, self._surface.metric, kept)))]
        for number, (_, outline) in enumerate(self._rims):
            rows = self._to_rims[2 * number : 2 * number + 2]
            corner = _RIM_REACH * (1.0 if outline.is_round else np.sqrt(2))
            limits.append((corner + np.linalg.norm(start @ rows.T, axis=1), np.linalg.norm(rows @ self._kept, axis=0)))
        return np.min([far[:, None] / np.maximum(rate, 1e-300) for far, rate in limits], axis=0)

    def _aimed(self, states: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, _Traced]:
        """Rays that end at places (n, 2), from states (n, 4) close by: Broyden's method, along what moves ends most."""
        states = states.copy()
        inverse = np.broadcast_to(np.eye(2), (len(states), 2, 2)).copy()
        rays = self._trace(states)
        miss = rays.ends - places
        for _ in range(_ITERATIONS):
            if not np.any(np.linalg.norm(miss, axis=1) > _HIT):
                break
            step = -np.einsum("nij,nj->ni", inverse, miss)
            step = np.where(np.isfinite(step) & (np.abs(step) < _FARTHEST), step, 0.0)
            states += step @ self._towards.T
            rays = self._trace(states)
            change, miss = rays.ends - places - miss, rays.ends - places
            with np.errstate(invalid="ignore", divide="ignore"):
                predicted = np.einsum("nij,nj->ni", inverse, change)
                row = np.einsum("ni,nij->nj", step, inverse)
                update = (step - predicted)[:, :, None] * row[:, None]
                update /= np.einsum("ni,ni->n", step, predicted)[:, None, None]
            inverse += np.where(np.isfinite(update), update, 0.0)
        return states, rays
