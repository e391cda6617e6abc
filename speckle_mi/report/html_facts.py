"""A page's tables of facts: what the assembly is made of, what was asked for, what the field's stages cost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields

import numpy as np

from ..geometry.pose import DEGREES_OF_FREEDOM, unit_of
from ..plan.stage import Stage
from ..scene.assembly import Assembly
from .html import Cell, paragraphs, table
from .terminal import MACHINE

_KINDS = {"opening": "aperture", "glass": "lens or other glass", "mirror": "mirror", "opaque": "opaque"}


def parameters(assemblies: Mapping[str, Assembly], facts: Iterable[tuple[str, str]]) -> str:
    """Tables of the light, target, detectors and elements. facts: of the drawing, each (what, value in words)."""
    first = next(iter(assemblies.values()))
    rows = [*facts, *_beams(first), *_target(first)]
    for name, one in assemblies.items():
        rows += _camera(name, one)
    options = first.options
    asked = f"method {options.method}, tolerance {options.tolerance:g}"
    rows.append(("integrator", asked + ("" if options.diffraction else ", without diffraction")))
    if first.index != 1:
        rows.append(("medium around everything", f"refractive index {first.index:.6g}"))
    merged: dict[str, list[str]] = {}
    for what, value in rows:
        merged.setdefault(what, []).append(value)
    together = [(what, "; ".join(values)) for what, values in merged.items()]
    return table((), together, name="parameters") + _elements(first)


def _beams(first: Assembly) -> list[tuple[str, str]]:
    rows = []
    for part in first.named_parts:
        radii = dict.fromkeys(float(one) for one in part.beam.wavefront_radii)
        fronts = " x ".join("plane" if np.isinf(one) else f"{one:.4g} mm" for one in radii)
        rows.append((part.light, f"wavefront radius {fronts} at the target"))
    if first.power is not None:
        rows.append(("laser's power", f"{first.power:g} mW"))
    return rows


def _target(first: Assembly) -> list[tuple[str, str]]:
    surface, target = first.target.surface, first.target
    if target.points is not None:
        return [("target", f"{len(target.points.points)} points of its own")]
    correlated = f"correlation length {1e3 * surface.correlation_length:.4g} µm, " if surface.correlation_length else ""
    lobe = "radiates by its material's lobe" if target.lobe else "radiates evenly"
    return [("target", f"roughness {1e3 * surface.roughness:.4g} µm rms, {correlated}"
                       f"{target.point_sources} point sources in the spot, {lobe}")]  # fmt: skip


def _camera(name: str, assembly: Assembly) -> list[tuple[str, str]]:
    if assembly.camera is None:
        return []
    camera = assembly.camera
    said = [f"{one.name} {value:g}".replace("_", " ") for one in fields(camera)
            if isinstance(value := getattr(camera, one.name), (int, float))]  # fmt: skip
    return [(name, f"camera: {', '.join(said)}")]


def _elements(first: Assembly) -> str:
    if not first.elements:
        return paragraphs(["Nothing stands between target and detector."], "note")
    rows = []
    for element in first.elements:
        faces = [face.middle for face in element.faces]
        place = np.mean(faces, axis=0) if faces else element.body.bounds.mean(axis=0)
        away = float(np.linalg.norm(place - first.spot.point))
        media = ", ".join(f"{index:.5g}" for index in element.media)
        at = ", ".join(f"{value:.4g}" for value in place + 0.0)
        rows.append((element.name, _KINDS.get(element.kind, element.kind), _faces(element), media or "–",
                     Cell(f"{away:.4g}", away), at))  # fmt: skip
    heads = ("element", "kind", "faces: radius of curvature (mm)", "index", "from the spot (mm)", "middle at (mm)")
    return table(heads, rows, name="elements")


def _faces(element) -> str:
    radii = ["plane" if face.curvature == 0 else f"{1 / face.curvature:.5g}" for face in element.faces]
    return ", ".join(radii) or "–"


def stages(summaries: Mapping[str, dict]) -> str:
    """The plan in words, and the error and time of each of its stages."""
    parts = []
    for name, summary in summaries.items():
        rows = []
        for stage in summary["stages"]:
            error, seconds = stage.get("error"), stage.get("seconds")
            rows.append((str(Stage.from_json(stage)), _number(error, "{:.1e}"),
                         _number(None if seconds is None else 1e3 * seconds, "{:.3g}")))  # fmt: skip
        caption = "of the first frame" + (f", detector {name}" if len(summaries) > 1 else "")
        parts.append(table(("stage", "error, relative L2", "ms"), rows, caption, name="plan"))
    return "\n".join(parts)


def _number(value: float | None, form: str) -> Cell:
    return Cell("–" if value is None or not np.isfinite(value) else form.format(value), value)


def asked(settings, count: int, defaults: Sequence[str]) -> str:
    """What the sweep was asked for, in a table."""
    ends = settings.displacements.min(), settings.displacements.max()
    units = "/".join(dict.fromkeys(unit_of(dof) for dof in DEGREES_OF_FREEDOM if dof in settings.dofs))
    rows = [
        ("motions", ", ".join(settings.dofs)),
        ("displacements", f"{len(settings.displacements)} from {ends[0]:g} to {ends[1]:g} {units}"),
        ("surfaces", f"{len(settings.seeds)}, seeds {settings.seeds[0]} to {settings.seeds[-1]}"),
        ("correlation window", "the default" if settings.window is None else f"{settings.window} px"),
        ("frames", f"{count}"),
    ]
    if defaults:
        rows.append(("values given for the scene", ", ".join(defaults)))
    return table((), rows, name="asked")


def machine(system: Mapping[str, str]) -> str:
    """Versions and machine; everything else that was found stands folded below."""
    first = [(name, str(system[name])) for name in MACHINE if name in system]
    rest = [(name, str(value)) for name, value in system.items() if name not in MACHINE]
    more = f"<details><summary>more of them</summary>{table((), rest)}</details>" if rest else ""
    return table((), first, name="versions") + more
