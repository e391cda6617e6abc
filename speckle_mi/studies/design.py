"""A scene whose numbers can be changed by name: what a study varies.

A name is that of a ``<default>`` of the scene, or a key as ``mi.traverse`` has it: ``lens.radius1``,
``laser.wavefront_radius``, ``detector.pixel_pitch``. Besides, every part that has a place can be displaced from where
the scene puts it: ``lens.x``, ``lens.y``, ``lens.z`` [mm] along and ``lens.rx``, ``lens.ry``, ``lens.rz`` [deg] about
the part's own axes, as a target is by its pose. A displaced target is at rest there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose
from ..scene.assembly import Assembly

INDEX = "bsdf.eta"
"""Key of the refractive index of one of Mitsuba's own shapes."""

_AT_REST = "seed"
"""What is no number to be varied: which surface."""


@dataclass(frozen=True)
class Design:
    """A scene file with values of its ``<default>``s, as plain data that another process can use.

    path: of the scene; defaults: names and texts, as ``-D`` gives them; variant: of Mitsuba; detector: id of the only
    one that is looked at, None for all; content: hash of the file and of what it describes, by which results are known.
    """

    path: str = field(compare=False)
    defaults: tuple[tuple[str, str], ...]
    variant: str
    detector: str | None
    content: str

    @classmethod
    def of(
        cls,
        path: str,
        defaults: Iterable[tuple[str, str]] = (),
        variant: str | None = None,
        detector: str | None = None,
    ) -> Design:
        """Raises SceneError, InputError, OSError as ``load_scene``."""
        from ..machine.backend import DEFAULT_VARIANT

        made = cls(str(Path(path).absolute()), tuple(defaults), variant or DEFAULT_VARIANT, detector, "")
        held = made.assemblies({})
        digest = sha256(Path(path).read_bytes())
        for name, assembly in held.items():
            digest.update(f"{name}:{assembly.fingerprint()}:{assembly.seed};".encode())
        return replace(made, content=digest.hexdigest()[:16])

    def with_values(self, values: Mapping[str, float]) -> Design:
        """The same with values of ``<default>``s written into it. Raises InputError for any other name."""
        known = self._texts()
        for name in values:
            if name not in known:
                raise InputError(f"{name}: the scene has no such <default>, must be one of {_listed(known)}")
        texts = dict(self.defaults) | {name: written(value) for name, value in values.items()}
        return type(self).of(self.path, texts.items(), self.variant, self.detector)

    def nominal(self) -> dict[str, float]:
        """Every number that can be changed, by its name, as the scene has it; displacements are 0."""
        found = {}
        for name, text in self._texts().items():
            try:
                found[name] = float(text)
            except ValueError:
                continue
        return {name: value for name, value in found.items() if name != _AT_REST} | _keys(self._scene({}))

    def require(self, names: Iterable[str], where: str = "") -> dict[str, float]:
        """The scene's own values of some names. Raises InputError for one that it has not."""
        known = self.nominal()
        for name in names:
            if name not in known:
                raise InputError(f"{where}{name}: the scene has no such number, must be one of {_listed(known)}")
            if not math.isfinite(known[name]):
                raise InputError(f"{where}{name}: is {known[name]} in the scene, must be finite to be varied")
        return {name: known[name] for name in names}

    def assemblies(self, values: Mapping[str, float]) -> dict[str, Assembly]:
        """The assembly with changed numbers, by detector. Raises SceneError where the scene does not allow them."""
        from ..scene.read import assemblies_from_scene

        texts = dict(self._texts()) if values else {}
        scene = self._scene({name: value for name, value in values.items() if name in texts})
        _change(scene, {name: value for name, value in values.items() if name not in texts})
        return assemblies_from_scene(scene, self.detector)

    def _texts(self) -> dict[str, str]:
        """The scene's ``<default>``s."""
        from ..scene.source import NotReadable, source_of_file

        try:
            known = source_of_file(self.path, {}).defaults
        except NotReadable:
            known = {}
        return known | dict(self.defaults)

    def _scene(self, values: Mapping[str, float]):
        from ..scene.load import open_scene

        texts = dict(self.defaults) | {name: written(value) for name, value in values.items()}
        return open_scene(self.path, [f"{name}={text}" for name, text in texts.items()], self.variant)


def written(value: float) -> str:
    """A number with every digit, whole ones as whole."""
    return f"{value:.17g}"


def _listed(names: Iterable[str]) -> str:
    """Names in words, a part's six displacements as one."""
    names, listed = list(names), []
    for name in names:
        part, _, last = name.rpartition(".")
        if part and last in DEGREES_OF_FREEDOM:
            name = f"{part}.({'|'.join(DEGREES_OF_FREEDOM)})"
        if name not in listed:
            listed.append(name)
    return ", ".join(listed) or "(none)"


def _keys(scene) -> dict[str, float]:
    """Numbers of a loaded scene's parts, and their displacements, all 0."""
    import mitsuba as mi

    from ..machine.backend import arrays
    from ..scene.parameters import value_of

    parameters, found, placed = mi.traverse(scene), {}, []
    own = {key.rpartition(".")[0] for key in parameters.keys() if ".ior" in key}
    for key in parameters.keys():
        part, _, name = key.rpartition(".")
        if name == "to_world" and "." not in part:
            placed.append(part)
        elif isinstance(parameters[key], arrays().Float64):
            found[key] = value_of(parameters[key])
        elif key.endswith(f".{INDEX}") and key.removesuffix(f".{INDEX}") not in own:
            found[key] = float(str(np.float32(parameters[key])))
    return found | {f"{part}.{dof}": 0.0 for part in placed for dof in DEGREES_OF_FREEDOM}


def _change(scene, values: Mapping[str, float]) -> None:
    """Changes a loaded scene's numbers and displaces its parts. Raises SceneError where one is not allowed."""
    import mitsuba as mi

    from ..scene.errors import SceneError, one_line

    if not values:
        return
    parameters, moved = mi.traverse(scene), {}
    for key, value in values.items():
        part, _, name = key.rpartition(".")
        if name in DEGREES_OF_FREEDOM:
            moved.setdefault(part, {})[name] = value
        else:
            parameters[key] = type(parameters[key])(value)
    exact = {part: _displaced(scene, parameters, part, Pose(**pose)) for part, pose in moved.items()}
    for part, matrix in exact.items():
        key = f"{part}.to_world"
        parameters[key] = type(parameters[key])(matrix)
    try:
        parameters.update()
    except RuntimeError as error:
        raise SceneError(one_line(error)) from error
    # Mitsuba keeps single precision: what was asked for is given again to those who keep it whole.
    for part, matrix in exact.items():
        if hasattr(plugin := _plugin(scene, part), "placement"):
            plugin.placement.put(matrix)
        for shape in scene.shapes():
            if hasattr(shape, "precise_transforms"):
                shape.precise_transforms[part] = matrix


def _displaced(scene, parameters, part: str, pose: Pose) -> np.ndarray:
    """(4, 4) place of a part that is displaced along and about its own axes, in double precision."""
    plugin = _plugin(scene, part)
    if hasattr(plugin, "placement"):
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = plugin.placement.frame.axes, plugin.placement.frame.origin
    else:
        known = [shape.precise_transforms for shape in scene.shapes() if hasattr(shape, "precise_transforms")]
        rounded = np.array(parameters[f"{part}.to_world"].matrix, np.float64).reshape(4, 4, -1)[..., 0]
        place = next((matrices[part] for matrices in known if part in matrices), rounded)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = pose.rotation, pose.translation
    if plugin is not None and not hasattr(plugin, "placement"):  # a stock shape's axes are as long as it is large
        size = np.linalg.norm(place[:3, :3], axis=0)
        place, scale = place @ np.diag([*(1 / size), 1.0]), np.diag([*size, 1.0])
        return place @ motion @ scale
    return place @ motion


def _plugin(scene, part: str):
    """The shape, sensor or emitter of an id."""
    return next((one for one in (*scene.shapes(), *scene.sensors(), *scene.emitters()) if one.id() == part), None)
