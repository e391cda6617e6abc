"""Random scenes with elements, each with the field that independent optics finds on some of its pixels.

``scene(number)`` for 0 to COUNT - 1 is a pure function of its number and of SEED; the kinds take turns. What the
reference cannot tell (a focal line in an opening, several rays, too many nodes) or what has other light than stated is
drawn again. Sizes run from 1 um to 100 mm, distances from 0.1 mm to 10 m. Nothing here imports the product.
"""

from __future__ import annotations

import mirror_ways
import numpy as np
import way_kinds
from optical_bench import WAVELENGTHS, Bench, finished
from reference_rays import NoReference
from threadpoolctl import threadpool_limits

SEED = 20240611
"""Of all scenes; another one gives other scenes of the same kinds."""

COUNT = 300
ATTEMPTS = 400
"""Draws of a scene until one can be judged."""

POINT = {"pinhole_far": 0.01, "ball": 0.02, "ball_water": 0.02}
"""Kinds whose sources lie nearer to the target's middle than 0.3 mm, since what follows is as near and as small."""

KINDS = {
    kind.__name__: kind
    for kind in (
        way_kinds.free_stop,
        way_kinds.pinhole_far,
        way_kinds.large_stop,
        mirror_ways.fold,
        mirror_ways.fold_two,
        way_kinds.series,
        way_kinds.series_three,
        way_kinds.spatial_filter,
        way_kinds.lens_stop,
        way_kinds.lens_decentred,
        way_kinds.lens_far,
        way_kinds.two_lenses,
        way_kinds.thin_gap,
        way_kinds.vertex_stop,
        way_kinds.bare_lens,
        way_kinds.plate_free,
        way_kinds.plate_on_target,
        way_kinds.plate_on_detector,
        way_kinds.ball,
        way_kinds.ball_water,
        mirror_ways.convex_sphere,
        mirror_ways.convex_mirror,
        mirror_ways.concave_mirror,
        mirror_ways.curved_behind_stop,
        mirror_ways.two_ways_curved,
        mirror_ways.sphere_inside,
    )
}
"""Name to function; scene ``number`` is of the kind ``number`` modulo their count."""


def kind_of(number: int) -> str:
    return list(KINDS)[number % len(KINDS)]


def numbers_of(kinds, count=COUNT):
    """The numbers below ``count`` of scenes of the given kinds."""
    return [number for number in range(count) if kind_of(number) in kinds]


def scene(number: int):
    """Scene ``number`` with its reference field."""
    kind = kind_of(number)
    reasons = {}
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([SEED, number, attempt])
        try:
            with np.errstate(all="ignore"), threadpool_limits(limits=1):  # small matrices: threads only wait
                return _drawn(number, kind, rng)
        except NoReference as reason:
            words = str(reason).split(":")[0].rstrip("0123456789.e-+ ")
            reasons[words] = reasons.get(words, 0) + 1
    raise RuntimeError(f"scene {number} ({kind}): none of {ATTEMPTS} draws can be judged: {reasons}")


def _drawn(number, kind, rng):
    bench = _bench(rng, POINT.get(kind, 0.3))
    return finished(number, kind, bench, KINDS[kind](bench))


def _bench(rng, point, polar=20.0):
    """A source within ``point`` [mm] of the target's middle, a chief ray up to ``polar`` [deg] from the normal."""
    source = np.array([*rng.uniform(-point, point, 2), 0.0])
    angle, azimuth = np.radians(rng.uniform(0, polar)), rng.uniform(0, 2 * np.pi)
    d = np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
    return Bench(rng, source, source.copy(), d, float(rng.choice(WAVELENGTHS)) * 1e-6)
