"""Where a beam lights a surface of facets: the footprint on each, and the plane that stands for all of them."""

from __future__ import annotations

import numpy as np

from ..geometry.frames import Frame
from ..geometry.rotation import vectors_across
from .beam import Beam
from .facets import PARALLEL, Facets

_TIGHTENED = 2
"""Times that a box around an elliptical beam's footprint is made smaller by what the beam is in it."""

_RINGS, _SPOKES = 8, 16
"""Rays of equal power through the beam that the surface is looked at with: rings, and rays a ring."""

_FEWEST = 12
"""Rays that must meet the surface for a plane to be laid through it."""

_LINE = 0.05
"""Ratio of the lit surface's two sides below which it is a line, which tells no plane."""


def footprint_bounds(facets: Facets, beam: Beam, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Centre (f, 2) and half-widths (f, 2) [mm] of boxes around the beam's footprint in each facet's coordinates.

    Of a round beam the footprint is an ellipse, and the boxes are as small as they can be. Of an elliptical one, whose
    two radii change along the beam at two rates, they are those of the ellipse with the largest radii that the beam has
    anywhere on the facet. Infinite where the beam grazes the facet or opens along it.
    """
    modes = list(zip(beam.cutoffs, beam.inverse_parameters, strict=True))
    axes = frame.axes.T @ beam.axes
    offset = facets.origin - frame.to_local(beam.reference[None])[0]
    basis = np.stack([facets.e1, facets.e2], axis=-1)  # (f, 3, 2)
    if beam.is_round:
        return _within_cone(axes[:, 2], offset, basis, modes[:1])
    # A circle around the ellipse of radii X, Y: its squared radius X^2 + Y^2 is quadratic along the beam.
    centre, half = _within_cone(axes[:, 2], offset, basis, modes)
    for _ in range(_TIGHTENED):
        middle = (offset + np.einsum("fkc,fc->fk", basis, centre)) @ axes[:, 2]
        with np.errstate(invalid="ignore"):
            reach = np.sum(np.abs(np.einsum("k,fkc->fc", axes[:, 2], basis)) * half, axis=1)
            ends = middle + np.array([[-1], [1]]) * np.where(np.isfinite(reach), reach, 0)
        squares = [cutoff**2 * np.max(np.abs(1 + ends * parameter) ** 2, axis=0) for cutoff, parameter in modes]
        tighter = _within_cylinder(axes[:, :2], offset, basis, np.stack(squares, axis=1))
        tight = np.all(np.isfinite(half), axis=1, keepdims=True) & (tighter[1] < half)
        centre, half = np.where(tight, tighter[0], centre), np.where(tight, tighter[1], half)
    return centre, half


def _within_cone(
    axis: np.ndarray, offset: np.ndarray, basis: np.ndarray, modes: list[tuple[float, complex]]
) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half-widths of the box around the part of every facet's plane where p^2 - s^2 <= R(s)^2.

    p is a point counted from the beam's reference, s = p.b along the axis b, and R^2 the sum of R_0^2 |1 + s/q_0|^2
    over ``modes`` (R_0, 1/q_0). On the plane c + a e1 + b e2 that is (x - x_c)^T M (x - x_c) <= level with x = (a, b)
    and M = E^T (1 - (1 + R_0^2/|q_0|^2) b b^T) E; its bounding box has the half-widths sqrt(level diag(M^-1)). Where M
    is not positive definite, as the beam grazes the facet or opens along it, they are infinite.
    """
    along, start = np.einsum("k,fkc->fc", axis, basis), offset @ axis
    opening = sum((cutoff * abs(parameter)) ** 2 for cutoff, parameter in modes)
    metric = np.eye(2) - (1 + opening) * along[:, :, None] * along[:, None, :]
    # Half the gradient of p^2 - s^2 - R^2 |1 + s/q_0|^2 at x = 0, and its value there.
    slope = (1 + opening) * start + sum(cutoff**2 * parameter.real for cutoff, parameter in modes)
    right = np.einsum("fk,fkc->fc", offset, basis) - slope[:, None] * along
    across = np.sum((offset - start[:, None] * axis) ** 2, axis=1)
    value = across - sum(cutoff**2 * np.abs(1 + start * parameter) ** 2 for cutoff, parameter in modes)
    return _box(metric, right, value)


def _within_cylinder(
    across: np.ndarray, offset: np.ndarray, basis: np.ndarray, squares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same where x^2/X^2 + y^2/Y^2 <= 1, x and y along the columns of ``across``, (X^2, Y^2) ``squares`` (f, 2)."""
    slopes, start = np.einsum("kd,fkc->fdc", across, basis), offset @ across
    weighted = slopes / squares[:, :, None]
    metric = np.einsum("fdc,fde->fce", weighted, slopes)
    return _box(metric, np.einsum("fdc,fd->fc", weighted, start), np.sum(start**2 / squares, axis=1) - 1)


def _box(metric: np.ndarray, right: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half-widths (f, 2) of the box around x^T M x + 2 g.x + v <= 0: M (f, 2, 2), g (f, 2), v (f,)."""
    determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.stack([metric[:, 1, 1], metric[:, 0, 0]], axis=1) / determinant[:, None]
        crossed = -metric[:, 0, 1] / determinant
        centre = -(inverse * right + crossed[:, None] * right[:, ::-1])
        level = -value - np.einsum("fc,fc->f", right, centre)
        half = np.sqrt(np.maximum(level, 0.0)[:, None] * inverse)
    endless = (determinant < 1e-12 * np.trace(metric, axis1=1, axis2=2) ** 2 / 4)[:, None]
    return np.where(endless, 0.0, centre), np.where(endless, np.inf, half)


def mean_plane_normal(facets: Facets, beam: Beam, frame: Frame, spot: np.ndarray) -> np.ndarray | None:
    """Unit normal (3,) of the plane that fits the lit surface best with its frame at ``frame``, on the laser's side.

    Every place counts by the light's intensity on it; spot: (3,) where the beam's axis meets the surface [mm]. It is
    the plane that a pattern's displacement depends on: the pattern is where the change of path has least variance over
    what scatters. None where the beam has no width, or meets too little of the surface to tell.
    """
    if beam.is_uniform:
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
    radius = np.sqrt(-0.5 * np.log1p(-share))
    angle = 2 * np.pi / _SPOKES * (np.arange(_SPOKES) + 0.5 * (np.arange(_RINGS)[:, None] % 2))
    circle = radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    stretched = (beam.across.T * beam.radii_at(spot)) @ beam.across  # the ellipse of a circle, whatever its axes are
    return beam.origin + circle.reshape(-1, 2) @ vectors_across(beam.axis) @ stretched
