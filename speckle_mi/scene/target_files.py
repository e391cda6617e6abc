"""The meshes and lists of scatterers that a scene names."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np

from ..geometry.pose import FARTHEST
from .errors import SceneError
from .parameters import describe

MAX_POINTS = 20_000_000

LARGEST_WEIGHT = 1e12
"""Of a scatterer: images are single precision, and hold the square of a sum of them."""


def resolve(props, name: str) -> Path:
    """Path that a scene gives, relative to the scene file; SceneError when there is no such file."""
    value = props[name]
    if not isinstance(value, str):
        raise SceneError(f"{describe(props)}: parameter {name!r} is {value!r}, must be the name of a file")
    path = Path(str(mi.file_resolver().resolve(value)))
    if not path.is_file():
        raise SceneError(
            f"{describe(props)}: parameter {name!r} names {value!r}, which is not a file (looked beside the scene)"
        )
    return path


def mesh_from_file(path: Path, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 and faces (m, 3) of a PLY or OBJ file; SceneError when it cannot be read."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("ply", "obj"):
        raise SceneError(f"{where}: {path.name!r} is not a mesh, must be a .ply or .obj file")
    try:
        mesh = mi.load_dict({"type": kind, "filename": str(path), "face_normals": True})
    except RuntimeError as error:
        raise SceneError(f"{where}: cannot read {path.name!r}: {_reason(error)}") from None
    vertices = np.array(mesh.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer(), dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0 or not np.all(np.isfinite(vertices)):
        raise SceneError(
            f"{where}: {path.name!r} holds {len(faces)} faces, must hold at least one, with finite vertices"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise SceneError(
            f"{where}: {path.name!r} has a face with vertex {wrong}, must be one of 0 to {len(vertices) - 1}"
        )
    if np.max(np.abs(vertices)) > FARTHEST:
        raise SceneError(
            f"{where}: {path.name!r} has a vertex at {np.max(np.abs(vertices)):g} mm, must stay within {FARTHEST:g} mm"
        )
    return vertices, faces


def points_from_csv(path: Path, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Scatterers x, y, z[, re, im] of a CSV file: points (n, 3) [mm] and weights (n,) complex.

    One heading line is allowed. Raises SceneError naming the line that cannot be used.
    """
    rows: list[list[float]] = []
    columns = None
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise SceneError(f"{where}: {path.name!r} is not a text file, must be CSV with columns x,y,z[,re,im]") from None
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.split("#", 1)[0].strip()
        if not line:
            continue
        try:
            values = [float(cell) for cell in line.split(",")]
        except ValueError:
            if not rows and columns is None:
                columns = 0  # the heading
                continue
            raise SceneError(
                f"{where}: {path.name!r} line {number} is {line!r}, must be numbers x,y,z[,re,im]"
            ) from None
        if len(values) not in (3, 5) or (rows and len(values) != len(rows[0])):
            raise SceneError(
                f"{where}: {path.name!r} line {number} has {len(values)} columns, must have 3 or 5 throughout"
            )
        if not np.all(np.isfinite(values)):
            raise SceneError(f"{where}: {path.name!r} line {number} is {line!r}, must hold finite numbers")
        if max(map(abs, values[:3])) > FARTHEST or max(map(abs, values[3:]), default=0.0) > LARGEST_WEIGHT:
            limits = f"x, y, z up to {FARTHEST:g} mm and re, im up to {LARGEST_WEIGHT:g} in size"
            raise SceneError(f"{where}: {path.name!r} line {number} is {line!r}, must be {limits}")
        rows.append(values)
        if len(rows) > MAX_POINTS:
            raise SceneError(f"{where}: {path.name!r} holds more than {MAX_POINTS} scatterers")
    if not rows:
        raise SceneError(f"{where}: {path.name!r} holds no scatterer, must hold lines x,y,z[,re,im]")
    table = np.array(rows)
    weights = table[:, 3] + 1j * table[:, 4] if table.shape[1] == 5 else np.ones(len(table), complex)
    return np.ascontiguousarray(table[:, :3]), weights


def _reason(error: Exception) -> str:
    """What is wrong, without the places in Mitsuba that pass it on."""
    return str(error).strip().splitlines()[-1].rpartition("] ")[2].strip()
