"""Fields of a point behind holes and plates, in closed form or as line integrals, written down independently."""

from __future__ import annotations

import numpy as np

from .scenes import WAVELENGTH

K = 2 * np.pi / WAVELENGTH

ROUND_EDGE_POINTS = 512
"""Least number of points on a hole's edge."""


def on_axis_integral(a: float, b: float, radius: float) -> complex:
    """First Rayleigh-Sommerfeld integral over a round hole, from ``a`` before it to ``b`` behind, on the axis."""
    turns = (np.hypot(a, radius) - a + np.hypot(b, radius) - b) / WAVELENGTH
    nodes, weights = np.polynomial.legendre.leggauss(16)
    edges = np.linspace(0.0, radius**2, int(2 * turns) + 3)
    half = np.diff(edges) / 2
    squared = (edges[:-1] + half)[:, None] + half[:, None] * nodes
    r1, r2 = np.sqrt(a * a + squared), np.sqrt(b * b + squared)
    phase = 2 * np.pi * (((r1 + r2) / WAVELENGTH) % 1.0)
    integrand = np.exp(1j * phase) / (r1 * r2) * (1 + 1j / (K * r2)) * b / r2 / (1j * WAVELENGTH)
    return complex(np.pi * np.sum(integrand * half[:, None] * weights))


def off_axis_field(a: float, b: float, radius: float, x: float) -> complex:
    """:func:`on_axis_integral` for a point ``x`` beside the axis, a hole of any size: the light's wave and its edge's.

    Kirchhoff's integral over a hole is the geometric wave and an integral along the edge (Maggi 1888, Rubinowicz 1917;
    Born and Wolf, Principles of Optics, 8.9); that of Rayleigh and Sommerfeld is the difference of Kirchhoff's for the
    point and for its mirror image in the screen, which the geometric wave does not reach.
    """
    count = int(4 * K * radius * x / b) + ROUND_EDGE_POINTS
    edges = _edge_wave(a, np.array([x, 0.0, b]), radius, count) - _edge_wave(a, np.array([x, 0.0, -b]), radius, count)
    lit = abs(x) * a / (a + b) < radius
    return complex(edges + (_wave(np.array([x, 0.0, a + b])) if lit else 0.0))


def _edge_wave(a: float, point: np.ndarray, radius: float, count: int) -> complex:
    """1/4 pi integral of e^{ik(r+s)}/(r s) (r x s).dl / (1 - r.s) along the edge, unit vectors r to, s from it."""
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    edge = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    along = np.stack([-np.sin(angle), np.cos(angle), np.zeros(count)], axis=1) * (2 * np.pi * radius / count)
    before, behind = edge + [0.0, 0.0, a], point - edge
    r = before / np.linalg.norm(before, axis=1, keepdims=True)
    s = behind / np.linalg.norm(behind, axis=1, keepdims=True)
    turning = np.sum(np.cross(r, s) * along, axis=1) / (1 - np.sum(r * s, axis=1))
    return complex(np.sum(_wave(before) * _wave(behind) * turning) / (4 * np.pi))


def _wave(offset: np.ndarray) -> np.ndarray:
    distance = np.linalg.norm(offset, axis=-1)
    return np.exp(2j * np.pi * ((distance / WAVELENGTH) % 1.0)) / distance


def through_plate(distance: float, thickness: float, index: float, rho: np.ndarray) -> np.ndarray:
    """Field of a point on the axis behind a plate across it, at distances rho (n,) from the axis, by Snell's law."""
    air = distance - thickness
    low, high = np.zeros_like(rho), np.ones_like(rho)
    for _ in range(200):  # sin(theta) by bisection
        sine = (low + high) / 2
        inside = sine / index
        reach = air * sine / np.sqrt(1 - sine**2) + thickness * inside / np.sqrt(1 - inside**2)
        low, high = np.where(reach < rho, sine, low), np.where(reach < rho, high, sine)
    cosine, inside = np.sqrt(1 - sine**2), np.sqrt(1 - (sine / index) ** 2)
    length = air / cosine + index * thickness / inside
    slope = air / cosine**2 + thickness * cosine / (index * inside**3)  # d rho / d theta
    ratio = np.where(rho > 1e-9, sine / np.maximum(rho, 1e-9), 1 / (air + thickness / index))
    return np.sqrt(ratio / (slope * cosine)) * np.exp(2j * np.pi * ((length / WAVELENGTH) % 1.0))
