"""What a camera adds to every picture at the same place: hot and dead pixels, columns and rows, a colour mosaic.

They stand still when the pattern moves and pull its shift to zero. A defect stands out from its neighbours by more
than any texture of the image does; what two images share at one place is the camera's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

STANDS_OUT = ((1.0, 6.0), (3.0, 10.0))
"""Least excess of a defect over its neighbours 1 and 2 px away, relative to them and the mean: of coarse speckle, and
what is added for each unit of the excess that the texture has. Clean speckle of 2 px and more, with 10 photons a pixel
and more, stays below it."""

TEXTURE_SHARE = 0.98
"""Quantile of the excess that is the texture's: above the share of pixels that may be defects."""

BRIGHT, DARK = 4.0, 0.1
"""Least brightness of a hot pixel and largest of a dead one, relative to the mean."""

FARTHEST = 2
"""Distance of the farthest neighbours that a pixel is compared with [px]."""

SAMPLES = 4_000
"""Pixels by which the texture is judged."""

LOCAL = 12
"""Half side of the neighbourhood whose mean a dead pixel is judged by [px]."""

LINE = 10.0
"""Excess of a defective column or row over its neighbours, in standard deviations of all columns' excess."""

LINE_SPREAD = 2.0
"""The same in standard deviations of the columns' means."""

MOST = 0.015
"""Share of the pixels beyond which what stands out is texture and no defect."""

MOSAIC_Z, MOSAIC_DIFFERENCE = 8.0, 0.02
"""Difference of the means of the four sublattices that a mosaic has, in standard errors and relative to the mean."""

BRIGHT_ENOUGH = 0.25
"""Sensitivity of a colour, relative to the most sensitive, at which its pixels are evened out and not replaced."""


@dataclass(frozen=True)
class Usual:
    """What few pixels of an image exceed by its texture alone: excess over the pixels 1 and 2 px away, and
    deficit, over the mean, against those 1 px away."""

    excess: tuple[float, float]
    deficit: float


@dataclass(frozen=True)
class Defects:
    """pixels: (rows, columns) bool, True where one stands out; columns, rows: lines that do; usual: what does not."""

    pixels: np.ndarray
    columns: tuple[int, ...] = ()
    rows: tuple[int, ...] = ()
    usual: Usual | None = None

    @property
    def mask(self) -> np.ndarray:
        """(rows, columns) bool, True at everything that stands out."""
        found = self.pixels.copy()
        found[:, list(self.columns)] = True
        found[list(self.rows), :] = True
        return found

    @property
    def any(self) -> bool:
        return bool(self.columns or self.rows or self.pixels.any())

    def shared(self, other: Defects) -> Defects:
        """What stands out in both."""
        columns, rows = (
            tuple(sorted({*a} & {*b})) for a, b in ((self.columns, other.columns), (self.rows, other.rows))
        )
        return Defects(self.pixels & other.pixels, columns, rows)

    def __str__(self) -> str:
        counts = (int(self.pixels.sum()), "pixel"), (len(self.columns), "column"), (len(self.rows), "row")
        return ", ".join(f"{n} {name}{'s' * (n > 1)}" for n, name in counts if n)


def _border(reach: int) -> list[tuple[int, int]]:
    """Offsets (v, u) of the pixels on the border of a square of half side ``reach``."""
    span = range(-reach, reach + 1)
    return [(v, u) for v in span for u in span if max(abs(v), abs(u)) == reach]


class _Pixels:
    """The pixels of an image with those around them, mirrored at its edges. Places are one number each."""

    def __init__(self, image: np.ndarray) -> None:
        margin = [FARTHEST if n > 1 else 0 for n in image.shape]
        self.shape = tuple(n + 2 * m for n, m in zip(image.shape, margin))
        self._inside = tuple(slice(m, n - m) for m, n in zip(margin, self.shape))
        padded = np.empty(self.shape)  # as `numpy.pad`, which takes longer
        padded[self._inside] = image
        for axis, (m, n) in enumerate(zip(margin, image.shape)):
            lead = padded if axis == 0 else padded.T
            for outside in range(1, m + 1):
                lead[m - outside] = lead[m + outside % n]
                lead[m + n - 1 + outside] = lead[m + abs(n - 1 - outside)]
        self._width, self._values = self.shape[1], padded.ravel()
        # Across a single row or column nothing is beside a pixel.
        self.borders = {
            reach: [
                (v * self._width + u) for v, u in _border(reach) if all(m or not o for m, o in zip(margin, (v, u)))
            ]
            for reach in (1, 2)
        }

    def where(self, condition: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Places of the image at whose values a condition holds."""
        inside = np.zeros(self.shape, dtype=bool)
        inside[self._inside] = condition(self._values.reshape(self.shape)[self._inside])
        return np.flatnonzero(inside)

    def at(self, places: np.ndarray, step: int = 0) -> np.ndarray:
        return self._values.take(places + step)

    def every(self, stride: int) -> np.ndarray:
        """Places of the image's pixels number 0, stride, ... in the order of its rows."""
        rows, columns = (s.stop - s.start for s in self._inside)
        v, u = np.divmod(np.arange(0, rows * columns, stride), columns)
        return (v + self._inside[0].start) * self._width + u + self._inside[1].start

    def coordinates(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(v, u) in the image."""
        v, u = np.divmod(places, self._width)
        return v - self._inside[0].start, u - self._inside[1].start


def _usual(pixels: _Pixels, count: int, level: float) -> Usual:
    places = pixels.every(max(1, count // SAMPLES) | 1)
    own = pixels.at(places)
    around = {reach: np.array([pixels.at(places, step) for step in steps]) for reach, steps in pixels.borders.items()}
    excess = [np.min((own - a) / (np.abs(a) + level), axis=0) for a in around.values()]
    deficit = (np.min(around[1], axis=0) - own) / level
    return Usual(
        tuple(float(np.quantile(e, TEXTURE_SHARE)) for e in excess), float(np.quantile(deficit, TEXTURE_SHARE))
    )


def _least(reach: int, usual: float) -> float:
    of_coarse, by_texture = STANDS_OUT[reach - 1]
    return of_coarse + by_texture * max(usual, 0.0)


def _outliers(pixels: _Pixels, level: float, places: np.ndarray, reach: int, usual: float) -> np.ndarray:
    """Those of the places above all on a border around them by more than texture explains."""
    least, own = _least(reach, usual), pixels.at(places)
    for step in pixels.borders[reach]:  # few are left after the first
        around = pixels.at(places, step)
        kept = np.flatnonzero(own - around > least * (np.abs(around) + level))
        places, own = places[kept], own[kept]
    return places


def _quantile(values: np.ndarray, share: float) -> float:
    """As `numpy.quantile`, which takes many times longer for few values."""
    place = share * (values.size - 1)
    below = int(place)
    above = min(below + 1, values.size - 1)
    parted = np.partition(values, (below, above))
    return float(parted[below] + (place - below) * (parted[above] - parted[below]))


def _bad_lines(image: np.ndarray, axis: int) -> tuple[int, ...]:
    """Columns (axis 0) or rows (axis 1) whose mean stands out from their neighbours'."""
    if min(image.shape) < 16:
        return ()
    profile = image.mean(axis=axis)
    excess = profile - ndimage.median_filter(profile, 5, mode="reflect")
    scale = 1.4826 * _quantile(np.abs(excess), 0.5)
    # Of speckle many columns are their own median; their other columns then give the scale.
    clipped = np.minimum(np.maximum(excess, _quantile(excess, 0.02)), _quantile(excess, 0.98))
    scale = max(scale, math.sqrt(float(clipped @ clipped) / clipped.size))
    # Of coarse speckle the profile is smooth, but not even.
    spread = 1.4826 * _quantile(np.abs(profile - _quantile(profile, 0.5)), 0.5)
    found = (
        np.flatnonzero(np.abs(excess) > max(LINE * scale, LINE_SPREAD * spread)) if scale > 0.0 else np.zeros(0, int)
    )
    return tuple(int(i) for i in found) if found.size <= MOST * profile.size else ()


def defects_of(image: np.ndarray, usual: Usual | None = None) -> Defects:
    """What stands out from its neighbours in one image of intensity (rows, columns).

    usual: of another image of the same texture, so that it need not be found again.
    """
    mask = np.zeros(image.shape, dtype=bool)
    level = float(np.abs(image).mean())
    if level <= 0.0 or max(image.shape) < 8:
        return Defects(mask)
    pixels = _Pixels(image)
    usual = usual or _usual(pixels, image.size, level)
    bright = pixels.where(lambda values: values > BRIGHT * level)
    found = [_outliers(pixels, level, bright, reach, excess) for reach, excess in zip((1, 2), usual.excess)]
    for places in (*found, _dead(image, pixels, level, usual.deficit)):
        mask[pixels.coordinates(places)] = True
    if np.count_nonzero(mask) > MOST * mask.size:
        mask[:] = False
    clean = repaired(image, mask) if mask.any() else image
    return Defects(mask, _bad_lines(clean, 0), _bad_lines(clean, 1), usual)


def _dead(image: np.ndarray, pixels: _Pixels, level: float, usual: float) -> np.ndarray:
    """Places of pixels below all of their neighbours by more than the texture explains."""
    least = _least(1, usual)
    places = pixels.where(lambda values: values < DARK * level)
    own = pixels.at(places)
    for step in pixels.borders[1]:
        kept = np.flatnonzero(pixels.at(places, step) - own > least * level)
        places, own = places[kept], own[kept]
    if not places.size:
        return places
    # Where the light is uneven the level is that of the neighbourhood.
    local = [
        image[max(0, i - LOCAL) : i + LOCAL + 1, max(0, j - LOCAL) : j + LOCAL + 1].mean()
        for i, j in zip(*pixels.coordinates(places))
    ]
    around = np.min([pixels.at(places, step) for step in pixels.borders[1]], axis=0)
    return places[around - own > least * np.array(local)]


def repaired(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """``image`` with the pixels of ``mask`` continued smoothly from those around them.

    Few pixels by the biharmonic equation (`skimage.restoration.inpaint_biharmonic`), which keeps a speckle's
    curvature; large regions by a smooth mean, which is all that is to be had.
    """
    if not mask.any() or mask.all():
        return image
    from skimage.restoration import inpaint_biharmonic

    wide = ndimage.binary_opening(mask, np.ones((4, 4)))
    wide = ndimage.binary_propagation(wide, mask=mask)
    image = image.copy()
    if wide.any():
        image[wide] = _smooth_filling(image, mask)[wide]
    narrow = mask & ~wide
    if narrow.any():
        for place in _patches(narrow):
            patch, holes = image[place], narrow[place]
            scale = float(np.abs(patch[~holes]).max(initial=0.0)) or 1.0
            filled = inpaint_biharmonic(np.where(holes, 0.0, patch) / scale, holes) * scale
            image[place] = np.where(holes, filled, patch)
    return image


def _patches(mask: np.ndarray, reach: int = 4) -> list[tuple[slice, slice]]:
    """Pieces of the image that hold the masked regions and what is around them."""
    grown = ndimage.binary_dilation(mask, np.ones((2 * reach + 1, 2 * reach + 1)))
    return ndimage.find_objects(ndimage.label(grown)[0])


def _smooth_filling(image: np.ndarray, mask: np.ndarray, sigma: float = 4.0) -> np.ndarray:
    known = np.where(mask, 0.0, 1.0)
    filling = float(image[~mask].mean())
    while True:
        weight = ndimage.gaussian_filter(known, sigma)
        total = ndimage.gaussian_filter(np.where(mask, 0.0, image), sigma)
        if (weight > 1e-3).all() or sigma > max(image.shape):
            return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), filling)
        sigma *= 2.0


def sublattices(image: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """The four images of every second pixel, by the (row, column) of their first."""
    return {(row, column): image[row::2, column::2] for row in (0, 1) for column in (0, 1)}


def mosaic_gains(image: np.ndarray) -> np.ndarray | None:
    """Means (2, 2) of every second pixel over the largest of them where they tell of a colour filter mosaic, else None.

    A pattern on a grey sensor has the same mean on all four.
    """
    rows, columns = (n - n % 2 for n in image.shape)
    if rows < 16 or columns < 16:
        return None
    halves = [image[row:rows:2, :columns].sum(axis=0) for row in (0, 1)]  # as their numbers lie in memory
    rough = np.array([half[column::2].sum() for half in halves for column in (0, 1)]) / (rows * columns / 4)
    if not np.any(np.abs(rough - rough.mean()) > MOSAIC_DIFFERENCE * rough.mean()):
        return None
    cells = image[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2).transpose(1, 3, 0, 2)
    mean = cells.mean(axis=(0, 1))
    total = float(mean.mean())
    if total <= 0.0:
        return None
    means = cells.mean(axis=(2, 3))
    # Neighbouring cells of one speckle are no independent proof: blocks of 8 cells are compared.
    blocks = [(n // 8) * 8 for n in mean.shape]
    if min(blocks) < 8:
        return None
    difference = (cells - mean)[:, :, : blocks[0], : blocks[1]]
    parts = difference.reshape(2, 2, blocks[0] // 8, 8, blocks[1] // 8, 8).mean(axis=(3, 5))
    error = parts.std(axis=(2, 3)) / math.sqrt(max(parts[0, 0].size - 1, 1))
    apart = np.abs(means - total)
    if not np.any((apart > MOSAIC_Z * error) & (apart > MOSAIC_DIFFERENCE * total)):
        return None
    return means / means.max()


def without_mosaic(image: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """The pattern that a sensor with filters of these ``gains`` (2, 2) saw, on all pixels.

    Laser light has one colour, so every pixel sees the same pattern: its values are divided by its filter's gain.
    Where that is small, what the others see is interpolated.
    """
    gains = gains / gains.max()
    even = np.array(image, dtype=float)
    bright = gains >= BRIGHT_ENOUGH
    for (row, column), part in sublattices(even).items():
        part /= gains[row, column] if bright[row, column] else 1.0
    if bright.all():
        return even
    return interpolated(even, [tuple(int(i) for i in place) for place in np.argwhere(bright)])


def interpolated(image: np.ndarray, places: list[tuple[int, int]]) -> np.ndarray:
    """The pattern on all pixels from every second one, of the sublattices at ``places`` (row, column)."""
    total = np.zeros(image.shape)
    for row, column in places:
        v, u = ((np.arange(n) - first) / 2 for n, first in zip(image.shape, (row, column)))
        coefficients = ndimage.spline_filter(image[row::2, column::2].astype(float), 5, mode="mirror")
        total += ndimage.map_coordinates(
            coefficients, np.meshgrid(v, u, indexing="ij"), order=5, mode="mirror", prefilter=False
        )
    return total / len(places)
