"""Who makes frames: a list of them is given to an executor, which gives their results in order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from ..field.detectors import Simulations
from ..field.frame import FrameResult
from ..geometry.pose import Pose


@dataclass(frozen=True)
class FrameTask:
    """One frame: pose of the target, which surface, and the name that its results are kept under; shot: which picture
    of a camera there."""

    pose: Pose
    seed: int
    name: str
    shot: int = 0


class FrameExecutor(Protocol):
    """Makes frames of the detectors of one scene somewhere."""

    def results(self, tasks: Iterable[FrameTask]) -> Iterator[dict[str, FrameResult]]:
        """The results of all tasks in their order, by detector, each as soon as it is there."""


class FramesInProcess:
    """Makes frames one after the other in this process."""

    def __init__(self, simulations: Simulations) -> None:
        self._simulations = simulations

    def results(self, tasks: Iterable[FrameTask]) -> Iterator[dict[str, FrameResult]]:
        for task in tasks:
            yield self._simulations.frames(task.pose, task.seed, task.shot)
