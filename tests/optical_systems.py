"""Lenses, mirrors and fans of rays that the tests of tracing and of aiming share, and how exact both have to be."""

from __future__ import annotations

import mpmath
import numpy as np

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface

WAVELENGTH = 632.8e-6  # mm
PATH_TOLERANCE = 1e-7 * WAVELENGTH  # mm; about 500 units in the last place of a 0.2 m path
INDEX = 1.5151


def frame(z: float = 0.0, x: float = 0.0, y: float = 0.0, rotation=(0.0, 0.0, 0.0)) -> Frame:
    return Frame(np.array([x, y, z]), rotation_matrix(np.array(rotation)))


def plane(z: float, **kwargs) -> Interaction:
    return Interaction.through(Surface(frame(z, **kwargs)))


def lens(
    z: float,
    c1: float,
    c2: float,
    thickness: float,
    k1: float = 0.0,
    k2: float = 0.0,
    index: float = INDEX,
    rotation=(0.0, 0.0, 0.0),
):
    """Refractions at the two surfaces of a lens, front vertex at z, turned about it."""
    front = frame(z, rotation=rotation)
    back = Frame(front.to_world(np.array([[0.0, 0.0, thickness]]))[0], front.axes)
    return (
        Interaction.refract(Surface(front, c1, k1), 1.0, index),
        Interaction.refract(Surface(back, c2, k2), index, 1.0),
    )


def ball(z: float, radius: float, index: float = INDEX):
    sphere = Surface.sphere(np.array([0.0, 0.0, z]), radius)
    return (Interaction.refract(sphere, 1.0, index, root="near"), Interaction.refract(sphere, index, 1.0, root="far"))


SYSTEMS = {
    "biconvex": (*lens(60.0, 0.02, -0.02, 5.0), plane(100.0)),
    "plano-convex": (*lens(60.0, 0.0, -0.04, 4.0), plane(100.0)),
    "convex-plano": (*lens(60.0, 0.04, 0.0, 4.0), plane(100.0)),
    "asphere": (*lens(60.0, 0.05, 0.0, 5.0, k1=-0.6), plane(100.0)),
    "asphere reversed": (*lens(60.0, 0.0, -0.05, 5.0, k2=-2.3), plane(100.0)),
    "paraboloid": (*lens(60.0, 0.05, 0.0, 5.0, k1=-1.0), plane(100.0)),
    "oblate": (*lens(60.0, 0.03, -0.01, 5.0, k1=1.5, k2=0.4), plane(100.0)),
    "meniscus tilted": (
        *lens(60.0, 0.03, 0.02, 3.0, rotation=(0.1, -0.2, 0.3)),
        plane(100.0, rotation=(0.2, 0.1, 0.0)),
    ),
    "ball": (*ball(60.0, 10.0), plane(100.0)),
    "two lenses": (*lens(50.0, 0.02, -0.02, 5.0), *lens(70.0, 0.03, 0.0, 5.0, k1=-0.7), plane(100.0)),
    "concave mirror": (Interaction.reflect(Surface(frame(80.0, rotation=(0.1, 0.05, 0.0)), -0.01)), plane(5.0)),
}


def mp_trace(sequence: Sequence, origin, direction):
    """Path, last point and direction in 30 digits, by the textbook quadratic and the vector form of Snell's law."""
    with mpmath.workdps(30):
        mp, vector = mpmath.mpf, lambda a: mpmath.matrix([mpmath.mpf(float(x)) for x in a])
        dot = lambda a, b: mpmath.fsum(x * y for x, y in zip(a, b))  # noqa: E731
        p, d = vector(origin), vector(direction)
        d = d / mpmath.sqrt(dot(d, d))
        path = mp(0)
        for one in sequence.interactions:
            axes = mpmath.matrix([[mpmath.mpf(float(x)) for x in row] for row in one.surface.frame.axes])
            vertex, c, g = vector(one.surface.frame.origin), mp(one.surface.curvature), 1 + mp(one.surface.conic)
            lp, ld = axes.T * (p - vertex), axes.T * d
            qa = c * (ld[0] ** 2 + ld[1] ** 2 + g * ld[2] ** 2)
            qb = c * (lp[0] * ld[0] + lp[1] * ld[1] + g * lp[2] * ld[2]) - ld[2]
            qc = c * (lp[0] ** 2 + lp[1] ** 2 + g * lp[2] ** 2) - 2 * lp[2]
            if qa == 0:
                t = -qc / (2 * qb)
            else:
                roots = sorted([(-qb - mpmath.sqrt(qb**2 - qa * qc)) / qa, (-qb + mpmath.sqrt(qb**2 - qa * qc)) / qa])
                if one.root == "vertex":
                    t = min(roots, key=lambda root: abs(lp[2] + root * ld[2]))
                else:
                    t = roots[0] if one.root == "near" else roots[1]
            h = lp + t * ld
            path += mp(one.index_before) * t
            normal = mpmath.matrix([c * h[0], c * h[1], c * g * h[2] - 1])
            normal = normal / mpmath.sqrt(dot(normal, normal))
            if dot(normal, ld) > 0:
                normal = -normal
            cosine = -dot(normal, ld)
            if one.action == "refract":
                eta = mp(one.index_before) / mp(one.index_after)
                ld = eta * ld + (eta * cosine - mpmath.sqrt(1 - eta**2 * (1 - cosine**2))) * normal
            elif one.action == "reflect":
                ld = ld + 2 * cosine * normal
            p, d = vertex + axes * h, axes * ld
        as_float = lambda a: np.array([float(x) for x in a])  # noqa: E731
        return float(path), as_float(p), as_float(d)
