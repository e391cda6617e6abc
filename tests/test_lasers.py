"""Several lasers, lines and wavelengths: light that does not interfere, one material, every field by its name."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest
from scene_builder import WORLD, detector_frame, detector_xml, direction, frame_along, integrator_xml, laser_xml, scene_of, target_xml

from speckle_mi import theory
from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.experiments.layout import layout_of
from speckle_mi.experiments.one_frame import OneFrame
from speckle_mi.field.simulation import Simulation, simulate_frame
from speckle_mi.field.sources import source_layers, write_sources
from speckle_mi.geometry.pose import Pose
from speckle_mi.images.exr import read_field, write_field
from speckle_mi.machine.fingerprint import fingerprint
from speckle_mi.measurement.correlator import Correlator
from speckle_mi.measurement.speckle_statistics import contrast
from speckle_mi.scattering.spectrum import line_samples, longest_path
from speckle_mi.scene.write import write_points

STANDARD_ERRORS = 4
SINGLE = 2e-7  # [1]: intensities are single precision.


def laser(id="laser", to_laser=direction(35, 180), **values):
    place = frame_along(-to_laser, 50.0 * np.asarray(to_laser))
    return laser_xml(place, **{"wavelength": 632.8, "beam_radius": 0.2, "wavefront_radius": None} | values | {"id": id})


def scene(*lasers, target=None, detector=None, sight=direction(0), distance=60.0, integrator=None):
    return scene_of(
        integrator_xml(**(integrator or {})), *lasers, target_xml(WORLD, **{"point_sources": 100} | (target or {})),
        detector_xml(detector_frame(sight, distance), **{"width": 48, "height": 40, "pixel_pitch": 0.02} | (detector or {})),
    )  # fmt: skip


TWO = (laser("left"), laser("right", direction(20, 60), wavelength=780.0))


def test_intensities_of_two_lasers_add_up_and_each_field_is_that_of_its_laser_alone(assemble):
    both = simulate_frame(assemble(scene(*TWO)))
    assert list(both.image.layers) == ["left.E", "right.E"]
    for name, xml in zip(("left", "right"), TWO, strict=True):
        alone = assemble(scene(xml))
        # Alone it would ask for a density of its own; the material of both is that of the denser one.
        dense = max(assemble(scene(one)).target.surface.density for one in TWO)
        surface = alone.target.surface.__class__(**{**vars(alone.target.surface), "density": dense})
        target = alone.target.__class__(**{**vars(alone.target), "surface": surface})
        frame = simulate_frame(alone.__class__(**{**fields(alone), "target": target}))
        np.testing.assert_array_equal(both.image.layers[f"{name}.E"], frame.image.field)
    sum_of_both = sum(np.abs(values) ** 2 for values in both.image.layers.values())
    np.testing.assert_allclose(both.image.intensity, sum_of_both, rtol=4 * SINGLE)
    np.testing.assert_array_equal(both.image.field, both.image.layers["left.E"])
    assert both.plan[0] == "intensities add up: left, right, 2 wavelengths or lasers in all"


def fields(assembly):
    return {name: getattr(assembly, name) for name in assembly.__dataclass_fields__}


def test_all_lasers_light_the_same_material(assemble):
    frame = simulate_frame(assemble(scene(*TWO, target={"roughness": 0.0})))
    first, second = (part.scatterers.position for part in frame.parts)
    shared = {tuple(place) for place in np.round(first, 9)} & {tuple(place) for place in np.round(second, 9)}
    # The spots overlap but for their tilts, and out to three radii.
    assert len(shared) > 0.7 * min(len(first), len(second))


def test_the_files_channels_are_named_after_the_lasers(assemble, tmp_path):
    image = simulate_frame(assemble(scene(*TWO))).image
    write_field(tmp_path / "f.exr", image)
    with OpenEXR.File(str(tmp_path / "f.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    assert set(channels) == {"Y", "E.re", "E.im", "left.E.re", "left.E.im", "right.E.re", "right.E.im"}
    np.testing.assert_array_equal(channels["right.E.re"], image.layers["right.E"].real.astype(np.float32))
    header = read_field(tmp_path / "f.exr").header
    assert [(light["name"], light["wavelength_nm"]) for light in header["lights"]] == [("left", 632.8), ("right", 780.0)]


def test_one_laser_has_the_channels_it_always_had(assemble, tmp_path):
    frame = simulate_frame(assemble(scene(laser())))
    write_field(tmp_path / "f.exr", frame.image)
    with OpenEXR.File(str(tmp_path / "f.exr"), separate_channels=True) as file:
        assert set(file.channels()) == {"Y", "E.re", "E.im"}
    assert "lights" not in frame.image.header


def test_a_render_by_mitsuba_has_every_lasers_field(mitsuba, assemble):
    text = scene(*TWO)
    image = np.array(mitsuba.render(mitsuba.load_string(text)))
    frame = simulate_frame(assemble(text)).image
    assert image.shape[2] == 3 + 4  # Y, E, and two layers
    np.testing.assert_allclose(image[..., 0], frame.intensity, rtol=SINGLE)
    np.testing.assert_allclose(image[..., 5], frame.layers["right.E"].real, rtol=0, atol=SINGLE * np.abs(frame.field).max())


def test_contrast_of_two_equal_incoherent_lasers_is_one_over_root_two(assemble):
    # From two sides, so that their patterns have nothing in common.
    assembly = assemble(
        scene(laser("left"), laser("right", direction(35, 0)), target={"point_sources": 200},
              detector={"width": 96, "height": 96, "pixel_pitch": 0.03})
    )  # fmt: skip
    found, each = [], []
    for seed in range(16):
        frame = simulate_frame(assembly, seed=seed)
        found.append(contrast(frame.image.intensity))
        each.append([np.mean(np.abs(values) ** 2) for values in frame.image.layers.values()])
    expected = theory.contrast_of_incoherent_patterns(np.mean(each, axis=0))
    assert expected == pytest.approx(np.sqrt(0.5), abs=0.01)
    error = np.std(found, ddof=1) / 4
    assert error < 0.02
    assert np.mean(found) == pytest.approx(np.sqrt(0.5), abs=STANDARD_ERRORS * error)


def test_lines_share_the_power_by_their_weights(assemble):
    text = scene(laser(wavelength=None, wavelengths="632.8, 780", weights="3 1"))
    frame = simulate_frame(assemble(text))
    assert list(frame.image.layers) == ["laser.E", "laser.line2.E"]
    for name, wavelength, share in (("laser.E", 632.8, 0.75), ("laser.line2.E", 780.0, 0.25)):
        alone = simulate_frame(assemble(scene(laser(wavelength=wavelength)))).image.field
        np.testing.assert_allclose(frame.image.layers[name], np.sqrt(share) * alone, rtol=1e-9)


def test_wavelength_may_name_several_lines_itself(assemble):
    one, other = (assemble(scene(laser(**names))) for names in (
        {"wavelength": "632.8, 780", "weights": "3 1"},
        {"wavelength": None, "wavelengths": "632.8, 780", "weights": "3 1"},
    ))  # fmt: skip
    assert one == other and len(one.parts) == 2


def test_every_laser_has_its_own_fields_of_single_scatterers(assemble):
    frame = simulate_frame(assemble(scene(*TWO)))
    layers = source_layers(frame.parts, None, 2)
    assert list(layers) == ["left.source000", "left.source001", "right.source000", "right.source001"]
    for part in frame.parts:
        position, amplitude = part.scatterers.position[1], part.scatterers.amplitude[1]
        r = np.linalg.norm(part.assembly.detector.points() - position, axis=1)
        expected = amplitude * np.exp(1j * part.assembly.beam.wavenumber * r) / r
        found = layers[f"{part.assembly.light}.source001"].ravel()
        assert np.linalg.norm(found - expected) < 1e-4 * np.linalg.norm(expected)
    alone = simulate_frame(assemble(scene(TWO[0])))
    assert list(source_layers(alone.parts, None, 1)) == ["source000"]


def test_pattern_of_another_wavelength_is_shifted_as_first_order_theory_says(assemble):
    """A smooth enough surface: heights of some nm only dephase, and the pattern goes on being itself."""
    to_laser, sight = direction(30, 180), direction(10, 60)
    text = scene(
        laser(to_laser=to_laser, wavelength=None, wavelengths="632.8, 633.1"), sight=sight,
        target={"roughness": 0.3, "point_sources": 100}, detector={"width": 192, "height": 192, "pixel_pitch": 0.012},
    )
    assembly, shifts = assemble(text), []
    grid = assembly.detector
    per_wavelength = theory.wavelength_displacement(
        assembly.spot.point, assembly.spot.normal, to_laser, grid.centre, grid.u, grid.v
    )
    expected = per_wavelength * (633.1 - 632.8) / 632.95
    for seed in range(12):
        layers = simulate_frame(assembly, seed=seed).image.layers
        first, second = (np.abs(layers[name]) ** 2 for name in ("laser.E", "laser.line2.E"))
        shift = Correlator(first).shift(second)
        shifts.append(np.array([shift.u_px, shift.v_px]) * grid.pitch)
    error = np.std(shifts, axis=0, ddof=1) / np.sqrt(len(shifts))
    assert error.max() < 0.02 * np.linalg.norm(expected)
    difference = np.abs(np.mean(shifts, axis=0) - expected)
    assert np.all(difference <= np.maximum(STANDARD_ERRORS * error, 0.01 * np.linalg.norm(expected))), (shifts, expected)


# The width of a line


@pytest.mark.parametrize("linewidth", [0.2, 1.0])
@pytest.mark.parametrize("difference", [0.05, 0.2, 0.5])
def test_fringes_of_two_points_fade_with_their_path_difference_as_the_gaussian_says(assemble, tmp_path, difference, linewidth):
    # Two scatterers behind one another: the light goes there and back, twice their distance.
    path = write_points(tmp_path / "points.csv", np.array([[0.0, 0, -difference / 4], [0.0, 0, difference / 4]]))
    light = dict(wavelength=785.0, beam_radius=None, linewidth=linewidth)
    text = scene(
        laser(to_laser=direction(0), **light), target={"points": str(path)},
        detector={"width": 400, "height": 1, "pixel_pitch": 0.05}, distance=60.0,
    )
    assembly = assemble(text)
    frame = simulate_frame(assembly)
    # Each point alone, in the middle of the line, shows what interferes.
    middle, single = frame.image.field[0], []
    simulation = Simulation(assembly)
    for number in (0, 1):
        single.append(simulation.field_of(frame.scatterers.selected(np.array([number])))[0])
    envelope, modulation = sum(np.abs(one) ** 2 for one in single), 2 * (single[0] * single[1].conj()).real
    np.testing.assert_allclose(np.abs(middle) ** 2, envelope + modulation, rtol=0, atol=1e-6 * envelope.max())
    fitted = np.sum((frame.image.intensity[0] - envelope) * modulation) / np.sum(modulation**2)
    expected = theory.coherence_gaussian_line(difference, 785e-6, linewidth * 1e-6)
    # Over the detector the difference itself changes by a hundredth.
    assert fitted == pytest.approx(expected, abs=0.01 * expected + 1e-3)
    assert not any("spectral_samples" in warning for warning in frame.warnings)


def test_contrast_of_a_rough_surface_in_light_of_a_line_follows_its_closed_form(assemble):
    """Paths differ by twice the heights: |gamma|^2 averages to 1/sqrt(1 + (4 s_k s_h)^2), s_k of k and s_h of heights."""
    wavelength, linewidth, roughness = 785.0, 2.0, 0.04
    deviation = 2 * np.pi * linewidth / wavelength**2 / np.sqrt(8 * np.log(2)) * 1e6  # of k [1/mm]
    expected = (1 + (4 * deviation * roughness) ** 2) ** -0.25
    assembly = assemble(
        scene(laser(to_laser=direction(0), wavelength=wavelength, linewidth=linewidth, spectral_samples=31), distance=300.0,
              target={"roughness": 1e3 * roughness, "point_sources": 300},
              detector={"width": 40, "height": 40, "pixel_pitch": 0.5})
    )  # fmt: skip
    found = []
    for seed in range(24):
        frame = simulate_frame(assembly, seed=seed)
        assert not any("spectral_samples" in warning for warning in frame.warnings)
        found.append(contrast(frame.image.intensity))
    error = np.std(found, ddof=1) / np.sqrt(len(found))
    assert expected < 0.9 and error < 0.02
    assert np.mean(found) == pytest.approx(expected, abs=STANDARD_ERRORS * error)


def test_field_of_a_line_is_that_of_its_middle(assemble):
    wide = simulate_frame(assemble(scene(laser(linewidth=0.5, spectral_samples=5))))
    np.testing.assert_array_equal(wide.image.field, simulate_frame(assemble(scene(laser()))).image.field)
    assert not wide.image.layers


def test_samples_have_the_lines_power_and_width():
    for count in (15, 31, 101):
        wavelengths, shares = line_samples(785.0, 2.0, count)
        assert wavelengths[0] == 785.0 and len(wavelengths) == count
        assert shares.sum() == pytest.approx(1, abs=1e-12)
        spread = np.sqrt(np.sum(shares * (1 / wavelengths - 1 / 785.0) ** 2))
        assert spread * 785.0**2 * np.sqrt(8 * np.log(2)) == pytest.approx(2.0, rel=1e-3)
        # Two waves whose paths differ by what the samples stand for, in steps: the closed form.
        for difference in np.linspace(0, longest_path(785.0, 2.0, count), 9):
            waves = np.sum(shares * np.exp(2j * np.pi * difference * (1 / wavelengths - 1 / 785.0)))
            assert abs(waves) == pytest.approx(theory.coherence_gaussian_line(difference, 785.0, 2.0), abs=4e-3)


def test_paths_that_differ_by_more_than_the_samples_stand_for_are_said(assemble, tmp_path):
    path = write_points(tmp_path / "points.csv", np.array([[0.0, 0, -1.0], [0.0, 0, 1.0]]))
    text = scene(laser(to_laser=direction(0), beam_radius=None, linewidth=1.0), target={"points": str(path)})
    warnings = simulate_frame(assemble(text)).warnings
    assert any("spectral_samples" in warning and "mm" in warning for warning in warnings)


# Theory, and what is refused


def test_theory_of_several_lines_is_what_they_have_in_common(assemble):
    one = expected_sensitivity(assemble(scene(laser())))
    lines = expected_sensitivity(assemble(scene(laser(wavelength=None, wavelengths="632.8 780"))))
    np.testing.assert_allclose(lines["u"], one["u"], rtol=1e-3, atol=1e-4)
    differing = expected_sensitivity(assemble(scene(laser("left"), laser("right", direction(60, 0)))))
    assert differing["u"] is None


def test_derivatives_of_incoherent_light_are_those_of_its_whole_intensity(assemble):
    """Against the intensities of frames on either side, for every motion."""
    assembly = assemble(scene(laser("left", linewidth=0.5, spectral_samples=3), TWO[1], integrator={"tolerance": 1e-7}))
    pixels = np.arange(0, 48 * 40, 37)
    found = Simulation(assembly).derivatives(pixels)
    rates = 2 * np.sum((found.field.conj()[:, None] * found.by_motion).real, axis=0)
    for dof, step, unit in (("x", 1e-4, 1.0), ("z", 1e-4, 1.0), ("ry", 2e-4, np.pi / 180)):
        rate = rates[["x", "y", "z", "rx", "ry", "rz"].index(dof)] * unit
        ends = [simulate_frame(assembly, Pose(**{dof: s * step})).image.intensity.ravel()[pixels] for s in (1, -1)]
        difference = (ends[0].astype(np.float64) - ends[1]) / (2 * step)
        # Second differences of single-precision intensities over steps of some hundredths of a speckle.
        np.testing.assert_allclose(difference, rate, rtol=0, atol=0.02 * np.abs(rate).max(), err_msg=dof)


def test_one_frame_measures_what_a_sweep_of_two_lasers_sees(assemble):
    detector = {"width": 160, "height": 160, "pixel_pitch": 0.016}
    two = laser(wavelength=None, wavelengths="632.8, 780"), laser("other", direction(35, 180), wavelength=700.0)
    assembly = assemble(scene(*two, detector=detector, target={"point_sources": 60}))
    found, expected = [], expected_sensitivity(assembly)
    for seed in range(6):
        one = OneFrame(Simulation(assembly))
        one.measure([seed])
        found.append(one.result.linear[0].value[:, 0])
    mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(6)
    theirs = expected["u"] * np.array([1, 1, 1, *[180 / np.pi] * 3])
    assert np.all(np.abs(mean - theirs) <= np.maximum(STANDARD_ERRORS * error, 0.01 * np.abs(theirs))), (mean, theirs)


def test_moved_targets_are_lit_by_every_laser_where_they_are(assemble):
    assembly = assemble(scene(*TWO))
    moved = simulate_frame(assembly, Pose(x=0.05, z=0.1))
    for part, alone in zip(moved.parts, assembly.parts, strict=True):
        np.testing.assert_array_equal(simulate_frame(alone, Pose(x=0.05, z=0.1)).image.field, part.field)


def test_lasers_of_known_powers_are_in_proportion_to_what_falls_on_the_surface(assemble):
    """Mean intensities as 2 mW and 1 mW on one surface, whatever the spots; the first laser's as it is alone."""
    lasers = (laser("left", direction(0), power=2.0), laser("right", direction(50, 60), power=1.0, beam_radius=0.4))
    both, found = assemble(scene(*lasers, target={"point_sources": 300})), []
    for seed in range(6):
        layers = simulate_frame(both, seed=seed).image.layers
        found.append([np.mean(np.abs(values) ** 2) for values in layers.values()])
    ratio = np.mean(found, axis=0)[0] / np.mean(found, axis=0)[1]
    assert ratio == pytest.approx(2.0, rel=0.25)  # a few hundred speckles in all
    powers = [np.sum(np.abs(part.scatterers.amplitude) ** 2) for part in simulate_frame(both).parts]
    assert powers[0] / powers[1] == pytest.approx(2.0, rel=0.01)


def test_a_camera_counts_the_photons_of_every_laser(assemble):
    camera = {"exposure": 1e-4}
    detector = {"width": 32, "height": 32, "pixel_pitch": 0.02, "camera": camera}
    lasers = (laser("left", wavelength=400.0, power=2.0), laser("right", direction(35, 90), wavelength=800.0, power=2.0))
    both = simulate_frame(assemble(scene(*lasers, target={"point_sources": 300}, detector=detector)))
    mean = {name: np.mean(np.abs(values) ** 2) for name, values in both.image.layers.items()}
    alone = simulate_frame(assemble(scene(lasers[0], target={"point_sources": 300}, detector=detector)))
    per_intensity = alone.image.header["camera"]["electrons"] / np.mean(alone.image.intensity)
    # Light of twice the wavelength has twice as many photons.
    expected = per_intensity * (mean["left.E"] + 2 * mean["right.E"])
    assert both.image.header["camera"]["electrons"] == pytest.approx(expected, rel=1e-4)


def test_powers_of_some_lasers_only_are_refused(assemble):
    with pytest.raises((ValueError, RuntimeError), match="'right'.*power.*all or of none"):
        assemble(scene(laser("left", power=1.0), laser("right", direction(35, 0))))


BAD = {
    "two wavelengths": (dict(wavelengths="632.8, 780"), ["wavelength", "wavelengths", "one of them"]),
    "no number": (dict(wavelength=None, wavelengths="red, 780"), ["wavelengths", "red", "numbers"]),
    "nothing": (dict(wavelength=None, wavelengths=""), ["wavelengths", "0 numbers"]),
    "negative": (dict(wavelength=None, wavelengths="632.8, -780"), ["wavelengths", "-780", "at least"]),
    "weights": (dict(wavelength=None, wavelengths="632.8, 780", weights="1"), ["weights", "one for each", "2"]),
    "weight": (dict(wavelength=None, wavelengths="632.8, 780", weights="1, 0"), ["weights", "at least"]),
    "too wide": (dict(linewidth=100.0), ["linewidth", "100", "at most"]),
    "negative width": (dict(linewidth=-1.0), ["linewidth", "at least"]),
    "even": (dict(linewidth=1.0, spectral_samples=4), ["spectral_samples", "4", "odd"]),
    "few": (dict(linewidth=1.0, spectral_samples=1), ["spectral_samples", "at least 3"]),
}


@pytest.mark.parametrize("name", BAD)
def test_light_that_cannot_be_meant_is_refused_in_one_line(assemble, name):
    values, words = BAD[name]
    with pytest.raises((ValueError, RuntimeError)) as refused:
        assemble(scene(laser(**values)))
    assert all(word in str(refused.value) for word in words), refused.value


def test_a_scene_without_a_laser_says_so(assemble):
    with pytest.raises((ValueError, RuntimeError), match="no <emitter type='laser'>"):
        assemble(scene())


def test_every_line_sees_its_own_index_of_a_glass(assemble):
    two = laser(wavelength=None, wavelengths="488, 1064")
    for medium, differs in (('<string name="glass" value="N-BK7"/>', True), ('<float name="ior" value="1.5"/>', False)):
        lens = f"""<shape type="lens" id="lens"><transform name="to_world"><translate z="30"/></transform>
            <float name="radius1" value="40"/><float name="radius2" value="-40"/><float name="thickness" value="4"/>
            <float name="diameter" value="20"/>{medium}</shape>"""
        first, second = assemble(scene(two, lens)).parts
        assert (fingerprint(first.elements) != fingerprint(second.elements)) == differs


SECOND_ORDER = 5e-4  # [mm]: patterns of 150 mm distance are magnified, and roughness dephases them, by parts in 10^3.


def test_dual_wavelength_sensor_tells_tilt_from_the_distance_of_its_two_patterns(shipped):
    """2 D dl/l a rad of ry along u, 2 D dl/l cos(a) of rx along v, and nothing when the surface is level."""
    assembly = shipped("dual_wavelength", width=256, height=256, pixel_pitch=0.012)
    grid, relative = assembly.detector, 5 / 787.5
    across = theory.wavelength_displacement(
        assembly.spot.point, assembly.spot.normal, -assembly.beam.axis, grid.centre, grid.u, grid.v
    )
    np.testing.assert_allclose(across, 0, atol=1e-9)
    for pose, expected in (
        (Pose(), (0.0, 0.0)), (Pose(ry=0.5), (2 * 150 * relative * np.radians(0.5), 0.0)),
        (Pose(rx=0.5), (0.0, 2 * 150 * relative * np.radians(0.5) * np.cos(np.radians(25)))),
    ):  # fmt: skip
        found = []
        for seed in range(6):
            layers = simulate_frame(assembly, pose, seed=seed).image.layers
            first, second = (np.abs(layers[name]) ** 2 for name in ("laser.E", "laser.line2.E"))
            shift = Correlator(first).shift(second)
            found.append(np.array([shift.u_px, shift.v_px]) * grid.pitch)
        error = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
        assert error.max() < 1.5e-3  # [mm], a twelfth of the shift
        difference = np.abs(np.abs(np.mean(found, axis=0)) - expected)
        assert np.all(difference <= STANDARD_ERRORS * error + SECOND_ORDER), (pose, found)


def test_sources_of_every_laser_make_its_field(assemble, tmp_path):
    assembly = assemble(scene(*TWO, detector={"width": 6, "height": 5, "pixel_pitch": 0.1}))
    frame, path = simulate_frame(assembly), tmp_path / "f.npz"
    write_sources(path, assembly, frame.scatterers, parts=frame.parts)
    with np.load(path) as written:
        for layer, suffix in (("left.E", ""), ("right.E", ".right")):
            position, amplitude, wavelength = (written[name + suffix] for name in ("position", "amplitude", "wavelength"))
            row, column = 3, 4
            pixel = written["pixel_origin"] + column * written["pitch"] * written["u"] + row * written["pitch"] * written["v"]
            r = np.linalg.norm(pixel - position, axis=1)
            exact = np.sum(amplitude * np.exp(2j * np.pi * r / wavelength) / r)
            field = frame.image.layers[layer]
            # The tolerance of the sum, and paths of 10^5 wavelengths in double precision.
            assert abs(field[row, column] - exact) < 1e-3 * np.abs(field).max()


def test_a_drawing_shows_every_laser_by_its_name(assemble):
    layout = layout_of({"detector": assemble(scene(*TWO))})
    assert len(layout.beams) == 2
    assert [part.name for part in layout.parts if part.kind == "laser"] == ["left", "right"]
    words = dict(layout.facts)
    assert words["left"].startswith("632.8 nm") and words["right"].startswith("780 nm")
