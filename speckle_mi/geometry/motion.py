"""Infinitesimal motions of a rigid body: the six that a target is moved by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .frames import Frame
from .pose import DEGREES_OF_FREEDOM, is_rotation
from .rotation import rotation_matrix


@dataclass(frozen=True)
class Motion:
    """A motion a(P) = shift + turn x (P - origin) per unit of it; shift (3,) [mm/unit], turn (3,) [rad/unit], world."""

    shift: np.ndarray
    turn: np.ndarray
    origin: np.ndarray

    @classmethod
    def of(cls, dof: str, frame: Frame) -> Motion:
        """One of the six motions of what stands at ``frame``, per mm or rad."""
        axis, nothing = frame.axes[:, DEGREES_OF_FREEDOM.index(dof) % 3], np.zeros(3)
        return cls(nothing, axis, frame.origin) if is_rotation(dof) else cls(axis, nothing, frame.origin)

    def velocity(self, points: np.ndarray) -> np.ndarray:
        """Displacement per unit (n, 3) of points (n, 3)."""
        return self.shift + np.cross(self.turn, points - self.origin)

    def moved(self, points: np.ndarray, amount: float) -> np.ndarray:
        """Places (n, 3) to which the finite motion takes points (n, 3)."""
        turn = rotation_matrix(amount * self.turn)
        return self.origin + (points - self.origin) @ turn.T + amount * self.shift

    def turned(self, vectors: np.ndarray, amount: float) -> np.ndarray:
        """Directions (n, 3) to which the finite motion takes directions (n, 3)."""
        return vectors @ rotation_matrix(amount * self.turn).T
