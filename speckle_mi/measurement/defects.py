"""What a camera adds to every picture at the same place: hot and dead pixels, columns and rows, a colour mosaic.

They stand still when the pattern moves and pull its shift to zero. A defect stands out from its neighbours by more
than any texture of the image does; what two images share at one place is the camera's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

STANDS_OUT = 0.8
"""Least excess of a defect over its brightest neighbour, relative to that and the mean: speckle of 2 px has 0.6."""

BEYOND_TEXTURE = 3.0
"""Excess of a defect over that of one pixel in a thousand of the image."""

SAMPLES = 20_000
"""Pixels by which the texture is judged."""

LOCAL = 12
"""Half side of the neighbourhood whose mean a dead pixel is judged by [px]."""

LINE = 10.0
"""Excess of a defective column or row over its neighbours, in standard deviations of all columns' excess."""

MOST = 0.02
"""Share of the pixels beyond which what stands out is texture and no defect."""

MOSAIC_Z, MOSAIC_DIFFERENCE = 8.0, 0.02
"""Difference of the means of the four sublattices that a mosaic has, in standard errors and relative to the mean."""

BRIGHT_ENOUGH = 0.25
"""Sensitivity of a colour, relative to the most sensitive, at which its pixels are evened out and not replaced."""


@dataclass(frozen=True)
class Defects:
    """pixels: (rows, columns) bool, True where a pixel stands out; columns, rows: lines that do."""

    pixels: np.ndarray
    columns: tuple[int, ...] = ()
    rows: tuple[int, ...] = ()

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
        columns, rows = (tuple(sorted({*a} & {*b})) for a, b in ((self.columns, other.columns), (self.rows, other.rows)))
        return Defects(self.pixels & other.pixels, columns, rows)

    def united(self, other: Defects) -> Defects:
        columns, rows = (tuple(sorted({*a} | {*b})) for a, b in ((self.columns, other.columns), (self.rows, other.rows)))
        return Defects(self.pixels | other.pixels, columns, rows)

    def __str__(self) -> str:
        counts = (int(self.pixels.sum()), "pixel"), (len(self.columns), "column"), (len(self.rows), "row")
        return ", ".join(f"{n} {name}{'s' * (n > 1)}" for n, name in counts if n)


def _largest_neighbour(image: np.ndarray, reach: int) -> np.ndarray:
    """The largest pixel on the border of the square of half side ``reach`` around each pixel, mirrored at the edges."""
    padded = np.pad(image, [(reach, reach) if n > reach else (0, 0) for n in image.shape], mode="reflect")
    largest = np.full(image.shape, -np.inf)
    for axis in (0, 1):
        n, other = image.shape[axis], image.shape[1 - axis]
        if n <= reach:
            continue
        lead = np.moveaxis(padded, axis, 0)
        sides = np.maximum(lead[:n], lead[2 * reach : 2 * reach + n])
        across = range(2 * reach + 1) if other > reach else (0,)
        for shift in across:
            np.maximum(largest, np.moveaxis(sides[:, shift : shift + other], 0, axis), out=largest)
    return largest


def _outliers(image: np.ndarray, level: float, reach: int) -> np.ndarray:
    """Pixels above everything on a border around them by more than the image's texture explains."""
    around = _largest_neighbour(image, reach)
    excess = (image - around) / (np.abs(around) + level)
    sample = excess.ravel()[:: max(1, excess.size // SAMPLES) | 1]
    usual = max(0.0, float(np.quantile(sample, 0.999)))
    return excess > max(STANDS_OUT, BEYOND_TEXTURE * usual)


def _bad_lines(image: np.ndarray, axis: int) -> tuple[int, ...]:
    """Columns (axis 0) or rows (axis 1) whose mean stands out from their neighbours'."""
    if min(image.shape) < 16:
        return ()
    profile = image.mean(axis=axis)
    excess = profile - ndimage.median_filter(profile, 5, mode="reflect")
    scale = 1.4826 * float(np.median(np.abs(excess)))
    # Of speckle many columns are their own median; their other columns then give the scale.
    scale = max(scale, float(np.sqrt(np.mean(np.square(np.clip(excess, *np.quantile(excess, [0.02, 0.98])))))))
    found = np.flatnonzero(np.abs(excess) > LINE * scale) if scale > 0.0 else np.zeros(0, int)
    return tuple(int(i) for i in found) if found.size <= MOST * profile.size else ()


def defects_of(image: np.ndarray) -> Defects:
    """What stands out from its neighbours in one image of intensity (rows, columns)."""
    none = np.zeros(image.shape, dtype=bool)
    level = float(np.abs(image).mean())
    if level <= 0.0 or max(image.shape) < 8:
        return Defects(none)
    pixels = _outliers(image, level, 1)
    pixels |= _outliers(image, level, 2)
    pixels |= _dead(image, level)
    if np.count_nonzero(pixels) > MOST * pixels.size:
        pixels = none
    clean = repaired(image, pixels) if pixels.any() else image
    return Defects(pixels, _bad_lines(clean, 0), _bad_lines(clean, 1))


def _dead(image: np.ndarray, level: float) -> np.ndarray:
    """Pixels below all of their neighbours by more than the texture explains."""
    around = -_largest_neighbour(-image, 1)
    excess = (around - image) / level
    sample = excess.ravel()[:: max(1, excess.size // SAMPLES) | 1]
    found = excess > max(STANDS_OUT, BEYOND_TEXTURE * max(0.0, float(np.quantile(sample, 0.999))))
    for v, u in np.argwhere(found):  # where the light is uneven the level is that of the neighbourhood
        near = image[max(0, v - LOCAL) : v + LOCAL + 1, max(0, u - LOCAL) : u + LOCAL + 1]
        found[v, u] = around[v, u] - image[v, u] > STANDS_OUT * float(near.mean())
    return found


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
    return [place for place in ndimage.find_objects(ndimage.label(grown)[0])]


def _smooth_filling(image: np.ndarray, mask: np.ndarray, sigma: float = 4.0) -> np.ndarray:
    known = np.where(mask, 0.0, 1.0)
    filling = np.full(image.shape, float(image[~mask].mean()))
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
        v, u = (
            (np.arange(n) - first) / 2 for n, first in zip(image.shape, (row, column))
        )
        coefficients = ndimage.spline_filter(image[row::2, column::2].astype(float), 5, mode="mirror")
        total += ndimage.map_coordinates(
            coefficients, np.meshgrid(v, u, indexing="ij"), order=5, mode="mirror", prefilter=False
        )
    return total / len(places)
