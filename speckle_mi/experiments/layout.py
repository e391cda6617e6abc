"""An assembly as it is drawn: what stands where, the beam with its width, and the rays through every element.

All in world coordinates [mm], and in a frame of the drawing whose first axis is the target's normal: a view is a pair
of its axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..field.simulation import Simulation
from ..geometry.frames import Frame
from ..optics.surface import Surface
from ..plan.drawn_rays import drawn_rays
from ..scattering.beam import Beam
from ..scene.assembly import Assembly
from ..scene.body import Body
from ..scene.elements import OUTSIDE, Element
from ..scene.traced_light import drawn_light
from .problems import Problem, dark_ways, missed_beams

_ALONG_PROFILE = 61
"""Places along the section of a face."""

_FACE_ON = 0.05
"""Sine of the angle between an element's axis and the line of sight below which it is drawn as seen from the front."""

_BEAM_STEPS = 40

_SHOWN_BEAM = 0.35
"""Length of a beam that is drawn where its laser is farther away, over the size of everything else."""


@dataclass(frozen=True)
class Line:
    """What is drawn: points (n, 3) [mm]; closed: whether it is an area."""

    points: np.ndarray
    closed: bool = False


@dataclass(frozen=True)
class Part:
    """name; kind: "target", "detector", "laser", or an element's; lines: for either view; place: (3,) of its label."""

    name: str
    kind: str
    lines: tuple[tuple[Line, ...], tuple[Line, ...]]
    place: np.ndarray


@dataclass(frozen=True)
class Layout:
    """axes: (3, 3) columns across the drawing, up in the side view and up in the view from above; parts; beams: lines
    of the lasers' widths and axes; rays: by way, the chief ray first; facts: (what, value in words); warnings;
    problems: what is wrong, where it is."""

    axes: np.ndarray
    origin: np.ndarray
    parts: tuple[Part, ...]
    beams: tuple[tuple[Line, ...], ...]
    rays: Mapping[str, list[np.ndarray]]
    facts: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    problems: tuple[Problem, ...] = ()


def layout_of(assemblies: Mapping[str, Assembly]) -> Layout:
    """The layout of a scene's assemblies, one a detector, with the target at its pose.

    Raises SceneError where a way's light cannot be followed.
    """
    first = next(iter(assemblies.values()))
    frame = first.target.frame.moved(first.pose)
    axes = np.column_stack([frame.axes[:, 2], frame.axes[:, 0], frame.axes[:, 1]])
    spot = first.spot_at(frame)
    parts = [_target(first.target.body, frame, axes)]
    parts += [_element(element, axes) for element in first.elements]
    rays, warnings, problems = {}, [], []
    for name, assembly in assemblies.items():
        parts.append(_detector(name, assembly, axes))
        simulation = Simulation(assembly)
        plan, setup = simulation.plan(), simulation.setup()
        several = f"{name}: " if len(assemblies) > 1 else ""
        for channel in plan.channels:
            rays[several + channel.route.label] = drawn_rays(channel, spot.point, assembly.detector)
        warnings += [several + warning for warning in plan.warnings]
        problems += [replace(one, words=several + one.words if one.words else "") for one in dark_ways(setup, plan)]
    problems = missed_beams(setup) or problems
    warnings += [one.words for one in problems if one.words and one.ray is None and one.words not in str(warnings)]
    size = _size(parts, spot.point)
    beams = []
    for lit in first.named_parts:
        lines, place = _beam(lit.beam, lit.spot_at(frame).point, axes, size if lit.path is None else 0.0)
        if lit.path is not None and lit.path.interactions:
            lines = (*lines, *map(Line, drawn_light(lit.path)))
            place = lit.path.own.origin - 0.02 * size * lit.path.own.axis
        beams.append(lines)
        parts.append(Part(lit.light, "laser", ((), ()), place))
    facts = tuple(_facts(first, frame, assemblies, rays))
    return Layout(axes, frame.origin, tuple(parts), tuple(beams), rays, facts, tuple(warnings), tuple(problems))


def _size(parts: list[Part], spot: np.ndarray) -> float:
    """Of what stands around the spot [mm]."""
    points = np.concatenate([line.points for part in parts for view in part.lines for line in view] + [spot[None]])
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _target(body: Body, frame: Frame, axes: np.ndarray) -> Part:
    points = frame.to_world(body.vertices)
    lines = tuple((_hull(points, axes, view),) for view in (0, 1))
    return Part("target", "target", lines, frame.origin)


def _detector(name: str, assembly: Assembly, axes: np.ndarray) -> Part:
    grid = assembly.detector
    half_u, half_v = grid.half_size
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [half_u, half_v]
    points = grid.centre + corners @ np.stack([grid.u, grid.v])
    return Part(name, "detector", tuple((_hull(points, axes, view),) for view in (0, 1)), grid.centre)


def _element(element: Element, axes: np.ndarray) -> Part:
    place = np.mean([face.middle for face in element.faces], axis=0) if element.faces else element.body.bounds.mean(0)
    if element.closed:
        place = element.faces[0].centre_of_curvature
    return Part(element.name, element.kind, tuple(_section(element, axes, view) for view in (0, 1)), place)


def _section(element: Element, axes: np.ndarray, view: int) -> tuple[Line, ...]:
    """Lines of an element cut by the plane of a view through its middle; seen from the front, its outline."""
    sight = axes[:, 2 - view]  # what a view looks along: the up direction of the other one
    if element.kind == "opaque" or not element.faces:
        return (_hull(_corners(element.body), axes, view),)
    if element.closed:
        face = element.faces[0]
        radius, centre = 1 / abs(face.curvature), face.centre_of_curvature
        angle = np.linspace(0, 2 * np.pi, 4 * _ALONG_PROFILE)
        circle = np.outer(np.cos(angle), axes[:, 0]) + np.outer(np.sin(angle), axes[:, 1 + view])
        return (Line(centre + radius * circle, closed=element.kind == "glass"),)
    if element.kind == "glass" and element.media and not element.edged:
        return (_hull(_corners(element.body), axes, view),)
    profiles = [_profile(face, sight) for face in element.faces]
    if element.kind == "opening":
        return _screen(element, profiles[0])
    if element.kind == "mirror" or not element.media:
        return tuple(Line(profile) for profile in profiles)
    pairs = zip(pairwise(profiles), pairwise(element.sides), strict=True)
    return tuple(_between(*faces) for faces, sides in pairs if set.intersection(*map(set, sides)) - {OUTSIDE})


def _between(first: np.ndarray, second: np.ndarray) -> Line:
    """The glass between the sections of two faces, (n, 3) each."""
    turn = -1 if np.linalg.norm(first[-1] - second[-1]) <= np.linalg.norm(first[-1] - second[0]) else 1
    return Line(np.concatenate([first, second[::turn]]), closed=True)


def _profile(face: Surface, sight: np.ndarray) -> np.ndarray:
    """Points (n, 3) along the section of a face by the plane across ``sight`` through the middle of its outline."""
    axis = face.frame.axes[:, 2]
    across = np.cross(sight, axis)
    if np.linalg.norm(across) < _FACE_ON:
        angle = np.linspace(0, 2 * np.pi, 4 * _ALONG_PROFILE)
        x, y = face.outline.edge(angle)
    else:
        direction = (across / np.linalg.norm(across)) @ face.frame.axes[:, :2]
        reach = 2 * max(face.outline.half_size)
        along = np.linspace(-reach, reach, 40 * _ALONG_PROFILE)
        x, y = np.array(face.outline.centre)[:, None] + direction[:, None] * along
        inside = np.flatnonzero(np.all(face.outline.margins(x, y) >= 0, axis=0))
        some = np.linspace(inside[0], inside[-1], _ALONG_PROFILE).round().astype(int)
        x, y = x[some], y[some]
    return face.frame.to_world(np.stack([x, y, face.sag(x, y)], axis=1))


def _screen(element: Element, hole: np.ndarray) -> tuple[Line, ...]:
    """The screen on either side of a hole."""
    middle = element.faces[0].middle
    if np.linalg.norm(hole[0] - hole[-1]) < 1e-6 * np.linalg.norm(hole[0] - middle):
        return (Line(hole),)  # seen from the front
    lines = []
    for edge in (hole[0], hole[-1]):
        outwards = (edge - middle) / np.linalg.norm(edge - middle)
        lines.append(Line(np.array([edge, middle + element.screen_radius * outwards])))
    return tuple(lines)


def _corners(body: Body) -> np.ndarray:
    """Points (n, 3) of a body's form, or the corners of its box."""
    if body.vertices is not None:
        return body.vertices
    low, high = body.bounds
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def _hull(points: np.ndarray, axes: np.ndarray, view: int) -> Line:
    """The outline of points (n, 3) as seen in a view: the hull of their projection."""
    flat = np.stack([points @ axes[:, 0], points @ axes[:, 1 + view]], axis=1)
    try:
        order = ConvexHull(flat).vertices
    except QhullError:  # seen edge-on
        along = flat @ np.linalg.svd(flat - flat.mean(axis=0))[2][0]
        order = [int(np.argmin(along)), int(np.argmax(along))]
    return Line(points[order], closed=True)


def _beam(beam: Beam, spot: np.ndarray, axes: np.ndarray, size: float) -> tuple[tuple[Line, ...], np.ndarray]:
    """The beam's axis and its 1/e^2 edges in either view, from the laser or as much of it as is worth drawing.

    And the place (3,) of its name, behind where it begins.
    """
    whole = float((spot - beam.origin) @ beam.axis)
    length = min(whole, max(_SHOWN_BEAM * size, 1e-9)) if size > 0 else whole
    along = np.linspace(-length, 0, _BEAM_STEPS)
    middle = spot + along[:, None] * beam.axis
    lines = [Line(middle)]
    if not beam.is_uniform:
        radii = np.array([beam.radii_at(point) for point in middle])
        for view in (0, 1):
            across = np.cross(axes[:, 2 - view], beam.axis)
            if np.linalg.norm(across) > _FACE_ON:
                across = across / np.linalg.norm(across)
                widths = np.linalg.norm(radii * (beam.across @ across), axis=1)[:, None]
                lines += [Line(middle + sign * widths * across) for sign in (-1, 1)]
    return tuple(lines), middle[0] - 0.02 * size * beam.axis


def _facts(first: Assembly, frame: Frame, assemblies: Mapping[str, Assembly], rays) -> list[tuple[str, str]]:
    """What is worth knowing in numbers."""
    facts = []
    for lit in first.named_parts:
        beam, spot = lit.beam, lit.spot_at(frame)
        radii = " x ".join(dict.fromkeys(f"{radius:.4g}" for radius in beam.radii_at(spot.point)))
        width = "uniform" if beam.is_uniform else f"radius {radii} mm"
        angle = _degrees(float(np.clip(-beam.axis @ spot.normal, -1, 1)))
        facts.append((lit.light, f"{1e6 * lit.vacuum_wavelength:.5g} nm, {width}, {angle} from the target's normal"))
    for name, one in assemblies.items():
        grid = one.detector
        rows, columns = grid.shape
        facts.append((name, f"{columns} x {rows} pixels of {1e3 * grid.pitch:.4g} µm"))
    for way, found in rays.items():
        if found:
            segments = np.linalg.norm(np.diff(found[0], axis=0), axis=1)
            facts.append((way, " + ".join(f"{segment:.4g}" for segment in segments) + " mm along the chief ray"))
    return facts


def _degrees(cosine: float) -> str:
    return f"{round(float(np.degrees(np.arccos(cosine))), 3):.3g}°"
