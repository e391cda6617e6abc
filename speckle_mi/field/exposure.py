"""What a camera makes of a frame: its numbers, and what the image's file says of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..geometry.pose import DEGREES_OF_FREEDOM, Pose
from ..images.camera import expose
from ..scene.assembly import Assembly

MOSTLY_SATURATED = 0.02
"""Share of saturated pixels from which on it is said: of developed speckle four times its mean is brighter."""


@dataclass(frozen=True)
class CameraFrame:
    """dn: (rows, columns) float32, None without a camera; header: what the image's file says of it; warnings: one
    sentence each."""

    dn: np.ndarray | None = None
    header: dict = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def picture_of(assembly: Assembly, pose: Pose, intensity: np.ndarray, shot: int = 0) -> CameraFrame:
    """The picture that the assembly's camera takes of an intensity (rows, columns) with the target at ``pose``.

    Its noise is a pure function of the camera, the surface, the pose and the number of the shot.
    """
    camera = assembly.camera
    if camera is None:
        return CameraFrame()
    place = (assembly.seed, [getattr(pose, name) + 0.0 for name in DEGREES_OF_FREEDOM], shot)
    picture = expose(camera, intensity, place)
    header = {"camera": camera.to_json() | {"electrons": picture.electrons, "saturated": picture.saturated}}
    warnings = ()
    if picture.saturated > MOSTLY_SATURATED:
        warnings = (
            f"{picture.saturated:.0%} of the pixels are saturated: more full_well or fewer electrons keep the speckle",
        )
    return CameraFrame(picture.dn, header, warnings)
