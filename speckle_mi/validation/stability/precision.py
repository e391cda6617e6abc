"""Rounding: single against double precision, sums of very many terms, random rays, and fits with hardly any data."""

from __future__ import annotations

import math

import numpy as np

from ...geometry.plane import PlanePoints
from .case import BROKEN, LIMIT, OK, Case, Check, compared, same_field, within
from .scenes import WAVELENGTH, Bench, against_exact_sum, exact_sum, pixel_centres, sampled_pixels

SINGLE_PRECISION = 1e-6
"""Of the method ``direct``."""


def single_precision_paths(quick: bool):
    """The same sum with float32 paths, which would fail, and as it is computed, with float64 paths."""
    from ...field.simulation import simulate_frame

    for distance in (60.0, 1e4):
        bench = Bench(detector_distance=distance, integrator={"method": "direct"})
        assembly = bench.assembly()
        frame = simulate_frame(assembly)
        pick = sampled_pixels(assembly.detector)
        places, lit = pixel_centres(assembly.detector, pick), frame.scatterers
        exact = exact_sum(lit.position, lit.amplitude, places, WAVELENGTH)
        offset = places[:, None].astype(np.float32) - lit.position.astype(np.float32)
        r = np.sqrt(np.sum(offset * offset, axis=-1))
        phase = np.float32(2 * np.pi / WAVELENGTH) * r
        narrow = np.sum(lit.amplitude * np.exp(1j * phase.astype(np.float64)) / r, axis=1)
        lost = float(np.linalg.norm(narrow - exact) / np.linalg.norm(exact))
        # Shown to fail: a float32 path of 60 mm is off by 0.04 rad, of 10 m by several.
        shown = OK if lost > 100 * SINGLE_PRECISION else BROKEN
        name = f"field at {distance:g} mm"
        yield Check(
            "float32 paths", f"{name}, float32 (not used)", lost, f"> {100 * SINGLE_PRECISION:g}", lost, math.inf, shown
        )
        computed = frame.image.field.ravel()[pick]
        yield same_field("float64 paths", f"{name}, as computed", computed, exact, SINGLE_PRECISION)


def sums_of_many_terms(quick: bool):
    """Sources on a sphere around the point: all terms are in phase, and the sum is their number times e^{ikr}/r."""
    from ...propagation.coherent_sum import coherent_sum
    from ...propagation.paths import FreeSpace

    random = np.random.default_rng(7)
    point = PlanePoints(np.array([0, 0, 60.0]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.zeros(1), np.zeros(1))
    for count in (10**3, 10**5, 10**6) if quick else (10**3, 10**5, 10**6, 10**7):
        x, y = random.uniform(-1, 1, (2, count))
        sources = np.stack([x, y, 60.0 - np.sqrt(60.0**2 - x * x - y * y)], axis=1)
        found = coherent_sum(FreeSpace(), sources, np.ones(count, complex), point, WAVELENGTH, "direct").field
        turns = 60.0 / WAVELENGTH
        exact = count / 60.0 * np.exp(2j * np.pi * (turns - round(turns)))
        yield same_field("many terms", f"sum of {count:.0e} terms in phase", found, np.array([exact]), SINGLE_PRECISION)
        weights = np.exp(2j * np.pi * random.random(count))
        found = coherent_sum(FreeSpace(), sources, weights, point, WAVELENGTH, "direct").field
        total = complex(math.fsum(weights.real), math.fsum(weights.imag))
        exact = total / 60.0 * np.exp(2j * np.pi * (turns - round(turns)))
        yield same_field(
            "many terms", f"sum of {count:.0e} terms at random", found, np.array([exact]), SINGLE_PRECISION
        )


def rays_as_their_number_grows(quick: bool):
    """The paper's method against the exact sum: the error falls with the rays, down to rounding."""
    small = {"width": 24, "height": 24, "pixel_pitch": 0.1}
    bench = Bench(detector=small, target={"point_sources": 5})
    exact = bench.with_(integrator={"method": "direct"}).field()
    last = math.inf
    for rays, bound in (
        ((16, 0.1), (100, 1e-5), (1500, 1e-6))
        if quick
        else ((16, 0.1), (64, 1e-4), (400, 1e-6), (1500, 1e-6), (10**4, 1e-6))
    ):
        found = bench.with_(integrator={"method": "rays", "rays_per_source": rays}).field()
        check = same_field("rays", f"field of {rays} rays a source", found, exact, min(bound, max(last, 1e-6)))
        last = check.error
        yield check


def tolerances(quick: bool):
    """Every tolerance that may be asked for is kept, against the sum in extended precision."""
    for tolerance in (1e-8, 1e-1) if quick else (1e-8, 1e-6, 1e-4, 1e-2, 1e-1):
        bench = Bench(integrator={"tolerance": tolerance}, detector={"width": 128, "height": 128})
        yield same_field("tolerance", f"field at {tolerance:g}", *against_exact_sum(bench), tolerance)


def fits_with_hardly_any_data(quick: bool):
    from ...measurement.sensitivity import fit_sensitivity

    line = fit_sensitivity(np.array([-0.1, 0.1]), np.array([[-50.0, 50.0]]), np.array([[0.9, 0.9]]))
    yield compared("fit", "slope, two displacements of one surface [mm/mm]", line.value, 0.5, 1e-12)
    one = fit_sensitivity(np.array([0.1]), np.array([[50.0]]))
    yield compared("fit", "slope of a single frame [mm/mm]", one.value, 0.5, 1e-12)
    yield _undefined("interval of a single frame", one.ci95[0], one.note)
    lost = fit_sensitivity(np.array([-0.1, 0.1]), np.array([[1.0, 2.0]]), np.zeros((1, 2)))
    yield _undefined("slope where nothing correlates", lost.value, lost.note)
    never = fit_sensitivity(np.array([-0.1, 0.1]), np.full((3, 2), np.nan))
    yield _undefined("slope where no frame was measured", never.value, never.note)
    rest = fit_sensitivity(np.zeros(3), np.zeros((2, 3)))
    yield _undefined("slope without any displacement", rest.value, rest.note)
    for scale in (1e-300, 1e-150, 1e150):
        steps = scale * np.array([-1.0, -0.5, 0.5, 1.0])
        fitted = fit_sensitivity(steps, 0.7e3 * np.stack([steps, steps]), np.full((2, 4), 0.5))
        yield compared("fit", f"slope, displacements of {scale:g} mm [mm/mm]", fitted.value, 0.7, 1e-9)
    uneven = fit_sensitivity(
        np.array([-0.1, 0.1]), np.array([[-50.0, 50.0], [300.0, -900.0]]), np.array([[1.0, 1.0], [1e-9, 1e-9]])
    )
    yield within(
        "fit",
        "slope, one surface all but decorrelated: finite",
        uneven.value,
        "finite",
        0.0 if np.isfinite(uneven.value) else math.inf,
        0.0,
    )


def _undefined(quantity: str, value: float, note: str) -> Check:
    """Where nothing can be said: NaN, with a reason."""
    clear = math.isnan(value) and bool(note)
    return Check("fit", quantity, value, "NaN, with a reason", 0.0, 0.0, LIMIT if clear else BROKEN, note)


CASES = (
    Case(single_precision_paths),
    Case(sums_of_many_terms),
    Case(rays_as_their_number_grows),
    Case(tolerances),
    Case(fits_with_hardly_any_data),
)
