"""The displacement of a window to a small fraction of a pixel, and how uncertain it is.

Gauss-Newton on the zero-normalised difference of the reference and the moved image (the least squares form of
Eq. (3)), inverse compositional: gradients are the reference's and made once (S. Baker and I. Matthews, DOI
10.1023/B:VISI.0000011205.11775.fd; B. Pan, K. Li and W. Tong, DOI 10.1007/s11340-013-9717-6). Images are interpolated
by their own trigonometric series over the window and a tapered margin, which is exact for a band-limited pattern, and
filtered on the way by the weight of :mod:`band`; a spline of degree 5 is off by a thousandth of a pixel at speckles of
2.5 px.

The covariance is the sandwich of the score's own variance over the window, with the neighbours that share a speckle
counted together (W. K. Newey and K. D. West, DOI 10.2307/1913610, in two dimensions). It knows no model of the noise:
photons, quantisation and decorrelation are all in the residual.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft, ndimage

from .band import weight_at

MARGIN = 16
"""Pixels around the window that the interpolation looks at."""

TAPER = 8
"""Outermost pixels of the margin, over which the images fade out [px]."""

ITERATIONS = 12
"""Most steps."""

CELLS = 5
"""Places of a box, along each axis, at which its sum is taken."""

CONVERGED = 1e-8
"""Step below which the iteration ends [px]."""

MOST_TAKEN_OFF = 1.5
"""Largest share by which Bartlett's weights are taken to have lessened a variance."""

FARTHEST = 1.5
"""Distance from the start beyond which the iteration has left its peak [px]."""

SPREAD = 2
"""Pixels around a masked one that its filling reaches."""


@dataclass(frozen=True)
class Found:
    """Displacement (v, u) [px], its covariance (2, 2) [px^2] and correlation of the filtered windows there.

    unshared: (rows, columns) what the moved window does not share with the reference's, and power: the mean square of
    that one, in the same unit.
    """

    displacement: np.ndarray
    covariance: np.ndarray
    correlation: float
    unshared: np.ndarray
    power: float


def padded_piece(image: np.ndarray, corner: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """``size`` pixels of ``image`` from ``corner``, which may lie outside: there the image is mirrored at its edge."""
    for axis, (start, count) in enumerate(zip(corner, size)):
        n = image.shape[axis]
        if start >= 0 and start + count <= n:
            image = image[(slice(None),) * axis + (slice(start, start + count),)]
            continue
        place = np.abs(np.arange(start, start + count)) % max(2 * n - 2, 1)
        image = np.take(image, np.where(place < n, place, 2 * n - 2 - place), axis=axis)
    return image


def _fade(n: int, margin: int) -> np.ndarray:
    taper = np.ones(n)
    if margin:
        rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(TAPER) + 0.5) / TAPER)
        taper[:TAPER], taper[n - TAPER :] = rise, rise[::-1]
    return taper


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    # Not BLAS, whose threads would wait for one another in products this short.
    return float(np.einsum("ij,ij->", a, b))


class Subset:
    """A window of the reference, ready to be found in moved images to a fraction of a pixel.

    reference: (rows, columns) pattern. corner, window: (row, column) of the window's first pixel and its size [px].
    weight: of `band_weight`. reach: (v, u) pixels within which residuals are correlated. valid: (rows, columns) bool,
    False for pixels of the reference that say nothing, None if all do.
    """

    def __init__(
        self,
        reference: np.ndarray,
        corner: tuple[int, int],
        window: tuple[int, int],
        weight: np.ndarray,
        reach: tuple[int, int],
        valid: np.ndarray | None = None,
    ) -> None:
        self.corner, self.window, self.reach = corner, window, reach
        self.axes = [axis for axis in (0, 1) if reference.shape[axis] > 1]
        self.margin = tuple(MARGIN if n > 1 else 0 for n in reference.shape)
        self.size = tuple(fft.next_fast_len(w + 2 * m, real=True) if m else w for w, m in zip(window, self.margin))
        v, u = fft.fftfreq(self.size[0]), fft.rfftfreq(self.size[1])
        self.frequency = (v[:, None], u[None, :])
        self.weight = weight_at(weight, (v, u))
        fades = [_fade(n, m) for n, m in zip(self.size, self.margin)]
        self.fade = fades[0][:, None] * fades[1]
        self.kept = self._kept(valid, (0, 0))
        spectrum = self._spectrum(reference, (0, 0))
        self.values = self.centred(self._window(spectrum))
        self.energy = _dot(self.values, self.values)
        self._set_gradients([self._window(spectrum * (2j * np.pi * self.frequency[a])) for a in self.axes])

    def _set_gradients(self, gradients: list[np.ndarray]) -> None:
        self.gradients = [self.along(g) for g in gradients]

    @cached_property
    def _gradient_spectra(self) -> list[np.ndarray]:
        """Of each gradient what its products with moved images are made of: with each frequency and its opposite."""
        twice = np.full(self.size[1] // 2 + 1, 2.0)
        twice[0] = 1.0
        if self.size[1] % 2 == 0:
            twice[-1] = 1.0
        twice /= math.prod(self.size)
        spectra = []
        for gradient in self.gradients:
            padded = np.zeros(self.size)
            padded[self._inside] = gradient
            spectra.append(fft.rfft2(padded).conj() * twice)
        return spectra

    def _kept(self, valid: np.ndarray | None, displacement: tuple[int, int]) -> np.ndarray | None:
        """Pixels of the window, displaced, that no masked pixel of an image reaches; None if that is all of them."""
        if valid is None:
            return None
        corner = tuple(c + d - SPREAD for c, d in zip(self.corner, displacement))
        piece = padded_piece(valid, corner, tuple(w + 2 * SPREAD for w in self.window))
        if piece.all():
            return None
        side = 2 * SPREAD + 1
        kept = ndimage.minimum_filter(piece, [side if n > 1 else 1 for n in valid.shape], mode="nearest")
        return kept[SPREAD : SPREAD + self.window[0], SPREAD : SPREAD + self.window[1]]

    def _spectrum(self, image: np.ndarray, displacement: tuple[int, int]) -> np.ndarray:
        corner = tuple(c + d - m for c, d, m in zip(self.corner, displacement, self.margin))
        piece = padded_piece(image, corner, self.size)
        spectrum = fft.rfft2((piece - piece.mean()) * self.fade)
        spectrum *= self.weight
        return spectrum

    def filtered(self, image: np.ndarray, displacement: tuple[int, int]) -> np.ndarray:
        """The window of ``image`` at a displacement and its margin, filtered as the registration sees it."""
        return fft.irfft2(self._spectrum(image, displacement), self.size)

    @property
    def _inside(self) -> tuple[slice, slice]:
        return tuple(slice(m, m + w) for m, w in zip(self.margin, self.window))

    def _window(self, spectrum: np.ndarray) -> np.ndarray:
        return fft.irfft2(spectrum, self.size)[self._inside]

    def centred(self, values: np.ndarray) -> np.ndarray:
        """Values less their mean over the pixels that count, 0 elsewhere."""
        if self.kept is None:
            return values - values.mean()
        count = max(int(np.count_nonzero(self.kept)), 1)
        return np.where(self.kept, values - float(values[self.kept].sum()) / count, 0.0)

    def along(self, gradient: np.ndarray) -> np.ndarray:
        """A gradient of the window by a parameter less what only changes the mean and the gain of the pattern."""
        gradient = self.centred(gradient)
        return gradient - (_dot(gradient, self.values) / self.energy) * self.values if self.energy else gradient

    def _ramps(self, place: np.ndarray) -> list[np.ndarray]:
        """Phases that shift a spectrum, along rows and along columns."""
        return [np.exp(2j * np.pi * d * f.ravel()) for d, f in zip(place, self.frequency)]

    def find(
        self, moved: np.ndarray, displacement: tuple[int, int], start: np.ndarray, valid: np.ndarray | None = None
    ) -> Found | None:
        """Where the window went in ``moved``, near a whole displacement plus ``start`` (v, u) [px].

        valid: (rows, columns) bool, False for pixels of the moved image that say nothing.

        Returns None where the iteration leaves the neighbourhood of its start or the correlation has no maximum there.
        """
        if (kept := self._kept(valid, displacement)) is not None:
            return self._restricted(kept).find(moved, displacement, start)
        spectrum = self._spectrum(moved, displacement)
        if self.energy <= 0.0 or (ended := self._zero_of_score(spectrum, np.array(start, dtype=float))) is None:
            return None
        place, slope = ended
        along_v, along_u = self._ramps(place)
        spectrum *= along_v[:, None]
        spectrum *= along_u
        values = self.centred(self._window(spectrum))
        energy, product = _dot(values, values), _dot(values, self.values)
        if product <= 0.0 or energy <= 0.0:
            return None
        inverse = np.linalg.inv((product / energy) * slope)
        covariance = np.full((2, 2), np.nan)
        # What the moved image does not share with the reference. The whole sum is the same with the residual of the
        # iteration, but in a box gradient times pattern is not 0.
        unshared = (product / energy) * (values - (product / self.energy) * self.values)
        variance = score_variance(self.gradients, unshared, self.reach)
        covariance[np.ix_(self.axes, self.axes)] = inverse @ variance @ inverse.T
        correlation = min(float(product / np.sqrt(energy * self.energy)), 1.0)
        return Found(np.add(displacement, place), covariance, correlation, unshared, self.energy / values.size)

    def _zero_of_score(self, spectrum: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Where (v, u) [px] the products of the moved image and the gradients vanish; their slope there.

        The products are linear in the moved image, so that sums over frequencies tell them at every displacement; the
        image's gain drops out. The slope has the moved image's gradient beside the reference's: what both share counts
        and not the noise of either. None as of `find`.
        """
        place = start.copy()
        products = [spectrum * gradient for gradient in self._gradient_spectra]
        for _ in range(ITERATIONS):
            along_v, along_u = self._ramps(place)
            sides = [(2j * np.pi * f.ravel()) * ramp for f, ramp in zip(self.frequency, (along_v, along_u))]
            across = [along_v @ product for product in products]
            score = np.array([float((a @ along_u).real) for a in across])
            slope = [[sides[0] @ (p @ along_u), a @ sides[1]] for p, a in zip(products, across)]
            slope = np.real(slope)[:, self.axes]
            if not np.linalg.eigvalsh(slope + slope.T).min() > 0.0:
                return None
            step = np.linalg.solve(slope, score)
            place[self.axes] -= step
            if not np.abs(place - start).max() < FARTHEST:
                return None
            if np.abs(step).max() < CONVERGED:
                break
        return place, slope

    def _restricted(self, kept: np.ndarray) -> Subset:
        """The same window with fewer pixels that count."""
        other = copy(self)
        other.kept = kept if self.kept is None else kept & self.kept
        other.values = other.centred(self.values)
        other.energy = _dot(other.values, other.values)
        other._set_gradients(self.gradients)
        vars(other).pop("_gradient_spectra", None)  # of all of the window
        return other


def _cell_sums(values: np.ndarray, cell: int, axis: int) -> np.ndarray:
    """Sums over cells of so many pixels along an axis; the last one may be smaller."""
    lead = values if axis == 0 else values.T
    sums = np.copy(lead[::cell])  # in the order in which the values lie
    for start in range(1, cell):
        part = lead[start::cell]
        sums[: len(part)] += part
    return sums if axis == 0 else sums.T


def _running_sums(values: np.ndarray, count: int, axis: int) -> np.ndarray:
    """Sums over every run of ``count`` values along an axis, those that reach over its ends included."""
    shape = tuple(n + count - 1 if a == axis else n for a, n in enumerate(values.shape))
    sums = np.zeros(shape)
    for start in range(count):
        sums[(slice(None),) * axis + (slice(start, start + values.shape[axis]),)] += values
    return sums


def score_variance(gradients: list[np.ndarray], residual: np.ndarray, reach: tuple[int, int]) -> np.ndarray:
    """Covariance (n, n) of the sums of n gradients (rows, columns) times a residual that is correlated over ``reach``.

    Of the sums over boxes that overlap, which are Bartlett's weights of the lags, times what those take off a
    correlation within the reach: as much as weights that are flat up to half of it have more, on the mean of the
    gradients (D. N. Politis and J. P. Romano, DOI 10.1111/j.1467-9892.1995.tb00223.x). They alone scatter too much.
    """
    box = tuple(min(2 * r + 1, max(w // 3, 1)) for r, w in zip(reach, residual.shape))
    cell = tuple(max(1, round(side / CELLS)) for side in box)
    count = tuple(max(1, round(side / c)) for side, c in zip(box, cell))
    half = tuple((n + 1) // 2 for n in count)
    sums, flat = [], []
    for gradient in gradients:
        score = gradient * residual
        for axis, c in enumerate(cell):  # of both axes first, so that boxes slide over few numbers
            score = _cell_sums(score, c, axis)
        along = {n: _running_sums(score, n, 0) for n in {count[0], half[0]}}
        boxes = {(m, n): _running_sums(along[m], n, 1) for m in along for n in {count[1], half[1]}}
        sums.append(boxes[count])
        flat.append(_flat(count, half, {size: _dot(b, b) / math.prod(size) for size, b in boxes.items()}))
    covariance = np.array([[_dot(a, b) for b in sums] for a in sums]) / math.prod(count)
    variance = np.diag(covariance)
    taken_off = float(np.mean(np.divide(flat, variance, out=np.ones(len(flat)), where=variance > 0.0)))
    # The whole sum is zero where the iteration ends, which takes this share of the variance away.
    left = 1.0 - math.prod(count) * math.prod(cell) / math.prod(residual.shape)
    return covariance * (min(max(taken_off, 1.0), MOST_TAKEN_OFF) / left)


def _flat(count: tuple[int, int], half: tuple[int, int], bartlett: dict[tuple[int, int], float]) -> float:
    """Variance with weights that are flat up to ``half`` and 0 from ``count`` on, of those that fall off at once."""
    weights = [{n: 1.0} if n == h else {n: n / (n - h), h: h / (h - n)} for n, h in zip(count, half)]
    return sum(a * b * bartlett[m, n] for m, a in weights[0].items() for n, b in weights[1].items())
