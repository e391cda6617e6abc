"""How much room an assembly takes, and how close the laser's light comes to its parts."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..geometry.plane import PlaneGrid
from ..scene.assembly import Assembly

_PROJECTIONS = 200
"""Of a point onto a line and a rectangle in turn, until it rests where they are closest."""


def extent(assemblies: Iterable[Assembly]) -> np.ndarray:
    """(3,) size [mm] along the world's axes of the box around lasers, spots, elements and detectors.

    assemblies: of the detectors of one scene. Where a laser stands is a point, the target its spot.
    """
    assemblies = list(assemblies)
    points = [corners(one.detector) for one in assemblies]
    for part in assemblies[0].parts:
        points.append(np.array([part.beam.origin, part.spot.point]))
    points += [element.body.bounds for element in assemblies[0].elements]
    return np.ptp(np.concatenate(points), axis=0)


def clearance(assemblies: Iterable[Assembly]) -> float:
    """Least gap [mm] between the laser's light and a detector or an element, below 0 where it is in its way.

    The light is a cylinder of the beam's radius (1/e^2 intensity, the larger one) from the laser to the spot; a
    detector is its rectangle, an element its corners.
    """
    assemblies, gaps = list(assemblies), [np.inf]
    for part in assemblies[0].parts:
        line = np.array([part.beam.origin, part.spot.point])
        thick = float(part.beam.radii.max()) if np.all(np.isfinite(part.beam.radii)) else 0.0
        gaps += [_to_rectangle(line, one.detector) - thick for one in assemblies]
        for element in part.elements:
            body = element.body
            points = body.vertices if body.vertices is not None else _box(body.bounds)
            gaps.append(float(np.min(np.linalg.norm(points - _on_line(line, points), axis=1))) - thick)
    return float(min(gaps))


def corners(grid: PlaneGrid) -> np.ndarray:
    """(4, 3) of a detector [mm]."""
    half_u, half_v = grid.half_size
    return np.array([grid.centre + a * half_u * grid.u + b * half_v * grid.v for a in (-1, 1) for b in (-1, 1)])


def _box(bounds: np.ndarray) -> np.ndarray:
    return np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def _on_line(line: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 3) the points of a line's piece (2, 3) that are closest to points (n, 3)."""
    along = line[1] - line[0]
    share = np.clip((points - line[0]) @ along / max(along @ along, 1e-300), 0, 1)
    return line[0] + share[:, None] * along


def _to_rectangle(line: np.ndarray, grid: PlaneGrid) -> float:
    """Distance [mm] of a line's piece (2, 3) from a detector's rectangle; of two convex sets projections find it."""
    half_u, half_v = grid.half_size
    point = grid.centre
    for _ in range(_PROJECTIONS):
        nearest = _on_line(line, point[None])[0]
        offset = nearest - grid.centre
        point = (
            grid.centre
            + np.clip(offset @ grid.u, -half_u, half_u) * grid.u
            + np.clip(offset @ grid.v, -half_v, half_v) * grid.v
        )
    return float(np.linalg.norm(nearest - point))
