"""Field images on disk: what was written is what is read, other software opens it, damage is named in one line."""

from __future__ import annotations

import json
import math
import os
import threading

import numpy as np
import OpenEXR
import pytest

from speckle_mi.images.exr import read_field, write_field
from speckle_mi.images.field_image import FieldImage, FieldImageError

ROWS, COLUMNS = 24, 40

HEADER = {
    "wavelength_nm": 632.8,
    "pixel_pitch_mm": 0.006,
    "pose": "x=0.1,rz=-0.020000000000000004",
    "seed": 2**40 + 1,
    "scene_hash": "0123456789abcdef",
    "method": "auto",
    "tolerance": 1e-4,
    "phase_sign": "+ikL",
    "version": "0.1.0",
    "u": [1.0, 0.0, 1 / 3],
    "plan": 'free space; "quoted" größer',
    "nothing": "",
}


def image(seed=0, header=HEADER):
    rng = np.random.default_rng(seed)
    field = (rng.normal(size=(ROWS, COLUMNS)) + 1j * rng.normal(size=(ROWS, COLUMNS))).astype(np.complex64)
    return FieldImage(np.abs(field).astype(np.float32) ** 2, field, dict(header))


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "f.exr"
    write_field(path, image())
    return path


def test_field_intensity_and_header_round_trip_exactly(written):
    read = read_field(written)
    np.testing.assert_array_equal(read.intensity, image().intensity)
    np.testing.assert_array_equal(read.field, image().field)
    assert read.header == HEADER
    assert read.intensity.dtype == np.float32 and read.field.dtype == np.complex64


def test_other_software_finds_the_channels_and_the_header(written):
    with OpenEXR.File(str(written), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
        header = dict(file.header())
        assert len(file.parts) == 1
    assert sorted(channels) == ["E.im", "E.re", "Y"]
    assert all(values.dtype == np.float32 and values.shape == (ROWS, COLUMNS) for values in channels.values())
    np.testing.assert_array_equal(channels["Y"], image().intensity)
    np.testing.assert_array_equal(channels["E.re"], image().field.real)
    np.testing.assert_array_equal(channels["E.im"], image().field.imag)
    for name in ("wavelength_nm", "pixel_pitch_mm", "tolerance"):
        assert header[name] == pytest.approx(HEADER[name], rel=1e-6)
    for name in ("pose", "scene_hash", "method", "phase_sign"):
        assert header[name] == HEADER[name]
    # OpenEXR keeps the attribute name "version" for itself; it is in the attribute that holds the header as it was.
    assert json.loads(header["speckle_mi"]) == HEADER
    assert str(header["seed"]) == str(HEADER["seed"])


def test_mitsuba_opens_it_and_shows_the_intensity(mitsuba, written):
    bitmap = mitsuba.Bitmap(str(written))
    names = [channel.name for channel in bitmap.struct_()]
    values = np.array(bitmap)
    np.testing.assert_array_equal(values[..., names.index("Y")], image().intensity)


def test_header_of_a_rendered_frame_says_what_it_is(shipped, tmp_path):
    from speckle_mi.geometry.pose import Pose
    from speckle_mi.field.simulation import simulate

    assembly = shipped("both_tilted", width=32, height=16, seed=3, method="direct")
    rendered = simulate(assembly, Pose(x=0.02, rz=-0.01))
    write_field(tmp_path / "f.exr", rendered)
    header = read_field(tmp_path / "f.exr").header
    assert header == rendered.header
    expected = {
        "wavelength_nm": 632.8, "pixel_pitch_mm": 0.006, "seed": 3, "method": "direct", "tolerance": 1e-4,
        "phase_sign": "+ikL", "scene_hash": assembly.fingerprint(),
    }
    assert {name: header[name] for name in expected} == expected
    assert Pose.parse(header["pose"]) == Pose(x=0.02, rz=-0.01)
    assert header["version"]


def test_further_fields_become_named_layers(tmp_path):
    extra = image(1).field
    write_field(tmp_path / "f.exr", image(), {"pupil": extra})
    with OpenEXR.File(str(tmp_path / "f.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(file.channels()["pupil.re"].pixels, extra.real)
        np.testing.assert_array_equal(file.channels()["pupil.im"].pixels, extra.imag)
    np.testing.assert_array_equal(read_field(tmp_path / "f.exr").field, image().field)


def test_an_image_of_intensity_only_has_no_field(tmp_path):
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": image().intensity}) as file:
        file.write(str(tmp_path / "y.exr"))
    read = read_field(tmp_path / "y.exr")
    assert read.field is None
    np.testing.assert_array_equal(read.intensity, image().intensity)


def test_an_image_of_the_field_only_gets_its_intensity(tmp_path):
    field = image().field
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"E.re": field.real.copy(), "E.im": field.imag.copy()}) as file:
        file.write(str(tmp_path / "e.exr"))
    np.testing.assert_allclose(read_field(tmp_path / "e.exr").intensity, np.abs(field) ** 2, rtol=1e-6)


def test_writing_replaces_a_file_only_when_it_is_complete(written, monkeypatch):
    before = written.read_bytes()

    def fails(self, name):
        with open(name, "wb") as file:
            file.write(b"half")
        raise OSError("the disk is full")

    monkeypatch.setattr(OpenEXR.File, "write", fails)
    with pytest.raises(OSError, match="full"):
        write_field(written, image(1))
    assert written.read_bytes() == before
    assert [path.name for path in written.parent.iterdir()] == ["f.exr"]


def test_writing_over_a_file_leaves_nothing_else_behind(written):
    write_field(written, image(1))
    np.testing.assert_array_equal(read_field(written).field, image(1).field)
    assert [path.name for path in written.parent.iterdir()] == ["f.exr"]


def test_writing_into_a_missing_folder_names_the_folder(tmp_path):
    with pytest.raises(OSError, match="nowhere"):
        write_field(tmp_path / "nowhere" / "f.exr", image())


def damaged(path, change):
    content = bytearray(path.read_bytes())
    change(content)
    path.write_bytes(content)


DAMAGES = {
    "cut in the header": lambda c: c.__delitem__(slice(60, None)),
    "cut in the pixels": lambda c: c.__delitem__(slice(len(c) // 2, None)),
    "cut by one byte": lambda c: c.__delitem__(slice(len(c) - 1, None)),
    "empty": lambda c: c.clear(),
    "text": lambda c: c.__setitem__(slice(None), b"not an image"),
    "magic number only": lambda c: c.__delitem__(slice(4, None)),
    "garbage in the header": lambda c: c.__setitem__(slice(8, 200), b"\xff" * 192),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_named_in_one_line(written, damage):
    damaged(written, DAMAGES[damage])
    with pytest.raises(FieldImageError) as caught:
        read_field(written)
    assert "\n" not in str(caught.value) and "f.exr" in str(caught.value)


def test_missing_files_folders_and_images_of_something_else_are_named(tmp_path):
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"R": image().intensity}) as file:
        file.write(str(tmp_path / "red.exr"))
    for path in (tmp_path / "none.exr", tmp_path, tmp_path / "red.exr"):
        with pytest.raises(FieldImageError) as caught:
            read_field(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert "R" in str(caught.value) and "E.re" in str(caught.value)


def test_a_field_that_is_not_finite_survives(tmp_path):
    odd = image()
    odd.field[0, 0] = complex(math.inf, math.nan)
    write_field(tmp_path / "f.exr", odd)
    np.testing.assert_array_equal(read_field(tmp_path / "f.exr").field, odd.field)


def test_a_damaged_file_of_ours_is_refused_without_a_word_of_the_library(written, capfd):
    """Wherever it is cut, and whichever line begins wrongly: a library prints nothing, and mutes nobody else."""
    whole = written.read_bytes()
    first_line = len(whole) - ROWS * (8 + 3 * 4 * COLUMNS)
    damages = [whole[:length] for length in range(first_line - 8 * ROWS, len(whole), 97)]
    for place in (first_line, first_line + 4, first_line - 8 * ROWS, first_line - 1):
        damages.append(whole[:place] + bytes([whole[place] ^ 0x41]) + whole[place + 1 :])
    for content in damages:
        written.write_bytes(content)
        with pytest.raises(FieldImageError, match="f.exr"):
            read_field(written)
    assert capfd.readouterr() == ("", "")


def test_threads_that_read_leave_standard_output_and_error_to_the_others(written, tmp_path):
    """The process's own descriptors, as other programs and compiled code see them, stay what they were throughout."""
    damaged_file = tmp_path / "cut.exr"
    damaged_file.write_bytes(written.read_bytes()[:-1])
    streams = [(number, os.fstat(number).st_ino) for number in (1, 2)]
    begun, changed = threading.Barrier(5), []

    def reads() -> None:
        begun.wait()
        for _ in range(40):
            read_field(written)
            with pytest.raises(FieldImageError):
                read_field(damaged_file)

    threads = [threading.Thread(target=reads) for _ in range(4)]
    for thread in threads:
        thread.start()
    begun.wait()
    while any(thread.is_alive() for thread in threads):
        changed += [number for number, file in streams if os.fstat(number).st_ino != file]
    assert not changed and [(number, os.fstat(number).st_ino) for number in (1, 2)] == streams
