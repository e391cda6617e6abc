"""An assembly as a body in space: faces of everything that stands there as polygons, lines, and the light on detectors.

World coordinates [mm]; a drawing turns them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..field.detectors import Simulations
from ..geometry.plane import PlaneGrid
from ..images.levels import block_means, root_levels, white_level
from ..optics.surface import Surface
from ..scattering.beam import Beam
from ..scene.assembly import Assembly
from ..scene.body import Body
from ..scene.elements import OUTSIDE, Element
from .layout import Layout

_AROUND, _RINGS = 32, 5
"""Polygons around the axis of a face, and from its middle to its rim."""

_MOST_TRIANGLES = 1500
"""Of a mesh that is shown as it is; finer ones are made coarser."""

_CELLS = 18
"""Places a side into which the corners of a finer mesh are gathered."""

_ALONG_BEAM = 12

_SECONDS = 0.6
"""Predicted time [s] up to which the pattern on the detectors is computed at every pixel."""

_COARSE = 160
"""Pixels of the longer side of a detector at whose places the pattern is computed else."""

_SHOWN = 384
"""Pixels of the longer side of a pattern that is shown, at most."""


@dataclass(frozen=True)
class Solid:
    """name, kind: as of the layout's part; polygons: each (k, 3) [mm]; rims: lines (k, 3) [mm] that bound it; place:
    (3,) of its name."""

    name: str
    kind: str
    polygons: tuple[np.ndarray, ...]
    rims: tuple[np.ndarray, ...]
    place: np.ndarray


@dataclass(frozen=True)
class Pattern:
    """Light on a detector: shown (rows, columns) uint8, root of the intensity; step: pixels from one to the next."""

    grid: PlaneGrid
    shown: np.ndarray
    step: int


def solids_of(assemblies: Mapping[str, Assembly], layout: Layout) -> list[Solid]:
    """Target and elements, then the detectors, then the beams, as in a layout."""
    first = next(iter(assemblies.values()))
    frame = first.target.frame.moved(first.pose)
    body = first.target.body
    triangles = _triangles(frame.to_world(body.vertices), body.faces)
    solids = [Solid("target", "target", triangles, (), frame.origin)]
    solids += [_element(element) for element in first.elements]
    for name, assembly in assemblies.items():
        corners, centre = _corners(assembly.detector), assembly.detector.centre
        solids.append(Solid(name, "detector", (corners,), (np.vstack([corners, corners[:1]]),), centre))
    lasers = [part for part in layout.parts if part.kind == "laser"]
    for lit, (axis, *others), part in zip(first.named_parts, layout.beams, lasers, strict=True):
        # Light that is traced on its way to the target is shown by its rays.
        rays = (axis, *others) if lit.path is not None else (axis,)
        rims = tuple(line.points for line in rays)
        solids.append(Solid(part.name, "laser", _tube(lit.beam, axis.points), rims, part.place))
    return solids


def _corners(grid: PlaneGrid) -> np.ndarray:
    half_u, half_v = grid.half_size
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return grid.centre + signs * [half_u, half_v] @ np.stack([grid.u, grid.v])


def _element(element: Element) -> Solid:
    polygons: list[np.ndarray] = []
    rims: list[np.ndarray] = []
    place = np.mean([face.middle for face in element.faces], axis=0) if element.faces else element.body.bounds.mean(0)
    if element.kind == "opening":
        inner, outer = _hole(element)
        polygons, rims = _between(inner, outer), [inner, outer]
    elif element.closed or element.kind == "opaque" or not element.faces:
        polygons = list(_body(element.body))
        place = element.body.bounds.mean(axis=0)
    elif element.kind == "glass" and not element.edged:
        polygons = list(_body(element.body))
    else:
        rings = [_rings(face) for face in element.faces]
        for face in rings:
            polygons += [quad for pair in pairwise(face) for quad in _between(*pair)] or [face[0][:-1]]
        rims = [face[-1] for face in rings]
        for number, (one, other) in enumerate(pairwise(element.sides)):
            if set(one) & set(other) - {OUTSIDE}:
                polygons += _between(rims[number], _matched(rims[number], rims[number + 1]))
    return Solid(element.name, element.kind, tuple(polygons), tuple(rims), place)


def _rings(face: Surface) -> list[np.ndarray]:
    """Closed lines (n, 3) on a face, from its middle out to its rim; of a plane one its rim."""
    angle = np.linspace(0, 2 * np.pi, _AROUND + 1)
    edge = np.stack(face.outline.edge(angle))
    middle = np.array(face.outline.centre)[:, None]
    rings = []
    for share in [1.0] if face.is_plane else np.linspace(0, 1, _RINGS + 1):
        x, y = middle + share * (edge - middle)
        rings.append(face.frame.to_world(np.stack([x, y, face.sag(x, y)], axis=1)))
    return rings


def _matched(line: np.ndarray, other: np.ndarray) -> np.ndarray:
    """A closed line as it lies beside another: from the point nearest to its first, in the same sense."""
    ring = other[:-1]
    best = min(
        (np.roll(turned, -shift, axis=0) for turned in (ring, ring[::-1]) for shift in range(len(ring))),
        key=lambda one: float(np.sum((one - line[:-1]) ** 2)),
    )
    return np.vstack([best, best[:1]])


def _between(one: np.ndarray, other: np.ndarray) -> list[np.ndarray]:
    """Quadrangles between two lines of as many points."""
    return [np.array([one[k], one[k + 1], other[k + 1], other[k]]) for k in range(len(one) - 1)]


def _hole(element: Element) -> tuple[np.ndarray, np.ndarray]:
    """The hole's edge and the screen's outer edge."""
    face, angle = element.faces[0], np.linspace(0, 2 * np.pi, 2 * _AROUND + 1)
    lines = []
    for x, y in (face.outline.edge(angle), element.screen_radius * np.array([np.cos(angle), np.sin(angle)])):
        lines.append(face.frame.to_world(np.stack([x, y, np.zeros_like(x)], axis=1)))
    return lines[0], lines[1]


def _body(body: Body) -> tuple[np.ndarray, ...]:
    """Polygons of a shape in its world place."""
    if body.form == "mesh":
        return _triangles(body.vertices, body.faces)
    angle = np.linspace(0, 2 * np.pi, _AROUND + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    if body.form == "rectangle":
        lines = [np.array([[-1, -1, 0], [1, -1, 0]]), np.array([[-1, 1, 0], [1, 1, 0]])]
    elif body.form == "disk":
        lines = [np.stack([*(share * circle), 0 * angle], axis=1) for share in (0.0, 1.0)]
    elif body.form == "cylinder":
        lines = [np.stack([*circle, np.full_like(angle, z)], axis=1) for z in (0.0, 1.0)]
    else:
        heights = np.linspace(0, np.pi, _AROUND // 2 + 1)
        lines = [np.stack([*(np.sin(t) * circle), np.full_like(angle, np.cos(t))], axis=1) for t in heights]
    to_world = np.asarray(body.to_world, dtype=np.float64)
    lines = [line @ to_world[:3, :3].T + to_world[:3, 3] for line in lines]
    return tuple(quad for pair in pairwise(lines) for quad in _between(*pair))


def _triangles(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, ...]:
    """The triangles of a mesh; of a fine one, those of its corners gathered in cells."""
    if len(faces) > _MOST_TRIANGLES:
        low, side = vertices.min(axis=0), max(float(np.ptp(vertices, axis=0).max()), 1e-300)
        cells = np.minimum((vertices - low) / side * _CELLS, _CELLS - 1).astype(np.int64)
        _, cell = np.unique(cells, axis=0, return_inverse=True)
        cell = cell.ravel()
        counts = np.bincount(cell)
        vertices = np.stack([np.bincount(cell, weights=column) / counts for column in vertices.T], axis=1)
        faces = cell[faces]
        apart = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        _, first = np.unique(np.sort(faces[apart], axis=1), axis=0, return_index=True)
        faces = faces[apart][first]
    return tuple(vertices[np.asarray(faces, dtype=np.int64)])


def _tube(beam: Beam, along: np.ndarray) -> tuple[np.ndarray, ...]:
    """The beam's 1/e^2 surface around points of its axis (n, 3); nothing of a beam without an end."""
    if beam.is_uniform:
        return ()
    angle = np.linspace(0, 2 * np.pi, _AROUND + 1)
    rings = []
    for point in along[np.linspace(0, len(along) - 1, _ALONG_BEAM).round().astype(int)]:
        radii = beam.radii_at(point)
        rings.append(point + np.stack([radii[0] * np.cos(angle), radii[1] * np.sin(angle)], axis=1) @ beam.across)
    return tuple(quad for pair in pairwise(rings) for quad in _between(*pair))


def patterns_of(assemblies: Mapping[str, Assembly]) -> tuple[dict[str, Pattern], str]:
    """The light on each detector, by name, and what has to be said of it.

    At every pixel where that is quick; else at pixels that lie ``step`` apart; nothing where even that is not.
    """
    bare = {name: replace(one, camera=None, sub_pixels=1) for name, one in assemblies.items()}
    step, said = 1, ""
    simulations = Simulations(bare)
    if simulations.cost().seconds > _SECONDS:
        largest = max(max(one.detector.shape) for one in bare.values())
        step = max(1, -(-largest // _COARSE))
        bare = {name: replace(one, detector=_coarser(one.detector, step)) for name, one in bare.items()}
        simulations, said = Simulations(bare), f"Patterns are shown at one pixel in {step} x {step}."
        if simulations.cost().seconds > 2 * _SECONDS:
            return {}, "Patterns are left out: they would take long."
    frames = simulations.frames()
    shown = {}
    for name, frame in frames.items():
        values = frame.image.intensity.astype(np.float64)
        values = block_means(values, max(1, -(-max(values.shape) // _SHOWN)))
        shown[name] = Pattern(assemblies[name].detector, root_levels(values, white_level(values)), step)
    return shown, said


def _coarser(grid: PlaneGrid, step: int) -> PlaneGrid:
    """Every ``step``-th pixel of a grid, about the same middle."""
    rows, columns = (max(1, size // step) for size in grid.shape)
    middle = 0.5 * step * grid.pitch * ((columns - 1) * grid.u + (rows - 1) * grid.v)
    return PlaneGrid(grid.centre - middle, grid.u, grid.v, step * grid.pitch, (rows, columns))
