"""Exact sequential ray tracing in float64: hit points, directions, optical path lengths, clearances of rims.

All rays advance together, one interaction at a time, in the local frame of each surface. A ray may carry tangents, the
derivatives of its position and direction along some parameters; they are propagated by the exact linearisation of
transfer, refraction and reflection (ray differentials; H. Igehy, "Tracing ray differentials", SIGGRAPH 1999,
doi:10.1145/311535.311555).

State of n rays with T tangents: (3, 2 + 2T, n) = position, unit direction, T position tangents, T direction tangents.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from .sequence import Interaction, Sequence
from .surface import BEHIND_TOLERANCE, dot

_PAST_START = 4.0
"""Factor on a step back within which the ray's own start lies on its way forward, in whatever medium."""


class RayStatus(IntEnum):
    """What became of a ray. After MISSED and TOTAL_INTERNAL_REFLECTION there is no ray, its results are NaN."""

    OK = 0
    OUTSIDE_OUTLINE = 1
    """Crossed a surface beyond its rim; followed all the same, as if the surface went on."""
    BEHIND = 2
    """The next surface lies behind the ray: the order of surfaces, or the root, is not this ray's."""
    MISSED = 3
    TOTAL_INTERNAL_REFLECTION = 4
    NOT_CONVERGED = 5
    """Aiming found no ray through the target."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Result of ``trace`` for n rays through s interactions.

    points: (s, n, 3) hit points, world [mm]; directions: (n, 3) unit, after the last interaction;
    optical_path_length: (n,) sum of index times length, from the origin to the last surface [mm];
    margins: (r, n) smooth signed clearance of the rims listed in ``Sequence.rims``, > 0 inside; a surface without an
    outline has no row;
    status: (n,) RayStatus codes, the worst that happened;
    stopped_at: (n,) the interaction where it first did, -1 if nothing.
    """

    points: np.ndarray
    directions: np.ndarray
    optical_path_length: np.ndarray
    margins: np.ndarray
    status: np.ndarray
    stopped_at: np.ndarray

    @property
    def valid(self) -> np.ndarray:
        """(n,) rays that met every surface inside its outline."""
        return self.status == RayStatus.OK


@dataclass
class Step:
    """One interaction of ``march``, in the local frame of its surface.

    state: the rays after the interaction; length: (n,) [mm] from the interaction before; reflected_totally: (n,) or
    None; tube: the three coefficients (n,) of the ray tube's cross section on the way in, see ``march``, or None.
    """

    interaction: Interaction
    state: np.ndarray
    length: np.ndarray
    reflected_totally: np.ndarray | None
    tube: tuple[np.ndarray, np.ndarray, np.ndarray] | None


def trace(sequence: Sequence, origins: np.ndarray, directions: np.ndarray) -> Trace:
    """Follow rays from ``origins`` (n, 3) [mm] along ``directions`` (n, 3) (any length) through ``sequence``.

    Rays outside an outline go on as if there were none. Raises ValueError for shapes that do not fit or a direction of
    length zero.
    """
    origins, directions = paired_rows(origins, directions, "origins", "directions")
    norm = np.linalg.norm(directions, axis=1, keepdims=True)
    if not np.all(norm > 0.0):
        raise ValueError("directions: every ray needs a direction of non-zero, finite length")
    state = np.stack([origins.T, (directions / norm).T], axis=1)
    log = Log(origins.shape[0])
    points = []
    for step in march(sequence, state):
        log.add(step)
        points.append(step.interaction.surface.frame.to_world(step.state[:, 0].T))
    final = step.state[:, 1].T @ sequence.last.surface.frame.axes.T
    return Trace(np.stack(points), final, log.optical_path_length, log.stacked_margins(), log.status, log.stopped_at)


class Log:
    """Path length, margins and status of n rays, gathered from the steps of ``march``."""

    def __init__(self, n: int) -> None:
        self.optical_path_length = np.zeros(n)
        self.margins: list[np.ndarray] = []
        self.status = np.zeros(n, dtype=np.int8)
        self.stopped_at = np.full(n, -1, dtype=np.int16)
        self._index = 0

    def add(self, step: Step) -> None:
        """Account for the next interaction."""
        self.optical_path_length += step.interaction.index_before * step.length
        x, y, _ = step.state[:, 0]
        outline = step.interaction.surface.outline
        if outline:
            margins = outline.margins(x, y)
            self.margins.append(margins)
            self._note(np.any(margins < 0.0, axis=0), RayStatus.OUTSIDE_OUTLINE)
        self._note(step.length < -max(BEHIND_TOLERANCE, step.interaction.slack), RayStatus.BEHIND)
        self._note(~np.isfinite(step.length), RayStatus.MISSED)
        if step.reflected_totally is not None:
            self._note(step.reflected_totally, RayStatus.TOTAL_INTERNAL_REFLECTION)
        self._index += 1

    def stacked_margins(self) -> np.ndarray:
        """(r, n)."""
        return np.concatenate(self.margins) if self.margins else np.empty((0, self.status.size))

    def _note(self, where: np.ndarray, status: RayStatus) -> None:
        # A ray that has ended is NaN from there on; the reason it ended for came first, so it stays.
        where = where & (self.status < status)
        self.status[where] = status
        self.stopped_at[where] = self._index


def march(sequence: Sequence, state: np.ndarray, tubes: bool = False) -> Iterator[Step]:
    """Take ``state`` (3, 2 + 2T, n), world coordinates, through the interactions, one ``Step`` each.

    tubes (T = 2): also give the cross section of the ray tube spanned by the two tangents on the segment before each
    interaction, d . (q1 x q2) = a0 + a1 t + a2 t^2 at length t from its start, as (a0, a1, a2).
    """
    count = (state.shape[1] - 2) // 2
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for interaction, change in zip(sequence.interactions, sequence.changes, strict=True):
            state = _change_frame(state, *change)
            tube = _tube(state) if tubes else None
            length, normal, incidence, normal_tangents = _transfer(interaction, state, count)
            total = None
            if interaction.action == "refract":
                total = _refract(interaction, state, count, normal, incidence, normal_tangents)
            elif interaction.action == "reflect":
                _reflect(state, count, normal, incidence, normal_tangents)
            yield Step(interaction, state, length, total, tube)


def _change_frame(state: np.ndarray, rotation: np.ndarray | None, shift: np.ndarray) -> np.ndarray:
    """A copy of the state in the next frame, see ``Sequence.changes``."""
    out = state.copy() if rotation is None else (rotation @ state.reshape(3, -1)).reshape(state.shape)
    out[:, 0] += shift[:, None]
    return out


def _tube(state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients of d . ((p1 + t d1) x (p2 + t d2)), (n,) each."""
    _, d, p1, p2, d1, d2 = np.moveaxis(state, 1, 0)
    return _triple(d, p1, p2), _triple(d, p1, d2) + _triple(d, d1, p2), _triple(d, d1, d2)


def _triple(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """a . (b x c), (n,)."""
    x = b[1] * c[2] - b[2] * c[1]
    y = b[2] * c[0] - b[0] * c[2]
    z = b[0] * c[1] - b[1] * c[0]
    return a[0] * x + a[1] * y + a[2] * z


def _transfer(
    interaction: Interaction, state: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Move the rays onto the surface, in place.

    Returns lengths (n,), unit normals N (3, n) or (3, 1), N . d (n,) and tangents of N (3, T, n), None if zero or
    unused.
    """
    surface = interaction.surface
    direction = state[:, 1]
    length, state[:, 0] = surface.intersect(state[:, 0], direction, interaction.root)
    if surface.is_plane:
        normal = np.array([[0.0], [0.0], [1.0]])
    else:
        gradient = surface.gradient(state[:, 0])
        scale = 1.0 / np.sqrt(dot(gradient, gradient))
        normal = gradient * scale
    incidence = direction[2] if surface.is_plane else dot(normal, direction)
    if not count:
        return length, normal, incidence, None
    # The tangent's hit stays on the surface: the length varies by -(N . dp)/(N . d).
    tangents = state[:, 2 : 2 + count]
    tangents += length * state[:, 2 + count :]
    along = tangents[2] if surface.is_plane else dot(normal[:, None], tangents)
    tangents -= direction[:, None] * (along / incidence)
    if surface.is_plane or interaction.action == "pass":
        return length, normal, incidence, None
    normal_tangents = surface.bend(state[:, 0], tangents)
    normal_tangents *= scale
    normal_tangents -= normal[:, None] * dot(normal[:, None], normal_tangents)
    return length, normal, incidence, normal_tangents


def _turning(state: np.ndarray, count: int, normal: np.ndarray, normal_tangents: np.ndarray | None) -> np.ndarray:
    """Tangents (T, n) of u = N . d."""
    tangents = dot(normal[:, None], state[:, 2 + count :])
    if normal_tangents is not None:
        tangents += dot(normal_tangents, state[:, 1, None])
    return tangents


def _refract(interaction: Interaction, state: np.ndarray, count: int, normal, u, normal_tangents) -> np.ndarray:
    """Snell's law d' = eta d + gamma N, in place; returns the mask (n,) of total internal reflection.

    gamma = w - eta u = (1 - eta^2) / (w + eta u), u = N . d, w = sign(u) sqrt(1 - eta^2 + eta^2 u^2): exactly nothing
    for equal indices.
    """
    eta = interaction.index_before / interaction.index_after
    u_tangents = _turning(state, count, normal, normal_tangents) if count else None
    square = (1.0 - eta) * (1.0 + eta) + (eta * u) ** 2
    w = np.copysign(np.sqrt(square), u)
    gamma = (1.0 - eta) * (1.0 + eta) / (w + eta * u)
    state[:, 1] = eta * state[:, 1] + gamma * normal
    if count:
        directions = state[:, 2 + count :]
        directions *= eta
        directions -= (eta * gamma / w) * u_tangents * normal[:, None]
        if normal_tangents is not None:
            directions += gamma * normal_tangents
    return square < 0.0


def _reflect(state: np.ndarray, count: int, normal: np.ndarray, u: np.ndarray, normal_tangents) -> None:
    """Law of reflection d' = d - 2 u N, u = N . d, in place."""
    u_tangents = _turning(state, count, normal, normal_tangents) if count else None
    state[:, 1] -= 2.0 * u * normal
    if count:
        state[:, 2 + count :] -= 2.0 * u_tangents * normal[:, None]
        if normal_tangents is not None:
            state[:, 2 + count :] -= 2.0 * u * normal_tangents


def paired_rows(one: np.ndarray, two: np.ndarray, name_one: str, name_two: str) -> tuple[np.ndarray, np.ndarray]:
    """Both as float64 (n, 3), or ValueError."""
    one, two = np.asarray(one, dtype=np.float64), np.asarray(two, dtype=np.float64)
    if one.ndim != 2 or one.shape[1] != 3 or one.shape != two.shape:
        raise ValueError(f"{name_one} {one.shape} and {name_two} {two.shape}: must both be (n, 3), one row a ray")
    return one, two


def tube_at_end(step: Step) -> tuple[np.ndarray, np.ndarray]:
    """Cross section (n,) of the ray tube at the end of a step, and distance (n,) [mm] to its nearest focal line.

    The distance is that of the nearer zero of a0 + a1 t + a2 t^2, on either side; inf for a collimated tube.
    """
    a0, a1, a2 = step.tube
    section, slope = a0 + step.length * (a1 + step.length * a2), a1 + 2.0 * step.length * a2
    bend = np.sqrt(np.maximum(slope * slope - 4.0 * section * a2, 0.0))
    return section, np.where(section == 0.0, 0.0, 2.0 * np.abs(section) / (np.abs(slope) + bend))


class Caustics:
    """Focal lines that n rays touch, counted from step to step of ``march``.

    Where a surface lies a little behind the place that a ray comes from, which ``Interaction.slack`` allows, the ray
    goes back to it and then forward past its own start: that point is no focus.
    """

    def __init__(self, n: int) -> None:
        self.count = np.zeros(n, dtype=np.int64)
        self._back = np.zeros(n)

    def add(self, step: Step) -> None:
        """Account for the segment before the next interaction."""
        a0, a1, a2 = step.tube
        skip = _PAST_START * self._back
        with np.errstate(invalid="ignore"):
            self.count += zeros_between(
                a0 + skip * (a1 + skip * a2), a1 + 2.0 * skip * a2, a2, np.maximum(step.length - skip, 0.0)
            )
            self._back = np.where(step.length < 0, -step.length, 0.0)


def zeros_between(a0: np.ndarray, a1: np.ndarray, a2: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Zeros of a0 + a1 t + a2 t^2 in 0 < t < length, (n,) int.

    The tube's wavefront has two real principal curvatures (Malus and Dupin), so the zeros are real: counted by signs,
    which still finds the double zero of a point focus when rounding makes its discriminant negative.
    """
    end = a0 + length * (a1 + length * a2)
    turn = -0.5 * a1 / a2
    one = a0 * end < 0.0
    two = (a0 * end > 0.0) & (a0 * a2 > 0.0) & (turn > 0.0) & (turn < length)
    return np.where(one, 1, np.where(two, 2, 0))
