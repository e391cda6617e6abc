"""The tolerance asked for is kept in every one of 240 random geometries, free and with elements, by the fast methods.

Distances 2 mm to 5 m, tilts to 70 degrees, spots 0.02 to 5 mm, wavelengths 0.3 to 10 um, roughness 0 to 50 um, one to
thousands of scatterers, detectors of one pixel to 200 x 200. The judges are the sum written down as it stands, image
sources, Fermat's principle and plain quadrature of an opening.
"""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import (
    MIRROR,
    bench,
    diffracted,
    disc_nodes,
    element_xml,
    fermat,
    lens_surfaces,
    rectangle_nodes,
    spherical,
    thin_lens_start,
    tilted,
)
from scene_builder import frame_along

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.plane import PlaneGrid
from speckle_mi.propagation.coherent_sum import coherent_sum
from speckle_mi.propagation.paths import FreeSpace, RayleighSommerfeld
from speckle_mi.propagation.reference import reference_sum
from speckle_mi.field.simulation import simulate_frame

CHECKED_POINTS = 40
FREE, MIRRORS, LENSES, OPENINGS = 150, 30, 30, 30


class Draw:
    """The random numbers of one geometry."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.uniform, self.integers = self.random.uniform, self.random.integers

    def between(self, low: float, high: float) -> float:
        """Evenly in the logarithm."""
        return float(10 ** self.uniform(np.log10(low), np.log10(high)))

    def spot(self, count: int, radius: float, roughness: float) -> np.ndarray:
        """Places (n, 3) [mm] of a spot of 1/e^2 ``radius`` cut at three radii, heights of rms ``roughness`` [mm]."""
        place = self.random.normal(size=(count, 3)) * [radius / 2, radius / 2, roughness]
        return place[np.hypot(place[:, 0], place[:, 1]) < 3 * radius]

    def places(self, target: PlaneGrid) -> np.ndarray:
        """Flat indices of points at which a field is judged."""
        return self.integers(target.size, size=CHECKED_POINTS)


def check(field: np.ndarray, exact: np.ndarray, tolerance: float, plan: object) -> None:
    error = np.linalg.norm(field - exact) / np.linalg.norm(exact)
    assert error <= tolerance, (error, tolerance, plan)


# The sums alone: free space, and from an opening


def sum_geometry(draw: Draw):
    distance, radius, wavelength = draw.between(2, 5000), draw.between(0.02, 5), draw.between(3e-4, 1e-2)
    sources = draw.spot(int(draw.between(2, 3000)), radius, draw.integers(2) * draw.uniform(0, 0.05))
    r_squared = sources[:, 0] ** 2 + sources[:, 1] ** 2
    weights = np.exp(-r_squared / (2 * radius**2) + 2j * np.pi * draw.uniform(size=len(sources)))
    theta, tilt = np.radians(draw.uniform(0, 70, 2))
    phi, psi, roll = draw.uniform(0, 2 * np.pi, 3)
    out = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    first = np.cross(out, [0.3, 0.9, 0.1])
    first /= np.linalg.norm(first)
    normal = -np.cos(tilt) * out + np.sin(tilt) * (np.cos(psi) * first + np.sin(psi) * np.cross(out, first))
    u = np.cross(normal, [0.2, 0.1, 0.97])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    u, v = np.cos(roll) * u + np.sin(roll) * v, np.cos(roll) * v - np.sin(roll) * u
    shape = tuple(int(n) for n in draw.integers(1, 200, 2))
    pitch = min(draw.between(1e-3, 3e-2), 0.7 * distance / max(shape))
    origin = distance * out - pitch * ((shape[1] - 1) / 2 * u + (shape[0] - 1) / 2 * v)
    path = RayleighSommerfeld(np.array([0.0, 0, 1]), wavelength) if draw.uniform() < 0.3 else FreeSpace()
    return path, sources, weights, PlaneGrid(origin, u, v, pitch, shape), wavelength, draw.between(1e-8, 1e-1)


@pytest.mark.parametrize("seed", range(FREE))
def test_sum_keeps_its_tolerance(mitsuba, seed):
    draw = Draw(seed)
    path, sources, weights, grid, wavelength, tolerance = sum_geometry(draw)
    pick = draw.places(grid)
    exact = reference_sum(path, sources, weights, grid.points()[pick], wavelength)
    for method in ("auto", "fast"):
        result = coherent_sum(path, sources, weights, grid, wavelength, method, tolerance)
        check(result.field.ravel()[pick], exact, tolerance, result.how)


# Whole scenes with elements


def sources_of(draw: Draw, most: int, radius: tuple[float, float]) -> tuple[np.ndarray, float]:
    """Scatterers (n, 3) [mm] of a spot, in front of the plane z = 0, and a wavelength [mm]."""
    roughness = draw.integers(2) * draw.uniform(0, 0.05)
    return draw.spot(int(draw.between(4, most)), draw.between(*radius), roughness), draw.between(3e-4, 1e-2)


def detector_towards(draw: Draw, origin: np.ndarray, heading: np.ndarray, tilt: float) -> Frame:
    """A detector at ``origin`` that faces light coming along ``heading``, turned by up to ``tilt`` [deg] and rolled."""
    frame = frame_along(-np.asarray(heading), np.asarray(origin, float), np.array([0.3, 1.0, 0.1]))
    turn = tilted(*draw.uniform(-tilt, tilt, 2), draw.uniform(-180, 180))
    return Frame(frame.origin, frame.axes @ turn)


def field_of(assemble, text: str, draw: Draw):
    """(places judged (m, 3), the field there (m,), scatterers, plan) of a scene, with auto and with fast."""
    assembly = assemble(text)
    pick = draw.places(assembly.detector)
    for method in ("auto", "fast"):
        frame = simulate_frame(assembly.with_options(method=method))
        yield assembly.detector.points()[pick], frame.image.field.ravel()[pick], frame.scatterers, frame.plan


@pytest.mark.parametrize("seed", range(1000, 1000 + MIRRORS))
def test_scene_of_a_mirror_keeps_its_tolerance(assemble, tmp_path, seed):
    draw = Draw(seed)
    distance, behind, tolerance = draw.between(10, 300), draw.between(10, 2000), draw.between(1e-7, 1e-1)
    sources, wavelength = sources_of(draw, 300, (0.02, min(2.0, 0.05 * distance)))
    mirror = Frame(
        np.array([0.0, 0, distance]), tilted(*draw.uniform(-10, 10, 2), 0) @ tilted(0, draw.uniform(115, 150), 0)
    )
    normal = mirror.axes[:, 2]

    def image(points):
        return points - 2 * ((points - mirror.origin) @ normal)[..., None] * normal

    heading = image(mirror.origin + [0.0, 0, 1]) - mirror.origin
    pixels = tuple(int(n) for n in draw.integers(1, 120, 2))
    pitch = min(draw.between(1e-3, 3e-2), 0.05 * (distance + behind) / max(pixels))
    detector = detector_towards(draw, mirror.origin + behind * heading, heading, 30)
    while len(set(sees_directly(detector, sources))) > 1:  # its plane cuts through the spot
        detector = detector_towards(draw, detector.origin, heading, 30)
    size = 0.8 * distance
    element = element_xml("rectangle", "mirror", mirror, MIRROR, size=(size, size, 1))
    text = bench(
        tmp_path, sources, detector, [element], pixels=pixels,
        pitch=pitch, wavelength=1e6 * wavelength, tolerance=tolerance, diffraction=False,
    )  # fmt: skip
    for places, field, lit, plan in field_of(assemble, text, draw):
        exact = spherical(image(lit.position), places[:, None], wavelength) @ lit.amplitude
        if sees_directly(detector, sources).all():
            exact = exact + spherical(lit.position, places[:, None], wavelength) @ lit.amplitude
        check(field, exact, tolerance, plan)


def sees_directly(detector: Frame, points: np.ndarray) -> np.ndarray:
    """Which of the points (n, 3) lie in front of the detector, (n,) bool."""
    return (points - detector.origin) @ detector.axes[:, 2] > 0


@pytest.mark.parametrize("seed", range(2000, 2000 + LENSES))
def test_scene_of_a_lens_keeps_its_tolerance(assemble, tmp_path, seed):
    draw = Draw(seed)
    sources, wavelength = sources_of(draw, 40, (0.02, 1.0))
    tolerance = draw.between(1e-6, 1e-1)
    sign = 1 if draw.uniform() < 0.7 else -1
    curvatures = sign * draw.uniform(0, 1 / 25, 2) * [1, -1]
    curvatures[draw.integers(2)] *= draw.integers(2)
    form = dict(
        radius1=0.0 if curvatures[0] == 0 else float(1 / curvatures[0]),
        radius2=0.0 if curvatures[1] == 0 else float(1 / curvatures[1]),
        conic1=draw.uniform(-1, 1),
        conic2=draw.uniform(-1, 1),
        thickness=draw.uniform(3, 6),
    )
    index = draw.uniform(1.3, 1.9)
    frame = Frame(np.array([*draw.uniform(-0.5, 0.5, 2), draw.between(25, 200)]), tilted(*draw.uniform(-5, 5, 2), 0))
    surfaces = lens_surfaces(frame.origin, frame.axes, index=index, **form)
    # The detector well before or well behind where the light may meet.
    power = (index - 1) * (curvatures[0] - curvatures[1]) + (index - 1) ** 2 * form["thickness"] * np.prod(
        curvatures
    ) / index
    vergence = power - 1 / frame.origin[2]
    behind = draw.between(20, 1000)
    if vergence > 0 and 0.5 < behind * vergence < 2:
        behind = (0.5 if draw.uniform() < 0.5 else 2.0) / vergence
    pixels = tuple(int(n) for n in draw.integers(2, 60, 2))
    magnified = abs(1 - behind * vergence)
    pitch = float(min(draw.between(2e-3, 5e-2), 3.0 * magnified / max(pixels)))
    detector = detector_towards(draw, [0, 0, frame.origin[2] + form["thickness"] + behind], [0, 0, 1.0], 20)
    element = element_xml("lens", "lens", frame, diameter=18.0, ior=index, **form)
    text = bench(
        tmp_path, sources, detector, [element], pixels=pixels,
        pitch=pitch, wavelength=1e6 * wavelength, tolerance=tolerance, diffraction=False,
    )  # fmt: skip
    for places, field, lit, plan in field_of(assemble, text, draw):
        exact = 0
        for position, amplitude in zip(lit.position, lit.amplitude, strict=True):
            start = thin_lens_start(position, places, surfaces, 1 / power if power else np.inf)
            length, factor = fermat(position, surfaces, places, start)
            exact = exact + amplitude * factor * np.exp(
                2j * np.pi * (length / wavelength - np.round(length / wavelength))
            )
        check(field, exact, tolerance, plan)


@pytest.mark.parametrize("seed", range(3000, 3000 + OPENINGS))
def test_scene_of_an_opening_keeps_its_tolerance(assemble, tmp_path, seed):
    draw = Draw(seed)
    sources, wavelength = sources_of(draw, 30, (0.02, 0.5))
    tolerance = draw.between(1e-6, 1e-1)
    before, behind = draw.between(5, 100), draw.between(5, 300)
    # Fresnel numbers to 60: the quadrature that judges stays affordable.
    half = np.sqrt(draw.between(0.1, 60) * wavelength / (1 / before + 1 / behind))
    half = min(half, 0.2 * before, 0.2 * behind)
    frame = Frame(np.array([*draw.uniform(-0.2, 0.2, 2) * half, before]), tilted(*draw.uniform(-25, 25, 2), 0))
    if draw.uniform() < 0.5:
        nodes, values = disc_nodes(half, 180, 480), {"radius": float(half)}
    else:
        other = half * draw.uniform(0.4, 1)
        nodes = rectangle_nodes(half, other, 260)
        values = {"shape": "rectangle", "width": float(2 * half), "height": float(2 * other)}
    pixels = tuple(int(n) for n in draw.integers(2, 80, 2))
    pitch = float(1.5 * half * (1 + behind / before) / max(pixels))
    detector = detector_towards(draw, [0, 0, before + behind], [0, 0, 1.0], 20)
    text = bench(
        tmp_path, sources, detector, [element_xml("aperture", "hole", frame, **values)], pixels=pixels, pitch=pitch,
        wavelength=1e6 * wavelength, tolerance=tolerance,
    )  # fmt: skip
    points = frame.to_world(np.stack([nodes[0], nodes[1], 0 * nodes[0]], axis=1))
    for places, field, lit, plan in field_of(assemble, text, draw):
        assert any("diffracted at hole" in line for line in plan), plan
        on_opening = spherical(lit.position, points[:, None], wavelength) @ lit.amplitude * nodes[2]
        exact = diffracted(points, on_opening, frame.axes[:, 2], places, wavelength)
        check(field, exact, tolerance, plan)
