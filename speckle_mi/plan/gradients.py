"""How steep the phase of the light is over an opening, which tells how many nodes its integral takes."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..geometry.outline import Circle
from ..optics.aim import AimedPaths
from ..propagation.lowrank import LARGEST_RANK, RANK_SHARE
from .legs import rays_over
from .places import FINE, detector_places, hole_places
from .way import Channel, PhaseGradient, Rim

_GRADIENT_SAFETY = 1.05
"""Factor on the sampled phase gradient, for what lies between the samples."""

_SATURATED, _BEYOND, _FEW = 0.7, 3, 10
"""Share of the most terms that samples can tell from which on they are too few, how many times
more it may be then, and samples of a spot that is too small for that to be asked."""


def phase_gradients(
    channel: Channel, spots: np.ndarray, wavelength: float, tolerance: float
) -> tuple[PhaseGradient, ...]:
    """Bounds on the phase gradient over every opening of a channel, for light from places on the spot (n, 3).

    tolerance: of the sums over them, which tells how many terms they need.

    Raises InputError, naming the opening, where no ray leads over one.
    """
    found = []
    for number, rim in enumerate(channel.openings):
        before = channel.openings[number - 1] if number > 0 else None
        after = channel.openings[number + 1] if number + 1 < len(channel.openings) else None
        sources = spots if before is None else hole_places(before.plane, *FINE)
        targets = detector_places(channel.grid) if after is None else hole_places(after.plane, *FINE)
        try:
            ends = before, after, sources, targets
            found.append(phase_gradient(channel, rim, *ends, wavelength, _GRADIENT_SAFETY, tolerance))
        except InputError as error:
            raise InputError(f"opening {rim.name!r}: {error}") from None
    return tuple(found)


def phase_gradient(
    channel: Channel,
    rim: Rim,
    before: Rim | None,
    after: Rim | None,
    sources: np.ndarray,
    targets: np.ndarray,
    wavelength: float,
    safety: float,
    tolerance: float = 1e-3,
) -> PhaseGradient:
    """Bound on the phase gradient over a rim of all light from sources (n, 3) to targets (m, 3).

    before, after: openings that these lie on, None for the spot and the detector; safety: factor on what is sampled.
    Raises InputError where no ray leads over the rim.
    """
    samples = hole_places(rim.plane, *FINE)
    coming = rays_over(channel, before, rim, sources, samples)
    going = rays_over(channel, rim, after, samples, targets)
    ends = (sources, samples), (samples, targets)
    terms = tuple(_terms(rays, *end, wavelength, tolerance) for rays, end in zip((coming, going), ends, strict=True))
    tangents = rim.plane.frame.axes[:, :2]
    k = 2 * np.pi * rim.index / wavelength
    arriving = k * (coming.arrival @ tangents).reshape(-1, len(samples), 2).swapaxes(0, 1)[:, :, None]
    leaving = k * (going.launch @ tangents).reshape(len(samples), 1, -1, 2)
    gradient = (arriving - leaving).reshape(len(samples), -1, 2)
    if not np.isfinite(gradient).any():
        raise InputError("no ray leads over it from the spot to the detector")
    outline = rim.plane.outline
    if not isinstance(outline, Circle):
        bound = safety * np.nanmax(np.abs(gradient), axis=(0, 1))
        return PhaseGradient((float(bound[0]), float(bound[1])), None, terms)
    local = rim.plane.frame.to_local(samples)[:, :2]
    radius = np.hypot(*local.T)
    with np.errstate(invalid="ignore"):
        length = np.fmax.reduce(np.hypot(gradient[..., 0], gradient[..., 1]), axis=1, initial=0.0)
        around = np.stack([-local[:, 1], local[:, 0]], axis=1) / np.maximum(radius, 1e-300)[:, None]
        azimuthal = np.fmax.reduce(np.abs(np.einsum("snk,sk->sn", gradient, around)), axis=1, initial=0.0)
    tilt = max(float(length[radius == 0].max()), float(azimuthal.max()))
    largest = float(length.max())
    grows_evenly = np.all(length <= (tilt + (largest - tilt) * radius / outline.radius) * safety + 1e-9)
    return PhaseGradient(safety * largest, safety * tilt if grows_evenly else None, terms)


def _terms(rays: AimedPaths, sources: np.ndarray, targets: np.ndarray, wavelength: float, tolerance: float) -> int:
    """Terms of the expansion of a sum from sources (n, 3) to targets (m, 3), whose rays are given, to ``tolerance``.

    Of the paths without what belongs to either end alone, and without their slopes over the sources; see ``lowrank``.
    """
    turns = (rays.optical_path_length / wavelength).reshape(len(sources), len(targets))
    if not np.all(np.isfinite(turns)):
        return LARGEST_RANK
    turns = turns - turns[:1] - (turns[:, :1] - turns[:1, :1])
    linear = np.column_stack([np.ones(len(sources)), sources - sources.mean(axis=0)])
    rest = turns - linear @ np.linalg.lstsq(linear, turns, rcond=None)[0]
    size = np.linalg.svd(rays.amplitude.reshape(turns.shape) * np.exp(2j * np.pi * rest), compute_uv=False)
    left_out = np.sqrt(np.cumsum(size[::-1] ** 2))[::-1]
    terms = int(np.count_nonzero(left_out > RANK_SHARE * tolerance * left_out[0]))
    return terms if terms < _SATURATED * len(size) or len(size) < _FEW else min(_BEYOND * terms, LARGEST_RANK)
