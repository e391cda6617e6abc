"""The part of a plane that a target covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.plane import PlaneGrid, PlanePoints


@dataclass(frozen=True)
class Area:
    """Part of the target's plane, a[0]..a[1] along u and b[0]..b[1] along v [mm]."""

    a: tuple[float, float]
    b: tuple[float, float]

    @classmethod
    def around(cls, target: PlaneGrid | PlanePoints) -> Area:
        if isinstance(target, PlaneGrid):
            return cls((0.0, float(target.columns[-1])), (0.0, float(target.rows[-1])))
        return cls((float(target.a.min()), float(target.a.max())), (float(target.b.min()), float(target.b.max())))

    @property
    def sides(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return self.a, self.b

    def unit_places(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Places (m, 2) of coordinates a, b (m,) [mm]: [-1, 1] from end to end, 0 along a side of no length."""
        places = np.zeros((len(a), 2))
        for column, values, side in zip(places.T, (a, b), self.sides, strict=True):
            if side[1] > side[0]:
                column[:] = (2 * values - side[0] - side[1]) / (side[1] - side[0])
        return places

    def points(self, target: PlaneGrid | PlanePoints, places: np.ndarray) -> PlanePoints:
        """Points of the target's plane at places (m, 2) in [-1, 1]^2."""
        a, b = (
            (side[0] + side[1]) / 2 + (side[1] - side[0]) / 2 * values
            for side, values in zip(self.sides, places.T, strict=True)
        )
        return PlanePoints(target.origin, target.u, target.v, a, b)


def points_at(target: PlaneGrid | PlanePoints, index: np.ndarray) -> PlanePoints:
    """The points of the target with flat indices ``index`` (m,)."""
    if isinstance(target, PlaneGrid):
        row, column = np.divmod(index, target.shape[1])
        return PlanePoints(target.origin, target.u, target.v, column * target.pitch, row * target.pitch)
    return PlanePoints(target.origin, target.u, target.v, target.a[index], target.b[index])
