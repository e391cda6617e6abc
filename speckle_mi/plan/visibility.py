"""What hides light: the target itself from the detector, and the shapes that stand in a way of the light."""

from __future__ import annotations

import numpy as np

from ..geometry.plane import PlaneGrid
from ..geometry.rotation import vectors_across
from ..scattering.rough_surface import Scatterers
from ..scene.meeting import stands_between
from ..scene.tracer import TARGET, off_surface
from .setup import Setup

_NOTICEABLE = 1e-3
"""Share of the power above which scatterers that only part of the detector sees are worth a warning."""


def visible_scatterers(setup: Setup, lit: Scatterers, viewpoints: list[np.ndarray]) -> tuple[Scatterers, str]:
    """The scatterers that the laser and one of the viewpoints (3,) see, and a warning or an empty text.

    A viewpoint is where light goes first: an element, or the detector's centre. A bare detector sees only what lies in
    front of it. The user's own points radiate to all sides; a flat patch to its front; on a mesh, rays towards laser
    and viewpoint test whether the target shades itself.
    """
    free = setup.assembly.target.points is not None
    seen = np.full(lit.count, free)
    for viewpoint in [] if free else viewpoints:
        faces = _faces(lit, viewpoint)
        seen |= faces if setup.assembly.target.is_flat else faces & _unshaded(setup, lit, viewpoint)
    if not setup.assembly.elements:
        # Through elements the light's last way is another: the routes know its side.
        normal, centre = setup.assembly.detector.normal, setup.assembly.detector.centre
        seen &= lit.position @ normal > centre @ normal
    note = "" if np.any(seen) else "no light: the detector sees none of the lit surface at this pose, the field is zero"
    if not (free or setup.assembly.target.is_flat or setup.assembly.elements) and np.any(seen):
        note = _note_of_horizon(setup, lit, seen)
    return (lit if np.all(seen) else lit.selected(seen)), note


def _note_of_horizon(setup: Setup, lit: Scatterers, seen: np.ndarray) -> str:
    """A warning when parts of the detector see other parts of a curved surface than its centre does."""
    grid = setup.assembly.detector
    half_u, half_v = grid.half_size
    partly = np.zeros(lit.count, dtype=bool)
    for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        partly |= _faces(lit, grid.centre + a * half_u * grid.u + b * half_v * grid.v) != seen
    power = np.abs(lit.amplitude) ** 2
    if power[partly].sum() <= _NOTICEABLE * power[seen].sum():
        return ""
    return "part of the detector lies below the horizon of part of the lit surface: its field is not exact there"


def pixels_in_view(setup: Setup, grid: PlaneGrid) -> np.ndarray | float:
    """1 where a flat target itself does not hide its spot from a pixel, (rows, columns), or 1.0 where it hides none."""
    if not setup.assembly.target.is_flat or setup.assembly.target.points is not None:
        return 1.0
    spot, normal = setup.spot.point, setup.spot.normal
    height = (grid.origin - spot) @ normal
    along_v, along_u = grid.rows * (grid.v @ normal), grid.columns * (grid.u @ normal)
    if height + along_v.min() + along_u.min() > 0:
        return 1.0
    return (height + along_v[:, None] + along_u > 0).astype(float)


# Shapes that stand in a way of the light


def shapes_beside(setup: Setup, touched: tuple[int, ...], points: np.ndarray, clear: float = 0.0) -> list[str]:
    """Names of the shapes that a way does not go over, but that may stand in it.

    points: (p, n, 3) of its rays, start, surfaces and end; touched: number of the element at each of the p places, or
    ``TARGET``, ``NOTHING``; clear: distance [mm] around the rays that is looked at, too. Judged by bounding boxes: a
    shape named here may still leave all rays free.
    """
    segments = zip(touched, touched[1:], points, points[1:], strict=False)
    return [
        "target" if number == TARGET else setup.assembly.elements[number].name
        for one, two, start, end in segments
        for number in _beside(setup, one, two, start, end, clear)
    ]


def unblocked(setup: Setup, touched: tuple[int, ...], points: np.ndarray, clear: float = 0.0) -> np.ndarray:
    """Whether each of n rays is free of all shapes that the way does not go over, (n,); see :func:`shapes_beside`.

    A segment through the hole of a screen that is not on the way is not free either: that is a way of its own.
    clear: distance [mm] aside of the rays at which parallel ones are looked at instead, in eight directions.
    """
    free = np.ones(points.shape[1], dtype=bool)
    for one, two, start, end in zip(touched, touched[1:], points, points[1:], strict=False):
        for aside in _across(np.nanmean(end - start, axis=0), clear):
            free &= _segment_free(setup, one, two, start + aside, end + aside)
    return free


def _across(heading: np.ndarray, distance: float) -> np.ndarray:
    """Displacements (8, 3) across a heading (3,) [mm]; none, (1, 3), for the distance 0 or rays that go nowhere."""
    length = np.linalg.norm(heading)
    if distance == 0 or not length > 0:
        return np.zeros((1, 3))
    across = vectors_across(heading / length)
    angle = np.pi / 4 * np.arange(8)
    return distance * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across


def _segment_free(setup: Setup, one: int, two: int, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Whether segments from start to end (n, 3), at the elements ``one`` and ``two``, are free of all others, (n,)."""
    standing = _beside(setup, one, two, start, end)
    if not standing:
        return np.ones(len(start), dtype=bool)
    towards = end - start
    distance = np.linalg.norm(towards, axis=1)
    direction = towards / np.maximum(distance, 1e-300)[:, None]
    elements = setup.assembly.elements
    meshes = tuple(number for number in standing if number == TARGET or elements[number].kind == "opaque")
    free = np.ones(len(start), dtype=bool)
    if meshes:
        clear = off_surface(end)
        reach = np.maximum(distance - 2 * clear, 0)
        free = setup.tracer.free(meshes, start + clear * direction, direction, reach, setup.frame) | (reach <= 0)
    for number in standing:
        if number not in meshes:
            free &= ~stands_between(elements[number], start, direction, distance)
    return free


def _beside(setup: Setup, one: int, two: int, start: np.ndarray, end: np.ndarray, clear: float = 0.0) -> list[int]:
    """Numbers of what lies in the box around segments from start to end (n, 3) but at neither end."""
    low, high = np.fmin.reduce(np.fmin(start, end)), np.fmax.reduce(np.fmax(start, end))
    numbers, lowest, highest = setup.boxes
    overlaps = np.all((lowest - clear <= high) & (highest + clear >= low), axis=1)
    return [number for number in numbers[overlaps].tolist() if number not in (one, two)]


def _faces(scatterers: Scatterers, point: np.ndarray) -> np.ndarray:
    normal, position = scatterers.normal, scatterers.position
    if scatterers.on_plane:
        return position @ normal[0] < point @ normal[0]
    return np.einsum("ij,ij->i", normal, point - position) > 0


def _unshaded(setup: Setup, lit: Scatterers, viewpoint: np.ndarray) -> np.ndarray:
    """Whether the way to the laser and to the viewpoint is free of the target's own mesh, (n,) bool."""
    target, frame = setup.assembly.target, setup.frame
    points, normals = frame.to_local(lit.position), lit.normal @ frame.axes
    size = float(np.max(np.ptp(target.surface.facets.origin, axis=0), initial=0.0))
    start = points + normals * max(off_surface(points), 1e-5 * size, 4 * target.surface.roughness)
    to_detector = frame.to_local(viewpoint[None])[0] - start
    distance = np.linalg.norm(to_detector, axis=1)
    to_laser = setup.assembly.beam.directions_to_source(lit.position) @ frame.axes
    reach = np.full(len(start), 10 * size + np.max(distance))
    free_of_target = setup.tracer.free_of_target
    return free_of_target(start, to_laser, reach) & free_of_target(start, to_detector / distance[:, None], distance)
