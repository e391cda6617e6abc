"""The ready parts in ``scenes/parts/``: their prescriptions against the textbook, their scenes against exact rays."""

from __future__ import annotations

import numpy as np
import pytest
from exact_lenses import focal_length, path
from scipy.optimize import brentq, minimize_scalar

from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.field.simulation import plan_of
from speckle_mi.optics.glass_catalogue import glass_named

RADII, THICKNESSES, GLASSES = (43.65, -43.65, -1400.0), (6.0, 2.5), ("SCHOTT/N-BK7", "SCHOTT/F2")


def achromat(nm: float) -> list[dict]:
    after = [(t, glass_named(g).index(nm * 1e-6)) for t, g in zip(THICKNESSES, GLASSES, strict=True)]
    return [{"radius": r, "after": gap} for r, gap in zip(RADII, [*after, (0.0, 1.0)], strict=True)]


def test_the_achromat_has_one_focal_length_in_blue_and_red():
    blue, yellow, red = map(focal_length, map(achromat, (486.1327, 587.5618, 656.2725)))
    assert yellow == pytest.approx(100.0, rel=1e-3)
    # A singlet of N-BK7 differs by f / V = 1.6 mm; the secondary spectrum of this pair is f / 2000.
    assert abs(blue - red) < 0.02 and abs(yellow - (blue + red) / 2) < 0.06


def test_the_scene_has_the_parts_prescription(shipped):
    lens = next(one for one in shipped("parts/achromat").elements if one.name == "achromat")
    assert np.allclose([1 / face.curvature for face in lens.faces], RADII, rtol=1e-12)
    assert np.allclose(lens.media, [gap[1] for gap in (one["after"] for one in achromat(632.8)[:2])], rtol=0, atol=1e-12)


def test_the_detector_of_the_achromat_stands_where_the_rays_make_the_smallest_spot(shipped):
    assembly = shipped("parts/achromat")
    lens, stop = ({one.name: one for one in assembly.elements}[name] for name in ("achromat", "stop"))
    front, at_stop = lens.faces[0].frame.origin[2], stop.faces[0].frame.origin[2]
    surfaces = achromat(632.8)
    rims = 2.0 * np.sqrt((np.arange(8) + 0.5) / 8)  # rings of equal area

    def landing(slope: float, z: float) -> float:
        return path(surfaces, [0, 0, 0], [slope, 0, 1], front, z)[1][0]

    slopes = [brentq(lambda m, rim=rim: landing(m, at_stop) - rim, 0, 0.05) for rim in rims]
    best = minimize_scalar(lambda z: sum(landing(m, z) ** 2 for m in slopes), bounds=(401.0, 405.0), method="bounded",
                           options={"xatol": 1e-4})  # fmt: skip
    assert assembly.detector.centre[2] == pytest.approx(best.x, abs=1e-2)


def test_the_pattern_behind_the_achromat_moves_as_the_image(shipped):
    assembly = shipped("parts/achromat", width=32, height=32)
    assert any("achromat - achromat - achromat - stop" in line for line in plan_of(assembly).lines)
    # v runs along -y; the image is upside down and 1.004 times the target, 2 f before and behind.
    assert expected_sensitivity(assembly)["x"][0] == pytest.approx(-1.0, abs=0.02)


def test_the_rays_through_the_asphere_meet_in_one_point(shipped):
    assembly = shipped("parts/asphere")
    lens = next(one for one in assembly.elements if one.name == "asphere")
    front, index = lens.faces[0].frame.origin[2], glass_named("SCHOTT/P-SK57").index(632.8e-6)

    def ends(coefficients) -> list[float]:
        first = {"radius": 28.0, "aspheric": coefficients, "after": (6.0, index)}
        second = {"radius": -28.0, "aspheric": [-one for one in coefficients], "after": (0.0, 1.0)}
        centre = float(assembly.detector.centre[2])
        return [float(path([first, second], [0, 0, 0], [m, 0, 1], front, centre)[1][0]) for m in (0.02, 0.05, 0.08, 0.1)]

    assert np.abs(ends((-1.4295e-5, 4.023e-9))).max() < 3e-5
    assert np.abs(ends(())).max() > 0.3
    # The scene's own faces are these.
    r = np.array([2.0, 4.0, 5.5])
    sphere = 28 - np.sqrt(28**2 - r * r)
    assert np.allclose(lens.faces[0].sag(r, 0 * r), sphere - 1.4295e-5 * r**4 + 4.023e-9 * r**6, rtol=0, atol=1e-12)


def test_the_pattern_behind_the_asphere_moves_as_the_image(shipped):
    assembly = shipped("parts/asphere", width=32, height=32)
    assert any("asphere - asphere - stop" in line for line in plan_of(assembly).lines)
    assert expected_sensitivity(assembly)["x"][0] == pytest.approx(-1.0, abs=0.02)


def test_the_diode_lights_an_ellipse_as_each_axis_goes_through_the_collimator(shipped):
    """By the complex parameter of either axis through a thick lens between its principal planes."""
    beam = shipped("parts/diode", width=32, height=32).beam
    n, radius, thickness, wavelength = 1.5151, 5.0, 2.0, 632.8e-6
    focus = 1 / ((n - 1) * (2 / radius - (n - 1) * thickness / (n * radius**2)))
    inside = focus * (n - 1) * thickness / (n * radius)
    for found, waist in zip(beam.radii, (0.006, 0.003), strict=True):
        q = -1j * np.pi * waist**2 / wavelength + 4.55 + inside
        q = 1 / (1 / q - 1 / focus) + inside + 40
        assert found == pytest.approx(np.sqrt(wavelength / (np.pi * (1 / q).imag)), rel=0.01)
