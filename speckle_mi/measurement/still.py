"""What stands still in two images of a moving pattern, as the correlation surface shows it.

A camera's fixed pattern (offsets and gains of its pixels, dust, reflections) correlates at zero shift whatever the
speckle does: as a spike of one pixel where it is as fine as the pixels, as a second peak where it is coarser. Where
that lies inside the peak of what moves, the residual tells of it.
"""

from __future__ import annotations

import math

import numpy as np

from .covariance import LOBE_REACH
from .peak import Peak, Texture, fall_beside, height_over_neighbours, peak_at

STILL = 1
"""Distance from zero shift at which a peak is one of what stands still [px]."""

SURE = 1.3
"""Significance beyond which a second peak, away from zero, is the moving pattern's and no chance."""

DOUBTFUL, FAINT = 1.2, 0.3
"""Significance and correlation below which a peak next to zero shift may be what uneven gain makes between unrelated
speckle. Uneven by half it correlates by 1/6, and by more where chance adds to that: three of 500 pairs reach a
significance of 1.04 to 1.09 with 0.17 to 0.27."""

ALIKE = 0.9
"""Correlation at zero shift above which the whole picture stands still."""

SPIKE = 0.02
"""Height of the correlation at zero shift over what its neighbours say, relative to the peak and beyond what the
pattern's own lobe has, from which on it is a fixed pattern's."""

SPIKE_SIGMAS = 5.0
"""The same in standard deviations of the white noise in a correlation."""

NARROW, OWN = 0.4, 0.68
"""Largest correlation next to a peak, relative to it, for a spike; and the least that the pattern itself has there."""

FINE = 0.3
"""The same for a pattern that is finer than the pixels."""


BROAD = 0.8
"""Fall of a peak's flanks, relative to those of the pattern's own lobe, below which no pattern that moved makes it.
Of 98 % of the pairs that have lost three quarters of their correlation it is more; what dust or uneven gain make
between unrelated speckle falls by less, also where they are as fine as the speckle: its own grain is not in it."""

HALF = 0.5
"""Largest correlation that a gain that stands still makes between unrelated speckle, however uneven it is."""

NEAR = 2
"""Distance from zero shift, in reaches of the pattern's lobe, up to which a broad peak is looked for."""

LEFT_BEHIND = 3.0
"""Standard errors by which the residual is less like itself along the shift than across it, from which on a part of the
pattern stood still."""

FARTHER = 1.7
"""Least lag along the shift at which the residual is compared with itself, in half widths of the pattern's lobe: there
what is a derivative along the shift has turned its sign."""

PULL = 0.4
"""Pull by what stands still, over its share of the pattern's variance, in standard deviations of the lobe: two thirds
of the steepest slope of a Gaussian, 0.61, since of uneven gain half of that variance moves with the pattern."""

LEAST_UNSHARED = 1e-6
"""Variance of the residual, relative to the pattern's, below which it is what interpolation leaves: a gain that is
uneven by a thousandth leaves more."""


def _distance(place: tuple[int, int], origin: tuple[int, int]) -> int:
    return max(abs(i - o) for i, o in zip(place, origin))


def moving_peak(surface: np.ndarray, peak: Peak, origin: tuple[int, int], texture: Texture) -> tuple[Peak, str]:
    """The peak of what moves where another tells of what stands still, and a note that says so."""
    if peak.other is None or texture.repeats:  # a pattern that repeats itself has several peaks by itself
        return peak, ""
    note = "besides the pattern that moved, something stands still in both images (a fixed pattern of the camera, dust)"
    if _distance(peak.other, origin) <= STILL:
        return Peak(peak.place, peak.offset, peak.ncc, peak.significance), note
    still = _distance(peak.place, origin) <= STILL and peak.ncc < ALIKE
    if (still or is_broad(surface, peak, origin, texture)) and peak.other_significance > SURE:
        moving = peak_at(surface, peak.other)
        return Peak(moving.place, moving.offset, moving.ncc, peak.other_significance), note
    return peak, ""


def is_broad(surface: np.ndarray, peak: Peak, origin: tuple[int, int], texture: Texture) -> bool:
    """Whether a weak peak next to zero shift falls off more slowly than the pattern's own lobe."""
    near = all(abs(i - o) <= NEAR * reach for i, o, reach in zip(peak.place, origin, texture.lobe))
    return near and peak.ncc < HALF and fall_beside(surface, peak.place, texture.half) < BROAD * texture.fall


def _beside(surface: np.ndarray, place: tuple[int, int]) -> float | None:
    """Largest correlation at the four pixels next to a place, None at the edge."""
    values = []
    for axis, n in enumerate(surface.shape):
        if n > 1:
            if not 1 <= place[axis] < n - 1:
                return None
            for side in (-1, 1):
                values.append(surface[tuple(i + side * (a == axis) for a, i in enumerate(place))])
    return float(max(values)) if values else None


def finer_than_a_pixel(surface: np.ndarray, peak: Peak) -> bool:
    """Whether the correlation falls off within a pixel of its peak: nothing says where between the pixels it is."""
    beside = _beside(surface, peak.place)
    return beside is not None and beside < FINE * float(surface[peak.place])


def of_the_camera(
    surface: np.ndarray, peak: Peak, origin: tuple[int, int], texture: Texture, pixels: int
) -> str | None:
    """Why a peak is the camera's and not the pattern's, None if it is the pattern's."""
    if peak.ncc == 1.0:  # a copy of the reference, noise and all
        return None
    remedy = "take a picture without light and give it as --dark"
    if _distance(peak.place, origin) <= STILL and texture.next > OWN:
        beside = _beside(surface, peak.place)
        if beside is not None and beside < NARROW * float(surface[peak.place]):
            return (
                "the correlation at zero shift is narrower than the pattern is: what stands still is the camera's"
                f" fixed pattern, not the speckle; {remedy}"
            )
    if is_broad(surface, peak, origin, texture):
        return (
            "what correlates near zero shift has not the grain of the pattern: it is what stands still in both images"
            " (dust, uneven gain) and not the speckle, or the pattern was scaled by several percent; take a picture of"
            " even light and give it as --flat, or a smaller window"
        )
    near = all(abs(i - o) <= reach for i, o, reach in zip(peak.place, origin, texture.lobe))
    if near and peak.ncc < FAINT and peak.significance < DOUBTFUL:
        return (
            f"a correlation of {peak.ncc:.2f} next to zero shift is no more than uneven gain or dust make between"
            " patterns that share nothing else; take a larger window, or a picture of even light and give it as --flat"
        )
    if near and (height := _spike(surface, origin, peak.ncc, texture.top, pixels, texture)) > 0.0:
        return (
            f"{100 * height:.0f} % of the correlation stand still, a fixed pattern of the camera that pulls this"
            f" shift toward zero; {remedy}"
        )
    return None


def _spike(
    surface: np.ndarray, origin: tuple[int, int], ncc: float, own: float, pixels: int, texture: Texture
) -> float:
    """Share of the correlation ``ncc`` that is a spike at zero shift, 0 if there is none to be sure of.

    own: height over its neighbours that the pattern's lobe may have there. pixels: that a correlation rests on.
    """
    if texture.next <= OWN or ncc <= 0.0:  # a pattern as fine as the pixels has spikes of its own
        return 0.0
    height = height_over_neighbours(surface, origin) - ncc * own
    least = max(SPIKE * ncc, SPIKE_SIGMAS / math.sqrt(pixels) * (1.0 - min(ncc, 1.0)))
    return height / ncc if height > least else 0.0


def still_note(
    surface: np.ndarray,
    origin: tuple[int, int],
    displacement: tuple[int, int],
    ncc: float,
    pixels: int,
    texture: Texture,
) -> str:
    """A note on what stands still beside a pattern that moved by ``displacement`` (v, u) [px], empty if none is."""
    far = any(abs(d) > reach for d, reach in zip(displacement, texture.lobe))
    if far and (height := _spike(surface, origin, ncc, 0.0, pixels, texture)) > 0.0:
        return f"a fixed pattern of the camera adds {100 * height:.0f} % of the correlation at zero shift"
    return ""


def pull(unshared: np.ndarray, power: float, displacement: np.ndarray, texture: Texture) -> float:
    """Standard uncertainty [px] that what stands still adds to a shift near zero, 0 where nothing seems to.

    Gain or dust as coarse as the speckle has no peak of its own beside the pattern's. But what the moved image does not
    share with the reference (rows, columns) is then a difference a(x) - a(x - d), which is unlike itself a shift d
    away and not so across it; speckle that boils and noise know no direction. power: mean square of the reference's
    window in the same unit; displacement: (v, u) [px].
    """
    distance = math.hypot(*displacement)
    near = all(abs(d) <= NEAR * reach for d, reach in zip(displacement, texture.lobe))
    variance = float(np.einsum("ij,ij->", unshared, unshared)) / unshared.size
    if not near or distance == 0.0 or variance <= LEAST_UNSHARED * power:
        return 0.0
    half = float(np.mean(texture.lobe)) / LOBE_REACH
    v, u = (round(d / distance * max(distance, FARTHER * half)) for d in displacement)
    if 4 * max(abs(v), abs(u)) > min(unshared.shape):
        return 0.0
    unlike = (_at_lag(unshared, (-u, v)) - _at_lag(unshared, (v, u))) / variance
    if unlike * math.sqrt(texture.speckles(unshared.size) / 2.0) < LEFT_BEHIND:
        return 0.0
    sigma = half / math.sqrt(2.0 * math.log(2.0))
    # The residual is as large as this share of what stands still: little of it after a short shift.
    seen = -2.0 * math.expm1(-0.5 * (distance / sigma) ** 2)
    return PULL * sigma * variance / (power * seen)


def _at_lag(values: np.ndarray, lag: tuple[int, int]) -> float:
    """Mean product of values (rows, columns) with those a lag (v, u) away."""
    one, other = (
        values[tuple(slice(max(0, side * d), n + min(0, side * d)) for d, n in zip(lag, values.shape))]
        for side in (1, -1)
    )
    return float(np.einsum("ij,ij->", one, other)) / one.size
