"""Surfaces given by their height above the vertex plane: all that the optics asks of them follows from its derivatives.

A surface of a new form is a subclass with ``_slopes``, ``_bends``, ``turned`` and ``same_form``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .surface import Surface, dot

_STEPS = 40
"""Newton's steps at most: from the conic's crossing a handful is enough, far outside the rim there may be none."""

_CONVERGED = 1e-12
"""Size [mm] of a last step, relative to 1 mm and the distance from the vertex, with which a crossing counts."""

_PIECES = 24
"""Pieces of the part of a line inside the rim that are looked at for crossings."""

_HALVINGS = 60

_MOST = 4
"""Crossings of one line that are told."""

FLAT = 1e-9
"""Least root in a conic's height: beyond the equator the surface goes on as steep as there."""


@dataclass(frozen=True, eq=False)
class HeightSurface(Surface):
    """A surface z = h(x, y) that differs from a conic of revolution, which it has at its vertex."""

    @property
    def is_closed(self) -> bool:
        return False

    def _slopes(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Height [mm] and its derivatives along x and y at local x, y (n,)."""
        raise NotImplementedError

    def _bends(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Second derivatives of the height, xx, xy and yy [1/mm]."""
        raise NotImplementedError

    def sag(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return self._slopes(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))[0]

    def gradient(self, point: np.ndarray) -> np.ndarray:
        _, by_x, by_y = self._slopes(point[0], point[1])
        return np.stack([by_x, by_y, np.full_like(by_x, -1.0)])

    def bend(self, point: np.ndarray, tangents: np.ndarray) -> np.ndarray:
        xx, xy, yy = self._bends(point[0], point[1])
        return np.stack(
            [xx * tangents[0] + xy * tangents[1], xy * tangents[0] + yy * tangents[1], np.zeros_like(tangents[2])]
        )

    def intersect(
        self, point: np.ndarray, direction: np.ndarray, root: str = "vertex"
    ) -> tuple[np.ndarray, np.ndarray]:
        """As :meth:`Surface.intersect`, by Newton's method from the crossing with the conic, in float64."""
        foot = -dot(point, direction)
        start = point + foot * direction
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            guess, _ = super().intersect(point, direction)
            t = np.where(np.isfinite(guess), guess - foot, -start[2] / direction[2])
            for _ in range(_STEPS):
                height, by_x, by_y = self._slopes(start[0] + t * direction[0], start[1] + t * direction[1])
                miss = start[2] + t * direction[2] - height
                step = miss / (direction[2] - by_x * direction[0] - by_y * direction[1])
                t = t - step
                small = np.abs(step) <= _CONVERGED * (1.0 + np.abs(t))
                if np.all(small | ~np.isfinite(step)):
                    break
            t = np.where(small, t, np.nan)
        return foot + t, start + t * direction

    def crossings(self, point: np.ndarray, direction: np.ndarray, closed: bool) -> tuple[np.ndarray, np.ndarray]:
        """As :meth:`Surface.crossings`: lengths (4, n) and places (4, 3, n) of the crossings inside the outline.

        The part of each line inside the rim is looked at in pieces, which end where the line turns against the surface.
        """
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            foot = -dot(point, direction)
            start = point + foot * direction
            first, last = self._within(start, direction)
            nodes = first + (last - first) * np.linspace(0, 1, _PIECES + 1)[:, None]
            nodes = self._with_turns(nodes, start, direction)
            below = self._miss(nodes, start, direction)[0] < 0
            piece, ray = np.nonzero((below[1:] != below[:-1]) & (last > first))
            found = self._root(nodes[piece, ray], nodes[piece + 1, ray], start[:, ray], direction[:, ray], 0)
            length = np.full((_MOST, len(foot)), np.nan)
            order = np.lexsort((found, ray))
            found, ray = found[order], ray[order]
            rank = np.arange(len(ray)) - np.searchsorted(ray, ray)
            kept = rank < _MOST
            length[rank[kept], ray[kept]] = (foot[ray] + found)[kept]
            hit = point[None] + length[:, None] * direction
            outside = np.array([np.any(self.outline.margins(x, y) < 0, axis=0) for x, y, _ in hit])
        return np.where(outside, np.nan, length), hit

    def _within(self, start: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and last t (n,) of lines start + t direction in the cylinder and the slab that hold the surface."""
        reach = self.outline.reach * (1 + 1e-9)
        share = np.linspace(-1, 1, 129)
        heights = np.concatenate([self.sag(reach * share, 0.0 * share), self.sag(0.0 * share, reach * share),
                                  self.sag(reach * share, reach * np.sqrt(1 - share**2))])  # fmt: skip
        room = 0.01 * (np.ptp(heights) + reach)
        ends = np.array([[np.min(heights) - room], [np.max(heights) + room]])
        walls = np.sort((ends - start[2]) / direction[2], axis=0)
        a, b = direction[0] ** 2 + direction[1] ** 2, start[0] * direction[0] + start[1] * direction[1]
        root = np.sqrt(b * b - a * (start[0] ** 2 + start[1] ** 2 - reach**2))
        tube = np.where(a > 0, np.array([-b - root, -b + root]) / a, np.array([[-np.inf], [np.inf]]))
        first = np.fmax(walls[0], tube[0])
        last = np.where(np.isnan(tube[1]), np.nan, np.fmin(walls[1], tube[1]))
        none = ~(last > first)
        return np.where(none, 0.0, first), np.where(none, 0.0, last)

    def _miss(self, t: np.ndarray, start: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height of places on lines above the surface, and how it changes along them."""
        height, by_x, by_y = self._slopes(start[0] + t * direction[0], start[1] + t * direction[1])
        return start[2] + t * direction[2] - height, direction[2] - by_x * direction[0] - by_y * direction[1]

    def _with_turns(self, nodes: np.ndarray, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Nodes (2 m - 1, n): those given (m, n), and between where the line turns against the surface, if it does."""
        rising = self._miss(nodes, start, direction)[1] > 0
        piece, ray = np.nonzero(rising[1:] != rising[:-1])
        between = (nodes[1:] + nodes[:-1]) / 2
        between[piece, ray] = self._root(nodes[piece, ray], nodes[piece + 1, ray], start[:, ray], direction[:, ray], 1)
        woven = np.empty((2 * len(nodes) - 1, nodes.shape[1]))
        woven[::2], woven[1::2] = nodes, between
        return woven

    def _root(self, low: np.ndarray, high: np.ndarray, start, direction, which: int) -> np.ndarray:
        """Where the height above the surface (0) or its change (1) is zero between two places that it parts, (m,)."""
        sign = self._miss(low, start, direction)[which] < 0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            same = (self._miss(middle, start, direction)[which] < 0) == sign
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return (low + high) / 2
