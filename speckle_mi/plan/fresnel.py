"""How far the wave of a straight edge reaches: Fresnel parameters, and how strong the wave is there."""

from __future__ import annotations

import numpy as np

_SHORTEST = 1e-9
"""Length [mm] below which two places count as this far apart."""


def fresnel_parameter(distance, length: float, wavelength: float):
    """v = d sqrt(2 / (lambda L)) at distances d [mm] from an edge, the wave of which has gone a length L [mm]."""
    return distance * np.sqrt(2 / (wavelength * max(length, _SHORTEST)))


def fresnel_distance(v: float, length: float, wavelength: float) -> float:
    """The distance d [mm] at which :func:`fresnel_parameter` is v."""
    return float(v * np.sqrt(wavelength * length / 2))


def edge_wave(v):
    """Amplitude 1/(pi sqrt(2) v) of a straight edge's wave over the light's, at most 1; 1 at the edge and beyond it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(v > 0, np.minimum(1.0, 1 / (np.pi * np.sqrt(2) * v)), 1.0)[()]
