"""Where a beam lights a surface of facets: the footprint on each, and the plane that stands for all of them."""

from __future__ import annotations

import numpy as np

from ..geometry.frames import Frame
from ..geometry.rotation import vectors_across
from .beam import Beam
from .facets import PARALLEL, Facets

_RINGS, _SPOKES = 8, 16
"""Rays of equal power through the beam that the surface is looked at with: rings, and rays a ring."""

_FEWEST = 12
"""Rays that must meet the surface for a plane to be laid through it."""

_LINE = 0.05
"""Ratio of the lit surface's two sides below which it is a line, which tells no plane."""


def footprint_bounds(facets: Facets, beam: Beam, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Centre (f, 2) and half-widths (f, 2) [mm] of the beam's elliptic footprint in each facet's coordinates.

    A point p, counted from the reference point and s = p.b along the axis b, lies in the beam where
    p^2 - s^2 <= R^2 |1 + s/q_0|^2, R the cutoff and q_0 the beam's complex parameter. On the plane c + a e1 + b e2 that
    is (x - x_c)^T M (x - x_c) <= level with x = (a, b) and M = E^T (1 - (1 + R^2/|q_0|^2) b b^T) E; its bounding box
    has the half-widths sqrt(level diag(M^-1)). Where M is not positive definite, as the beam grazes the facet or opens
    along it, they are infinite.
    """
    axis = frame.axes.T @ beam.axis
    offset = facets.origin - frame.to_local(beam.reference[None])[0]
    basis = np.stack([facets.e1, facets.e2], axis=-1)  # (f, 3, 2)
    along, start = np.einsum("k,fkc->fc", axis, basis), offset @ axis
    cutoff, parameter = beam.cutoff, beam.inverse_parameter
    opening = (cutoff * abs(parameter)) ** 2
    metric = np.eye(2) - (1 + opening) * along[:, :, None] * along[:, None, :]
    # Half the gradient of p^2 - s^2 - R^2 |1 + s/q_0|^2 at x = 0, and its value there.
    slope = (1 + opening) * start + cutoff**2 * parameter.real
    right = np.einsum("fk,fkc->fc", offset, basis) - slope[:, None] * along
    across = np.sum((offset - start[:, None] * axis) ** 2, axis=1)
    value = across - cutoff**2 * np.abs(1 + start * parameter) ** 2
    determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.stack([metric[:, 1, 1], metric[:, 0, 0]], axis=1) / determinant[:, None]
        crossed = -metric[:, 0, 1] / determinant
        centre = -(inverse * right + crossed[:, None] * right[:, ::-1])
        level = -value - np.einsum("fc,fc->f", right, centre)
        half = np.sqrt(np.maximum(level, 0.0)[:, None] * inverse)
    endless = (determinant < 1e-12)[:, None]
    return np.where(endless, 0.0, centre), np.where(endless, np.inf, half)


def mean_plane_normal(facets: Facets, beam: Beam, frame: Frame, spot: np.ndarray) -> np.ndarray | None:
    """Unit normal (3,) of the plane that fits the lit surface best with its frame at ``frame``, on the laser's side.

    Every place counts by the light's intensity on it; spot: (3,) where the beam's axis meets the surface [mm]. It is
    the plane that a pattern's displacement depends on: the pattern is where the change of path has least variance over
    what scatters. None where the beam has no width, or meets too little of the surface to tell.
    """
    if np.isinf(beam.radius):
        return None
    places, facet = facets.first_met_by(frame, _rays_of(beam, spot), beam.axis)
    places, facet = places[facet >= 0], facet[facet >= 0]
    facing = -facets.normal[facet] @ (frame.axes.T @ beam.axis)
    places, facing = places[facing > PARALLEL], facing[facing > PARALLEL]
    if len(places) < _FEWEST:
        return None
    # The rays carry equal power, and scatterers are spread over the surface: there are more where the light grazes.
    weight = 1 / facing
    offset = places - np.average(places, axis=0, weights=weight)
    extent, axes = np.linalg.eigh((offset * weight[:, None]).T @ offset)
    if extent[1] < _LINE**2 * extent[2]:
        return None
    return -axes[:, 0] * np.sign(axes[:, 0] @ beam.axis)


def _rays_of(beam: Beam, spot: np.ndarray) -> np.ndarray:
    """Origins (n, 3) of rays along the beam that carry equal shares of its power where it meets ``spot`` (3,)."""
    share = (np.arange(_RINGS) + 0.5) / _RINGS
    # Of a Gaussian beam the share 1 - exp(-2 r^2/w^2) lies within r.
    radius = beam.radius_at(spot) * np.sqrt(-0.5 * np.log1p(-share))
    angle = 2 * np.pi / _SPOKES * (np.arange(_SPOKES) + 0.5 * (np.arange(_RINGS)[:, None] % 2))
    circle = radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return beam.origin + circle.reshape(-1, 2) @ vectors_across(beam.axis)
