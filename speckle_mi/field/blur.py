"""What a detector sees of a moving target while its shutter is open: the mean of the intensity over the exposure.

The mean over time is taken by Gauss's formulas with more and more moments until two of them agree. The intensity at a
pixel is a smooth function of time where the pose is, so that they agree to many digits soon after the moments are as
close as it takes the pattern to move by a speckle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.pose import Pose
from ..images.field_image import FieldImage
from ..scene.assembly import Assembly
from .detectors import Simulations
from .frame import FrameResult

FEWEST, MOST = 2, 512
"""Moments in an exposure."""

AGREEMENT = 1e-3
"""Difference (rms over pixels, relative to the mean) of two formulas, the finer of which is then taken."""

_LOOKED_AT = np.linspace(0, 1, 9)
"""Parts of the exposure at which it is looked whether anything moves."""


@dataclass(frozen=True)
class ExposedFrame:
    """One frame of a camera. image: with its field only where nothing moved; moments: rendered for its mean, 1 where
    nothing moved; blur_error: difference of the mean from one of half as many moments, relative to it; numerical_error:
    the largest of them; warnings."""

    image: FieldImage
    moments: int
    blur_error: float
    numerical_error: float
    warnings: tuple[str, ...]


class Shutter:
    """Frames of the detectors of one scene with their target in motion; each takes up what the last one needed."""

    def __init__(self, assemblies: Mapping[str, Assembly], exposure: float) -> None:
        """exposure: [s]; of a camera that counts photons by its own exposure, that is this one."""
        timed = {name: _timed(assembly, exposure) for name, assembly in assemblies.items()}
        self.exposure = exposure
        self._whole = Simulations(timed)
        self._bare = Simulations({name: replace(assembly, camera=None) for name, assembly in timed.items()})
        self._moments = FEWEST

    def cost(self):
        """What a frame costs where nothing moves."""
        return self._whole.cost(Pose())

    def frames(self, pose_at: Callable[[float], Pose], begin: float, shot: int) -> dict[str, ExposedFrame]:
        """What each detector sees while the shutter is open from ``begin`` [s] on; shot: number of a camera's picture.

        pose_at: pose at a time [s]. Without a motion in that time this is, bit for bit, the frame at the pose.
        """
        middle = pose_at(begin + self.exposure / 2)
        if self.exposure == 0 or all(pose_at(begin + part * self.exposure) == middle for part in _LOOKED_AT):
            frames = self._whole.frames(middle, shot=shot)
            return {name: ExposedFrame(one.image, 1, 0.0, one.numerical_error, one.warnings)
                    for name, one in frames.items()}  # fmt: skip
        return self._blurred(pose_at, begin, middle, shot)

    def _blurred(self, pose_at, begin: float, middle: Pose, shot: int) -> dict[str, ExposedFrame]:
        moments = max(FEWEST, self._moments // 2)
        before = self._means(pose_at, begin, moments)
        while True:
            moments *= 2
            means = self._means(pose_at, begin, moments)
            errors = {name: means[name].difference(before[name]) for name in means}
            if moments >= MOST or max(errors.values()) <= AGREEMENT:
                break
            before = means
        self._moments = moments
        return {name: self._picture(name, means[name], middle, shot, moments, errors[name]) for name in means}

    def _means(self, pose_at, begin: float, moments: int) -> dict[str, _Mean]:
        """Means over the exposure of every detector's light."""
        nodes, weights = np.polynomial.legendre.leggauss(moments)
        found = {name: _Mean() for name in self._bare.by_detector}
        for node, weight in zip(nodes, weights / 2, strict=True):
            for name, frame in self._bare.frames(pose_at(begin + (1 + float(node)) / 2 * self.exposure)).items():
                found[name].add(float(weight), frame)
        return found

    def _picture(self, name: str, mean: _Mean, middle: Pose, shot: int, moments: int, error: float) -> ExposedFrame:
        picture = self._whole.by_detector[name].picture(mean.photons, middle, shot)
        warnings = (*mean.warnings, *picture.warnings)
        if error > AGREEMENT:
            warnings += (f"blur has not converged after {moments} moments: it is uncertain by {error:.1%} of the mean",)
        said = tuple(dict.fromkeys(warnings))
        header = mean.header | {"pose": str(middle), "numerical_error": mean.error, "warnings": list(said)}
        image = FieldImage(mean.intensity.astype(np.float32), None, header | picture.header, dn=picture.dn)
        return ExposedFrame(image, moments, error, mean.error, said)


def _timed(assembly: Assembly, exposure: float) -> Assembly:
    """The assembly with a camera of that exposure, where its camera goes by one."""
    camera = assembly.camera
    if camera is None or camera.exposure is None or exposure == 0:
        return assembly
    return replace(assembly, camera=replace(camera, exposure=exposure))


class _Mean:
    """Sums over an exposure: intensity, and light as a camera counts it, (rows, columns) float64."""

    def __init__(self) -> None:
        self.intensity, self.photons = 0.0, 0.0
        self.error, self.header, self.warnings = 0.0, {}, ()

    def add(self, weight: float, frame: FrameResult) -> None:
        self.intensity = self.intensity + weight * frame.image.intensity.astype(np.float64)
        counted = frame.image.intensity if frame.photons is None else frame.photons
        self.photons = self.photons + weight * counted.astype(np.float64)
        self.error = float(np.maximum(self.error, frame.numerical_error))
        self.header = self.header or frame.image.header
        self.warnings = tuple(dict.fromkeys((*self.warnings, *frame.warnings)))

    def difference(self, other: _Mean) -> float:
        """Rms difference of the intensities, relative to their mean."""
        mean = float(np.mean(self.intensity))
        return float(np.sqrt(np.mean((self.intensity - other.intensity) ** 2))) / mean if mean > 0 else 0.0
