"""Who makes frames: a list of them is given to an executor, which gives their results in order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from ..field.frame import FrameResult
from ..field.simulation import Simulation
from ..geometry.pose import Pose


@dataclass(frozen=True)
class FrameTask:
    """One frame of an assembly: pose of the target, which surface, and the name that its results are kept under."""

    pose: Pose
    seed: int
    name: str


class Executor(Protocol):
    """Makes frames of one assembly somewhere."""

    def results(self, tasks: Iterable[FrameTask]) -> Iterator[FrameResult]:
        """The results of all tasks in their order, each as soon as it is there."""


class InProcess:
    """Makes frames one after the other in this process."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def results(self, tasks: Iterable[FrameTask]) -> Iterator[FrameResult]:
        for task in tasks:
            yield self._simulation.frame(task.pose, task.seed)
