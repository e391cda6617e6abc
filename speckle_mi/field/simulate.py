"""One field image of an assembly: scatterers, visibility, coherent sum, radiation lobe, pixel average."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..geometry.frames import Frame
from ..geometry.pose import Pose
from ..images.field_image import FieldImage
from ..machine.cores import products_on_one_thread
from ..machine.progress import tell
from ..plan.plan import Plan, make_plan
from ..plan.visibility import pixels_in_view, visible_scatterers
from ..plan.way import Channel
from ..scattering.rough_surface import Scatterers, illuminated_points, illuminated_scatterers
from ..scene.assembly import Assembly
from ..version import __version__
from .stages import ChannelField, channel_field, ray_channel


@dataclass(frozen=True)
class SimulatedFrame:
    """What :func:`simulate` found out besides the image.

    scatterers: what was summed; plan: one line a stage, what was done and why; numerical_error: estimated relative
    L2 error of the field; warnings: one sentence each.
    """

    image: FieldImage
    scatterers: Scatterers
    plan: list[str]
    numerical_error: float
    warnings: list[str] = field(default_factory=list)


def simulate(assembly: Assembly, pose: Pose | None = None) -> FieldImage:
    """The field image of ``assembly`` with its target at ``pose`` (default: the pose the scene's target has)."""
    return simulate_frame(assembly, pose).image


@products_on_one_thread()
def simulate_frame(assembly: Assembly, pose: Pose | None = None) -> SimulatedFrame:
    """:func:`simulate` with the scatterers, the plan, the estimated error and the warnings."""
    pose = assembly.pose if pose is None else pose
    frame = assembly.target.frame.moved(pose)
    warnings: list[str] = []
    plan = plan_of(assembly)
    scatterers = _visible(assembly, frame, _illuminated(assembly, frame), plan, warnings)
    centre, intensity, lines, error = _detect(assembly, frame, scatterers, plan)
    warnings += plan.warnings
    image = FieldImage(intensity, centre, _header(assembly, pose, scatterers, lines, error, warnings))
    return SimulatedFrame(image, scatterers, lines, error, warnings)


def field_of(assembly: Assembly, scatterers: Scatterers, pose: Pose | None = None) -> np.ndarray:
    """The field (rows, columns) at the pixel centres that given scatterers make with the target at ``pose``."""
    frame = assembly.target.frame.moved(assembly.pose if pose is None else pose)
    return _field(assembly, frame, scatterers, plan_of(assembly), (0.0, 0.0))[0]


def plan_of(assembly: Assembly) -> Plan:
    """The plan of an assembly with its target at rest, made once."""
    key = assembly.fingerprint()
    if key not in _plans:
        while len(_plans) >= _PLANS_KEPT:
            _plans.pop(next(iter(_plans)))
        _plans[key] = make_plan(assembly, assembly.target.frame)
    return _plans[key]


_plans: dict[str, Plan] = {}
_PLANS_KEPT = 8
_PIXELS_AT_ONCE = 1 << 13
_UNLIT = (
    "no light: the beam misses the target at this pose, or no scatterer lies under it (see point_sources), "
    "the field is zero"
)


def _illuminated(assembly: Assembly, frame: Frame) -> Scatterers:
    target = assembly.target
    if target.points is not None:
        return illuminated_points(target.points, assembly.beam, frame)
    return illuminated_scatterers(target.surface, assembly.beam, frame)


def _visible(assembly: Assembly, frame: Frame, lit: Scatterers, plan: Plan, warnings: list[str]) -> Scatterers:
    if not np.any(lit.amplitude):
        warnings.append(_UNLIT)
        return lit.selected(np.zeros(0, dtype=np.int64))
    viewpoints = [channel.viewpoint for channel in plan.channels] or [assembly.detector.centre]
    seen, note = visible_scatterers(assembly, frame, lit, viewpoints)
    if note or not np.any(seen.amplitude):
        warnings.append(note or _UNLIT)
    return seen


def _detect(
    assembly: Assembly, frame: Frame, scatterers: Scatterers, plan: Plan
) -> tuple[np.ndarray, np.ndarray, list[str], float]:
    """Field at the pixel centres, intensity averaged over the pixels, plan and estimated error."""
    side = assembly.sub_pixels
    centre, lines, error = _field(assembly, frame, scatterers, plan, (0.0, 0.0))
    if side == 1:
        return centre, _intensity(centre), lines, error
    total = np.zeros(assembly.detector.shape)
    for offset_v in _sub_pixel_offsets(side):
        for offset_u in _sub_pixel_offsets(side):
            if offset_u == offset_v == 0:
                total += _intensity(centre)
                continue
            values, _, sub_error = _field(assembly, frame, scatterers, plan, (offset_u, offset_v))
            total += _intensity(values)
            error = max(error, sub_error)
        tell("rows of sub-pixels", 1 + round(side * offset_v + (side - 1) / 2), side)
    lines = [*lines, f"pixels: intensity averaged over {side} x {side} sub-pixels"]
    return centre, (total / side**2).astype(np.float32), lines, error


def _sub_pixel_offsets(side: int) -> np.ndarray:
    """Centres of ``side`` equal parts of a pixel, in pixels from its centre."""
    return (np.arange(side) - (side - 1) / 2) / side


def _field(
    assembly: Assembly, frame: Frame, scatterers: Scatterers, plan: Plan, offset: tuple[float, float]
) -> tuple[np.ndarray, list[str], float]:
    """Sum of all channels' fields at the pixel centres, shifted by ``offset`` pixels along u and v."""
    lines = list(plan.lines)
    if scatterers.count == 0 or not plan.channels:
        return (
            np.zeros(assembly.detector.shape, complex),
            [*lines, "nothing is summed: no light reaches the detector"],
            0.0,
        )
    parts = [_part(assembly, frame, scatterers, channel, offset) for channel in plan.channels]
    lines += [line for part in parts for line in part.lines]
    if len(parts) == 1:
        return parts[0].field, lines, parts[0].error
    total = sum(part.field for part in parts)
    error = np.sqrt(sum((part.error * np.linalg.norm(part.field)) ** 2 for part in parts))
    norm = np.linalg.norm(total)
    return total, lines, float(error / norm) if norm > 0 else 0.0


def _part(
    assembly: Assembly, frame: Frame, scatterers: Scatterers, channel: Channel, offset: tuple[float, float]
) -> ChannelField:
    """What one channel brings to the pixel centres, shifted by ``offset`` pixels along u and v."""
    grid = channel.grid
    grid = replace(grid, origin=grid.origin + grid.pitch * (offset[0] * grid.u + offset[1] * grid.v))
    by_rays = assembly.options.method == "rays"
    part = (ray_channel if by_rays else channel_field)(assembly, frame, scatterers, channel, grid)
    if channel.interactions:
        return part
    seen = pixels_in_view(assembly, frame, grid)
    return part if np.all(seen) else replace(part, field=part.field * seen)


def _intensity(values: np.ndarray) -> np.ndarray:
    """|E|^2 in float32, (rows, columns); a few rows at a time, which stay in the processor's cache."""
    intensity = np.empty(values.shape, dtype=np.float32)
    step = max(1, _PIXELS_AT_ONCE // values.shape[1])
    for row in range(0, len(values), step):
        some = values[row : row + step]
        intensity[row : row + step] = some.real**2 + some.imag**2
    return intensity


def _header(
    assembly: Assembly, pose: Pose, scatterers: Scatterers, plan: list[str], error: float, warnings: list[str]
) -> dict:
    grid, frame = assembly.detector, assembly.target.frame
    return {
        "wavelength_nm": round(assembly.beam.wavelength * 1e6, 9),
        "pixel_pitch_mm": grid.pitch,
        "pose": str(pose),
        "seed": assembly.seed,
        "scene_hash": assembly.fingerprint(),
        "method": assembly.options.method,
        "tolerance": assembly.options.tolerance,
        "phase_sign": "+ikL",
        "version": __version__,
        "software": f"speckle_mi {__version__}",
        "point_sources": scatterers.count,
        "numerical_error": error,
        "plan": "; ".join(plan),
        "warnings": "; ".join(warnings),
        "detector_centre_mm": grid.centre.tolist(),
        "u": grid.u.tolist(),
        "v": grid.v.tolist(),
        "target_origin_mm": frame.origin.tolist(),
        "target_x": frame.axes[:, 0].tolist(),
        "target_y": frame.axes[:, 1].tolist(),
    }
