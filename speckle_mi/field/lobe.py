"""Angular distribution of the scattered light, from the BSDF of the target: every scatterer has its facet's normal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from scipy.linalg import qr, solve_triangular

from ..geometry.motion import Motion
from ..plan.setup import Setup
from ..scattering.beam import Beam
from ..scattering.rough_surface import Scatterers
from ..scene.errors import SceneError

EVALUATED_AT_ONCE = 1 << 22
"""Directions of a BSDF evaluated at once, to bound the memory."""

SHARE = 0.1
"""Part of the tolerance that the expansion over facets may take."""

ALONG_NORMAL = 1e-6
"""Sine of the angle between the target's x axis and a normal below which its y axis gives the tangent."""


@dataclass(frozen=True)
class LobeTerm:
    """One term of an expansion sum_r s_r(j) p_r(D) of every scatterer's lobe.

    sources: (n,) factor of each scatterer, or 1; towards: places (m, 3) -> factor (m,) of each; moved: the same with
    the facet moved by an amount of a motion.
    """

    sources: np.ndarray | float
    towards: Callable[[np.ndarray], np.ndarray]
    moved: Callable[[np.ndarray, Motion, float], np.ndarray] | None = None


EVEN = (LobeTerm(1.0, lambda places: np.ones(len(places))),)
"""Radiation that is the same to all sides."""

STEP = 1e-2
"""Half the angle [rad] between the directions from which a lobe's change is taken: BSDFs are float32."""


class Lobe:
    """The target's BSDF, made of its description."""

    def __init__(self, recipe: dict, where: str) -> None:
        self._bsdf = mi.load_dict(recipe)
        flags = self._bsdf.flags()
        if mi.has_flag(flags, mi.BSDFFlags.Delta) and not mi.has_flag(flags, mi.BSDFFlags.Smooth):
            raise SceneError(
                f"{where}: 'lobe' needs a rough BSDF, {self._bsdf.class_name()} reflects like a mirror only"
            )

    def amplitude(
        self, beam: Beam, axes: np.ndarray, normals: np.ndarray, points: np.ndarray, directions: np.ndarray
    ) -> np.ndarray:
        """sqrt(f cos) (n, m) of the BSDF f at facets from the laser towards directions (n, m, 3) of any length.

        beam: that lights them; axes: (3, 3) the target's x, y, z; normals: (n, 3) unit normals; points: (n, 3) places
        on the facets [mm]; all in the world.
        """
        tangents = _tangents(axes, normals)
        local = np.stack([tangents, np.cross(normals, tangents), normals], axis=1)
        incoming = np.einsum("nij,nj->ni", local, beam.directions_to_source(points))
        directions = directions / np.linalg.norm(directions, axis=2, keepdims=True)
        amplitude = np.empty(directions.shape[:2])
        step = max(1, EVALUATED_AT_ONCE // directions.shape[1])
        for first in range(0, len(normals), step):
            part = slice(first, first + step)
            outgoing = np.einsum("nij,nmj->nmi", local[part], directions[part])
            shape = outgoing.shape[:2]
            si = mi.SurfaceInteraction3f()
            si.wi = _vectors(np.repeat(incoming[part], shape[1], axis=0))
            # f cos, as Mitsuba's eval gives it.
            value = self._bsdf.eval(mi.BSDFContext(), si, _vectors(outgoing.reshape(-1, 3)))
            value = np.maximum(np.array(value[0], dtype=np.float64), 0.0)
            amplitude[part] = np.sqrt(np.broadcast_to(value, (shape[0] * shape[1],))).reshape(shape)
        return amplitude

    def terms(
        self,
        setup: Setup,
        scatterers: Scatterers,
        launch: Callable[[np.ndarray, np.ndarray], np.ndarray],
        samples: np.ndarray,
        tolerance: float,
    ) -> tuple[LobeTerm, ...]:
        """The lobes of all scatterers as a short sum of products of a source's and a place's factor.

        launch: (points (n, 3), places (m, 3)) -> directions (n, m, 3) in which light leaves towards the places;
        samples: (m, 3) places spread over those that are asked for; tolerance: relative error of the field. The lobes
        of few facets stand for all, by a pivoted QR of what each sends to the samples (interpolative decomposition: H.
        Cheng et al., SIAM J. Sci. Comput. 26 (2005) 1389, doi:10.1137/030602678).
        """
        normals, points, facet = facets_of(scatterers, setup.spot.point)
        beam, axes = setup.assembly.beam, setup.frame.axes

        def term(number: int, factor: np.ndarray | float) -> LobeTerm:
            normal, point = normals[number][None], points[number][None]

            def moved(places: np.ndarray, motion: Motion, amount: float) -> np.ndarray:
                there = motion.moved(point, amount)
                turned = motion.turned(axes.T, amount).T
                return self.amplitude(beam, turned, motion.turned(normal, amount), there, launch(there, places))[0]

            still = lambda places: self.amplitude(beam, axes, normal, point, launch(point, places))[0]  # noqa: E731
            return LobeTerm(factor, still, moved)

        if len(normals) == 1:
            return (term(0, 1.0),)
        table = self.amplitude(beam, axes, normals, points, launch(points, samples))
        _, triangle, order = qr(table.T, mode="economic", pivoting=True)
        size = np.abs(np.diag(triangle))
        rank = max(1, int(np.count_nonzero(size > SHARE * tolerance * size[0])))
        coefficients = np.zeros((len(normals), rank))
        coefficients[order[:rank]] = np.eye(rank)
        coefficients[order[rank:]] = solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:]).T
        return tuple(term(order[k], coefficients[facet, k]) for k in range(rank))


@dataclass(frozen=True)
class LobeRate:
    """How a lobe changes as the target moves, or as the places move that it sends light to: as a lobe's terms.

    motion: of the target, or None; shift: (3,) of the places per unit [mm], or None; step: half the difference that is
    taken, in units of the motion.
    """

    lobe: Lobe
    motion: Motion | None
    shift: np.ndarray | None
    step: float

    def terms(self, *arguments) -> tuple[LobeTerm, ...]:
        """As :meth:`Lobe.terms`."""
        return tuple(LobeTerm(term.sources, self._rate(term)) for term in self.lobe.terms(*arguments))

    def _rate(self, term: LobeTerm) -> Callable[[np.ndarray], np.ndarray]:
        def at(places: np.ndarray, amount: float) -> np.ndarray:
            if self.motion is not None:
                return term.moved(places, self.motion, amount)
            return term.towards(places + amount * self.shift)

        return lambda places: (at(places, self.step) - at(places, -self.step)) / (2 * self.step)


def facets_of(scatterers: Scatterers, spot: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals and middles (f, 3) of the facets that scatterers lie on, and the number (n,) of each one's facet.

    spot: (3,) middle of what scatters on a flat patch [mm].
    """
    if scatterers.on_plane:  # the spot's middle stands for all of a flat patch
        return scatterers.normal[:1], spot[None], np.zeros(scatterers.count, dtype=np.int64)
    normals, facet = np.unique(scatterers.normal, axis=0, return_inverse=True)
    facet = facet.ravel()
    count = np.bincount(facet)[:, None]
    middles = np.stack([np.bincount(facet, column) for column in scatterers.position.T], axis=1) / count
    return normals, middles, facet


def _tangents(axes: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Unit tangents (n, 3) at facets of normals (n, 3): the target's x axis laid on each, its y where x is normal."""
    tangents = axes[:, 0] - (normals @ axes[:, 0])[:, None] * normals
    along = np.linalg.norm(tangents, axis=1) < ALONG_NORMAL
    tangents[along] = (axes[:, 1] - (normals @ axes[:, 1])[:, None] * normals)[along]
    return tangents / np.linalg.norm(tangents, axis=1, keepdims=True)


def _vectors(rows: np.ndarray) -> mi.Vector3f:
    return mi.Vector3f(*(mi.Float(np.ascontiguousarray(column, np.float32)) for column in rows.T))
