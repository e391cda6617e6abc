"""Rays through lenses in 40 digits, from the numbers of a prescription alone, for the tests to judge the product by.

A lens is a list of surfaces, each a dictionary of ``radius``, ``conic``, ``aspheric`` (coefficients of r^4, r^6, ...),
``form``, and ``after``: (thickness, index) of what follows. Every surface is met by Newton's method on its height.
"""

from __future__ import annotations

from collections.abc import Sequence

import mpmath
from mpmath import mpf

DIGITS = 40


def sag(surface: dict, x, y):
    """Height of a surface at x, y, and its two slopes, in mpmath numbers."""
    radius, conic = mpf(surface.get("radius", 0)), mpf(surface.get("conic", 0))
    form = surface.get("form", "rotational")
    s = {"rotational": x * x + y * y, "cylinder_x": x * x, "cylinder_y": y * y}[form]
    c = 1 / radius if radius else mpf(0)
    root = mpmath.sqrt(1 - (1 + conic) * c * c * s)
    height = c * s / (1 + root)
    by_s = c / (2 * root)
    for number, a in enumerate(surface.get("aspheric", ()), start=2):
        height += mpf(a) * s**number
        by_s += number * mpf(a) * s ** (number - 1)
    return height, (2 * x * by_s if form != "cylinder_y" else mpf(0)), (2 * y * by_s if form != "cylinder_x" else mpf(0))


def path(surfaces: Sequence[dict], origin, direction, front: float, end: float):
    """(optical path, (x, y)) of a ray from ``origin`` along ``direction`` to the plane z = end.

    front: height of the first vertex, axis along z.
    """
    with mpmath.workdps(DIGITS):
        p, d = [mpf(float(v)) for v in origin], [mpf(float(v)) for v in direction]
        size = mpmath.sqrt(sum(v * v for v in d))
        d = [v / size for v in d]
        length, index, z = mpf(0), mpf(1), mpf(float(front))
        for surface in surfaces:
            t = (z - p[2]) / d[2]
            for _ in range(60):
                x, y = p[0] + t * d[0], p[1] + t * d[1]
                height, by_x, by_y = sag(surface, x, y)
                step = (p[2] + t * d[2] - z - height) / (d[2] - by_x * d[0] - by_y * d[1])
                t -= step
                if abs(step) < mpf(10) ** (5 - DIGITS):
                    break
            p = [a + t * b for a, b in zip(p, d, strict=True)]
            length += index * t
            _, by_x, by_y = sag(surface, p[0], p[1])
            size = mpmath.sqrt(1 + by_x**2 + by_y**2)
            normal = [-by_x / size, -by_y / size, 1 / size]
            thickness, behind = surface.get("after", (0, 1))
            eta = index / mpf(behind)
            u = sum(a * b for a, b in zip(normal, d, strict=True))
            w = mpmath.sqrt(1 - eta**2 * (1 - u * u))
            d = [eta * a + (w - eta * u) * n for a, n in zip(d, normal, strict=True)]
            index, z = mpf(behind), z + mpf(thickness)
        t = (mpf(float(end)) - p[2]) / d[2]
        return length + index * t, (float(p[0] + t * d[0]), float(p[1] + t * d[1]))


def with_index(surfaces: Sequence[dict], index: float) -> list[dict]:
    """The same lens of glass of an index."""
    return [one | ({"after": (one["after"][0], index)} if "after" in one else {}) for one in surfaces]


def reversed_lens(surfaces: Sequence[dict]) -> list[dict]:
    """The same lens turned round."""
    gaps = [surface["after"] for surface in surfaces[:-1]][::-1] + [(0, 1)]
    return [
        surface | {"radius": -surface.get("radius", 0), "after": gap,
                   "aspheric": [-a for a in surface.get("aspheric", ())]}
        for surface, gap in zip(surfaces[::-1], gaps, strict=True)
    ]  # fmt: skip


def focal_length(surfaces: Sequence[dict]) -> float:
    """Paraxial focal length, by the rays' matrices, of a lens in air."""
    with mpmath.workdps(DIGITS):
        system, index = mpmath.eye(2), mpf(1)
        for surface in surfaces:
            thickness, behind = surface.get("after", (0, 1))
            radius = mpf(surface.get("radius", 0))
            power = (mpf(behind) - index) / radius if radius else mpf(0)
            index = mpf(behind)
            system = mpmath.matrix([[1, mpf(thickness) / index], [0, 1]]) * mpmath.matrix([[1, 0], [-power, 1]]) * system
        return float(-1 / system[1, 0])


def parameters_of(surfaces: Sequence[dict]) -> dict[str, float | str]:
    """The numbers as a scene names them."""
    values: dict[str, float | str] = {}
    for number, surface in enumerate(surfaces, start=1):
        values[f"radius{number}"] = float(surface.get("radius", 0))
        values[f"conic{number}"] = float(surface.get("conic", 0))
        if surface.get("aspheric"):
            values[f"aspheric{number}"] = ", ".join(repr(float(a)) for a in surface["aspheric"])
        if surface.get("form"):
            values[f"form{number}"] = surface["form"]
        if number < len(surfaces):
            values[f"thickness{number}"], values[f"ior{number}"] = map(float, surface["after"])
    return values
