"""Is this way free? Rays through copies of a scene's shapes.

Mitsuba's rays are single precision: they tell which shape is met and whether anything stands in a way, never a phase.
The scenes in which they run are made from an assembly's own geometry and belong to the tracer.
"""

from __future__ import annotations

import threading

import mitsuba as mi
import numpy as np

from ..geometry.frames import Frame
from .assembly import Target
from .body import Body
from .elements import Element

TARGET, NOTHING = -1, -2
"""What a ray meets besides an element: the target, nothing."""

_OFF_SURFACE = 1e-3
"""Least distance [mm] from a mesh at which rays start, so that its own facets do not stop them."""


def off_surface(points: np.ndarray) -> float:
    """That distance for points (n, 3) whose coordinates Mitsuba rounds to single precision, twice a ray [mm]."""
    return max(_OFF_SURFACE, 16 * float(np.finfo(np.float32).eps) * float(np.max(np.abs(points), initial=0.0)))


class Tracer:
    """Rays through some elements and a target.

    The target lies in a scene of its own, in its own frame: rays are turned into it, so that it may stand anywhere.
    """

    def __init__(self, elements: tuple[Element, ...], target: Target) -> None:
        self._bodies = tuple(element.body for element in elements)
        self._opaque = tuple(n for n, element in enumerate(elements) if element.kind == "opaque")
        self._target = None if target.points is not None else target.body
        self._scenes: dict[tuple[int, ...], tuple[mi.Scene, tuple[mi.Shape, ...]]] = {}
        self._lock = threading.Lock()

    def nearest_opaque(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Number of the opaque element that each ray meets first, or ``NOTHING``, and its distance (n,) [mm].

        origin, direction: (n, 3), world, directions of unit length.
        """
        number, distance = np.full(len(origin), NOTHING), np.full(len(origin), np.inf)
        scene, shapes = self._scene(self._opaque)
        clear = off_surface(origin)
        hit = scene.ray_intersect_preliminary(_rays(origin + clear * direction, direction))
        for place, shape in zip(self._opaque, shapes, strict=True):
            number[np.array(hit.shape == mi.ShapePtr(shape))] = place
        met = number != NOTHING
        distance[met] = np.array(hit.t, dtype=np.float64)[met] + clear
        return number, distance

    def nearest_target(self, origin: np.ndarray, direction: np.ndarray, frame: Frame) -> np.ndarray:
        """Distance (n,) [mm] at which rays (n, 3) meet the target's mesh, which stands at ``frame``; inf: nothing."""
        scene, _ = self._scene((TARGET,))
        local = frame.to_local(origin)
        clear = off_surface(local)
        hit = scene.ray_intersect_preliminary(_rays(local + clear * (direction @ frame.axes), direction @ frame.axes))
        return np.where(np.array(hit.is_valid()), np.array(hit.t, dtype=np.float64) + clear, np.inf)

    def free(
        self, numbers: tuple[int, ...], start: np.ndarray, direction: np.ndarray, reach: np.ndarray, frame: Frame
    ) -> np.ndarray:
        """Whether rays meet none of the elements ``numbers`` (or ``TARGET``) within their ``reach`` (n,) [mm], (n,).

        start, direction: (n, 3), world, directions of unit length; frame: where the target stands.
        """
        free = np.ones(len(start), dtype=bool)
        if elements := tuple(number for number in numbers if number != TARGET):
            scene, _ = self._scene(elements)
            free &= ~np.array(scene.ray_test(_rays(start, direction, reach)))
        if TARGET in numbers and self._target is not None:
            free &= self.free_of_target(frame.to_local(start), direction @ frame.axes, reach)
        return free

    def free_of_target(self, start: np.ndarray, direction: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Whether rays in the target's own frame do not meet it within ``reach`` (n,) [mm], (n,)."""
        scene, _ = self._scene((TARGET,))
        return ~np.array(scene.ray_test(_rays(start, direction, reach)))

    def _scene(self, numbers: tuple[int, ...]) -> tuple[mi.Scene, tuple[mi.Shape, ...]]:
        """A scene with nothing but the given shapes in it, and these."""
        with self._lock:
            if numbers not in self._scenes:
                bodies = [self._target if number == TARGET else self._bodies[number] for number in numbers]
                shapes = tuple(_shape_of(body) for body in bodies)
                parts = {f"shape{k}": shape for k, shape in enumerate(shapes)}
                self._scenes[numbers] = mi.load_dict({"type": "scene"} | parts), shapes
            return self._scenes[numbers]


def _shape_of(body: Body) -> mi.Shape:
    """A shape of Mitsuba's made from copied geometry."""
    if body.form != "mesh":
        return mi.load_dict({"type": body.form, "to_world": mi.ScalarTransform4f(body.to_world)})
    mesh = mi.Mesh("body", vertex_count=len(body.vertices), face_count=len(body.faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(body.vertices.ravel().astype(np.float32))
    parameters["faces"] = mi.UInt32(body.faces.ravel())
    parameters.update()
    return mesh


def _rays(origin: np.ndarray, direction: np.ndarray, reach: np.ndarray | None = None) -> mi.Ray3f:
    o, d = (mi_type(*(mi.Float(np.ascontiguousarray(column, np.float32)) for column in vectors.T))
            for mi_type, vectors in ((mi.Point3f, origin), (mi.Vector3f, direction)))  # fmt: skip
    if reach is None:
        return mi.Ray3f(o, d)
    return mi.Ray3f(o=o, d=d, maxt=mi.Float(reach.astype(np.float32)), time=0.0, wavelengths=mi.Color0f())
