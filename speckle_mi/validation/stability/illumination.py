"""Extremes of the illumination: grazing beams, curved and plane wavefronts, foci on target and detector."""

from __future__ import annotations

import numpy as np

from .case import Case, compared, declined, same_field, within
from .scenes import WAVELENGTH, Bench, against_exact_sum, exact_laser

TOLERANCE = 1e-4


def grazing_incidence(quick: bool):
    for angle in (0.0, 80.0, 89.0) if quick else (0.0, 45.0, 80.0, 85.0, 88.0, 89.0):
        bench = Bench(laser_angle=angle, target={"width": 100.0, "height": 10.0})
        yield same_field("grazing", f"field at an incidence of {angle:g} deg", *against_exact_sum(bench), TOLERANCE)
    yield declined("grazing", "incidence of 90 deg", Bench(laser_angle=90.0).assembly, "runs along", "must meet")
    yield declined("grazing", "incidence of 91 deg", Bench(laser_angle=91.0).assembly, "back")


def wavefronts(quick: bool):
    """The phase of the laser's field against its definition in extended precision."""
    random = np.random.default_rng(3)
    for radius in (
        (0.1, -0.1, 750.0, 1e15, np.inf) if quick else (0.1, -0.1, 1.0, -1.0, 750.0, -750.0, 1e6, -1e9, 1e15, np.inf)
    ):
        # Within the steepest beam there is.
        laser = {"wavefront_radius": radius, "beam_radius": min(0.12, 0.3 * abs(radius))}
        assembly = Bench(laser=laser).assembly()
        points = assembly.spot.point + random.uniform(-0.3, 0.3, (2000, 3))
        # Paths of up to 1e5 wavelengths hold 1e-11 of a turn in double precision.
        name = f"laser's field, wavefront radius {radius:g} mm"
        yield same_field("wavefront", name, assembly.beam.field(points), exact_laser(assembly.beam, points), 1e-9)
        bench = Bench(laser=laser)
        yield same_field("wavefront", f"field, wavefront radius {radius:g} mm", *against_exact_sum(bench), TOLERANCE)
    for radii, bends in (((0.02, 0.3), (-750.0, 90.0)), ((0.05, 0.05), (0.2, -0.2)), ((np.inf, np.inf), (0.3, -0.2))):
        laser = {"beam_radius": None, "wavefront_radius": None}
        laser |= {f"beam_radius_{axis}": radius for axis, radius in zip("xy", radii, strict=True)}
        laser |= {f"wavefront_radius_{axis}": radius for axis, radius in zip("xy", bends, strict=True)}
        bench = Bench(laser=laser)
        assembly = bench.assembly()
        name = f"beam radii {radii[0]:g}, {radii[1]:g} mm, wavefronts {bends[0]:g}, {bends[1]:g} mm"
        points = assembly.spot.point + random.uniform(-0.3, 0.3, (2000, 3))
        exact = exact_laser(assembly.beam, points)
        yield same_field("wavefront", f"laser's field, {name}", assembly.beam.field(points), exact, 1e-9)
        yield same_field("wavefront", f"field, {name}", *against_exact_sum(bench), TOLERANCE)
    yield declined(
        "wavefront", "wavefront radius 0", Bench(laser={"wavefront_radius": 0.0}).assembly, "wavefront_radius", "inf"
    )
    steep = Bench(laser={"wavefront_radius": -0.1})
    yield declined("wavefront", "wavefront radius -0.1 of a wider beam", steep.assembly, "beam_radius", "at most")


def focus_on_the_target(quick: bool):
    """A waist of a wavelength, and a point focus of uniform light, in which it stays finite."""
    bench = Bench(laser={"beam_radius": WAVELENGTH, "wavefront_radius": np.inf}, target={"point_sources": 20})
    yield same_field("focus on the target", "field of a waist of one wavelength", *against_exact_sum(bench), TOLERANCE)
    for radius in (1e-6, -1e-6):
        assembly = Bench(laser={"wavefront_radius": radius, "beam_radius": np.inf}).assembly()
        points = np.array([assembly.spot.point, assembly.spot.point - radius * assembly.beam.axis])
        modulus = np.abs(assembly.beam.field(points))
        yield within(
            "focus on the target",
            f"modulus in the focus, R = {radius:g} mm",
            modulus.max(),
            1.0,
            np.abs(modulus - 1).max(),
            1e-9,
        )


def focus_on_the_detector(quick: bool):
    """A smooth target under a beam that converges on the detector: density pi w^2 / z there, spot lambda z / (pi w)."""
    from ...field.simulation import simulate

    z, w = 60.0, 0.12
    bench = Bench(
        laser_angle=0.0,
        laser={"wavefront_radius": -z},
        target={"roughness": 0.0, "point_sources": 20_000},
        detector={"width": 257, "height": 1, "pixel_pitch": 0.004},
    )
    assembly = bench.assembly()
    field = np.abs(simulate(assembly).field[0])
    peak = assembly.target.surface.density * np.pi * w**2 / z
    yield compared("focus on the detector", "field in the focus", field[128], peak, 5e-3, relative=True)
    waist = WAVELENGTH * z / (np.pi * w)
    inside = np.abs(np.arange(257) - 128) * 0.004 < waist
    u = ((np.arange(257) - 128) * 0.004)[inside]
    fitted = np.sqrt(-1 / np.polyfit(u**2, np.log(field[inside]), 1)[0])
    yield compared("focus on the detector", "waist lambda z / (pi w) [mm]", fitted, waist, 0.01, relative=True)


CASES = (Case(grazing_incidence), Case(wavefronts), Case(focus_on_the_target), Case(focus_on_the_detector))
