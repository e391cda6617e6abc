"""What a camera adds to every picture at the same place: hot and dead pixels, columns and rows, a colour mosaic.

They stand still when the pattern moves and pull its shift to zero. A defect stands out from its neighbours by more
than any texture of the image does; what two images share at one place is the camera's.
"""

from __future__ import annotations

import math
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


def _neighbour(image: np.ndarray, v: np.ndarray, u: np.ndarray, offset: tuple[int, int]) -> np.ndarray:
    """Pixels at an offset from (v, u), mirrored at the image's edges."""
    places = []
    for place, step, n in zip((v, u), offset, image.shape):
        place = np.abs(place + step)
        places.append(np.minimum(place, 2 * n - 2 - place) if n > abs(step) else np.zeros_like(place))
    return image[tuple(places)]


def _offsets(image: np.ndarray, reach: int) -> list[tuple[int, int]]:
    return [o for o in _border(reach) if all(n > 1 or step == 0 for n, step in zip(image.shape, o))]


def _excess(image: np.ndarray, level: float, place: tuple[np.ndarray, np.ndarray], offset: tuple[int, int]):
    """How far pixels are above a neighbour, relative to it and the mean."""
    around = _neighbour(image, *place, offset)
    return (image[place] - around) / (np.abs(around) + level)


def _where(condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (v, u) at which an image is true: as `numpy.nonzero`, which takes longer."""
    return np.divmod(np.flatnonzero(condition), condition.shape[1])


def _usual(image: np.ndarray, level: float) -> Usual:
    place = np.divmod(np.arange(0, image.size, max(1, image.size // SAMPLES) | 1), image.shape[1])
    excess = [np.min([_excess(image, level, place, o) for o in _offsets(image, reach)], axis=0) for reach in (1, 2)]
    darkest = np.min([_neighbour(image, *place, o) for o in _offsets(image, 1)], axis=0)
    deficit = (darkest - image[place]) / level
    return Usual(
        tuple(float(np.quantile(e, TEXTURE_SHARE)) for e in excess), float(np.quantile(deficit, TEXTURE_SHARE))
    )


def _least(reach: int, usual: float) -> float:
    of_coarse, by_texture = STANDS_OUT[reach - 1]
    return of_coarse + by_texture * max(usual, 0.0)


def _outliers(
    image: np.ndarray, level: float, place: tuple[np.ndarray, np.ndarray], reach: int, usual: float
) -> tuple[np.ndarray, np.ndarray]:
    """Those of the places (v, u) above all on a border around them by more than texture explains."""
    least = _least(reach, usual)
    for offset in _offsets(image, reach):  # few are left after the first
        kept = _excess(image, level, place, offset) > least
        place = place[0][kept], place[1][kept]
    return place


def _bad_lines(image: np.ndarray, axis: int) -> tuple[int, ...]:
    """Columns (axis 0) or rows (axis 1) whose mean stands out from their neighbours'."""
    if min(image.shape) < 16:
        return ()
    profile = image.mean(axis=axis)
    excess = profile - ndimage.median_filter(profile, 5, mode="reflect")
    scale = 1.4826 * float(np.median(np.abs(excess)))
    # Of speckle many columns are their own median; their other columns then give the scale.
    scale = max(scale, float(np.sqrt(np.mean(np.square(np.clip(excess, *np.quantile(excess, [0.02, 0.98])))))))
    # Of coarse speckle the profile is smooth, but not even.
    spread = 1.4826 * float(np.median(np.abs(profile - np.median(profile))))
    found = (
        np.flatnonzero(np.abs(excess) > max(LINE * scale, LINE_SPREAD * spread)) if scale > 0.0 else np.zeros(0, int)
    )
    return tuple(int(i) for i in found) if found.size <= MOST * profile.size else ()


def defects_of(image: np.ndarray, usual: Usual | None = None) -> Defects:
    """What stands out from its neighbours in one image of intensity (rows, columns).

    usual: of another image of the same texture, so that it need not be found again.
    """
    pixels = np.zeros(image.shape, dtype=bool)
    level = float(np.abs(image).mean())
    if level <= 0.0 or max(image.shape) < 8:
        return Defects(pixels)
    usual = usual or _usual(image, level)
    bright = _where(image > BRIGHT * level)
    found = [_outliers(image, level, bright, reach, excess) for reach, excess in zip((1, 2), usual.excess)]
    for place in (*found, _dead(image, level, usual.deficit)):
        pixels[place] = True
    if np.count_nonzero(pixels) > MOST * pixels.size:
        pixels[:] = False
    clean = repaired(image, pixels) if pixels.any() else image
    return Defects(pixels, _bad_lines(clean, 0), _bad_lines(clean, 1), usual)


def _dead(image: np.ndarray, level: float, usual: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (v, u) of pixels below all of their neighbours by more than the texture explains."""
    offsets = _offsets(image, 1)
    least = _least(1, usual) * level
    v, u = _where(image < DARK * level)
    for offset in offsets:
        kept = _neighbour(image, v, u, offset) - image[v, u] > least
        v, u = v[kept], u[kept]
    # Where the light is uneven the level is that of the neighbourhood.
    local = [image[max(0, i - LOCAL) : i + LOCAL + 1, max(0, j - LOCAL) : j + LOCAL + 1].mean() for i, j in zip(v, u)]
    around = np.min([_neighbour(image, v, u, o) for o in offsets], axis=0) if v.size else np.zeros(0)
    kept = around - image[v, u] > _least(1, usual) * np.array(local)
    return v[kept], u[kept]


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
    rough = np.array([part[: rows // 2, : columns // 2].mean() for part in sublattices(image).values()])
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
