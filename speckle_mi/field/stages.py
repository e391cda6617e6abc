"""The field that one channel of the plan brings to the detector: sums from points to points, opening after opening."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..geometry.pairs import all_pairs
from ..geometry.plane import PlaneGrid, PlanePoints
from ..optics.aim import aim
from ..optics.sequence import Interaction, Sequence, amplitude_of, detector_plane
from ..optics.traced_path import TracedLeg
from ..plan.places import FINE, detector_places, hole_places
from ..plan.setup import Setup
from ..plan.opening_shadows import has_shadow, is_summed_along_edge, lit_nodes
from ..plan.shadows import (
    SHADOWS_ON_DETECTOR,
    SHADOWS_ON_OPENING,
    extremes,
    is_clear,
    lit_pixels,
    shadowed_sum,
    shapes_beside_way,
)
from ..plan.stage import BESIDE_WINDOW, HIDDEN, RAYS, SUM, Stage
from ..plan.way import Channel, Rim, without_rims
from ..propagation.area import points_at
from ..propagation.coherent_sum import CERTAINTY, How, SumResult, coherent_sum
from ..propagation.edge_integral import edge_sum
from ..propagation.opening_quadrature import TIGHTEST
from ..propagation.paths import FreeSpace, RayleighSommerfeld
from ..propagation.reference import reference_sum
from ..scattering.rough_surface import Scatterers
from ..scene.errors import SceneError
from .lobe import EVEN, Lobe, LobeTerm
from .openings import beside_window, nodes_on
from .ray_method import ray_field

_MOST_HIDDEN = 0.5
"""Error of the field by pixels from which a part of an opening is hidden, beyond which it is no result."""

_FEW_PAIRS = 300_000
"""Pairs of scatterer and pixel below which their plain sum takes less time than the search for a better way."""

_DIM_SHARE = 0.5
"""By how much more of itself the error of a sum counts for every further opening."""

_QUADRATURE_SHARE, _QUADRATURE_SAFETY = 1e-5, 100.0
"""Part of the tolerance to which the integral over an opening is resolved: it converges fast, and costs little; and by
how much more its error may be where the next opening takes the dim part of its light alone."""


@dataclass(frozen=True)
class ChannelField:
    """field: complex (rows, columns); stages: how the sums were done; error: estimated relative L2 error."""

    field: np.ndarray
    stages: tuple[Stage, ...]
    error: float


def channel_field(
    setup: Setup, scatterers: Scatterers, channel: Channel, grid: PlaneGrid, lobe: Lobe | None = None
) -> ChannelField:
    """The field on ``grid``, which is the channel's unfolded detector or a part of it.

    lobe: shapes the radiation of the scatterers, None for even radiation.
    """
    if not channel.openings:
        return _without_openings(setup, scatterers, channel, grid, lobe)
    if is_summed_along_edge(setup, channel, scatterers.position, scatterers.count, grid.size):
        return _along_edge(setup, scatterers, channel, grid, channel.openings[0])
    options, wavelength = setup.assembly.options, setup.assembly.beam.wavelength
    sources, weights, opening = scatterers.position, scatterers.amplitude, None
    how, tolerance = (wavelength, options.method), max(options.tolerance / (len(channel.openings) + 1), 1e-8)
    quadrature = max(_QUADRATURE_SHARE * tolerance, TIGHTEST)
    stages: list[Stage] = []
    for number, rim in enumerate(channel.openings):
        began = time.perf_counter()
        nodes, areas = nodes_on(channel, number, quadrature)
        path = leg_path(channel, number, rim.end, opening, wavelength)
        onward = channel.onward[number]
        judged = None if onward is None else onward.drawn(nodes.a, nodes.b, areas)
        if number == 0:
            values, results = on_first_opening(setup, channel, rim, path, scatterers, nodes, tolerance, lobe, judged)
        else:
            result = summed(channel, path, sources, weights, nodes, *how, tolerance, setup.costs, judged)
            values, results = result.field, [(result.how, result.numerical_error)]
        stages += _sums((rim.name,), results, began, nodes.size)
        sources, weights = nodes.points(), values * areas
        if rim.whole is not None:
            stages.append(Stage(BESIDE_WINDOW, (rim.name,), error=beside_window(rim, nodes, values, areas)))
        opening = (rim.normal, rim.index)
    began = time.perf_counter()
    path = leg_path(channel, len(channel.openings), detector_plane(channel.grid), opening, wavelength)
    result = summed(channel, path, sources, weights, grid, *how, tolerance, setup.costs)
    values = result.field.reshape(grid.shape)
    if channel.hidden is not None:
        stages += _hidden_light(channel, values)
    stages += _sums(("the detector",), [(result.how, result.numerical_error)], began)
    uncertain = _QUADRATURE_SAFETY * quadrature * np.sqrt(len(channel.openings))
    return _channel_field(channel, values, stages, uncertain)


def _along_edge(setup: Setup, scatterers: Scatterers, channel: Channel, grid: PlaneGrid, rim: Rim) -> ChannelField:
    """The field behind one opening in space as straight light and the wave of its edge."""
    began, wavelength = time.perf_counter(), setup.assembly.beam.wavelength
    plane = rim.plane
    result = edge_sum(plane.outline, plane.frame, scatterers.position, scatterers.amplitude, grid, wavelength)
    hidden = _hidden_light(channel, result.field) if channel.hidden is not None else []
    sums = _sums(("the detector",), [(result.how, result.numerical_error)], began)
    return _channel_field(channel, result.field, [*hidden, *sums])


def _without_openings(
    setup: Setup, scatterers: Scatterers, channel: Channel, grid: PlaneGrid, lobe: Lobe | None
) -> ChannelField:
    """The field of a channel whose light is diffracted nowhere, with its shadows."""
    began = time.perf_counter()
    path = leg_path(channel, 0, detector_plane(channel.grid), None, setup.assembly.beam.wavelength)
    values, results, share = on_detector(setup, channel, path, scatterers, grid, lobe)
    stages = _sums(("the detector",), results, began, share=share)
    return _channel_field(channel, values, stages)


def on_detector(
    setup: Setup, channel: Channel, path, scatterers: Scatterers, grid: PlaneGrid | PlanePoints, lobe: Lobe | None
) -> tuple[np.ndarray, list[tuple[How, float]], float | None]:
    """The field on the detector of a channel without openings, how each sum was done, and the share in shadow, if any.

    path: to the detector's plane; grid: all of its pixels, or centres of some of them (the field is then (m,)).
    """
    assembly = setup.assembly
    clear = is_clear(setup, channel, scatterers.position, setup.frame.axes)
    how = assembly.beam.wavelength, assembly.options.method, assembly.options.tolerance, setup.costs
    results, share = [], None

    def radiated(weights: np.ndarray) -> np.ndarray:
        nonlocal share
        result = summed(channel, path, scatterers.position, weights, grid, *how)
        field, error = result.field, result.numerical_error
        if not clear:
            field, share, shared = _shadowed_field(setup, channel, path, scatterers.position, weights, grid, field)
            error = float(np.hypot(error, shared))
        results.append((result.how, error))
        return field

    terms = _lobe_terms(setup, scatterers, channel, None, detector_places(channel.grid), lobe)
    return _sum_of_terms(terms, scatterers, grid, radiated), results, share


def on_first_opening(
    setup: Setup, channel: Channel, rim: Rim, path, scatterers: Scatterers, nodes: PlanePoints, tolerance: float,
    lobe: Lobe | None, judged: np.ndarray | None = None,
) -> tuple[np.ndarray, list[tuple[How, float]]]:  # fmt: skip
    """The field (n,) at the nodes of the first opening, and how each sum was done with its error.

    judged: indices of nodes on which the error is measured, those that send light to the detector.
    """
    how = setup.assembly.beam.wavelength, setup.assembly.options.method, tolerance, setup.costs
    sources, results = scatterers.position, []
    shadowed = has_shadow(channel, rim, sources, setup.frame.axes)

    def radiated(weights: np.ndarray) -> np.ndarray:
        result = summed(channel, path, sources, weights, nodes, *how, judged)
        field, error = result.field, result.numerical_error
        if shadowed:
            field, shared = _with_shadows_on(setup, nodes, channel, rim, path, sources, weights, field, *how)
            error = float(np.hypot(error, shared))
        results.append((result.how, error))
        return field

    terms = _lobe_terms(setup, scatterers, channel, rim, hole_places(rim.plane, *FINE), lobe)
    return _sum_of_terms(terms, scatterers, nodes, radiated), results


def _lobe_terms(
    setup: Setup, scatterers: Scatterers, channel: Channel, rim: Rim | None, samples: np.ndarray, lobe: Lobe | None
) -> tuple[LobeTerm, ...]:
    """The scatterers' radiation on the first leg of a channel, to an opening or (None) to the detector."""
    if lobe is None:
        return EVEN

    def launch(points: np.ndarray, places: np.ndarray) -> np.ndarray:
        if not channel.leg(0):
            return places[None] - points[:, None]
        end = detector_plane(channel.grid) if rim is None else rim.end
        aimed = aim(Sequence((*channel.leg(0), end)), *all_pairs(points, places))
        return aimed.launch.reshape(len(points), len(places), 3)

    return lobe.terms(setup, scatterers, launch, samples, setup.assembly.options.tolerance)


def _sum_of_terms(
    terms: tuple[LobeTerm, ...],
    scatterers: Scatterers,
    places: PlaneGrid | PlanePoints,
    radiated: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """The field at places; radiated: weights (n,) of the scatterers -> their field there with even radiation."""
    if terms is EVEN:
        return radiated(scatterers.amplitude)
    points, total = places.points(), 0.0
    for term in terms:
        field = radiated(scatterers.amplitude * term.sources)
        total = total + field * term.towards(points).reshape(field.shape)
    return total


def _sums(
    ends: tuple[str, ...], results: list[tuple[How, float]], began: float, nodes: int | None = None,
    share: float | None = None,
) -> list[Stage]:  # fmt: skip
    """Stages of the sums that ended at an opening or the detector; the time is their whole's, on the first."""
    seconds = time.perf_counter() - began
    return [
        Stage(SUM, ends, how=how, nodes=nodes, share=share, error=error, seconds=seconds if number == 0 else None)
        for number, (how, error) in enumerate(results)
    ]


def _channel_field(channel: Channel, values: np.ndarray, stages: list[Stage], quadrature: float = 0.0) -> ChannelField:
    """The whole of a channel; its error is that of the sums, of what is left out and of the quadrature together."""
    # A further opening may take the dim part of the light before it, where an error weighs more.
    dim = 1.0 + _DIM_SHARE * max(len(channel.openings) - 1, 0)
    parts = [*(dim * stage.error for stage in stages), channel.left_out, quadrature]
    error = float(np.sqrt(np.sum(np.square(parts))))
    factor = amplitude_of(channel.interactions)
    values = values if factor == 1.0 else factor * values
    return ChannelField(values, tuple(replace(stage, way=channel.route.label) for stage in stages), error)


def summed(channel: Channel, path, *arguments) -> SumResult:
    """The coherent sum; where a traced path finds no ray, SceneError that says on which way and what to do."""
    try:
        return coherent_sum(path, *arguments)
    except InputError as error:
        if not isinstance(path, TracedLeg):
            raise
        raise SceneError(
            f"way {channel.route.label}: {error}: "
            "put an aperture that keeps the light off the edges, or move the detector"
        ) from None


def ray_channel(
    setup: Setup, scatterers: Scatterers, channel: Channel, grid: PlaneGrid, lobe: Lobe | None = None
) -> tuple[ChannelField, list[str]]:
    """The field by the paper's own method, fans of rays whose paths are interpolated on the pixels; and warnings."""
    began = time.perf_counter()
    sequence = Sequence(channel.interactions) if channel.interactions else None
    wavelength, rays = setup.assembly.beam.wavelength, setup.assembly.options.rays_per_source
    sources, results = scatterers.position, []
    beside = shapes_beside_way(setup, channel, extremes(sources, setup.frame.axes))

    def radiated(weights: np.ndarray) -> np.ndarray:
        results.append(ray_field(sequence, grid, sources, weights, wavelength, rays))
        if not beside:
            return results[-1].field
        return shadowed_sum(
            sources,
            lambda places, only: lit_pixels(setup, channel, places, grid, only, rims=False),
            lambda group, seen: ray_field(sequence, grid, sources[group], weights[group], wavelength, rays).field[seen],
            results[-1].field,
            SHADOWS_ON_DETECTOR,
        )[0]

    terms = _lobe_terms(setup, scatterers, channel, None, detector_places(grid), lobe)
    values = _sum_of_terms(terms, scatterers, grid, radiated)
    warnings = list(dict.fromkeys(line for result in results for line in result.warnings))
    traced = sum(result.rays_traced for result in results)
    seconds = time.perf_counter() - began
    stage = Stage(RAYS, way=channel.route.label, count=rays, rays=traced, share=results[-1].covered, seconds=seconds)
    return ChannelField(amplitude_of(channel.interactions) * values, (stage,), math.nan), warnings


def leg_path(channel: Channel, number: int, end: Interaction, opening, wavelength: float):
    """What leads from point set ``number`` of the channel to the next, which lies in the plane ``end``."""
    between = channel.leg(number)
    if between and channel.openings:
        between = without_rims(between)  # beside an opening paths are only there to be interpolated
    if between:
        return TracedLeg(Sequence((*between, end)), wavelength, opening)
    return FreeSpace() if opening is None else RayleighSommerfeld(opening[0], wavelength)


# Shadows


def _with_shadows_on(
    setup: Setup,
    nodes: PlanePoints,
    channel: Channel,
    rim: Rim,
    path,
    sources: np.ndarray,
    weights: np.ndarray,
    whole: np.ndarray,
    *how,
) -> tuple[np.ndarray, float]:
    """The field at the nodes of the first opening with the shadows of shapes and of other rims, and its error.

    whole: (n,) the field without them. The error is that of scatterers that share their shadow.
    """
    points = nodes.points()

    def sum_over(group: np.ndarray, seen: np.ndarray) -> np.ndarray:
        places = replace(nodes, a=nodes.a[seen], b=nodes.b[seen])
        return summed(channel, path, sources[group], weights[group], places, *how).field

    field, _, error = shadowed_sum(
        sources, lambda places, _: lit_nodes(setup, channel, rim, places, points), sum_over, whole, SHADOWS_ON_OPENING
    )
    return field, error


def _shadowed_field(
    setup: Setup,
    channel: Channel,
    path,
    sources: np.ndarray,
    weights: np.ndarray,
    grid: PlaneGrid | PlanePoints,
    whole: np.ndarray,
) -> tuple[np.ndarray, float, float]:
    """Geometric field with all shadows, each scatterer's (or patch of the spot's) at its own place.

    whole: of the grid's shape, the field without them. Returns the share of pixels in shadow and the error of sharing,
    too.
    """
    options = setup.assembly.options
    how = setup.assembly.beam.wavelength, options.method, options.tolerance, setup.costs
    pixels = grid.points()

    def sum_over(group: np.ndarray, seen: np.ndarray) -> np.ndarray:
        if isinstance(path, FreeSpace) and len(group) * np.count_nonzero(seen) < _FEW_PAIRS:
            return reference_sum(
                path, sources[group], weights[group], pixels[seen.ravel()], setup.assembly.beam.wavelength
            )
        places = points_at(grid, np.flatnonzero(seen))
        return summed(channel, path, sources[group], weights[group], places, *how).field

    def lit(places: np.ndarray, only: np.ndarray | None):
        if isinstance(grid, PlaneGrid):
            return lit_pixels(setup, channel, places, grid, only)
        pixel = channel.grid.index_of(grid)
        chosen = None
        if only is not None:
            chosen = np.zeros(channel.grid.shape, dtype=bool)
            chosen.flat[pixel[only]] = True
        return (seen.flat[pixel] for seen in lit_pixels(setup, channel, places, channel.grid, chosen))

    return shadowed_sum(
        sources,
        lit,
        sum_over,
        whole,
        SHADOWS_ON_DETECTOR,
    )


def _hidden_light(channel: Channel, values: np.ndarray) -> list[Stage]:
    """A stage on light that falls on pixels from which a rim or a shape hides a part of the last opening, or none.

    There the field is not known. Raises SceneError where that is more than half of the whole.
    """
    power = np.abs(values) ** 2
    share = float(power[channel.hidden].sum() / max(power.sum(), 1e-300))
    error = CERTAINTY * np.sqrt(share)
    if share == 0:
        return []
    if error > _MOST_HIDDEN:
        raise SceneError(
            f"way {channel.route.label}: {share:.2%} of the light behind {channel.openings[-1].name!r} falls where "
            "a rim or a shape hides a part of that opening, and the diffraction there is not computed: make that "
            "element wider, move it out of the light, or the detector smaller"
        )
    return [Stage(HIDDEN, (channel.openings[-1].name,), share=share, error=float(error))]
