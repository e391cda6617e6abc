"""Lenses of any number of surfaces against exact rays in 40 digits, and against the same parts described apart."""

from __future__ import annotations

import numpy as np
import pytest
from exact_lenses import focal_length, parameters_of, path, reversed_lens
from exact_optics import Refractor, bench, diffracted, disc_nodes, element_xml, facing, fermat, rendered, rendered_unit
from exact_optics import thin_lens_start

from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.trace import trace
from speckle_mi.scene.elements import OUTSIDE
from speckle_mi.scene.write import on_axis

WAVELENGTH = 632.8e-6  # mm
PATH_TOLERANCE = 1e-6
"""Wavelengths, of an optical path against 40 digits."""

FIELD_TOLERANCE = 1e-5
"""Relative, of a scene whose tolerance is 1e-6."""

# Indices of N-BK7 and SF5 at 486.1, 587.6 and 656.3 nm.
CROWN, FLINT = (1.52238, 1.51680, 1.51432), (1.68750, 1.67271, 1.66661)


def cemented(n1: float, n2: float) -> list[dict]:
    return [{"radius": 62.8, "after": (4.0, n1)}, {"radius": -45.7, "after": (2.5, n2)}, {"radius": -128.2}]


def triplet(n1: float, n2: float) -> list[dict]:
    return [{"radius": 46.2, "after": (1.5, n2)}, {"radius": 26.9, "conic": -0.3, "after": (7.0, n1)},
            {"radius": -30.1, "after": (1.5, n2)}, {"radius": -60.0, "conic": 0.5}]  # fmt: skip


def air_spaced(n1: float, n2: float) -> list[dict]:
    return [{"radius": 59.0, "after": (4.5, n1)}, {"radius": -40.9, "after": (0.4, 1.0)},
            {"radius": -40.3, "after": (2.0, n2)}, {"radius": -130.7}]  # fmt: skip


LENSES = {"cemented doublet": cemented, "cemented triplet": triplet, "air-spaced doublet": air_spaced}

RAYS = {
    "along the axis": ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
    "to the rim": ([0.0, 0.0, 0.0], [0.1, 0.02, 1.0]),
    "off axis": ([7.0, -3.0, 0.0], [-0.12, 0.15, 1.0]),
    "parallel": ([6.0, 5.0, 0.0], [0.0, 0.0, 1.0]),
}

FRONT, END = 60.0, 160.0


def element_of(mi, surfaces: list[dict], **more):
    scene = {"type": "lens", "diameter": 22.0, "to_world": mi.ScalarTransform4f().translate([0, 0, FRONT])}
    return mi.load_dict(scene | parameters_of(surfaces) | more).element().at(WAVELENGTH)


def through(element, backwards: bool = False) -> Sequence:
    """Light over all faces of a lens, to the plane z = END."""
    medium, steps = OUTSIDE, []
    for face in range(len(element.faces))[:: -1 if backwards else 1]:
        steps.append(element.interaction(face, medium))
        medium = element.beyond(face, medium)
    return Sequence((*steps, Interaction.through(Surface(on_axis(END)))))


def check_paths(element, surfaces: list[dict], tolerance: float = PATH_TOLERANCE) -> None:
    origins, directions = (np.array(part, float) for part in zip(*RAYS.values(), strict=True))
    traced = trace(through(element), origins, directions)
    assert np.all(traced.valid)
    for number, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        expected, (x, y) = path(surfaces, origin, direction, FRONT, END)
        assert abs(float(expected - float(traced.optical_path_length[number]))) < tolerance * WAVELENGTH
        assert np.linalg.norm(traced.points[-1, number, :2] - [x, y]) < 1e-11 * END


@pytest.mark.parametrize("colour", [0, 1, 2])
@pytest.mark.parametrize("name", LENSES)
def test_paths_through_a_group_are_exact_on_and_off_axis_both_ways_round(mitsuba, name, colour):
    surfaces = LENSES[name](CROWN[colour], FLINT[colour])
    check_paths(element_of(mitsuba, surfaces), surfaces)
    check_paths(element_of(mitsuba, surfaces, reverse=True), reversed_lens(surfaces))


def test_a_plan_finds_the_way_over_all_surfaces_of_a_group_once(tmp_path, assemble):
    lens = element_xml("lens", "group", on_axis(FRONT), diameter=22.0, **parameters_of(triplet(CROWN[1], FLINT[1])))
    _, frame, _ = rendered(assemble, bench(tmp_path, np.zeros(3), facing(120.0), [lens], pixels=(8, 8)))
    assert any("group - group - group - group" in line for line in frame.plan), frame.plan


def _refractors(surfaces: list[dict]) -> list[Refractor]:
    z, found = FRONT, []
    for surface in surfaces:
        thickness, index = surface.get("after", (0.0, 1.0))
        curvature = 1 / surface["radius"] if surface["radius"] else 0.0
        found.append(Refractor(np.array([0.0, 0, z]), np.eye(3), curvature, surface.get("conic", 0.0), index))
        z += thickness
    return found


@pytest.mark.parametrize("name", LENSES)
def test_field_through_a_group_is_that_of_fermats_path(tmp_path, assemble, name):
    surfaces = LENSES[name](CROWN[1], FLINT[1])
    source = np.array([0.4, -0.3, 0.0])
    lens = element_xml("lens", "group", on_axis(FRONT), diameter=22.0, **parameters_of(surfaces))
    assembly, _, field = rendered_unit(
        assemble, bench(tmp_path, source, facing(110.0, 0.5), [lens], pixels=(12, 8), diffraction=False)
    )
    places, refractors = assembly.detector.points(), _refractors(surfaces)
    start = thin_lens_start(source, places, refractors, focal_length(surfaces))
    length, amplitude = fermat(source[None], refractors, places, start)
    expected = amplitude * np.exp(2j * np.pi / WAVELENGTH * length)
    assert np.linalg.norm(field - expected) < FIELD_TOLERANCE * np.linalg.norm(expected)


def test_field_behind_a_doublet_and_a_stop_is_the_huygens_sum(tmp_path, assemble):
    surfaces, source = cemented(CROWN[1], FLINT[1]), np.array([0.2, 0.1, 0.0])
    lens = element_xml("lens", "doublet", on_axis(FRONT), diameter=22.0, **parameters_of(surfaces))
    stop = element_xml("aperture", "stop", on_axis(80.0), radius=0.4)
    assembly, _, field = rendered_unit(
        assemble, bench(tmp_path, source, facing(140.0), [lens, stop], pixels=(12, 8), pitch=0.1)
    )
    x, y, weight = disc_nodes(0.4, 30, 90)
    places, refractors = np.stack([x, y, np.full(x.size, 80.0)], axis=1), _refractors(surfaces)
    length, amplitude = fermat(
        source[None], refractors, places, thin_lens_start(source, places, refractors, focal_length(surfaces))
    )
    at_stop = weight * amplitude * np.exp(2j * np.pi / WAVELENGTH * length)
    expected = diffracted(places, at_stop, np.array([0.0, 0, 1]), assembly.detector.points(), WAVELENGTH)
    assert np.linalg.norm(field - expected) < FIELD_TOLERANCE * np.linalg.norm(expected)


def _parts(surfaces: list[dict], pairs: list[tuple[int, float]]) -> list[str]:
    """Singlets between surfaces ``first`` and the next, front vertices at the given heights."""
    found = []
    for first, z in pairs:
        values = parameters_of([surfaces[first], surfaces[first + 1]])
        found.append(element_xml("lens", f"part{first}", on_axis(z), diameter=22.0, **values))
    return found


@pytest.mark.parametrize("name, pairs", [
    ("cemented doublet", [(0, FRONT), (1, FRONT + 4.0)]),
    ("air-spaced doublet", [(0, FRONT), (2, FRONT + 4.9)]),
])  # fmt: skip
def test_a_group_in_one_lens_is_its_singlets_one_behind_the_other(tmp_path, assemble, name, pairs):
    surfaces = LENSES[name](CROWN[1], FLINT[1])
    whole = [element_xml("lens", "group", on_axis(FRONT), diameter=22.0, **parameters_of(surfaces))]
    fields = [
        rendered_unit(assemble, bench(tmp_path, np.array([0.4, 0, 0]), facing(110.0), parts, pixels=(10, 6),
                                      diffraction=False))[2]
        for parts in (whole, _parts(surfaces, pairs))
    ]  # fmt: skip
    assert np.linalg.norm(fields[0] - fields[1]) < FIELD_TOLERANCE * np.linalg.norm(fields[1])


def test_a_reversed_lens_is_the_lens_turned_about_the_axis_across(mitsuba):
    surfaces = cemented(CROWN[1], FLINT[1])
    there = element_of(mitsuba, surfaces, reverse=True)
    place = mitsuba.ScalarTransform4f([[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, FRONT + 6.5], [0, 0, 0, 1]])
    turned = element_of(mitsuba, surfaces, to_world=place)
    rays = [np.array(part, float) for part in zip(*RAYS.values(), strict=True)]
    one, other = trace(through(there), *rays), trace(through(turned, backwards=True), *rays)
    assert np.allclose(one.optical_path_length, other.optical_path_length, rtol=0, atol=1e-6 * WAVELENGTH)


def test_the_index_names_of_a_singlet_and_the_numbered_ones_are_the_same_lens(mitsuba):
    plain = {"type": "lens", "radius1": 30.0, "diameter": 10.0}
    one = mitsuba.load_dict(plain | {"thickness": 3.0, "ior": 1.6}).element().at(WAVELENGTH)
    other = mitsuba.load_dict(plain | {"thickness1": 3.0, "ior1": 1.6}).element().at(WAVELENGTH)
    assert one.media == other.media == (1.6,)
    assert [f.frame.origin[2] for f in one.faces] == [f.frame.origin[2] for f in other.faces] == [0.0, 3.0]


def _wide(mi, **more):
    scene = {"type": "lens", "radius1": 40.0, "radius2": -30.0, "radius3": -80.0, "thickness1": 6.0, "thickness2": 3.0,
             "ior1": 1.5, "ior2": 1.7, "diameter1": 20.0, "diameter2": 16.0, "diameter3": 24.0}  # fmt: skip
    return mi.load_dict(scene | more)


def test_between_rims_of_several_diameters_an_edge_stands_in_the_way(mitsuba):
    from speckle_mi.optics.edge import edge_crossing, edge_profile

    faces = _wide(mitsuba).element().faces
    profile = edge_profile(faces)
    assert list(profile[:, 0]) == [10.0, 10.0, 12.0, 12.0]
    down = np.array([[0.0, 0.0, 1.0]] * 3)
    starts = np.array([[9.0, 0, -5], [11.0, 0, -5], [13.0, 0, -5]])
    met = edge_crossing(faces, starts, down, 1e-8)
    level = 6.0 - (30 - np.sqrt(30**2 - 8**2))  # the ring level with the middle rim
    assert np.isinf(met[0]) and np.isinf(met[2]) and met[1] == pytest.approx(5 + level, abs=1e-12)


def test_a_mesh_of_several_diameters_is_closed(mitsuba):
    from test_elements import triangles, volume

    corners = triangles(_wide(mitsuba))
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(area.sum(axis=0)) < 1e-5 * np.abs(area).sum()
    assert volume(corners) > 0


@pytest.mark.parametrize("change, message", [
    ({"thickness2": None}, "'thickness2' is missing"),
    ({"ior2": None}, "'ior2' is missing"),
    ({"diameter": None}, "'diameter' is missing"),
    ({"ior3": 1.5}, "'thickness3' is missing"),
    ({"thickness": 4.0, "thickness1": None}, "'thickness2' makes 3 surfaces"),
    ({"radius1000000": 4.0}, "makes 1000000 surfaces, must be at most 40"),
    ({"thickness1": 0.5}, "surfaces 1 and 2 cross.*'thickness1' 0.5 mm must be at least"),
    ({"radius2": -10.0}, "'diameter' is 22 mm, must be at most 20 mm, the widest that 'radius2'"),
    ({"ior2": 0.5}, "'ior2' is 0.5, must be at least 1"),
    ({"reverse": "yes"}, "reverse"),
    ({"radius01": 4.0}, "radius01"),
])  # fmt: skip
def test_what_a_group_lacks_is_named(mitsuba, change, message):
    scene = {"type": "lens", "diameter": 22.0} | parameters_of(cemented(CROWN[1], FLINT[1])) | change
    with pytest.raises(RuntimeError, match=message):
        mitsuba.load_dict({name: value for name, value in scene.items() if value is not None})
