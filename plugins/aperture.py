r"""
.. _shape-aperture:

Aperture (:monosp:`aperture`)
-----------------------------

.. pluginparameters::

 * - to_world
   - |transform|
   - Place of the opening's centre; the disc faces along its local z. Only rotation and translation.
   - |exposed|
 * - shape
   - |string|
   - Form of the opening, ``circle`` or ``rectangle``. (Default: circle)
   -
 * - radius
   - |float|
   - Radius of a circular opening [mm]. (Required for ``circle``)
   - |exposed|
 * - width, height
   - |float|
   - Size of a rectangular opening along the local x and y [mm]. (Required for ``rectangle``)
   - |exposed|
 * - outer_radius
   - |float|
   - Radius of the opaque disc [mm], larger than the opening. (Default: 10 times the distance of the opening's
     farthest point from the centre, at least 10)
   - |exposed|
 * - bsdf
   - |bsdf|
   - What other integrators see. (Default: black)
   -

A thin opaque disc with a hole. Light passes it in either direction.

.. tabs::
    .. code-tab:: xml

        <shape type="aperture">
            <transform name="to_world"><translate z="41"/></transform>
            <float name="radius" value="0.5"/>
        </shape>

    .. code-tab:: python

        'type': 'aperture', 'radius': 0.5, 'to_world': mi.ScalarTransform4f().translate([0, 0, 41])
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from speckle_mi.geometry.outline import Circle, Rectangle
from speckle_mi.optics.surface import Surface
from speckle_mi.scene.body import Body
from speckle_mi.scene.elements import Element
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, read_choice, read_number, stored, value_of
from ._mesh import ENCLOSING, SECTORS, fill_mesh, moved_with, ring_faces, rounding_room, sector_angles
from ._numbers import check_numbers, expose, has_bsdf, in_words, read_numbers
from ._placement import Placement

_SIZES = {"circle": ("radius",), "rectangle": ("width", "height")}
_SIZE = {"at_least": 1e-6, "at_most": 1e5, "unit": "mm"}


class Aperture(mi.Mesh):
    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        self.form = read_choice(props, "shape", "circle", _SIZES)
        for name in sum(_SIZES.values(), ()):
            if name in props and name not in _SIZES[self.form]:
                wanted = " and ".join(_SIZES[self.form])
                raise SceneError(f"{self.where}: has {name!r}, but a {self.form} is given by {wanted}")
        read_numbers(self, props, dict.fromkeys(_SIZES[self.form], _SIZE))
        self.limits = dict.fromkeys((*_SIZES[self.form], "outer_radius"), _SIZE)
        self.outer_radius = stored(read_number(props, "outer_radius", max(10.0, 10.0 * self._outline().reach), **_SIZE))
        self._check()
        if not has_bsdf(props):
            black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
            props["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": black})
        super().__init__(props)
        fill_mesh(self, self.placement.frame, self._vertices(), ring_faces(2, SECTORS))

    def element(self) -> Element:
        """The hole, a plane with its outline, in its screen."""
        frame = self.placement.frame
        return Element(
            self.id(),
            "opening",
            (Surface(frame, outline=self._outline()),),
            Body.mesh(frame.to_world(self._vertices()), ring_faces(2, SECTORS)),
            screen_radius=value_of(self.outer_radius),
        )

    def _outline(self) -> Circle | Rectangle:
        sizes = [value_of(getattr(self, name)) for name in _SIZES[self.form]]
        return Circle(sizes[0]) if self.form == "circle" else Rectangle(sizes[0] / 2, sizes[1] / 2)

    def _check(self) -> None:
        check_numbers(self, self.limits)
        outer, inner = value_of(self.outer_radius), ENCLOSING * self._outline().reach + self._room()
        if not outer > inner:
            raise SceneError(
                f"{self.where}: parameter 'outer_radius' is {outer:g} mm, must be more than {inner:.7g} mm, "
                f"where the {self.form} ends"
            )

    def _room(self) -> float:
        return rounding_room(self.placement.frame, value_of(self.outer_radius))

    def _vertices(self) -> np.ndarray:
        """Corners of the hole, then of the disc's edge at the same angles, (2 SECTORS, 3) [mm], local."""
        outline, room = self._outline(), self._room()
        if isinstance(outline, Circle):
            angle = sector_angles()
            reach = np.full(SECTORS, ENCLOSING * (outline.radius + room))
        else:
            x, y = outline.half_x + room, outline.half_y + room
            corner = np.arctan2(y, x)
            # A quarter of the corners on each side, the first of them in the rectangle's own corner; evenly in angle,
            # so that the disc's edge stays round around a narrow slit.
            first = np.array([-corner, corner, np.pi - corner, np.pi + corner])
            part = np.arange(SECTORS // 4) * (4 / SECTORS)
            angle = (first[:, None] + np.multiply.outer((np.roll(first, -1) - first) % (2 * np.pi), part)).ravel()
            reach = 1 / np.maximum(np.abs(np.cos(angle)) / x, np.abs(np.sin(angle)) / y)
        profile = np.concatenate([reach, np.full(SECTORS, value_of(self.outer_radius))])
        flat = profile * np.tile([np.cos(angle), np.sin(angle)], 2)
        return np.stack([*flat, np.zeros(2 * SECTORS)], axis=-1)

    def traverse(self, callback) -> None:
        super().traverse(callback)
        expose(self, self.limits, callback)

    def parameters_changed(self, keys) -> None:
        super().parameters_changed(moved_with(self, keys, self.limits, self._check, lambda: (self._vertices(),)))

    def to_string(self) -> str:
        return f"Aperture[{self.form}, {in_words(self, self.limits, ' mm')}]"


mi.register_shape("aperture", Aperture)
