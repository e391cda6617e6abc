"""What a scene holds, as plain float64 data: laser beam, target, elements and detector.

Everything after this module works on an :class:`Assembly`; Mitsuba's scene is asked only here and where rays have
to find their way.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import mitsuba as mi
import numpy as np

from ..geometry.frames import Frame
from ..geometry.plane import PlaneGrid
from ..geometry.pose import Pose
from ..machine.memory import excess
from ..scattering.beam import Beam
from ..scattering.rough_surface import PointScatterers, RoughSurface
from .elements import Element, elements_of
from .errors import SceneError
from .parameters import integer_of, value_of

GRAZING = 1e-9
"""Cosine of the angle of incidence below which the beam cannot light the target."""

_ON_SURFACE = 1e-9
"""Depth in a glass, relative to its size, up to which a point still counts as on its surface."""

MAX_SUB_PIXELS = 10_000
"""Most sub-pixels a pixel: as many fields are computed."""

BYTES_PER_PIXEL = 40
"""Memory of one frame at its peak: the field (16), its intensity (4), a working copy (16) and what is done in tiles."""


@dataclass(frozen=True)
class Options:
    """What the integrator was asked for."""

    method: str = "auto"
    tolerance: float = 1e-4
    diffraction: bool = True
    rays_per_source: int = 1500


@dataclass(frozen=True)
class Target:
    """The rough target at rest.

    frame: its place; surface or points: what scatters; spot: (3,) where the beam's axis meets it [mm], world;
    spot_normal: (3,) unit normal there; shape: the Mitsuba shape; lobe: whether its BSDF shapes the radiation.
    """

    frame: Frame
    surface: RoughSurface
    points: PointScatterers | None
    spot: np.ndarray
    spot_normal: np.ndarray
    lobe: bool
    shape: mi.Shape

    @property
    def is_flat(self) -> bool:
        """Whether it is a single plane patch, which cannot shade itself."""
        return self.surface.facets.count == 1


@dataclass(frozen=True)
class Assembly:
    """One laser, one target, one detector, the elements between, and what the scene asks of the integrator."""

    beam: Beam
    target: Target
    elements: tuple[Element, ...]
    detector: PlaneGrid
    options: Options
    pose: Pose
    sub_pixels: int
    scene: mi.Scene

    @property
    def seed(self) -> int:
        """Which surface."""
        return self.target.surface.seed

    @property
    def scene_frame(self) -> Frame:
        """Where the target's mesh stands in the Mitsuba scene."""
        return self.target.frame.moved(self.pose)

    @cached_property
    def obstacles(self) -> mi.Scene:
        """The shapes that may stand in the light's way: all of the scene, without a target that is only scatterers.

        The user's own scatterers replace the target's surface: its mesh still stands in the scene, but is not there.
        """
        if self.target.points is None:
            return self.scene
        return mi.load_dict({"type": "scene"} | {f"element{k}": one.shape for k, one in enumerate(self.elements)})

    def spot_at(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Middle of what scatters with the target at ``frame``: point (3,) [mm] and normal (3,).

        Where the beam's axis meets the surface, which is taken as plane around the spot at rest (where the axis runs
        along it, the material's own place); the mean of the user's own points.
        """
        turn = frame.axes @ self.target.frame.axes.T
        normal = turn @ self.target.spot_normal
        if self.target.points is not None:
            return frame.to_world(self.target.points.points.mean(axis=0)[None])[0], normal
        place = frame.origin + turn @ (self.target.spot - self.target.frame.origin)
        slope = float(normal @ self.beam.axis)
        if abs(slope) < GRAZING:
            return place, normal
        return self.beam.origin + (normal @ (place - self.beam.origin)) / slope * self.beam.axis, normal

    def with_seed(self, seed: int) -> Assembly:
        """The same assembly with another surface."""
        surface = replace(self.target.surface, seed=seed)
        return replace(self, target=replace(self.target, surface=surface))

    def with_options(self, **changes) -> Assembly:
        """The same assembly with other options of the integrator."""
        return replace(self, options=replace(self.options, **changes))

    def fingerprint(self) -> str:
        """Hash of everything that determines the field but pose and seed, 16 hexadecimal digits."""
        return self._fingerprint

    @cached_property
    def _fingerprint(self) -> str:
        text = json.dumps(self._describe(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def _describe(self) -> dict:
        beam, target, grid = self.beam, self.target, self.detector
        facets, points = target.surface.facets, target.points
        return {
            "beam": [_digits(value) for value in (beam.origin, beam.axis, beam.reference)]
            + [repr(value) for value in (beam.radius, beam.wavefront_radius, beam.wavelength)],
            "target": [_digits(target.frame.origin), _digits(target.frame.axes), repr(target.lobe)]
            + [
                repr(value)
                for value in (target.surface.density, target.surface.roughness, target.surface.correlation_length)
            ]
            + [str(target.shape.bsdf()) if target.lobe else ""]
            + [_hash(facets.origin, facets.e1, facets.e2, facets.bounds, facets.edges)],
            "elements": [element.describe() for element in self.elements],
            "points": None if points is None else _hash(points.points, points.weights),
            "detector": [_digits(grid.origin), _digits(grid.u), _digits(grid.v), repr(grid.pitch), list(grid.shape)],
            "sub_pixels": self.sub_pixels,
            "options": [
                self.options.method,
                repr(self.options.tolerance),
                self.options.diffraction,
                self.options.rays_per_source,
            ],
        }


def assembly_from_scene(scene: mi.Scene, sensor: mi.Sensor | None = None, spp: int = 0) -> Assembly:
    """Collects the assembly of a loaded scene.

    Raises SceneError when a laser, target, detector or coherent integrator is missing or there are several, and for
    every shape that cannot be taken into account.
    """
    laser = _only(scene.emitters(), "Laser", "emitter", "laser")
    target = _only(scene.shapes(), "RoughTarget", "shape", "rough_target")
    detector = sensor if sensor is not None else _only(scene.sensors(), "Detector", "sensor", "detector")
    if type(detector).__name__ != "Detector":
        raise SceneError(f"sensor {detector.id()!r} is a {detector.class_name()}, must be a detector")
    integrator = scene.integrator()
    if type(integrator).__name__ != "Coherent":
        found = "none" if integrator is None else integrator.class_name()
        raise SceneError(f"the scene's integrator is {found}, must be <integrator type=\"coherent\"/>")
    for emitter in scene.emitters():
        if emitter is not laser:
            raise SceneError(
                f"emitter {emitter.id()!r} ({emitter.class_name()}) is not a laser: "
                "its light would be left out, remove it"
            )
    _require_memory(detector)
    elements = tuple(elements_of(scene, target))
    beam, target = _aim(laser.beam(), target)
    _require_apart(elements)
    _require_in_air(elements, f"{detector.where}: the detector's centre", detector.grid().centre)
    _require_in_air(elements, f"{target.shape.where}: the middle of the spot", target.spot)
    return Assembly(
        beam=beam,
        target=target,
        elements=elements,
        detector=detector.grid(),
        options=integrator.options,
        pose=target.shape.pose(),
        sub_pixels=_sub_pixels(spp or detector.sampler().sample_count()),
        scene=scene,
    )


def _require_memory(detector: mi.Sensor) -> None:
    """SceneError where one image alone would take more memory than the machine has, or has no pixel."""
    columns, rows = (int(n) for n in detector.film().size())
    if columns < 1 or rows < 1:
        raise SceneError(f"{detector.where}: the film has {columns} x {rows} pixels, must have at least 1 x 1")
    if too_much := excess(BYTES_PER_PIXEL * columns * rows):
        raise SceneError(f"{detector.where}: {columns} x {rows} pixels {too_much}: set a smaller width or height")


def _require_apart(elements: tuple[Element, ...]) -> None:
    """SceneError where two screens lie in each other: light would go from the one to the other over no distance."""
    for first, second in combinations([element for element in elements if element.kind == "opening"], 2):
        a, b = first.faces[0].frame, second.faces[0].frame
        offset, room = b.origin - a.origin, (first.size + second.size) / 2
        parallel = np.linalg.norm(np.cross(a.axes[:, 2], b.axes[:, 2])) < _ON_SURFACE
        if parallel and abs(offset @ a.axes[:, 2]) < _ON_SURFACE * room and np.linalg.norm(offset) < room:
            raise SceneError(
                f"apertures {first.name!r} and {second.name!r} lie in one plane and overlap, must stand apart: "
                "make one opening of them"
            )


def _require_in_air(elements: tuple[Element, ...], what: str, point: np.ndarray) -> None:
    """SceneError where a point (3,) lies inside a glass, where no way of the light begins or ends."""
    for element in elements:
        if element.kind == "glass" and _is_inside(element, point):
            raise SceneError(f"{what} lies inside the glass of {element.name!r}, must lie outside")


def _is_inside(element: Element, point: np.ndarray) -> bool:
    """Whether a point (3,) lies between the faces of a glass, by more than rounding."""
    if element.closed:
        face = element.faces[0]
        centre = face.frame.origin + face.frame.axes[:, 2] / face.curvature
        return float(np.linalg.norm(point - centre)) < (1 - _ON_SURFACE) / abs(face.curvature)
    middle = np.mean([face.frame.origin for face in element.faces], axis=0)
    depths = []
    for face in element.faces:
        (x, y, z), (_, _, inwards) = face.frame.to_local(np.array([point, middle]))
        if np.any(face.outline.margins(x, y) < 0):
            return False
        depths.append((z - face.sag(x * x + y * y)) * np.sign(inwards))
    return min(depths) > _ON_SURFACE * element.size


def _only(candidates: list, kind: str, role: str, plugin: str):
    found = [candidate for candidate in candidates if type(candidate).__name__ == kind]
    if len(found) != 1:
        names = ", ".join(candidate.where.partition(" ")[2] for candidate in found)
        tag = f"<{role} type={plugin!r}>"
        there = f"{len(found)} of {tag}: {names}" if found else f"no {tag}"
        raise SceneError(f"the scene has {there}, must have exactly one")
    return found[0]


def _sub_pixels(samples: int) -> int:
    """Side of the square of sub-pixels that holds at least ``samples`` of them. SceneError for too many."""
    if samples > MAX_SUB_PIXELS:
        raise SceneError(f"{samples} sub-pixels a pixel (spp, sample_count): must be at most {MAX_SUB_PIXELS}")
    return max(1, int(np.ceil(np.sqrt(samples) - 1e-9)))


def _aim(beam: Beam, shape: mi.Shape) -> tuple[Beam, Target]:
    """The beam aimed at where its axis meets the target at rest, and the target with its density of scatterers."""
    frame, facets = shape.placement.frame, shape.facets
    spot, normal = _where_axis_meets(facets, frame, beam, shape.where, required=shape.points is None)
    beam = beam.aimed_at(beam.origin + ((spot - beam.origin) @ beam.axis) * beam.axis)
    if np.isinf(beam.radius):
        density = shape.point_sources / float(np.sum(facets.area))
    else:
        density = shape.point_sources * abs(float(normal @ beam.axis)) / (np.pi * beam.radius**2)
    surface = RoughSurface(
        facets=facets,
        density=density,
        roughness=value_of(shape.roughness) * 1e-3,
        correlation_length=value_of(shape.correlation_length) * 1e-3,
        seed=integer_of(shape.seed),
    )
    return beam, Target(frame, surface, shape.points, beam.reference, normal, shape.lobe, shape)


def _where_axis_meets(facets, frame: Frame, beam: Beam, where: str, required: bool) -> tuple[np.ndarray, np.ndarray]:
    """Where the beam's axis first meets the surface, else the target's plane: point and normal (3,) in the world."""
    origin, axis = frame.to_local(beam.origin[None])[0], frame.axes.T @ beam.axis
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = facets.normal @ axis
        distance = np.einsum("fk,fk->f", facets.normal, facets.origin - origin) / slope
    distance[np.abs(slope) < GRAZING] = np.nan
    hit = origin + distance[:, None] * axis - facets.origin
    a, b = (np.einsum("fk,fk->f", hit, basis) for basis in (facets.e1, facets.e2))
    slack = 1e-9 * np.max(np.abs(facets.bounds))
    edges = facets.edges
    # Edge normals of triangles are not of unit length, which only makes the slack finer or coarser.
    inside = np.all(edges[..., 0] * a[:, None] + edges[..., 1] * b[:, None] <= edges[..., 2] + slack, axis=1)
    inside &= distance > 0
    if np.any(inside):
        first = int(np.nanargmin(np.where(inside, distance, np.inf)))
        normal = facets.normal[first]
        if slope[first] > 0 and required:
            raise SceneError(
                f"{where}: the laser lights the back of the target (its normal points away from the laser), "
                "must light its front: turn the target, or the faces of its mesh"
            )
    else:
        first, normal = None, np.array([0.0, 0.0, 1.0])
        if abs(axis[2]) < GRAZING:
            if required:
                raise SceneError(f"{where}: the laser's axis runs along the target's surface, must meet it")
            return frame.origin, frame.axes @ normal
        distance = np.array([-origin[2] / axis[2]])
    at = first if first is not None else 0
    return frame.to_world((origin + distance[at] * axis)[None])[0], frame.axes @ normal


def _digits(array: np.ndarray) -> list[str]:
    return [repr(float(value)) for value in np.ravel(array)]


def _hash(*arrays: np.ndarray) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
