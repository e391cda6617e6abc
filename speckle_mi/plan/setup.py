"""An assembly with its target at one pose, as the plan and the stages of a frame look at it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ..geometry.frames import Frame
from ..geometry.pose import Pose
from ..propagation.costs import RECORDED, Costs
from ..scene.assembly import Assembly, Spot
from ..scene.meeting import Meetings
from ..scene.tracer import TARGET, Tracer, off_surface


class Lighting(Protocol):
    """A beam, or light that is like one around the target."""

    def log_ratio(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Logarithm (n,) of the field at points (n, 3) over that at others close by."""


@dataclass(frozen=True, eq=False)
class Setup:
    """assembly: what there is; pose: the target's displacement from rest; tracer: tells which ways are free; costs: of
    the pieces of a sum, from which the cheapest way of doing it is chosen; beside_beam: what lights the target, as
    ``Beam`` has it, where optics have made another light of the assembly's beam."""

    assembly: Assembly
    pose: Pose
    tracer: Tracer
    costs: Costs = RECORDED
    beside_beam: Lighting | None = None

    @property
    def light(self) -> Lighting:
        """What lights the target."""
        return self.assembly.beam if self.beside_beam is None else self.beside_beam

    @cached_property
    def frame(self) -> Frame:
        """Where the target stands."""
        return self.assembly.target.frame.moved(self.pose)

    @cached_property
    def meetings(self) -> Meetings:
        """All that rays can meet."""
        assembly = self.assembly
        return Meetings(assembly.elements, assembly.target, self.frame, self.tracer, assembly.detector)

    @cached_property
    def spot(self) -> Spot:
        """Middle of what scatters."""
        return self.assembly.spot_at(self.frame)

    @cached_property
    def boxes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers (k,) of all elements, and ``TARGET`` where it has a surface; lowest, highest corners (k, 3) [mm].

        As wide as single precision may place them.
        """
        numbers = list(range(len(self.assembly.elements)))
        bounds = [element.body.bounds for element in self.assembly.elements]
        if self.assembly.target.points is None:
            ends = self.assembly.target.body.bounds
            placed = self.frame.to_world(np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3))
            numbers.append(TARGET)
            bounds.append(np.array([placed.min(axis=0), placed.max(axis=0)]))
        boxes = np.array(bounds).reshape(-1, 2, 3)
        slack = np.array([off_surface(one) for one in boxes])[:, None]
        return np.array(numbers, dtype=np.int64), boxes[:, 0] - slack, boxes[:, 1] + slack

    @property
    def front(self) -> np.ndarray | None:
        """Unit normal (3,) on the side that the target radiates to, None for scatterers that radiate to all."""
        return None if self.assembly.target.points is not None else self.spot.normal

    @cached_property
    def spots(self) -> np.ndarray:
        """Places that stand for all that scatters, (n, 3): its middle, and points around it as far as it is summed."""
        target = self.assembly.target
        if target.points is not None:
            places = self.frame.to_world(target.points.points)
            outermost = np.unique(np.concatenate([places[np.argmax(places, 0)], places[np.argmin(places, 0)]]), axis=0)
            return np.concatenate([places.mean(axis=0)[None], outermost]) if len(outermost) > 1 else outermost
        beam, spot, normal = self.assembly.beam, self.spot.point, self.spot.normal
        largest = 0.5 * float(np.ptp(target.surface.facets.bounds))
        # An ellipse, longest where the beam runs along the surface.
        along = beam.axis - (beam.axis @ normal) * normal
        first = along / np.linalg.norm(along) if np.linalg.norm(along) > 1e-9 else self.frame.axes[:, 0]
        second = np.cross(normal, first)
        tangents = np.stack([first, second])
        # (p.x/X)^2 + (p.y/Y)^2 = 1 at its edge, p in the surface.
        lit = (beam.across @ tangents.T) / np.minimum(beam.cutoff * beam.radii_at(spot), largest)[:, None]
        inverse_squares, turn = np.linalg.eigh(lit.T @ lit)
        sizes = np.minimum(1 / np.sqrt(np.maximum(inverse_squares, largest**-2)), largest)
        ends = (size * sign * axis for size, axis in zip(sizes, turn.T @ tangents, strict=True) for sign in (-1, 1))
        return np.array([spot, *(spot + end for end in ends)])
