"""A Gaussian beam carried along a traced ray: its complex curvatures, and Gouy's phase.

Light close to a ray is turned by u = M x where it passes aside of it by x, both across the ray: M is the (2, 2) matrix
of the wavefront's curvatures. A Gaussian beam has complex ones, M = 1/R + i lambda/(pi w^2) along its principal axes,
and rays beside it are carried alike: with the tangents (A, B; C, D) of an exactly traced ray M goes into
(C + D M)(A + B M)^-1 (J. A. Arnaud, "Nonorthogonal optical waveguides and resonators", Bell Syst. Tech. J. 49 (1970);
A. E. Siegman, Lasers (1986), section 20). Oblique incidence, astigmatism and any order of surfaces are in the tangents.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .launch import transverse
from .sequence import Interaction, Sequence
from .trace import march


@dataclass(frozen=True)
class CarriedBeam:
    """A beam behind the surfaces that it has come over.

    place: (3,) where its axis leaves the last one [mm]; direction: (3,) unit; basis: (3, 2) orthonormal columns across
    it; curvatures: (2, 2) complex, symmetric, in that basis [1/mm]; path: optical path up to there [mm]; gouy: phase
    [rad] by which it is behind that path, of both principal axes together; points: (s, 3) of the axis on all surfaces.
    """

    place: np.ndarray
    direction: np.ndarray
    basis: np.ndarray
    curvatures: np.ndarray
    path: float
    gouy: float
    points: np.ndarray

    def on(self, length: float) -> CarriedBeam:
        """The same after a length [mm] of the free way behind."""
        return CarriedBeam(
            self.place + length * self.direction, self.direction, self.basis, freely(self.curvatures, length),
            self.path + length, self.gouy + gouy_phase(self.curvatures, length), self.points,
        )  # fmt: skip

    @property
    def principal(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Axes (3, 2) of the ellipse of its intensity, complex curvatures (2,) along them, and the twist [1/mm].

        The twist is what couples the two axes: the wavefront's own principal axes lie elsewhere. Of a beam that is
        round its wavefront's axes are taken, and nothing is left.
        """
        spread, bend = self.curvatures.imag, self.curvatures.real
        sizes, turn = np.linalg.eigh(spread)
        if sizes[1] - sizes[0] <= 1e-9 * abs(sizes[1]):
            _, turn = np.linalg.eigh(bend)
        if abs(turn[0, 0]) < abs(turn[0, 1]):
            turn = turn[:, ::-1]  # the first axis is that which is nearer to the first of the basis
        turn = turn * np.where(np.diag(turn) < 0, -1.0, 1.0)
        along = turn.T @ self.curvatures @ turn
        return self.basis @ turn, np.diag(along), float(along[0, 1].real)


def freely(curvatures: np.ndarray, length: float) -> np.ndarray:
    """Curvatures (2, 2) after a length [mm] in one medium."""
    return curvatures @ np.linalg.inv(np.eye(2) + length * curvatures)


def gouy_phase(curvatures: np.ndarray, length: float) -> float:
    """Gouy's phase [rad] over a length [mm] in one medium, half of it from either principal axis.

    The roots of det(1 + s M) never cross the negative real axis as M's imaginary part is positive.
    """
    return 0.5 * float(np.sum(np.angle(1 + length * np.linalg.eigvals(curvatures))))


def stop_spread(radius: float, reach: float, wavelength: float) -> float:
    """Imaginary curvature [1/mm] that a stop of a radius ``reach`` adds to a beam of 1/e^2 ``radius``, both [mm].

    The Gaussian that stands for the light within has the same second moment, with u = 2 (reach/radius)^2 the radius
    radius sqrt(1 - u/(e^u - 1)): ``reach`` for a beam much wider than the stop.
    """
    u = 2 * (reach / radius) ** 2
    left = 1 - u / np.expm1(u) if u < 500 else 1.0
    return float(wavelength / np.pi * (1 / (radius**2 * max(left, 1e-12)) - 1 / radius**2))


def carried_beam(
    interactions: tuple[Interaction, ...], origin: np.ndarray, axes: np.ndarray, curvatures: np.ndarray,
    wavelength: float, stops: Mapping[int, float] | None = None,
) -> CarriedBeam:  # fmt: skip
    """A beam from ``origin`` (3,) along the last of ``axes`` (3, 3) over interactions that its axis is known to take.

    curvatures: (2, 2) complex along the first two axes at the origin [1/mm]; wavelength [mm]; stops: by the numbers of
    interactions that cut the beam, the radii [mm] of their outlines.
    """
    beam = CarriedBeam(origin, axes[:, 2], axes[:, :2], curvatures, 0.0, 0.0, np.empty((0, 3)))
    first = 0
    for number in (*sorted(stops or ()), None):
        last = len(interactions) if number is None else number + 1
        if last > first:
            beam = _over(interactions[first:last], beam)
        first = last
        if number is not None:
            size = float(np.sqrt(wavelength / np.pi)) * np.linalg.det(beam.curvatures.imag) ** -0.25
            spread = stop_spread(size, stops[number], wavelength)
            beam = replace(beam, curvatures=beam.curvatures + 1j * spread * np.eye(2))
    return beam


def _over(interactions: tuple[Interaction, ...], beam: CarriedBeam) -> CarriedBeam:
    """A beam behind some more surfaces."""
    zero, curvatures, basis = np.zeros((3, 2)), beam.curvatures, beam.basis
    moves, turns = np.concatenate([basis, zero], axis=1), np.concatenate([zero, basis], axis=1)
    state = np.concatenate([beam.place[:, None], beam.direction[:, None], moves, turns], axis=1)[:, :, None]
    path, gouy, here, points = beam.path, beam.gouy, curvatures, []
    for step in march(Sequence(interactions), state):
        length, frame = float(step.length[0]), step.interaction.surface.frame
        path += step.interaction.index_before * length
        gouy += gouy_phase(here, length)
        local = step.state[:, :, 0]
        points.append(frame.to_world(local[:, 0][None])[0])
        direction = frame.axes @ local[:, 1]
        basis = np.column_stack([one[:, 0] for one in transverse(direction[:, None])])
        aside, turned = (basis.T @ frame.axes @ local[:, some] for some in (slice(2, 6), slice(6, 10)))
        aside, turned = (part[:, :2] + part[:, 2:] @ curvatures for part in (aside, turned))
        here = turned @ np.linalg.inv(aside)
        here = 0.5 * (here + here.T)
    return CarriedBeam(points[-1], direction, basis, here, path, gouy, np.concatenate([beam.points, points]))
