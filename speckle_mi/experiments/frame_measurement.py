"""One frame of a sweep as a job: the field with the target at a pose, and how far its pattern has moved from rest."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np

from ..field.detectors import Simulations
from ..field.frame import FrameResult
from ..geometry.pose import Pose
from ..images.field_image import FieldImage
from ..measurement.correlator import Correlator
from ..measurement.speckle_statistics import centre_of_gravity, contrast
from ..scene.assembly import Assembly
from .chief_ray import SeenAxes, axes_as_seen
from .expectation import on_all_axes

REFERENCES_KEPT = 4
"""Surfaces whose frame at rest is kept for those that follow."""

IMAGES = "images"
"""What a job brings besides when asked: the images of all detectors."""


@dataclass(frozen=True)
class FrameTask:
    """Pose of the target, which surface, and which picture of a camera there."""

    pose: Pose
    seed: int
    shot: int = 0

    @property
    def is_reference(self) -> bool:
        return self.pose == Pose() and self.shot == 0


@dataclass(frozen=True)
class SweptScene:
    """What the frames of a sweep depend on besides their tasks: the assembly of every detector, and the side of the
    correlation window [px]. Which surface and pose the scene has its target at is left out."""

    assemblies: dict[str, Assembly]
    window: int | None

    @classmethod
    def of(cls, assemblies: Mapping[str, Assembly], window: int | None) -> SweptScene:
        return cls({name: replace(one.with_seed(0), pose=Pose()) for name, one in assemblies.items()}, window)


def in_single_precision(image: FieldImage) -> FieldImage:
    """The image as its file holds it, which is half as much to send."""
    layers = {name: values.astype(np.complex64) for name, values in image.layers.items()}
    return replace(image, field=image.field.astype(np.complex64), layers=layers)


class FrameMeasurement:
    """Makes frames and measures them, from several threads if need be. A frame at rest is made when first needed."""

    def __init__(self, scene: SweptScene) -> None:
        self.simulations, self._scene = Simulations(scene.assemblies), scene
        self.seen: dict[str, SeenAxes] = {
            name: axes_as_seen(one.assembly, one.plan()) for name, one in self.simulations.by_detector.items()
        }
        self._references: dict[int, Future] = {}
        self._lock = threading.Lock()

    def __call__(self, task: FrameTask, besides: str | None = None) -> dict:
        """What the frame gave, as plain data: ``seconds`` and, by detector, what was measured and its plan.

        besides: ``IMAGES`` adds the images themselves.
        """
        began = time.perf_counter()
        correlators, frames = self._at_rest(task.seed)
        if frames is None or not task.is_reference:
            frames = self.simulations.frames(task.pose, task.seed, task.shot)
        found = {name: self._measured(name, frame, correlators[name]) for name, frame in frames.items()}
        result = {"seconds": time.perf_counter() - began, "detectors": found}
        if besides != IMAGES:
            return result
        return result | {IMAGES: {name: in_single_precision(frame.image) for name, frame in frames.items()}}

    def _at_rest(self, seed: int) -> tuple[dict[str, Correlator], dict[str, FrameResult] | None]:
        """Correlators with the surface's frame at rest, by detector; these frames where they have just been made."""
        with self._lock:
            known = self._references.get(seed)
            if known is None:
                while len(self._references) >= REFERENCES_KEPT:
                    self._references.pop(next(iter(self._references)))
                mine = self._references[seed] = Future()
        if known is not None:
            return known.result(), None
        try:
            frames = self.simulations.frames(Pose(), seed)
            window = self._scene.window
            mine.set_result({name: Correlator(frame.image.measured, window) for name, frame in frames.items()})
        except BaseException as error:
            mine.set_exception(error)
            with self._lock:
                self._references.pop(seed, None)
            raise
        return mine.result(), frames

    def _measured(self, name: str, frame: FrameResult, correlator: Correlator) -> dict:
        """The measured columns of a frame's record, and what the image's header says of how it was made."""
        assembly, measured, header = self._scene.assemblies[name], frame.image.measured, frame.image.header
        pixel = 1e3 * assembly.detector.pitch
        shift = correlator.shift(measured)
        along = on_all_axes(np.array([[shift.u_px], [shift.v_px]]) * pixel, assembly, self.seen[name])[:, 0]
        cog = np.array(centre_of_gravity(measured)) * pixel
        columns = {f"shift_{axis}_um": float(value) for axis, value in zip("uvxy", along, strict=True)}
        columns |= {
            "ncc": shift.ncc, "cog_u_um": float(cog[0]), "cog_v_um": float(cog[1]), "contrast": contrast(measured),
            "status": shift.status, "sigma_u_um": shift.sigma_u_px * pixel, "sigma_v_um": shift.sigma_v_px * pixel,
        }  # fmt: skip
        return {"columns": columns} | {key: header[key] for key in ("plan", "numerical_error", "warnings")}
