"""Points on a plane: scattered, or on the regular grid of a detector. Lengths are millimetres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PlanePoints:
    """Points on a plane: ``origin + a u + b v``.

    origin: (3,) [mm]; u, v: (3,) orthonormal; a, b: (m,) coordinates [mm].
    """

    origin: np.ndarray
    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    b: np.ndarray

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit normal u x v."""
        return np.cross(self.u, self.v)

    @property
    def size(self) -> int:
        return int(self.a.size)

    def points(self) -> np.ndarray:
        """World positions (m, 3) [mm]."""
        return self.origin + self.a.reshape(-1, 1) * self.u + self.b.reshape(-1, 1) * self.v


@dataclass(frozen=True)
class PlaneGrid:
    """Regular grid of points on a plane, row-major: ``origin + column * pitch * u + row * pitch * v``.

    origin: (3,) centre of pixel (row 0, column 0) [mm]; u, v: (3,) orthonormal directions of
    increasing column and row; pitch [mm]; shape = (rows, columns).
    """

    origin: np.ndarray
    u: np.ndarray
    v: np.ndarray
    pitch: float
    shape: tuple[int, int]

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit normal u x v."""
        return np.cross(self.u, self.v)

    @property
    def size(self) -> int:
        return self.shape[0] * self.shape[1]

    @property
    def centre(self) -> np.ndarray:
        """(3,) middle of the grid [mm]."""
        rows, columns = self.shape
        return self.origin + self.pitch * ((columns - 1) / 2 * self.u + (rows - 1) / 2 * self.v)

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the sides along u and v, to the outer edges of the pixels [mm]."""
        return 0.5 * self.pitch * self.shape[1], 0.5 * self.pitch * self.shape[0]

    @property
    def columns(self) -> np.ndarray:
        """(columns,) coordinate along u from ``origin`` [mm]."""
        return self.pitch * np.arange(self.shape[1])

    @property
    def rows(self) -> np.ndarray:
        """(rows,) coordinate along v from ``origin`` [mm]."""
        return self.pitch * np.arange(self.shape[0])

    def index_of(self, pixels: PlanePoints) -> np.ndarray:
        """Flat indices (m,) of the grid points that lie nearest to points given in the grid's own coordinates."""
        rows, columns = (
            np.clip(np.rint(along / self.pitch).astype(np.int64), 0, count - 1)
            for along, count in zip((pixels.b, pixels.a), self.shape, strict=True)
        )
        return rows * self.shape[1] + columns

    def points(self) -> np.ndarray:
        """World positions (rows * columns, 3) [mm], row-major."""
        grid = self.origin + self.rows[:, None, None] * self.v + self.columns[None, :, None] * self.u
        return grid.reshape(-1, 3)
