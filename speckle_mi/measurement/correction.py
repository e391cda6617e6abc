"""A camera's dark picture and flat field taken off its images, and a mask of what they say nothing about."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import InputError
from .defects import interpolated, sublattices, without_mosaic

LEAST_FLAT = 0.05
"""Flat field, relative to its mean, below which a pixel sees too little to be corrected."""

COLOURS = "RGB"


@dataclass(frozen=True)
class Correction:
    """What is done to every image of a camera. dark, flat: (rows, columns), None if there is none; mask: bool, False
    where the images say nothing. mosaic: colours of the filters of the first 2 x 2 pixels by row, e.g. RGGB; colour:
    the one that is used, None for all.
    """

    dark: np.ndarray | None = None
    flat: np.ndarray | None = None
    mask: np.ndarray | None = None
    mosaic: str | None = None
    colour: str | None = None

    def apply(self, values: np.ndarray) -> np.ndarray:
        """An image (rows, columns) corrected. Raises InputError where a picture of the correction has another size."""
        for name, other in (("dark", self.dark), ("flat", self.flat), ("mask", self.mask)):
            if other is not None and other.shape != values.shape:
                raise InputError(f"--{name}: {_size(other)} px, must be those of the images, {_size(values)} px")
        if self.dark is not None:
            values = values - self.dark
        if self.flat is not None:
            values = values / self._sensitivity
        if self.mosaic is not None:
            values = self._one_colour(np.asarray(values, dtype=float))
        return values

    def valid(self) -> np.ndarray | None:
        """(rows, columns) bool, False where corrected images say nothing; None if they say something everywhere."""
        masks = [] if self.mask is None else [self.mask]
        if self.flat is not None:
            masks.append(self.light > LEAST_FLAT * self.light.mean())
        return np.logical_and.reduce(masks) if masks else None

    @cached_property
    def light(self) -> np.ndarray:
        """The flat field less the dark picture, where there is a flat field."""
        return self.flat if self.dark is None else self.flat - self.dark

    @cached_property
    def _sensitivity(self) -> np.ndarray:
        relative = self.light / self.light.mean()
        return np.where(relative > LEAST_FLAT, relative, 1.0)

    def _one_colour(self, values: np.ndarray) -> np.ndarray:
        parts = sublattices(values)
        if self.colour is not None:
            return interpolated(values, [place for place, letter in zip(parts, self.mosaic) if letter == self.colour])
        means = np.array([part.mean() for part in parts.values()]).reshape(2, 2)
        letters = np.array(list(self.mosaic)).reshape(2, 2)
        for letter in set(self.mosaic):  # filters of one colour are alike
            means[letters == letter] = means[letters == letter].mean()
        return without_mosaic(values, np.maximum(means, 0.0)) if means.max() > 0.0 else values


def _size(values: np.ndarray) -> str:
    return f"{values.shape[1]} x {values.shape[0]}"


def checked_mosaic(text: str | None, colour: str | None) -> tuple[str | None, str | None]:
    """A mosaic and a colour of it in capitals. Raises InputError for what is none."""
    if text is None:
        if colour is not None:
            raise InputError(f"--colour {colour}: must come with --bayer, the colours of the mosaic")
        return None, None
    mosaic = text.upper()
    if len(mosaic) != 4 or set(mosaic) - set(COLOURS):
        raise InputError(
            f"--bayer {text}: must be the colours of the first 2 x 2 pixels by row, as RGGB, BGGR, GRBG or GBRG"
        )
    if colour is not None and colour.upper() not in mosaic:
        raise InputError(f"--colour {colour}: must be one of the mosaic's, {', '.join(sorted(set(mosaic)))}")
    return mosaic, None if colour is None else colour.upper()


def read_correction(
    read: Callable[[str], np.ndarray],
    dark: str | None,
    flat: str | None,
    mask: str | None,
    mosaic: str | None = None,
    colour: str | None = None,
) -> Correction:
    """The correction by pictures that ``read`` gives (rows, columns) by name. Raises InputError for what is none."""
    mosaic, colour = checked_mosaic(mosaic, colour)
    dark, flat, mask = (None if name is None else read(name) for name in (dark, flat, mask))
    for name, values in (("dark", dark), ("flat", flat), ("mask", mask)):
        if values is not None and not np.isfinite(values).all():
            raise InputError(f"--{name}: holds pixels that are NaN or infinite, all must be finite")
    if mask is not None and not mask.any():
        raise InputError("--mask: is black everywhere, must be white (not 0) where the images are to be looked at")
    found = Correction(dark, flat, None if mask is None else mask > 0, mosaic, colour)
    if flat is not None and not (dark is not None and dark.shape != flat.shape) and not found.light.mean() > 0.0:
        raise InputError("--flat: is not brighter than the dark picture, must be a picture of even light")
    return found
