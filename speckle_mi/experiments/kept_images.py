"""The images that a sweep leaves in its folder: which are to stay, which are there, and writing them aside."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from ..images.exr import read_field, read_header, write_field
from ..images.exr_layout import damage
from ..images.field_image import FieldImage, FieldImageError
from ..images.saved import write_picture
from ..machine.files import for_part
from ..scene.assembly import Assembly
from ..version import __version__
from .frame_measurement import FrameTask
from .sweep_result import SweepSettings, frame_count

NONE, FIRST, ALL = KEPT = ("none", "first", "all")
"""Which field images stay: none, those of the first surface, all."""

ROOM = 512e6
"""Bytes that the images of a sweep take at most unless it is said which of them stay."""

_PENDING = 8
"""Frames that may wait to be written: bounds the memory they take."""

_HEADER = 8192
"""About what an image's file has beside its pixels [bytes]."""


def bytes_of_image(assembly: Assembly) -> float:
    """About the size of a field image's file."""
    layers = len(assembly.named_parts) if assembly.further else 0
    return 4.0 * assembly.detector.size * (3 + (assembly.camera is not None) + 2 * layers) + _HEADER


def images_to_keep(assemblies: Mapping[str, Assembly], settings: SweepSettings) -> str:
    """As many as take up to ``ROOM``: all, else those of the first surface, else none."""
    whole = frame_count(settings) * sum(map(bytes_of_image, assemblies.values()))
    if whole <= ROOM:
        return ALL
    return FIRST if whole <= ROOM * len(settings.seeds) else NONE


class KeptImages:
    """The images of a sweep's folder. One waits while ``_PENDING`` frames are still to be written."""

    def __init__(self, folder: Path, assemblies: Mapping[str, Assembly], keep: str, pictures: str | None) -> None:
        """keep: one of ``KEPT``; pictures: ``png`` or ``tiff``, to write what the cameras save of every frame."""
        self._folder, self._keep, self._pictures = folder, keep, pictures
        self._hashes = {name: assembly.fingerprint() for name, assembly in assemblies.items()}
        self._waiting: deque[Future] = deque()
        self._pool = ThreadPoolExecutor(max_workers=1)

    def __enter__(self) -> KeptImages:
        return self

    def __exit__(self, kind, *_: object) -> None:
        try:
            if kind is None:
                self.settle()
        finally:
            # Where it went wrong, as the disk is full, say, the frames that wait are not tried.
            self._pool.shutdown(cancel_futures=True)

    def settle(self) -> None:
        """Waits until everything is written. Raises OSError where it cannot be."""
        while self._waiting:
            self._waiting.popleft().result()

    def are_wanted(self, is_of_first: bool) -> bool:
        """Whether something of the frame is to be written; is_of_first: of the first surface."""
        return bool(self._pictures) or self._stay(is_of_first)

    def are_there(self, name: str, task: FrameTask, is_of_first: bool) -> bool:
        """Whether everything of the frame that is to stay lies whole in the folder."""
        return all(
            (not self._stay(is_of_first) or _is_image_of(self._path(name, detector), task, scene_hash))
            and (not self._pictures or self._picture(name, detector).is_file())
            for detector, scene_hash in self._hashes.items()
        )

    def read(self, name: str, task: FrameTask) -> dict[str, FieldImage] | None:
        """The images of a frame, None where they are not there."""
        places = {detector: self._path(name, detector) for detector in self._hashes}
        if not all(_is_image_of(place, task, self._hashes[detector]) for detector, place in places.items()):
            return None
        return {detector: read_field(place) for detector, place in places.items()}

    def write(
        self, name: str, is_of_first: bool, images: Mapping[str, FieldImage], then: Callable[[], None]
    ) -> None:
        """Writes what is to stay of a frame, aside, and does ``then``. Raises OSError of this or an earlier frame."""
        while len(self._waiting) >= _PENDING:
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(self._write, name, is_of_first, images, then))

    def _write(self, name: str, is_of_first: bool, images: Mapping[str, FieldImage], then) -> None:
        for detector, image in images.items():
            if self._pictures:
                write_picture(self._picture(name, detector), image)
            if self._stay(is_of_first):
                write_field(self._path(name, detector), image)
        then()

    def _stay(self, is_of_first: bool) -> bool:
        return self._keep == ALL or (self._keep == FIRST and is_of_first)

    def _path(self, name: str, detector: str) -> Path:
        path = self._folder / f"{name}.exr"
        return path if len(self._hashes) == 1 else for_part(path, detector)

    def _picture(self, name: str, detector: str) -> Path:
        path = self._path(name, detector)
        return path.with_name(f"{path.stem}.{self._pictures}")


def _is_image_of(path: Path, task: FrameTask, scene_hash: str) -> bool:
    """Whether a file is the whole image of a task, made by the same version."""
    wanted = {"scene_hash": scene_hash, "seed": task.seed, "pose": str(task.pose), "version": __version__}
    try:
        return wanted.items() <= read_header(path).items() and damage(path) is None
    except (FieldImageError, OSError):
        return False
