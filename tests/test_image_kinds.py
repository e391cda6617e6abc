"""Pictures as cameras and other programs write them: every one gives the same intensities, or says why it does not."""

from __future__ import annotations

import csv
import io
import json

import imagecodecs
import numpy as np
import OpenEXR
import pytest
import tifffile
from bad_scenes import is_clear
from PIL import Image

from speckle_mi.correlate import main
from speckle_mi.images.colours import LUMINANCE, luminance_weights
from speckle_mi.images.field_image import FieldImageError
from speckle_mi.images.pictures import read_image
from speckle_mi.validation.shifts.speckle import shifted_pair

SHAPE, SHIFT = (120, 130), (-2.6, 3.3)
MEAN = 100.0


@pytest.fixture(scope="module")
def speckle():
    """A pair of 16-bit images that hold 12 bits."""
    return [np.round(MEAN * image).clip(0, 4095).astype(np.uint16) for image in shifted_pair(SHAPE, 4.0, SHIFT, 1)]


def same(path, values, rtol=1e-6, atol=1e-3, **options):
    np.testing.assert_allclose(read_image(path, **options).intensity, values, rtol=rtol, atol=atol)


@pytest.mark.parametrize("compression", ["lzw", "zstd", "deflate", "packbits", "lzma"])
@pytest.mark.parametrize("predictor", [False, True])
def test_tiff_of_any_compression(tmp_path, speckle, compression, predictor):
    if predictor and compression == "packbits":
        pytest.skip("has no predictor")
    tifffile.imwrite(tmp_path / "a.tif", speckle[0], compression=compression, predictor=predictor)
    same(tmp_path / "a.tif", speckle[0])


def test_tiff_of_twelve_packed_bits_tiles_and_big_headers(tmp_path, speckle):
    packed = imagecodecs.packints_encode(speckle[0][:, :128], 12)
    tifffile.imwrite(
        tmp_path / "p.tif", iter([packed]), shape=(120, 128), dtype=np.uint16, bitspersample=12,
        compression="none", rowsperstrip=120,
    )  # fmt: skip
    same(tmp_path / "p.tif", speckle[0][:, :128])
    tifffile.imwrite(tmp_path / "t.tif", speckle[0], tile=(32, 32), bigtiff=True)
    same(tmp_path / "t.tif", speckle[0])


def test_tiff_whose_pages_go_in_a_circle_is_refused(tmp_path, speckle):
    tifffile.imwrite(tmp_path / "a.tif", speckle[0], metadata=None)
    content = bytearray((tmp_path / "a.tif").read_bytes())
    first = int.from_bytes(content[4:8], "little")
    last = first + 2 + 12 * int.from_bytes(content[first : first + 2], "little")
    content[last : last + 4] = content[4:8]  # where the next page is: where this one is
    (tmp_path / "a.tif").write_bytes(content)
    with pytest.raises(FieldImageError, match="lead back|damaged"):
        read_image(tmp_path / "a.tif")


def test_tiff_whose_white_is_zero_is_turned_round(tmp_path, speckle):
    grey = (speckle[0] >> 4).astype(np.uint8)
    tifffile.imwrite(tmp_path / "w.tif", 255 - grey, photometric="miniswhite")
    same(tmp_path / "w.tif", grey)
    tifffile.imwrite(tmp_path / "f.tif", grey.astype(np.float32), photometric="miniswhite")
    with pytest.raises(FieldImageError, match="0 is white"):
        read_image(tmp_path / "f.tif")


def test_a_palette_means_its_colours(tmp_path, speckle):
    grey = (speckle[0] >> 4).astype(np.uint8)
    ramp = np.tile(np.arange(255, -1, -1, dtype=np.uint16) * 257, (3, 1))  # from white to black
    tifffile.imwrite(tmp_path / "p.tif", 255 - grey, photometric="palette", colormap=ramp)
    same(tmp_path / "p.tif", grey.astype(float) * 257, rtol=1e-5)
    picture = Image.fromarray(255 - grey, mode="P")
    picture.putpalette(np.repeat(np.arange(255, -1, -1, dtype=np.uint8), 3).tobytes())
    picture.save(tmp_path / "p.png")
    same(tmp_path / "p.png", grey, rtol=1e-5)


def test_planes_of_colours_inks_and_opacity(tmp_path, speckle):
    colours = np.stack([speckle[0], speckle[1], speckle[0][::-1]], axis=-1)
    expected = colours @ np.array(list(LUMINANCE.values()))
    tifffile.imwrite(tmp_path / "c.tif", colours, photometric="rgb")
    tifffile.imwrite(tmp_path / "s.tif", np.moveaxis(colours, -1, 0), photometric="rgb", planarconfig="separate")
    for name in ("c.tif", "s.tif"):
        same(tmp_path / name, expected)
    opaque = np.concatenate([colours, np.full((*SHAPE, 1), 65535, np.uint16)], axis=-1)
    tifffile.imwrite(tmp_path / "o.tif", opaque, photometric="rgb", extrasamples=["unassalpha"])
    same(tmp_path / "o.tif", expected)
    grey = (speckle[0] >> 4).astype(np.uint8)
    inks = np.zeros((*SHAPE, 4), np.uint8)
    inks[..., 3] = 255 - grey
    tifffile.imwrite(tmp_path / "k.tif", inks, photometric="separated")
    same(tmp_path / "k.tif", grey)


def test_colours_of_sixteen_bits_keep_them_in_png(tmp_path, speckle):
    for name, values in (
        ("c.png", np.stack([speckle[0]] * 3, axis=-1)),
        ("a.png", np.stack([speckle[0]] * 3 + [np.full(SHAPE, 65535, np.uint16)], axis=-1)),
        ("g.png", speckle[0]),
    ):
        (tmp_path / name).write_bytes(imagecodecs.png_encode(values))
        same(tmp_path / name, speckle[0])


def test_a_camera_that_was_held_upright_is_turned(tmp_path, speckle):
    grey = (speckle[0] >> 4).astype(np.uint8)
    exif = Image.Exif()
    exif[274] = 6  # to be turned by 90 degrees clockwise
    Image.fromarray(grey).save(tmp_path / "e.png", exif=exif)
    same(tmp_path / "e.png", np.rot90(grey, -1))
    tifffile.imwrite(tmp_path / "e.tif", grey, extratags=[(274, "H", 1, 6, True)])
    same(tmp_path / "e.tif", np.rot90(grey, -1))
    Image.merge("CMYK", [Image.fromarray(np.zeros_like(grey))] * 3 + [Image.fromarray(255 - grey)]).save(
        tmp_path / "k.jpg", quality=100
    )
    same(tmp_path / "k.jpg", grey, atol=4)  # as far as JPEG rounds


def test_pages_are_named(tmp_path, speckle, capsys):
    tifffile.imwrite(tmp_path / "pair.tif", np.stack(speckle), photometric="minisblack")
    with pytest.raises(FieldImageError, match="2 pages.*--page 1 to 2"):
        read_image(tmp_path / "pair.tif")
    with pytest.raises(FieldImageError, match="--page 3"):
        read_image(tmp_path / "pair.tif", page=3)
    same(tmp_path / "pair.tif", speckle[1], page=2)
    assert main([str(tmp_path / "pair.tif")] * 2 + ["--page", "1,2"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["shift_u_px"], found["shift_v_px"]) == pytest.approx(SHIFT, abs=0.01)
    with pytest.raises(ValueError, match="--page 0"):
        main([str(tmp_path / "pair.tif")] * 2 + ["--page", "0"])


# --- OpenEXR ---------------------------------------------------------------------------------------------------------


def write_exr(path, channels, **header):
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(head, {name: np.ascontiguousarray(v, np.float32) for name, v in channels.items()}) as file:
        file.write(str(path))


def window(left, top, columns, rows):
    return (np.array([left, top], np.int32), np.array([left + columns - 1, top + rows - 1], np.int32))


def test_images_lie_where_their_data_windows_say(tmp_path, capsys):
    scene = shifted_pair((200, 200), 4.0, (0, 0), 3)[0]
    display = window(0, 0, 200, 200)
    for name, left, top in (("a.exr", 30, 20), ("b.exr", 18, 27)):
        part = scene[top : top + 150, left : left + 150]
        write_exr(tmp_path / name, {"Y": part}, dataWindow=window(left, top, 150, 150), displayWindow=display)
    image = read_image(tmp_path / "a.exr")
    assert image.origin == (20, 30) and image.canvas == (200, 200)
    assert main([str(tmp_path / "a.exr"), str(tmp_path / "b.exr")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["shift_u_px"], found["shift_v_px"]) == (0.0, 0.0) and "(30, 20)" in found["message"]
    # The part's middle lies at (104.5, 94.5), the canvas's at 99.5: what it shows has its centre about there.
    assert found["cog_reference_u_px"] == pytest.approx(5.0, abs=4.0)
    assert found["cog_reference_v_px"] == pytest.approx(-5.0, abs=4.0)


def test_layers_and_channels_are_had_by_name(tmp_path):
    values = np.random.default_rng(0).random((4, 5, 6)).astype(np.float32)
    layer = {f"glass.{c}": v for c, v in zip("RGB", values)}
    write_exr(tmp_path / "l.exr", {**layer, "depth.Z": values[3]})
    same(tmp_path / "l.exr", np.moveaxis(values[:3], 0, -1) @ list(LUMINANCE.values()), channel="glass")
    same(tmp_path / "l.exr", values[3], channel="depth.Z")
    for options, word in (({}, "glass.R"), ({"channel": "wood"}, "wood"), ({"channel": "depth"}, "depth")):
        with pytest.raises(FieldImageError) as caught:
            read_image(tmp_path / "l.exr", **options)
        is_clear(str(caught.value), "l.exr", word, "--channel" if not options else "")


def test_colours_are_weighted_by_the_primaries_of_the_file(tmp_path):
    rec709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
    assert luminance_weights(rec709) == pytest.approx(LUMINANCE, abs=1e-4)
    rec2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)
    colours = dict(zip("RGB", np.random.default_rng(1).random((3, 5, 6)).astype(np.float32)))
    write_exr(tmp_path / "w.exr", colours, chromaticities=rec2020)
    expected = 0.2627 * colours["R"] + 0.6780 * colours["G"] + 0.0593 * colours["B"]  # Rec. ITU-R BT.2020
    same(tmp_path / "w.exr", expected, rtol=1e-3)


# --- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path, speckle):
    paths = []
    for name, image in zip(("a.tif", "b.tif"), speckle):
        tifffile.imwrite(tmp_path / name, image, compression="lzw")
        paths.append(str(tmp_path / name))
    return paths


def test_centres_of_gravity_are_in_pixels_and_with_a_pitch_in_um(files, speckle, capsys):
    assert main(files) == 0
    found = json.loads(capsys.readouterr().out)
    light = speckle[0].astype(float)
    expected = light.sum(axis=0) @ (np.arange(SHAPE[1]) - (SHAPE[1] - 1) / 2) / light.sum()
    assert found["cog_reference_u_px"] == pytest.approx(expected) and found["cog_reference_u_um"] is None
    assert main([*files, "--pitch", "6"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["cog_reference_u_um"] == pytest.approx(6 * expected)
    assert found["shift_u_um"] == pytest.approx(6 * SHIFT[0], abs=0.06)
    assert 0 < found["sigma_u_px"] < 0.01 and found["sigma_u_um"] == pytest.approx(6 * found["sigma_u_px"])


def test_many_images_make_a_table_in_which_one_may_be_damaged(files, tmp_path, capsys):
    (tmp_path / "c.tif").write_bytes((tmp_path / "b.tif").read_bytes()[:200])
    assert main([*files, files[0], str(tmp_path / "c.tif")]) == 2
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["status"] for row in rows] == ["ok", "ok", "unreadable"] and "c.tif" in rows[2]["message"]
    assert float(rows[0]["shift_u_px"]) == pytest.approx(SHIFT[0], abs=0.01) and float(rows[1]["shift_u_px"]) == 0


@pytest.mark.filterwarnings("error")
def test_an_image_with_pixels_that_are_no_numbers_is_a_row_that_names_it(files, tmp_path, speckle, capsys):
    holed = speckle[1].astype(np.float32)
    holed[3, 4:6] = np.inf, -np.inf
    tifffile.imwrite(tmp_path / "n.tif", holed)
    with pytest.raises(FieldImageError, match="n.tif, the moved image: 2 of"):
        main([files[0], str(tmp_path / "n.tif")])
    capsys.readouterr()
    assert main([files[0], str(tmp_path / "n.tif"), files[1]]) == 2
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["status"] for row in rows] == ["unreadable", "ok"]
    assert "n.tif, the moved image: 2 of" in rows[0]["message"]


def test_images_of_unequal_size_share_their_first_pixel(files, tmp_path, speckle, capsys):
    tifffile.imwrite(tmp_path / "s.tif", speckle[1][:110, :100])
    assert main([files[0], str(tmp_path / "s.tif")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["shift_u_px"], found["shift_v_px"]) == pytest.approx(SHIFT, abs=0.01)
    assert "100 x 110 px" in found["message"]


@pytest.mark.parametrize(
    "flags, words",
    [(["--pitch", "0"], "--pitch 0"), (["--high-pass", "0.5"], "--high-pass 0.5"), (["--fit", "bend"], "bend"),
     (["--bayer", "RGX"], "--bayer RGX"), (["--channel", "Y"], "--channel Y"), (["--page", "2"], "--page 2")],
)  # fmt: skip
def test_flags_out_of_range_are_refused_by_name(files, flags, words):
    with pytest.raises(ValueError, match=words):
        main([*files, *flags])


# --- damage ----------------------------------------------------------------------------------------------------------


KINDS = ("a.tif", "l.tif", "a.png", "c.png", "a.jpg", "a.bmp", "a.gif", "z.exr")
DAMAGED_EACH = 60
"""Files damaged at random of each kind."""


def test_damaged_files_of_any_kind_are_one_clear_line_or_an_image(tmp_path, speckle):
    grey = (speckle[0] >> 4).astype(np.uint8)[:40, :50]
    tifffile.imwrite(tmp_path / "a.tif", grey)
    tifffile.imwrite(tmp_path / "l.tif", grey, compression="lzw")
    for name in ("a.png", "a.jpg", "a.bmp", "a.gif"):
        Image.fromarray(grey).save(tmp_path / name)
    (tmp_path / "c.png").write_bytes(imagecodecs.png_encode(np.stack([speckle[0][:40, :50]] * 3, axis=-1)))
    write_exr(tmp_path / "z.exr", {"Y": grey})
    random = np.random.default_rng(0)
    for kind in KINDS:
        whole = (tmp_path / kind).read_bytes()
        for _ in range(DAMAGED_EACH):
            content = bytearray(whole)
            reach = min(len(whole), random.choice([64, 400, len(whole)]))
            for place in random.integers(0, reach, random.integers(1, 6)):
                content[place] = random.integers(256)
            if random.random() < 0.3:
                del content[random.integers(1, len(content)) :]
            path = tmp_path / f"damaged{(tmp_path / kind).suffix}"
            path.write_bytes(bytes(content))
            try:
                image = read_image(path)
            except FieldImageError as error:
                is_clear(str(error), path.name)
            else:
                assert image.intensity.ndim == 2 and image.intensity.size > 0
