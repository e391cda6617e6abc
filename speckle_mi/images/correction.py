"""A camera's dark picture and flat field taken off its images, and a mask of what they say nothing about."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..measurement.defects import interpolated, without_mosaic
from .field_image import FieldImage, FieldImageError
from .pictures import read_image

LEAST_FLAT = 0.05
"""Flat field, relative to its mean, below which a pixel sees too little to be corrected."""

COLOURS = "RGB"


@dataclass(frozen=True)
class Correction:
    """What is done to every image of a camera. dark, flat: (rows, columns), None if there is none; mask: bool, False
    where the images say nothing. mosaic: colours of the filters of the first 2 x 2 pixels by row, e.g. RGGB; colour: the
    one that is used, None for all.
    """

    dark: np.ndarray | None = None
    flat: np.ndarray | None = None
    mask: np.ndarray | None = None
    mosaic: str | None = None
    colour: str | None = None

    def apply(self, image: FieldImage) -> FieldImage:
        """The image corrected. Raises FieldImageError for pictures of another size."""
        values = image.intensity
        for name, other in (("dark", self.dark), ("flat", self.flat), ("mask", self.mask)):
            if other is not None and other.shape != values.shape:
                raise FieldImageError(f"--{name}: {_size(other)} px, must be those of the images, {_size(values)} px")
        if self.dark is not None:
            values = values - self.dark
        if self.flat is not None:
            values = values / self._sensitivity()
        if self.mosaic is not None:
            values = self._one_colour(np.asarray(values, dtype=float))
        return image if values is image.intensity else replace(image, intensity=values.astype(np.float32), field=None)

    def valid(self) -> np.ndarray | None:
        """(rows, columns) bool, False where corrected images say nothing; None if they say something everywhere."""
        masks = [] if self.mask is None else [self.mask]
        if self.flat is not None:
            masks.append(self._light() > LEAST_FLAT * self._light().mean())
        return np.logical_and.reduce(masks) if masks else None

    def _light(self) -> np.ndarray:
        return self.flat if self.dark is None else self.flat - self.dark

    def _sensitivity(self) -> np.ndarray:
        light = self._light()
        relative = light / light.mean()
        return np.where(relative > LEAST_FLAT, relative, 1.0)

    def _one_colour(self, values: np.ndarray) -> np.ndarray:
        places = {(i // 2, i % 2): letter for i, letter in enumerate(self.mosaic)}
        if self.colour is not None:
            return interpolated(values, [place for place, letter in places.items() if letter == self.colour])
        means = np.array([[float(values[row::2, column::2].mean()) for column in (0, 1)] for row in (0, 1)])
        for letter in set(self.mosaic):  # filters of one colour are alike
            same = np.array([[places[row, column] == letter for column in (0, 1)] for row in (0, 1)])
            means[same] = means[same].mean()
        return without_mosaic(values, np.maximum(means, 0.0)) if means.max() > 0.0 else values


def _size(values: np.ndarray) -> str:
    return f"{values.shape[1]} x {values.shape[0]}"


def checked_mosaic(text: str | None, colour: str | None) -> tuple[str | None, str | None]:
    """A mosaic and a colour of it in capitals. Raises ValueError for what is none."""
    if text is None:
        if colour is not None:
            raise ValueError(f"--colour {colour}: must come with --bayer, the colours of the mosaic")
        return None, None
    mosaic = text.upper()
    if len(mosaic) != 4 or set(mosaic) - set(COLOURS):
        raise ValueError(f"--bayer {text}: must be the colours of the first 2 x 2 pixels by row, as RGGB, BGGR, GRBG or GBRG")
    if colour is not None and colour.upper() not in mosaic:
        raise ValueError(f"--colour {colour}: must be one of the mosaic's, {', '.join(sorted(set(mosaic)))}")
    return mosaic, None if colour is None else colour.upper()


def read_correction(
    dark: str | os.PathLike | None,
    flat: str | os.PathLike | None,
    mask: str | os.PathLike | None,
    mosaic: str | None = None,
    colour: str | None = None,
    read: Callable = read_image,
) -> Correction:
    """Reads the pictures of a correction. Raises ValueError, in one line, for what cannot be one."""
    mosaic, colour = checked_mosaic(mosaic, colour)
    dark, flat, mask = (None if path is None else read(path).intensity for path in (dark, flat, mask))
    for name, values in (("dark", dark), ("flat", flat), ("mask", mask)):
        if values is not None and not np.isfinite(values).all():
            raise ValueError(f"--{name}: holds pixels that are NaN or infinite, all must be finite")
    if mask is not None and not mask.any():
        raise ValueError("--mask: is black everywhere, must be white (not 0) where the images are to be looked at")
    found = Correction(dark, flat, None if mask is None else mask > 0, mosaic, colour)
    if flat is not None and not (dark is not None and dark.shape != flat.shape) and not found._light().mean() > 0.0:
        raise ValueError("--flat: is not brighter than the dark picture, must be a picture of even light")
    return found
