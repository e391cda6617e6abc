"""Which lit scatterers the detector sees: those that face it and that the target itself does not hide."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from .assembly import Assembly
from .geometry import Frame, PlaneGrid
from .routes import screen_crossing
from .surface import Scatterers

_NOTICEABLE = 1e-3
"""Share of the power above which scatterers that only part of the detector sees are worth a warning."""

_OFF_SURFACE = 1e-3
"""Least distance [mm] from the target at which rays start, so that its own facets do not stop them."""


def _off_surface(points: np.ndarray) -> float:
    """That distance for points (n, 3) whose coordinates Mitsuba rounds to single precision, twice a ray [mm]."""
    return max(_OFF_SURFACE, 16 * float(np.finfo(np.float32).eps) * float(np.max(np.abs(points))))


def visible_scatterers(
    assembly: Assembly, frame: Frame, lit: Scatterers, viewpoints: list[np.ndarray]
) -> tuple[Scatterers, str]:
    """The scatterers that the laser and one of the viewpoints (3,) see, and a warning or an empty text.

    A viewpoint is where light goes first: an element, or the detector's centre. A bare detector sees only what lies in
    front of it. The user's own points radiate to all sides; a flat patch to its front; on a mesh, rays towards laser and
    viewpoint test whether the target shades itself.
    """
    free = assembly.target.points is not None
    seen = np.full(lit.count, free)
    for viewpoint in [] if free else viewpoints:
        faces = _faces(lit, viewpoint)
        seen |= faces if assembly.target.is_flat else faces & _unshaded(assembly, frame, lit, viewpoint)
    if not assembly.elements:
        # Through elements the light's last way is another: the routes know its side.
        seen &= lit.position @ assembly.detector.normal > assembly.detector.centre @ assembly.detector.normal
    note = "" if np.any(seen) else "no light: the detector sees none of the lit surface at this pose, the field is zero"
    if not (free or assembly.target.is_flat or assembly.elements) and np.any(seen):
        note = _note_of_horizon(assembly, lit, seen)
    return (lit if np.all(seen) else lit.selected(seen)), note


def _note_of_horizon(assembly: Assembly, lit: Scatterers, seen: np.ndarray) -> str:
    """A warning when parts of the detector see other parts of a curved surface than its centre does."""
    grid = assembly.detector
    half_u, half_v = (0.5 * grid.pitch * n for n in (grid.shape[1], grid.shape[0]))
    partly = np.zeros(lit.count, dtype=bool)
    for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        partly |= _faces(lit, grid.centre + a * half_u * grid.u + b * half_v * grid.v) != seen
    power = np.abs(lit.amplitude) ** 2
    if power[partly].sum() <= _NOTICEABLE * power[seen].sum():
        return ""
    return "part of the detector lies below the horizon of part of the lit surface: its field is not exact there"


def pixels_in_view(assembly: Assembly, frame: Frame, grid: PlaneGrid) -> np.ndarray | float:
    """1 where the straight way from the spot's middle to a pixel is free, (rows, columns), or 1.0 where all are.

    A flat target itself hides what lies behind its plane; elements hide what lies behind them. A way through the hole
    of a screen is not counted either: it is a way of its own.
    """
    if assembly.elements:
        return _unblocked_pixels(assembly, grid)
    if not assembly.target.is_flat or assembly.target.points is not None:
        return 1.0
    spot, normal = assembly.spot_at(frame)
    height = (grid.origin - spot) @ normal
    along_v, along_u = grid.rows * (grid.v @ normal), grid.columns * (grid.u @ normal)
    if height + along_v.min() + along_u.min() > 0:
        return 1.0
    return (height + along_v[:, None] + along_u > 0).astype(float)


def _unblocked_pixels(assembly: Assembly, grid: PlaneGrid) -> np.ndarray:
    """1 where the straight way from the spot's middle to a pixel is free of every shape of the scene, else 0."""
    spot, normal = assembly.spot_at(assembly.scene_frame)
    start = spot + _off_surface(spot) * normal
    to_pixel = grid.points() - start
    distance = np.linalg.norm(to_pixel, axis=1)
    start, direction = np.broadcast_to(start, to_pixel.shape), to_pixel / distance[:, None]
    free = _free(assembly.scene, start, direction, distance)
    for element in assembly.elements:
        if element.kind == "opening":
            crossing, in_hole, on_screen = screen_crossing(element, start, direction)
            free &= ~((in_hole | on_screen) & (crossing < distance))
    return free.reshape(grid.shape).astype(float)


def _faces(scatterers: Scatterers, point: np.ndarray) -> np.ndarray:
    normal, position = scatterers.normal, scatterers.position
    if len(normal) and normal.strides[0] == 0:  # the same for all of a flat patch
        return position @ normal[0] < point @ normal[0]
    return np.einsum("ij,ij->i", normal, point - position) > 0


def _unshaded(assembly: Assembly, frame: Frame, lit: Scatterers, viewpoint: np.ndarray) -> np.ndarray:
    """Whether the way to the laser and to the viewpoint is free of the target's own mesh, (n,) bool.

    The rays are turned into the pose of the mesh in the Mitsuba scene, so that no scene has to be built anew.
    """
    target = assembly.target
    current = target.frame.moved(target.shape.pose())
    points = current.to_world(frame.to_local(lit.position))
    normals = lit.normal @ frame.axes @ current.axes.T
    centre = current.to_world(frame.to_local(viewpoint[None]))[0]
    scene = _scene_of(target.shape)
    size = float(np.max(np.ptp(target.surface.facets.origin, axis=0), initial=0.0))
    start = points + normals * max(_off_surface(points), 1e-5 * size, 4 * target.surface.roughness)
    to_detector = centre - start
    distance = np.linalg.norm(to_detector, axis=1)
    to_laser = assembly.beam.directions_to_source(lit.position) @ frame.axes @ current.axes.T
    reach = np.full(len(start), 10 * size + np.max(distance))
    return _free(scene, start, to_laser, reach) & _free(scene, start, to_detector / distance[:, None], distance)


_target_scenes: dict[int, tuple[mi.Shape, mi.Scene]] = {}


def _scene_of(shape: mi.Shape) -> mi.Scene:
    """A scene with nothing but the target in it."""
    held = _target_scenes.get(id(shape))
    if held is None or held[0] is not shape:
        _target_scenes.clear()
        _target_scenes[id(shape)] = held = (shape, mi.load_dict({"type": "scene", "target": shape}))
    return held[1]


def _free(scene: mi.Scene, start: np.ndarray, direction: np.ndarray, reach: np.ndarray) -> np.ndarray:
    rays = mi.Ray3f(
        o=mi.Point3f(*(mi.Float(column.astype(np.float32)) for column in start.T)),
        d=mi.Vector3f(*(mi.Float(column.astype(np.float32)) for column in direction.T)),
        maxt=mi.Float(reach.astype(np.float32)),
        time=0.0,
        wavelengths=mi.Color0f(),
    )
    return ~np.array(scene.ray_test(rays))
