"""Refractive indices of glasses by name against the vendors' formulas, and the focal lengths of parts one can buy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bad_scenes import PARTS, is_clear, on_axis, refusal, scene_with
from exact_lenses import focal_length

from speckle_mi.optics.glass import ModelGlass
from speckle_mi.optics.glass_catalogue import glass_named

INDEX_TOLERANCE = 1e-6
FOCAL_TOLERANCE = 1e-3
"""Relative, of a data sheet's focal length, which has three or four digits."""

LINES = (435.8343, 486.1327, 587.5618, 656.2725, 1060.0)
"""Wavelengths [nm]: g, F, d, C and that of a Nd laser."""

# B1, B2, B3, C1, C2, C3 of Sellmeier's formula, l in um: data sheets of SCHOTT.
SCHOTT = {
    "N-BK7": (1.03961212, 0.231792344, 1.01046945, 0.00600069867, 0.0200179144, 103.560653),
    "N-SF5": (1.52481889, 0.187085527, 1.42729015, 0.011254756, 0.0588995392, 129.141675),
    "N-SF6": (1.77931763, 0.338149866, 2.08734474, 0.0133714182, 0.0617533621, 174.01759),
    "N-SF10": (1.62153902, 0.256287842, 1.64447552, 0.0122241457, 0.0595736775, 147.468793),
    "N-SF11": (1.73759695, 0.313747346, 1.89878101, 0.013188707, 0.0623068142, 155.23629),
    "N-BAF10": (1.5851495, 0.143559385, 1.08521269, 0.00926681282, 0.0424489805, 105.613573),
    "N-BAK4": (1.28834642, 0.132817724, 0.945395373, 0.00779980626, 0.0315631177, 105.965875),
    "N-F2": (1.39757037, 0.159201403, 1.2686543, 0.00995906143, 0.0546931752, 119.248346),
    "N-SK16": (1.34317774, 0.241144399, 0.994317969, 0.00704687339, 0.0229005, 92.7508526),
    "N-LAK22": (1.14229781, 0.535138441, 1.04088385, 0.00585778594, 0.0198546147, 100.834017),
    "N-K5": (1.08511833, 0.199562005, 0.930511663, 0.00661099503, 0.024110866, 111.982777),
    "N-SK2": (1.28189012, 0.257738258, 0.96818604, 0.0072719164, 0.0242823527, 110.377773),
    "N-SF57": (1.87543831, 0.37375749, 2.30001797, 0.0141749518, 0.0640509927, 177.389795),
    "N-SF1": (1.60865158, 0.237725916, 1.51530653, 0.0119654879, 0.0590589722, 135.521676),
    "N-LASF9": (2.00029547, 0.298926886, 1.80691843, 0.0121426017, 0.0538736236, 156.530829),
    "N-KZFS4": (1.35055424, 0.197575506, 1.09962992, 0.0087628207, 0.0371767201, 90.3866994),
    "N-FK51A": (0.971247817, 0.216901417, 0.904651666, 0.00472301995, 0.0153575612, 168.68133),
    "N-SSK5": (1.59222659, 0.103520774, 1.05174016, 0.00920284626, 0.0423530072, 106.927374),
    "N-BAK1": (1.12365662, 0.309276848, 0.881511957, 0.00644742752, 0.0222284402, 107.297751),
    "F2": (1.34533359, 0.209073176, 0.937357162, 0.00997743871, 0.0470450767, 111.886764),
}  # fmt: skip

OTHERS = {
    # Malitson, doi:10.1364/JOSA.55.001205; C as squares of the wavelengths of its resonances.
    "fused silica": (0.6961663, 0.4079426, 0.8974794, 0.0684043**2, 0.1162414**2, 9.896161**2),
    # Malitson, doi:10.1364/AO.2.001103
    "CaF2": (0.5675888, 0.4710914, 3.8484723, 0.050263605**2, 0.1003909**2, 34.649040**2),
}


def sellmeier(constants: tuple[float, ...], nm: float) -> float:
    square = (nm * 1e-3) ** 2
    return math.sqrt(1 + sum(b * square / (square - c) for b, c in zip(constants[:3], constants[3:], strict=True)))


@pytest.mark.parametrize("name", [*SCHOTT, *OTHERS])
def test_an_index_is_that_of_the_vendors_formula(name):
    constants, glass = (SCHOTT | OTHERS)[name], glass_named(f"SCHOTT/{name}" if name in SCHOTT else name)
    for line in LINES:
        assert abs(glass.index(line * 1e-6) - sellmeier(constants, line)) < INDEX_TOLERANCE


@pytest.mark.parametrize("name, n_d", [
    ("N-BK7", 1.51680), ("N-SF5", 1.67271), ("N-SF11", 1.78472), ("N-BAF10", 1.67003), ("SCHOTT/F2", 1.62004),
    ("N-LASF9", 1.85025), ("N-SK16", 1.62041), ("OHARA/S-BSL7", 1.51633), ("CDGM/H-K9L", 1.51680),
    ("OHARA/S-TIH53", 1.84666), ("HOYA/BSC7", 1.51680), ("fused silica", 1.45846),
])  # fmt: skip
def test_an_index_at_the_d_line_is_the_catalogues(name, n_d):
    assert glass_named(name).index(587.5618e-6) == pytest.approx(n_d, abs=1.01e-5)


def test_names_are_alike_in_upper_and_lower_case_and_air_is_one():
    assert glass_named("schott/n-bk7") == glass_named("N-BK7") == glass_named(" N-bk7 ")
    assert glass_named("Fused  Silica") == glass_named("fused_silica")
    assert glass_named("air").index(1e-3) == 1.0


@pytest.mark.parametrize("name, near", [("BK7", "N-BK7"), ("N-BK8", "N-BK7"), ("H-K9", "H-K9L"),
                                        ("silicate", "silica"), ("SCHOTT/K9L", "H-K9L")])  # fmt: skip
def test_a_name_that_nobody_uses_is_refused_with_near_ones(name, near):
    with pytest.raises(ValueError, match="not known") as caught:
        glass_named(name)
    assert near in str(caught.value) and len(str(caught.value)) < 300


def test_a_name_that_several_use_wants_the_maker():
    with pytest.raises(ValueError, match="several.*HIKARI/SF5.*SCHOTT/SF5"):
        glass_named("SF5")


def test_a_wavelength_beyond_the_formulas_is_refused_with_its_range():
    with pytest.raises(ValueError, match="300 to 2500 nm, not at 250 nm"):
        glass_named("N-BK7").index(250e-6)


@pytest.mark.parametrize("name", ["N-BK7", "N-SF11", "N-BAF10", "N-FK51A", "N-KZFS4"])
def test_a_model_glass_follows_its_original_from_violet_to_infrared(name):
    glass = glass_named(name)
    blue, yellow, red = (glass.index(line * 1e-6) for line in (486.1327, 587.5618, 656.2725))
    model = ModelGlass(yellow, (yellow - 1) / (blue - red))
    for nm in np.linspace(440, 850, 12):
        assert abs(model.index(nm * 1e-6) - glass.index(nm * 1e-6)) < 5e-4
    assert model.index(486.1327e-6) - model.index(656.2725e-6) == pytest.approx(blue - red, rel=1e-9)


# Radii and thicknesses [mm], glasses, wavelength [nm] and focal length [mm] as their data sheets give them.
PARTS_ONE_CAN_BUY = {
    "Thorlabs AC254-100-A": ((62.8, -45.7, -128.2), (4.0, 2.5), ("N-BK7", "SCHOTT/SF5"), 587.6, 100.1),
    "Thorlabs AC254-200-A": ((77.4, -87.6, 291.1), (4.0, 2.5), ("N-SSK5", "LAFN7"), 587.6, 200.2),
    "Thorlabs LA1509": ((51.5, 0.0), (3.6,), ("N-BK7",), 587.6, 99.7),
    "Thorlabs LA1608": ((38.6, 0.0), (4.1,), ("N-BK7",), 587.6, 74.7),
    "Thorlabs LA1433": ((77.3, 0.0), (3.1,), ("N-BK7",), 587.6, 149.5),
    "Thorlabs LB1676": ((102.4, -102.4), (3.6,), ("N-BK7",), 587.6, 99.7),
}


@pytest.mark.parametrize("part", PARTS_ONE_CAN_BUY)
def test_the_focal_length_of_a_part_is_that_of_its_data_sheet(part):
    radii, thicknesses, glasses, nm, stated = PARTS_ONE_CAN_BUY[part]
    after = [(t, glass_named(g).index(nm * 1e-6)) for t, g in zip(thicknesses, glasses, strict=True)]
    surfaces = [{"radius": r, "after": gap} for r, gap in zip(radii, [*after, (0, 1)], strict=True)]
    assert focal_length(surfaces) == pytest.approx(stated, rel=FOCAL_TOLERANCE)


# In a scene

SINGLET = '<shape type="lens" id="lens">{}<float name="radius1" value="50"/><float name="thickness" value="5"/>' \
          '<float name="diameter" value="20"/>{}</shape>'  # fmt: skip


def lens_of(*inside: str) -> str:
    return SINGLET.format(on_axis(25.0), "".join(inside))


def text(name: str, value: str) -> str:
    return f'<string name="{name}" value="{value}"/>'


@pytest.mark.parametrize("nm", [486.1327, 632.8, 1060.0])
def test_a_lens_has_the_index_of_its_glass_at_the_lasers_wavelength(assemble, nm):
    laser = PARTS["laser"].replace('"632.8"', f'"{nm}"')
    assembly = assemble(scene_with(lens=lens_of(text("glass", "N-BK7")), laser=laser))
    lens = next(one for one in assembly.elements if one.name == "lens")
    assert abs(lens.media[0] - sellmeier(SCHOTT["N-BK7"], nm)) < INDEX_TOLERANCE
    assert abs(lens.at(587.5618e-6).media[0] - 1.5168) < 1e-6


@pytest.mark.parametrize("inside, words", [
    ([text("glass", "N-BK8")], ["'lens'", "'glass'", "'N-BK8'", "N-BK7"]),
    ([text("glass", "SF5")], ["'lens'", "HIKARI/SF5", "SCHOTT/SF5"]),
    ([text("glass", "")], ["'lens'", "'glass'"]),
    ([text("glass", "N-BK7"), '<float name="ior" value="1.5"/>'], ["'ior'", "'glass'", "one of them"]),
    ([text("glass", "N-BK7"), text("glass1", "N-BK7")], ["'glass'", "'glass1'", "one of them"]),
    ([text("glass", "SCHOTT/IRG26")], ["'lens'", "850", "632.8 nm"]),
    ([text("glass", "SCHOTT/B270")], ["'lens'", "no dispersion formula", "'ior'"]),
    (['<float name="glass" value="1.5"/>'], ["'glass'", "must be a text"]),
])  # fmt: skip
def test_glasses_that_cannot_be_are_refused_by_name(mitsuba, inside, words):
    is_clear(refusal(mitsuba, scene_with(lens=lens_of(*inside))), *words)
