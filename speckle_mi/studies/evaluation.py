"""What one variant of a scene does: a job of a study. First-order theory of it, and one frame of each of some surfaces.

All variants of a study are measured on the same surfaces and the same pixels, so that what surfaces do is common to
them and cancels as far as their patterns are alike.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from ..errors import InputError
from ..experiments.chief_ray import axes_as_seen
from ..experiments.expectation import AXES, expected_sensitivity, on_all_axes
from ..experiments.one_frame import FEWEST_PIXELS, OneFrame, values_of_surfaces
from ..field.detectors import Simulations
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation
from ..machine.cores import products_on_one_thread
from ..scene.assembly import Assembly
from .design import Design
from .room import clearance, extent
from .swept import swept_sensitivities

PER_UNIT = np.array([np.pi / 180 if is_rotation(dof) else 1.0 for dof in DEGREES_OF_FREEDOM])
"""From rad to deg, where a motion is a rotation."""

COVERAGE = 2.0
"""Standard uncertainties that a half width stands for."""

_CLOSE = 1e-12
"""Relative width of the bracket that a compensator's value is found in."""


@dataclass(frozen=True)
class Compensator:
    """A number that assembly adjusts within bounds until first-order theory has an entry at a value.

    place: of the entry in arrays (detectors, axes, motions).
    """

    parameter: str
    bounds: tuple[float, float]
    place: tuple[int, int, int]
    value: float


@dataclass(frozen=True)
class Variants:
    """What the variants of a study have in common: plain data, the ``given`` of its jobs.

    density: of the scatterers [1/mm^2], which are material and stay when the light on them changes; None for what each
    variant asks for; compensators: that each is adjusted by; sweep: displacements [mm or deg] of a sweep by which
    sensitivities are measured, None for one frame; pixels: that are looked at, the same in all variants, None for as
    many as each one's speckles need.
    """

    design: Design
    density: float | None = None
    compensators: tuple[Compensator, ...] = ()
    sweep: tuple[float, ...] | None = None
    pixels: int | None = FEWEST_PIXELS


@dataclass(frozen=True)
class Evaluation:
    """Of d detectors and k surfaces. Sensitivities are [mm/mm, mm/deg], NaN where they are not known.

    theory: (d, 6 axes, 6 motions) of first order, axes u, v, x, y, cog_u, cog_v; measured: (k, d, 6, 6) of surfaces;
    curvature: (k, d, 6) kappa [1/mm^2 or 1/deg^2] of each, where correlation falls as exp(-kappa q^2); doubt: (d, 6, 6)
    half widths of what is common to all surfaces and not known, by the fields' error and by curvature; extent: (3,)
    size [mm] along the world's axes of the box around all parts; clearance: least gap [mm] between the laser's light
    and any part but the target; failed: why there is nothing, empty where there is; adjusted: what the compensators
    were set to; seconds: of a frame of one surface.
    """

    theory: np.ndarray
    measured: np.ndarray
    curvature: np.ndarray
    doubt: np.ndarray
    extent: tuple[float, ...] = ()
    clearance: float = np.nan
    failed: str = ""
    adjusted: tuple[float, ...] = ()
    seconds: float = 0.0

    @classmethod
    def of(cls, result: Mapping) -> Evaluation:
        """From the result of a job."""
        return cls(**{**result, **{name: tuple(result[name]) for name in ("adjusted", "extent")}})


@dataclass(frozen=True)
class Asked:
    """One job: values by name, and the seeds of the surfaces that are measured, none for theory alone."""

    values: tuple[tuple[str, float], ...]
    seeds: tuple[int, ...] = ()


class Evaluator:
    """Does the jobs of :class:`Variants`: called with what is :class:`Asked`, gives an evaluation as plain data.

    A variant that cannot be, or that sends no light to a detector, is a result as well.
    """

    def __init__(self, variants: Variants) -> None:
        self._variants = variants

    def __call__(self, asked: Asked) -> dict:
        try:
            return vars(self.evaluation(asked))
        except InputError as error:
            nothing = np.full((0, 6, 6), np.nan)
            return vars(Evaluation(nothing, nothing[None], nothing[None, :, 0], nothing, failed=str(error)))

    @products_on_one_thread()
    def evaluation(self, asked: Asked) -> Evaluation:
        """The same as a value. Raises InputError where the variant cannot be."""
        values, adjusted = dict(asked.values), []
        for compensator in self._variants.compensators:
            values[compensator.parameter] = self._compensated(compensator, values)
            adjusted.append(values[compensator.parameter])
        assemblies = self.assemblies(values)
        simulations = Simulations(assemblies)
        parts = simulations.by_detector.values()
        theory = np.stack([theory_of(one.assembly, one.plan(Pose())) for one in parts])
        measured, curvature, doubt, seconds = self._measured(simulations, asked.seeds)
        size = tuple(extent(assemblies.values()).tolist())
        return Evaluation(
            theory, measured, curvature, doubt, size, clearance(assemblies.values()), "", tuple(adjusted), seconds
        )

    def assemblies(self, values: Mapping[str, float]) -> dict[str, Assembly]:
        """The variant's, by detector."""
        found = self._variants.design.assemblies(values)
        density = self._variants.density
        return found if density is None else {name: _of_density(one, density) for name, one in found.items()}

    def _compensated(self, compensator: Compensator, values: Mapping[str, float]) -> float:
        def off(setting: float) -> float:
            changed = self.assemblies({**values, compensator.parameter: setting})
            theory = np.stack([theory_of(one) for one in changed.values()])[compensator.place]
            if not np.isfinite(theory):
                raise InputError(f"compensator {compensator.parameter}: no first-order theory of its condition")
            return float(theory) - compensator.value

        low, high = compensator.bounds
        at_low, at_high = off(low), off(high)
        if at_low * at_high > 0:
            raise InputError(
                f"compensator {compensator.parameter}: its condition is not met from {low:g} to {high:g} "
                f"(off by {at_low:.3g} to {at_high:.3g})"
            )
        return float(brentq(off, low, high, xtol=_CLOSE * max(abs(low), abs(high)), rtol=_CLOSE))

    def _measured(
        self, simulations: Simulations, seeds: tuple[int, ...]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Sensitivities (k, d, 6, 6), curvature (k, d, 6), doubt (d, 6, 6) and seconds of a surface."""
        count = len(simulations.by_detector)
        measured = np.full((len(seeds), count, len(AXES), 6), np.nan)
        curvature = np.full((len(seeds), count, 6), np.nan)
        doubt = np.zeros((count, len(AXES), 6))
        if not seeds:
            return measured, curvature, doubt, 0.0
        if self._variants.sweep is not None:
            return swept_sensitivities(simulations, seeds, np.array(self._variants.sweep))
        lit, began = {seed: simulations.first.lit(Pose(), seed) for seed in seeds}, time.perf_counter()
        for number, one in enumerate(simulations.by_detector.values()):
            frame, seen = OneFrame(one, self._variants.pixels), axes_as_seen(one.assembly, one.plan(Pose()))
            for seed in seeds:
                frame.add(seed, lit[seed])
            found = frame.result
            curvature[:, number] = [velocity.curvature * PER_UNIT**2 for velocity in found.curved]
            if self._variants.pixels is None:
                measured[:, number, :4], spread = values_of_surfaces(found, one.assembly, seen)
                size = np.linalg.norm(measured[:, number, :2].mean(axis=0), axis=0)
                doubt[number, :4] = np.hypot(COVERAGE * spread, found.error * size)
            else:  # in the same way in all variants, for which differences count
                values = [on_all_axes(velocity.value.T * PER_UNIT, one.assembly, seen) for velocity in found.linear]
                measured[:, number, :4] = values
        return measured, curvature, doubt, (time.perf_counter() - began) / len(seeds)


def theory_of(assembly: Assembly, plan=None) -> np.ndarray:
    """(6 axes, 6 motions) that first-order theory expects [mm/mm, mm/deg], NaN where there is none."""
    expected = expected_sensitivity(assembly, plan)
    return np.array([np.full(6, np.nan) if expected[axis] is None else expected[axis] for axis in AXES])


def _of_density(assembly: Assembly, density: float) -> Assembly:
    surface = replace(assembly.target.surface, density=density)
    return replace(assembly, target=replace(assembly.target, surface=surface))
