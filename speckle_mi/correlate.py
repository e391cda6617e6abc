"""Displacement of a speckle pattern between two images, by normalised cross-correlation.

    python -m speckle_mi.correlate REF.exr MOVED.exr [--window 256]

Images are (rows, columns) arrays of intensity. A shift (u, v) [px], u along increasing column and v along
increasing row, says where the features went: moved(x) = reference(x - shift).

1. The window at the middle of the reference is correlated with every place of the moved image it fits in
   (Eq. (3) of Opt. Eng. 61(6) 061410, DOI 10.1117/1.OE.61.6.061410).
2. Only if that shows no significant peak: both whole images are correlated over their overlap (D. Padfield,
   DOI 10.1109/TIP.2011.2181402, with full masks), and a window that lies on both patterns measures the shift.

A shift is reported only if its peak is one that unrelated patterns would show once in a thousand pairs.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist

import numpy as np
from scipy import fft

from .statistics import as_image, autocovariance, central_lobe, contrast, deviation, speckle_size

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

FALSE_ALARM = 1e-3
"""Probability that two unrelated patterns are given a shift; each of the two stages gets half."""

LEAST_OVERLAP = 1 / 16
"""Share of the pattern that must still be on the detector for its shift to be measured."""

RIVAL = 0.9
"""A second peak this high, relative to the first, makes the shift ambiguous."""

PATCH = 2
"""Pixels on each side of the peak in the sub-pixel fit."""

FEWEST_SPECKLES = 16
"""Fewest independent speckles that can tell two patterns apart at all."""

CONSTANT = 1e-9
"""Variation of a piece of an image, relative to all of the image's, that is taken for rounding."""

ROUNDING = 1e-12
"""Rounding of an NCC of 1; speckle of 100 px moved by 1e-4 px is already further from it."""

SPECKLE_KURTOSIS = 9.0
"""Fourth moment over squared variance of exponentially distributed intensity."""


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


def _log_maximum(patch: np.ndarray) -> tuple[tuple[float, float], float] | None:
    """Offset (v, u) from the middle and height of the maximum of a patch of NCC values, or None.

    A polynomial through the logarithm of all values (a product of degree 4 x 4 for 5 x 5 values), so a Gaussian
    peak of any orientation is exact. Three points an axis would ignore the cross term, which a finite number of
    speckles always has: up to 0.08 px for 40 px speckle in a 256 px window.
    """
    if patch.min() <= 0.0:
        return None
    nodes = [np.arange(n) - n // 2 for n in patch.shape]
    to_powers = [np.linalg.inv(np.vander(x.astype(float), increasing=True)) for x in nodes]
    coefficients = to_powers[0] @ np.log(patch) @ to_powers[1].T
    place = np.zeros(2)
    free = [axis for axis in (0, 1) if patch.shape[axis] > 1]
    if not free:
        return None
    for _ in range(20):
        powers = [_power_derivatives(place[axis], patch.shape[axis]) for axis in (0, 1)]
        value, gradient_v, curvature_v = powers[0] @ coefficients @ powers[1][0]
        gradient_u, cross = powers[0][:2] @ coefficients @ powers[1][1]
        curvature_u = powers[0][0] @ coefficients @ powers[1][2]
        gradient = np.array([gradient_v, gradient_u])[free]
        hessian = np.array([[curvature_v, cross], [cross, curvature_u]])[np.ix_(free, free)]
        if np.linalg.eigvalsh(hessian).max() >= -1e-12:
            return None
        step = -np.linalg.solve(hessian, gradient)
        place[free] += step
        if np.abs(place).max() > 1.0:
            return None
        if np.abs(step).max() < 1e-9:
            return (float(place[0]), float(place[1])), min(math.exp(value), 1.0)
    return None


def _power_derivatives(x: float, count: int) -> np.ndarray:
    """Powers x^0 ... x^(count-1) and their first and second derivatives, (3, count)."""
    n = np.arange(count)
    powers = float(x) ** n
    table = np.zeros((3, count))
    table[0] = powers
    table[1, 1:] = n[1:] * powers[:-1]
    table[2, 2:] = n[2:] * n[1:-1] * powers[:-2]
    return table


def _box_sums(image: np.ndarray, box: tuple[int, int]) -> np.ndarray:
    """Sums of ``image`` (rows, columns) over every (height, width) box that lies inside it."""
    for axis, size in enumerate(box):
        running = np.cumsum(image, axis=axis)
        lead = np.moveaxis(running, axis, 0)
        sums = lead[size - 1 :].copy()
        sums[1:] -= lead[:-size]
        image = np.moveaxis(sums, 0, axis)
    return image


class _Template:
    """A piece of the reference, ready to be correlated with every place of images of one shape it fits in."""

    def __init__(self, piece: np.ndarray, shape: tuple[int, int]) -> None:
        self.size, self.shape = piece.shape, shape
        self.padded = tuple(fft.next_fast_len(n, real=True) for n in shape)
        values = piece - piece.mean()
        self.norm = math.sqrt(float(np.sum(np.square(values))))
        self.spectrum = fft.rfft2(values, self.padded, workers=2).conj()

    def ncc(self, pattern: np.ndarray) -> np.ndarray:
        """Eq. (3) at every place (row, column) of the template's corner in ``pattern``; 0 where that is constant."""
        (rows, columns), (height, width) = self.shape, self.size
        spectrum = fft.rfft2(pattern, self.padded, workers=2)
        spectrum *= self.spectrum
        # Places that wrap around the padded image are exactly those cut off here.
        products = fft.irfft2(spectrum, self.padded, workers=2, overwrite_x=True)
        products = products[: rows - height + 1, : columns - width + 1]
        squares = np.square(pattern)
        energy = _box_sums(squares, self.size) - _box_sums(pattern, self.size) ** 2 / (height * width)
        energy[energy <= CONSTANT * squares.sum()] = np.inf
        return products / (self.norm * np.sqrt(energy))


class _Overlaps:
    """The whole reference, ready to be correlated with images over their overlap at every displacement."""

    def __init__(self, reference: np.ndarray) -> None:
        self.shape = reference.shape
        self.padded = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in self.shape)
        self.spectrum = fft.rfft2(reference, self.padded, workers=2).conj()
        self.lags = [np.arange(1 - n, n) for n in self.shape]
        counts = [n - np.abs(lag) for n, lag in zip(self.shape, self.lags)]
        self.pixels = (counts[0][:, None] * counts[1]).astype(np.float64)
        self.sums, self.energy = self._sums_and_energy(reference, -1)

    def _sums_and_energy(self, image: np.ndarray, sign: int) -> tuple[np.ndarray, np.ndarray]:
        """Sum and squared deviation of the overlapping pixels of the moved (sign +1) or reference (-1) image."""
        sums = self._over_overlap(image, sign)
        squares = np.square(image)
        energy = self._over_overlap(squares, sign) - sums**2 / self.pixels
        energy[energy <= CONSTANT * squares.sum()] = np.inf
        return sums, energy

    def _over_overlap(self, image: np.ndarray, sign: int) -> np.ndarray:
        """Sum of ``image`` over the pixels that overlap, at every lag."""
        for axis in (0, 1):
            n, lag = self.shape[axis], sign * self.lags[axis]
            running = np.insert(np.cumsum(image, axis=axis), 0, 0.0, axis=axis)
            image = running.take(np.minimum(n, n + lag), axis) - running.take(np.maximum(0, lag), axis)
        return image

    def ncc(self, pattern: np.ndarray) -> np.ndarray:
        """NCC over the overlap, (2 rows - 1, 2 columns - 1), no displacement in the middle."""
        spectrum = fft.rfft2(pattern, self.padded, workers=2)
        spectrum *= self.spectrum
        products = fft.irfft2(spectrum, self.padded, workers=2, overwrite_x=True)
        # Negative lags wrap around, and so do negative indices.
        products = products[self.lags[0]][:, self.lags[1]]
        sums, energy = self._sums_and_energy(pattern, 1)
        return (products - sums * self.sums / self.pixels) / np.sqrt(energy * self.energy)


class _Texture:
    """What chance can do with a pattern: its speckle area, its lobe, and how many speckles carry its contrast.

    area: integral of the squared normalised autocovariance over the central lobe [px^2], the area on which two
    patterns agree or disagree together. lobe: half extents (v, u) [px].
    """

    def __init__(self, piece: np.ndarray) -> None:
        covariance = autocovariance(piece)
        rows, columns = piece.shape
        # A lobe is never taken wider than this, so that a pattern of parallel stripes is seen to repeat itself.
        self.lobe = tuple(min(reach, n // 3) for reach, n in zip(central_lobe(covariance), piece.shape))
        v, u = self.lobe
        self.area = float(np.sum(np.square(covariance[rows - 1 - v : rows + v, columns - 1 - u : columns + u])))
        squares = np.square(piece - piece.mean())
        # A few bright pixels carry the contrast of an image whose kurtosis is above that of speckle.
        self.carrying = min(1.0, SPECKLE_KURTOSIS * float(squares.mean() ** 2 / np.mean(squares**2)))

    def speckles(self, pixels: np.ndarray | float) -> np.ndarray | float:
        """Number of independent speckles in so many pixels."""
        return pixels * (self.carrying / self.area)


@dataclass(frozen=True)
class _Peak:
    """A maximum of a correlation surface.

    place: its pixel. offset: (v, u) [px] from there, None where the surface has no smooth maximum inside a patch
    or it lies at the edge. significance: its pixel's NCC over the least significant.
    rival: place of another peak as good.
    """

    place: tuple[int, int]
    offset: tuple[float, float] | None
    ncc: float
    significance: float = math.nan
    rival: tuple[int, int] | None = None


def _peak_at(surface: np.ndarray, place: tuple[int, int]) -> _Peak:
    """The maximum of ``surface`` next to the pixel ``place``, by the largest patch that has one."""
    top = float(surface[place])
    if top > 1.0 - ROUNDING:  # only a copy correlates fully (Cauchy-Schwarz), so it lies exactly here
        return _Peak(place, (0.0, 0.0), 1.0)
    for radius in (PATCH, 1):
        reach = [radius if n > 1 else 0 for n in surface.shape]
        if all(r <= i < n - r for r, i, n in zip(reach, place, surface.shape)):
            patch = surface[tuple(slice(i - r, i + r + 1) for i, r in zip(place, reach))]
            if (found := _log_maximum(patch)) is not None:
                return _Peak(place, found[0], min(max(found[1], top), 1.0))
    return _Peak(place, None, min(top, 1.0))


def _threshold(speckles: np.ndarray | float, places: float) -> np.ndarray | float:
    """NCC that the best of ``places`` [speckle areas] of unrelated patterns exceeds with FALSE_ALARM / 2.

    speckles: independent ones under the template. Fisher's z of a Gaussian field with three maxima an area, with the
    skewness 4/sqrt(speckles) that products of exponential intensities have (Cornish-Fisher). Checked by simulation.
    """
    z = -NormalDist().inv_cdf(0.5 * FALSE_ALARM / (3.0 * max(places, 1.0)))
    root = np.sqrt(speckles)
    return np.tanh((z + 4.0 * (z * z - 1.0) / (6.0 * root)) / root)


def _highest(surface: np.ndarray, pixels: np.ndarray | float, texture: _Texture) -> _Peak:
    """The most significant peak of a correlation surface, each value of which rests on ``pixels`` pixels."""
    speckles = np.asarray(texture.speckles(pixels))  # one number for stage 1, one a displacement for stage 2
    most = float(speckles.max())
    # With too few speckles everywhere the best of the larger overlaps is still looked up, but proves nothing.
    enough = np.broadcast_to(speckles >= min(FEWEST_SPECKLES, 0.5 * most), surface.shape)
    threshold = _threshold(np.maximum(speckles, 1.0), np.count_nonzero(enough) / texture.area)
    ratio = np.where(enough, surface / threshold, 0.0)
    place = _argmax(ratio)
    peak = _peak_at(surface, place)
    # Of the pixel, not interpolated: interpolation raises the peaks of unrelated patterns too.
    significance = float(ratio[place]) if most >= FEWEST_SPECKLES else 0.0
    lobe = tuple(slice(max(i - reach, 0), i + reach + 1) for i, reach in zip(place, texture.lobe))
    ratio[lobe] = 0.0
    other = _argmax(ratio)
    if significance >= 1.0 and ratio[other] >= 1.0 and _peak_at(surface, other).ncc >= RIVAL * peak.ncc:
        return _Peak(place, peak.offset, peak.ncc, significance, other)
    # Unrelated patterns scatter by 1/sqrt(speckles); if the rest of this surface scatters more, the bar is higher.
    scatter = np.where(enough, surface * np.sqrt(speckles), 0.0)
    scatter[lobe] = 0.0
    away = np.count_nonzero(enough) - np.count_nonzero(enough[lobe])
    excess = math.sqrt(float(np.sum(np.square(scatter))) / away) if away else 1.0
    return _Peak(place, peak.offset, peak.ncc, significance / max(excess, 1.0))


def _argmax(surface: np.ndarray) -> tuple[int, int]:
    row, column = np.unravel_index(int(np.argmax(surface)), surface.shape)
    return int(row), int(column)


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
    the light stands still when the pattern moves, and would hold the peak back. Raises ValueError for pixels that are not
    finite and for a window below 4 or larger than the image.
    """

    def __init__(self, reference: np.ndarray, window: int | None = None) -> None:
        image = as_image(reference, "reference image")
        self.shape = rows, columns = image.shape
        if window is not None and not 4 <= window <= max(self.shape):
            raise ValueError(
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
                self._central, self._texture = _Template(piece, self.shape), _Texture(piece)

    @cached_property
    def _whole(self) -> tuple[_Overlaps, _Texture]:
        """What stage 2 needs of the reference, made when it is first needed."""
        return _Overlaps(self._reference), _Texture(self._reference)

    def shift(self, moved: np.ndarray) -> Shift:
        """Shift of ``moved`` (rows, columns) from the reference.

        Raises ValueError if its shape is not the reference's or its pixels are not finite.
        """
        image = as_image(moved, "moved image")
        if image.shape != self.shape:
            raise ValueError(f"moved image: shape {image.shape} differs from the reference image's {self.shape}")
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
        peak = _highest(surface, math.prod(self.window), self._texture)
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
        peak = _highest(overlaps.ncc(pattern), overlaps.pixels, texture)
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
        least = _threshold(texture.speckles(math.prod(self.window)), overlaps.pixels.size / texture.area)
        return self._symmetric(pattern, displacement, peak, float(least))

    def _symmetric(self, pattern: np.ndarray, coarse: tuple[int, int], peak: _Peak, least: float) -> Shift:
        """Measure near the displacement ``coarse`` (v, u) with a template and its copy placed evenly about the middle.

        The template is the window, or all that both patterns share if the window's NCC is below ``least``.
        """
        for limit in (self.window, self.shape):
            displacement = coarse
            for _ in range(6):  # each round moves the template to where the last one saw the peak
                surface, size = self._around(pattern, displacement, limit)
                if surface is None:
                    break
                local = _peak_at(surface, _argmax(surface))
                displacement = tuple(d + i - n // 2 for d, i, n in zip(displacement, local.place, surface.shape))
                if local.offset is None:
                    continue
                if limit == self.window and local.ncc < least:
                    break
                local = _Peak(local.place, local.offset, local.ncc, peak.significance)
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
        return _Template(piece, around.shape).ncc(around), size

    def _found(self, peak: _Peak, displacement: tuple[int, int], window: tuple[int, int]) -> Shift:
        v, u = (
            d + o if n > 1 else math.nan  # a single row or column cannot show motion across itself
            for d, o, n in zip(displacement, peak.offset, self.shape)
        )
        return Shift(u, v, peak.ncc, "ok", "", peak.significance, window)

    def _ambiguous(self, peak: _Peak, origin: tuple[int, int] | None) -> Shift:
        if origin is None:
            message = "the correlation peak has no definite top within what both images share"
        else:
            (v1, u1), (v2, u2) = ([i - o for i, o in zip(place, origin)] for place in (peak.place, peak.rival))
            message = f"shifts of ({u1}, {v1}) and ({u2}, {v2}) px in (u, v) correlate equally well"
        return self._no_shift("ambiguous", message, peak.ncc, peak.significance)


def correlate(reference: np.ndarray, moved: np.ndarray, window: int | None = None) -> Shift:
    """Shift of ``moved`` from ``reference``, both (rows, columns); see `Correlator` for window and what raises."""
    return Correlator(reference, window).shift(moved)


def centre_of_gravity(image: np.ndarray) -> tuple[float, float]:
    """Centre of gravity (u, v) [px] of an intensity (rows, columns), relative to the image's middle.

    NaN for an image without light. Raises ValueError for pixels that are not finite.
    """
    light = as_image(image)
    total = float(light.sum())
    if total <= 0.0:
        return math.nan, math.nan
    rows, columns = light.shape
    u = np.arange(columns) - (columns - 1) / 2
    v = np.arange(rows) - (rows - 1) / 2
    return float(light.sum(axis=0) @ u) / total, float(light.sum(axis=1) @ v) / total


def compare(reference: np.ndarray, moved: np.ndarray, pitch: float | None, window: int | None = None) -> dict:
    """What the command prints: shift, correlation, centres of gravity and statistics of two images.

    pitch: [mm], None if unknown (lengths in um are then NaN). Raises ValueError as `Correlator` does.
    """
    shift = correlate(reference, moved, window)
    um = math.nan if pitch is None else 1e3 * pitch
    centres = {"reference": centre_of_gravity(reference), "moved": centre_of_gravity(moved)}
    centres["shift"] = tuple(b - a for a, b in zip(centres["reference"], centres["moved"]))
    sizes = speckle_size(reference)
    return {
        "shift_u_px": shift.u_px,
        "shift_v_px": shift.v_px,
        "shift_u_um": shift.u_px * um,
        "shift_v_um": shift.v_px * um,
        "ncc": shift.ncc,
        "status": shift.status,
        "message": shift.message,
        "significance": shift.significance,
        "window": list(shift.window),
        **{f"cog_{name}_{axis}_um": c[i] * um for name, c in centres.items() for i, axis in enumerate("uv")},
        "contrast_reference": contrast(reference),
        "contrast_moved": contrast(moved),
        "speckle_size_u_px": sizes[0],
        "speckle_size_v_px": sizes[1],
        "speckle_size_u_um": sizes[0] * um,
        "speckle_size_v_um": sizes[1] * um,
    }


def _common_pitch(*headers: dict) -> float | None:
    """Pixel pitch [mm] in the headers of field images, None if none has one. Raises ValueError if they differ."""
    found = [header["pixel_pitch_mm"] for header in headers if "pixel_pitch_mm" in header]
    for pitch in found:
        if not isinstance(pitch, (int, float)) or not 0.0 < pitch < math.inf:
            raise ValueError(f"pixel_pitch_mm = {pitch!r} in an image's header: must be a positive number")
    if found and not math.isclose(min(found), max(found), rel_tol=1e-6):
        raise ValueError(f"the images' pixel pitches differ: {min(found):g} and {max(found):g} mm")
    return float(found[0]) if found else None


def main(argv: list[str] | None = None) -> int:
    """Print the comparison of two field images as one JSON object."""
    from .cli import parser
    from .exr import read_field

    arguments_of = parser("correlate", "Shift of the speckle pattern between two field images, as JSON on stdout.")
    arguments_of.add_argument("reference", metavar="REF.exr", help="field image before the motion")
    arguments_of.add_argument("moved", metavar="MOVED.exr", help="field image after the motion")
    window_help = "side of the correlation window (default: 256, less on a small detector)"
    arguments_of.add_argument("--window", type=int, metavar="PX", help=window_help)
    arguments = arguments_of.parse_args(argv)
    reference, moved = read_field(arguments.reference), read_field(arguments.moved)
    pitch = _common_pitch(reference.header, moved.header)
    result = compare(reference.intensity, moved.intensity, pitch, arguments.window)
    # JSON has no NaN.
    known = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in result.items()}
    print(json.dumps(known, indent=2))
    return 0


if __name__ == "__main__":
    from .cli import command

    raise SystemExit(command(main))
