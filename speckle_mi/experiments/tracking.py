"""A pattern followed from frame to frame beyond the length over which it stays itself.

Shifts are measured against a reference. When the correlation with it has fallen, the last frame that was still like it
becomes the next reference: its place is known, with the uncertainty that its shift had.

What decorrelation leaves in a shift is a matter of the scatterers in the spot. While these are partly the same, the
errors of one reference after the other have one sign and add up; once others have taken their place they are
independent. Their mean square after a way L is s^2 L times the integral of their correlation, sqrt(pi) w where it falls
as exp(-(d/w)^2): as that of errors that add up over sqrt(pi) w and are independent from there on. The correlation that
the shifts show, exp(-(d/w)^2), too, tells how far in w each took the spot. So the drift that the track states grows in
proportion to the way at first, then as its root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..measurement.correlator import Correlator

RENEWED = 0.8
"""Correlation below which the reference is renewed unless asked otherwise."""

_TOGETHER = math.sqrt(math.pi)
"""Way over which errors add up, in lengths over which the correlation falls to 1/e."""


COARSE = 1.2
"""Factor on the uncertainty that a shift states for itself. That counts what is left between two images as noise from
pixel to pixel; what decorrelation leaves is as coarse as the speckle. Measured over surfaces, errors along an in-plane
motion are 1.2 to 1.5 times as large as stated, across it as large, of motions away from the target half as large."""


@dataclass(frozen=True)
class TrackPoint:
    """Where a frame's pattern is, from the first frame's, [px].

    u, v: NaN where not measured; sigma_u, sigma_v: standard uncertainties, drift included, infinite from where the
    track was lost on; ncc: correlation with the reference; reference: number of that frame; status: of the shift, or
    "lost" where the track goes on from an unknown displacement.
    """

    u: float
    v: float
    sigma_u: float
    sigma_v: float
    ncc: float
    reference: int
    status: str


@dataclass(frozen=True)
class _Anchor:
    """A frame whose place is known.

    number; image; place: (2,) [px]; variance: (2,) of all ways that are behind it [px^2]; sigma: (2,) that has added up
    since [px], over so many lengths of correlation.
    """

    number: int
    image: np.ndarray
    place: np.ndarray
    variance: np.ndarray
    sigma: np.ndarray
    lengths: float = 0.0

    def settled(self) -> _Anchor:
        """The same as a reference: what has added up for long enough is independent of what comes."""
        if self.lengths < _TOGETHER:
            return self
        return replace(self, variance=self.variance + self.sigma**2, sigma=np.zeros(2), lengths=0.0)


class Track:
    """Follows the pattern over images (rows, columns) that are given one after the other.

    window: of the correlation [px]; renewed: correlation below which the reference is renewed.
    """

    def __init__(self, window: int | None = None, renewed: float = RENEWED) -> None:
        self._window, self._renewed = window, renewed
        self.points: list[TrackPoint] = []
        self.references: list[int] = []
        self._reference: _Anchor | None = None
        self._last: _Anchor | None = None
        self._correlator: Correlator | None = None

    def add(self, image: np.ndarray) -> TrackPoint:
        """The next frame's place."""
        number = len(self.points)
        point = self._first(image) if self._reference is None else self._next(number, image)
        self.points.append(point)
        return point

    def _first(self, image: np.ndarray) -> TrackPoint:
        self._refer_to(_Anchor(0, image, np.zeros(2), np.zeros(2), np.zeros(2)))
        return TrackPoint(0.0, 0.0, 0.0, 0.0, 1.0, 0, "ok")

    def _next(self, number: int, image: np.ndarray) -> TrackPoint:
        found = self._correlator.shift(image)
        if not (found.ok and found.ncc >= self._renewed) and self._last.number != self._reference.number:
            self._refer_to(self._last)
            found = self._correlator.shift(image)
        reference = self._reference
        place = reference.place + np.nan_to_num([found.u_px, found.v_px])
        if not found.ok:
            # What lies between this frame and the last is not known; from here on the track goes on.
            self._refer_to(_Anchor(number, image, reference.place, np.full(2, np.inf), np.zeros(2)))
            status = f"lost: {found.status}"
            return TrackPoint(math.nan, math.nan, math.inf, math.inf, found.ncc, reference.number, status)
        sigma = reference.sigma + COARSE * np.array([found.sigma_u_px, found.sigma_v_px])
        lengths = reference.lengths + math.sqrt(max(-math.log(min(max(found.ncc, 1e-6), 1.0)), 0.0))
        self._last = _Anchor(number, image, place, reference.variance, sigma, lengths)
        measured = np.where(np.isnan([found.u_px, found.v_px]), np.nan, place)
        drift = np.sqrt(reference.variance + sigma**2)
        return TrackPoint(*map(float, measured), *map(float, drift), found.ncc, reference.number, "ok")

    def _refer_to(self, anchor: _Anchor) -> None:
        self._reference = self._last = anchor.settled()
        self._correlator = Correlator(anchor.image, self._window)
        self.references.append(anchor.number)
