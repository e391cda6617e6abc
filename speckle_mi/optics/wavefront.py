"""Second derivatives of the optical path over a plane: how the wavefronts that cross it bend.

The path V from a fixed place to one of the plane has the gradient n d over it, d the direction of the arriving ray; the
path on from there to a fixed place has -n d, d that of the leaving ray (W. R. Hamilton's characteristic function;
M. Born and E. Wolf, Principles of Optics, section 4.1). How d turns along the plane comes from the ray's tangents.
"""

from __future__ import annotations

import numpy as np

from ..geometry.frames import Frame
from .launch import launch_state, transverse
from .sequence import Sequence
from .trace import march


def arriving_curvature(sequence: Sequence, source: np.ndarray, launch: np.ndarray) -> np.ndarray:
    """(2, 2) second derivatives [1/mm] of the path from ``source`` (3,) over the last plane, along its axes.

    launch: (3,) unit direction of the ray. With P and D, what turns at the source move and turn at the end, the light
    of a place dx aside arrives turned by D P^-1 dx. Infinite or NaN on a caustic, or where there is no ray.
    """
    direction = launch[:, None]
    for step in march(sequence, launch_state(source[:, None], direction, *transverse(direction))):
        pass
    moved, turned = step.state[:2, 2:4, 0], step.state[:2, 4:6, 0]
    with np.errstate(invalid="ignore", over="ignore"):
        return sequence.last.index_before * _solved(moved.T, turned.T).T


def leaving_curvature(sequence: Sequence, plane: Frame, place: np.ndarray, launch: np.ndarray) -> np.ndarray:
    """(2, 2) second derivatives [1/mm] of the path from ``place`` (3,) of ``plane`` on to a fixed one, along its axes.

    launch: (3,) unit direction of the ray. With A and B, what dx and a turn move at the end of the sequence, light of a
    place dx aside has to leave turned by -B^-1 A dx to end where it did. Infinite or NaN where those are conjugate.
    """
    direction = launch[:, None]
    zero, turns = np.zeros((3, 1)), transverse(direction)
    moves = plane.axes[:, :1], plane.axes[:, 1:2]
    state = np.stack([place[:, None], direction, *moves, zero, zero, zero, zero, *turns], axis=1)
    for step in march(sequence, state):
        pass
    along = plane.axes[:, :2].T @ np.concatenate(turns, axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        return sequence.interactions[0].index_before * along @ _solved(step.state[:2, 4:6, 0], step.state[:2, 2:4, 0])


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """matrix^-1 right, (2, 2) each; NaN where there is none."""
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return np.full((2, 2), np.nan)
