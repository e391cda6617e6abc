r"""
.. _shape-lens:

Lens (:monosp:`lens`)
---------------------

.. pluginparameters::

 * - to_world
   - |transform|
   - Place of the first vertex; the axis is the local z and runs into the glass. Only rotation and translation.
   - |exposed|
 * - radius1, ..., radiusN
   - |float|
   - Radii of curvature of the surfaces at their vertices [mm], in the order of the local z; positive: centre of
     curvature on the +z side, 0: plane. The highest number given to any parameter tells how many there are, 2 to 40.
     (Default: 0)
   - |exposed|
 * - conic1, ..., conicN
   - |float|
   - Conic constants; 0: sphere, -1: paraboloid, below -1: hyperboloid. (Default: 0)
   - |exposed|
 * - aspheric1, ..., asphericN
   - |string|
   - Coefficients of r^4, r^6, ... [mm^-3, mm^-5, ...], at most ten, with commas. (Default: none)
   -
 * - form1, ..., formN
   - |string|
   - ``rotational``, ``cylinder_x`` (curved along the local x only) or ``cylinder_y``. (Default: rotational)
   -
 * - thickness1, ..., thicknessN-1
   - |float|
   - Distances of each vertex to the next [mm]; of two surfaces also ``thickness``. (Required)
   - |exposed|
 * - ior1, ..., iorN-1
   - |float|
   - Indices of refraction behind each surface at the laser's wavelength, 1 to 10; relative to air in air, else to
     vacuum; 1: an air gap. Of two surfaces also ``ior``. (This or a glass is required)
   - |exposed|
 * - glass1, ..., glassN-1
   - |string|
   - Glasses behind each surface by name instead, at the laser's wavelength: ``N-BK7``, ``SCHOTT/N-BK7``,
     ``fused silica``, ``PMMA``, ``air``. Of two surfaces also ``glass``.
   -
 * - diameter, or diameter1, ..., diameterN
   - |float|
   - Clear diameter of all surfaces, or of each [mm]. (Required)
   - |exposed|
 * - filename
   - |string|
   - Instead of these a vendor's lens file, Zemax's as text (``.zmx``), beside the scene; a ``diameter``, ``ior`` or
     ``glass`` of the scene replaces the file's. (Default: none)
   -
 * - reverse
   - |boolean|
   - Turns the lens round: its last surface comes first, with its vertex where ``to_world`` says. (Default: false)
   -
 * - bsdf
   - |bsdf|
   - A smooth dielectric whose ``int_ior`` is the first ``ior``; its ``specular_transmittance`` counts at each surface,
     and its ``ext_ior`` says what everything stands in. (Default: a smooth dielectric of this index)
   -

Surfaces on one axis, :math:`z = c r^2 / (1 + \sqrt{1 - (1 + k) c^2 r^2}) + a_1 r^4 + a_2 r^6 + ...` from each vertex,
with a medium between each and the next: a singlet, a cemented group, an air-spaced one in its barrel. It stands in air,
or in the ``ext_ior`` of the scene's dielectrics where that is another medium.

Glasses by name have their makers' dispersion formulas, from the data of refractiveindex.info: indices relative to air
at 20 C and 1 atm. A name that several makers use wants the maker's before it; one that nobody uses is refused with
those that are near. The formula is taken at the wavelength as the laser gives it.

A file's surfaces in or at glass are the lens: standard ones, even aspheres, cylinders; glasses by name or by index and
Abbe's number; clear semi-diameters (CLAP, else DIAM; with a cylinder the least of them). What cannot be expressed is
refused by the surface's number and type; what does not count (coatings, a stop in air) is left out, as the plan says.

Around the glass is an opaque edge: a cylinder from rim to rim, where two rims differ with the larger one's radius and a
level ring to the smaller. Light inside that comes beside a rim ends there. An aperture may stand in an air gap. Other
integrators than ``coherent`` see the outer surfaces alone, with the first medium inside.

.. tabs::
    .. code-tab:: xml

        <shape type="lens">
            <float name="radius1" value="50"/> <float name="radius2" value="-50"/>
            <float name="thickness" value="5"/> <float name="diameter" value="20"/> <float name="ior" value="1.5151"/>
        </shape>

    .. code-tab:: python

        'type': 'lens', 'radius1': 62.8, 'radius2': -45.7, 'radius3': -128.2, 'thickness1': 4.0, 'thickness2': 2.5,
        'ior1': 1.5151, 'ior2': 1.6676, 'diameter': 25.4
"""

from __future__ import annotations

import mitsuba as mi

from speckle_mi.geometry.outline import Circle
from speckle_mi.optics.cylinder import Cylinder
from speckle_mi.optics.even_asphere import MOST_COEFFICIENTS, EvenAsphere
from speckle_mi.optics.glass import FixedIndex, index_of
from speckle_mi.optics.prescription import ROUNDING, Prescription
from speckle_mi.optics.surface import Surface
from speckle_mi.scene.body import Body
from speckle_mi.scene.elements import OUTSIDE, Element
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, read_boolean, read_choice, read_list, value_of
from speckle_mi.scene.write import ORIGIN
from ._lens_file import take_lens_file
from ._lens_mesh import bands_of, lens_faces, lens_vertices
from ._lens_numbers import FORMS, ROTATIONAL, LensNumbers, read_glass
from ._mesh import fill_mesh, moved_with
from ._numbers import check_numbers, expose, has_bsdf, in_words, read_numbers
from ._placement import Placement


class Lens(mi.Mesh):
    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        self.glasses, self.note = take_lens_file(props)
        self.numbers = LensNumbers(props, self.glasses)
        read_numbers(self, props, self.numbers.limits, self.numbers.defaults)
        self.glasses |= {number: read_glass(props, name) for number, name in self.numbers.glasses.items()}
        self.aspheric = [read_list(props, f"aspheric{number}", MOST_COEFFICIENTS) for number in self.numbers.all]
        self.forms = [read_choice(props, f"form{number}", ROTATIONAL, FORMS) for number in self.numbers.all]
        self.reverse = read_boolean(props, "reverse", False)
        self._check()
        self.owns_bsdf = not has_bsdf(props)
        if self.owns_bsdf:
            props["bsdf"] = mi.load_dict({"type": "dielectric", "int_ior": self.index, "ext_ior": 1.0})
        super().__init__(props)
        self.bands = bands_of(self.prescription().surfaces)
        vertices, normals = self._vertices()
        fill_mesh(self, self.placement.frame, vertices, lens_faces(self.bands), normals)

    @property
    def index(self) -> float:
        """Index of refraction behind the first surface, of a glass by name that of yellow light."""
        return index_of(self.prescription().glasses[0])

    def element(self) -> Element:
        """The media between the surfaces, which :meth:`Element.at` gives their indices at a wavelength."""
        vertices, _ = self._vertices()
        body = Body.mesh(self.placement.frame.to_world(vertices), lens_faces(self.bands))
        last, glasses = self.numbers.surfaces - 1, self.prescription().glasses
        sides = tuple((n - 1 if n > 0 else OUTSIDE, n if n < last else OUTSIDE) for n in range(last + 1))
        faces = self.surfaces()
        return Element(self.id(), "glass", faces, body, sides=sides, edged=True, glasses=glasses, note=self.note)

    def surfaces(self) -> tuple[Surface, ...]:
        """All surfaces in the world, each with its vertex and rim."""
        return self.prescription().placed(self.placement.frame)

    def prescription(self) -> Prescription:
        """The lens as light meets it, turned round where it is to be."""
        drawn = self._drawn()
        return drawn.reversed() if self.reverse else drawn

    def _drawn(self) -> Prescription:
        """The lens in the order of its parameters."""
        count = self.numbers.surfaces
        media = range(1, count)
        return Prescription(
            tuple(self._surface(number) for number in range(1, count + 1)),
            tuple(self._value(self.numbers.of_medium("thickness", number)) for number in media),
            tuple(self.glasses.get(n) or FixedIndex(self._value(self.numbers.of_medium("ior", n))) for n in media),
        )

    def _surface(self, number: int) -> Surface:
        radius, conic = self._value(f"radius{number}"), self._value(f"conic{number}")
        rim = Circle(self._value(self.numbers.diameter(number)) / 2)
        curvature, aspheric = 1.0 / radius if radius else 0.0, self.aspheric[number - 1]
        if (form := self.forms[number - 1]) != ROTATIONAL:
            return Cylinder(ORIGIN, curvature, conic, rim, FORMS.index(form) - 1)
        if any(aspheric):
            return EvenAsphere(ORIGIN, curvature, conic, rim, aspheric)
        return Surface(ORIGIN, curvature, conic, rim)

    def _value(self, name: str) -> float:
        return value_of(getattr(self, name))

    def _check(self) -> None:
        check_numbers(self, self.numbers.limits)
        self.numbers.check_forms(self.forms, self.aspheric)
        lens = self._drawn()
        for number, surface in enumerate(lens.surfaces, start=1):
            name = self.numbers.diameter(number)
            if surface.outline.reach > surface.widest * (1 + ROUNDING):
                raise SceneError(
                    f"{self.where}: parameter {name!r} is {self._value(name):g} mm, must be at most "
                    f"{2 * surface.widest:.7g} mm, the widest that 'radius{number}' = "
                    f"{self._value(f'radius{number}'):g} mm with 'conic{number}' = {surface.conic:g} allows"
                )
        for number, thickness in enumerate(lens.thicknesses, start=1):
            least, at = lens.thinnest(number - 1)
            if least < -ROUNDING * max(one.outline.reach for one in lens.surfaces):
                name, rim = self.numbers.of_medium("thickness", number), self.numbers.diameter(number)
                which = f" {number} and {number + 1}" if self.numbers.surfaces > 2 else ""
                raise SceneError(
                    f"{self.where}: the surfaces{which} cross inside the diameter of {self._value(rim):g} mm "
                    f"(thickness {least:.4g} mm at {at:.4g} mm from the axis), must not: {name!r} {thickness:g} mm "
                    f"must be at least {thickness - least:.7g} mm, or {rim!r} smaller"
                )

    def _vertices(self):
        """Vertices (n, 3) [mm] and normals (n, 3) in the local frame."""
        return lens_vertices(self.prescription().placed(ORIGIN), self.placement.frame, self.bands)

    def traverse(self, callback) -> None:
        super().traverse(callback)
        expose(self, self.numbers.limits, callback)

    def parameters_changed(self, keys) -> None:
        keys = moved_with(self, keys, self.numbers.limits, self._check, self._vertices)
        if self.owns_bsdf and any(key.startswith("ior") for key in keys):
            bsdf = mi.traverse(self.bsdf())
            bsdf["eta"] = self.index
            bsdf.update()
        super().parameters_changed(keys)

    def to_string(self) -> str:
        return f"Lens[{in_words(self, self.numbers.limits)}]"


mi.register_shape("lens", Lens)
