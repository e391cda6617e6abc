"""How much of the light a way brings straight to the detector, and how much its edges alone throw there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.pairs import all_pairs
from ..optics.aim import AimedPaths, aim
from ..optics.sequence import Interaction, Sequence, detector_plane
from ..optics.surface import Surface
from ..optics.trace import trace
from .legs import rays_over
from .places import detector_places, hole_places
from .setup import Setup
from .way import Channel

_HOLE_SHARES, _HOLE_ANGLES = (0.0, 0.5, 0.98), 8

_SHARE_SIDE = 9
"""Places a side on the detector at which is looked whether a way reaches them."""


@dataclass(frozen=True)
class Strength:
    """Of a way's light on the detector.

    lit: whether straight light arrives in its area; amplitude [1/mm]: of it on the detector, or of what edges throw
    there, at most, where none arrives.
    """

    lit: bool
    amplitude: float


def strength_of(setup: Setup, channel: Channel) -> Strength:
    """How strong a way's light is.

    A ray from the spot to the detector clears all outlines, or rays from one place to the next (spot, openings,
    detector) go straight on. Where they miss the next, the edge of the opening before throws its wave there.
    """
    spots, interactions, grid = setup.spots, channel.interactions, channel.grid
    straight = _straight(channel, spots)
    if straight.lit:
        return straight
    stops = [n for n, step in enumerate(channel.route.steps) if step[2] == "pass"]
    light, start = None, 0
    for stop in (*stops, None):
        last = len(interactions) if stop is None else stop
        between = tuple(i for i in interactions[start:last] if i.action != "pass")
        start = last
        if stop is None:
            end, goals, size = detector_plane(grid), detector_places(grid), grid.half_size
        else:
            plane = interactions[stop].surface
            end = Interaction.through(Surface(plane.frame), interactions[stop].index_before)
            goals, size = hole_places(plane, _HOLE_SHARES, _HOLE_ANGLES), plane.outline.half_size
        leg = Sequence((*between, end))
        if light is None:
            light = _from_spot(leg, spots, goals)
        elif _goes_straight_on(light, leg, goals, size):
            light = _straight_on(light, leg, goals)
        else:
            light = _thrown(light, leg, goals, setup.assembly.beam.wavelength)
    return Strength(False, light.amplitude) if light.thrown else replace(straight, lit=True)


def _straight(channel: Channel, spots: np.ndarray) -> Strength:
    """Whether a ray from the spot to one of some places on the detector clears all outlines; and how strong it is."""
    aimed, clear = _aimed_at_detector(channel, spots, detector_places(channel.grid))
    found = aimed.converged
    if not np.any(found):
        return Strength(False, 1 / _apart(spots, channel.grid.centre[None]))
    amplitude = float(np.sqrt(np.mean(np.minimum(aimed.amplitude[found], 1e100) ** 2)))
    return Strength(bool(np.any(clear)), amplitude)


def _aimed_at_detector(
    channel: Channel, spots: np.ndarray, places: np.ndarray
) -> tuple[AimedPaths, np.ndarray]:
    """Rays from all places on the spot to all of some places on the detector, and whether they clear all outlines."""
    aimed = rays_over(channel, None, None, spots, places, rims=True)
    return aimed, aimed.converged & np.all(aimed.margins >= 0, axis=0)


@dataclass(frozen=True)
class _Light:
    """What has arrived at places (m, 3) of an opening or the detector.

    directions: (m, 3) it comes from, None where no ray leads there; amplitude [1/mm]: of straight light at the place
    that it is weakest at, or of what an edge throws there, at most; radius of its wavefront [mm]; thrown: whether an
    edge has sent it there.
    """

    places: np.ndarray
    directions: np.ndarray | None
    amplitude: float
    radius: float
    thrown: bool = False


def _from_spot(sequence: Sequence, spots: np.ndarray, goals: np.ndarray) -> _Light:
    aimed, arrived = _aimed(sequence, spots, goals)
    good = aimed.converged
    if not np.any(good):
        radius = _apart(spots, goals)
        return _Light(*arrived, 1 / radius, radius)
    amplitude = float(np.min(aimed.amplitude[good]))
    return _Light(*arrived, amplitude, 1 / max(amplitude, 1e-300))


def _aimed(
    sequence: Sequence, places: np.ndarray, goals: np.ndarray
) -> tuple[AimedPaths, tuple[np.ndarray, np.ndarray | None]]:
    """Rays from all places to all goals (k, 3), and where those that there are arrive, and from where: (m, 3) each.

    Where there are none, the goals, and None.
    """
    starts, ends = all_pairs(places, goals)
    aimed = aim(sequence, starts, ends)
    good = aimed.converged
    return aimed, ((ends[good], aimed.arrival[good]) if np.any(good) else (goals, None))


def _straight_on(light: _Light, sequence: Sequence, goals: np.ndarray) -> _Light:
    """Light that has gone on from an opening to the next place."""
    _, arrived = _aimed(sequence, light.places, goals)
    radius = light.radius + _apart(light.places, goals)
    return _Light(*arrived, light.amplitude * light.radius / radius, radius, light.thrown)


def _thrown(light: _Light, sequence: Sequence, goals: np.ndarray, wavelength: float) -> _Light:
    """Light that only the edge of an opening throws to the next place, at most.

    By the Maggi-Rubinowicz integral a place on the edge that is met with the amplitude A and sends light on with the
    amplitude B, turned by the angle psi, brings A B cot(psi/2)/(4 pi) per length of the edge; about the place where its
    phase stands still a length of sqrt(lambda/(1/r + 1/s)) counts, and there are two such places, one on either side.
    """
    aimed, arrived = _aimed(sequence, light.places, goals)
    good, apart = aimed.converged, _apart(light.places, goals)
    if light.directions is None or not np.any(good):
        # No ray leads there: as if at a right angle.
        turned, onward, arrived = np.array([1.0]), np.array([1 / apart]), (goals, None)
    else:
        directions = np.repeat(light.directions, len(goals), axis=0)[good]
        cosine = np.clip(np.einsum("ij,ij->i", directions, aimed.launch[good]), -1.0, 1.0)
        turned = np.sqrt((1 + cosine) / np.maximum(1 - cosine, 1e-300))
        onward = aimed.amplitude[good]
    length = np.sqrt(wavelength / (1 / light.radius + onward))
    wave = 2 * light.amplitude * np.max(onward * turned * length) / (4 * np.pi)
    return _Light(*arrived, min(wave, light.amplitude), apart, thrown=True)


def _goes_straight_on(light: _Light, sequence: Sequence, goals: np.ndarray, size) -> bool:
    """Whether light that goes straight on from an opening meets the next one, or the detector, around its middle."""
    if light.directions is None:
        return False
    on = trace(sequence, light.places, light.directions).points[-1]
    on = on[np.all(np.isfinite(on), axis=1)]
    frame = sequence.last.surface.frame
    local = frame.to_local(on)[:, :2] - frame.to_local(goals.mean(axis=0)[None])[0, :2]
    return bool(np.any(np.all(np.abs(local) <= np.array(size), axis=1)))


def _apart(places: np.ndarray, goals: np.ndarray) -> float:
    return max(float(np.linalg.norm(goals.mean(axis=0) - places.mean(axis=0))), 1e-9)


def reached_share(channel: Channel, spots: np.ndarray) -> float:
    """Amplitude of a way's straight light on the whole detector, relative to light that reaches all of it.

    spots: (m, 3) places that stand for the spot. The root of the share of the detector that it reaches.
    """
    places = detector_places(channel.grid, _SHARE_SIDE)
    _, reached = _aimed_at_detector(channel, spots, places)
    return float(np.sqrt(max(np.mean(reached), 0.5 / len(places))))
