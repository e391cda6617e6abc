"""A sequence: frames of a moving target at equal times, and the track of its pattern."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..field.blur import ExposedFrame, Shutter
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose
from ..images.exr import write_field
from ..images.levels import block_means, root_levels, white_level
from ..images.saved import write_picture
from ..machine.files import for_part
from ..machine.progress import progress_bars
from ..measurement.speckle_statistics import contrast
from ..scene.assembly import Assembly
from .expectation import expected_sensitivity
from .tracking import Track
from .trajectory import MotionInTime

_FIRST_ORDER_TURN, _FIRST_ORDER_DEPTH = 1.0, 0.02
"""Rotation [deg], and motion along the target's normal over the detector's distance, up to which first-order theory at
rest is put beside a track."""

_THUMBNAIL, _MOST_THUMBNAILS = 192, 120
"""Longer side [px] and number of the small pictures that a video is made of."""


@dataclass(frozen=True)
class SequenceSettings:
    """count: of frames; rate: frames a second; exposure: [s], from each frame's time on; window: of the correlation
    [px]; renewed: correlation below which the track takes another reference."""

    count: int
    rate: float
    exposure: float
    window: int | None
    renewed: float


@dataclass
class DetectorSequence:
    """What one detector gave. track; predicted: (n, 2) [um] of u and v by first-order theory, NaN where it does not
    hold; contrasts: (n,); thumbnails: small uint8 pictures; warnings, with how many frames had them."""

    track: Track
    predicted: list[np.ndarray] = field(default_factory=list)
    contrasts: list[float] = field(default_factory=list)
    thumbnails: list[np.ndarray] = field(default_factory=list)
    warnings: dict[str, int] = field(default_factory=dict)


@dataclass
class FrameSequence:
    """begins: (n,) [s]; poses: at the middle of each exposure; moments, blur_errors: of each frame, the largest over
    the detectors; detectors: by name."""

    settings: SequenceSettings
    detectors: dict[str, DetectorSequence]
    begins: list[float] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    moments: list[int] = field(default_factory=list)
    blur_errors: list[float] = field(default_factory=list)
    numerical_error: float = 0.0

    @property
    def middles(self) -> list[float]:
        """Times of the middles of the exposures [s]."""
        return [begin + self.settings.exposure / 2 for begin in self.begins]


def frames_in(motion: MotionInTime, rate: float, exposure: float) -> int | None:
    """How many frames the time of a motion holds, None where it has no end. Raises InputError where there is none."""
    if math.isinf(motion.end):
        return None
    count = math.floor((motion.end - motion.begin - exposure) * rate * (1 + 1e-12) + 1e-9) + 1
    if count < 1:
        lasts = motion.end - motion.begin
        raise InputError(f"--exposure {exposure:g}: must be at most the {lasts:g} s that the motion lasts")
    return count


def run_sequence(
    assemblies: Mapping[str, Assembly], motion: MotionInTime, settings: SequenceSettings, folder: Path,
    pictures: str | None = None, quiet: bool = False,
) -> FrameSequence:  # fmt: skip
    """Makes the frames and writes them into ``folder``: ``frame_00000.exr``, of several detectors each with its name.

    pictures: ``png`` or ``tiff``, to write what cameras save as well, of the detectors that have one.
    """
    shutter = Shutter(assemblies, settings.exposure)
    detectors = {name: DetectorSequence(Track(settings.window, settings.renewed)) for name in assemblies}
    made = FrameSequence(settings, detectors)
    theories = {name: _Prediction(assembly) for name, assembly in assemblies.items()}
    every = max(1, -(-settings.count // _MOST_THUMBNAILS))
    with progress_bars(quiet) as progress:
        bar = progress.add_task("frames", total=settings.count)
        for number in range(settings.count):
            begin = motion.begin + number / settings.rate
            pose = motion.at(begin + settings.exposure / 2)
            frames = shutter.frames(motion.at, begin, number)
            for name, frame in frames.items():
                path = folder / f"frame_{number:05d}.exr"
                _write(path if len(frames) == 1 else for_part(path, name), frame, begin, settings, pictures)
                one = made.detectors[name]
                one.predicted.append(theories[name].at(pose))
                _note(one, frame, number % every == 0)
            made.begins.append(begin)
            made.poses.append(pose)
            made.moments.append(max(frame.moments for frame in frames.values()))
            made.blur_errors.append(max(frame.blur_error for frame in frames.values()))
            made.numerical_error = float(np.maximum(
                made.numerical_error, max(frame.numerical_error for frame in frames.values())
            ))  # fmt: skip
            progress.advance(bar)
    return made


def _write(path: Path, frame: ExposedFrame, begin: float, settings: SequenceSettings, pictures: str | None) -> None:
    header = {"time_s": begin + settings.exposure / 2, "exposure_s": settings.exposure, "moments": frame.moments,
              "blur_error": frame.blur_error}  # fmt: skip
    image = replace(frame.image, header=frame.image.header | header)
    if pictures and image.dn is not None:
        write_picture(path.with_suffix(f".{pictures}"), image)
    write_field(path, image)


def _note(one: DetectorSequence, frame: ExposedFrame, is_shown: bool) -> None:
    measured = frame.image.measured
    one.track.add(measured)
    one.contrasts.append(contrast(measured))
    for warning in frame.warnings:
        one.warnings[warning] = one.warnings.get(warning, 0) + 1
    if is_shown:
        small = block_means(np.asarray(measured, dtype=np.float64), max(1, -(-max(measured.shape) // _THUMBNAIL)))
        one.thumbnails.append(root_levels(small, white_level(small)))


class _Prediction:
    """Where first-order theory at rest has the pattern at a pose, from where it is at the first."""

    def __init__(self, assembly: Assembly) -> None:
        expected = expected_sensitivity(assembly)
        rows = [expected["u"], expected["v"]]
        self._matrix = None if any(row is None for row in rows) else np.array(rows)
        self._depth = _FIRST_ORDER_DEPTH * float(np.linalg.norm(assembly.detector.centre - assembly.spot.point))
        self._first: np.ndarray | None = None

    def at(self, pose: Pose) -> np.ndarray:
        """(2,) [um] along u and v, NaN where theory does not hold."""
        values = np.array([getattr(pose, name) for name in DEGREES_OF_FREEDOM])
        holds = np.linalg.norm(values[3:]) <= _FIRST_ORDER_TURN and abs(values[2]) <= self._depth
        if self._first is None:
            self._first = values if holds else np.full(6, np.nan)
        if self._matrix is None or not holds:
            return np.full(2, np.nan)
        return 1e3 * self._matrix @ (values - self._first)
