r"""A camera: from the intensity on an image sensor to the numbers that it hands out.

The signal's way through a pixel (EMVA Standard 1288, release 4.0; J. R. Janesick, *Photon Transfer*, DOI
10.1117/3.725073), electrons [e-] throughout but for the last line:

    expected   mu = (1 + prnu g) s I + dark_electrons
    charge     q  = min(Poisson(mu), full_well)
    number     DN = round(black_level + (q + read_noise n) / gain), at least 0, at most 2^bit_depth - 1

I is the intensity on the pixel's sensitive part and s the exposure, so that the mean of s I is ``mean_electrons``, or
that of a laser's ``power``, an ``exposure`` time and a ``quantum_efficiency`` (:mod:`theory.radiometry`); g and n are
standard normal numbers. g is the pixel's own and the same in every frame, the rest is drawn anew for each. Halves are
rounded to even. Where nothing is cut off a number's variance against its mean is the photon transfer curve,
``(mean - black_level) / gain + (read_noise / gain)^2 + 1/12``.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from ..errors import InputError
from ..machine.fingerprint import fingerprint

HEADROOM = 8.0
"""Full well over mean where only one of them is given: exp(-8) = 0.03 % of developed speckle is brighter."""

MEAN_ELECTRONS = 1000.0
"""Mean of an image where neither it nor the full well is given [e-]."""

_AT_ONCE = 1 << 18
"""Pixels that are read out at a time: bounds the memory that takes."""

_BRIGHTEST = 1e15
"""Electrons beyond which a Poisson number is not drawn any more: no well holds them."""


@dataclass(frozen=True)
class Camera:
    """What a detector's image goes through.

    id: the detector's, so that two cameras of one scene have noise of their own; mean_electrons: at the image's mean
    [e-], None where ``exposure`` [s] and ``quantum_efficiency`` tell it from the laser's power; full_well [e-], inf:
    never full; gain [e-/DN]; bit_depth: of the converter, 0: it has no largest number; black_level [DN]; read_noise
    [e-, rms]; fill_factor: sensitive part of a pixel's area, a square in its middle; prnu: relative rms of the pixels'
    responses; dark_electrons: mean in a frame [e-]; noise_seed: which noise.
    """

    id: str
    mean_electrons: float | None
    full_well: float
    gain: float
    bit_depth: int = 0
    black_level: float = 0.0
    read_noise: float = 0.0
    fill_factor: float = 1.0
    prnu: float = 0.0
    dark_electrons: float = 0.0
    noise_seed: int = 0
    exposure: float | None = None
    quantum_efficiency: float = 1.0

    @classmethod
    def of(cls, id: str = "", **given: float) -> Camera:
        """A camera of which some is given by the names of its parameters, the rest as follows.

        Without ``mean_electrons`` and ``exposure`` the mean is an eighth of the full well, or 1000 e-; with a
        ``bit_depth`` the full well is eight means, and the ``gain`` full_well / (2^bit_depth - 1), else 1 e-/DN.
        Raises InputError where ``mean_electrons`` and ``exposure`` are both given, or a converter's range is not known.
        """
        mean, well, exposure = (given.get(name) for name in ("mean_electrons", "full_well", "exposure"))
        bits = int(given.get("bit_depth", 0))
        if mean is not None and exposure is not None:
            raise InputError(
                f"mean_electrons is {mean:g} and exposure {exposure:g} s, must be one of them: both say how many "
                "electrons there are"
            )
        if mean is None and exposure is None:
            mean = MEAN_ELECTRONS if well is None else well / HEADROOM
        gain = given.get("gain")
        if bits and well is None and gain is None:
            if mean is None:
                raise InputError("bit_depth with exposure: must be given a full_well or a gain, too")
            well = HEADROOM * mean
        if gain is None:
            gain = well / (2**bits - 1) if bits else 1.0
        return cls(id, **given | {"mean_electrons": mean, "full_well": well or math.inf, "gain": gain})

    @property
    def white(self) -> float:
        """The converter's largest number [DN], inf where it has none."""
        return float(2**self.bit_depth - 1) if self.bit_depth else math.inf

    def to_json(self) -> dict:
        """What an image's header says of it; None for what is not limited or not given."""
        return {name: None if value == math.inf else value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Picture:
    """dn: (rows, columns) float32, whole numbers; saturated: share of pixels whose well or converter was full;
    electrons: mean of those that light was expected to free [e-]."""

    dn: np.ndarray
    saturated: float
    electrons: float


def expose(camera: Camera, intensity: np.ndarray, place: tuple, per_intensity: float | None = None) -> Picture:
    """The picture that a camera takes of an intensity (rows, columns), in any unit.

    place: plain data, of which the frame's noise is a pure function together with the camera's id and ``noise_seed``:
    another place has independent noise. per_intensity: electrons that one unit of intensity frees, needed where the
    camera states no ``mean_electrons``. An image without light shows the dark frame.
    """
    scale = _scale(camera, intensity, per_intensity)
    rows, columns = intensity.shape
    response, photons, reading = (
        _numbers(camera, *what) for what in (("response",), ("photons", place), ("reading", place))
    )
    dn, full, lit = np.empty(intensity.shape, np.float32), 0, 0.0
    step = max(1, _AT_ONCE // columns)
    for row in range(0, rows, step):
        expected = scale * intensity[row : row + step].astype(np.float64)
        if camera.prnu:
            expected *= np.maximum(1 + camera.prnu * response.standard_normal(expected.shape), 0.0)
        lit += float(expected.sum())
        expected += camera.dark_electrons
        charge = np.minimum(photons.poisson(np.minimum(expected, _BRIGHTEST)), camera.full_well).astype(np.float64)
        well_is_full = charge >= camera.full_well
        if camera.read_noise:
            charge += camera.read_noise * reading.standard_normal(expected.shape)
        numbers = np.clip(np.rint(camera.black_level + charge / camera.gain), 0.0, camera.white)
        full += int(np.count_nonzero(well_is_full | (numbers >= camera.white)))
        dn[row : row + step] = numbers
    return Picture(dn, full / dn.size, lit / dn.size)


def _scale(camera: Camera, intensity: np.ndarray, per_intensity: float | None) -> float:
    """Electrons of a pixel with the mean response for a unit of intensity."""
    if camera.mean_electrons is None:
        if per_intensity is None:
            raise InputError("the laser's power is not known, the camera must be given mean_electrons")
        return per_intensity
    mean = float(np.mean(intensity, dtype=np.float64))
    return camera.mean_electrons / mean if mean > 0 else 0.0


def _numbers(camera: Camera, *words: object) -> np.random.Generator:
    """Random numbers that are a pure function of the camera and of words, from the counter-based generator Philox."""
    key = fingerprint("camera", camera.noise_seed, camera.id, *words)
    return np.random.Generator(np.random.Philox(key=int(key, 16)))
