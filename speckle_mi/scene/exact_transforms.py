"""What Mitsuba's loaders lose of a scene: transforms in double precision, single shapes, and how a material is made.

A mirror whose normal is rounded to single precision tilts by 3e-8 rad: thousandths of a wavelength at the
detector. A scene with a rough target is therefore parsed a second time while it is loaded, and what was read is kept
with the target. Whether it has one is seen from its text; any other scene is loaded by Mitsuba alone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from types import ModuleType

import numpy as np

from .bsdf_recipe import TARGET, bsdf_recipe
from .source import NotReadable, source_of_file, source_of_string, types_in_dict
from .stated_indices import stated_indices

_MARK = "remembers_transforms"
_LOADERS = {"load_file": "parse_file", "load_string": "parse_string", "load_dict": "parse_dict"}
_NOT_FOR_THE_PARSER = ("parallel", "optimize")


def remember_transforms(mitsuba: ModuleType) -> None:
    """Makes Mitsuba's loaders keep the transforms they would round and the shapes they would merge.

    The loaders serve all variants, and are changed once.
    """
    for loader, parse in _LOADERS.items():
        load = getattr(mitsuba, loader)
        if not hasattr(load, _MARK):
            setattr(mitsuba, loader, _remembering(mitsuba, load, parse))


def _remembering(mitsuba: ModuleType, load: Callable, parse: str) -> Callable:
    @functools.wraps(load)
    def loading(source, *arguments, **parameters):
        values = {name: str(value) for name, value in parameters.items() if name not in _NOT_FOR_THE_PARSER}
        if mitsuba.variant() is None or not _may_hold_a_target(source, values, parse):
            return load(source, *arguments, **parameters)
        config = mitsuba.parser.ParserConfig(mitsuba.variant())
        try:
            state = getattr(mitsuba.parser, parse)(config, source, **values)
            nodes = list(state.nodes)
        except Exception:  # the loader itself says best what is wrong with the source
            return load(source, *arguments, **parameters)
        if not any(node.props.plugin_name() == TARGET for node in nodes):
            return load(source, *arguments, **parameters)
        # Merging shapes of one material into one mesh, Mitsuba's default, would take mirrors and plates apart.
        loaded = load(source, *arguments, **{"optimize": False, **parameters})
        indices = stated_indices(nodes)
        for target in _targets(loaded, mitsuba):
            target.precise_transforms = {
                node.props.id(): _matrix(node.props) for node in nodes if node.props.id() and _is_placed(node.props)
            }
            target.stated_indices = indices
            target.bsdf_recipe = bsdf_recipe(state, target.id())
        return loaded

    setattr(loading, _MARK, True)
    return loading


def _may_hold_a_target(source, values: Mapping[str, str], parse: str) -> bool:
    """Whether a scene names a rough target; True also where its text cannot be looked through."""
    try:
        if parse == "parse_dict":
            return TARGET in types_in_dict(source)
        looked = (source_of_file if parse == "parse_file" else source_of_string)(source, values)
    except (NotReadable, TypeError, ValueError, AttributeError):  # not even of the type that a loader takes
        return True
    return TARGET in looked.types


def _targets(loaded, mitsuba: ModuleType) -> Iterator:
    """The rough targets of what was loaded: a scene, a shape or a list of them."""
    if isinstance(loaded, mitsuba.Scene):
        loaded = loaded.shapes()
    for shape in loaded if isinstance(loaded, (list, tuple)) else (loaded,):
        if hasattr(shape, "precise_transforms"):
            yield shape


def _is_placed(props) -> bool:
    return "to_world" in props or "center" in props or "radius" in props


def _matrix(props) -> np.ndarray:
    """``to_world`` (4, 4) of a shape, with the centre and radius of a sphere multiplied in, as Mitsuba does."""
    matrix = np.array(props["to_world"].matrix, dtype=np.float64) if "to_world" in props else np.eye(4)
    if props.plugin_name() == "sphere":
        local = np.diag([*(3 * [float(props.get("radius", 1.0))]), 1.0])
        local[:3, 3] = np.array(props["center"], dtype=np.float64).ravel() if "center" in props else 0.0
        matrix = matrix @ local
    return matrix


def precise_transform(shape, target) -> np.ndarray:
    """``to_world`` (4, 4) of a stock shape in double precision.

    Where the scene was not loaded from XML, or the transform was changed since, Mitsuba's own single-precision
    matrix is all there is.
    """
    known = target.precise_transforms.get(shape.id())
    if shape.class_name() == "Cube":
        return _of_cube(shape, known)
    import mitsuba as mi

    rounded = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4, -1)[..., 0]
    return known if known is not None and _equal_but_for_rounding(known, rounded) else rounded


def _equal_but_for_rounding(exact: np.ndarray, rounded: np.ndarray) -> bool:
    return bool(np.all(np.isfinite(rounded))) and bool(
        np.allclose(exact, rounded, rtol=1e-6, atol=1e-6 * np.abs(rounded).max())
    )


def _of_cube(shape, known: np.ndarray | None) -> np.ndarray:
    """Transform of a cube, which is a mesh whose vertices are already placed."""
    import mitsuba as mi

    parameters = mi.traverse(shape)
    vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    unit = np.array([[x, y, z, 1.0] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    centre = vertices.mean(axis=0)
    if known is not None:
        extent = np.ptp((unit @ known.T)[:, :3], axis=0)
        if _equal_but_for_rounding(np.stack([known[:3, 3], extent]), np.stack([centre, np.ptp(vertices, axis=0)])):
            return known
    matrix = np.eye(4)
    matrix[:3, 3] = centre
    # The faces follow each other in opposite pairs of triangles; three at right angles span the box.
    found: list[np.ndarray] = []
    for face in vertices[np.array(parameters["faces"], dtype=np.int64).reshape(-1, 6)]:
        half = np.unique(face.round(7), axis=0).mean(axis=0) - centre
        if all(abs(half @ other) < 0.1 * np.linalg.norm(half) * np.linalg.norm(other) for other in found):
            found.append(half)
    matrix[:3, :3] = np.stack(found[:3], axis=1)
    return matrix
