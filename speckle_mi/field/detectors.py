"""Several detectors that look at one target: their frames come from one set of scatterers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ..geometry.pose import Pose
from ..plan.cost import Cost
from ..scene.assembly import Assembly
from ..scene.tracer import Tracer
from .frame import FrameResult
from .simulation import Simulation

_HELD = 24
"""Memory of a pixel of a frame that waits for the other detectors': field, intensity and a camera's number [bytes]."""


class Simulations:
    """Frames of the detectors of one scene, by their names.

    assemblies: as ``load_detectors`` gives them: they differ in the detector, its sub-pixels and camera alone, else
    ValueError. Each detector's frames are bit for bit those of a simulation of its own.
    """

    of_one: type[Simulation] = Simulation
    """What each detector's frames are made by."""

    def __init__(self, assemblies: Mapping[str, Assembly]) -> None:
        if not assemblies:
            raise ValueError("assemblies: must hold at least one detector's")
        first = next(iter(assemblies.values()))
        for name, assembly in assemblies.items():
            if assembly != replace(
                first, detector=assembly.detector, sub_pixels=assembly.sub_pixels, camera=assembly.camera
            ):
                raise ValueError(f"assembly of {name!r}: differs in more than its detector from the first one")
        tracer = Tracer(first.elements, first.target)
        self.by_detector = {name: self.of_one(assembly, tracer) for name, assembly in assemblies.items()}

    @property
    def first(self) -> Simulation:
        """That of the first detector, which tells what all have in common."""
        return next(iter(self.by_detector.values()))

    def frames(self, pose: Pose | None = None, seed: int | None = None, shot: int = 0) -> dict[str, FrameResult]:
        """The frame of every detector; arguments and errors as of :meth:`Simulation.frame`."""
        if len(self.by_detector) == 1:
            return {name: one.frame(pose, seed, shot=shot) for name, one in self.by_detector.items()}
        lit = self.first.lit(pose, seed)
        return {name: one.frame(pose, seed, shot=shot, lit=lit) for name, one in self.by_detector.items()}

    def cost(self, pose: Pose | None = None) -> Cost:
        """What a frame of every detector will cost together."""
        costs = [one.cost(pose) for one in self.by_detector.values()]
        pixels = [one.assembly.detector.size for one in self.by_detector.values()]
        memory = max(cost.memory + _HELD * (sum(pixels) - own) for cost, own in zip(costs, pixels, strict=True))
        return Cost(sum(cost.seconds for cost in costs), memory)
