"""An assembly with its target at one pose, as the plan and the stages of a frame look at it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ..geometry.frames import Frame
from ..geometry.pose import Pose
from ..scene.assembly import Assembly, Spot
from .tracer import Tracer


@dataclass(frozen=True, eq=False)
class Setup:
    """assembly: what there is; pose: the target's displacement from rest; tracer: tells which ways are free."""

    assembly: Assembly
    pose: Pose
    tracer: Tracer

    @cached_property
    def frame(self) -> Frame:
        """Where the target stands."""
        return self.assembly.target.frame.moved(self.pose)

    @cached_property
    def spot(self) -> Spot:
        """Middle of what scatters."""
        return self.assembly.spot_at(self.frame)
