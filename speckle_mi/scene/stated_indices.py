"""Refractive indices as the scene's file states them, which Mitsuba keeps only as a quotient in single precision.

The quotient alone does not tell a glass of 1.128 in air from one of 1.5 in water, and its rounding costs 1e-4
wavelengths of path a millimetre of glass.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_DEFAULTS = {"int_ior": "bk7", "ext_ior": "air"}
"""What a dielectric of Mitsuba is made of where nothing is said."""


def stated_indices(nodes: Sequence) -> dict[str, list[tuple[float, float]]]:
    """(int_ior, ext_ior) of the dielectrics of a parsed scene's shapes, by the shapes' ids.

    nodes: of ``mi.parser.ParserState``. Shapes without an id share the entry of the empty one.
    """
    import mitsuba as mi

    by_id = {node.props.id(): node for node in nodes if node.props.id()}
    found: dict[str, list[tuple[float, float]]] = {}
    for node in nodes:
        dielectric = _dielectric_of(node, nodes, by_id) if node.type == mi.ObjectType.Shape else None
        if dielectric is not None:
            indices = tuple(_index(dielectric.props, name) for name in _DEFAULTS)
            found.setdefault(node.props.id(), []).append(indices)
    return found


def _dielectric_of(node, nodes: Sequence, by_id: dict):
    """The first dielectric among what a node holds, through references and other BSDFs; None where it holds none."""
    import mitsuba as mi

    for name in node.props.keys():
        value = node.props[name]
        if isinstance(value, mi.Properties.ResolvedReference):
            child = nodes[value.index()]
        elif isinstance(value, mi.Properties.Reference):
            child = by_id.get(value.id())
        else:
            continue
        if child is None or child.type != mi.ObjectType.BSDF:
            continue
        if child.props.plugin_name() == "dielectric":
            return child
        if (inner := _dielectric_of(child, nodes, by_id)) is not None:
            return inner
    return None


def _index(props, name: str) -> float:
    """A refractive index, given as a number or by the name of a material."""
    value = props[name] if name in props else _DEFAULTS[name]
    return _of_material(value) if isinstance(value, str) else float(value)


def _of_material(name: str) -> float:
    """Index of a material that Mitsuba knows by name, from its own table: the decimal that single precision rounded."""
    import mitsuba as mi

    medium = mi.load_dict({"type": "dielectric", "int_ior": name, "ext_ior": 1.0})
    return float(str(np.float32(mi.traverse(medium)["eta"])))
