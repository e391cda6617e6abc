"""Reads a loaded Mitsuba scene into an assembly. Nothing of the scene is kept or changed."""

from __future__ import annotations

import re
from itertools import combinations

import mitsuba as mi
import numpy as np

from ..machine.memory import excess
from .assembly import Assembly
from .elements import Element
from .errors import SceneError
from .materials import medium_around
from .light import lights_of
from .shapes import shapes_of

_ON_SURFACE = 1e-9
"""Depth in a glass, relative to its size, up to which a point still counts as on its surface."""

_NAME = re.compile(r"[\w-]([\w\-. ]{0,98}[\w-])?")
"""Ids of several detectors."""

MAX_SUB_PIXELS = 10_000
"""Most sub-pixels a pixel: as many fields are computed."""

BYTES_PER_PIXEL = 40
"""Memory of one frame at its peak: the field (16), its intensity (4), a working copy (16) and what is done in tiles."""


def assembly_from_scene(scene: mi.Scene, sensor: mi.Sensor | str | None = None, spp: int = 0) -> Assembly:
    """Collects the assembly of a loaded scene as one detector sees it.

    sensor: which one, or its id; it is the only one unless given. Raises SceneError when a laser, target, detector or
    coherent integrator is missing or there are several, and for every shape that cannot be taken into account.
    """
    if sensor is None:
        sensor = _only(scene.sensors(), "sensor", "detector")
    (assembly,) = _read(scene, [_detector_named(scene, sensor) if isinstance(sensor, str) else sensor], spp)
    return assembly


def assemblies_from_scene(scene: mi.Scene, only: str | None = None, spp: int = 0) -> dict[str, Assembly]:
    """The assemblies of all detectors of a loaded scene by their ids, read once: they share all but the detector.

    only: the id of one that is wanted alone. Raises SceneError as :func:`assembly_from_scene`, for an unknown id and,
    of several detectors, for one without an id that names its files.
    """
    detectors = [sensor for sensor in scene.sensors() if role_of(sensor) == "detector"]
    if only is not None:
        detectors = [_detector_named(scene, only)]
    elif len(detectors) < 2:
        detectors = [_only(scene.sensors(), "sensor", "detector")]
    else:
        _require_names([sensor.id() for sensor in detectors])
    read = _read(scene, detectors, spp)
    return {sensor.id(): assembly for sensor, assembly in zip(detectors, read, strict=True)}


def _detector_named(scene: mi.Scene, name: str) -> mi.Sensor:
    detectors = {sensor.id(): sensor for sensor in scene.sensors() if role_of(sensor) == "detector"}
    if name not in detectors:
        there = ", ".join(map(repr, detectors)) or "(none)"
        raise SceneError(f"detector {name!r}: the scene has none of this id, must be one of {there}")
    return detectors[name]


def _read(scene: mi.Scene, detectors: list[mi.Sensor], spp: int) -> list[Assembly]:
    """The assembly of each of some detectors."""
    lasers = [emitter for emitter in scene.emitters() if role_of(emitter) == "laser"]
    if not lasers:
        raise SceneError("the scene has no <emitter type='laser'>, must have one or several")
    shape = _only(scene.shapes(), "shape", "rough_target")
    for detector in detectors:
        if role_of(detector) != "detector":
            raise SceneError(f"sensor {detector.id()!r} is a {detector.class_name()}, must be a detector")
    integrator = scene.integrator()
    if role_of(integrator) != "coherent":
        found = "none" if integrator is None else integrator.class_name()
        raise SceneError(f"the scene's integrator is {found}, must be <integrator type=\"coherent\"/>")
    for emitter in scene.emitters():
        if emitter not in lasers:
            raise SceneError(
                f"emitter {emitter.id()!r} ({emitter.class_name()}) is not a laser: "
                "its light would be left out, remove it"
            )
    for detector in detectors:
        _require_memory(detector)
    shapes = shapes_of(scene, shape)
    medium = medium_around(shapes, shape)
    (light, *further), target, longest_path, in_spot = lights_of(lasers, shape, shapes, medium)
    elements = light.elements
    _require_apart(elements)
    assemblies = [
        Assembly(
            beam=light.beam,
            target=target,
            elements=elements,
            detector=detector.grid(),
            options=integrator.options,
            pose=shape.pose(),
            sub_pixels=_sub_pixels(spp or detector.sampler().sample_count()),
            index=medium,
            camera=detector.camera,
            power=lasers[0].power,
            light=light.name,
            weight=light.weight,
            further=tuple(further),
            longest_path=longest_path,
            in_spot=in_spot,
            path=light.path,
        )
        for detector in detectors
    ]
    for detector, assembly in zip(detectors, assemblies, strict=True):
        _require_in_air(elements, f"{detector.where}: the detector's centre", assembly.detector.centre)
        _require_known_light(detector, assembly)
    _require_in_air(elements, f"{shape.where}: the middle of the spot", assemblies[0].spot.point)
    return assemblies


def role_of(plugin: object) -> str | None:
    """What a plugin of this package is in a scene, by the name that scenes call it; None for any other."""
    return getattr(plugin, "role", None)


def _require_names(names: list[str]) -> None:
    """SceneError where several detectors do not each have an id that can be part of a file's name."""
    for name in names:
        if not name:
            raise SceneError(f"the scene has {len(names)} detectors, each must have an id: one has none")
        if not _NAME.fullmatch(name):
            raise SceneError(
                f"detector {name!r}: of several detectors each id names files, must be at most 100 letters, digits and "
                "-_ (also . and spaces in between)"
            )


def _require_known_light(detector: mi.Sensor, assembly: Assembly) -> None:
    """SceneError for a camera with an exposure where the light's power on the target is not known."""
    if assembly.camera is None or assembly.camera.exposure is None:
        return
    lacking = (
        "the laser's power [mW] is not said: give it" if assembly.power is None
        else "light without a beam_radius has no power: give the laser one" if assembly.beam.is_uniform
        else "the target's own points do not tell their share of the power" if assembly.target.points is not None
        else None
    )  # fmt: skip
    if lacking:
        raise SceneError(f"{detector.where}: has an exposure, but {lacking}, or mean_electrons instead of the exposure")


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
        if element.kind == "glass" and element.is_inside(point, _ON_SURFACE):
            raise SceneError(f"{what} lies inside the glass of {element.name!r}, must lie outside")


def _only(candidates: list, kind: str, plugin: str):
    found = [candidate for candidate in candidates if role_of(candidate) == plugin]
    if len(found) != 1:
        names = ", ".join(candidate.where.partition(" ")[2] for candidate in found)
        tag = f"<{kind} type={plugin!r}>"
        there = f"{len(found)} of {tag}: {names}" if found else f"no {tag}"
        choice = ", or one be chosen by its id (--detector; load_detectors takes all)"
        raise SceneError(f"the scene has {there}, must have exactly one{choice if found and kind == 'sensor' else ''}")
    return found[0]


def _sub_pixels(samples: int) -> int:
    """Side of the square of sub-pixels that holds at least ``samples`` of them. SceneError for too many."""
    if samples > MAX_SUB_PIXELS:
        raise SceneError(f"{samples} sub-pixels a pixel (spp, sample_count): must be at most {MAX_SUB_PIXELS}")
    return max(1, int(np.ceil(np.sqrt(samples) - 1e-9)))
