"""Writes scenes: their plugins as plain values, their XML as text, with every digit of a number.

    from speckle_mi.scene.write import aimed, detector, direction, integrator, laser, rough_target, write_scene

    write_scene("scene.xml", integrator(),
                laser(aimed(50 * direction(35, 180)), beam_radius=0.12, wavefront_radius=-750.0),
                rough_target(point_sources=100), detector(aimed(60 * direction(0)), 744, 480))

What is written here loads like any scene written by hand; parameters have the names and units of the plugins [mm, nm,
um, deg]. Nothing is checked here but that a value can be written: the plugins do that, and say what is wrong.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from ..geometry.frames import Frame
from ..machine.files import replacing

ORIGIN = Frame(np.zeros(3), np.eye(3))
"""The world's own frame: origin (0, 0, 0), axes x, y, z."""

_HEAD_ON = 1e-9
"""Sine of the angle to an axis below which a hint does not tell the direction across it."""

_KINDS = {bool: "boolean", int: "integer", float: "float", str: "string"}


@dataclass(frozen=True)
class Typed:
    """A parameter of a kind that no Python value stands for: ``Typed("spectrum", 0.5)`` is a reflectance of 0.5."""

    kind: str
    value: bool | int | float | str


@dataclass(frozen=True)
class Default:
    """A parameter that the command line can change: ``Default("width", 744)`` is written as ``$width``, 744 at rest."""

    name: str
    value: bool | int | float | str


@dataclass(frozen=True)
class Plugin:
    """One plugin of a scene.

    tag: what it is to the scene ("shape", "emitter", "sensor", "integrator", "bsdf", ...); type: which plugin; id: its
    name in plans and messages; frame: its place, None for a plugin that has none; size: by which a stock shape is
    scaled along its own axes first; values: parameters by their names, None is left out; inside: plugins within it, or
    XML as it stands.
    """

    tag: str
    type: str
    id: str | None = None
    frame: Frame | None = None
    size: tuple[float, float, float] = (1.0, 1.0, 1.0)
    values: Mapping[str, object] = field(default_factory=dict)
    inside: tuple[Plugin | str, ...] = ()

    def with_values(self, **values) -> Plugin:
        """The same with other parameters; None takes one away."""
        return replace(self, values={**self.values, **values})

    def at(self, frame: Frame) -> Plugin:
        """The same at another place."""
        return replace(self, frame=frame)

    def xml(self) -> str:
        """The XML element. Raises TypeError for a value that is no number, truth value or text."""
        name = "" if self.id is None else f" id={quoteattr(self.id)}"
        place = "" if self.frame is None else to_world(self.frame, self.size)
        body = place + parameters(self.values) + "".join(map(_xml, self.inside))
        return f"<{self.tag} type={quoteattr(self.type)}{name}>{body}</{self.tag}>"

    def defaults(self) -> dict[str, Default]:
        """Every ``Default`` of it and of the plugins inside, by name."""
        found = {value.name: value for value in self.values.values() if isinstance(value, Default)}
        for plugin in self.inside:
            if isinstance(plugin, Plugin):
                found |= plugin.defaults()
        return found


# Plugins of a sensor


def integrator(**values) -> Plugin:
    """How the field is computed: ``method``, ``tolerance``, ``diffraction``, ``rays_per_source``."""
    return Plugin("integrator", "coherent", values=values)


def laser(frame: Frame, id: str = "laser", **values) -> Plugin:
    """The laser, its light along the frame's z: ``wavelength`` [nm], ``beam_radius``, ``wavefront_radius`` [mm]."""
    return Plugin("emitter", "laser", id, frame, values={"wavelength": 632.8} | values)


def rough_target(frame: Frame = ORIGIN, id: str = "target", inside: Iterable[Plugin | str] = (), **values) -> Plugin:
    """The target, its outward normal along the frame's z: ``roughness`` [um], ``point_sources``, ``points``, ..."""
    return Plugin("shape", "rough_target", id, frame, values=values, inside=tuple(inside))


def detector(
    frame: Frame, width: int | Default, height: int | Default, pixel_pitch: float | Default = 0.006,
    samples: int = 1, id: str = "detector", **camera,
) -> Plugin:  # fmt: skip
    """The detector, which looks along the frame's z, columns against its x: pixels, their pitch [mm], sub-pixels.

    camera: ``mean_electrons``, ``read_noise``, ``full_well`` [e-], ``bit_depth``, ...
    """
    film = Plugin("film", "hdrfilm", values={"width": width, "height": height})
    sampler = [Plugin("sampler", "independent", values={"sample_count": samples})] if samples != 1 else []
    values = {"pixel_pitch": pixel_pitch} | camera
    return Plugin("sensor", "detector", id, frame, values=values, inside=(film, *sampler))


def shape(
    type: str, id: str, frame: Frame, inside: Iterable[Plugin | str] = (), size=(1.0, 1.0, 1.0), **values
) -> Plugin:
    """An aperture, a lens or a stock shape (``inside``: its material; ``size``: its scale) at a place."""
    return Plugin("shape", type, id, frame, tuple(size), values, tuple(inside))


def material(type: str, **values) -> Plugin:
    """A BSDF, such as ``dielectric`` with ``int_ior`` and ``ext_ior``, ``conductor``, ``diffuse``."""
    return Plugin("bsdf", type, values=values)


# Places


def direction(polar: float, azimuth: float = 0.0) -> np.ndarray:
    """Unit vector (3,) at an angle [deg] from +z, turned [deg] about z from +x."""
    polar, azimuth = np.radians([polar, azimuth])
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def frame_along(z: np.ndarray, origin: np.ndarray, x_hint: np.ndarray = (1.0, 0.0, 0.0)) -> Frame:
    """Right-handed frame at ``origin`` (3,) [mm], z along ``z`` (3,), x as near to ``x_hint`` (3,) as that allows."""
    z = np.asarray(z, dtype=np.float64) / np.linalg.norm(z)
    x = np.asarray(x_hint, dtype=np.float64) - (np.asarray(x_hint) @ z) * z
    if np.linalg.norm(x) < _HEAD_ON:
        x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return Frame(np.asarray(origin, dtype=np.float64), np.stack([x, np.cross(z, x), z], axis=1))


def aimed(origin: np.ndarray, at: np.ndarray = (0.0, 0.0, 0.0), x_hint: np.ndarray = (-1.0, 0.0, 0.0)) -> Frame:
    """Frame at ``origin`` (3,) [mm] that looks at a point ``at`` (3,) [mm]; a detector's columns then run along +x."""
    origin = np.asarray(origin, dtype=np.float64)
    return frame_along(np.asarray(at) - origin, origin, x_hint)


def on_axis(z: float) -> Frame:
    """The world's axes at a place on its z axis [mm]."""
    return Frame(np.array([0.0, 0.0, z]), np.eye(3))


# Text


def scene_text(*parts: Plugin | str) -> str:
    """The scene of plugins (or XML of parts as it stands), its defaults first."""
    defaults: dict[str, Default] = {}
    for part in parts:
        defaults |= part.defaults() if isinstance(part, Plugin) else {}
    lines = [f"<default name={quoteattr(name)} value={quoteattr(_text(d.value))}/>" for name, d in defaults.items()]
    return "\n".join(['<scene version="3.0.0">', *lines, *filter(None, map(_xml, parts)), "</scene>\n"])


def write_scene(path: str | os.PathLike, *parts: Plugin | str) -> Path:
    """Writes a scene file, whole or not at all, and returns its path. Raises OSError where it cannot be written."""
    with replacing(path) as temporary:
        temporary.write_text(scene_text(*parts), encoding="utf-8")
    return Path(path)


def write_points(path: str | os.PathLike, position: np.ndarray, weights: np.ndarray | None = None) -> Path:
    """Writes scatterers for a target's ``points``: position (n, 3) [mm] in its frame, weights (n,) complex or all one.

    Raises ValueError for arrays that do not fit together, OSError where the file cannot be written.
    """
    columns = np.atleast_2d(np.asarray(position, dtype=np.float64))
    if columns.ndim != 2 or columns.shape[1] != 3:
        raise ValueError(f"position of shape {np.shape(position)}: must be (n, 3) in mm")
    if weights is not None:
        weights = np.asarray(weights, dtype=np.complex128)
        if weights.shape != (len(columns),):
            raise ValueError(f"weights of shape {weights.shape}: must be one for each of the {len(columns)} scatterers")
        columns = np.column_stack([columns, weights.real, weights.imag])
    with replacing(path) as temporary:
        np.savetxt(temporary, columns, delimiter=",", fmt="%.17g")
    return Path(path)


def to_world(frame: Frame, size=(1.0, 1.0, 1.0)) -> str:
    """The transform that puts a plugin at a place, scaled before along its own axes."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = frame.axes * np.asarray(size, dtype=np.float64), frame.origin
    numbers = " ".join(repr(float(value)) for value in matrix.ravel())
    return f'<transform name="to_world"><matrix value="{numbers}"/></transform>'


def parameters(values: Mapping[str, object]) -> str:
    """Parameters as XML elements of the kind that their values have; None is left out."""
    return "".join(_parameter(name, value) for name, value in values.items() if value is not None)


def _parameter(name: str, value: object) -> str:
    if isinstance(value, Default):
        kind, text = _kind(name, value.value), f"${value.name}"
    elif isinstance(value, Typed):
        kind, text = value.kind, _text(value.value)
    else:
        kind, text = _kind(name, value), _text(value)
    return f"<{kind} name={quoteattr(name)} value={quoteattr(text)}/>"


def _kind(name: str, value: object) -> str:
    value = _plain(value)
    if type(value) not in _KINDS:
        raise TypeError(f"{name} = {value!r}: must be a number, a truth value or text, or Typed")
    return _KINDS[type(value)]


def _text(value: object) -> str:
    value = _plain(value)
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else repr(value)


def _plain(value: object) -> object:
    """A NumPy number as Python's and a path as text: both are written alike."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value.item() if isinstance(value, np.generic) else value


def _xml(part: Plugin | str) -> str:
    return part if isinstance(part, str) else part.xml()
