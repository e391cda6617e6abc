"""What one frame gave."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..geometry.pose import Pose
from ..images.field_image import FieldImage
from ..plan.stage import Stage
from ..scattering.rough_surface import Scatterers
from ..scene.assembly import Assembly
from ..version import __version__


@dataclass(frozen=True)
class LightOnDetector:
    """What light of one wavelength brings to the detector.

    assembly: with this light as its first; field: complex (rows, columns) at the pixels' centres; intensity: float32,
    averaged over the pixels; scatterers: what was summed; stages, error, warnings: as of the frame.
    """

    assembly: Assembly
    field: np.ndarray
    intensity: np.ndarray
    scatterers: Scatterers
    stages: tuple[Stage, ...]
    error: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class FrameResult:
    """A field image with what was found out on the way.

    scatterers: what was summed; stages: what was done and why; numerical_error: estimated relative L2 error of the
    field, NaN where it is not known (method ``rays``); warnings: one sentence each; seconds: it took; parts: what every
    laser and line brought, whose intensities add up (the image's field and ``scatterers`` are the first's); photons:
    (rows, columns) the light as a camera counts it, None where that is the image's intensity.
    """

    image: FieldImage
    scatterers: Scatterers
    stages: tuple[Stage, ...]
    numerical_error: float
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    parts: tuple[LightOnDetector, ...] = ()
    photons: np.ndarray | None = None

    @property
    def plan(self) -> list[str]:
        """The stages in words, one line each."""
        return [str(stage) for stage in self.stages]


def header_of(
    assembly: Assembly, scene_hash: str, pose: Pose, count: int, stages: tuple[Stage, ...], error: float,
    warnings: Iterable[str],
) -> dict:  # fmt: skip
    """What an image's file says of it: everything that it was made with, units in the names.

    scene_hash: the assembly's fingerprint.
    """
    grid, frame = assembly.detector, assembly.target.frame
    lights = [{"name": part.light, "wavelength_nm": round(part.vacuum_wavelength * 1e6, 9), "weight": part.weight}
              for part in assembly.parts] if assembly.further else None  # fmt: skip
    return ({"lights": lights} if lights else {}) | {
        "wavelength_nm": round(assembly.vacuum_wavelength * 1e6, 9),
        "pixel_pitch_mm": grid.pitch,
        "pose": str(pose),
        "seed": assembly.seed,
        "scene_hash": scene_hash,
        "method": assembly.options.method,
        "tolerance": assembly.options.tolerance,
        "phase_sign": "+ikL",
        "version": __version__,
        "software": f"speckle_mi {__version__}",
        "point_sources": count,
        "numerical_error": error,
        "plan": [stage.to_json() for stage in stages],
        "warnings": list(warnings),
        "detector_centre_mm": grid.centre.tolist(),
        "u": grid.u.tolist(),
        "v": grid.v.tolist(),
        "target_origin_mm": frame.origin.tolist(),
        "target_x": frame.axes[:, 0].tolist(),
        "target_y": frame.axes[:, 1].tolist(),
    }
