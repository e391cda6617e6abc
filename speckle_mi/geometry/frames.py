"""Cartesian frames in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .pose import Pose


@dataclass(frozen=True)
class Frame:
    """A Cartesian frame in the world: ``origin`` (3,) [mm], ``axes`` (3, 3) with unit columns x, y, z."""

    origin: np.ndarray
    axes: np.ndarray

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """World coordinates (n, 3) of local points (n, 3)."""
        return self.origin + np.asarray(points) @ self.axes.T

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """Local coordinates (n, 3) of world points (n, 3)."""
        return (np.asarray(points) - self.origin) @ self.axes

    def moved(self, pose: Pose) -> Frame:
        """The frame after a rigid motion given in its own axes about its own origin."""
        return Frame(self.origin + self.axes @ pose.translation, self.axes @ pose.rotation)
