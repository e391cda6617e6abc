"""Extremes of scale: wavelengths, distances, spots, pixels, detectors, and where in the world everything stands."""

from __future__ import annotations

import resource
import sys

import numpy as np

from ...geometry.frames import Frame
from ...geometry.rotation import rotation_matrix
from ...scene.read import BYTES_PER_PIXEL
from .case import Case, compared, same_field, within
from .scenes import Bench, against_exact_sum, aperture, lens

TOLERANCE = 1e-4
"""The integrator's default, which every field must keep."""

LARGEST_SIDE = 8192


def wavelengths(quick: bool):
    for wavelength in (200.0, 632.8, 10600.0) if quick else (200.0, 405.0, 632.8, 1550.0, 10600.0):
        bench = Bench(laser={"wavelength": wavelength})
        yield same_field("wavelength", f"field at {wavelength:g} nm", *against_exact_sum(bench), TOLERANCE)


def distances(quick: bool):
    for distance in (0.5, 10.0, 1e4) if quick else (0.5, 2.0, 10.0, 100.0, 1e3, 1e4):
        pitch = min(0.05, 0.006 * distance / 60)
        bench = Bench(
            laser_distance=distance,
            detector_distance=distance,
            detector={"pixel_pitch": pitch},
            laser={"beam_radius": min(0.12, 0.1 * distance)},
        )
        yield same_field("distance", f"field at {distance:g} mm", *against_exact_sum(bench), TOLERANCE)


def spots(quick: bool):
    for radius in (0.0006328, 0.01, 20.0) if quick else (0.0006328, 0.002, 0.01, 0.1, 1.0, 20.0):
        bench = Bench(laser={"beam_radius": radius}, target={"width": 150.0, "height": 150.0, "point_sources": 200})
        yield same_field("spot", f"field of a spot of {radius:g} mm", *against_exact_sum(bench), TOLERANCE)


def pixels(quick: bool):
    for pitch in (1e-4, 0.05) if quick else (1e-4, 1e-3, 0.01, 0.05):
        bench = Bench(detector={"pixel_pitch": pitch})
        yield same_field("pixel", f"field on pixels of {pitch * 1e3:g} um", *against_exact_sum(bench), TOLERANCE)


def detectors(quick: bool):
    for columns, rows in ((1, 1), (4096, 1), (1, 4096), (2, 3)):
        bench = Bench(detector={"width": columns, "height": rows})
        yield same_field("detector", f"field on {columns} x {rows} pixels", *against_exact_sum(bench), TOLERANCE)


def detector_of_67_million_pixels(quick: bool):
    before = _peak_memory()
    bench = Bench(detector={"width": LARGEST_SIDE, "height": LARGEST_SIDE, "pixel_pitch": 0.001})
    name = f"{LARGEST_SIDE} x {LARGEST_SIDE} pixels"
    yield same_field(
        "detector", f"field on {name}", *against_exact_sum(bench.with_(target={"point_sources": 20})), TOLERANCE
    )
    taken = max(_peak_memory() - before, 0.0) / LARGEST_SIDE**2
    yield within("detector", f"peak memory of {name} [bytes a pixel]", taken, BYTES_PER_PIXEL, taken, BYTES_PER_PIXEL)


def _peak_memory() -> float:
    """Largest memory that the process has taken so far [bytes]."""
    unit = 1 if sys.platform == "darwin" else 1024
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * unit


def places_in_the_world(quick: bool):
    """A rigid motion of everything changes nothing: two fields that each keep the tolerance."""
    random = np.random.default_rng(5)
    turn = rotation_matrix(random.normal(size=3))
    worlds = {
        "moved by 10 m": Frame(np.array([6e3, -6e3, 5.3e3]), np.eye(3)),
        "rotated at random": Frame(np.zeros(3), turn),
        "moved and rotated": Frame(np.array([6e3, -6e3, 5.3e3]), turn),
    }
    for name, bench in _benches().items():
        reference = bench.field()
        for change, world in worlds.items():
            yield same_field(
                "place", f"field of {name}, {change}", bench.with_(world=world).field(), reference, 2 * TOLERANCE
            )


def order_of_parts(quick: bool):
    """The order of the parts in the file changes not even a bit."""
    for name, bench in _benches().items():
        field, other = bench.field(), bench.with_(backwards=True).field()
        yield compared("order", f"field of {name}, parts in reverse", float(np.abs(field - other).max()), 0.0, 0.0)


def _benches() -> dict[str, Bench]:
    small = {"width": 32, "height": 24}
    return {
        "free space": Bench(detector=small),
        "an aperture": Bench(detector=small, elements=(aperture(41.0, radius=0.5),)),
    }


def lens_in_the_world(quick: bool):
    world = Frame(np.array([6e3, -6e3, 5.3e3]), rotation_matrix(np.random.default_rng(5).normal(size=3)))
    thick = {"radius1": 50.0, "radius2": -50.0, "thickness": 5.0, "diameter": 20.0, "ior": 1.5151}
    bench = Bench(
        detector_distance=199.0,
        detector={"width": 24, "height": 24},
        target={"point_sources": 50},
        elements=(lens(97.0685, **thick), aperture(103.0, radius=1.0)),
    )
    moved = bench.with_(world=world)
    yield same_field("place", "field through a lens, moved and rotated", moved.field(), bench.field(), 2 * TOLERANCE)


CASES = (
    Case(wavelengths),
    Case(distances),
    Case(spots),
    Case(pixels),
    Case(detectors),
    Case(detector_of_67_million_pixels, in_quick=False),
    Case(places_in_the_world),
    Case(order_of_parts),
    Case(lens_in_the_world),
)
