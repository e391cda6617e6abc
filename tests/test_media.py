"""Glasses and mirrors as their BSDFs describe them, and the medium that a whole scene stands in."""

from __future__ import annotations

import numpy as np
import pytest
from bad_scenes import PARTS, is_clear, on_axis, refusal, scene_with
from exact_optics import bench, diffracted, disc_nodes, element_xml, facing, rendered_unit
from scene_builder import WORLD, direction, frame_along, parameters
from scipy.optimize import brentq

from speckle_mi.field.simulation import simulate_frame
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.optics.sequence import Interaction, Sequence, amplitude_of
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.unfold import unfold
from speckle_mi.scene.elements import OUTSIDE as AROUND
from speckle_mi.scene.read import assembly_from_scene

VACUUM = 632.8e-6  # mm

BK7, WATER, AIR = 1.5046, 1.3330, 1.000277
"""Indices of Mitsuba's table."""

SINGLE = 1e-7
"""Relative rounding of single precision: what a decimal number is known to where the file's own is not."""

FIELD_TOLERANCE = 1e-5
"""Relative, of a scene whose tolerance is 1e-6."""


def dielectric(name: str = "", **values) -> str:
    return f'<bsdf type="dielectric"{f" id={name!r}" if name else ""}>{parameters(values)}</bsdf>'


def shape(kind: str, bsdf: str, name: str = "odd", z: float = 30.0, inside: str = "") -> str:
    identity = f' id="{name}"' if name else ""
    return f'<shape type="{kind}"{identity}>{on_axis(z)}{inside}{bsdf}</shape>'


def with_shapes(*shapes: str, lens: str = "") -> str:
    return scene_with(lens=lens, aperture="", **{f"shape{i}": one for i, one in enumerate(shapes)})


def element(assemble, name: str, *shapes: str, **more):
    found = {one.name: one for one in assemble(with_shapes(*shapes, **more)).elements}
    return found[name]


# Indices


@pytest.mark.parametrize("kind", ["sphere", "cube"])
@pytest.mark.parametrize(
    "values, index, medium",
    [
        ({"int_ior": 1.5168}, 1.5168 / AIR, 1.0),
        ({"int_ior": 1.5168, "ext_ior": 1.0}, 1.5168, 1.0),
        ({"int_ior": 1.5, "ext_ior": 1.33}, 1.5 / 1.33, 1.33),
        ({"int_ior": "bk7", "ext_ior": "water"}, BK7 / WATER, WATER),
        ({"int_ior": "diamond", "ext_ior": "air"}, 2.419 / AIR, 1.0),
        ({"int_ior": "air", "ext_ior": "water"}, AIR / WATER, WATER),
        ({}, BK7 / AIR, 1.0),
    ],
)
def test_an_index_is_the_files_own_to_the_last_digit(assemble, kind, values, index, medium):
    assembly = assemble(with_shapes(shape(kind, dielectric(**values))))
    assert assembly.elements[0].index == index
    assert assembly.index == medium
    assert assembly.beam.wavelength == pytest.approx(VACUUM / medium, rel=1e-15)
    assert assembly.vacuum_wavelength == pytest.approx(VACUUM, rel=1e-15)


def test_an_index_is_found_through_references_and_for_shapes_without_a_name(assemble):
    glass = dielectric("glass", int_ior=1.6, ext_ior=1.33)
    assembly = assemble(with_shapes(glass, shape("sphere", '<ref id="glass"/>', name="ball", z=20.0)))
    assert (assembly.elements[0].index, assembly.index) == (1.6 / 1.33, 1.33)
    one, two = (shape("sphere", dielectric(int_ior=n, ext_ior=1.33), "", z) for n, z in ((1.5, 20.0), (1.7, 30.0)))
    assembly = assemble(with_shapes(one, two))
    indices = {one.faces[0].frame.origin[2] + 1.0: one.index for one in assembly.elements}
    assert indices == {20.0: 1.5 / 1.33, 30.0: 1.7 / 1.33} and assembly.index == 1.33


def test_a_scene_from_a_dictionary_states_its_indices_as_a_file_does(mitsuba):
    scene = {
        "type": "scene",
        "integrator": {"type": "coherent"},
        "laser": {"type": "laser", "wavelength": 632.8, "to_world": mitsuba.ScalarTransform4f().look_at(
            origin=[0, 0, 50], target=[0, 0, 0], up=[0, 1, 0])},
        "target": {"type": "rough_target"},
        "ball": {"type": "sphere", "center": [0, 0, 20], "bsdf": {
            "type": "dielectric", "int_ior": 1.5, "ext_ior": "water"}},
        "detector": {"type": "detector", "pixel_pitch": 0.01, "to_world": mitsuba.ScalarTransform4f().look_at(
            origin=[0, 0, 60], target=[0, 0, 0], up=[0, 1, 0]), "film": {"type": "hdrfilm", "width": 8, "height": 8}},
    }  # fmt: skip
    assembly = assembly_from_scene(mitsuba.load_dict(scene))
    assert (assembly.elements[0].index, assembly.index) == (1.5 / WATER, WATER)


def test_a_changed_dielectric_counts_in_the_same_medium(load, mitsuba):
    scene = load(with_shapes(shape("sphere", dielectric(int_ior=1.5, ext_ior=1.33))))
    parameters_ = mitsuba.traverse(scene)
    parameters_["odd.bsdf.eta"] = 1.25
    parameters_.update()
    assembly = assembly_from_scene(scene)
    assert assembly.elements[0].index == pytest.approx(1.25, rel=SINGLE) and assembly.index == 1.33


@pytest.mark.parametrize("kind", ["sphere", "cube"])
def test_flipped_normals_turn_a_glass_inside_out(assemble, kind):
    """Mitsuba then takes the inside for the outside."""
    flipped = '<boolean name="flip_normals" value="true"/>'
    assembly = assemble(with_shapes(shape(kind, dielectric(int_ior=1.33, ext_ior=1.5), inside=flipped)))
    assert (assembly.elements[0].index, assembly.index) == (1.5 / 1.33, 1.33)


# The medium around everything

IN_WATER = shape("sphere", dielectric(int_ior=1.5, ext_ior=1.33), name="ball", z=15.0)


def test_a_lens_stands_in_the_water_of_the_scenes_dielectrics(assemble):
    assert element(assemble, "lens", IN_WATER, lens=PARTS["lens"]).index == 1.5 / 1.33
    assert element(assemble, "lens", lens=PARTS["lens"]).index == 1.5


@pytest.mark.parametrize("ext_ior", [{}, {"ext_ior": 1.0}, {"ext_ior": "air"}, {"ext_ior": 1.3331}])
def test_two_media_around_one_scene_are_refused_by_name(mitsuba, ext_ior):
    other = shape("cube", dielectric(int_ior=1.5, **ext_ior), name="plate", z=35.0)
    line = refusal(mitsuba, with_shapes(IN_WATER, other))
    is_clear(line, "'ball'", "'plate'", "1.33", "'ext_ior'", "must be the same")


def test_air_and_vacuum_are_one_medium(assemble):
    parts = [{"ext_ior": 1.0}, {}, {"ext_ior": "air"}]
    shapes = [shape("sphere", dielectric(int_ior=1.5, **e), f"ball{i}", 10.0 + 5 * i) for i, e in enumerate(parts)]
    assembly = assemble(with_shapes(*shapes))
    assert [one.index for one in assembly.elements] == [1.5, 1.5 / AIR, 1.5 / AIR] and assembly.index == 1.0


def test_media_differ_in_the_fingerprint(assemble):
    scenes = (with_shapes(shape("sphere", dielectric(int_ior=2 * n, ext_ior=n))) for n in (1.0, 1.33))
    assert len({assemble(text).fingerprint() for text in scenes}) == 2


# Fields in water

INSIDE, OUTSIDE = 1.5, 1.33


def plate(transmittance: float = 1.0) -> str:
    """A lens without curvature, 4 mm thick, under water."""
    glass = dielectric(int_ior=INSIDE, ext_ior=OUTSIDE, specular_transmittance=transmittance)
    frame = Frame(np.array([0.0, 0.0, 18.0]), WORLD.axes)
    return element_xml("lens", "plate", frame, glass, thickness=4.0, diameter=40.0, ior=INSIDE)


def through_plate(r: np.ndarray, z: float) -> np.ndarray:
    """Field (n,) at distances r (n,) from the axis at height z, of a source at 0 below a plate of 4 mm, all in water.

    Written with the indices themselves and the vacuum wavelength: n sin theta is kept, and the amplitude is
    sqrt(dOmega / dA) = sqrt(sin theta dtheta / (r dr cos theta)).
    """

    def landing(sine: float) -> float:
        slanted = OUTSIDE * sine / INSIDE
        return (z - 4.0) * sine / np.sqrt(1 - sine**2) + 4.0 * slanted / np.sqrt(1 - slanted**2)

    field = []
    for one in np.atleast_1d(r):
        sine = brentq(lambda s, one=one: landing(s) - one, 0.0, 0.9, xtol=1e-16, rtol=1e-15) if one > 0 else 0.0
        cosine, inner = np.sqrt(1 - sine**2), np.sqrt(1 - (OUTSIDE * sine / INSIDE) ** 2)
        path = OUTSIDE * (z - 4.0) / cosine + INSIDE * 4.0 / inner
        # dr/dtheta = cos theta dr/dsin theta, and r/sin theta, which has a limit on the axis
        spread = (z - 4.0) / cosine**2 + 4.0 * OUTSIDE / INSIDE * cosine / inner**3
        over_sine = (z - 4.0) / cosine + 4.0 * OUTSIDE / INSIDE / inner
        field.append(np.exp(2j * np.pi / VACUUM * path) / np.sqrt(spread * over_sine * cosine))
    return np.array(field)


def test_field_through_a_plate_under_water_has_the_waters_wavelength(tmp_path, assemble):
    text = bench(tmp_path, np.zeros(3), facing(60.0), [plate()], diffraction=False)
    assembly, frame, field = rendered_unit(assemble, text)
    x, y, _ = assembly.detector.points().T
    expected = through_plate(np.hypot(x, y), 60.0)
    assert np.linalg.norm(field - expected) < FIELD_TOLERANCE * np.linalg.norm(expected)
    assert frame.image.header["wavelength_nm"] == pytest.approx(632.8, abs=1e-9)  # the laser's own, in vacuum


def test_diffraction_under_water_has_the_waters_wavelength(tmp_path, assemble):
    stop = element_xml("aperture", "stop", Frame(np.array([0.0, 0.0, 30.0]), WORLD.axes), radius=0.08)
    text = bench(tmp_path, np.zeros(3), facing(60.0), [plate(), stop])
    assembly, _, field = rendered_unit(assemble, text)
    x, y, weight = disc_nodes(0.08, 24, 64)
    at_stop = through_plate(np.hypot(x, y), 30.0) * weight
    places = np.stack([x, y, np.full(x.size, 30.0)], axis=1)
    expected = diffracted(places, at_stop, np.array([0.0, 0, 1]), assembly.detector.points(), VACUUM / OUTSIDE)
    assert np.linalg.norm(field - expected) < FIELD_TOLERANCE * np.linalg.norm(expected)


def test_sources_of_a_frame_under_water_add_up_with_its_wavelength(assemble):
    """The distance counts in the medium: e^{ikr}/r with k of the medium is the field where nothing is in the way."""
    away = element_xml("sphere", "away", Frame(np.array([0.0, 500.0, 50.0]), WORLD.axes), dielectric(ext_ior=1.33))
    assembly = assemble(scene_with(lens="", aperture="", away=away))
    frame = simulate_frame(assembly)
    r = np.linalg.norm(assembly.detector.points()[:, None] - frame.scatterers.position, axis=2)
    expected = (np.exp(2j * np.pi * 1.33 / VACUUM * r) / r) @ frame.scatterers.amplitude
    tolerance = 3 * assembly.options.tolerance
    assert np.linalg.norm(frame.image.field.ravel() - expected) < tolerance * np.linalg.norm(expected)


# Strengths


def conductor(value: float | str) -> str:
    said = value if isinstance(value, str) else f'<float name="specular_reflectance" value="{value}"/>'
    return f'<bsdf type="conductor">{said}</bsdf>'


TEXTURE = '<texture type="checkerboard" name="{}"/>'


@pytest.mark.parametrize("kind", ["rectangle", "disk", "sphere"])
@pytest.mark.parametrize("wrap", ["{}", '<bsdf type="twosided">{}</bsdf>'])
def test_a_mirror_reflects_the_root_of_its_reflectance(assemble, kind, wrap):
    found = element(assemble, "odd", shape(kind, wrap.format(conductor(0.49))))
    assert found.interaction(0, AROUND).amplitude == pytest.approx(0.7, rel=1e-15)
    assert element(assemble, "odd", shape(kind, wrap.format(conductor("")))).amplitude == 1.0


@pytest.mark.parametrize("kind", ["sphere", "cube"])
def test_each_face_of_a_glass_passes_the_root_of_its_transmittance(assemble, kind):
    found = element(assemble, "odd", shape(kind, dielectric(int_ior=1.5, specular_transmittance=0.81)))
    for medium in (AROUND, 0):
        assert found.interaction(0, medium).amplitude == pytest.approx(0.9, rel=1e-15)


def test_a_lens_may_be_given_a_dielectric_of_its_index_with_a_transmittance(assemble):
    glass = dielectric(int_ior=1.5, specular_transmittance=0.25)
    found = element(assemble, "lens", lens=PARTS["lens"].replace("</shape>", f"{glass}</shape>"))
    assert (found.amplitude, found.index) == (0.5, 1.5)


def test_what_reflects_or_passes_nothing_is_opaque(assemble):
    assert element(assemble, "odd", shape("disk", conductor(0.0))).kind == "opaque"
    assert element(assemble, "odd", shape("cube", dielectric(specular_transmittance=0.0))).kind == "opaque"


@pytest.mark.parametrize("kind", ["rectangle", "sphere"])
def test_a_texture_as_strength_is_refused_by_name(mitsuba, kind):
    texture = conductor(TEXTURE.format("specular_reflectance"))
    line = refusal(mitsuba, with_shapes(shape(kind, texture)))
    is_clear(line, "'odd'", "'specular_reflectance'", "must be one number")


def test_a_texture_as_transmittance_is_refused_by_name(mitsuba):
    glass = f'<bsdf type="dielectric">{TEXTURE.format("specular_transmittance")}</bsdf>'
    is_clear(refusal(mitsuba, with_shapes(shape("cube", glass))), "'odd'", "'specular_transmittance'", "must be")


@pytest.mark.parametrize("value", [1.5, -0.5])
def test_a_strength_beyond_all_of_the_light_is_refused(mitsuba, value):
    is_clear(refusal(mitsuba, with_shapes(shape("disk", conductor(value)))), "reflectance", "must be")


def test_the_amplitude_of_a_way_is_the_product_of_its_interactions_unfolded_or_not(assemble):
    plane = Surface(Frame(np.array([0.0, 0.0, 40.0]), WORLD.axes))
    ways = (
        Interaction.refract(plane, 1.0, 1.5, amplitude=0.5),
        Interaction.refract(plane, 1.5, 1.0, amplitude=0.5),
        Interaction.reflect(plane, amplitude=0.9),
        Interaction.through(plane),
    )
    unfolded, _ = unfold(ways, assemble(scene_with()).detector)
    assert amplitude_of(ways) == Sequence(ways).amplitude == Sequence(unfolded).amplitude == 0.225


def test_fields_carry_the_roots_of_reflectance_and_transmittance(tmp_path, assemble):
    """A mirror of 0.49 behind a plate whose two faces pass 0.81 each leaves 0.7 x 0.81 of the amplitude."""
    turned = Frame(np.array([0.0, 0.0, 60.0]), rotation_matrix(np.radians([0.0, 20.0, 0.0])))
    # Looks up at the mirror, its back to the target.
    aside = frame_along(-direction(-140), turned.origin + 30.0 * direction(-140), np.array([1.0, 0, 0]))
    fields = []
    for transmittance, reflectance in ((1.0, 1.0), (0.81, 0.49)):
        fold = element_xml("disk", "fold", turned, conductor(reflectance), size=(20.0, 20.0, 1.0))
        text = bench(tmp_path, np.zeros(3), aside, [plate(transmittance), fold], pixels=(8, 8), diffraction=False)
        fields.append(rendered_unit(assemble, text)[2])
    assert np.linalg.norm(fields[0]) > 0
    assert np.linalg.norm(fields[1] - 0.567 * fields[0]) < FIELD_TOLERANCE * np.linalg.norm(fields[0])


# Contradictions


@pytest.mark.parametrize(
    "bsdf, words",
    [
        ('<bsdf type="conductor"/>', ["SmoothConductor", "shape 'mirror'"]),
        ('<bsdf type="diffuse"/>', ["SmoothDiffuse"]),
        ('<bsdf type="roughdielectric"/>', ["RoughDielectric"]),
        (dielectric(int_ior=1.7), ["1.7"]),
        (dielectric(), ["1.5046"]),
    ],
)
def test_a_lens_whose_bsdf_contradicts_it_is_refused(mitsuba, bsdf, words):
    line = refusal(mitsuba, scene_with(lens=PARTS["lens"].replace("</shape>", f"{bsdf}</shape>")))
    is_clear(line, "lens 'lens'", "must be a dielectric of 'int_ior' = 1.5", *words)


@pytest.mark.parametrize(
    "bsdf", ['<bsdf type="diffuse"/>', dielectric(), conductor(0.5), '<bsdf type="roughconductor"/>']
)
def test_a_mirror_whose_bsdf_contradicts_it_is_refused(mitsuba, bsdf):
    text = f'<shape type="mirror" id="mirror">{on_axis(35.0)}<float name="diameter" value="10"/>{bsdf}</shape>'
    is_clear(refusal(mitsuba, with_shapes(text)), "mirror 'mirror'", "must be a conductor", "= 1")


def test_a_mirror_may_be_given_a_conductor_of_its_reflectance(assemble):
    text = (
        f'<shape type="mirror" id="mirror">{on_axis(35.0)}<float name="diameter" value="10"/>'
        f'<float name="reflectance" value="0.81"/><bsdf type="twosided">{conductor(0.81)}</bsdf></shape>'
    )
    assert element(assemble, "mirror", text).amplitude == pytest.approx(0.9, rel=1e-15)
