"""Pictures of any kind as images of intensity, and what is no picture."""

from __future__ import annotations

import imageio.v3
import numpy as np
import OpenEXR
import pytest
from bad_scenes import is_clear
from test_statistics import speckle_pair

from speckle_mi.measurement.correlator import correlate
from speckle_mi.images.field_image import FieldImageError
from speckle_mi.images.pictures import read_image

SHIFT = (4.0, -3.0)
ROUNDED = {"png": 0.01, "tif": 0.01, "jpg": 0.05}
"""Error of a shift [px] that values of 8 bits, and JPEG's compression, may cause in speckle of 6 px."""


@pytest.fixture(scope="module")
def speckle():
    pair = speckle_pair((120, 160), (6.0, 6.0), 1, SHIFT, 1.0)
    return [np.asarray(255 * np.minimum(image / (6 * image.mean()), 1.0)).astype(np.uint8) for image in pair]


@pytest.mark.parametrize("kind", ROUNDED)
@pytest.mark.parametrize("colours", [False, True])
def test_the_shift_between_two_pictures_is_found_whatever_their_format(tmp_path, speckle, kind, colours):
    names = [tmp_path / f"{n}.{kind}" for n in "ab"]
    for name, image in zip(names, speckle):
        imageio.v3.imwrite(name, np.stack([image] * 3, axis=-1) if colours else image)
    found = correlate(*(read_image(name).intensity for name in names))
    assert np.abs(np.subtract((found.u_px, found.v_px), SHIFT)).max() < ROUNDED[kind]


def test_sixteen_bits_and_floats_keep_their_values(tmp_path):
    values = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000
    for name, stored in (("a.tif", values), ("a.png", values), ("b.tif", values.astype(np.float32))):
        imageio.v3.imwrite(tmp_path / name, stored)
        image = read_image(tmp_path / name)
        assert np.array_equal(image.intensity, values) and image.field is None and image.header == {}


def test_colours_of_other_programs_become_luminance(tmp_path):
    colours = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32)
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(head, {"RGB": colours}).write(str(tmp_path / "a.exr"))
    np.testing.assert_allclose(read_image(tmp_path / "a.exr").intensity, colours @ [0.2126, 0.7152, 0.0722], rtol=1e-6)


def test_opacity_is_no_colour(tmp_path, speckle):
    opaque = np.full_like(speckle[0], 255)
    imageio.v3.imwrite(tmp_path / "a.png", np.stack([speckle[0]] * 3 + [opaque], axis=-1))
    np.testing.assert_allclose(read_image(tmp_path / "a.png").intensity, speckle[0], rtol=1e-6)


@pytest.mark.parametrize("kind", ["png", "tif", "jpg"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_a_picture_cut_short_is_refused(tmp_path, speckle, kind, share):
    path = tmp_path / f"a.{kind}"
    imageio.v3.imwrite(path, speckle[0])
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(FieldImageError) as caught:
        read_image(path)
    is_clear(str(caught.value), path.name, "PNG")


def test_what_is_no_picture_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    imageio.v3.imwrite(tmp_path / "stack.tif", np.zeros((5, 20, 30), np.uint8))
    cases = ("text.png", "no image"), ("stack.tif", "5 pages"), (".", "not a file"), ("none", "no such")
    for name, word in cases:
        with pytest.raises(FieldImageError) as caught:
            read_image(tmp_path / name)
        is_clear(str(caught.value), word)
    with pytest.raises(FieldImageError, match="name of an image"):
        read_image("")
