"""``python -m speckle_mi.correlate``: displacement of a speckle pattern between images, with its uncertainty.

    python -m speckle_mi.correlate REF MOVED... [--window 256] [--fit affine] [--pitch 6] [--dark F] [--mask F]

Shift, correlation, centres of gravity and statistics of any two images as JSON, lengths in um where a header or --pitch
gives the pixel pitch; of several moved images as CSV, a row each. How a shift is measured, and when none is reported,
says :mod:`speckle_mi.measurement.correlator`.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace

from .command_line import command, parser, print_json
from .errors import InputError

FITS = ("shift", "rotation", "scale", "affine")
"""What `measurement.deformation` fits."""

UNREADABLE = "unreadable"
"""Status of a moved image, one of several, that is none."""


def main(argv: Sequence[str] | None = None) -> int:
    """Print the comparison of two images as one JSON object, of more as CSV."""
    arguments = _arguments().parse_args(argv)
    _check(arguments)
    compared = _comparer(arguments)
    if len(arguments.moved) == 1 and not arguments.csv:
        # JSON has no NaN.
        print(json.dumps(_known(compared(arguments.moved[0], 1)), indent=2))
        return 0
    return _table(arguments, compared)


def _arguments():
    made = parser(
        "correlate", "Shift of the speckle pattern between images: JSON on stdout, CSV for several.",
        "rest.exr moved.exr --fit affine",
    )  # fmt: skip
    kinds = "a field image, or any EXR, TIFF, PNG, JPEG"
    made.add_argument("reference", metavar="REF", help=f"image before the motion: {kinds}")
    made.add_argument("moved", metavar="MOVED", nargs="+", help="image after the motion; several give a table")
    window_help = "side of the correlation window (default: 256, less on a small detector)"
    made.add_argument("--window", type=int, metavar="PX", help=window_help)
    made.add_argument("--fit", default="shift", choices=FITS, help="also fit rotation, scale or all of the strain")
    made.add_argument("--pitch", type=float, metavar="UM", help="pixel pitch, for images that do not say it")
    made.add_argument("--dark", metavar="F", help="picture without light, taken off every image")
    made.add_argument("--flat", metavar="F", help="picture of even light, divided out")
    made.add_argument("--mask", metavar="F", help="picture that is black where the images are not to be looked at")
    made.add_argument("--high-pass", type=float, metavar="PX", help="take off structure larger than this")
    made.add_argument("--bayer", metavar="RGGB", help="colours of a raw picture's first 2 x 2 pixels, by row")
    made.add_argument("--colour", metavar="R|G|B", help="with --bayer: use this colour alone")
    made.add_argument("--page", metavar="N[,N...]", help="page of files that have several: for all, or one an image")
    made.add_argument("--channel", metavar="NAME", help="channel or layer of EXR files")
    made.add_argument("--csv", action="store_true", help="print a table, also of one moved image")
    return made


def _check(arguments) -> None:
    if arguments.pitch is not None and not 0.0 < arguments.pitch < math.inf:
        raise InputError(f"--pitch {arguments.pitch:g}: must be a positive number of um")
    if arguments.high_pass is not None and not 1.0 <= arguments.high_pass < math.inf:
        raise InputError(f"--high-pass {arguments.high_pass:g}: must be at least 1 px")


def _pages(text: str | None, count: int) -> list[int | None]:
    """The page of each of ``count`` images. Raises InputError."""
    if text is None:
        return [None] * count
    try:
        pages = [int(part) for part in text.split(",")]
    except ValueError:
        pages = [0]
    if min(pages) < 1 or len(pages) not in (1, count):
        raise InputError(f"--page {text}: must be a whole number from 1, or {count} of them with commas, one an image")
    return pages * count if len(pages) == 1 else pages


def _comparer(arguments) -> Callable[[str, int], dict]:
    """A function that compares the reference with a moved image, by its name and number."""
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .images.field_image import FieldImageError
    from .images.pictures import read_image
    from .images.placing import on_common_pixels
    from .machine.quiet import muted
    from .measurement.compare import Comparison, centres, common_pitch
    from .measurement.correction import read_correction
    from .measurement.covariance import checked_image

    def picture(name: str, page: int | None = None, channel: str | None = None):
        with muted():  # OpenEXR prints what is damaged in pictures of other programs, besides the error it raises
            return read_image(name, page, channel)

    pages = _pages(arguments.page, 1 + len(arguments.moved))
    correction = read_correction(
        lambda name: picture(name).measured,
        arguments.dark, arguments.flat, arguments.mask, arguments.bayer, arguments.colour,
    )  # fmt: skip

    def read(name: str, number: int):
        image = picture(name, pages[number], arguments.channel)
        try:
            checked_image(image.measured, f"{name}, the {'moved' if number else 'reference'} image")
        except InputError as error:  # of this file, so that one of several is a row that says so
            raise FieldImageError(str(error)) from None
        return replace(image, intensity=correction.apply(image.measured), dn=None)

    reference = read(arguments.reference, 0)
    made: dict[tuple, Comparison] = {}  # of the last kind of image

    def compared(name: str, number: int) -> dict:
        moved = read(name, number)
        given = common_pitch(reference.header, moved.header)
        pitch = given if arguments.pitch is None else 1e-3 * arguments.pitch
        if given is not None and pitch is not None and not math.isclose(given, pitch, rel_tol=1e-6):
            raise InputError(f"--pitch {arguments.pitch:g}: the images' headers say {1e3 * given:g} um")
        one, other, note = on_common_pixels(reference, moved)
        key = (one.shape, moved.origin, pitch)  # moved images of one kind share the reference's transforms
        if key not in made:
            made.clear()
            valid = correction.valid()
            valid = valid if valid is None or valid.shape == one.shape else None
            made[key] = Comparison(one, pitch, arguments.window, arguments.fit, valid, arguments.high_pass)
        result = made[key].with_moved(other, note=note)
        if note:
            # Of what each image shows, from the middle of the canvas.
            result |= centres(_centre_on_canvas(reference), _centre_on_canvas(moved), made[key].um)
        return result

    return compared


def _centre_on_canvas(image) -> tuple[float, float]:
    """Centre of gravity (u, v) [px] of an image from the middle of its canvas."""
    from .images.placing import middle_offset
    from .measurement.speckle_statistics import centre_of_gravity

    u, v = (c + o for c, o in zip(centre_of_gravity(image.intensity), middle_offset(image)))
    return u, v


def _known(result: dict) -> dict:
    """A result with None for what is not known."""
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in result.items()}


def _table(arguments, compared: Callable[[str, int], dict]) -> int:
    """Prints a row for each moved image; one that cannot be read is a row that says so. Returns the exit status."""
    from .images.field_image import FieldImageError

    rows, status = [], 0
    for number, name in enumerate(arguments.moved, start=1):
        try:
            rows.append({"moved": name, **_known(compared(name, number))})
        except FieldImageError as error:
            rows.append({"moved": name, "status": UNREADABLE, "message": str(error)})
            status = 2
    print_json(arguments, rows)
    if arguments.json:
        return status
    columns = max(rows, key=len)
    for row in rows:
        if isinstance(row.get("window"), list):
            row["window"] = "x".join(map(str, row["window"][::-1]))
    writer = csv.DictWriter(sys.stdout, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return status


if __name__ == "__main__":
    raise SystemExit(command(main))
