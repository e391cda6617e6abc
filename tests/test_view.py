"""A field image looked at: numbers of known light, pictures that are whole, refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest
from matplotlib.image import imread
from PIL import Image

from speckle_mi.command_line import BAD_INPUT, DONE, command
from speckle_mi.images.exr import write_field
from speckle_mi.images.field_image import FieldImage
from speckle_mi.measurement.field_statistics import field_statistics, power_spectrum
from speckle_mi.view import main

SIDE, SPECKLE = 256, 4.0
STATISTICAL = 0.06  # Of contrast and size, for some 2000 speckles.


@pytest.fixture
def speckle():
    """A developed speckle field (SIDE, SIDE): white noise through a Gaussian pupil, of SPECKLE px."""
    rng = np.random.default_rng(5)
    noise = rng.normal(size=(SIDE, SIDE)) + 1j * rng.normal(size=(SIDE, SIDE))
    f = np.fft.fftfreq(SIDE)
    # |mu|^2 = exp(-(r / s)^2), whose full width at half maximum is 2 s sqrt(ln 2), from the power exp(-2 (pi s f)^2).
    s = SPECKLE / (2 * np.sqrt(np.log(2)))
    pupil = np.exp(-((np.pi * s) ** 2) * (f[:, None] ** 2 + f**2))
    return np.fft.ifft2(np.fft.fft2(noise) * pupil)


def test_statistics_of_developed_speckle_are_those_of_its_making(speckle):
    found = field_statistics(np.abs(speckle) ** 2)
    assert found.contrast == pytest.approx(1.0, abs=STATISTICAL)
    assert found.size == pytest.approx((SPECKLE, SPECKLE), rel=STATISTICAL)
    levels, densities = found.law
    assert densities[:10] == pytest.approx(np.exp(-levels[:10]), rel=0.2)
    assert np.sum(densities) * (levels[1] - levels[0]) == pytest.approx(1.0, abs=1e-3)


def test_spectrum_of_a_plane_wave_is_one_place():
    rows, columns = np.mgrid[:64, :64]
    power = power_spectrum(np.exp(2j * np.pi * (8 * columns - 4 * rows) / 64))
    assert np.unravel_index(np.argmax(power), power.shape) == (32 - 4, 32 + 8) and power.max() == 1.0
    near = power[32 - 4 - 2 : 32 - 4 + 3, 32 + 8 - 2 : 32 + 8 + 3].sum()
    assert near > 0.999 * power.sum(), "a Hann window keeps it together"


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_a_field_is_drawn_and_told_in_numbers(speckle, tmp_path, capsys, ending):
    file = tmp_path / "f.exr"
    write_field(file, FieldImage(np.abs(speckle) ** 2, speckle, {"pixel_pitch_mm": 0.006}))
    assert command(main, [str(file), "-o", str(tmp_path / f"f.{ending}")]) == DONE
    told = capsys.readouterr().out
    assert f"{SIDE} x {SIDE} pixels of 6 um" in told and "contrast" in told and "µm" in told
    if ending == "png":
        assert len(np.unique(imread(tmp_path / "f.png").reshape(-1, 4), axis=0)) > 500
    else:
        assert "spectrum of the field" in (tmp_path / "f.svg").read_text() or (tmp_path / "f.svg").stat().st_size > 1e4


def test_json_says_the_same_and_nothing_else(speckle, tmp_path, capsys):
    file = tmp_path / "f.exr"
    write_field(file, FieldImage(np.abs(speckle) ** 2, speckle, {"pixel_pitch_mm": 0.006}))
    assert command(main, [str(file), "--json"]) == DONE
    told = json.loads(capsys.readouterr().out)
    found = field_statistics((np.abs(speckle) ** 2).astype(np.float32))
    assert told["contrast"] == pytest.approx(found.contrast)
    assert told["speckle_size_um"] == pytest.approx([6 * one for one in found.size])


def test_pictures_of_cameras_are_looked_at_without_a_field(speckle, tmp_path, capsys):
    intensity = np.abs(speckle) ** 2
    Image.fromarray(np.clip(30 * intensity / intensity.mean(), 0, 255).astype(np.uint8)).save(tmp_path / "camera.png")
    assert command(main, [str(tmp_path / "camera.png"), "-o", str(tmp_path / "look.png")]) == DONE
    assert "px" in capsys.readouterr().out and (tmp_path / "look.png").exists()


def test_dark_images_are_drawn_and_bad_ones_refused(tmp_path, capsys):
    dark = tmp_path / "dark.exr"
    write_field(dark, FieldImage(np.zeros((32, 24)), np.zeros((32, 24), complex), {"pixel_pitch_mm": 0.006}))
    assert command(main, [str(dark), "-o", str(tmp_path / "dark.png"), "--quiet"]) == DONE
    assert command(main, [str(dark), "--json"]) == DONE
    assert json.loads(capsys.readouterr().out, parse_constant=pytest.fail)["contrast"] is None
    assert command(main, [str(dark), "-o", str(tmp_path / "f.bmp")]) == BAD_INPUT
    assert "must end in .png or .svg" in capsys.readouterr().err
    assert command(main, [str(tmp_path / "none.exr")]) == BAD_INPUT
    assert "there is no such file" in capsys.readouterr().err
