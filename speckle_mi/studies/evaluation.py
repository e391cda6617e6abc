"""What one variant of a scene does: a job of a study. First-order theory of it, and one frame of each of some surfaces.

All variants of a study are measured on the same surfaces and the same pixels, so that what surfaces do is common to
them and cancels as far as their patterns are alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from ..errors import InputError
from ..experiments.chief_ray import axes_as_seen
from ..experiments.expectation import AXES, expected_sensitivity, on_all_axes
from ..experiments.one_frame import FEWEST_PIXELS, OneFrame
from ..field.detectors import Simulations
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose, is_rotation
from ..machine.cores import products_on_one_thread
from ..measurement.velocity import half_correlation
from ..scene.assembly import Assembly
from .design import Design

PER_UNIT = np.array([np.pi / 180 if is_rotation(dof) else 1.0 for dof in DEGREES_OF_FREEDOM])
"""From rad to deg, where a motion is a rotation."""

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
    sensitivities are measured, None for one frame.
    """

    design: Design
    density: float | None = None
    compensators: tuple[Compensator, ...] = ()
    sweep: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Evaluation:
    """Of d detectors and k surfaces. Sensitivities are [mm/mm, mm/deg], NaN where they are not known.

    theory: (d, 6 axes, 6 motions) of first order, axes u, v, x, y, cog_u, cog_v; measured: (k, d, 6, 6) of surfaces;
    half: (d, 6) displacement [mm or deg] at which correlation falls to one half; failed: why there is nothing, empty
    where there is; adjusted: what the compensators were set to; seconds: that it took.
    """

    theory: np.ndarray
    measured: np.ndarray
    half: np.ndarray
    failed: str = ""
    adjusted: tuple[float, ...] = ()
    seconds: float = 0.0

    @classmethod
    def of(cls, result: Mapping) -> Evaluation:
        """From the result of a job."""
        return cls(**{**result, "adjusted": tuple(result["adjusted"])})


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
            return vars(Evaluation(nothing, nothing[None], nothing[:, 0], str(error)))

    @products_on_one_thread()
    def evaluation(self, asked: Asked) -> Evaluation:
        """The same as a value. Raises InputError where the variant cannot be."""
        values, adjusted = dict(asked.values), []
        for compensator in self._variants.compensators:
            values[compensator.parameter] = self._compensated(compensator, values)
            adjusted.append(values[compensator.parameter])
        simulations = Simulations(self.assemblies(values))
        parts = simulations.by_detector.values()
        theory = np.stack([theory_of(one.assembly, one.plan(Pose())) for one in parts])
        measured, half, seconds = self._measured(simulations, asked.seeds)
        return Evaluation(theory, measured, half, adjusted=tuple(adjusted), seconds=seconds)

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

    def _measured(self, simulations: Simulations, seeds: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, float]:
        count = len(simulations.by_detector)
        measured, half, seconds = np.full((len(seeds), count, len(AXES), 6), np.nan), np.full((count, 6), np.nan), 0.0
        if not seeds:
            return measured, half, seconds
        if self._variants.sweep is not None:
            from .swept import swept_sensitivities

            return swept_sensitivities(simulations, seeds, np.array(self._variants.sweep))
        lit = {seed: simulations.first.lit(Pose(), seed) for seed in seeds}
        for number, one in enumerate(simulations.by_detector.values()):
            frame, seen = OneFrame(one, FEWEST_PIXELS), axes_as_seen(one.assembly, one.plan(Pose()))
            for surface, seed in enumerate(seeds):
                frame.add(seed, lit[seed])
                value = frame.result.linear[surface].value.T * PER_UNIT
                measured[surface, number, :4] = on_all_axes(value, one.assembly, seen)
            curvature = np.mean([velocity.curvature for velocity in frame.result.linear], axis=0) * PER_UNIT**2
            half[number] = half_correlation(curvature)
            seconds += frame.result.seconds
        return measured, half, seconds


def theory_of(assembly: Assembly, plan=None) -> np.ndarray:
    """(6 axes, 6 motions) that first-order theory expects [mm/mm, mm/deg], NaN where there is none."""
    expected = expected_sensitivity(assembly, plan)
    return np.array([np.full(6, np.nan) if expected[axis] is None else expected[axis] for axis in AXES])


def _of_density(assembly: Assembly, density: float) -> Assembly:
    surface = replace(assembly.target.surface, density=density)
    return replace(assembly, target=replace(assembly.target, surface=surface))
