"""Angular distribution of the scattered light, from the BSDF of the target."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..geometry.frames import Frame
from ..scene.assembly import Assembly
from ..scene.errors import SceneError


def lobe_towards(assembly: Assembly, frame: Frame, directions: np.ndarray) -> np.ndarray:
    """sqrt(f cos) of the target's BSDF f from the beam's axis towards ``directions`` (n, 3) of any length, (n,).

    The beam's spot is small against its distance from the detector, so its centre stands for all scatterers. Raises
    SceneError for a BSDF that only reflects like a mirror.
    """
    target = assembly.target
    bsdf = target.shape.bsdf()
    if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) and not mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth):
        raise SceneError(
            f"{target.shape.where}: 'lobe' needs a rough BSDF, {bsdf.class_name()} reflects like a mirror only"
        )
    turned = frame.axes @ target.frame.axes.T
    normal = turned @ target.spot_normal
    tangent = turned @ target.frame.axes[:, 0]
    tangent = tangent - (tangent @ normal) * normal
    if np.linalg.norm(tangent) < 1e-6:
        tangent = turned @ target.frame.axes[:, 1]
        tangent = tangent - (tangent @ normal) * normal
    tangent = tangent / np.linalg.norm(tangent)
    local = np.stack([tangent, np.cross(normal, tangent), normal])
    outgoing = local @ (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*(local @ assembly.beam.directions_to_source(target.spot[None])[0]).tolist())
    # f cos, as Mitsuba's eval gives it.
    value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*(mi.Float(row.astype(np.float32)) for row in outgoing)))
    return np.sqrt(np.maximum(np.array(value[0], dtype=np.float64), 0.0)) * np.ones(len(directions))
