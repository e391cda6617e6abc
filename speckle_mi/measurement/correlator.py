"""The shift of a speckle pattern against a reference, and why there is none where there is none.

Images are (rows, columns) arrays of intensity. A shift (u, v) [px], u along increasing column and v along
increasing row, says where the features went: moved(x) = reference(x - shift).

1. The window at the middle of the reference is correlated with every place of the moved image it fits in.
2. Only if that shows no significant peak: both whole images are correlated over their overlap, and a window that lies
   on both patterns measures the shift.

A shift is reported only if its peak is one that unrelated patterns would show once in a thousand pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import InputError
from .ncc import Overlaps, Template
from .peak import FEWEST_SPECKLES, PATCH, Peak, Texture, argmax, least_significant, most_significant, peak_at
from .speckle_statistics import as_image, deviation

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

LEAST_OVERLAP = 1 / 16
"""Share of the pattern that must still be on the detector for its shift to be measured."""


@dataclass(frozen=True)
class Shift:
    """Where the features of a pattern went.

    u_px, v_px: shift along columns and rows [px]; NaN unless ``status`` is "ok" (and along an axis on which
    the image has a single pixel). ncc: interpolated peak of the correlation, NaN if there is none to speak of.
    status: "ok", "not significant", "ambiguous", "left the detector" or "no contrast"; message: one sentence
    saying why, empty if ok. significance: NCC at the peak's pixel over the least that is significant.
    window: (rows, columns) of the template the result rests on [px].
    """

    u_px: float
    v_px: float
    ncc: float
    status: str
    message: str
    significance: float
    window: tuple[int, int]

    @property
    def ok(self) -> bool:
        return self.status == "ok"


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
    the light stands still when the pattern moves, and would hold the peak back. Raises InputError for pixels that are
    not finite and for a window below 4 or larger than the image.
    """

    def __init__(self, reference: np.ndarray, window: int | None = None) -> None:
        image = as_image(reference, "reference image")
        self.shape = rows, columns = image.shape
        if window is not None and not 4 <= window <= max(self.shape):
            raise InputError(
                f"window = {window}: must be 4 to {max(self.shape)} px, the image has {columns} x {rows} pixels"
            )
        # A window asked for is kept on a side that holds it: larger shifts are then stage 2's.
        self.window = tuple(
            window if window is not None and window <= n else min(window or DEFAULT_WINDOW, math.ceil(WINDOW_SHARE * n))
            for n in self.shape
        )
        if window is None:
            self.window = _lit_window(image, self.window)
        self._corner = tuple((n - w) // 2 for n, w in zip(self.shape, self.window))
        self._reference = deviation(image)
        self._central = self._texture = None
        if self._reference is not None:
            piece = self._reference[tuple(slice(i, i + w) for i, w in zip(self._corner, self.window))]
            if deviation(piece) is not None:  # the light may miss the middle of the detector
                self._central, self._texture = Template(piece, self.shape), Texture(piece)

    @cached_property
    def _whole(self) -> tuple[Overlaps, Texture]:
        """What stage 2 needs of the reference, made when it is first needed."""
        return Overlaps(self._reference), Texture(self._reference)

    def shift(self, moved: np.ndarray) -> Shift:
        """Shift of ``moved`` (rows, columns) from the reference.

        Raises InputError if its shape is not the reference's or its pixels are not finite.
        """
        image = as_image(moved, "moved image")
        if image.shape != self.shape:
            raise InputError(f"moved image: shape {image.shape} differs from the reference image's {self.shape}")
        pattern = deviation(image)
        for name, values in (("reference", self._reference), ("moved", pattern)):
            if values is None:
                return self._no_shift("no contrast", f"the {name} image is constant, there is no pattern to follow")
        return self._near(pattern) or self._far(pattern)

    def _no_shift(self, status: str, message: str, ncc: float = math.nan, significance: float = math.nan) -> Shift:
        return Shift(math.nan, math.nan, ncc, status, message, significance, self.window)

    def _near(self, pattern: np.ndarray) -> Shift | None:
        """Stage 1: the central window over the moved image; None if no peak is significant."""
        if self._central is None:
            return None
        surface = self._central.ncc(pattern)
        peak = most_significant(surface, math.prod(self.window), self._texture)
        if peak.significance < 1.0:
            return None
        if peak.rival is not None:
            return self._ambiguous(peak, self._corner)
        displacement = tuple(i - c for i, c in zip(peak.place, self._corner))
        searched = all(places > 1 or n == 1 for places, n in zip(surface.shape, self.shape))
        if peak.offset is None or not searched:
            return self._symmetric(pattern, displacement, peak, 0.0)
        return self._found(peak, displacement, self.window)

    def _far(self, pattern: np.ndarray) -> Shift:
        """Stage 2: the whole images over their overlap, then a window placed on both patterns."""
        overlaps, texture = self._whole
        peak = most_significant(overlaps.ncc(pattern), overlaps.pixels, texture)
        middle = tuple(n - 1 for n in self.shape)
        if (most := float(texture.speckles(math.prod(self.shape)))) < FEWEST_SPECKLES:
            message = (
                f"the contrast of the image rests on {most:.0f} independent speckles, at least {FEWEST_SPECKLES} are"
                " needed to know a pattern again"
            )
            return self._no_shift("not significant", message, peak.ncc, peak.significance)
        if peak.significance < 1.0:
            message = (
                f"no displacement gives a significant correlation (best {peak.ncc:.3f}, {peak.significance:.2f} of what"
                " is needed): the patterns are unrelated, or this one has left the detector"
            )
            return self._no_shift("not significant", message, peak.ncc, peak.significance)
        if peak.rival is not None:
            return self._ambiguous(peak, middle)
        displacement = tuple(i - m for i, m in zip(peak.place, middle))
        share = overlaps.pixels[peak.place] / math.prod(self.shape)
        if share < LEAST_OVERLAP:
            message = (
                f"the pattern moved by about ({displacement[1]}, {displacement[0]}) px in (u, v) and only"
                f" {100 * share:.1f} % of it is still on the detector"
            )
            return self._no_shift("left the detector", message, peak.ncc, peak.significance)
        least = least_significant(texture.speckles(math.prod(self.window)), overlaps.pixels.size / texture.area)
        return self._symmetric(pattern, displacement, peak, float(least))

    def _symmetric(self, pattern: np.ndarray, coarse: tuple[int, int], peak: Peak, least: float) -> Shift:
        """Measure near the displacement ``coarse`` (v, u) with a template and its copy placed evenly about the middle.

        The template is the window, or all that both patterns share if the window's NCC is below ``least``.
        """
        for limit in (self.window, self.shape):
            displacement = coarse
            for _ in range(6):  # each round moves the template to where the last one saw the peak
                surface, size = self._around(pattern, displacement, limit)
                if surface is None:
                    break
                local = peak_at(surface, argmax(surface))
                displacement = tuple(d + i - n // 2 for d, i, n in zip(displacement, local.place, surface.shape))
                if local.offset is None:
                    continue
                if limit == self.window and local.ncc < least:
                    break
                local = Peak(local.place, local.offset, local.ncc, peak.significance)
                return self._found(local, displacement, size)
        return self._ambiguous(peak, None)

    def _around(
        self, pattern: np.ndarray, displacement: tuple[int, int], limit: tuple[int, int]
    ) -> tuple[np.ndarray | None, tuple[int, int]]:
        """NCC within a few pixels of a displacement, None where no template fits, and the template's size."""
        reach = tuple(PATCH + 1 if n > 1 else 0 for n in self.shape)
        size = tuple(min(w, n - abs(d) - 2 * r) for w, n, d, r in zip(limit, self.shape, displacement, reach))
        if min(size) < 1:
            return None, size
        start = [(n - s - d) // 2 for n, s, d in zip(self.shape, size, displacement)]
        piece = self._reference[tuple(slice(i, i + s) for i, s in zip(start, size))]
        around = pattern[tuple(slice(i + d - r, i + d + r + s) for i, d, r, s in zip(start, displacement, reach, size))]
        if deviation(piece) is None or deviation(around) is None:
            return None, size
        return Template(piece, around.shape).ncc(around), size

    def _found(self, peak: Peak, displacement: tuple[int, int], window: tuple[int, int]) -> Shift:
        v, u = (
            d + o if n > 1 else math.nan  # a single row or column cannot show motion across itself
            for d, o, n in zip(displacement, peak.offset, self.shape)
        )
        return Shift(u, v, peak.ncc, "ok", "", peak.significance, window)

    def _ambiguous(self, peak: Peak, origin: tuple[int, int] | None) -> Shift:
        if origin is None:
            message = "the correlation peak has no definite top within what both images share"
        else:
            (v1, u1), (v2, u2) = ([i - o for i, o in zip(place, origin)] for place in (peak.place, peak.rival))
            message = f"shifts of ({u1}, {v1}) and ({u2}, {v2}) px in (u, v) correlate equally well"
        return self._no_shift("ambiguous", message, peak.ncc, peak.significance)


def correlate(reference: np.ndarray, moved: np.ndarray, window: int | None = None) -> Shift:
    """Shift of ``moved`` from ``reference``, both (rows, columns); see `Correlator` for window and what raises."""
    return Correlator(reference, window).shift(moved)
