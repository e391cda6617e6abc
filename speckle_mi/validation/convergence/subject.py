"""What a study is about: an assembly, the small motion that it is moved by, and what theory says of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...experiments.expectation import expected_sensitivity
from ...field.simulation import plan_of

SHARE_OF_RADIUS = 0.1
"""Displacement along x relative to the beam's radius: the pattern keeps 99 % of its correlation."""

MOVED_PIXELS = 2
"""Displacement along x, in pixels, where the beam has no radius."""

EDGES = (
    "behind an opening: light diffracted at its edge stands still while the speckles move and holds the peak of the "
    "correlation back, most at small displacements; theory leaves it out"
)

LONE = (
    "through a lens: a tilt moves the speckles of scatterers that share a resolution cell; those that few scatterers "
    "make, seen one by one, stay where they are"
)
"""Why simulated shifts are not those of first-order theory."""


@dataclass(frozen=True)
class Subject:
    """An assembly under study.

    name: of its scene; plan: how its light goes; point_sources: values of N1, rising; displacement: of the moved
    frames along x [mm]; expected: axis u, v -> first-order sensitivities to all motions, None without theory.
    """

    assembly: object
    name: str
    plan: object
    point_sources: tuple[int, ...]
    displacement: float
    expected: dict[str, np.ndarray | None]

    @classmethod
    def of(cls, assembly, name: str, point_sources: Sequence[int]) -> Subject:
        """The user's own scatterers are as many as they are, whatever N1 is asked for."""
        radius, points = assembly.beam.radius, assembly.target.points
        displacement = SHARE_OF_RADIUS * radius if np.isfinite(radius) else MOVED_PIXELS * assembly.detector.pitch
        plan = plan_of(assembly)
        expected = expected_sensitivity(assembly, plan)
        counts = tuple(point_sources) if points is None else (len(points.points),)
        along = {axis: expected[axis] for axis in ("u", "v")}
        return cls(assembly, name, plan, counts, float(displacement), along)

    @property
    def theory_shift(self) -> list[float] | None:
        """Shift [um] of the pattern along u and v by the displacement, to first order; None without theory."""
        if any(values is None for values in self.expected.values()):
            return None
        return [1e3 * self.displacement * float(values[0]) for values in self.expected.values()]

    @property
    def openings(self) -> int:
        """How many openings diffract the light."""
        return sum(len(channel.openings) for channel in self.plan.channels)

    def why_off_theory(self, motions: set[str]) -> list[str]:
        """What is known to set the measured means of ``motions`` apart from first-order theory, a sentence each."""
        channels = self.plan.channels
        edges = motions and any(channel.openings and not channel.has_power for channel in channels)
        lone = "ry" in motions and any(channel.has_power for channel in channels)
        return [*([EDGES] if edges else []), *([LONE] if lone else [])]
