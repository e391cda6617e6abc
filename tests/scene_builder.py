"""Scenes for the tests: any geometry from directions and distances, written as the XML that a user would write."""

from __future__ import annotations

import numpy as np

from speckle_mi.geometry.frames import Frame
from speckle_mi.scene import write
from speckle_mi.scene.write import aimed, direction, frame_along, parameters

__all__ = ["direction", "frame_along", "parameters"]

WORLD = write.ORIGIN
transform, scene_of = write.to_world, write.scene_text


def detector_frame(sight: np.ndarray, distance: float, tilt: np.ndarray | None = None) -> Frame:
    """A detector at ``distance`` along ``sight`` that faces the origin, then turned by ``tilt`` (3, 3) where it stands.

    Columns run as far along +x as the line of sight allows (the local x axis points against the columns).
    """
    frame = aimed(distance * np.asarray(sight))
    return frame if tilt is None else Frame(frame.origin, tilt @ frame.axes)


def laser_xml(frame: Frame, **values) -> str:
    return write.laser(frame, **{"beam_radius": 0.12, "wavefront_radius": -750.0} | values).xml()


def target_xml(frame: Frame = WORLD, bsdf: str = "", **values) -> str:
    return write.rough_target(frame, inside=[bsdf], **{"roughness": 0.8, "point_sources": 100} | values).xml()


def detector_xml(
    frame: Frame, width: int = 64, height: int = 48, pixel_pitch: float = 0.006, samples: int = 1,
    id: str = "detector", camera: dict | None = None,
) -> str:  # fmt: skip
    return write.detector(frame, width, height, pixel_pitch, samples, id, **(camera or {})).xml()


def integrator_xml(**values) -> str:
    return write.integrator(**values).xml()


def free_space(
    to_laser: np.ndarray = direction(0),
    sight: np.ndarray = direction(0),
    *,
    laser_distance: float = 50.0,
    detector_distance: float = 60.0,
    tilt: np.ndarray | None = None,
    target_frame: Frame = WORLD,
    laser: dict | None = None,
    target: dict | None = None,
    detector: dict | None = None,
    integrator: dict | None = None,
    extra: str = "",
) -> str:
    """A scene of laser, target and detector; directions in the target's frame, which stands at ``target_frame``."""

    def placed(frame: Frame) -> Frame:
        return Frame(target_frame.origin + target_frame.axes @ frame.origin, target_frame.axes @ frame.axes)

    to_laser, sight = np.asarray(to_laser), np.asarray(sight)
    return scene_of(
        integrator_xml(**(integrator or {})),
        laser_xml(placed(frame_along(-to_laser, laser_distance * to_laser)), **(laser or {})),
        target_xml(target_frame, **(target or {})),
        detector_xml(placed(detector_frame(sight, detector_distance, tilt)), **(detector or {})),
        extra,
    )
