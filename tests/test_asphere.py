"""Even aspheres against exact rays in 40 digits and Fermat's path, alone, in lenses and as mirrors."""

from __future__ import annotations

from dataclasses import dataclass

import mpmath
import numpy as np
import pytest
from exact_lenses import focal_length, parameters_of, reversed_lens, sag, with_index
from exact_optics import Refractor, bench, element_xml, facing, fermat, rendered_unit, thin_lens_start
from scene_builder import direction, frame_along
from test_lens import FIELD_TOLERANCE, FRONT, WAVELENGTH, check_paths, element_of

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.outline import Circle
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.optics.even_asphere import EvenAsphere
from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.trace import trace

INDICES = (1.5224, 1.5151, 1.5066)

ASPHERES = {
    "moulded asphere": [{"radius": 24.0, "conic": -0.6, "aspheric": [1.2e-5, -3e-8, 1e-11], "after": (6.0, None)},
                        {"radius": 0.0}],
    "two aspheres": [{"radius": 30.0, "aspheric": [-2e-6, 4e-9], "after": (6.0, None)},
                     {"radius": -45.0, "conic": 1.5, "aspheric": [3e-6]}],
    "Schmidt plate": [{"radius": 0.0, "aspheric": [-3e-5, 1.1e-7], "after": (4.0, None)}, {"radius": 0.0}],
}  # fmt: skip


@pytest.mark.parametrize("index", INDICES)
@pytest.mark.parametrize("name", ASPHERES)
def test_paths_through_an_asphere_are_exact_on_and_off_axis_both_ways_round(mitsuba, name, index):
    surfaces = with_index(ASPHERES[name], index)
    check_paths(element_of(mitsuba, surfaces), surfaces)
    check_paths(element_of(mitsuba, surfaces, reverse=True), reversed_lens(surfaces))


@dataclass(frozen=True)
class Aspheric(Refractor):
    coefficients: tuple[float, ...] = ()

    def point(self, x, y):
        square = x * x + y * y
        more = sum(a * square**n for n, a in enumerate(self.coefficients, start=2))
        return super().point(x, y) + self.axes @ np.stack([0 * x, 0 * x, more + 0 * x])

    def tangents(self, x, y):
        square = x * x + y * y
        more = sum(2 * n * a * square ** (n - 1) for n, a in enumerate(self.coefficients, start=2)) + 0 * x
        one, other = super().tangents(x, y)
        return one + self.axes @ np.stack([0 * x, 0 * x, more * x]), other + self.axes @ np.stack([0 * x, 0 * x, more * y])


@pytest.mark.parametrize("name", ["moulded asphere", "two aspheres"])
def test_field_through_an_asphere_is_that_of_fermats_path(tmp_path, assemble, name):
    surfaces, source, z, refractors = with_index(ASPHERES[name], 1.5151), np.array([0.4, -0.3, 0.0]), FRONT, []
    for one in surfaces:
        thickness, index = one.get("after", (0.0, 1.0))
        curvature = 1 / one["radius"] if one["radius"] else 0.0
        more = tuple(one.get("aspheric", ()))
        refractors.append(Aspheric(np.array([0.0, 0, z]), np.eye(3), curvature, one.get("conic", 0.0), index, more))
        z += thickness
    lens = element_xml("lens", "asphere", Frame(np.array([0, 0, FRONT]), np.eye(3)), diameter=22.0,
                       **parameters_of(surfaces))  # fmt: skip
    assembly, _, field = rendered_unit(
        assemble, bench(tmp_path, source, facing(95.0, 0.5), [lens], pixels=(12, 8), diffraction=False)
    )
    places = assembly.detector.points()
    start = thin_lens_start(source, places, refractors, focal_length(surfaces))
    length, amplitude = fermat(source[None], refractors, places, start)
    expected = amplitude * np.exp(2j * np.pi / WAVELENGTH * length)
    assert np.linalg.norm(field - expected) < FIELD_TOLERANCE * np.linalg.norm(expected)


SURFACE = EvenAsphere(Frame(np.zeros(3), np.eye(3)), 1 / 24, -0.6, Circle(11.0), (1.2e-5, -3e-8, 1e-11))
WAVY = EvenAsphere(Frame(np.zeros(3), np.eye(3)), 0.02, 0.3, Circle(10.0), (-4e-4, 2.5e-6))


def test_derivatives_are_those_of_the_height():
    x, y, h = np.array([0.0, 3.0, -7.0, 1.0]), np.array([0.0, 4.0, 2.0, -9.0]), 1e-4
    for surface in (SURFACE, WAVY):
        point = np.stack([x, y, surface.sag(x, y)])
        by_x, by_y, _ = surface.gradient(point)
        assert np.allclose(by_x, (surface.sag(x + h, y) - surface.sag(x - h, y)) / (2 * h), atol=1e-8)
        assert np.allclose(by_y, (surface.sag(x, y + h) - surface.sag(x, y - h)) / (2 * h), atol=1e-8)
        for axis in (0, 1):
            tangent = np.zeros((3, 1, 4))
            tangent[axis] = 1.0
            step = np.stack([h * (axis == 0) + 0 * x, h * (axis == 1) + 0 * x, 0 * x])
            change = (surface.gradient(point + step) - surface.gradient(point - step)) / (2 * h)
            assert np.allclose(surface.bend(point, tangent)[:, 0], change, atol=1e-8)


@pytest.mark.parametrize("distance", [10.0, 1e3, 5e3])
def test_a_crossing_is_exact_from_metres_away(distance):
    rng = np.random.default_rng(1)
    target = np.stack([rng.uniform(-7, 7, 40), rng.uniform(-7, 7, 40), np.zeros(40)])
    direction = np.stack([rng.normal(0, 0.1, 40), rng.normal(0, 0.1, 40), np.ones(40)])
    direction /= np.linalg.norm(direction, axis=0)
    point = target - distance * direction
    length, hit = SURFACE.intersect(point, direction)
    numbers = {"radius": 24.0, "conic": -0.6, "aspheric": SURFACE.coefficients}
    for n in range(40):
        with mpmath.workdps(30):
            p, d = ([mpmath.mpf(float(v)) for v in part[:, n]] for part in (point, direction))
            t = mpmath.findroot(lambda t: p[2] + t * d[2] - sag(numbers, p[0] + t * d[0], p[1] + t * d[1])[0], distance)
            assert abs(float(t - mpmath.mpf(float(length[n])))) < 1e-6 * WAVELENGTH + 4e-16 * distance


def test_all_crossings_of_a_wavy_surface_are_found_in_order():
    """A line along the surface's wave meets it up to four times; every change of side on a fine grid is one."""
    rng = np.random.default_rng(2)
    start = np.stack([np.full(200, -15.0), rng.uniform(-4, 4, 200), rng.uniform(-0.3, 0.2, 200)])
    direction = np.stack([np.ones(200), rng.normal(0, 0.05, 200), rng.normal(0, 0.01, 200)])
    direction /= np.linalg.norm(direction, axis=0)
    length, hit = WAVY.crossings(start, direction, False)
    t = np.linspace(0, 30, 40001)
    several = 0
    for n in range(200):
        p = start[:, n, None] + t * direction[:, n, None]
        inside = np.hypot(p[0], p[1]) < 10.0
        below = p[2] < WAVY.sag(p[0], p[1])
        expected = t[1:][(below[1:] != below[:-1]) & inside[1:] & inside[:-1]]
        found = length[:, n][np.isfinite(length[:, n])]
        assert len(found) == len(expected) and np.allclose(found, expected, atol=1e-3)
        several += len(found) > 2
    assert several > 5
    some = np.isfinite(length)
    assert np.abs(hit[:, 2] - WAVY.sag(hit[:, 0], hit[:, 1]))[some].max() < 1e-12


def test_tangents_through_an_asphere_are_those_of_rays_beside():
    from speckle_mi.optics.trace import march

    turned = Frame(np.array([0.3, -0.2, 20.0]), rotation_matrix(np.array([0.1, -0.2, 0.3])))
    surface = EvenAsphere(turned, 1 / 24, -0.6, None, SURFACE.coefficients)
    end = Interaction.through(Surface(Frame(np.array([0, 0, 40.0]), np.eye(3))))
    sequence = Sequence((Interaction.refract(surface, 1.0, 1.5), Interaction.refract(
        Surface(Frame(np.array([0, 0, 30.0]), np.eye(3))), 1.5, 1.0), end))  # fmt: skip
    origin, direction, h = np.zeros((1, 3)), np.array([[0.1, 0.05, 1.0]]), 1e-5
    across = np.array([1.0, 0.0, -0.1])
    unit = direction / np.linalg.norm(direction)
    state = np.stack([origin.T, unit.T, np.zeros((3, 1)), across[:, None]], axis=1)
    *_, last = march(sequence, state)
    ends = [trace(sequence, origin, unit + sign * h * across).points[-1, 0] for sign in (1, -1)]
    # The launch directions are of unit length again: the part of ``across`` along the ray does not count.
    unit_across = across - (across @ unit[0]) * unit[0]
    state[:, 3, 0] = unit_across
    *_, last = march(sequence, state)
    assert np.allclose(last.state[:, 2, 0], (ends[0] - ends[1]) / (2 * h), rtol=1e-7, atol=1e-7)


def like_a_paraboloid(radius: float) -> str:
    """Coefficients that take the sphere's own r^4, r^6, ... away, of c r^2/(1 + sqrt(1 - c^2 r^2)) = sum b_n c^(2n-1) r^2n."""
    term, found = 1 / 8, []
    for n in range(2, 10):
        found.append(-term / radius ** (2 * n - 1))
        term *= (2 * n - 1) / (2 * n + 2)
    return ", ".join(map(repr, found))


def test_a_spherical_mirror_with_the_paraboloids_coefficients_is_a_paraboloid(mitsuba):
    radius, r = 200.0, np.linspace(0, 10, 21)
    values = {"type": "mirror", "radius": radius, "diameter": 20.0, "aspheric": like_a_paraboloid(radius)}
    face = mitsuba.load_dict(values).element().faces[0]
    assert np.allclose(face.sag(r, 0 * r), r * r / (2 * radius), rtol=0, atol=1e-13)
    with pytest.raises(RuntimeError, match="'aspheric' has 11 numbers"):
        mitsuba.load_dict(values | {"aspheric": "1e-9 " * 11})


@pytest.mark.parametrize("off_axis", [0.0, 6.0])
def test_field_over_an_aspheric_mirror_is_that_over_the_paraboloid_it_stands_for(tmp_path, assemble, off_axis):
    turned = Frame(np.array([0.0, 0.0, 60.0]), rotation_matrix(np.radians([0.0, 20.0, 0.0])))
    aside = frame_along(-direction(-140), turned.origin + 30.0 * direction(-140), np.array([1.0, 0, 0]))
    fields = []
    for form in ({"conic": -1.0}, {"aspheric": like_a_paraboloid(200.0)}):
        bowl = element_xml("mirror", "bowl", turned, radius=200.0, diameter=20.0, off_axis=off_axis, **form)
        text = bench(tmp_path, np.zeros(3), aside, [bowl], pixels=(8, 8), diffraction=False)
        fields.append(rendered_unit(assemble, text)[2])
    assert np.linalg.norm(fields[0]) > 0
    assert np.linalg.norm(fields[1] - fields[0]) < FIELD_TOLERANCE * np.linalg.norm(fields[0])


@pytest.mark.parametrize("change, message", [
    ({"aspheric1": "1e-5, x"}, "'aspheric1' is '1e-5, x', must be numbers such as"),
    ({"aspheric1": "1e-5 inf"}, "'aspheric1'.*must be numbers"),
    ({"aspheric1": 1e-5}, "'aspheric1' is 1e-05, must be a text"),
    ({"aspheric1": "1e-3"}, "surfaces cross inside the diameter"),
    ({"radius1": 10.0, "conic1": 0.0}, "'diameter' is 22 mm, must be at most 19.99"),
    ({"aspheric3": "1e-9"}, "'thickness2' is missing"),
])  # fmt: skip
def test_aspheric_numbers_that_cannot_be_are_refused(mitsuba, change, message):
    values = {"type": "lens", "diameter": 22.0} | parameters_of(with_index(ASPHERES["moulded asphere"], 1.5)) | change
    with pytest.raises(RuntimeError, match=message):
        mitsuba.load_dict(values)
