"""Scenes for the tests: any geometry from directions and distances, written as the XML that a user would write."""

from __future__ import annotations

import numpy as np

from speckle_mi.geometry.frames import Frame

WORLD = Frame(np.zeros(3), np.eye(3))


def direction(polar_deg: float, azimuth_deg: float = 0.0) -> np.ndarray:
    """Unit vector (3,) at an angle from +z, turned about z from +x."""
    polar, azimuth = np.radians([polar_deg, azimuth_deg])
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def frame_along(z: np.ndarray, origin: np.ndarray, x_hint: np.ndarray) -> Frame:
    """Right-handed frame whose z axis is ``z`` and whose x axis is as near to ``x_hint`` as that allows."""
    z = np.asarray(z, float) / np.linalg.norm(z)
    x = np.asarray(x_hint, float) - (x_hint @ z) * z
    if np.linalg.norm(x) < 1e-9:
        x = np.cross(np.array([0.0, 1.0, 0.0]), z)
    x /= np.linalg.norm(x)
    return Frame(np.asarray(origin, float), np.stack([x, np.cross(z, x), z], axis=1))


def detector_frame(sight: np.ndarray, distance: float, tilt: np.ndarray | None = None) -> Frame:
    """A detector at ``distance`` along ``sight`` that faces the origin, then turned by ``tilt`` (3, 3) where it stands.

    Columns run as far along +x as the line of sight allows (the local x axis points against the columns).
    """
    frame = frame_along(-np.asarray(sight), distance * np.asarray(sight), np.array([-1.0, 0.0, 0.0]))
    return frame if tilt is None else Frame(frame.origin, tilt @ frame.axes)


def transform(frame: Frame) -> str:
    """``to_world`` of a frame."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = frame.axes, frame.origin
    numbers = " ".join(repr(float(value)) for value in matrix.ravel())
    return f'<transform name="to_world"><matrix value="{numbers}"/></transform>'


def parameters(values: dict) -> str:
    """Parameters as XML elements by the type of their values; None is left out."""
    lines = []
    for name, value in values.items():
        kind = {bool: "boolean", int: "integer", float: "float", str: "string"}.get(type(value))
        if value is None:
            continue
        assert kind, f"{name} = {value!r}"
        text = str(value).lower() if kind == "boolean" else value if kind == "string" else repr(value)
        lines.append(f'<{kind} name="{name}" value="{text}"/>')
    return " ".join(lines)


def laser_xml(frame: Frame, **values) -> str:
    values = {"wavelength": 632.8, "beam_radius": 0.12, "wavefront_radius": -750.0} | values
    return f'<emitter type="laser" id="laser">{transform(frame)}{parameters(values)}</emitter>'


def target_xml(frame: Frame = WORLD, bsdf: str = "", **values) -> str:
    values = {"roughness": 0.8, "point_sources": 100} | values
    return f'<shape type="rough_target" id="target">{transform(frame)}{parameters(values)}{bsdf}</shape>'


def detector_xml(frame: Frame, width: int = 64, height: int = 48, pixel_pitch: float = 0.006, samples: int = 1) -> str:
    sampler = (
        f'<sampler type="independent"><integer name="sample_count" value="{samples}"/></sampler>'
        if samples != 1
        else ""
    )
    return (
        f'<sensor type="detector" id="detector">{transform(frame)}{parameters({"pixel_pitch": pixel_pitch})}'
        f'<film type="hdrfilm">{parameters({"width": width, "height": height})}</film>{sampler}</sensor>'
    )


def integrator_xml(**values) -> str:
    return f'<integrator type="coherent">{parameters(values)}</integrator>'


def scene_of(*parts: str) -> str:
    return '<scene version="3.0.0">\n' + "\n".join(parts) + "\n</scene>"


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
        laser_xml(placed(frame_along(-to_laser, laser_distance * to_laser, np.array([1.0, 0, 0]))), **(laser or {})),
        target_xml(target_frame, **(target or {})),
        detector_xml(placed(detector_frame(sight, detector_distance, tilt)), **(detector or {})),
        extra,
    )
