"""Vendors' lens files: what is read of them, what is refused, and in which words."""

from __future__ import annotations

import numpy as np
import pytest
from bad_scenes import LONGEST_LINE, is_clear
from exact_lenses import focal_length, path
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_lens import END, FRONT, RAYS, WAVELENGTH, through

from speckle_mi.field.simulation import plan_of
from speckle_mi.optics.glass_catalogue import glass_named
from speckle_mi.optics.lens_file import read_lens
from speckle_mi.optics.trace import trace
from speckle_mi.scene.errors import one_line

# An achromat as vendors' files have it: doubled first surface, a stop of its own, coatings, and an image.
ACHROMAT = """VERS 100510 0 123 L123
MODE SEQ
NAME an achromat
UNIT MM X W X CM MR CPMM
ENPD 20
GCAT SCHOTT INFRARED
WAVM 1 0.5876 1
SURF 0
  TYPE STANDARD
  CURV 0.0 0 0.0 0.0 0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.0
  DISZ 5
  DIAM 10 0 0 0 1 ""
SURF 2
  TYPE STANDARD
  CURV 0.015923566878980892
  DISZ 0
  DIAM 12.7 1 0 0 1 ""
SURF 3
  TYPE STANDARD
  CURV 0.015923566878980892 0 0 0 0
  COAT AR
  DISZ 4
  GLAS N-BK7 0 0 1.5168 64.17 0 0 0 0 0 0
  DIAM 12.7 1 0 0 1 ""
SURF 4
  TYPE STANDARD
  CURV -0.02188183807439825
  DISZ 2.5
  GLAS SF5 0 0 1.5 40 0
  DIAM 12.7 1 0 0 1 ""
SURF 5
  CURV -0.0078003120124804995
  DISZ 97
  COAT AR
  DIAM 12.7 1 0 0 1 ""
SURF 6
  CURV 0
  DISZ 0
  DIAM 0.1
TOL TOFF 0 0
"""

ASPHERE = """MODE SEQ
UNIT IN X W
SURF 0
DISZ INFINITY
SURF 1
TYPE EVENASPH
STOP
CURV 1.0
CONI -0.6
PARM 1 0
PARM 2 0.2
PARM 3 -0.3
DISZ 0.25
GLAS ___BLANK 1 0 1.5168 64.17 0 0 0 0 0 0
DIAM 0.4
SURF 2
CURV 0
DISZ 1
DIAM 0.4
CLAP 0 0.35 0
SURF 3
DISZ 0
"""


def lens_from(mi, folder, text: str | bytes, **more):
    path_ = folder / "part.zmx"
    path_.write_bytes(text if isinstance(text, bytes) else text.encode())
    place = mi.ScalarTransform4f().translate([0, 0, FRONT])
    return mi.load_dict({"type": "lens", "id": "lens", "filename": str(path_), "to_world": place} | more)


def refused(mi, folder, text, *words, **more) -> None:
    with pytest.raises(RuntimeError) as caught:
        lens_from(mi, folder, text, **more)
    is_clear(one_line(caught.value), "'part.zmx'", *words)


def test_an_achromat_is_read_with_its_radii_glasses_and_rims(mitsuba, tmp_path):
    element = lens_from(mitsuba, tmp_path, ACHROMAT).element().at(587.5618e-6)
    assert np.allclose([1 / face.curvature for face in element.faces], [62.8, -45.7, -128.2], rtol=1e-12)
    assert np.allclose([face.frame.origin[2] - FRONT for face in element.faces], [0, 4, 6.5])
    assert [face.outline.radius for face in element.faces] == [12.7] * 3
    assert element.media == tuple(glass_named(name).index(587.5618e-6) for name in ("N-BK7", "SCHOTT/SF5"))
    surfaces = [{"radius": r, "after": gap} for r, gap in zip(
        (62.8, -45.7, -128.2), [*zip((4.0, 2.5), element.media, strict=True), (0, 1)], strict=True)]  # fmt: skip
    assert focal_length(surfaces) == pytest.approx(100.1, rel=1e-3)  # of the data sheet


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_a_file_reads_the_same_in_every_encoding(mitsuba, encoding, ends):
    text = ACHROMAT.replace("an achromat", "Achromat f\u00fcr 633 nm").replace("\n", ends)
    lens, plain = read_lens(text.encode(encoding)), read_lens(ACHROMAT.encode())
    assert [vars(one) for one in lens.surfaces] == [vars(one) for one in plain.surfaces]
    assert lens.media == plain.media and lens.thicknesses == plain.thicknesses


def test_paths_through_an_asphere_of_a_file_in_inches_are_exact(mitsuba, tmp_path):
    element = lens_from(mitsuba, tmp_path, ASPHERE).element().at(WAVELENGTH)
    surfaces = [{"radius": 25.4, "conic": -0.6, "aspheric": [0.2 / 25.4**3, -0.3 / 25.4**5],
                 "after": (6.35, element.media[0])}, {"radius": 0}]  # fmt: skip
    assert [face.outline.radius for face in element.faces] == pytest.approx([10.16, 8.89], rel=1e-12)
    assert abs(element.media[0] - glass_named("N-BK7").index(WAVELENGTH)) < 1e-4
    rays = [np.array(part, float) for part in zip(*list(RAYS.values())[:2], strict=True)]
    traced = trace(through(element), *rays)
    assert np.all(traced.valid)
    for number, ray in enumerate(zip(*rays, strict=True)):
        expected, _ = path(surfaces, *ray, FRONT, END)
        assert abs(float(expected - float(traced.optical_path_length[number]))) < 1e-6 * WAVELENGTH


def test_what_is_left_out_of_a_file_is_said_in_one_line(assemble, tmp_path):
    from exact_optics import bench, facing

    (tmp_path / "part.zmx").write_text(ACHROMAT)
    lens = f'<shape type="lens" id="group"><string name="filename" value="{tmp_path / "part.zmx"}"/>' \
           f'<transform name="to_world"><translate z="{FRONT}"/></transform></shape>'  # fmt: skip
    plan = plan_of(assemble(bench(tmp_path, np.zeros(3), facing(110.0), [lens], pixels=(8, 8))))
    note, = plan.warnings
    assert note == "group: of part.zmx is left out: surface 1 (in air), surface 2 (in air), the stop at surface 1, coatings"


def test_a_scene_replaces_the_glass_and_the_diameter_of_a_file(mitsuba, tmp_path):
    text = ACHROMAT.replace("N-BK7", "BK7")
    refused(mitsuba, tmp_path, text, "'BK7'", "not known", "N-BK7")
    element = lens_from(mitsuba, tmp_path, text, glass1="N-BK7", ior2=1.7, diameter=20.0).element().at(WAVELENGTH)
    assert element.media == (glass_named("N-BK7").index(WAVELENGTH), 1.7)
    assert [face.outline.radius for face in element.faces] == [10.0] * 3
    turned = lens_from(mitsuba, tmp_path, ACHROMAT, reverse=True).element().at(WAVELENGTH)
    assert turned.faces[0].curvature == pytest.approx(1 / 128.2, rel=1e-12)


def test_a_dummy_surface_inside_a_glass_only_adds_its_thickness():
    dummy = "SURF 4\nCURV 0\nDISZ 1.5\nGLAS N-BK7 0 0 1.5 40\nDIAM 12.7\nSURF 5"
    text = ACHROMAT.replace("SURF 6", "SURF 7").replace("SURF 5", "SURF 6").replace("SURF 4", dummy)
    lens = read_lens(text.encode())
    assert len(lens.surfaces) == 3 and lens.thicknesses == (5.5, 2.5)
    assert "surface 4 (the same on both sides)" in lens.left_out


def test_a_name_of_several_makers_is_that_of_the_files_catalogues(mitsuba, tmp_path):
    refused(mitsuba, tmp_path, ACHROMAT.replace("GCAT SCHOTT INFRARED\n", ""), "'SF5'", "HIKARI/SF5", "SCHOTT/SF5")
    assert read_lens(ACHROMAT.encode()).glass(1).name == "SCHOTT/SF5"
    assert read_lens(ACHROMAT.replace("GCAT SCHOTT", "GCAT OHARA HIKARI").encode()).glass(1).name == "HIKARI/SF5"


CYLINDER = ASPHERE.replace("UNIT IN", "UNIT MM").replace("EVENASPH", "{}").replace("CURV 1.0", "CURV {}").replace(
    "PARM 1 0\nPARM 2 0.2\nPARM 3 -0.3", "PARM 1 {}\nPARM 2 {}").replace("DISZ 0.25", "DISZ 4").replace(
    "0.4", "6").replace("0.35", "5")  # fmt: skip


@pytest.mark.parametrize("kind, curv, parm1, parm2, form, radius, conic", [
    ("TOROIDAL", 0.02, 0, 0, "cylinder_y", 50.0, -0.6),
    ("BICONICX", 0.02, 0, 0, "cylinder_y", 50.0, -0.6),
    ("BICONICX", 0, 40, -0.3, "cylinder_x", 40.0, -0.3),
    ("BICONICX", 0.02, 50, -0.6, "rotational", 50.0, -0.6),
])  # fmt: skip
def test_a_cylinder_of_a_file_is_one_of_the_lens(mitsuba, tmp_path, kind, curv, parm1, parm2, form, radius, conic):
    lens = lens_from(mitsuba, tmp_path, CYLINDER.format(kind, curv, parm1, parm2))
    face = lens.element().faces[0]
    assert 1 / face.curvature == pytest.approx(radius, rel=1e-12) and face.conic == conic
    assert lens.forms == [form, "rotational"] and face.outline.radius == (5.0 if form != "rotational" else 6.0)


GLASS4 = "  GLAS SF5 0 0 1.5 40 0"

BAD = {
    "nothing": ("", ["no surface"]),
    "another format": ("LEN NEW 1\nRD 20\nTH 3\n", ["no surface", "zmx"]),
    "binary": (bytes(range(256)) * 40, ["binary"]),
    "an archive": (b"PK\x03\x04" + bytes(range(32)) * 100, ["binary"]),
    "truncated in glass": (ACHROMAT.partition("SURF 5")[0], ["surface 4", "bounds a glass"]),
    "truncated before glass": (ACHROMAT.partition("SURF 3")[0], ["no glass"]),
    "a surface missing": (ACHROMAT.replace("SURF 4", "SURF 9"), ["surface 4 is missing"]),
    "not sequential": (ACHROMAT.replace("MODE SEQ", "MODE NSC"), ["not sequential"]),
    "an unknown unit": (ACHROMAT.replace("UNIT MM", "UNIT FURLONG"), ["FURLONG", "MM"]),
    "a mirror": (ACHROMAT.replace("GLAS SF5", "GLAS MIRROR"), ["surface 4", "mirror"]),
    "an unknown type": (ACHROMAT.replace("SURF 4\n  TYPE STANDARD", "SURF 4\n  TYPE GRINSUR5"), ["surface 4", "GRINSUR5"]),
    "a coordinate break": (ACHROMAT.replace("SURF 4\n  TYPE STANDARD", "SURF 4\n  TYPE COORDBRK"), ["surface 4", "COORDBRK"]),
    "a black box": (ACHROMAT.replace("SURF 4\n  TYPE STANDARD", "SURF 4\n  TYPE BLACKBOX"), ["surface 4", "black box"]),
    "not a number": (ACHROMAT.replace("CURV -0.0218", "CURV NaN -0.0218"), ["surface 4", "CURV", "NaN"]),
    "a word for a number": (ACHROMAT.replace("DISZ 2.5", "DISZ thick"), ["surface 4", "DISZ", "thick"]),
    "an infinite gap": (ACHROMAT.replace("DISZ 2.5", "DISZ INFINITY"), ["surface 4", "infinite"]),
    "a negative gap": (ACHROMAT.replace("DISZ 2.5", "DISZ -2.5"), ["'thickness2'", "-2.5"]),
    "no diameter": (ACHROMAT.replace("DIAM 12.7", "DIAM 0"), ["surface 3", "semi-diameter", "'diameter'"]),
    "an unknown glass": (ACHROMAT.replace("N-BK7", "N-BK8"), ["'N-BK8'", "N-BK7"]),
    "a model without numbers": (ACHROMAT.replace(GLASS4, "  GLAS ___BLANK 1"), ["surface 4", "model glass"]),
    "a model of index 0": (ACHROMAT.replace(GLASS4, "  GLAS ___BLANK 1 0 0.0 40"), ["surface 4", "n = 0"]),
    "a term in r^2": (ASPHERE.replace("PARM 1 0", "PARM 1 0.01"), ["surface 1", "r^2"]),
    "a term of another type": (ASPHERE.replace("PARM 3", "PARM 13"), ["surface 1", "PARM 13"]),
    "a toroid": (CYLINDER.format("TOROIDAL", 0.02, 30, 0), ["surface 1", "TOROIDAL", "two radii"]),
    "a toroid of higher order": (CYLINDER.format("TOROIDAL", 0.02, 0, 1e-3), ["surface 1", "PARM 2"]),
    "a million surfaces": ("".join(f"SURF {n}\nCURV 0\n" for n in range(100_000)), ["more than 200 surfaces"]),
    "too large": (b" " * 5_000_000, ["bytes"]),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_file_that_is_no_lens_is_refused_in_one_line(mitsuba, tmp_path, kind):
    text, words = BAD[kind]
    if kind == "a negative gap":  # an error of the numbers, as if the scene had given them
        with pytest.raises(RuntimeError) as caught:
            lens_from(mitsuba, tmp_path, text)
        return is_clear(one_line(caught.value), *words)
    refused(mitsuba, tmp_path, text, *words)


def test_numbers_beside_a_file_and_a_file_that_is_not_there_are_refused(mitsuba, tmp_path):
    with pytest.raises(RuntimeError, match="has 'filename' and 'radius1'"):
        lens_from(mitsuba, tmp_path, ACHROMAT, radius1=5.0)
    with pytest.raises(RuntimeError, match="not a file"):
        mitsuba.load_dict({"type": "lens", "filename": str(tmp_path / "none.zmx")})


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(st.data())
def test_a_damaged_file_gives_a_lens_or_one_clear_line(data):
    text = bytearray((ACHROMAT if data.draw(st.booleans()) else ASPHERE).encode(data.draw(st.sampled_from(
        ["utf-8", "utf-16", "utf-16-be"]))))  # fmt: skip
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(text) - 1))
        what = data.draw(st.sampled_from(["cut", "byte", "word", "twice"]))
        if what == "cut":
            text = text[: at + 1]
        elif what == "byte":
            text[at] = data.draw(st.integers(0, 255))
        elif what == "word":
            text[at : at + 3] = data.draw(st.sampled_from([b"NaN", b"1e999", b"-", b"\n", b" INF ", b"SURF 3\n", b"PARM x y\n"]))
        else:
            text += text[at : at + 80]
    try:
        lens = read_lens(bytes(text))
        for number in range(len(lens.media)):
            lens.glass(number)
    except ValueError as error:
        line = str(error)
        assert line and "\n" not in line and len(line) < LONGEST_LINE, line
