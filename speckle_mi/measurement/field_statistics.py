"""What one image says of its light: statistics of the speckle, the law of its intensity, the spectrum of the field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .speckle_statistics import centre_of_gravity, contrast_and_size, speckle_count

_BINS, _BRIGHTEST = 60, 12.0
"""Bins of the intensity's law, and how many means it is looked at."""


@dataclass(frozen=True)
class FieldStatistics:
    """contrast: standard deviation over mean, 1 of developed speckle; size: (2,) full width at half maximum of the
    intensity's correlation along u and v [px]; speckles: how many the image holds; centre: (2,) of gravity from the
    image's middle [px]; mean, largest: intensity; law: (levels, densities), (k,) each, of the intensity over its mean;
    a statistic that the image cannot give is NaN.
    """

    contrast: float
    size: tuple[float, float]
    speckles: float
    centre: tuple[float, float]
    mean: float
    largest: float
    law: tuple[np.ndarray, np.ndarray]

    def to_json(self, pitch: float | None) -> dict:
        """Plain data, None for what the image cannot give; lengths in um too, where the ``pitch`` [mm] is known."""
        said = {"contrast": self.contrast, "speckle_size_px": [*self.size], "speckles": self.speckles,
                "centre_px": [*self.centre], "mean": self.mean, "largest": self.largest}  # fmt: skip
        if pitch is not None:
            um = 1e3 * pitch
            said |= {"speckle_size_um": [um * one for one in self.size], "centre_um": [um * one for one in self.centre]}
        return {name: _plain(value) for name, value in said.items()}


def _plain(value: float | list[float]) -> float | list[float | None] | None:
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return value if math.isfinite(value) else None


def field_statistics(intensity: np.ndarray) -> FieldStatistics:
    """Of an intensity (rows, columns). Raises InputError for pixels that are not finite."""
    centre = centre_of_gravity(intensity)
    contrast, size = contrast_and_size(intensity)
    mean = float(np.mean(intensity, dtype=np.float64))
    relative = np.asarray(intensity, dtype=np.float64).ravel() / mean if mean > 0 else np.zeros(1)
    counts, edges = np.histogram(relative, _BINS, (0.0, _BRIGHTEST))
    law = 0.5 * (edges[1:] + edges[:-1]), counts / (relative.size * np.diff(edges))
    return FieldStatistics(
        contrast, size, speckle_count(intensity), centre, mean, float(np.max(intensity)), law
    )


def power_spectrum(values: np.ndarray) -> np.ndarray:
    """Power (rows, columns) of the spatial frequencies of a field or an intensity over its largest, 0 in the middle.

    A Hann window keeps the image's edges from adding frequencies of their own.
    """
    rows, columns = (np.hanning(count + 2)[1:-1] for count in values.shape)
    values = values - values.mean() if not np.iscomplexobj(values) else values
    power = np.abs(np.fft.fftshift(np.fft.fft2(values * rows[:, None] * columns))) ** 2
    largest = float(power.max())
    return power / largest if largest > 0 else power
