"""Light that does not interfere: intensities of several lasers, lines, and wavelengths of a line add up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..plan.cost import Cost
from ..plan.stage import INCOHERENT, Stage
from ..scattering.rough_surface import Scatterers
from ..scene.assembly import Assembly
from .derivatives import DerivativeFields
from .frame import LightOnDetector

_HELD = 20
"""Memory of a pixel of light that waits for the other's: its field and intensity [bytes]."""

_LIT = 1e-4
"""Power relative to the brightest scatterer's from which on its path counts."""


def added_up(assembly: Assembly, parts: Sequence[LightOnDetector]) -> LightOnDetector:
    """What all light together brings to the detector; the field, and what scatters, are the first's.

    The error is relative to all light: that of every part counts by its share.
    """
    if len(parts) == 1 and parts[0].assembly.weight == 1:
        return parts[0]
    weights = [part.assembly.weight for part in parts]
    intensity = sum(weight * part.intensity.astype(np.float64) for weight, part in zip(weights, parts, strict=True))
    powers = np.array([weight * np.sum(part.intensity, dtype=np.float64) for weight, part in zip(weights, parts)])
    errors = np.array([part.error for part in parts])
    shares = powers / powers.sum() if powers.sum() > 0 else np.zeros(len(parts))
    known = named(parts)
    stages = [Stage(INCOHERENT, tuple(part.assembly.light for part in known), count=len(parts))]
    stages += [stage for part in known for stage in part.stages]
    warnings = []
    for part in known:
        name = f"{part.assembly.light}: " if len(known) > 1 else ""
        warnings += [name + warning for warning in part.warnings]
    return replace(
        parts[0], intensity=intensity.astype(np.float32), stages=tuple(stages),
        error=float(np.sqrt(np.sum(shares * errors**2))), warnings=tuple(dict.fromkeys(warnings)),
    )  # fmt: skip


def by_photons(parts: Sequence[LightOnDetector]) -> np.ndarray | None:
    """Intensity (rows, columns) as a camera counts it: in photons of the first wavelength. None of one light alone."""
    if len(parts) == 1:
        return None
    first = parts[0].assembly.vacuum_wavelength
    scales = [part.assembly.weight * part.assembly.vacuum_wavelength / first for part in parts]
    photons = sum(scale * part.intensity.astype(np.float64) for scale, part in zip(scales, parts, strict=True))
    return photons.astype(np.float32)


def stacked(parts: Sequence[DerivativeFields], weights: Sequence[float]) -> DerivativeFields:
    """Fields and derivatives of all light, along a first axis, scaled so that their intensities add up."""
    roots = np.sqrt(weights)
    arrays = (
        np.array([root * getattr(part, name) for root, part in zip(roots, parts, strict=True)])
        for name in ("field", "by_motion", "along")
    )
    return DerivativeFields(*arrays, max(part.error for part in parts))


def named(parts: Sequence[LightOnDetector]) -> tuple[LightOnDetector, ...]:
    """Those that are a laser's or a line's own, without the samples of a line's width."""
    return tuple(part for part in parts if part.assembly.light is not None)


def layers_of(parts: Sequence[LightOnDetector]) -> dict[str, np.ndarray]:
    """Fields (rows, columns) of all lasers and lines by the names of their layers; none where there is one."""
    known = named(parts)
    return {f"{part.assembly.light}.E": part.field for part in known} if len(known) > 1 else {}


def together(own: Cost, others: Sequence[Cost], assembly: Assembly) -> Cost:
    """What a frame costs whose lights take turns, and are held until all are there."""
    held = _HELD * assembly.detector.size * len(others)
    return Cost(own.seconds + sum(cost.seconds for cost in others), held + max(cost.memory for cost in (own, *others)))


def too_few_samples(assembly: Assembly, lit: Scatterers) -> list[str]:
    """A warning where paths from the laser over the lit scatterers to the detector's middle differ by too much."""
    if np.isinf(assembly.longest_path) or assembly.light is None or lit.count == 0:
        return []
    power = np.abs(lit.amplitude) ** 2
    bright = power > _LIT * power.max()
    places = lit.position[bright]
    # Straight on: what stands before the detector changes the paths' differences to second order only.
    path = assembly.beam.log_field(places).imag / assembly.beam.wavenumber
    spread = assembly.index * float(np.ptp(path + np.linalg.norm(places - assembly.detector.centre, axis=1)))
    if spread <= assembly.longest_path:
        return []
    return [
        f"paths differ by {spread:.3g} mm, the samples of the line stand for it up to {assembly.longest_path:.3g} mm: "
        f"set spectral_samples to {(spread / assembly.longest_path) ** 2:.2g} times as many"
    ]
