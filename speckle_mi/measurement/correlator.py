"""The shift of a speckle pattern against a reference, and why there is none where there is none.

Images are (rows, columns) arrays of intensity. A shift (u, v) [px], u along increasing column and v along
increasing row, says where the features went: moved(x) = reference(x - shift).

What stands still in both images is taken off first: pixels and lines that stand out, a colour mosaic, an uneven light
(:mod:`defects`, :mod:`light`). Then a window of the reference is found in the moved image (:mod:`matching`) and
registered to a fraction of a pixel (:mod:`registration`).

A shift is reported only if its peak is one that unrelated patterns would show once in a thousand pairs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from ..errors import InputError
from ..machine.cores import products_on_one_thread
from .covariance import as_image, checked_image, deviation, deviation_in_range, in_range
from .defects import Defects, Usual, defects_of, mosaic_gains, repaired, without_mosaic
from .deformation import Deformation
from .light import flatten, smoothing_of
from .matching import Matcher
from .reduced import block_means, matching_pieces
from .shift import Shift, no_shift
from .speckle_statistics import has_even_light

DEFAULT_WINDOW = 256
"""Side of the correlation window [px]."""

WINDOW_SHARE = 0.625
"""Largest part of an image's side the window takes, so that there is room to search."""

SMALLEST_WINDOW = 48
"""Side below which a window is not shrunk to the light [px]."""

LIT_CORNERS = 0.7
"""Least mean intensity in the four quarter-size corners of a window, relative to the whole, for it to count as lit."""

SHRINKING = 0.9
"""Factor from one window tried to the next smaller one."""

MIDDLE = 1024
"""Side of the middle of a larger image that is looked at first [px], or four windows."""


def _lit_window(image: np.ndarray, window: tuple[int, int]) -> tuple[int, int]:
    """The window (rows, columns) at the image's middle, shrunk in steps until its corners are lit like the rest."""
    share = 1.0
    while True:
        sides = tuple(max(math.ceil(share * side), min(SMALLEST_WINDOW, side)) for side in window)
        top, left = ((n - w) // 2 for n, w in zip(image.shape, sides, strict=True))
        piece = image[top : top + sides[0], left : left + sides[1]]
        a, b = (max(1, side // 4) for side in sides)
        corners = np.mean([piece[:a, :b].mean(), piece[:a, -b:].mean(), piece[-a:, :b].mean(), piece[-a:, -b:].mean()])
        if corners >= LIT_CORNERS * piece.mean() or share < SHRINKING**12:
            return sides if corners >= LIT_CORNERS * piece.mean() else window
        share *= SHRINKING


class Correlator:
    """Measures shifts against one reference, whose transforms are made once.

    reference: (rows, columns) intensity. window: side of the square window at its middle [px], clipped to 5/8 of a
    shorter side of the image; without it 256, clipped on both sides alike and shrunk to where the light is: an edge of
    the light stands still when the pattern moves, and would hold the peak back. mask: (rows, columns) bool, False for
    pixels that say nothing in any image. smoothing: structure larger than about this [px] is taken off; without it,
    light that is uneven. Raises InputError for pixels that are not finite, for a window below 4 or larger than the
    image and for a mask of another shape or without a valid pixel.
    """

    def __init__(
        self,
        reference: np.ndarray,
        window: int | None = None,
        *,
        mask: np.ndarray | None = None,
        smoothing: float | None = None,
    ) -> None:
        shape = np.shape(reference)
        if window is not None and len(shape) == 2 and not 4 <= window <= max(shape):
            raise InputError(
                f"window = {window}: must be 4 to {max(shape)} px, the image has {shape[1]} x {shape[0]} pixels"
            )
        if smoothing is not None and not 1.0 <= smoothing < math.inf:
            raise InputError(f"smoothing = {smoothing:g} px: must be at least 1 px")
        self._middle, self._alone = None, True
        side = max(MIDDLE, 4 * (window or DEFAULT_WINDOW))
        if len(shape) == 2 and min(shape) > 1 and max(shape) > side:
            self._place = tuple(slice((n - min(n, side)) // 2, (n + min(n, side)) // 2) for n in shape)
            inner = None if mask is None else mask[self._place]
            if inner is None or inner.any():
                self._middle = Correlator(np.asarray(reference)[self._place], window, mask=inner, smoothing=smoothing)
                self._middle._alone = False  # what has left its own window is looked for in the whole image
        self.shape, self._raw = shape, np.asarray(reference)
        self._mask, self._asked = _checked_mask(mask, shape), smoothing
        self._matchers: dict[float | None, Matcher | None] = {}
        self._window_asked = window
        if self._middle is None:
            self._prepare()
        self.window = self._middle.window if self._middle is not None else self._window

    def _prepare(self) -> None:
        """Everything that is needed of the whole reference."""
        image = as_image(self._raw, "reference image")
        window = self._window_asked
        # A window asked for is kept on a side that holds it: larger shifts are then stage 2's.
        self._window = tuple(
            window if window is not None and window <= n else min(window or DEFAULT_WINDOW, math.ceil(WINDOW_SHARE * n))
            for n in self.shape
        )
        if window is None:
            self._window = _lit_window(image, self._window)
        self._image, self._defects, self._mosaic = _cleaned(image, self._mask)
        self._smoothing = self._asked or _smoothing_of(self._image, deviation_in_range(self._image))

    def shift(self, moved: np.ndarray) -> Shift:
        """Shift of ``moved`` (rows, columns) from the reference.

        Raises InputError if its shape is not the reference's or its pixels are not finite.
        """
        return self.shift_and_deformation(moved)[0]

    @products_on_one_thread()
    def shift_and_deformation(self, moved: np.ndarray, fit: str = "shift") -> tuple[Shift, Deformation | None]:
        """The shift, and how the window was turned and strained besides; None where that is not to be had.

        fit: one of `deformation.FITS`; "shift" asks for no deformation. Raises as `shift` does.
        """
        if np.shape(moved) != self.shape and np.ndim(moved) == 2:
            raise InputError(
                f"moved image: shape {np.shape(moved)} differs from the reference image's {tuple(self.shape)}"
            )
        if self._middle is not None:
            found, deformed = self._middle.shift_and_deformation(np.asarray(moved)[self._place], fit)
            if found.ok or found.status == "ambiguous":
                return found, deformed
            return self._beyond_the_middle(np.asarray(moved), fit)
        matcher, pattern, defects, mosaic = self._looked_at(moved)
        for name, values, given, found in (
            ("reference", matcher, self._raw, self._defects), ("moved", pattern, moved, defects)
        ):  # fmt: skip
            if values is not None:
                continue
            if found.any and deviation(np.asarray(given, dtype=float)) is not None:
                message = f"all contrast of the {name} image is in what stands out of it like a defect: {found}"
                return no_shift("not significant", message, self._window), None
            message = f"the {name} image is constant, there is no pattern to follow"
            return no_shift("no contrast", message, self._window), None
        found = matcher.shift(pattern, self._valid(defects), self._alone)
        measured = found.ok and not math.isnan(found.u_px + found.v_px)
        deformed = matcher.deformation(pattern, found, fit) if fit != "shift" and measured else None
        return _noted(found, self._defects.shared(defects), self._mosaic or mosaic), deformed

    @cached_property
    def _means(self) -> tuple[Correlator, np.ndarray, int]:
        """A correlator for means of blocks of a large reference, these means and the blocks' side [px]."""
        block = math.ceil(max(self.shape) / MIDDLE)
        means = block_means(checked_image(self._raw, "reference image"), block)
        mask = None if self._mask is None else block_means(self._mask, block) == 1.0
        smoothing = None if self._asked is None else max(1.0, self._asked / block)
        mask = mask if mask is None or mask.any() else None
        return Correlator(means, mask=mask, smoothing=smoothing), means, block

    def _beyond_the_middle(self, moved: np.ndarray, fit: str) -> tuple[Shift, Deformation | None]:
        """Of a large image whose middle shows no shift: roughly in means of blocks, then where both show the same."""
        correlator, means, block = self._means
        found = correlator.shift(block_means(checked_image(moved, "moved image"), block))
        if math.isnan(found.u_px + found.v_px):
            message = f"of means of {block} x {block} px: {found.message}"
            return no_shift(found.status, message, self.window, found.ncc, found.significance), None
        rough = tuple(round(block * shift) for shift in (found.v_px, found.u_px))
        side = max(MIDDLE, 4 * (self._window_asked or DEFAULT_WINDOW))
        one, other = matching_pieces(self.shape, rough, side, means, block)
        mask = None if self._mask is None else self._mask[one] & self._mask[other]
        window = None if self._window_asked is None else min(self._window_asked, max(s.stop - s.start for s in one))
        correlator = Correlator(self._raw[one], window, mask=mask, smoothing=self._asked)
        found, deformed = correlator.shift_and_deformation(moved[other], fit)
        v, u = rough
        if deformed is not None:
            deformed = replace(deformed, shift=(deformed.shift[0] + u, deformed.shift[1] + v))
        return replace(found, u_px=found.u_px + u, v_px=found.v_px + v), deformed

    def _looked_at(self, moved: np.ndarray) -> tuple[Matcher | None, np.ndarray | None, Defects, bool]:
        """The reference's window and the moved pattern, None without one; what stood out; whether it was a mosaic."""
        image, defects, mosaic = _cleaned(as_image(moved, "moved image"), self._mask, self._defects.usual)
        pattern = deviation_in_range(image)
        smoothing = self._smoothing or _smoothing_of(image, pattern)
        if smoothing is not None:
            pattern = deviation(flatten(image, smoothing))
        return self._matcher(smoothing), pattern, defects, mosaic

    def _matcher(self, smoothing: float | None) -> Matcher | None:
        """The reference's window, of its pattern without what a smoothing takes off; None without a pattern."""
        if smoothing not in self._matchers:
            even = smoothing is None
            pattern = deviation_in_range(self._image) if even else deviation(flatten(self._image, smoothing))
            corner = tuple((n - w) // 2 for n, w in zip(self.shape, self._window))
            valid = self._valid(self._defects)
            self._matchers[smoothing] = None if pattern is None else Matcher(pattern, self._window, corner, valid)
        return self._matchers[smoothing]

    def _valid(self, defects: Defects) -> np.ndarray | None:
        if not defects.any:
            return self._mask
        return ~defects.mask if self._mask is None else self._mask & ~defects.mask


def _checked_mask(mask: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray | None:
    if mask is None:
        return None
    mask = np.asarray(mask, dtype=bool)
    if mask.shape != tuple(shape):
        raise InputError(f"mask: shape {mask.shape} differs from the images' {tuple(shape)}")
    if not mask.any():
        raise InputError("mask: leaves no pixel, must be true (not 0) where the images are to be looked at")
    return None if mask.all() else mask


def _cleaned(
    image: np.ndarray, mask: np.ndarray | None, usual: Usual | None = None
) -> tuple[np.ndarray, Defects, bool]:
    """An image without mosaic, what stands out or is masked filled in; what stood out; whether it was a mosaic.

    The image that is left is in range, see `in_range`.
    """
    image = in_range(image)
    if (gains := mosaic_gains(image)) is not None:
        image = without_mosaic(image, gains)
    if mask is not None:
        image = repaired(image, ~mask)
    defects = defects_of(image, usual)
    if defects.any:
        image = repaired(image, defects.mask)
    changed = defects.any or mask is not None or gains is not None
    return (in_range(image) if changed else image), defects, gains is not None


def _smoothing_of(image: np.ndarray, pattern: np.ndarray | None) -> float | None:
    """The smoothing that takes off the light of an image, None where it is even. pattern: the image's deviation."""
    return None if pattern is None or has_even_light(pattern) else smoothing_of(image)


def _noted(found: Shift, still: Defects, mosaic: bool) -> Shift:
    """A shift with notes on what was repaired."""
    notes = [found.message]
    if mosaic:
        notes.append(
            "every second pixel differs, as behind a colour filter mosaic (Bayer): the four kinds were evened out"
        )
    if still.any:
        notes.append(f"what stands out at the same place of both images was left out: {still}")
    return replace(found, message="; ".join(filter(None, notes)))


def correlate(reference: np.ndarray, moved: np.ndarray, window: int | None = None) -> Shift:
    """Shift of ``moved`` from ``reference``, both (rows, columns); see `Correlator` for window and what raises."""
    return Correlator(reference, window).shift(moved)
