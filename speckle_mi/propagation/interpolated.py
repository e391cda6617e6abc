"""A slow path (traced through lenses) replaced by its Chebyshev series on a source box and a target rectangle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.plane import PlaneGrid, PlanePoints
from .area import Area
from .chebyshev import TensorSeries, axis_tails, tensor_coefficients, tensor_nodes
from .paths import Path
from .source_box import SourceBox

FIRST_ORDERS = (5, 5, 2, 5, 5)
"""Nodes tried first: three dimensions of the source box, two sides of the target."""

LARGEST_TABLE = 200_000
"""Node pairs beyond which the path is too rough, or the box too large, to be interpolated."""

CHECKED_PAIRS = 32
"""Random pairs on which the series is compared with the path."""

CHECK_SEED = 3
"""Seed of these pairs."""


@dataclass(frozen=True)
class InterpolatedPath:
    """Path given by series: calling it gives length and amplitude like any other path.

    source_index: which source polynomials the columns of ``target_series`` multiply; the columns hold length, real and
    imaginary part of the amplitude, one after the other. error: largest difference from the path itself that was found,
    in phase [rad] or relative amplitude.
    """

    box: SourceBox
    target: PlaneGrid | PlanePoints
    rectangle: Area
    source_index: np.ndarray
    target_series: TensorSeries
    real: bool
    error: float = np.inf

    def __call__(self, sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Length (n, m) [mm] and amplitude (n, m) between sources (n, 3) and points (m, 3) of the target's plane."""
        offset = targets - self.target.origin
        at = self.rectangle.unit_places(offset @ self.target.u, offset @ self.target.v)
        x = self.box.to_local(sources)
        parts = 2 if self.real else 3
        there = np.moveaxis(self.target_series(at).reshape(len(at), 3, -1)[:, :parts], 1, 0)
        series = TensorSeries(self.source_index, there.reshape(parts * len(at), -1).T)
        length, *amplitude = np.split(series(x), parts, axis=1)
        return length, amplitude[0] if self.real else amplitude[0] + 1j * amplitude[1]


def interpolated(
    path: Path, box: SourceBox, target: PlaneGrid | PlanePoints, wavelength: float, tolerance: float
) -> InterpolatedPath | None:
    """Series of the path to ``tolerance`` in phase [rad] and relative amplitude; None where it takes too many nodes."""
    rectangle = Area.around(target)
    sides = (rectangle.a, rectangle.b)
    orders = [order if half > 0 else 1 for order, half in zip(FIRST_ORDERS, box.half, strict=False)]
    orders += [order if side[1] > side[0] else 1 for order, side in zip(FIRST_ORDERS[3:], sides, strict=True)]
    while np.prod(orders) <= LARGEST_TABLE:
        source_orders = tuple(orders[:3])
        nodes, places = tensor_nodes(source_orders), tensor_nodes(tuple(orders[3:]))
        length, amplitude = path(box.to_world(nodes), rectangle.points(target, places).points())
        values = np.stack([length, amplitude.real, amplitude.imag], axis=-1)
        # One tensor over source and target dimensions.
        tensor = tensor_coefficients(values.reshape(-1, 3), tuple(orders))
        scale = 2 * np.pi / wavelength
        phase = axis_tails(tensor[..., :1], last=1) * np.linalg.norm(tensor[..., 0]) * scale
        tails = np.maximum(phase, axis_tails(tensor[..., 1:], last=1))
        failing = [axis for axis in range(5) if tails[axis] > tolerance]
        if not failing:
            by_source = tensor.reshape(-1, orders[3], orders[4], 3)
            index = np.stack(np.unravel_index(np.arange(len(nodes)), source_orders), axis=1)
            keep = _significant(by_source, scale, tolerance)
            columns = np.moveaxis(by_source[keep], (3, 0), (2, 3)).reshape(orders[3], orders[4], -1)
            series = TensorSeries.pruned(columns, 0.0)
            found = InterpolatedPath(box, target, rectangle, index[keep], series, not np.iscomplexobj(amplitude))
            error = _difference(found, path, wavelength)
            if error < 10 * tolerance:
                return replace(found, error=error)
            failing = [axis for axis in range(5) if orders[axis] > 1]
        for axis in failing:
            orders[axis] += 2
    return None


def _significant(by_source: np.ndarray, scale: float, tolerance: float) -> np.ndarray:
    """Source polynomials that change phase or amplitude by more than a hundredth of the tolerance somewhere."""
    largest = np.abs(by_source).sum(axis=(1, 2))
    relative = largest[:, 1:].max(axis=1) / largest[:, 1:].max()
    return (largest[:, 0] * scale > 0.01 * tolerance) | (relative > 0.01 * tolerance)


def _difference(found: InterpolatedPath, path: Path, wavelength: float) -> float:
    """Largest difference in phase [rad] or relative amplitude on random pairs."""
    random = np.random.default_rng(CHECK_SEED)
    sources = found.box.to_world(random.uniform(-1, 1, (CHECKED_PAIRS, 3)))
    places = found.rectangle.points(found.target, random.uniform(-1, 1, (4, 2))).points()
    length, amplitude = path(sources, places)
    near_length, near_amplitude = found(sources, places)
    phase = 2 * np.pi / wavelength * np.abs(length - near_length).max()
    relative = np.abs(amplitude - near_amplitude).max() / np.abs(amplitude).max()
    return float(max(phase, relative))
