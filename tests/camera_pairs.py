"""Pairs of pictures as a camera takes them: everything that stands between the light on a sensor and the numbers.

A pair is a function of its number alone. What moves is exactly shifted speckle; what stands still is the camera's own
and that of the light: gain of every pixel, offsets, hot pixels, dust on the window, a beam's envelope, ambient light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from speckle_mi.validation.shifts.speckle import shifted_pair

SIDE, WINDOW = 132, 64
"""Side of the pictures and of the window that is followed [px]."""

ELECTRONS = 10.0, 10_000.0
"""Mean of a pixel, least and most [e]."""

UNRELATED_EVERY = 5
"""Every so many pairs show two patterns that have nothing in common but the camera."""


@dataclass(frozen=True)
class CameraPair:
    """Two pictures (rows, columns) in counts, the shift (u, v) [px] between them, None if they are unrelated, and what
    made them: mean electrons, speckle size [px], correlation of the light, and what stands still."""

    reference: np.ndarray
    moved: np.ndarray
    shift: tuple[float, float] | None
    electrons: float
    size: float
    correlation: float
    still: str


def camera_pair(number: int) -> CameraPair:
    random = np.random.default_rng([number, 16])
    size = float(np.exp(random.uniform(np.log(2.1), np.log(8.0))))
    electrons = float(np.exp(random.uniform(*np.log(ELECTRONS))))
    reach = random.choice([1.5, 6.0, 25.0])
    shift = tuple(float(s) for s in random.uniform(-reach, reach, 2))
    unrelated = number % UNRELATED_EVERY == UNRELATED_EVERY - 1
    correlation = 1.0 if random.random() < 0.5 else float(random.uniform(0.6, 1.0))
    before, after = shifted_pair((SIDE, SIDE), size, shift, number, correlation)
    if unrelated:
        after = shifted_pair((SIDE, SIDE), size, (0.0, 0.0), number + 1_000_000)[0]
    camera, still = _camera(random, electrons, _uneven_gain(random, size) if unrelated else None)
    pictures = [camera(light) for light in (before, after)]
    return CameraPair(*pictures, None if unrelated else shift, electrons, size, correlation, still)


def _uneven_gain(random: np.random.Generator, size: float) -> np.ndarray | None:
    """A gain of +-50 % as coarse as the speckle or up to four times as coarse, as a window full of dust has it; or
    none."""
    width = random.choice([0.0, 1.0, 2.0, 4.0]) * size
    if not width:
        return None
    field = ndimage.gaussian_filter(random.standard_normal((SIDE, SIDE)), width / 2.355, mode="wrap")
    return np.maximum(1 + 0.5 * field / field.std(), 0.05)


def _camera(random: np.random.Generator, electrons: float, uneven: np.ndarray | None):
    """A camera before which light of mean 1 is held, and words on what stands still in its pictures."""
    v, u = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    words = [] if uneven is None else ["gain"]
    light = np.ones((SIDE, SIDE)) if uneven is None else uneven
    if random.random() < 0.4:
        centre, radius = random.uniform(-15, 15, 2), SIDE * random.uniform(0.35, 0.8)
        light = light * np.exp(-((v - centre[0]) ** 2 + (u - centre[1]) ** 2) / (2 * radius**2))
        words.append("beam")
    for _ in range(random.choice([0, 0, 1, 3])):
        centre, radius = random.uniform(-50, 50, 2), random.uniform(2, 8)
        edge = 1 / (1 + np.exp(np.hypot(v - centre[0], u - centre[1]) - radius))
        light = light * (1 - random.uniform(0.05, 0.5) * edge)
        words.append("dust")
    ambient = random.choice([0.0, 0.1]) * (1 + 0.5 * u / SIDE)
    gain = 1 + random.uniform(0.002, 0.015) * random.standard_normal((SIDE, SIDE))
    offsets = random.uniform(0.0, 0.3) * random.standard_normal((SIDE, SIDE))
    read_noise = random.uniform(0.5, 3.0)
    full_well = random.uniform(5.0, 20.0) * electrons
    levels = 2 ** int(random.choice([8, 10, 12, 14])) - 1
    black = round(0.02 * levels)
    hot = np.zeros((SIDE, SIDE))
    count = int(random.choice([0, 0, 2, 12]))
    hot[tuple(random.integers(0, SIDE, (2, count)))] = full_well * random.uniform(0.2, 1.0, count)
    words += ["hot"] * bool(count)

    def picture(speckle: np.ndarray) -> np.ndarray:
        expected = electrons * gain * (light * speckle + ambient) + hot
        seen = random.poisson(np.maximum(expected, 0.0)) + offsets + read_noise * random.standard_normal((SIDE, SIDE))
        counts = black + np.clip(seen, None, full_well) / full_well * (levels - black)
        return np.clip(np.round(counts), 0, levels)

    return picture, " ".join(words)
