"""``python -m speckle_mi.view``: a field image looked at, as a picture and in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .command_line import command, parser, print_json, say


def main(arguments: Sequence[str] | None = None) -> None:
    made = parser(
        "view", "Shows a field image, or any image: light, phase, spectrum and statistics of the speckle.",
        "moved.exr -o moved.png",
    )  # fmt: skip
    made.add_argument("image", metavar="F.exr", help="field image, or another EXR, PNG, TIFF or JPEG")
    made.add_argument("-o", "--output", metavar="F.png|F.svg", help="picture to write")
    made.add_argument("--channel", metavar="NAME", help="channel of an EXR file to take for the intensity")
    options = made.parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .images.pictures import read_image
    from .machine.files import require_distinct, require_picture
    from .machine.quiet import muted
    from .measurement.covariance import checked_image
    from .measurement.field_statistics import field_statistics

    if options.output is not None:
        require_picture(options.output)
        require_distinct(image=options.image, output=options.output)
    with muted():  # OpenEXR prints what is damaged in pictures of other programs, besides the error it raises
        image = read_image(options.image, None, options.channel)
    checked_image(image.measured, options.image)
    statistics, pitch = field_statistics(image.measured), image.header.get("pixel_pitch_mm")
    if options.output is not None:
        from .report.field_view import draw_field

        draw_field(options.output, image.measured, image.field, pitch, statistics, Path(options.image).name)
    print_json(options, statistics.to_json(pitch))
    from .report.field_view import words_of

    rows, columns = image.measured.shape
    say(options, f"{options.image}: {columns} x {rows} pixels" + ("" if pitch is None else f" of {1e3 * pitch:.4g} um"))
    for line in words_of(statistics, pitch):
        say(options, line)


if __name__ == "__main__":
    raise SystemExit(command(main))
