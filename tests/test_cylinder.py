"""Cylinder lenses against exact rays in 40 digits and Fermat's path, with the edge and the mesh around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from exact_lenses import parameters_of, reversed_lens, with_index
from exact_optics import Refractor, bench, element_xml, facing, fermat, rendered_unit
from test_elements import triangles, volume
from test_lens import FIELD_TOLERANCE, FRONT, WAVELENGTH, check_paths, element_of

from speckle_mi.optics.cylinder import Cylinder
from speckle_mi.optics.edge import edge_crossing
from speckle_mi.scene.write import on_axis

INDICES = (1.5224, 1.5151, 1.5066)

LENSES = {
    "plano-convex along x": [{"radius": 40.0, "form": "cylinder_x", "after": (5.0, None)}, {"radius": 0.0}],
    "concave along y": [{"radius": -50.0, "form": "cylinder_y", "after": (4.0, None)},
                        {"radius": 60.0, "form": "cylinder_y", "conic": -0.4}],
    "crossed": [{"radius": 50.0, "form": "cylinder_x", "after": (6.0, None)},
                {"radius": -70.0, "form": "cylinder_y"}],
    "sphere and cylinder": [{"radius": 60.0, "conic": 0.3, "after": (6.0, None)},
                            {"radius": -45.0, "form": "cylinder_x", "conic": -1.2}],
}  # fmt: skip


@pytest.mark.parametrize("index", INDICES)
@pytest.mark.parametrize("name", LENSES)
def test_paths_through_a_cylinder_lens_are_exact_on_and_off_axis_both_ways_round(mitsuba, name, index):
    surfaces = with_index(LENSES[name], index)
    check_paths(element_of(mitsuba, surfaces), surfaces)
    check_paths(element_of(mitsuba, surfaces, reverse=True), reversed_lens(surfaces))


@dataclass(frozen=True)
class Cylindrical(Refractor):
    axis: int = 0

    def point(self, x, y):
        bent, zero = (x, y)[self.axis], 0 * x
        flat = super().point(bent, zero)
        across = self.axes @ np.stack([x, y, zero]) - self.axes @ np.stack([bent, zero, zero])
        return flat + across

    def tangents(self, x, y):
        bent, zero = (x, y)[self.axis], 0 * x
        c, one = self.curvature, np.ones_like(x)
        slope = c * bent / np.sqrt(1 - (1 + self.conic) * c * c * bent * bent)
        slopes = (slope, zero) if self.axis == 0 else (zero, slope)
        return self.axes @ np.stack([one, zero, slopes[0]]), self.axes @ np.stack([zero, one, slopes[1]])


@pytest.mark.parametrize("name", LENSES)
def test_field_through_a_cylinder_lens_is_that_of_fermats_path(tmp_path, assemble, name):
    surfaces, source, z, refractors = with_index(LENSES[name], 1.5151), np.array([0.4, -0.3, 0.0]), FRONT, []
    for one in surfaces:
        thickness, index = one.get("after", (0.0, 1.0))
        curvature, place = 1 / one["radius"] if one["radius"] else 0.0, np.array([0.0, 0, z])
        if form := one.get("form"):
            axis = ("cylinder_x", "cylinder_y").index(form)
            refractors.append(Cylindrical(place, np.eye(3), curvature, one.get("conic", 0.0), index, axis))
        else:
            refractors.append(Refractor(place, np.eye(3), curvature, one.get("conic", 0.0), index))
        z += thickness
    lens = element_xml("lens", "cylinder", on_axis(FRONT), diameter=22.0, **parameters_of(surfaces))
    assembly, _, field = rendered_unit(
        assemble, bench(tmp_path, source, facing(85.0, 0.5), [lens], pixels=(12, 8), diffraction=False)
    )
    places = assembly.detector.points()
    straight = (source[:2] + (places[:, :2] - source[:2]) * FRONT / 85.0).T
    length, amplitude = fermat(source[None], refractors, places, np.tile(straight, (2, 1)))
    expected = amplitude * np.exp(2j * np.pi / WAVELENGTH * length)
    assert np.linalg.norm(field - expected) < FIELD_TOLERANCE * np.linalg.norm(expected)


@pytest.mark.parametrize("name", LENSES)
def test_the_mesh_of_a_cylinder_lens_is_closed_and_holds_its_glass(mitsuba, name):
    surfaces = with_index(LENSES[name], 1.5)
    values = {"type": "lens", "diameter": 22.0} | parameters_of(surfaces)
    corners = triangles(mitsuba.load_dict(values))
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(area.sum(axis=0)) < 1e-5 * np.abs(area).sum()
    front, back = mitsuba.load_dict(values).element().faces
    r, angle = np.meshgrid(11.0 * np.sqrt((np.arange(400) + 0.5) / 400), 2 * np.pi * np.arange(400) / 400)
    x, y = r * np.cos(angle), r * np.sin(angle)
    thickness = surfaces[0]["after"][0] + back.sag(x, y) - front.sag(x, y)
    assert volume(corners) == pytest.approx(np.pi * 11.0**2 * np.mean(thickness), rel=1e-3)


def test_the_edge_of_a_cylinder_lens_follows_its_rim(mitsuba):
    """Plano-convex along x: on the x axis the edge is shorter by the sag than on the y axis."""
    values = {"type": "lens", "diameter": 22.0} | parameters_of(with_index(LENSES["plano-convex along x"], 1.5))
    faces = mitsuba.load_dict(values).element().faces
    sag = 40 - np.sqrt(40**2 - 11**2)
    starts = np.array([[-20.0, 0, sag - 0.01], [-20.0, 0, sag + 0.01], [0, -20.0, 0.01], [0, -20.0, 5.01]])
    towards = np.array([[1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]])
    met = edge_crossing(faces, starts, towards, 1e-8)
    assert list(np.isfinite(met)) == [False, True, True, False]
    assert met[1:3] == pytest.approx([9.0, 9.0], abs=1e-12)


def test_derivatives_are_those_of_the_height():
    from speckle_mi.geometry.outline import Circle

    x, y, h = np.array([0.0, 3.0, -7.0, 1.0]), np.array([0.0, 4.0, 2.0, -9.0]), 1e-4
    for axis in (0, 1):
        surface = Cylinder(on_axis(0.0), 0.03, -0.4, Circle(11.0), axis)
        point = np.stack([x, y, surface.sag(x, y)])
        for along in (0, 1):
            step = np.stack([h * (along == 0) + 0 * x, h * (along == 1) + 0 * x, 0 * x])
            slope = (surface.sag(*(point + step)[:2]) - surface.sag(*(point - step)[:2])) / (2 * h)
            assert np.allclose(surface.gradient(point)[along], slope, atol=1e-8)
            change = (surface.gradient(point + step) - surface.gradient(point - step)) / (2 * h)
            assert np.allclose(surface.bend(point, step[:, None] / h)[:, 0], change, atol=1e-8)


@pytest.mark.parametrize("change, message", [
    ({"form1": "cylinder_z"}, "'form1' is 'cylinder_z', must be one of rotational, cylinder_x, cylinder_y"),
    ({"aspheric1": "1e-6"}, "has 'form1' = 'cylinder_x' and 'aspheric1'"),
    ({"diameter1": 20.0}, "'form1' is 'cylinder_x' and the surfaces have diameters of their own"),
    ({"thickness1": 1.0}, "surfaces cross inside the diameter"),
    ({"radius1": 10.0}, "'diameter' is 22 mm, must be at most 20 mm"),
])  # fmt: skip
def test_cylinders_that_cannot_be_are_refused(mitsuba, change, message):
    values = {"type": "lens", "diameter": 22.0} | parameters_of(with_index(LENSES["plano-convex along x"], 1.5)) | change
    with pytest.raises(RuntimeError, match=message):
        mitsuba.load_dict(values)
