"""One call for every propagation: chooses how to do the coherent sum, does it, and measures its error.

The error is measured on a random sample of the target's points against the exact float64 sum; a method that misses the
tolerance there is replaced by a better one rather than believed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import PlaneGrid, PlanePoints
from .bandlimited import band_limited_sum, node_grid, source_box
from .direct import SINGLE_PRECISION, direct_sum, supports
from .paths import Path
from .reference import reference_sum

METHODS = ("auto", "direct", "fast")

SAMPLE_SEED = 20220601
"""Seed of the sample of target points on which the error is measured."""


@dataclass(frozen=True)
class SumResult:
    """Outcome of a coherent sum.

    field: complex128 of the target's shape; plan: what was chosen and why, one line; numerical_error: relative L2 error of the
    field, measured on a sample of points against the exact float64 sum.
    """

    field: np.ndarray
    plan: str
    numerical_error: float


def coherent_sum(
    path: Path,
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    wavelength: float,
    method: str = "auto",
    tolerance: float = 1e-4,
) -> SumResult:
    """E_m = sum_j c_j A(P_j, D_m) e^{+ikV(P_j, D_m)} on all points of the target.

    sources: (n, 3) [mm]; weights c: (n,) complex; wavelength [mm]; method: ``direct`` every pair, ``fast`` few nodes,
    ``auto`` the cheaper; tolerance: relative L2 error allowed of ``fast`` and ``auto``, 1e-8 to 1e-1.
    Raises ValueError for arrays of the wrong shape, values that are not finite, and parameters out of range.
    """
    sources, weights = _checked(sources, weights, target, wavelength, method, tolerance)
    if len(sources) == 0:
        return SumResult(np.zeros(_shape(target), dtype=np.complex128), "no sources: the field is zero", 0.0)
    pairs = len(sources) * target.size
    if method != "direct":
        box = source_box(sources)
        nodes = node_grid(path, box, target, wavelength, tolerance)
        if 4 * nodes.size < target.size:
            field = band_limited_sum(
                lambda places: direct_sum(path, sources, weights, places, wavelength, tolerance / 4),
                path, box[0], nodes, target, wavelength, tolerance,
            )  # fmt: skip
            error = measured_error(field, path, sources, weights, target, wavelength, tolerance)
            if error <= tolerance:
                count = f"{nodes.count[0]} x {nodes.count[1]}"
                plan = f"band-limited: exact sum on {count} nodes, interpolated to {target.size} points"
                return SumResult(field, plan, error)
    field = direct_sum(path, sources, weights, target, wavelength, SINGLE_PRECISION if method == "direct" else tolerance)
    error = measured_error(field, path, sources, weights, target, wavelength, tolerance)
    return SumResult(field, f"direct: every one of {pairs:.3g} pairs", error)


def measured_error(
    field: np.ndarray,
    path: Path,
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    wavelength: float,
    tolerance: float,
) -> float:
    """Relative L2 error of ``field`` on a random sample of points, against the exact float64 sum.

    The sample shrinks with the number of sources so that it stays a small part of the work; the scale of the error is
    the root mean square of the whole field, which a small sample of a speckle pattern does not know.
    """
    count = int(np.clip(10_000_000 // len(sources), 8, 64))
    pick = np.random.default_rng(SAMPLE_SEED).integers(target.size, size=min(count, target.size))
    if isinstance(target, PlaneGrid):
        row, column = np.divmod(pick, target.shape[1])
        places = PlanePoints(target.origin, target.u, target.v, column * target.pitch, row * target.pitch)
    else:
        places = PlanePoints(target.origin, target.u, target.v, target.a[pick], target.b[pick])
    if supports(path):
        exact = direct_sum(path, sources, weights, places, wavelength, 0.0)
    else:
        exact = reference_sum(path, sources, weights, places.points(), wavelength)
    flat = field.reshape(-1)
    mean_square = max(np.vdot(flat, flat).real / flat.size, np.vdot(exact, exact).real / exact.size * 1e-6)
    if mean_square == 0.0:
        return 0.0
    return float(np.sqrt(np.mean(np.abs(flat[pick] - exact) ** 2) / mean_square))


def _shape(target: PlaneGrid | PlanePoints) -> tuple[int, ...]:
    return target.shape if isinstance(target, PlaneGrid) else (target.size,)


def _checked(
    sources: np.ndarray,
    weights: np.ndarray,
    target: PlaneGrid | PlanePoints,
    wavelength: float,
    method: str,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray]:
    if method not in METHODS:
        raise ValueError(f"method = {method!r}: must be one of {', '.join(METHODS)}")
    if not 1e-8 <= tolerance <= 1e-1:
        raise ValueError(f"tolerance = {tolerance}: must be a relative L2 error between 1e-8 and 1e-1")
    if not (np.isfinite(wavelength) and wavelength > 0):
        raise ValueError(f"wavelength = {wavelength}: must be a positive number of mm")
    sources = np.ascontiguousarray(sources, dtype=np.float64)
    weights = np.ascontiguousarray(weights, dtype=np.complex128)
    if sources.ndim != 2 or sources.shape[1] != 3:
        raise ValueError(f"sources of shape {sources.shape}: must be (n, 3) positions in mm")
    if weights.shape != (len(sources),):
        raise ValueError(f"weights of shape {weights.shape}: must be one for each of the {len(sources)} sources")
    if not (np.isfinite(sources).all() and np.isfinite(weights).all()):
        raise ValueError("sources and weights must be finite numbers")
    if target.size == 0:
        raise ValueError("target of no points: must have at least one")
    return sources, weights
