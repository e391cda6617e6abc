r"""
.. _shape-beam_splitter:

Beam splitter (:monosp:`beam_splitter`)
---------------------------------------

.. pluginparameters::

 * - to_world
   - |transform|
   - Place of the middle of the coated face, which lies across the local z. Only rotation and translation.
   - |exposed|
 * - width, height
   - |float|
   - Size along the local x and y [mm]. (Required unless ``diameter`` is given)
   - |exposed|
 * - diameter
   - |float|
   - Diameter of a round one [mm], instead of ``width`` and ``height``.
   - |exposed|
 * - thickness
   - |float|
   - Thickness of the plate behind the coated face, towards +z [mm]; 0: nothing but the coating. (Default: 0)
   - |exposed|
 * - ior
   - |float|
   - Index of refraction of the plate. (Required for a plate unless ``glass`` is given)
   - |exposed|
 * - glass
   - |string|
   - Glass of the plate by name, as for a ``lens``.
   -
 * - reflectance
   - |float|
   - Part R of the intensity that the coated face reflects, 0 to 1; 1 - R goes through. (Default: 0.5)
   - |exposed|

A plane that reflects a part of the light and lets the other part through, on the light's way to the target (of a laser
that is ``traced``) as on the way to the detector. Amplitudes are the roots of R and 1 - R on either side; nothing is
absorbed, and the coating's own phases, the same for all rays, are left out.

A plate is parallel: its back face is taken as perfectly anti-reflection coated, and around it is an opaque edge. Ghosts
are left out: the light that the back face of a real plate reflects, a percent or so of it, reaches the detector shifted
beside the light that is meant, or is absent where the plate is a wedge. A plate moves light aside, makes its path
longer, and in light that is not parallel it is astigmatic; all of that is traced. Light that comes through the back is
reflected inside the glass. A cube is a splitter without thickness, two glass cubes apart.

::

              reflected    through
                   ^          .
          coated   |        .
          face \   |      .
                \ \|    .
                 \ \  .  \
        light ----\-o     \   z: into the plate
                   \ \     \
                    \ thickness

.. tabs::
    .. code-tab:: xml

        <shape type="beam_splitter">
            <transform name="to_world"><rotate y="1" angle="45"/><translate z="30"/></transform>
            <float name="width" value="36"/> <float name="height" value="25"/>
            <float name="thickness" value="1"/> <string name="glass" value="N-BK7"/>
            <float name="reflectance" value="0.5"/>
        </shape>

    .. code-tab:: python

        'type': 'beam_splitter', 'diameter': 25.4, 'reflectance': 0.3
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.outline import Circle, Rectangle
from speckle_mi.optics.glass import FixedIndex, Glass, index_of
from speckle_mi.optics.surface import Surface
from speckle_mi.scene.body import Body
from speckle_mi.scene.elements import OUTSIDE, Element
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, read_number, value_of
from ._lens_numbers import INDEX, LENGTH, read_glass
from ._mesh import ENCLOSING, fill_mesh, moved_with, ring_faces, rounding_room, sector_angles, sheet_faces
from ._numbers import check_numbers, expose, has_bsdf, in_words, read_numbers
from ._placement import Placement

_SIDES = ("width", "height")
_THICKNESS = {"at_least": 0.0, "at_most": 1e5, "unit": "mm"}
_REFLECTANCE = {"at_least": 0.0, "at_most": 1.0}
_THINNEST = 1e-6
"""Thickness [mm] below which a plate would be thinner than light can tell."""


class BeamSplitter(mi.Mesh):
    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        self.limits = self._limits(props)
        read_numbers(self, props, self.limits, {"thickness": 0.0, "reflectance": 0.5})
        self.glass = read_glass(props, "glass") if "glass" in props else None
        self.is_plate = value_of(self.thickness) > 0
        self._check()
        if has_bsdf(props):
            raise SceneError(f"{self.where}: has a BSDF, must have none: 'reflectance' says all of it")
        self.owns_bsdf = True
        props["bsdf"] = self._bsdf()
        super().__init__(props)
        fill_mesh(self, self.placement.frame, self._vertices(), self._faces())

    def element(self) -> Element:
        """The coated face, and that behind it."""
        frame, outline = self.placement.frame, self._outline()
        faces = [Surface(frame, outline=outline)]
        body = Body.mesh(frame.to_world(self._vertices()), self._faces())
        reflectance = value_of(self.reflectance)
        if not self.is_plate:
            return Element(
                self.id(), "glass", tuple(faces), body, sides=((OUTSIDE, OUTSIDE),), reflectances=(reflectance,)
            )
        back = Frame(frame.origin + value_of(self.thickness) * frame.axes[:, 2], frame.axes)
        faces.append(Surface(back, outline=outline))
        return Element(
            self.id(), "glass", tuple(faces), body, sides=((OUTSIDE, 0), (0, OUTSIDE)), edged=True,
            glasses=(self._medium(),), reflectances=(reflectance, 0.0),
        )  # fmt: skip

    def _limits(self, props: mi.Properties) -> dict[str, dict]:
        """Numbers that the scene gives or must give, with their limits. SceneError where they contradict each other."""
        if "diameter" in props and any(name in props for name in _SIDES):
            raise SceneError(f"{self.where}: has 'diameter' and {_given(props, _SIDES)}, must have one or the other")
        sizes = ("diameter",) if "diameter" in props else _SIDES
        limits = dict.fromkeys(sizes, LENGTH) | {"thickness": _THICKNESS, "reflectance": _REFLECTANCE}
        plate = read_number(props, "thickness", 0.0, **_THICKNESS) > 0
        if not plate and ("ior" in props or "glass" in props):
            raise SceneError(f"{self.where}: has {_given(props, ('ior', 'glass'))}, but no plate: its 'thickness' is 0")
        if "ior" in props and "glass" in props:
            raise SceneError(f"{self.where}: has 'ior' and 'glass', must have one of them")
        return limits | ({"ior": INDEX} if plate and "glass" not in props else {})

    def _check(self) -> None:
        check_numbers(self, self.limits)
        thickness = value_of(self.thickness)
        if (thickness > 0) != self.is_plate or 0 < thickness < _THINNEST:
            wanted = f"at least {_THINNEST:g} mm" if self.is_plate else "0, as it was when the scene was loaded"
            raise SceneError(f"{self.where}: parameter 'thickness' is {thickness:g} mm, must be {wanted}")

    def _medium(self) -> Glass:
        return self.glass or FixedIndex(value_of(self.ior))

    def _outline(self) -> Circle | Rectangle:
        if "diameter" in self.limits:
            return Circle(value_of(self.diameter) / 2)
        return Rectangle(*(value_of(getattr(self, name)) / 2 for name in _SIDES))

    def _bsdf(self) -> mi.BSDF:
        """What other integrators see: of a plate the glass, else a mixture of mirror and nothing."""
        if self.is_plate:
            return mi.load_dict({"type": "dielectric", "int_ior": index_of(self._medium()), "ext_ior": 1.0})
        mirror = {"type": "twosided", "bsdf": {"type": "conductor"}}
        return mi.load_dict(
            {"type": "blendbsdf", "weight": 1 - value_of(self.reflectance), "one": mirror, "two": {"type": "null"}}
        )

    def _rim(self) -> np.ndarray:
        """Corners (s, 2) [mm] of a polygon around the outline, a trace outside it."""
        outline = self._outline()
        room = rounding_room(self.placement.frame, outline.reach + value_of(self.thickness))
        if isinstance(outline, Circle):
            angle = sector_angles()
            return ENCLOSING * (outline.radius + room) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (np.array(outline.half_size) + room)

    def _vertices(self) -> np.ndarray:
        """Vertices (n, 3) [mm], local: middle and rim of the coated face, and of a plate the same of its back."""
        flat = np.concatenate([np.zeros((1, 2)), self._rim()])
        heights = (0.0, value_of(self.thickness)) if self.is_plate else (0.0,)
        return np.concatenate([np.column_stack([flat, np.full(len(flat), height)]) for height in heights])

    def _faces(self) -> np.ndarray:
        corners = len(self._rim())
        sheet = sheet_faces(1, corners)
        if not self.is_plate:
            return sheet
        rings = ring_faces(2, corners)  # numbered from 0: the first rim, then the second
        edge = np.where(rings < corners, rings + 1, rings + 2)
        return np.concatenate([sheet[:, ::-1], sheet + corners + 1, edge[:, ::-1]])

    def traverse(self, callback) -> None:
        super().traverse(callback)
        expose(self, self.limits, callback)

    def parameters_changed(self, keys) -> None:
        super().parameters_changed(moved_with(self, keys, self.limits, self._check, lambda: (self._vertices(),)))

    def to_string(self) -> str:
        return f"BeamSplitter[{in_words(self, self.limits)}]"


def _given(props: mi.Properties, names: tuple[str, ...]) -> str:
    return " and ".join(repr(name) for name in names if name in props)


mi.register_shape("beam_splitter", BeamSplitter)
