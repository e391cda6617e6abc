"""Kinds of random scenes: each function builds a bench up to its last element and gives the detector's distance.

Here are openings in free space, lenses, plates and balls; ``mirror_ways`` has folds and curved mirrors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from reference_optics import Opening, edge_field_of
from reference_rays import Face, chief, trace
from stray_light import CLEAR


def _hole(b, low, high):
    """Half-widths of a round (mostly) or rectangular hole."""
    a = b.log(low, high)
    return (a,) if b.rng.random() < 0.75 else (a, a * b.between(0.6, 1.5))


# One opening in free space


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
    middle = [Face(second, axes, 1 / r2, 0, n1, n2, reach)]
    if gap:
        back = vertex + t1 * axes[:, 2]
        middle = [Face(back, axes, 1 / r2, 0, n1, 1.0, reach), Face(second, axes, 1 / r2, 0, 1.0, n2, reach)]
    b.meet([Face(vertex, axes, 1 / r1, 0, 1.0, n1, reach), *middle, Face(last, axes, 1 / r3, 0, n2, 1.0, reach)])
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
    radii = {"convex front": (r, 0.0), "flat front": (0.0, -r), "flat back": (r, 0.0), "convex back": (2 * r, -2 * r)}
    r1, r2 = radii[form]
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
    b.detector_half = 3 * 0.61 * b.wavelength * (distance + 1) / radius
    b.detector_tilt = 2.0
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
    b.detector_axes = axes @ np.diag([1.0, -1.0, -1.0])
    if gap:
        b.go(gap / (b.d @ axes[:, 2]))
    return 0.0


def ball(b, inside=None, outside=1.0):
    """A ball lens of given indices and a stop behind it."""
    radius = b.log(0.5, 10)
    n = inside or b.pick(1.45, 1.5168, 1.6)
    b.go(radius * b.log(0.2, 3))
    b.ball(radius, n, outside, b.rng.uniform(-0.1, 0.1, 2) * radius)
    b.go(b.between(0.03, 0.25) * radius)
    b.opening((b.between(0.02, 0.12) * radius,), tilt=5, decentre=0.4)
    return radius * b.between(2, 12)


def ball_water(b):
    """A ball lens in water."""
    b.index = 1.33
    return ball(b, b.pick(1.45, 1.5, 1.6), 1.33)
