"""Fans of rays from a source: exact traces with their tubes, over the solid angle that a detector takes up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.plane import PlaneGrid
from ..geometry.rotation import vectors_across
from ..optics.aim import aim
from ..optics.sequence import Sequence
from ..optics.trace import Log, RayStatus, march, tube_at_end, zeros_between

PROBE_RAYS, DENSE_PROBE_RAYS = 41, 201
"""Rays along each side of the lattices that find the solid angle to be covered; dense: the first look for a pinhole."""

PROBE_STEPS = 20

PROBE_WIDTHS = (0.02, 0.1, 0.4, 1.2)
"""Half widths [rad] of the fans that look for light where rays aimed at the detector find none."""

WIDEST = 1.3
"""Half width of a fan in equal-area coordinates; sqrt(2) in all directions is the half space."""


@dataclass(frozen=True)
class Rays:
    """Rays of one source at the detector's plane, n of them.

    a, b: (n,) places along u, v [mm]; path: (n,) [mm]; tube: (n,) signed section on the detector plane per solid angle
    [mm^2]; amplitude: (n,) [1/mm]; spread: (n,) |section| over that of free space; reach: (n,) length [mm] over which
    the tube has spread, from its nearest focal line or its source; caustics: (n,) focal lines touched; margins: (r, n);
    status: (n,).
    """

    a: np.ndarray
    b: np.ndarray
    path: np.ndarray
    tube: np.ndarray
    amplitude: np.ndarray
    spread: np.ndarray
    reach: np.ndarray
    caustics: np.ndarray
    margins: np.ndarray
    status: np.ndarray

    @property
    def free(self) -> np.ndarray:
        """(n,) not blocked."""
        return self.status == RayStatus.OK

    def within(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(n,) in the box low (2,) to high (2,) of the detector's plane."""
        with np.errstate(invalid="ignore"):
            return (self.a >= low[0]) & (self.a <= high[0]) & (self.b >= low[1]) & (self.b <= high[1])


def trace_fan(system: Sequence, source: np.ndarray, axes: np.ndarray, p: np.ndarray, q: np.ndarray) -> Rays:
    """Rays from ``source`` (3,) at equal-area coordinates p, q (n,) about ``axes[0]``, with their tubes."""
    log = Log(p.size)
    length, caustics = np.zeros(p.size), np.zeros(p.size, dtype=np.int64)
    with np.errstate(invalid="ignore", divide="ignore"):
        for step in march(system, _launch_state(source, axes, p, q), tubes=True):
            log.add(step)
            length += np.abs(step.length)
            caustics += zeros_between(*step.tube, step.length)
        section, focal_distance = tube_at_end(step)
        state = step.state
        return Rays(
            a=state[0, 0],
            b=state[1, 0],
            path=log.optical_path_length,
            tube=state[0, 2] * state[1, 3] - state[0, 3] * state[1, 2],
            amplitude=1.0 / np.sqrt(np.abs(section)),
            spread=np.abs(section) / length**2,
            reach=np.fmin(focal_distance, length),
            caustics=caustics,
            margins=log.stacked_margins(),
            status=log.status,
        )


def _launch_state(source: np.ndarray, axes: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Rays (3, 6, n) with tangents along p and q.

    d = (1 - s^2/2) c + sqrt(1 - s^2/4) (p e1 + q e2), s^2 = p^2 + q^2 (Lambert's azimuthal projection): dp dq is the
    solid angle, so a regular lattice in p, q is equally distributed over it.
    """
    centre, e1, e2 = axes[:, :, None]
    square = p * p + q * q
    scale = np.sqrt(1.0 - 0.25 * square)
    across = p * e1 + q * e2
    place = np.repeat(source[:, None], p.size, axis=1)
    state = np.zeros((3, 6, p.size))
    state[:, 0], state[:, 1] = place, (1.0 - 0.5 * square) * centre + scale * across
    state[:, 4] = -p * centre + scale * e1 - (0.25 * p / scale) * across
    state[:, 5] = -q * centre + scale * e2 - (0.25 * q / scale) * across
    return state


def detector_box(grid: PlaneGrid) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2,) of the detector [mm], outer edges of its pixels."""
    rows, columns = grid.shape
    return np.full(2, -0.5 * grid.pitch), grid.pitch * (np.array([columns, rows]) - 0.5)


@dataclass(frozen=True)
class LaunchCones:
    """Which solid angle every source has to fill: a window of equal-area coordinates, linear in the source's place.

    axes: (3, 3) rows c, e1, e2, c the middle direction; centre: (3,) of the spot [mm]; window: (4,) p low, p high,
    q low, q high for a source there, None where no light was found; slope: (3, 4) change [1/mm]; margin: (4,) what the
    linear law leaves open.
    """

    axes: np.ndarray
    centre: np.ndarray
    window: np.ndarray | None
    slope: np.ndarray
    margin: np.ndarray

    @classmethod
    def around(cls, system: Sequence, grid: PlaneGrid, position: np.ndarray) -> LaunchCones:
        """From the windows of the outermost sources and the middle one of (n, 3)."""
        centre = position.mean(axis=0)
        axes, start = _aimed_start(system, grid, centre)
        chosen = {int(np.argmin(((position - centre) ** 2).sum(axis=1)))}
        chosen |= {int(pick(position[:, i])) for i in range(3) for pick in (np.argmin, np.argmax)}
        some = position[sorted(chosen)]
        fans = [(PROBE_RAYS, np.array([-w, w, -w, w])) for w in PROBE_WIDTHS]
        starts = [(PROBE_RAYS, start), (DENSE_PROBE_RAYS, start), *fans]
        windows = [find_window(system, grid, axes, source, starts) for source in some]
        lit = [i for i, window in enumerate(windows) if window is not None]
        if not lit:
            return cls(axes, centre, None, np.zeros((3, 4)), np.zeros(4))
        limits, offset = np.array([windows[i] for i in lit]), some[lit] - centre
        middle, away = limits.mean(axis=0), offset.mean(axis=0)
        slope = np.linalg.lstsq(offset - away, limits - middle, rcond=1e-3)[0]
        margin = np.abs(limits - middle - (offset - away) @ slope).max(axis=0)
        return cls(axes, centre, middle - away @ slope, slope, margin * [-1, 1, -1, 1])

    def of(self, source: np.ndarray) -> np.ndarray | None:
        """Window (4,) of ``source`` (3,), or None."""
        if self.window is None:
            return None
        return np.clip(self.window + (source - self.centre) @ self.slope + self.margin, -WIDEST, WIDEST)


def _aimed_start(system: Sequence, grid: PlaneGrid, source: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) about the ray to the detector's middle and the window (4,) of rays aimed at edges and corners.

    The axes are turned so that p and q move the landing point along u and v, as far as a rotation can.
    """
    low, high = detector_box(grid)
    s, t = (mesh.ravel()[:, None] for mesh in np.meshgrid([0.5, 0.0, 1.0], [0.5, 0.0, 1.0]))
    edge = low + (high - low) * np.concatenate([s, t], axis=1)
    targets = grid.origin + edge[:, :1] * grid.u + edge[:, 1:] * grid.v
    paths = aim(system, np.repeat(source[None], 9, axis=0), targets)
    if paths.converged[0]:
        c = paths.launch[0]
    else:
        c = system.interactions[0].surface.frame.origin - source
        c = c / np.linalg.norm(c) if np.linalg.norm(c) > 0 else grid.normal
    axes = np.stack([c, *vectors_across(c)])
    for last in march(system, _launch_state(source, axes, np.zeros(1), np.zeros(1))):
        pass
    jacobian = last.state[:2, 2:4, 0]
    if np.isfinite(jacobian).all():
        left, _, right = np.linalg.svd(jacobian)
        axes[1:] = (left @ right) @ axes[1:]
    local = paths.launch[paths.converged] @ axes.T
    local = local[local[:, 0] > 0.0]
    across = local[:, 1:] * np.sqrt(2.0 / (1.0 + local[:, :1]))
    half = np.abs(across).max(axis=0, initial=1e-3)
    return axes, np.array([-half[0], half[0], -half[1], half[1]])


def find_window(system: Sequence, grid: PlaneGrid, axes, source, starts: list[tuple[int, np.ndarray]]):
    """Smallest window (4,) that holds every free ray of ``source`` to the detector, to a step of the probing lattice.

    starts: rays along a side and window (4,) of the lattices to begin with, one after the other until a ray arrives.
    The lattice is widened where rays at its edge still arrive, and narrowed where they do not. None: no ray does.
    """
    low, high = detector_box(grid)
    for n, window in starts:
        for _ in range(PROBE_STEPS):
            p, q = np.linspace(*window[:2], n), np.linspace(*window[2:], n)
            rays = trace_fan(system, source, axes, *(mesh.ravel() for mesh in np.meshgrid(p, q, indexing="ij")))
            arrives = (rays.free & rays.within(low, high)).reshape(n, n)
            if not arrives.any():
                break
            sides = [_side(p, arrives.any(axis=1)), _side(q, arrives.any(axis=0))]
            found = np.clip(np.concatenate([limits for limits, _ in sides]), -WIDEST, WIDEST)
            before, window, n = window, found, PROBE_RAYS
            narrowed = (found[1] - found[0]) * (found[3] - found[2]) < 0.6 * np.prod(before[1::2] - before[::2])
            if np.array_equal(before, found) or not (narrowed or any(open_ for _, open_ in sides)):
                return window
        else:
            return window
    return None


def _side(x: np.ndarray, arrives: np.ndarray) -> tuple[np.ndarray, bool]:
    """New limits (2,) along one axis, and whether light may go on beyond the lattice."""
    some = np.flatnonzero(arrives)
    step, width = x[1] - x[0], x[-1] - x[0]
    first, last = arrives[0], arrives[-1]
    limits = [x[some[0]] - (0.5 * width if first else step), x[some[-1]] + (0.5 * width if last else step)]
    return np.array(limits), bool(first or last)


def lattice(system: Sequence, axes, source, window, count: int) -> tuple[Rays, tuple[int, int], float]:
    """At most ``count`` rays on a lattice of squares over the window and one step beyond it."""
    width = np.maximum(window[1::2] - window[::2], 1e-12)
    along_p = int(np.clip(round(np.sqrt(count * width[0] / width[1])), 4, count // 4))
    shape = (along_p, count // along_p)
    axes_pq = []
    for i, n in enumerate(shape):
        beyond = width[i] / (n - 3) if n >= 10 else 0.0
        axes_pq.append(np.linspace(window[2 * i] - beyond, window[2 * i + 1] + beyond, n))
    p, q = axes_pq
    rays = trace_fan(system, source, axes, *(mesh.ravel() for mesh in np.meshgrid(p, q, indexing="ij")))
    return rays, shape, float((p[1] - p[0]) * (q[1] - q[0]))
