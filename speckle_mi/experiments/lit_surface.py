"""The target as first-order theory takes it: its tangent plane where it is lit, and the light on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.motion import Motion
from ..geometry.pose import DEGREES_OF_FREEDOM
from ..geometry.rotation import vectors_across
from ..propagation.rates import STEP
from ..scattering.beam import Beam
from ..scene.assembly import Assembly

_LEAST = 1e-3
"""Radius [mm] of the spot that stands for light that has no middle, and least one of the user's own points."""

_WIDEST = 1e3
"""Radius [mm] that a spot has at most, as where light grazes."""

_STEP = 0.01
"""Step [mm] of the second differences that tell the spot's radii: a Gaussian beam's loss is quadratic."""


@dataclass(frozen=True)
class LitSurface:
    """The tangent plane of the target at rest where it is lit.

    point, normal: (3,) middle of the spot [mm] and unit normal; tangents: (2, 3); metric: (2, 2), p^T metric p is the
    square of the distance from the middle in spot radii [1/mm^2], p along the tangents; patch: the square of what is
    beyond the sides of a patch, each half of them 1, as (2, 2) and its middle (2,), None where it has none; beam: whose
    light is on it, None where a Gaussian spot of the metric stands for it; fading: (2, 2) as the metric, of the light
    alone, that material moves through.
    """

    point: np.ndarray
    normal: np.ndarray
    tangents: np.ndarray
    metric: np.ndarray
    patch: tuple[np.ndarray, np.ndarray] | None
    beam: Beam | None
    fading: np.ndarray

    @classmethod
    def of(cls, assembly: Assembly) -> LitSurface:
        """Of the target at rest; light without a width lights all of a patch, of a mesh a small spot."""
        spot, target, beam = assembly.spot, assembly.target, assembly.beam
        tangents = vectors_across(spot.normal)
        if target.points is not None:
            offset = (target.frame.to_world(target.points.points) - spot.point) @ tangents.T
            spread = offset.T @ offset / len(offset)
            least = _LEAST**2 + 1e-3 * float(np.trace(spread))
            metric = np.linalg.inv(4 * spread + least * np.eye(2))
            return cls(spot.point, spot.normal, tangents, metric, None, None, np.zeros((2, 2)))
        metric, patch = _beam_metric(beam, spot.point, tangents), _patch(assembly, tangents)
        if patch is not None:
            return cls(spot.point, spot.normal, tangents, metric + patch[0].T @ patch[0], patch, beam, metric)
        if metric.trace() < 4 * _WIDEST**-2:
            return cls(spot.point, spot.normal, tangents, np.eye(2) / _LEAST**2, None, None, np.zeros((2, 2)))
        return cls(spot.point, spot.normal, tangents, metric, None, beam, metric)

    def shrunk(self, share: float) -> LitSurface:
        """A Gaussian spot of so much of the radius."""
        return replace(self, metric=self.metric / share**2, fading=self.fading / share**2, patch=None, beam=None)

    def points(self, along: np.ndarray) -> np.ndarray:
        """World points (..., 3) at coordinates (..., 2) along the tangents."""
        return self.point + along @ self.tangents

    def light(self, along: np.ndarray) -> np.ndarray:
        """Intensity (n,) at coordinates (n, 2), 1 in the middle and 0 beyond the patch."""
        if self.beam is None:
            return np.exp(-2 * np.einsum("ni,ij,nj->n", along, self.metric, along))
        middle = self.beam.log_field(self.point[None])
        value = np.exp(2 * (self.beam.log_field(self.points(along)) - middle).real)
        if self.patch is None:
            return value
        sides, centre = self.patch
        return np.where(np.all(np.abs(along @ sides.T - centre) <= 1, axis=1), value, 0.0)


def _beam_metric(beam: Beam, point: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """(2, 2) the form p^T metric p that is 1 where the light's intensity has fallen to 1/e^2 of the middle's."""
    corners = _STEP * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]])
    loss = -beam.log_field(point + corners @ tangents).real
    first, second = (loss[1] + loss[2]) / 2 - loss[0], (loss[3] + loss[4]) / 2 - loss[0]
    mixed = (loss[5] + loss[6] - loss[7] - loss[8]) / 8
    values, axes = np.linalg.eigh(np.array([[first, mixed], [mixed, second]]) / _STEP**2)
    return (axes * np.maximum(values, _WIDEST**-2)) @ axes.T


def _patch(assembly: Assembly, tangents: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Rows (2, 2) that take coordinates along the tangents to halves of the patch's sides, and its middle in these.

    None for a mesh, and where the beam's axis meets the plane beside the patch, which then stands for it.
    """
    target = assembly.target
    if not target.is_flat:
        return None
    low_a, high_a, low_b, high_b = target.surface.facets.bounds[0]
    half = 0.5 * np.array([high_a - low_a, high_b - low_b])
    axes = target.frame.axes[:, :2].T
    sides = axes @ tangents.T / half[:, None]
    place = axes @ (assembly.spot.point - target.frame.origin)
    middle = (0.5 * np.array([low_a + high_a, low_b + high_b]) - place) / half
    return (sides, middle) if np.all(np.abs(middle) <= 1) else None


def path_motions(assembly: Assembly, points: np.ndarray) -> np.ndarray:
    """(n, 6, 3) displacement of points (n, 3) on the target at rest per unit of its motions [mm/mm, mm/rad]."""
    motions = (Motion.of(dof, assembly.target.frame) for dof in DEGREES_OF_FREEDOM)
    return np.stack([motion.velocity(points) for motion in motions], axis=1)


def path_changes(assembly: Assembly, points: np.ndarray, launch: np.ndarray) -> np.ndarray:
    """(n, 6) rates (grad psi + grad_P V).a at which the target's motions change the paths of rays [mm/mm, mm/rad].

    points: (n, 3) on the target at rest; launch: (n, 3) the rays' unit directions there. grad_P V = -launch, in units
    of the medium around everything; grad psi is that of the beam's own phase, whatever its shape.
    """
    beam = assembly.beam
    steps = STEP * np.concatenate([np.eye(3), -np.eye(3)])
    phase = beam.log_field((points + steps[:, None]).reshape(-1, 3)).imag.reshape(6, -1) / beam.wavenumber
    gradient = ((phase[:3] - phase[3:]) / (2 * STEP)).T - launch
    return np.einsum("nqk,nk->nq", path_motions(assembly, points), gradient)
