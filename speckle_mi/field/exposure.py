"""What a camera makes of a frame: its numbers, and what the image's file says of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..geometry.pose import DEGREES_OF_FREEDOM
from ..images.camera import expose
from ..plan.setup import Setup
from ..plan.way import Channel
from ..scene.assembly import Assembly
from ..theory import irradiance_per_intensity, photoelectrons

MOSTLY_SATURATED = 0.02
"""Share of saturated pixels from which on it is said: of developed speckle four times its mean is brighter."""


@dataclass(frozen=True)
class CameraFrame:
    """dn: (rows, columns) float32, None without a camera; header: what the image's file says of it; warnings: one
    sentence each."""

    dn: np.ndarray | None = None
    header: dict = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def picture_of(setup: Setup, channels: tuple[Channel, ...], intensity: np.ndarray, shot: int = 0) -> CameraFrame:
    """The picture that the assembly's camera takes of an intensity (rows, columns) with the target at the setup's pose.

    channels: the ways that the light comes by. Noise is a pure function of the camera, the surface, the pose and the
    number of the shot.
    """
    camera = setup.assembly.camera
    if camera is None:
        return CameraFrame()
    place = (setup.assembly.seed, [getattr(setup.pose, name) + 0.0 for name in DEGREES_OF_FREEDOM], shot)
    per_intensity = None if camera.exposure is None else electrons_per_intensity(setup.assembly, channels)
    picture = expose(camera, intensity, place, per_intensity)
    header = {"camera": camera.to_json() | {"electrons": picture.electrons, "saturated": picture.saturated}}
    warnings = ()
    if picture.saturated > MOSTLY_SATURATED:
        warnings = (
            f"{picture.saturated:.0%} of the pixels are saturated: more full_well or fewer electrons keep the speckle",
        )
    return CameraFrame(picture.dn, header, warnings)


def electrons_per_intensity(assembly: Assembly, channels: tuple[Channel, ...] = ()) -> float:
    """Electrons that a unit of intensity frees in a pixel of a camera whose exposure is known, by the laser's power.

    Light is taken to fall on all pixels as on the detector's middle; by several ways, as by these in the mean.
    """
    camera, grid = assembly.camera, assembly.detector
    target = assembly.target
    irradiance = irradiance_per_intensity(assembly.power, assembly.in_spot, target.lobe is not None)
    area = camera.fill_factor * grid.pitch**2
    slope = float(np.mean([_slope(channel, assembly.spot.point) for channel in channels])) if channels else 1.0
    return slope * photoelectrons(
        irradiance, area, camera.exposure, assembly.vacuum_wavelength, camera.quantum_efficiency
    )


def _slope(channel: Channel, spot: np.ndarray) -> float:
    """Cosine of the angle at which light falls on the detector's middle, from the last place on its way."""
    last = channel.interactions[-1].place if channel.interactions else spot
    ray = channel.grid.centre - last
    return float(abs(channel.grid.normal @ ray) / np.linalg.norm(ray))
