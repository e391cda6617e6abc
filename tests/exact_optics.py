"""Optics worked out a second way, for the tests to judge the product by: Fermat's principle and plain diffraction sums.

Nothing here traces a ray. The path from P to D over k surfaces is the stationary value of the length

    L(q) = sum n_i |X_{i+1} - X_i|,   X_0 = P, X_i = X_i(q_i) on surface i, X_{k+1} = D,

over the 2k coordinates q of the points on the surfaces, found by Newton's method with exact derivatives (complex
steps).
The amplitude is the Van Vleck determinant, |A|^2 = |det d2L/dP_perp dD_perp|, 1/r^2 in free space, and a focal line for
every negative eigenvalue of d2L/dq2 turns the phase by -pi/2 (Morse). Lengths are mm, the phasor is e^{+ikL}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scene_builder import (
    WORLD,
    detector_frame,
    detector_xml,
    direction,
    frame_along,
    integrator_xml,
    laser_xml,
    scene_of,
    target_xml,
)
from scipy.special import roots_legendre

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.field.simulation import simulate_frame
from speckle_mi.scene.write import Typed, material, shape, write_points

STEP = 1e-40  # Of a complex step: derivatives without any cancellation.


@dataclass(frozen=True)
class Refractor:
    """A conic of revolution, z = c r^2/(1 + sqrt(1 - (1 + k) c^2 r^2)) along its axis from its vertex; n behind it."""

    vertex: np.ndarray
    axes: np.ndarray
    curvature: float
    conic: float
    index: float

    def point(self, x, y):
        """(3, m) world points at local x, y (m,), complex allowed."""
        c, square = self.curvature, x * x + y * y
        z = c * square / (1 + np.sqrt(1 - (1 + self.conic) * c * c * square))
        return self.vertex[:, None] + self.axes @ np.stack([x, y, z])

    def tangents(self, x, y):
        """Two (3, m) derivatives of the point."""
        c, square = self.curvature, x * x + y * y
        slope = c / np.sqrt(1 - (1 + self.conic) * c * c * square)
        one, zero = np.ones_like(x), np.zeros_like(x)
        return self.axes @ np.stack([one, zero, slope * x]), self.axes @ np.stack([zero, one, slope * y])


def lens_surfaces(origin, axes, radius1, radius2, thickness, index, conic1=0.0, conic2=0.0) -> list[Refractor]:
    """Front and back of a lens whose front vertex is at ``origin`` and whose axis is axes[:, 2]."""
    origin, axes = np.asarray(origin, float), np.asarray(axes, float)

    def curvature(radius):
        return 1 / radius if radius else 0.0

    back = origin + thickness * axes[:, 2]
    return [
        Refractor(origin, axes, curvature(radius1), conic1, index),
        Refractor(back, axes, curvature(radius2), conic2, 1.0),
    ]


def _length(vector):
    return np.sqrt((vector * vector).sum(axis=0))


def _gradient(source, surfaces, q, target):
    """dL/dP (3, m), dL/dq (2k, m), dL/dD (3, m), and L (m,)."""
    points = [source, *(s.point(q[2 * i], q[2 * i + 1]) for i, s in enumerate(surfaces)), target]
    index = [1.0, *(s.index for s in surfaces)]
    total, along = 0.0, []
    for n, one, two in zip(index, points, points[1:], strict=False):
        length = _length(two - one)
        total = total + n * length
        along.append(n * (two - one) / length)
    inner = []
    for i, s in enumerate(surfaces):
        for tangent in s.tangents(q[2 * i], q[2 * i + 1]):
            inner.append(((along[i] - along[i + 1]) * tangent).sum(axis=0))
    return -along[0], np.array(inner), along[-1], total


def _jacobian(function, values):
    """d function / d values, (outputs, inputs, m), by complex steps."""
    columns = []
    for k in range(len(values)):
        moved = values.astype(complex)
        moved[k] += 1j * STEP
        columns.append(function(moved).imag / STEP)
    return np.stack(columns, axis=1)


def fermat(sources, surfaces, targets, start):
    """(length (m,), complex amplitude (m,)) of the rays from sources (m, 3) to targets (m, 3) over the surfaces.

    start: (2k, m) guess of the local coordinates on the surfaces.
    """
    source, target = (np.array(np.broadcast_to(a, np.broadcast_shapes(np.shape(sources), np.shape(targets))).T, float)
                      for a in (sources, targets))
    q = np.array(start, float)
    for _ in range(60):
        slope = _gradient(source, surfaces, q, target)[1]
        bend = _jacobian(lambda v: _gradient(source, surfaces, v, target)[1], q)
        step = -np.linalg.solve(np.moveaxis(bend, -1, 0), slope.T[..., None])[..., 0].T
        step *= np.minimum(1, 1.0 / np.maximum(np.abs(step).max(axis=0), 1e-300))
        q = q + step
        if np.abs(step).max() < 1e-13:
            break
    assert np.abs(slope).max() < 1e-11, f"the reference found no ray, slope {np.abs(slope).max():.1e}"
    bend = np.moveaxis(_jacobian(lambda v: _gradient(source, surfaces, v, target)[1], q), -1, 0)
    by_source = np.moveaxis(_jacobian(lambda v: _gradient(v, surfaces, q, target)[1], source), -1, 0)
    by_target = np.moveaxis(_jacobian(lambda v: _gradient(source, surfaces, q, v)[1], target), -1, 0)
    launch, _, arrival, length = _gradient(source, surfaces, q, target)
    mixed = -np.swapaxes(by_source, 1, 2) @ np.linalg.solve(bend, by_target)
    if not surfaces:
        raise ValueError("no surface: the length is the distance")
    first, last = _across(launch), _across(arrival)
    determinant = np.linalg.det(np.swapaxes(first, 1, 2) @ mixed @ last)
    focal_lines = (np.linalg.eigvalsh(0.5 * (bend + np.swapaxes(bend, 1, 2))) < 0).sum(axis=1)
    return length, np.sqrt(np.abs(determinant)) * (-1j) ** focal_lines


def _across(directions):
    """(m, 3, 2) two unit vectors across each of (3, m) directions."""
    d = directions / _length(directions)
    hint = np.where(np.abs(d[0]) < 0.7, np.array([[1.0], [0.0], [0.0]]), np.array([[0.0], [1.0], [0.0]]))
    first = hint - d * (hint * d).sum(axis=0)
    first /= _length(first)
    return np.stack([first, np.cross(d.T, first.T).T], axis=-1).transpose(1, 0, 2)


def thin_lens_start(source, target, surfaces, focal_length):
    """Guess (2k, m) for a lens near the line from source to target: where a thin lens would be crossed."""
    axes = surfaces[0].axes
    middle = np.mean([s.vertex for s in surfaces], axis=0)
    s, d = (np.atleast_2d(p - middle) @ axes for p in (np.asarray(source), np.asarray(target)))
    before, behind = -s[:, 2:], d[:, 2:]
    place = (d[:, :2] + behind / before * s[:, :2]) / (1 + behind / before - behind / focal_length)
    return np.tile(place.T, (len(surfaces), 1))


# Diffraction


def disc_nodes(radius, rings, spokes):
    """(x, y, weight) on a disc: Gauss-Legendre in the radius, equal angles."""
    t, w = roots_legendre(rings)
    r, w = radius * (t + 1) / 2, radius * w / 2
    angle = 2 * np.pi * np.arange(spokes) / spokes
    return (
        np.outer(r, np.cos(angle)).ravel(),
        np.outer(r, np.sin(angle)).ravel(),
        np.repeat(w * r * 2 * np.pi / spokes, spokes),
    )


def rectangle_nodes(half_x, half_y, count):
    """(x, y, weight) on a rectangle: Gauss-Legendre along both sides."""
    t, w = roots_legendre(count)
    x, y = np.meshgrid(half_x * t, half_y * t)
    return x.ravel(), y.ravel(), (half_x * half_y * np.outer(w, w)).ravel()


def diffracted(points, values, normal, targets, wavelength):
    """Rayleigh and Sommerfeld's first integral, (m,): sum values e^{ikr}/r (1 + i/(kr)) cos(chi) / (i lambda).

    points: (q, 3) on the opening; values: (q,) field there times area; normal: (3,) in the light's direction.
    """
    k = 2 * np.pi / wavelength
    field = np.empty(len(targets), complex)
    for i, target in enumerate(targets):
        ray = target - points
        r = np.sqrt((ray * ray).sum(axis=1))
        field[i] = np.sum(values * np.exp(1j * k * r) / r**2 * (1 + 1j / (k * r)) * (ray @ normal))
    return field / (1j * wavelength)


def spherical(sources, targets, wavelength):
    """e^{ikr}/r from sources (.., 3) to targets (.., 3)."""
    r = np.linalg.norm(np.asarray(targets) - np.asarray(sources), axis=-1)
    return np.exp(2j * np.pi / wavelength * r) / r


# Scenes


def tilted(*degrees: float) -> np.ndarray:
    """(3, 3) axes turned by a rotation vector [deg]."""
    return rotation_matrix(np.radians(degrees))


def element_xml(kind: str, name: str, frame, inside: str = "", size=(1.0, 1.0, 1.0), **values) -> str:
    """A shape at a place, scaled before by ``size``."""
    return shape(kind, name, frame, [inside], size, **values).xml()


DIELECTRIC = material("dielectric", int_ior=1.5151, ext_ior=1.0).xml()
MIRROR = material("conductor").xml()
BLACK = material("diffuse", reflectance=Typed("rgb", 0)).xml()


def bench(tmp_path, sources, detector, elements, *, pixels=(24, 16), pitch=0.05, wavelength=632.8, **integrator) -> str:
    """A scene of point sources (n, 3) [mm], elements, a detector, and a plane wave of ``wavelength`` [nm] along -z."""
    table = write_points(tmp_path / "points.csv", sources)
    light = frame_along(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 50.0]), np.array([1.0, 0.0, 0.0]))
    return scene_of(
        integrator_xml(**({"tolerance": 1e-6} | integrator)),
        laser_xml(light, beam_radius=None, wavefront_radius=None, wavelength=wavelength),
        *elements,
        target_xml(WORLD, points=table, roughness=None, point_sources=None),
        detector_xml(detector, width=pixels[0], height=pixels[1], pixel_pitch=pitch),
    )


def facing(z: float, x: float = 0.0, y: float = 0.0, tilt=(0.0, 0.0, 0.0)) -> Frame:
    """A detector that looks down the z axis, turned about its centre."""
    frame = detector_frame(direction(0), z)
    return Frame(frame.origin + [x, y, 0.0], tilted(*tilt) @ frame.axes)


def rendered(assemble, text: str):
    """(assembly, frame, field (pixels,)) of a scene."""
    assembly = assemble(text)
    frame = simulate_frame(assembly)
    return assembly, frame, frame.image.field.ravel()


def rendered_unit(assemble, text: str):
    """(assembly, frame, field (pixels,) of a unit source): a single source's field, less the illumination."""
    assembly, frame, field = rendered(assemble, text)
    assert frame.scatterers.count == 1
    return assembly, frame, field / frame.scatterers.amplitude[0]
