"""Kinds of random scenes with mirrors, plane ones that fold the light and curved ones; see ``way_kinds``."""

from __future__ import annotations

import numpy as np
from optical_bench import CONDUCTOR, WIDEST, floats, shape
from reference_optics import Opening, Way
from reference_rays import Face, NoReference, frame_along
from stray_light import blocked, crosses, refuse_other_ways, shade, shade_over


def _fold(b, count):
    before = b.log(8, 400)
    b.go(before)
    mirrors = []
    for i in range(count):
        half = b.log(5, 40)
        b.plane_mirror(b.turned(60, 120), half, b.rng.uniform(-0.55, 0.55, 2) * half)
        mirrors.append(b.legs[0][-1])
        b.go(b.log(10, 200))
    return mirrors


def _shield_detector(b, distance, half, room, *others):
    """Shields a detector (of a half-width) from the direct light, other places before it; returns its places (5, 3)."""
    axes = frame_along(b.d)
    end = b.at + distance * b.d
    detector = end + np.array([[0, 0], [1, 1], [-1, 1], [1, -1], [-1, -1]]) @ (half * axes[:, :2].T)
    b.path.append((b.at, end))
    for places in (*others, detector):
        shade(b, places, room)
    b.path.pop()
    return detector


def _shield_all(b, mirrors, distance, half):
    """The source's direct light and that of other mirror sequences reach neither opening nor detector."""
    hole = b.openings[0].face.points(b.openings[0].samples())
    detector = _shield_detector(b, distance, 2.5 * half, max(1.0, 2 * b.openings[0].half[0]), hole)
    refuse_other_ways(b, mirrors, mirrors, [*hole, *detector])


def _detector_half(b, distance):
    onward = sum(np.linalg.norm(q - p) for p, q in b.path)
    a = max(b.openings[0].half)
    return max(a * (1 + distance / onward), 0.5 * b.wavelength * distance / min(b.openings[0].half))


def fold(b, count=1):
    """A plane mirror hit off its middle, then a pinhole."""
    mirrors = _fold(b, count)
    b.opening((b.log(0.01, 1.5),), tilt=8, decentre=0.5, outer=b.between(9, 15))
    distance = b.log(10, 400)
    _shield_all(b, mirrors, distance, _detector_half(b, distance))
    return distance


def fold_two(b):
    """Two plane mirrors, then a pinhole."""
    return fold(b, 2)


# Curved mirrors


def _curved_fold(b, sphere, concave):
    f = b.log(15, 300)
    radius, half = 2 * f, b.between(0.15, 0.3) * 2 * f
    d_out = b.turned(60, 140)
    if sphere:
        b.conductor_sphere(d_out, radius)
        return
    conic, off = b.pick((0.0, 0.0), (0.0, 0.0), (-1.0, 0.0), (-1.0, 1.0), (-0.5, 0.0))
    off = off * b.between(0.5, 1.0) * half
    b.curved_mirror(d_out, radius if concave else -radius, conic, 2 * half, off, b.rng.uniform(-0.25, 0.25, 2) * half,
                    flip=b.rng.random() < 0.3)
    b.notes.append(f"radius {radius if concave else -radius:.3g}, conic {conic:g}, off-axis {off:.3g} mm")


def _curved_then_stop(b, sphere, concave):
    b.go(b.log(10, 200))
    _curved_fold(b, sphere, concave)
    mirrors = list(b.legs[0])
    b.go(b.log(8, 150))
    b.opening((b.log(0.02, 1.0),), tilt=5, decentre=0.5, outer=b.between(9, 15))
    distance = b.log(10, 200)
    half = _detector_half(b, distance)
    _shield_all(b, mirrors, distance, half)
    end = b.at + distance * b.d
    b.path.append((b.at, end))
    shade_over(b, b.at, mirrors, end, 2.5 * min(half, WIDEST))
    b.path.pop()
    return distance


def convex_sphere(b):
    """The outside of a metal sphere, then a stop."""
    return _curved_then_stop(b, True, False)


def convex_mirror(b):
    """A convex `mirror`, then a stop."""
    return _curved_then_stop(b, False, False)


def concave_mirror(b):
    """A concave `mirror`, spherical, conic or off-axis, then a stop."""
    return _curved_then_stop(b, False, True)


def _stop_then_curved(b, sphere, concave):
    """A stop, then a curved mirror that folds the light to the detector."""
    b.go(b.log(8, 100))
    b.opening((b.log(0.05, 0.6),), tilt=5, decentre=0.5, outer=b.between(9, 15))
    b.go(b.log(12, 150))
    _curved_fold(b, sphere, concave)
    return b.log(15, 200)


def curved_behind_stop(b):
    """A stop, then a convex sphere or `mirror` that folds the light back."""
    distance = _stop_then_curved(b, b.rng.random() < 0.6, b.rng.random() < 0.3)
    _shield_detector(b, distance, _detector_half(b, distance) * 3, 1.0)
    return distance


def two_ways_curved(b):
    """A stop and a convex sphere that folds the light back meet the light of another stop: the sign between them."""
    distance = _stop_then_curved(b, True, False)
    end = b.at + distance * b.d
    line = end - b.source
    span = np.linalg.norm(line)
    direct = line / span
    if direct[2] < 0.2 or not -0.7 < direct @ b.d < 0.9:
        raise NoReference("the two lights come from too far apart or too near each other")
    stop = b.source + b.between(0.35, 0.7) * line
    axes = frame_along(direct, b.rng.normal(size=3))
    hole = b.openings[0].half[0] * b.between(0.3, 1.5)
    outer = b.between(9, 15)
    screen = (stop, axes, (outer + 1,), None)
    if any(crosses(p, q, screen) for p, q in [*b.path, (b.at, end)]) or blocked(b, b.source, end):
        raise NoReference("the second stop is in the way")
    b.xml.append(shape("aperture", b.name("stop"), stop, axes, floats(radius=hole, outer_radius=outer)))
    b.other_ways.append(Way(b.source, [[], []], [Opening(Face(stop, axes), (hole,))], None, b.index))
    sphere, first = b.legs[1], b.openings[0].face.vertex
    b.detector_half = min(_detector_half(b, distance), 1.5)
    room = 2.5 * b.detector_half + hole
    b.path += [(b.source, stop), (stop, end), (b.at, end)]
    shade_over(b, first, [], end, room)
    shade_over(b, first, [], stop, room)
    shade_over(b, stop, sphere, end, room)
    shade_over(b, b.source, sphere, stop, room)
    del b.path[-3:]
    # The detector faces between the two.
    b.detector_axes = frame_along(-(b.d + direct), b.rng.normal(size=3))
    return distance


def sphere_inside(b):
    """Source and detector inside a metal sphere: its concave side; a screen takes what comes back further down."""
    radius = b.log(30, 300)
    b.source = np.array([*b.rng.uniform(-0.03, 0.03, 2), 0.02]) * radius
    centre = np.array([*b.rng.uniform(-0.05, 0.05, 2), b.between(0, 0.1)]) * radius
    b.xml.append(shape("sphere", b.name("sphere"), centre, np.eye(3), CONDUCTOR, (radius,) * 3))
    b.baffle(np.array([0.0, 0.0, -0.01 * radius]), np.array([0.0, 0.0, 1.0]), 1.5 * radius)
    b.at = b.source.copy()
    b.d = b.turned(0, 15)
    b.meet([Face(centre + radius * np.array([0, 0, 1.0]), np.diag([1.0, -1.0, -1.0]), 1 / radius, 0.0, 1.0, None,
                  0.9 * radius)])
    b.detector_half = 0.01 * radius
    b.extra_error += 1e-5
    return radius * b.between(0.2, 0.7)
