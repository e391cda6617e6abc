"""Quadrature on openings against closed forms of diffraction and against rules that share nothing with it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import fresnel, j0, j1, roots_legendre

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.plane import PlanePoints
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.propagation.opening_quadrature import opening_nodes, star_nodes
from speckle_mi.geometry.outline import Circle, Rectangle
from speckle_mi.propagation.paths import RayleighSommerfeld
from speckle_mi.propagation.reference import reference_sum

WAVELENGTH = 632.8e-6  # mm
K = 2 * np.pi / WAVELENGTH
FLAT = Frame(np.zeros(3), np.eye(3))
TOLERANCES = (1e-3, 1e-6)
CHANGES = (0.0, 0.3, 3.0, 30.0, 100.0, 300.0, 1000.0, 2000.0)
"""Phase gradient times radius [rad]."""

CLOSED_FORM_TOLERANCE = 1e-6
"""Asked of the quadrature where a closed form or a finer rule is the judge, relative to the unobstructed field."""


def disc_scale(change: float) -> float:
    """Root mean square of the integral over a unit disc of e^{i g.x}, over all g up to ``change``."""
    return np.pi * min(1.0, 2.0 / max(change, 1e-9))


def tone(points: PlanePoints, weights: np.ndarray, gx: float, gy: float) -> complex:
    return weights @ np.exp(1j * (gx * points.a + gy * points.b))


def disc_tone(gradient: float) -> float:
    return 2 * np.pi * (j1(gradient) / gradient if gradient else 0.5)


def gradients(change: float) -> np.ndarray:
    return change * (np.linspace(0, 1, 25) if change <= 300 else np.array([0.5, 0.95, 0.999, 1.0]))


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("change", CHANGES)
def test_a_tilted_wave_on_a_disc_gives_the_airy_pattern(change, tolerance):
    points, weights = opening_nodes(Circle(1.0), FLAT, change, tolerance)
    for g in gradients(change):
        assert abs(tone(points, weights, 0.8 * g, 0.6 * g) - disc_tone(g)) <= tolerance * disc_scale(change)


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("change", CHANGES)
def test_a_tilted_wave_on_a_rectangle_gives_two_sincs(change, tolerance):
    gx, gy = change / 2, change / 0.5
    points, weights = opening_nodes(Rectangle(2.0, 0.5), FLAT, (gx, 0.3 * gy), tolerance)
    scale = 4 * np.sqrt(np.prod([min(1.0, np.pi / 2 / max(c, 1e-9)) for c in (change, 0.3 * change)]))
    for part in (0.0, 0.4, 0.9, 1.0):
        for other in (0.0, 0.7, 1.0):
            exact = 4 * np.sinc(part * change / np.pi) * np.sinc(other * 0.3 * change / np.pi)
            assert abs(tone(points, weights, part * gx, other * 0.3 * gy) - exact) <= tolerance * scale


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
@pytest.mark.parametrize("change", [10.0, 100.0, 1000.0])
@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_a_defocused_and_tilted_wave_needs_fewer_nodes_and_keeps_the_tolerance(tolerance, change, share):
    points, weights = opening_nodes(Circle(1.0), FLAT, change, tolerance, tilt=share * change)
    assert points.size < opening_nodes(Circle(1.0), FLAT, change, tolerance)[0].size
    x, w = roots_legendre(2500)
    r, w = (x + 1) / 2, w * np.pi * (x + 1) / 2
    for part in (0.0, 0.5, 0.9, 1.0):
        for defocus in (0.0, 0.6, 1.0):
            tilt, bend = part * share * change, defocus * (1 - share) * change / 2
            exact = w @ (np.exp(1j * bend * r**2) * j0(tilt * r))
            phase = tilt * (0.6 * points.a + 0.8 * points.b) + bend * (points.a**2 + points.b**2)
            assert abs(weights @ np.exp(1j * phase) - exact) <= tolerance * disc_scale(change)


@pytest.mark.parametrize("change", [30.0, 100.0, 400.0])
def test_an_astigmatic_wave_is_resolved_too(change):
    tolerance = 1e-5
    points, weights = opening_nodes(Circle(1.0), FLAT, change, tolerance)
    # Integral over the angle of e^{i (K/2) r^2 cos 2 theta}.
    x, w = roots_legendre(1000)
    r = (x + 1) / 2
    exact = np.pi * np.sum(w * r * j0(change / 2 * r**2))
    value = weights @ np.exp(0.5j * change * (points.a**2 - points.b**2))
    assert abs(value - exact) <= tolerance * disc_scale(change)


def fewest_nodes_of_this_kind(change: float, tolerance: float) -> int:
    """Nodes of the smallest rule for tilted waves found by asking for ever looser tolerances."""
    asked, fewest = tolerance, np.inf
    while asked <= 0.1:
        points, weights = opening_nodes(Circle(1.0), FLAT, change, asked)
        error = max(abs(tone(points, weights, g, 0.0) - disc_tone(g)) for g in gradients(change))
        if error > tolerance * disc_scale(change):
            break
        fewest, asked = points.size, 2 * asked
    return int(fewest)


@pytest.mark.parametrize("change", [100.0, 300.0, 1000.0])
def test_hardly_more_nodes_are_used_than_needed(change):
    tolerance = 1e-3
    used = opening_nodes(Circle(1.0), FLAT, change, tolerance)[0].size
    assert used <= 1.3 * fewest_nodes_of_this_kind(change, tolerance)


def test_the_number_of_nodes_tends_to_an_eighth_of_the_phase_squared():
    # K R / 4 radii by K R / 2 angles on average.
    assert opening_nodes(Circle(1.0), FLAT, 4000.0, 1e-3)[0].size < 1.15 * 4000.0**2 / 8


@pytest.mark.parametrize("change", [0.0, 1.0, 50.0])
@pytest.mark.parametrize("outline, area", [(Circle(0.7), np.pi * 0.49), (Rectangle(0.2, 3.0), 2.4)])
def test_weights_are_positive_and_add_up_to_the_area(outline, area, change):
    frame = Frame(np.array([3.0, -1.0, 40.0]), rotation_matrix(np.array([0.2, -0.4, 1.0])))
    points, weights = opening_nodes(outline, frame, change, 1e-6)
    assert np.all(weights > 0)
    assert np.sum(weights) == pytest.approx(area, rel=1e-13)
    local = frame.to_local(points.points())
    assert np.max(np.abs(local[:, 2])) < 1e-13
    assert np.all(outline.margins(local[:, 0], local[:, 1]) > 0)


# Openings bounded by a smooth curve


def displaced_circle(angle: np.ndarray, radius: float = 1.0, shift: float = 0.4) -> np.ndarray:
    """A circle of which the origin lies ``shift`` from the centre along -x."""
    return shift * np.cos(angle) + np.sqrt(radius**2 - (shift * np.sin(angle)) ** 2)


def ellipse(angle: np.ndarray, a: float = 1.0, b: float = 0.5) -> np.ndarray:
    return a * b / np.hypot(b * np.cos(angle), a * np.sin(angle))


@pytest.mark.parametrize("change", [0.0, 10.0, 100.0, 500.0])
@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_a_circle_seen_from_beside_its_centre_is_the_same_circle(change, tolerance):
    points, weights = star_nodes(displaced_circle, FLAT, change, tolerance)
    for angle in (0.0, 0.9, np.pi / 2):
        for g in (0.5 * change, change):
            gx, gy = g * np.cos(angle), g * np.sin(angle)
            exact = np.exp(1j * gx * 0.4) * disc_tone(g)
            assert abs(tone(points, weights, gx, gy) - exact) <= tolerance * disc_scale(change)


@pytest.mark.parametrize("change", [0.0, 10.0, 100.0, 500.0])
@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_an_elliptic_pupil_is_a_stretched_circle(change, tolerance):
    points, weights = star_nodes(ellipse, FLAT, change, tolerance)
    scale = 0.5 * np.pi * min(1.0, 2 / max(change * np.sqrt(0.5), 1e-9))
    for angle in (0.0, 0.9, np.pi / 2):
        for g in (0.5 * change, change):
            gx, gy = g * np.cos(angle), g * np.sin(angle)
            exact = 0.5 * disc_tone(np.hypot(gx, 0.5 * gy))
            assert abs(tone(points, weights, gx, gy) - exact) <= tolerance * scale


# Diffraction: Rayleigh-Sommerfeld I, phasor e^{+ikr}


def diffracted(points: PlanePoints, weights: np.ndarray, incident: np.ndarray, targets: np.ndarray) -> np.ndarray:
    path = RayleighSommerfeld(points.normal, WAVELENGTH)
    return reference_sum(path, points.points(), weights * incident, targets, WAVELENGTH)


def spherical(points: PlanePoints, source: np.ndarray) -> np.ndarray:
    s = np.linalg.norm(points.points() - source, axis=1)
    return np.exp(1j * K * s) / s


def slopes(radius: float, source: np.ndarray, targets: np.ndarray) -> tuple[float, float]:
    """Largest gradient of k(s + r) over a disc in z = 0, and largest component across the radius [rad/mm]."""
    theta = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    total = across = 0.0
    for r in radius * np.linspace(0.01, 1, 12):
        q = np.stack([r * np.cos(theta), r * np.sin(theta), 0 * theta], axis=-1)
        incoming = (q - source) / np.linalg.norm(q - source, axis=1, keepdims=True)
        for target in targets:
            slope = incoming + (q - target) / np.linalg.norm(q - target, axis=1, keepdims=True)
            total = max(total, K * np.max(np.hypot(slope[:, 0], slope[:, 1])))
            across = max(across, K * np.max(np.abs(np.cos(theta) * slope[:, 1] - np.sin(theta) * slope[:, 0])))
    return total, across


@pytest.mark.parametrize("distance", [0.1, 0.5, 5.0, 50.0, 4000.0])
def test_plane_wave_on_the_axis_behind_a_disc(distance):
    # U = e^{ikz} - (z/rho) e^{ik rho}, rho = sqrt(z^2 + R^2): Osterberg and Smith, J. Opt. Soc. Am. 51, 1050 (1961).
    radius = 0.05
    rho = np.hypot(distance, radius)
    # sin(chi) grows slower than r: its bound in proportion to r is r/z.
    points, weights = opening_nodes(Circle(radius), FLAT, K * radius / distance, 1e-8, tilt=0.0)
    field = diffracted(points, weights, np.ones(points.size), np.array([[0.0, 0.0, distance]]))[0]
    exact = np.exp(1j * K * distance) - distance / rho * np.exp(1j * K * rho)
    assert abs(field - exact) < CLOSED_FORM_TOLERANCE


@pytest.mark.parametrize("fresnel_number", [0.1, 0.5, 1.0, 2.0, 10.0, 21.0, 50.0, 200.0])
def test_point_source_on_the_axis_behind_a_disc(fresnel_number):
    # With w = s + r the integral over the disc is that of e^{ikw}/w, whose derivative along z is taken at its two ends.
    radius, ratio = 0.5, 1.7
    source_distance = (1 + 1 / ratio) * radius**2 / (WAVELENGTH * fresnel_number)
    distance = ratio * source_distance
    source, target = np.array([0, 0, -source_distance]), np.array([[0, 0, distance]])
    rho = np.hypot(distance, radius)
    near, far = source_distance + distance, np.hypot(source_distance, radius) + rho
    exact = np.exp(1j * K * near) / near - distance / rho * np.exp(1j * K * far) / far
    gradient = K * radius * (1 / source_distance + 1 / distance)
    points, weights = opening_nodes(Circle(radius), FLAT, gradient, 1e-8, tilt=0.0)
    field = diffracted(points, weights, spherical(points, source), target)[0]
    assert abs(field - exact) * near < CLOSED_FORM_TOLERANCE


def chord_rule(radius: float, count: int) -> tuple[PlanePoints, np.ndarray]:
    """Another quadrature on a disc: Gauss-Legendre along chords, x = R sin(phi)."""
    x, w = roots_legendre(count)
    phi = x * np.pi / 2
    half = radius * np.cos(phi)
    a, b = np.repeat(radius * np.sin(phi), count), np.multiply.outer(half, x).ravel()
    return PlanePoints(np.zeros(3), *np.eye(3)[:2], a, b), np.multiply.outer(w * np.pi / 2 * half * half, w).ravel()


@pytest.mark.parametrize("fresnel_number", [0.1, 1.0, 21.0, 200.0])
@pytest.mark.parametrize("tilted", [False, True], ids=["bound", "tilt"])
def test_edge_of_the_shadow_of_a_disc(fresnel_number, tilted):
    radius = 0.5
    distance = 2 * radius**2 / (WAVELENGTH * fresnel_number)
    source = np.array([0.05, -0.02, -distance])
    # Inside, on and outside the edge of the geometric shadow.
    rho = np.array([0.5, 1.8, 2.0, 2.3]) * radius
    targets = np.stack([rho * 0.8 - source[0], rho * 0.6 - source[1], np.full(4, distance)], axis=-1)
    gradient, across = slopes(radius, source, targets)
    points, weights = opening_nodes(Circle(radius), FLAT, gradient, 1e-4, tilt=across if tilted else None)
    field = diffracted(points, weights, spherical(points, source), targets)
    finer, finer_weights = chord_rule(radius, int(0.6 * gradient * radius) + 60)
    expected = diffracted(finer, finer_weights, spherical(finer, source), targets)
    # The disc's integral relative to the unobstructed field 1/(2 L), with the factor 1/(lambda L^2) in front of it.
    scale = disc_scale(gradient * radius) * radius**2 / (WAVELENGTH * distance**2)
    assert np.max(np.abs(field - expected)) < 1e-4 * scale


def test_square_opening_in_the_fresnel_region():
    # Separable to 1e-3 here: Fresnel integrals give the field behind a square (Goodman, 3rd ed., Eq. (4-42)).
    half, distance = 0.25, 100.0
    x = np.array([0.0, 0.1, 0.25, 0.3])
    targets = np.stack([x, 0.4 * x, np.full(x.size, distance)], axis=-1)
    gradient = K * np.array([0.3 + half, 0.12 + half]) / distance
    points, weights = opening_nodes(Rectangle(half, half), FLAT, tuple(gradient), 1e-6)
    field = diffracted(points, weights, np.ones(points.size), targets)

    def side(u: np.ndarray) -> np.ndarray:
        scale = np.sqrt(2 / (WAVELENGTH * distance))
        s, c = np.array(fresnel(scale * (half - u))) + np.array(fresnel(scale * (half + u)))
        return (c + 1j * s) / np.sqrt(2)

    expected = np.exp(1j * K * distance) / 1j * side(targets[:, 0]) * side(targets[:, 1])
    # Phase and cosine beyond Fresnel's terms.
    paraxial = K * (2 * half) ** 4 / (8 * distance**3) + (0.6 / distance) ** 2
    assert np.max(np.abs(field - expected)) < 4 * paraxial + CLOSED_FORM_TOLERANCE


@pytest.mark.parametrize("distance", [20.0, 200.0])
def test_power_through_a_disc_arrives_behind_it(distance):
    radius, waist = 0.1, 0.04
    # A Gaussian beam that leaves 4e-6 of its power outside: hardly a tail of diffraction from the edge.
    reach = 4 * np.hypot(waist, WAVELENGTH * distance / (np.pi * waist))
    x, w = roots_legendre(120)
    r = reach * (x + 1) / 2
    targets = np.stack([r, 0 * r, np.full(r.size, distance)], axis=-1)
    points, weights = opening_nodes(Circle(radius), FLAT, K * (reach + radius) / distance, 1e-6)
    incident = np.exp(-(points.a**2 + points.b**2) / waist**2)
    sent = weights @ np.abs(incident) ** 2
    caught = reach / 2 * w @ (2 * np.pi * r * np.abs(diffracted(points, weights, incident, targets)) ** 2)
    # Flux is |U|^2 cos(chi), and the far field |U|^2 has cos^2(chi): off by the mean square angle, 2.5e-5, and the
    # edge's tail carries lambda L / (pi^2 R reach) of the intensity at the rim, below 1e-5.
    assert caught == pytest.approx(sent, rel=1e-4)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: opening_nodes(Circle(1.0), FLAT, -1.0, 1e-4), "phase gradient = -1.0 rad/mm"),
        (lambda: opening_nodes(Circle(1.0), FLAT, np.nan, 1e-4), "phase gradient = nan"),
        (lambda: opening_nodes(Circle(1.0), FLAT, 1.0, 0.0), "tolerance = 0.0"),
        (lambda: opening_nodes(Circle(1.0), FLAT, 1e6, 1e-4), "needs 1.25e"),
        (lambda: opening_nodes(Rectangle(1.0, 1.0), FLAT, 1e6, 1e-4), "too large"),
        (lambda: opening_nodes(Rectangle(1.0, 1.0), FLAT, 1.0, 1e-4, tilt=0.0), "only for a circle"),
        (lambda: star_nodes(lambda t: np.cos(t), FLAT, 1.0, 1e-4), "positive radius"),
        (lambda: star_nodes(lambda t: 1 + 0.5 * np.sign(np.sin(t)), FLAT, 1.0, 1e-6), "smooth curve"),
    ],
)
def test_what_cannot_be_summed_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
