"""Pictures as a described camera takes them: photon transfer, saturation, quantisation, noise, and shifts from them.

``pytest tests/test_camera.py`` judges the stated uncertainty on a sample; ``python tests/test_camera.py`` judges 200
noisy pairs for each of 10 to 10,000 electrons and speckles of 2 to 8 px and prints the table.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

from scene_builder import direction, free_space  # noqa: E402

from speckle_mi.errors import InputError  # noqa: E402
from speckle_mi.field.simulation import Simulation  # noqa: E402
from speckle_mi.geometry.pose import Pose  # noqa: E402
from speckle_mi.images.camera import Camera, expose  # noqa: E402
from speckle_mi.images.exr import read_field, write_field  # noqa: E402
from speckle_mi.images.field_image import FieldImage  # noqa: E402
from speckle_mi.images.saved import write_picture  # noqa: E402
from speckle_mi.measurement.correlator import Correlator  # noqa: E402
from speckle_mi.scene.errors import SceneError  # noqa: E402
from speckle_mi.validation.shifts.speckle import shifted_pair  # noqa: E402

TRANSFERRED = 0.01
"""Relative error of gain and read noise from a photon transfer curve that is promised."""

FLAT = np.ones((400, 400))
"""Even light."""

STATED = 0.2
"""Relative difference of the stated uncertainty from the spread that is promised."""

ELECTRONS, SIZES = (10.0, 100.0, 1000.0, 10000.0), (2.0, 3.0, 4.0, 6.0, 8.0)
"""Mean of a pixel [e-] and full width at half maximum of a speckle [px] of the whole table."""

SAMPLE, SAMPLED_PAIRS, PAIRS = ((10.0, 2.0), (10.0, 8.0), (100.0, 4.0), (10000.0, 3.0)), 80, 200
"""What the tests judge of it, and pairs of a cell in the tests and in the command."""

SIDE, WINDOW = 132, 64
"""Side of the pictures and of the window that is followed [px]."""


# Photon transfer


def test_the_photon_transfer_curve_of_even_light_gives_gain_and_read_noise():
    camera = Camera.of("c", mean_electrons=1.0, full_well=20000.0, bit_depth=12, read_noise=11.0, black_level=40.0,
                       prnu=0.01)  # fmt: skip
    assert camera.gain == pytest.approx(20000 / 4095)
    means, variances = [], []
    for number, electrons in enumerate([1e-9, *np.linspace(500, 15000, 12)]):
        level = replace(camera, mean_electrons=float(electrons))
        one, two = (expose(level, FLAT, (number, shot)).dn.astype(float) for shot in (0, 1))
        means.append(0.5 * (one + two).mean() - camera.black_level)
        variances.append(0.5 * np.var(one - two))  # of a difference, which the pixels' own responses fall out of
    slope = np.polyfit(means, variances, 1, w=1 / np.array(variances))[0]
    assert 1 / slope == pytest.approx(camera.gain, rel=TRANSFERRED)
    quantisation = 1 / 12
    read_noise = camera.gain * math.sqrt(variances[0] - quantisation)
    assert read_noise == pytest.approx(camera.read_noise, rel=TRANSFERRED)


def test_the_photon_transfer_curve_of_rendered_speckle_gives_gain_and_read_noise(assemble):
    values = {"mean_electrons": 400, "full_well": 6000, "bit_depth": 12, "read_noise": 20, "black_level": 200}
    assembly = assemble(free_space(detector={"camera": values, "pixel_pitch": 0.012}))
    intensity, shots = Simulation(assembly).frame().image.intensity, 600
    total, squares = np.zeros(intensity.shape), np.zeros(intensity.shape)
    for shot in range(shots):
        dn = expose(assembly.camera, intensity, (shot,)).dn.astype(float)
        total += dn
        squares += dn**2
    mean, variance = total / shots, (squares - total**2 / shots) / (shots - 1)
    mean -= values["black_level"]
    not_full = mean < 0.8 * 4095
    weight = 1 / (mean[not_full].clip(0) / assembly.camera.gain + (20 / assembly.camera.gain) ** 2)
    slope, offset = np.polyfit(mean[not_full], variance[not_full], 1, w=weight)
    assert 1 / slope == pytest.approx(assembly.camera.gain, rel=TRANSFERRED)
    assert assembly.camera.gain * math.sqrt(offset - 1 / 12) == pytest.approx(values["read_noise"], rel=TRANSFERRED)


# Saturation and quantisation


def test_numbers_are_electrons_by_the_gain_rounded_and_never_beyond_the_largest():
    light = np.random.default_rng(1).exponential(size=(200, 300))
    counting = Camera.of("c", mean_electrons=900.0, full_well=3000.0)
    electrons = expose(counting, light, (5,)).dn
    assert electrons.max() == 3000 and np.array_equal(electrons, np.rint(electrons))
    for bits in (1, 4, 8, 12, 16):
        camera = Camera.of("c", mean_electrons=900.0, full_well=3000.0, bit_depth=bits)
        assert camera.gain == 3000 / (2**bits - 1)
        picture = expose(camera, light, (5,))
        assert np.array_equal(picture.dn, np.rint(electrons.astype(float) / camera.gain))
        assert picture.dn.max() == 2**bits - 1
        assert picture.saturated == pytest.approx(np.mean((electrons >= 3000) | (picture.dn == 2**bits - 1)))


def test_a_full_well_holds_no_more_however_bright_the_light():
    camera = Camera.of("c", mean_electrons=1e8, full_well=5000.0, bit_depth=10)
    picture = expose(camera, FLAT, ())
    assert np.all(picture.dn == 1023) and picture.saturated == 1.0


def test_a_converter_of_a_stated_gain_is_full_before_the_well():
    camera = Camera.of("c", mean_electrons=4000.0, full_well=20000.0, bit_depth=8, gain=10.0)
    assert np.all(expose(camera, FLAT, ()).dn == 255)


def test_what_is_not_given_makes_a_well_exposed_camera():
    light = np.random.default_rng(2).exponential(size=(300, 300))
    faint = {"mean_electrons": 10.0, "bit_depth": 8}
    for given in ({"bit_depth": 8}, {"full_well": 9000.0}, {"read_noise": 2.0}, faint):
        picture = expose(Camera.of("c", **given), light, ())
        assert picture.saturated < 0.001 and picture.dn.max() > 4 * picture.dn.mean() > 0, given


# Noise


def test_a_frame_is_the_same_picture_again_and_another_frame_has_noise_of_its_own():
    camera = Camera.of("left", mean_electrons=200.0, read_noise=3.0)
    light, place = np.random.default_rng(3).exponential(size=(256, 256)), (0, [0.0] * 6, 0)
    first = expose(camera, light, place).dn
    assert np.array_equal(first, expose(camera, light, place).dn)
    others = {
        "surface": (camera, (1, [0.0] * 6, 0)), "pose": (camera, (0, [1e-9, 0, 0, 0, 0, 0], 0)),
        "shot": (camera, (0, [0.0] * 6, 1)), "seed": (replace(camera, noise_seed=1), place),
        "detector": (replace(camera, id="right"), place),
    }  # fmt: skip
    expected = 200.0 * light / light.mean()
    noise = (first - expected) / np.sqrt(expected + 9)
    for what, (other, where) in others.items():
        found = (expose(other, light, where).dn - expected) / np.sqrt(expected + 9)
        assert abs(np.mean(noise * found)) < 4 / math.sqrt(light.size), what


def test_rows_have_noise_of_their_own_in_pictures_of_many_pixels():
    camera = Camera.of("c", mean_electrons=50.0)
    large = expose(camera, np.ones((1200, 700)), ()).dn
    noise = (large - 50) / math.sqrt(50)
    assert noise.mean() == pytest.approx(0, abs=4 / math.sqrt(large.size))
    assert np.var(noise) == pytest.approx(1, abs=0.01)
    assert not np.array_equal(large[:374], large[374:748])


def test_the_response_of_the_pixels_is_fixed_for_a_camera():
    camera = Camera.of("c", mean_electrons=1e6, prnu=0.02)
    one, two = (expose(camera, FLAT, (shot,)).dn / 1e6 - 1 for shot in (0, 1))
    assert np.std(one) == pytest.approx(0.02, rel=0.01)
    assert np.corrcoef(one.ravel(), two.ravel())[0, 1] > 0.99
    other = expose(replace(camera, noise_seed=1), FLAT, (0,)).dn / 1e6 - 1
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4 / math.sqrt(FLAT.size)


def test_dark_electrons_come_without_light():
    camera = Camera.of("c", mean_electrons=100.0, dark_electrons=30.0)
    dark = expose(camera, np.zeros((300, 300)), ()).dn
    assert dark.mean() == pytest.approx(30, rel=0.01) and np.var(dark) == pytest.approx(30, rel=0.03)
    assert expose(camera, FLAT, ()).dn.mean() == pytest.approx(130, rel=0.01)


# Scenes and files


def test_a_detector_without_a_camera_has_no_numbers(assemble):
    assembly = assemble(free_space())
    assert assembly.camera is None
    image = Simulation(assembly).frame().image
    assert image.dn is None and image.measured is image.intensity


@pytest.mark.parametrize(
    "given", [{"mean_electrons": 50}, {"read_noise": 2}, {"full_well": 800}, {"bit_depth": 8}, {"fill_factor": 0.5},
              {"prnu": 0.01}, {"dark_electrons": 3}, {"noise_seed": 4}]
)  # fmt: skip
def test_any_parameter_of_a_camera_gives_numbers(assemble, given):
    assembly = assemble(free_space(detector={"camera": given, "width": 24, "height": 16}))
    image = Simulation(assembly).frame(Pose(x=0.001)).image
    assert image.dn.shape == (16, 24) and image.dn.max() > image.dn.min()
    assert image.header["camera"]["electrons"] == pytest.approx(assembly.camera.mean_electrons, rel=0.05)


def test_light_and_field_are_the_same_with_a_camera_as_without(assemble):
    bare, seen = (
        Simulation(assemble(free_space(detector={"camera": values}))).frame().image
        for values in ({}, {"mean_electrons": 50, "bit_depth": 8})
    )
    assert np.array_equal(bare.intensity, seen.intensity) and np.array_equal(bare.field, seen.field)


def test_intensity_is_averaged_over_the_sensitive_part_of_a_pixel(assemble):
    sight, pitch = direction(0), 0.03  # a few pixels a speckle, so that the sensitive part matters
    assembly = assemble(free_space(sight=sight, detector={"camera": {"fill_factor": 0.36}, "pixel_pitch": pitch}))
    assert assembly.sub_pixels == 3
    found, grid = Simulation(assembly).frame().image.intensity, assembly.detector
    total = np.zeros(found.shape)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            # Middles of the thirds of a square that is 0.6 pixels wide.
            origin = grid.origin + 0.6 / 3 * pitch * (du * grid.u + dv * grid.v)
            moved = replace(assembly, detector=replace(grid, origin=origin), sub_pixels=1)
            total += Simulation(moved).frame().image.intensity
    tolerance = 3e-4  # of sums to 1e-4 of the field each
    assert np.linalg.norm(found - total / 9) < tolerance * np.linalg.norm(found)


WRONG = {
    "no electrons": ({"mean_electrons": 0.0}, "'mean_electrons' is 0 e-, must be above 0 e-"),
    "negative noise": ({"read_noise": -1.0}, "'read_noise' is -1 e-"),
    "many bits": ({"bit_depth": 24}, "'bit_depth' is 24, must be at least 1 and at most 16"),
    "half a bit": ({"bit_depth": 7.5}, "must be a whole number"),
    "all of it": ({"fill_factor": 1.5}, "'fill_factor' is 1.5, must be above 0 and at most 1"),
    "black is white": ({"bit_depth": 4, "black_level": 15.0}, "must be below the largest number of 4 bits, 15"),
}


@pytest.mark.parametrize("fault", WRONG)
def test_what_is_no_camera_is_refused_with_what_would_be(assemble, fault):
    values, words = WRONG[fault]
    with pytest.raises((SceneError, RuntimeError), match=words.replace("(", r"\(")):
        assemble(free_space(detector={"camera": values}))


def test_both_ways_of_saying_how_bright_it_is_are_refused():
    with pytest.raises(InputError, match="must be one of them"):
        Camera.of("c", mean_electrons=10.0, exposure=0.01)


# Light of a known power


def mean_electrons(assemble, sight, distance, surfaces=16, **given) -> float:
    """Mean electrons of a pixel over surfaces, which scatter as many as they have scatterers, and the camera's."""
    laser = {"beam_radius": 0.3, "power": 2.0, "wavelength": 500.0}
    detector = {"camera": {"exposure": 1e-3, "quantum_efficiency": 0.5}, "width": 40, "height": 40, "pixel_pitch": 0.05}
    target = {"point_sources": 300} | given.pop("target", {})
    simulation = Simulation(assemble(free_space(
        direction(25, 70), sight, laser=laser, detector_distance=distance, target=target, detector=detector, **given
    )))  # fmt: skip
    frames = [simulation.frame(seed=seed).image for seed in range(surfaces)]
    return float(np.mean([frame.header["camera"]["electrons"] for frame in frames]))


PHOTONS = 2e-3 * 1e-3 / (6.62607015e-34 * 299792458 / 500e-9)
"""Of 2 mW for 1 ms at 500 nm."""

PIXEL = 0.05**2
"""Its area [mm^2]."""

OF_CHANCE = 0.05
"""Relative scatter of the mean of 16 images of some hundred speckles each, three standard errors."""


@pytest.mark.parametrize("polar, distance", [(0.0, 60.0), (35.0, 80.0)])
def test_even_light_of_a_known_power_frees_electrons_by_the_pixel_s_share_of_a_half_space(assemble, polar, distance):
    found = mean_electrons(assemble, direction(polar, 200), distance)
    assert found == pytest.approx(0.5 * PHOTONS * PIXEL / distance**2 / (2 * np.pi), rel=OF_CHANCE)


def test_a_white_target_frees_electrons_by_lambert_s_law(assemble):
    polar = 50.0
    target = {"lobe": True, "bsdf": '<bsdf type="diffuse"><spectrum name="reflectance" value="0.6"/></bsdf>'}
    found = mean_electrons(assemble, direction(polar, 200), 60.0, target=target)
    radiant = 0.6 / np.pi * np.cos(np.radians(polar))
    assert found == pytest.approx(0.5 * PHOTONS * PIXEL / 60.0**2 * radiant, rel=OF_CHANCE)


def test_a_tilted_detector_catches_less(assemble):
    tilt = np.radians(40)
    turned = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    found = mean_electrons(assemble, direction(0), 60.0, tilt=turned)
    assert found == pytest.approx(0.5 * PHOTONS * PIXEL / 60.0**2 / (2 * np.pi) * np.cos(tilt), rel=OF_CHANCE)


def test_all_light_that_passes_a_hole_comes_to_a_detector_behind_it(assemble):
    radius, place, distance = 0.4, 20.0, 40.0
    hole = (
        f'<shape type="aperture" id="stop"><transform name="to_world"><translate z="{place}"/></transform>'
        f'<float name="radius" value="{radius}"/><float name="outer_radius" value="9"/></shape>'
    )
    laser = {"beam_radius": 0.05, "power": 2.0, "wavelength": 500.0}
    side = 32  # pixels, which together are twice as wide as the light behind the hole
    detector = {"camera": {"exposure": 1e-3}, "width": side, "height": side, "pixel_pitch": 0.1}
    simulation = Simulation(assemble(free_space(
        direction(25, 70), laser=laser, detector_distance=distance, target={"point_sources": 100}, detector=detector,
        extra=hole,
    )))  # fmt: skip
    frames = [simulation.frame(seed=seed).image.header["camera"]["electrons"] for seed in range(6)]
    solid_angle = np.pi * radius**2 / place**2
    assert np.mean(frames) * side**2 == pytest.approx(PHOTONS * solid_angle / (2 * np.pi), rel=0.1)


def test_a_pixel_with_gaps_around_it_catches_its_part_of_the_light(assemble):
    whole, part = (
        Simulation(assemble(free_space(laser={"power": 1.0}, detector={"camera": camera}))).frame().image.header
        for camera in ({"exposure": 1e-3, "fill_factor": 1.0}, {"exposure": 1e-3, "fill_factor": 0.4})
    )
    whole, part = (header["camera"]["electrons"] for header in (whole, part))
    assert part / whole == pytest.approx(0.4, rel=1e-3)  # of the 0.006 mm of a pixel the speckle hardly changes


@pytest.mark.parametrize(
    "laser, target, said",
    [({}, {}, "laser's power"), ({"power": 1.0, "beam_radius": np.inf}, {}, "has no power"),
     ({"power": -1.0}, {}, "'power' is -1 mW")],
)  # fmt: skip
def test_an_exposure_needs_the_power_that_falls_on_the_target(assemble, laser, target, said):
    with pytest.raises((SceneError, RuntimeError), match=said):
        assemble(free_space(laser=laser, target=target, detector={"camera": {"exposure": 1e-3}}))


@pytest.mark.parametrize("bits, kind", [(8, np.uint8), (6, np.uint8), (10, np.uint16), (16, np.uint16)])
def test_saved_pictures_hold_the_numbers_as_they_are(tmp_path, bits, kind):
    from PIL import Image
    import tifffile

    camera = Camera.of("c", bit_depth=bits, mean_electrons=500.0)
    dn = expose(camera, np.random.default_rng(1).exponential(size=(20, 30)), ()).dn
    image = FieldImage(dn, None, {"camera": camera.to_json()}, dn=dn)
    for suffix, read in (("png", Image.open), ("tiff", tifffile.imread)):
        write_picture(tmp_path / f"f.{suffix}", image)
        values = np.asarray(read(tmp_path / f"f.{suffix}"))
        assert values.dtype.itemsize == kind().itemsize and np.array_equal(values, dn)


def test_shifts_are_measured_on_the_numbers_unless_a_channel_is_named(tmp_path, capsys):
    from speckle_mi import correlate

    before, after = shifted_pair((SIDE, SIDE), 4.0, (2.5, -1.25), 1)
    for name, dn in (("a", before), ("b", after)):
        field = np.sqrt(before).astype(np.complex64)
        write_field(tmp_path / f"{name}.exr", FieldImage(before.astype(np.float32), field, {}, dn=np.rint(100 * dn)))
    assert np.array_equal(read_field(tmp_path / "b.exr").dn, np.rint(100 * after).astype(np.float32))
    files = [str(tmp_path / f"{name}.exr") for name in "ab"]
    correlate.main(files)
    assert json.loads(capsys.readouterr().out)["shift_u_px"] == pytest.approx(2.5, abs=0.01)
    correlate.main([*files, "--channel", "Y"])
    assert json.loads(capsys.readouterr().out)["shift_u_px"] == pytest.approx(0, abs=1e-6)


def test_mitsuba_s_own_render_has_the_numbers_as_a_channel(load):
    scene = load(free_space(detector={"camera": {"bit_depth": 8}}))
    scene.integrator().render(scene)
    bitmap = scene.sensors()[0].film().bitmap()
    names = [field.name for field in bitmap.struct_()]
    assert names[-1] == "DN" and np.asarray(bitmap)[..., -1].max() <= 255


# The uncertainty of a shift


def ratio(electrons: float, size: float, pairs: int) -> float:
    """Spread of the errors of shifts over noisy pairs, by the root mean square of the stated uncertainties."""
    camera = Camera.of("c", mean_electrons=electrons, full_well=8 * electrons, bit_depth=8, read_noise=2.0)
    errors, stated = [], []
    for number in range(pairs):
        random = np.random.default_rng([number, int(10 * size)])
        shift = random.uniform(-3, 3, 2)
        images = shifted_pair((SIDE, SIDE), size, tuple(shift), 1000 * int(size) + number)
        before, after = (expose(camera, image, (number, shot)).dn for shot, image in enumerate(images))
        found = Correlator(before, WINDOW).shift(after)
        if found.ok:
            errors.append(np.subtract((found.u_px, found.v_px), shift))
            stated.append((found.sigma_u_px, found.sigma_v_px))
    assert len(errors) >= 0.97 * pairs
    return float(np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(stated))))


@pytest.mark.parametrize("electrons, size", SAMPLE)
def test_the_stated_uncertainty_is_the_spread_over_noisy_pairs(electrons, size):
    of_chance = 2 / math.sqrt(4 * SAMPLED_PAIRS)  # two standard errors of the spread of so many
    assert abs(math.log(ratio(electrons, size, SAMPLED_PAIRS))) < math.log(1 + STATED) + of_chance


def main() -> int:
    print(f"spread / stated uncertainty over {PAIRS} pairs, window {WINDOW} px, 8 bits, read noise 2 e-")
    print("speckle (px) " + "".join(f"{electrons:>12,.0f} e-" for electrons in ELECTRONS))
    held = True
    for size in SIZES:
        row = [ratio(electrons, size, PAIRS) for electrons in ELECTRONS]
        held &= all(1 - STATED < value < 1 + STATED for value in row)
        print(f"{size:12g} " + "".join(f"{value:15.2f}" for value in row), flush=True)
    return int(not held)


if __name__ == "__main__":
    raise SystemExit(main())
