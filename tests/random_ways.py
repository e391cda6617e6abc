"""Random scenes with elements, each with the field that independent optics finds on some of its pixels.

``scene(number)`` for 0 to COUNT - 1 is a pure function of its number and of SEED; the kinds take turns. What the reference
cannot tell (a focal line in an opening, several rays, too many nodes) or what has other light than stated is drawn
again. Sizes run from 1 um to 100 mm, distances from 0.1 mm to 10 m. Nothing here imports the product.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from optical_bench import (
    _CONDUCTOR,
    CLEAR,
    WAVELENGTHS,
    Bench,
    _blocked,
    _crosses,
    _finish,
    _floats,
    _other_ways,
    _shape,
    _stray,
)
from reference_optics import Face, NoReference, Opening, Way, chief, edge_field_of, frame_along, trace
from threadpoolctl import threadpool_limits

SEED = 20240611
"""Of all scenes; another one gives other scenes of the same kinds."""

COUNT = 300
ATTEMPTS = 400


def _bench(rng, polar=20.0, point=0.3):
    """A source near the target's middle and a chief ray up to ``polar`` [deg] from the normal."""
    source = np.array([*rng.uniform(-point, point, 2), 0.0])
    angle, azimuth = np.radians(rng.uniform(0, polar)), rng.uniform(0, 2 * np.pi)
    d = np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
    return Bench(rng, source, source.copy(), d, float(rng.choice(WAVELENGTHS)) * 1e-6)


def _hole(b, low, high):
    """Half-widths of a round (mostly) or rectangular hole."""
    a = b.log(low, high)
    return (a,) if b.rng.random() < 0.75 else (a, a * b.between(0.6, 1.5))


# One opening, free space and plane mirrors


def free_stop(b):
    """One stop in free space, off axis and tilted."""
    l1, l2 = b.log(5, 1000), b.log(5, 1000)
    b.go(l1)
    b.opening(_hole(b, 0.02, min(0.2 * l1, 5)), tilt=20, decentre=1.0)
    return l2


def pinhole_far(b):
    """A pinhole of 1 um to 1 mm up to 10 m away."""
    l1 = b.log(0.1, 1e4)
    b.go(l1)
    b.opening((b.log(5e-4, min(0.5, 0.2 * l1)),), tilt=5, decentre=0.3, outer=max(10.0, 0.02 * l1))
    return b.log(1.0, 3000)


def large_stop(b):
    """A stop of 20 to 100 mm several metres away."""
    b.go(b.log(1500, 9000))
    b.opening(_hole(b, 10, 50), tilt=3, decentre=0.5)
    return b.log(1500, 9000)


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


def _shield_all(b, mirrors, distance, half):
    """The source's direct light and that of other mirror sequences reach neither opening nor detector."""
    hole = b.openings[0].face.points(b.openings[0].samples())
    axes = frame_along(b.d)
    end = b.at + distance * b.d
    detector = end + np.array([[0, 0], [1, 1], [-1, 1], [1, -1], [-1, -1]]) @ (2.5 * half * axes[:, :2].T)
    b.path.append((b.at, end))
    room = max(1.0, 2 * b.openings[0].half[0])
    _stray(b, hole, room)
    _stray(b, detector, room)
    b.path.pop()
    _other_ways(b, mirrors, mirrors, [*hole, *detector])


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


# Several openings


def series(b):
    """Two stops, one behind the other, in free space."""
    l1 = b.log(3, 500)
    b.go(l1)
    fresnel = b.between(0.5, 8)
    l2 = b.log(3, 500)
    a = np.sqrt(fresnel * b.wavelength * l1 * l2 / (l1 + l2))
    b.opening((a,), tilt=8, decentre=0.4)
    b.go(l2)
    geometric = a * (l1 + l2) / l1
    b.opening((geometric * b.between(0.4, 1.5),), tilt=8, decentre=0.5)
    return b.log(3, 500)


def series_three(b):
    """Three stops in free space."""
    b.go(b.log(5, 100))
    a = b.log(0.03, 0.15)
    b.opening((a,), tilt=5, decentre=0.3)
    for _ in range(2):
        b.go(b.log(10, 100))
        b.opening((a * b.between(0.7, 2),), tilt=5, decentre=0.3)
    return b.log(10, 200)


def spatial_filter(b):
    """A stop, a lens, a pinhole at the image, a second lens."""
    f1, f2, n = b.log(15, 60), b.log(15, 60), 1.5168
    l1 = f1 * b.between(1.6, 4)
    image = 1 / (1 / f1 - 1 / l1)
    before = b.between(0.3, 0.85) * l1
    b.go(before)
    a = b.between(0.008, 0.03) * before
    b.opening((a,), decentre=0.1)
    b.go(l1 - before)
    _biconvex(b, f1, n, 2.5 * a * l1 / before / CLEAR + 6)
    b.go(image - 2)
    b.opening((b.between(0.4, 2.0) * 0.61 * b.wavelength * image / (a * l1 / before),))
    b.go(f2 * b.between(1.2, 2.5))
    _biconvex(b, f2, n, 14)
    return f2 * b.pick(0.4, 3.0) * b.between(0.8, 1.2)


# Lenses


def _biconvex(b, f, n, diameter, tilt=0.0, decentre=(0.0, 0.0)):
    r1 = 2 * (n - 1) * f * b.between(0.8, 1.6)
    r2 = -1 / (1 / ((n - 1) * f) - 1 / r1)
    sag = diameter**2 / 8 * (1 / abs(r1) + 1 / abs(r2))
    return b.lens(r1, r2, float(f"{1.2 * sag + 1:.3g}"), diameter, n, tilt, decentre)


def lens_stop(b):
    """A lens on the axis and a stop behind it."""
    f = b.log(10, 200)
    b.go(f * b.between(1.3, 4))
    _biconvex(b, f, b.pick(1.45, 1.5151, 1.7), b.between(0.3, 0.6) * f)
    b.go(b.between(0.05, 0.5) * f)
    b.opening(_hole(b, 0.01 * f, 0.05 * f), tilt=5, decentre=0.3)
    return f * b.between(0.2, 3)


def lens_decentred(b):
    """A lens hit off its axis and tilted, and a pinhole beside its axis."""
    f = b.log(10, 200)
    b.go(f * b.between(0.5, 4))
    _biconvex(b, f, b.pick(1.45, 1.5151, 1.7), 0.6 * f, tilt=6, decentre=b.rng.uniform(-0.12, 0.12, 2) * f)
    b.go(b.log(0.02, 0.5) * f)
    b.opening(_hole(b, 0.002 * f, 0.02 * f), tilt=8, decentre=0.5)
    return f * b.between(0.2, 3)


def lens_far(b):
    """A lens metres away and a stop behind it."""
    f = b.log(50, 500)
    b.go(b.log(1000, 9000))
    _biconvex(b, f, 1.5151, b.between(0.1, 0.3) * f, tilt=2)
    b.go(b.between(0.02, 0.3) * f)
    b.opening((b.log(0.005, 0.02) * f,), decentre=0.5)
    return f * b.between(0.5, 1.5)


def two_lenses(b):
    """Two lenses, decentred and tilted, with the stop between or behind them."""
    f1, f2 = b.log(20, 100), b.log(20, 100)
    between = b.rng.random() < 0.5
    small = 0.01 * min(f1, f2)
    b.go(f1 * b.between(0.6, 2))
    _biconvex(b, f1, 1.5151, 0.5 * f1, tilt=4, decentre=b.rng.uniform(-0.03, 0.03, 2) * f1)
    b.go(b.between(0.1, 0.4) * f1)
    if between:
        b.opening((b.between(0.5, 2) * small,), decentre=0.5)
        b.go(b.between(0.1, 0.6) * f1)
    _biconvex(b, f2, 1.62, 0.5 * f2, tilt=4, decentre=b.rng.uniform(-0.03, 0.03, 2) * f2)
    if not between:
        b.go(b.between(0.05, 0.4) * f2)
        b.opening((b.between(0.5, 2) * small,), decentre=0.5)
    return f2 * b.between(0.3, 2)


def thin_gap(b):
    """Two lenses 0 to 10 um apart (0: cemented) and a stop."""
    gap = b.pick(0.0, 0.0, 1e-5, 1e-4, 1e-3, 1e-2)
    f = b.log(20, 200)
    n1, n2 = 1.67003, 1.72825
    d = b.between(0.2, 0.4) * f
    r1, r2, r3 = 0.67 * f, -0.45 * f, -5.8 * f
    t1, t2 = (float(f"{x * f:.4g}") for x in (0.18, 0.05))
    b.go(b.pick(f * b.between(1.2, 4), b.log(300, 5000)))
    axes = b.axes(3)
    vertex = b.at + axes[:, :2] @ (b.rng.uniform(-0.02, 0.02, 2) * f)
    b.lens(r1, r2, t1, d, n1, axes=axes, front=vertex, meet=False)
    second = vertex + (t1 + gap) * axes[:, 2]
    b.lens(r2, r3, t2, d, n2, axes=axes, front=second, meet=False)
    reach = CLEAR * d / 2
    last = second + t2 * axes[:, 2]
    middle = [Face(vertex + t1 * axes[:, 2], axes, 1 / r2, 0, n1, 1.0, reach), Face(second, axes, 1 / r2, 0, 1.0, n2, reach)]
    if gap == 0:
        middle = [Face(second, axes, 1 / r2, 0, n1, n2, reach)]
    b._meet([Face(vertex, axes, 1 / r1, 0, 1.0, n1, reach), *middle, Face(last, axes, 1 / r3, 0, n2, 1.0, reach)])
    b.notes.append(f"gap {gap:g} mm")
    b.go(b.between(0.05, 0.4) * f)
    b.opening((b.between(0.01, 0.04) * f,), decentre=0.3)
    return f * b.between(0.4, 2)


def vertex_stop(b):
    """A stop at a lens's vertex, or a mask on its flat or convex back, 0 to 10 um apart."""
    gap = b.pick(0.0, 0.0, 1e-4, 1e-3, 1e-2)
    f, n = b.log(15, 150), 1.5168
    b.go(f * b.between(1.3, 4))
    r, d = (n - 1) * f, 0.5 * f
    t = float(f"{1.2 * d * d / 8 / r + 1:.3g}")
    a = (b.between(0.01, 0.04) * f,)
    form = b.pick("convex front", "flat front", "flat back", "convex back")
    axes = b.axes()
    b.notes.append(f"{form}, gap {gap:g} mm")
    r1, r2 = {"convex front": (r, 0.0), "flat front": (0.0, -r), "flat back": (r, 0.0), "convex back": (2 * r, -2 * r)}[form]
    if form.endswith("front"):
        b.opening(a, decentre=0.0, axes=axes, outer=d)
        if gap:
            b.go(gap)
        b.lens(r1, r2, t, d, n, axes=axes)
    else:
        b.lens(r1, r2, t, d, n, axes=axes)
        if gap:
            b.go(gap)
        b.opening(a, decentre=0.0, axes=axes, outer=d)
    return f * b.between(0.3, 3)


def bare_lens(b):
    """A lens alone that images the source: its rim is the pupil."""
    f, n = b.log(20, 100), 1.5151
    radius = b.between(0.03, 0.06) * f
    l1 = f * b.between(1.6, 4)
    b.go(l1)
    r = (n - 1) * f
    t = float(f"{1.2 * radius**2 / 2 / r + 0.6:.3g}")
    flat_first = b.rng.random() < 0.5
    axes = b.axes()
    _, _, faces = b.lens(*((0.0, -r) if flat_first else (r, 0.0)), t, 2 * radius, n, axes=axes, meet=False)
    front, back = (replace(x, reach=1.001 * radius) for x in faces)
    goal = replace(back, reach=1e9)
    marginal = chief(b.source, [replace(front, reach=1e9)], goal, (0.999 * radius, 0.0))
    hit = trace(b.source[None], marginal[None], [front])[0][0]
    outside = np.linalg.norm(((hit - front.vertex) @ axes)[:2]) > 0.999 * radius
    b.notes.append("front rim" if outside else "back rim")
    if outside:
        b.legs, b.openings = [[], [back]], [Opening(front, (radius,))]
    else:
        b.legs, b.openings = [[front], []], [Opening(back, (radius,))]
    p, d, _, _ = trace(b.source[None], b.d[None], faces)
    b.at, b.d = p[0], d[0]
    image = 1 / (1 / f - 1 / l1)
    distance = image * b.between(0.985, 1.01)
    # The light beside the lens is diffracted at the rim as well; it is no part of the reference.
    rim = Opening(Face(front.vertex + t / 2 * axes[:, 2], axes), (radius,))
    end = b.at + distance * b.d + 0.05 * radius * axes[:, 0]
    through = edge_field_of(b.source, rim, end[None], b.wavelength)[0][0]
    span = np.linalg.norm(end - b.source)
    b.beside = abs(np.exp(2j * np.pi / b.wavelength * span) / span - through)
    b.extra_error += 1e-4
    return distance


# Plates and balls


def plate_free(b):
    """A tilted plate between stop and detector."""
    b.go(b.log(5, 200))
    b.opening(_hole(b, 0.05, 0.5), decentre=0.5)
    b.go(b.log(2, 100))
    b.plate(b.log(0.3, 10), 15, b.pick(1.5, 1.52), tilt=25)
    return b.log(2, 100)


def plate_on_target(b):
    """A plate that touches the target (or nearly), then a stop."""
    gap, t, half = b.pick(0.0, 0.0, 1e-3, 1e-2), b.log(0.3, 5), 12.0
    n = b.pick(1.5, 1.52)
    b.notes.append(f"gap {gap:g} mm")
    axes = np.eye(3)
    front = np.array([0.0, 0.0, gap])
    if gap:
        b.go(gap / b.d[2])
    b.plate(t, half, n, axes=axes, middle=front)
    b.go(b.log(10, 100))
    b.opening(_hole(b, 0.05, 0.5), tilt=5, decentre=0.5)
    return b.log(10, 200)


def plate_on_detector(b):
    """A stop, then a window that touches the detector (or nearly)."""
    gap, t = b.pick(0.0, 0.0, 2e-4, 1e-3, 1e-2), b.log(0.3, 3)
    b.notes.append(f"gap {gap:g} mm")
    b.go(b.log(10, 200))
    b.opening(_hole(b, 0.05, 0.5), tilt=5, decentre=0.5)
    b.go(b.log(10, 200))
    axes = b.axes(5)
    b.plate(t, 12.0, b.pick(1.5, 1.52), axes=axes)
    b.final_axes = axes @ np.diag([1.0, -1.0, -1.0])
    if gap:
        b.go(gap / (b.d @ axes[:, 2]))
    return 0.0


def ball(b, inside=None, outside=1.0):
    """A ball lens of given indices and a stop behind it."""
    radius = b.log(0.5, 10)
    n = inside or b.pick(1.45, 1.5168, 1.6)
    b.go(radius * b.log(0.5, 5))
    b.ball(radius, n, outside, b.rng.uniform(-0.1, 0.1, 2) * radius)
    b.go(b.between(0.03, 0.4) * radius)
    b.opening((b.between(0.02, 0.12) * radius,), tilt=5, decentre=0.4)
    return radius * b.between(2, 12)


def ball_water(b):
    """A ball lens in water."""
    b.index = 1.33
    return ball(b, b.pick(1.45, 1.5, 1.6), 1.33)


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
    _shield_all(b, mirrors, distance, _detector_half(b, distance))
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
    end = b.at + distance * b.d
    axes = frame_along(b.d)
    half = _detector_half(b, distance) * 3
    targets = end + np.array([[0, 0], [1, 1], [-1, 1], [1, -1], [-1, -1]]) @ (half * axes[:, :2].T)
    b.path.append((b.at, end))
    _stray(b, targets, 1.0)
    b.path.pop()
    return distance


def two_ways_curved(b):
    """A stop and a convex sphere that folds the light back meet the light of another stop: the sign between them."""
    distance = _stop_then_curved(b, True, False)
    end = b.at + distance * b.d
    line = end - b.source
    span = np.linalg.norm(line)
    direct = line / span
    if direct[2] < 0.2 or direct @ b.d > 0.9:
        raise NoReference("the direct light comes too flat")
    stop = b.source + b.between(0.35, 0.7) * line
    axes = frame_along(direct, b.rng.normal(size=3))
    amplitude = 1.0
    hole = b.openings[0].half[0] * b.between(0.3, 1.5)
    outer = b.between(9, 15)
    screen = (stop, axes, (outer + 1,), None)
    if any(_crosses(p, q, screen) for p, q in [*b.path, (b.at, end)]) or _blocked(b, b.source, end):
        raise NoReference("the second stop is in the way")
    b.xml.append(_shape("aperture", b.name("stop"), stop, axes, _floats(radius=hole, outer_radius=outer)))
    b.second = Way(b.source, [[], []], [Opening(Face(stop, axes), (hole,))], None, b.index, amplitude)
    # The detector faces between the two.
    b.final_direction = (b.d + direct) / np.linalg.norm(b.d + direct)
    return distance


def sphere_inside(b):
    """Source and detector inside a metal sphere: its concave side; a screen takes what comes back further down."""
    radius = b.log(30, 300)
    b.source = np.array([*b.rng.uniform(-0.03, 0.03, 2), 0.02]) * radius
    centre = np.array([*b.rng.uniform(-0.05, 0.05, 2), b.between(0, 0.1)]) * radius
    b.xml.append(_shape("sphere", b.name("sphere"), centre, np.eye(3), _CONDUCTOR, (radius,) * 3))
    b.baffle(np.array([0.0, 0.0, -0.01 * radius]), np.array([0.0, 0.0, 1.0]), 1.5 * radius)
    b.at = b.source.copy()
    b.d = b.turned(0, 15)
    b._meet([Face(centre + radius * np.array([0, 0, 1.0]), np.diag([1.0, -1.0, -1.0]), 1 / radius, 0.0, 1.0, None,
                  0.9 * radius)])
    b.plain = 0.01 * radius
    b.extra_error += 1e-5
    return radius * b.between(0.2, 0.7)


KINDS = {
    kind.__name__: kind
    for kind in (
        free_stop, pinhole_far, large_stop, fold, fold_two, series, series_three, spatial_filter, lens_stop,
        lens_decentred, lens_far, two_lenses, thin_gap, vertex_stop, bare_lens, plate_free, plate_on_target,
        plate_on_detector, ball, ball_water, convex_sphere, convex_mirror, concave_mirror, curved_behind_stop,
        two_ways_curved, sphere_inside,
    )
}
"""Name to function; scene ``number`` is of the kind ``number`` modulo their count."""


def kind_of(number: int) -> str:
    return list(KINDS)[number % len(KINDS)]


def numbers_of(kinds, count=COUNT):
    """The numbers below ``count`` of scenes of the given kinds."""
    return [number for number in range(count) if kind_of(number) in kinds]


def scene(number: int):
    """Scene ``number`` with its reference field."""
    kind = kind_of(number)
    reasons = {}
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([SEED, number, attempt])
        try:
            with np.errstate(all="ignore"), threadpool_limits(limits=1):  # small matrices: threads only wait
                return _drawn(number, kind, rng)
        except NoReference as reason:
            words = str(reason).split(":")[0].rstrip("0123456789.e-+ ")
            reasons[words] = reasons.get(words, 0) + 1
    raise RuntimeError(f"scene {number} ({kind}): none of {ATTEMPTS} draws can be judged: {reasons}")


def _drawn(number, kind, rng):
    b = _bench(rng, *{"pinhole_far": (20.0, 0.01), "ball": (20.0, 0.02), "ball_water": (20.0, 0.02)}.get(kind, ()))
    b.final_axes = b.final_direction = b.second = b.plain = None
    distance = KINDS[kind](b)
    options = {}
    if kind == "plate_on_detector":
        options = {"axes": b.final_axes, "shift": 0.3}
    if kind == "two_ways_curved":
        options = {"axes": frame_along(-b.final_direction, rng.normal(size=3)), "extra_ways": (b.second,)}
    if kind == "bare_lens":
        b_half = 3 * 0.61 * b.wavelength * (distance + 1) / b.openings[0].half[0]
        options = {"spread": b_half, "tilt": 2.0}
    if kind == "sphere_inside":
        options = {"spread": b.plain}
    return _finish(number, kind, b, distance, **options)
