"""The light of a scene's lasers: every line of every laser aimed at the target, and the target that they share."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np

from ..geometry.frames import Frame
from ..scattering.beam import Beam
from ..scattering.rough_surface import RoughSurface
from .assembly import GRAZING, Light, Target
from .body import Body
from .elements import Element
from .errors import SceneError
from .light_path import LightPath
from .parameters import integer_of, value_of
from .shapes import elements_of
from .traced_light import light_path
from .tracer import Tracer


def lights_of(
    lasers: list[mi.Emitter], shape: mi.Shape, shapes: list[mi.Shape], medium: float
) -> tuple[tuple[Light, ...], Target, float, float]:
    """The light of all lasers in a medium of index ``medium``, and the target with its density of scatterers.

    Also the path difference [mm] up to which samples stand for their lines, and how many scatterers are expected
    within the first beam's radii.

    Scatterers are material, the same for all light: as dense as the light that asks for most. Elements are read for
    every wavelength. Of lasers whose powers are said the fields are in proportion to the roots of what falls on a unit
    of the surface, that of the first being as it is alone. Raises SceneError as for one laser, for several without ids
    of their own, and where the powers of some are not known.
    """
    names = [laser.id() for laser in lasers]
    if len(lasers) > 1 and ("" in names or len(set(names)) < len(names)):
        raise SceneError(f"the scene has {len(lasers)} lasers, each must have an id of its own: their fields' names")
    _require_powers(lasers)
    lights, densities, paths, elements = [], [], [], {}
    first = None
    for laser in lasers:
        for line in laser.lines():
            beam, path = replace(line.beam, wavelength=line.beam.wavelength / medium), None
            if beam.wavelength not in elements:
                # Of glasses, by the vacuum wavelength.
                elements[beam.wavelength] = tuple(elements_of(shapes, shape, medium, line.beam.wavelength))
            if laser.traced:
                path = _path(beam, laser, elements[beam.wavelength], shape)
            beam, density = _aim(beam, path, shape)
            if len(lasers) > 1 and laser.power is not None:
                # Of a power P the share P density/N falls on every scatterer, where N lie within the radii.
                first = first or laser.power * density
                beam = replace(beam, strength=beam.strength * float(np.sqrt(laser.power * density / first)))
            name = None if line.number is None else laser.id() + (f".line{line.number + 1}" if line.number else "")
            lights.append(Light(name, beam, elements[beam.wavelength], medium, line.weight, path))
            densities.append(density)
            paths.append(line.longest_path)
    crowding = max(densities) / densities[0]
    return tuple(lights), _target(shape, max(densities)), min(paths), shape.point_sources * crowding


def _require_powers(lasers: list[mi.Emitter]) -> None:
    """SceneError where some of several lasers say their power and others do not, or have none."""
    said = [laser for laser in lasers if laser.power is not None]
    if len(lasers) == 1 or not said:
        return
    for laser in lasers:
        lacking = (
            "does not say its 'power'" if laser.power is None
            else "has no beam_radius, without which light has no power" if laser.beam().is_uniform
            else None
        )  # fmt: skip
        if lacking:
            raise SceneError(f"{laser.where}: {lacking}: of several lasers the powers of all or of none must be known")


def _path(beam: Beam, laser: mi.Emitter, elements: tuple[Element, ...], shape: mi.Shape) -> LightPath:
    """The optics that the light of a traced laser comes over. SceneError where it does not come to the target."""
    target = _target(shape, density=0.0)
    return light_path(beam, laser.where, elements, target, Tracer(elements, target))


def _aim(beam: Beam, path: LightPath | None, shape: mi.Shape) -> tuple[Beam, float]:
    """The beam aimed at where its axis meets the target at rest, and the density of scatterers [1/mm^2] under it.

    path: the optics before it, of a traced laser.
    """
    frame, facets = shape.placement.frame, shape.facets
    if path is not None:
        beam = path.beam_at(path.carried.place)
    spot, normal = _where_axis_meets(facets, frame, beam, shape.where, required=shape.points is None)
    if path is None:
        beam = beam.aimed_at(beam.origin + ((spot - beam.origin) @ beam.axis) * beam.axis)
    else:
        beam = path.beam_at(spot)
    if beam.is_uniform:
        return beam, shape.point_sources / float(np.sum(facets.area))
    return beam, shape.point_sources * abs(float(normal @ beam.axis)) / (np.pi * beam.radius**2)


def _target(shape: mi.Shape, density: float) -> Target:
    surface = RoughSurface(
        facets=shape.facets,
        density=density,
        roughness=value_of(shape.roughness) * 1e-3,
        correlation_length=value_of(shape.correlation_length) * 1e-3,
        seed=integer_of(shape.seed),
    )
    return Target(
        frame=shape.placement.frame,
        surface=surface,
        points=shape.points,
        body=Body.mesh(*shape.rest_mesh),
        lobe=_lobe(shape) if shape.lobe else None,
        point_sources=shape.point_sources,
        where=shape.where,
    )


def _lobe(shape: mi.Shape) -> dict:
    """The target's BSDF as plain data. SceneError where the scene was loaded in a way that tells nothing of it."""
    recipe = shape.bsdf_recipe
    if recipe is None:
        raise SceneError(
            f"{shape.where}: 'lobe' needs the BSDF as the scene describes it, which is not known: load the scene with "
            "mi.load_file, mi.load_string or mi.load_dict, the BSDF written out in it"
        )
    return recipe


def _where_axis_meets(facets, frame: Frame, beam: Beam, where: str, required: bool) -> tuple[np.ndarray, np.ndarray]:
    """Where the beam's axis first meets the surface, else the target's plane: point and normal (3,) in the world."""
    met = facets.first_met(frame, beam.origin, beam.axis)
    if met is not None:
        if met[1] @ beam.axis > 0 and required:
            raise SceneError(
                f"{where}: the laser lights the back of the target (its normal points away from the laser), "
                "must light its front: turn the target, or the faces of its mesh"
            )
        return met
    normal = frame.axes[:, 2]
    slope = normal @ beam.axis
    if abs(slope) < GRAZING:
        if required:
            raise SceneError(f"{where}: the laser's axis runs along the target's surface, must meet it")
        return frame.origin, normal
    return beam.origin + ((frame.origin - beam.origin) @ normal) / slope * beam.axis, normal
