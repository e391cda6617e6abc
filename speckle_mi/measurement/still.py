"""What stands still in two images of a moving pattern, as the correlation surface shows it.

A camera's fixed pattern (offsets and gains of its pixels, dust, reflections) correlates at zero shift whatever the
speckle does: as a spike of one pixel where it is as fine as the pixels, as a second peak where it is coarser.
"""

from __future__ import annotations

import numpy as np

from .peak import Peak, Texture, peak_at

STILL = 1
"""Distance from zero shift at which a peak is one of what stands still [px]."""

SURE = 1.3
"""Significance beyond which a second peak, away from zero, is the moving pattern's and no chance."""

ALIKE = 0.9
"""Correlation at zero shift above which the whole picture stands still."""

SPIKE, SPIKE_SIGMAS = 0.03, 6.0
"""Height of a correlation at zero shift over what its neighbours say, absolute and in standard deviations of white
noise, from which on it is a fixed pattern."""

SPIKE_SHARE = 0.1
"""Height of the spike over that of the peak from which on a shift within a speckle is not to be believed."""

NARROW, OWN = 0.4, 0.6
"""Largest correlation next to a peak, relative to it, for a spike; and the least that the pattern itself has there."""

FINE = 0.3
"""The same for a pattern that is finer than the pixels."""


def _distance(place: tuple[int, int], origin: tuple[int, int]) -> int:
    return max(abs(i - o) for i, o in zip(place, origin))


def moving_peak(surface: np.ndarray, peak: Peak, origin: tuple[int, int]) -> tuple[Peak, str]:
    """The peak of what moves where another tells of what stands still, and a note that says so."""
    if peak.other is None:
        return peak, ""
    note = "besides the pattern that moved, something stands still in both images (a fixed pattern of the camera, dust)"
    if _distance(peak.other, origin) <= STILL:
        return Peak(peak.place, peak.offset, peak.ncc, peak.significance), note
    if _distance(peak.place, origin) <= STILL and peak.ncc < ALIKE and peak.other_significance > SURE and not peak.rivals:
        moving = peak_at(surface, peak.other)
        return Peak(moving.place, moving.offset, moving.ncc, peak.other_significance), note
    return peak, ""


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
    """Whether the correlation falls off within a pixel of its peak: then nothing says where between the pixels it is."""
    beside = _beside(surface, peak.place)
    return beside is not None and beside < FINE * float(surface[peak.place])


def _spike(surface: np.ndarray, origin: tuple[int, int]) -> float:
    """Height of the surface at zero shift over the curve through its neighbours, 0 at the edge of the surface."""
    heights = []
    for axis, n in enumerate(surface.shape):
        if n == 1:
            continue
        i = origin[axis]
        if not 3 <= i < n - 3:
            return 0.0
        line = np.take(surface, range(i - 3, i + 4), axis=axis)
        line = line[:, origin[1]] if axis == 0 else line[origin[0], :]
        heights.append(float(line[3] - (15 * (line[2] + line[4]) - 6 * (line[1] + line[5]) + line[0] + line[6]) / 20))
    return min(heights, default=0.0)


def of_the_camera(
    surface: np.ndarray, peak: Peak, origin: tuple[int, int], texture: Texture
) -> str | None:
    """Why a peak is the camera's and not the pattern's, None if it is the pattern's."""
    remedy = "take a picture without light and give it as --dark"
    if _distance(peak.place, origin) <= STILL and texture.next > OWN:
        beside = _beside(surface, peak.place)
        if beside is not None and beside < NARROW * float(surface[peak.place]):
            return (
                "the correlation at zero shift is narrower than the pattern is: what stands still is the camera's"
                f" fixed pattern, not the speckle; {remedy}"
            )
    near = all(abs(i - o) <= reach for i, o, reach in zip(peak.place, origin, texture.lobe))
    if near and texture.next > OWN and _is_spike(surface, origin, texture):
        height = _spike(surface, origin)
        if height > SPIKE_SHARE * peak.ncc:
            return (
                f"{100 * height:.0f} % of the correlation stand still, a fixed pattern of the camera that pulls this"
                f" shift toward zero; {remedy}"
            )
    return None


def _is_spike(surface: np.ndarray, origin: tuple[int, int], texture: Texture) -> bool:
    height = _spike(surface, origin)
    if height <= SPIKE:
        return False
    # The same curve through seven values of the surface beside it: what it misses there by itself.
    scatter = [abs(_spike(surface, tuple(o + d for o, d in zip(origin, shift)))) for shift in _AROUND]
    return height > SPIKE_SIGMAS * float(np.median(scatter))


_AROUND = [(v, u) for v in (-4, 0, 4) for u in (-4, 0, 4) if (v, u) != (0, 0)]


def still_note(
    surface: np.ndarray, origin: tuple[int, int], displacement: tuple[int, int], texture: Texture
) -> str:
    """A note on what stands still beside a pattern that moved by ``displacement`` (v, u) [px], empty if nothing does."""
    if max(map(abs, displacement)) > STILL and texture.next > OWN and _is_spike(surface, origin, texture):
        return f"a fixed pattern of the camera makes {100 * _spike(surface, origin):.0f} % of the correlation at zero shift"
    return ""
