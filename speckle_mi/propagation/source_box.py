"""The box that holds the sources, in axes that fit them: flat where they are flat."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..machine.cores import on_all_cores

SOURCES_AT_ONCE = 1 << 14
"""Sources handled by one thread at once: the arrays of a chunk stay in its cache."""

FLAT = 1e-9
"""Half extent relative to the largest (or absolute [mm] for a single point) below which a dimension is dropped."""


def chunks(count: int) -> Iterator[slice]:
    """Slices of ``SOURCES_AT_ONCE`` that cover ``count`` sources."""
    return (slice(first, min(first + SOURCES_AT_ONCE, count)) for first in range(0, count, SOURCES_AT_ONCE))


def for_chunks(work: Callable[[slice], object], count: int) -> list:
    """``work`` on every chunk of ``count`` sources, on all cores, results in order."""
    return on_all_cores(work, chunks(count))


@dataclass(frozen=True)
class SourceBox:
    """Box ``centre + x half[0] axes[0] + ...``, |x| <= 1: centre (3,) [mm], unit rows axes (3, 3), half (3,) [mm]."""

    centre: np.ndarray
    axes: np.ndarray
    half: np.ndarray

    @classmethod
    def around(cls, sources: np.ndarray, along: np.ndarray) -> SourceBox:
        """Smallest box with one face parallel to the sources' best plane and one edge nearest to ``along`` (3,).

        Sources (n, 3) [mm]. Where they are a line or a point, or fill space evenly, any fitting axes.
        """
        some = sources[:: max(1, len(sources) // 8192)]
        spread = some - some.mean(axis=0)
        normal = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        first = along - (along @ normal) * normal
        if np.linalg.norm(first) < 1e-6:
            first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        first /= np.linalg.norm(first)
        axes = np.stack([first, np.cross(normal, first), normal])

        def range_of(chunk: slice) -> np.ndarray:
            place = axes @ sources[chunk].T
            return np.stack([place.min(axis=1), -place.max(axis=1)])

        low, high = np.min(for_chunks(range_of, len(sources)), axis=0) * [[1], [-1]]
        half = (high - low) / 2
        half[half <= FLAT * max(half.max(), 1e-3)] = 0.0
        return cls((low + high) / 2 @ axes, axes, half)

    @property
    def corners(self) -> np.ndarray:
        """(8, 3) [mm]."""
        signs = np.array(list(product((-1.0, 1.0), repeat=3)))
        return self.to_world(signs)

    def to_world(self, places: np.ndarray) -> np.ndarray:
        """World points (n, 3) [mm] of places (n, 3) in [-1, 1]^3."""
        return self.centre + (places * self.half) @ self.axes

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """Places (n, 3) in [-1, 1]^3 of world points (n, 3) [mm]; 0 along a dropped dimension. Stored by coordinate."""
        scale = np.divide(1.0, self.half, out=np.zeros(3), where=self.half > 0)
        places = self.axes @ points.T
        places -= (self.axes @ self.centre)[:, None]
        places *= scale[:, None]
        return places.T
