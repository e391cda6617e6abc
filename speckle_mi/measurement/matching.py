"""A window of a reference pattern found in moved patterns: search, judgement, refinement.

Patterns are (rows, columns) arrays of mean 0 and rms deviation 1 of which camera and light have been taken off.

1. The window at the middle of the reference is correlated with the neighbourhood of its place in the moved image, and
   with every place it fits in if nothing significant is near.
2. Only if that shows no significant peak: both whole images are correlated over their overlap, and a window that lies
   on both patterns measures the shift.
3. The window is registered to a fraction of a pixel (:mod:`registration`).
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from .band import band_weight
from .covariance import deviation
from .deformation import Deformation, fit_deformation
from .masked import masked_displacement
from .ncc import Overlaps, Template
from .peak import FEWEST_SPECKLES, PATCH, Bar, Peak, Texture, argmax, least_significant, most_significant, peak_at
from .registration import Found, Subset
from .shift import Shift, no_shift
from .still import finer_than_a_pixel, moving_peak, of_the_camera, pull, still_note
from .turned import turned_back, turns

MASKED = 0.1
"""Share of the window from which on it is correlated by what the masks leave, and not filled in."""

TURNED = 1.3
"""Significance at which a pattern that was turned back is the reference's: two angles were tried for it."""

REACH = 64
"""Shift up to which the window is searched for first [px]."""

LEAST_OVERLAP = 1 / 16
"""Share of the pattern that must still be on the detector for its shift to be measured."""

WHOLE_PIXEL = 1.0 / math.sqrt(12.0)
"""Standard uncertainty of a shift known to the whole pixel [px]."""

PATCH_LOBE = (2 * PATCH, 2 * PATCH)
"""Reach of correlated residuals where the middle of the reference, by which it is judged, is dark [px]."""

PULLED = (
    "a part of the pattern stands still (uneven gain, dust) and pulls this shift toward zero, which its uncertainty"
    " holds; take a picture of even light and give it as --flat"
)

DECORRELATION = 0.6
"""K of sigma = K (s^2/n) sqrt((1-c)/c) px, s the speckle size and n the side of the window [px]."""


class Matcher:
    """Finds shifts against one reference pattern, whose transforms and gradients are made once.

    reference: (rows, columns), None for one without contrast. window, corner: (rows, columns) of the template and the
    place of its first pixel. valid: (rows, columns) bool, False where the reference says nothing; None if it all does.
    """

    def __init__(
        self,
        reference: np.ndarray,
        window: tuple[int, int],
        corner: tuple[int, int],
        valid: np.ndarray | None = None,
    ) -> None:
        self.reference, self.shape, self.window, self.corner, self.valid = (
            reference, reference.shape, window, corner, valid,
        )  # fmt: skip
        piece = reference[tuple(slice(i, i + w) for i, w in zip(corner, window))]
        self.lit = deviation(piece) is not None  # the light may miss the middle of the detector
        if self.lit:
            self.piece, self.texture = piece, Texture(piece)

    @cached_property
    def _weight(self) -> np.ndarray:
        return band_weight(self.reference)

    @cached_property
    def _subset(self) -> Subset:
        return self._subset_of(self.corner, self.window)

    def _subset_of(self, corner: tuple[int, int], size: tuple[int, int]) -> Subset:
        reach = self.texture.lobe if self.lit else PATCH_LOBE
        return Subset(self.reference, corner, size, self._weight, reach, self.valid)

    def _evenly(self, size: tuple[int, int], displacement: tuple[int, int]) -> tuple[int, int]:
        """First pixel of a template that lies as far before the middle as its displaced copy lies behind it."""
        return tuple((n - s - d) // 2 for n, s, d in zip(self.shape, size, displacement))

    @cached_property
    def _near_template(self) -> tuple[Template, tuple[int, int]]:
        """The template for the window's neighbourhood, and the row and column where that begins."""
        # What repeats itself must be seen to do so.
        reach = max(self.shape) if self.texture.repeats else REACH
        first = tuple(max(0, c - reach) for c in self.corner)
        last = tuple(min(n, c + w + reach) for n, c, w in zip(self.shape, self.corner, self.window))
        return Template(self.piece, tuple(b - a for a, b in zip(first, last))), first

    @cached_property
    def _wide_template(self) -> Template:
        return Template(self.piece, self.shape)

    @cached_property
    def _whole(self) -> tuple[Overlaps, Texture, Bar]:
        """What stage 2 needs of the reference, made when it is first needed."""
        overlaps, texture = Overlaps(self.reference), Texture(self.reference)
        return overlaps, texture, Bar.of(overlaps.pixels, texture, overlaps.pixels.shape)

    def shift(self, pattern: np.ndarray, valid: np.ndarray | None = None, beyond: bool = True) -> Shift:
        """Shift of ``pattern`` (rows, columns) from the reference; valid: False where it says nothing.

        beyond: whether to look further than where the whole window still is, and for turns.
        """
        if self.lit and self._much_is_masked(valid):
            return self._masked(pattern, valid)
        found = self._near(pattern, valid)
        if not beyond:
            return found or no_shift("not significant", "the window is nowhere to be found", self.window)
        found = found or self._far(pattern, valid)
        # A pattern that was turned may have a peak as broad as one of what stands still.
        if self.lit and found.status in ("not significant", "fixed pattern"):
            return self._turned(pattern, found.significance) or found
        return found

    def _turned(self, pattern: np.ndarray, before: float) -> Shift | None:
        """What there is to say of a pattern that is the reference's once it is turned back, None if it is not.

        before: its significance as it is, which must be less.
        """
        for angle in turns(self.reference, pattern):
            found = self._near(turned_back(pattern, angle), None)
            if found is not None and found.ok and found.significance > max(TURNED, before):
                message = (
                    f"the pattern was turned by about {angle:.1f} deg, more than a window of {self.window[1]} x"
                    f" {self.window[0]} px can follow: take a smaller one, or turn the image back"
                )
                return no_shift("rotated", message, self.window, found.ncc, found.significance)
        return None

    def _much_is_masked(self, valid: np.ndarray | None) -> bool:
        inside = tuple(slice(i, i + w) for i, w in zip(self.corner, self.window))
        return any(v is not None and v[inside].mean() < 1.0 - MASKED for v in (self.valid, valid))

    def _masked(self, pattern: np.ndarray, valid: np.ndarray | None) -> Shift:
        """Instead of both stages: what both images show, where much of them is masked."""
        all_valid = np.ones(self.shape, dtype=bool)
        masks = [all_valid if v is None else v for v in (self.valid, valid)]
        displacement, ncc, pixels = masked_displacement(self.reference, pattern, *masks)
        speckles = float(self.texture.speckles(pixels))
        least = least_significant(max(speckles, 1.0), 4.0 * math.prod(self.shape) / self.texture.area)
        significance = ncc / float(least) if speckles >= FEWEST_SPECKLES else 0.0
        if significance < 1.0:
            message = (
                f"what the masks leave shows no significant correlation (best {ncc:.3f} on {pixels} px,"
                f" {significance:.2f} of what is needed)"
            )
            return no_shift("not significant", message, self.window, ncc, significance)
        size = tuple(min(w, n - abs(d)) for w, n, d in zip(self.window, self.shape, displacement))
        start = self._evenly(size, displacement)
        result = self._subset_of(start, size).find(pattern, displacement, np.zeros(2), valid)
        peak = Peak(start, None, min(ncc, 1.0), significance)
        if result is None:
            return self._ambiguous(peak, None)
        return self._found(peak, displacement, size, result, "")

    def _near(self, pattern: np.ndarray, valid: np.ndarray | None) -> Shift | None:
        """Stage 1: the central window over the moved image; None if no peak is significant."""
        if not self.lit:
            return None
        template, first = self._near_template
        around = pattern[tuple(slice(f, f + n) for f, n in zip(first, template.shape))]
        found = self._searched(template, around, first, pattern, valid)
        if found is None and template.shape != self.shape:
            found = self._searched(self._wide_template, pattern, (0, 0), pattern, valid)
        return found

    def _searched(self, template: Template, around: np.ndarray, first: tuple[int, int], pattern, valid) -> Shift | None:
        surface = template.ncc(around)
        bar = Bar.of(math.prod(self.window), self.texture, surface.shape)
        peak = most_significant(surface, bar, self.texture)
        if peak.significance < 1.0:
            return None
        origin = tuple(c - f for c, f in zip(self.corner, first))
        peak, note = moving_peak(surface, peak, origin, self.texture)
        if peak.rivals:
            return self._ambiguous(peak, origin)
        displacement = tuple(i - c for i, c in zip(peak.place, origin))
        if (reason := of_the_camera(surface, peak, origin, self.texture, math.prod(self.window))) is not None:
            return no_shift("fixed pattern", reason, self.window, peak.ncc, peak.significance)
        if finer_than_a_pixel(surface, peak):
            return self._whole_pixel(peak, displacement)
        searched = all(places > 1 or n == 1 for places, n in zip(surface.shape, self.shape))
        if peak.offset is None or not searched:
            return self._symmetric(pattern, displacement, peak, 0.0, valid)
        result = self._subset.find(pattern, displacement, np.array(peak.offset), valid)
        note = note or still_note(surface, origin, displacement, peak.ncc, math.prod(self.window), self.texture)
        return self._found(peak, displacement, self.window, result, note)

    def deformation(self, pattern: np.ndarray, shift: Shift, fit: str) -> Deformation | None:
        """The mapping of the window that measured ``shift`` onto ``pattern``."""
        displacement = (round(shift.v_px), round(shift.u_px))
        size, evenly = shift.window, self._evenly(shift.window, displacement)
        corner = tuple(c if w == s else e for c, w, s, e in zip(self.corner, self.window, size, evenly))
        start = np.eye(3)
        start[:2, 2] = shift.u_px - displacement[1], shift.v_px - displacement[0]
        return fit_deformation(self._subset_of(corner, size), pattern, displacement, start, fit)

    def _far(self, pattern: np.ndarray, valid: np.ndarray | None) -> Shift:
        """Stage 2: the whole images over their overlap, then a window placed on both patterns."""
        overlaps, texture, bar = self._whole
        surface = overlaps.ncc(pattern)
        peak = most_significant(surface, bar, texture)
        middle = tuple(n - 1 for n in self.shape)
        if (most := float(texture.speckles(math.prod(self.shape)))) < FEWEST_SPECKLES:
            message = (
                f"the contrast of the image rests on {most:.0f} independent speckles, at least {FEWEST_SPECKLES} are"
                " needed to know a pattern again"
            )
            return no_shift("not significant", message, self.window, peak.ncc, peak.significance)
        if peak.significance < 1.0:
            message = (
                f"no displacement gives a significant correlation (best {peak.ncc:.3f}, {peak.significance:.2f} of what"
                " is needed): the patterns are unrelated, or this one has left the detector"
            )
            return no_shift("not significant", message, self.window, peak.ncc, peak.significance)
        if peak.rivals:
            return self._ambiguous(peak, middle)
        peak, note = moving_peak(surface, peak, middle, texture)
        pixels = round(float(overlaps.pixels[peak.place]))
        if (reason := of_the_camera(surface, peak, middle, texture, pixels)) is not None:
            return no_shift("fixed pattern", reason, self.window, peak.ncc, peak.significance)
        displacement = tuple(i - m for i, m in zip(peak.place, middle))
        share = overlaps.pixels[peak.place] / math.prod(self.shape)
        if share < LEAST_OVERLAP:
            message = (
                f"the pattern moved by about ({displacement[1]}, {displacement[0]}) px in (u, v) and only"
                f" {100 * share:.1f} % of it is still on the detector"
            )
            return no_shift("left the detector", message, self.window, peak.ncc, peak.significance)
        least = least_significant(texture.speckles(math.prod(self.window)), overlaps.pixels.size / texture.area)
        return self._symmetric(pattern, displacement, peak, float(least), valid, note)

    def _symmetric(
        self, pattern: np.ndarray, coarse: tuple[int, int], peak: Peak, least: float, valid, note: str = ""
    ) -> Shift:
        """Measure near the displacement ``coarse`` (v, u) with a template and its copy placed evenly about the middle.

        The template is the window, or all that both patterns share if the window's NCC is below ``least``.
        """
        for limit in (self.window, self.shape):
            displacement = coarse
            for _ in range(6):  # each round moves the template to where the last one saw the peak
                surface, size, start = self._around(pattern, displacement, limit)
                if surface is None:
                    break
                local = peak_at(surface, argmax(surface))
                displacement = tuple(d + i - n // 2 for d, i, n in zip(displacement, local.place, surface.shape))
                if local.offset is None:
                    if finer_than_a_pixel(surface, local):
                        return self._whole_pixel(Peak(local.place, None, local.ncc, peak.significance), displacement)
                    continue
                if limit == self.window and local.ncc < least:
                    break
                result = self._subset_of(start, size).find(pattern, displacement, np.array(local.offset), valid)
                local = Peak(local.place, local.offset, local.ncc, peak.significance)
                return self._found(local, displacement, size, result, note)
        return self._ambiguous(peak, None)

    def _around(
        self, pattern: np.ndarray, displacement: tuple[int, int], limit: tuple[int, int]
    ) -> tuple[np.ndarray | None, tuple[int, int], tuple[int, int]]:
        """NCC within a few pixels of a displacement, None where no template fits; the template's size and corner."""
        reach = tuple(PATCH + 1 if n > 1 else 0 for n in self.shape)
        size = tuple(min(w, n - abs(d) - 2 * r) for w, n, d, r in zip(limit, self.shape, displacement, reach))
        if min(size) < 1:
            return None, size, (0, 0)
        start = self._evenly(size, displacement)
        piece = self.reference[tuple(slice(i, i + s) for i, s in zip(start, size))]
        around = pattern[tuple(slice(i + d - r, i + d + r + s) for i, d, r, s in zip(start, displacement, reach, size))]
        if deviation(piece) is None or deviation(around) is None:
            return None, size, start
        return Template(piece, around.shape).ncc(around), size, start

    def _found(
        self, peak: Peak, displacement: tuple[int, int], window: tuple[int, int], result: Found | None, note: str
    ) -> Shift:
        if peak.offset == (0.0, 0.0) and peak.ncc == 1.0:  # a copy: there is nothing to interpolate
            place, covariance = np.array(displacement, dtype=float), np.zeros((2, 2))
        elif result is None:  # the refinement found no maximum: the surface has one all the same
            place = np.add(displacement, peak.offset)
            covariance = np.eye(2) * self._scatter(peak.ncc, window) ** 2
        else:
            place, covariance = result.displacement, result.covariance
            if self.lit and (pulled := pull(result.unshared, result.power, place, self.texture)) > 0.0:
                covariance = covariance + pulled**2 * np.eye(2)
                note = note or PULLED
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        # A single row or column cannot show motion across itself.
        (v, sigma_v), (u, sigma_u) = (
            (float(x), float(s)) if n > 1 else (math.nan, math.nan) for x, s, n in zip(place, sigma, self.shape)
        )
        product = sigma_u * sigma_v
        together = float(covariance[0, 1]) / product if product > 0.0 else math.nan
        return Shift(u, v, peak.ncc, "ok", note, peak.significance, window, sigma_u, sigma_v, together)

    def _scatter(self, ncc: float, window: tuple[int, int]) -> float:
        """Expected scatter [px] of the peak of decorrelated speckle."""
        size = math.sqrt(self.texture.area) if self.lit else 4.0
        return DECORRELATION * size**2 / math.sqrt(math.prod(window)) * math.sqrt(max(1.0 - ncc, 1e-6) / max(ncc, 0.01))

    def _whole_pixel(self, peak: Peak, displacement: tuple[int, int]) -> Shift:
        message = "the pattern is finer than the pixels: the shift is known to the whole pixel"
        (v, sigma_v), (u, sigma_u) = (
            (float(d), WHOLE_PIXEL) if n > 1 else (math.nan, math.nan) for d, n in zip(displacement, self.shape)
        )
        return Shift(u, v, peak.ncc, "ok", message, peak.significance, self.window, sigma_u, sigma_v, 0.0)

    def _ambiguous(self, peak: Peak, origin: tuple[int, int] | None) -> Shift:
        if origin is None:
            message = "the correlation peak has no definite top within what both images share"
        else:
            (v1, u1), (v2, u2) = ([i - o for i, o in zip(place, origin)] for place in (peak.place, peak.other))
            message = f"shifts of ({u1}, {v1}) and ({u2}, {v2}) px in (u, v) correlate equally well"
            message += ": the pattern repeats itself, take a window that holds what does not repeat"
        return no_shift("ambiguous", message, self.window, peak.ncc, peak.significance)
