"""``python -m speckle_mi.correlate``: displacement of the speckle pattern between two images.

    python -m speckle_mi.correlate REF.exr MOVED.exr [--window 256]

Shift, correlation, centres of gravity and statistics of any two images as JSON, lengths in um where a header gives the
pixel pitch; how a shift is measured, and when none is reported, says :mod:`speckle_mi.measurement.correlator`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from .command_line import command, parser


def main(argv: Sequence[str] | None = None) -> int:
    """Print the comparison of two images as one JSON object."""
    arguments_of = parser("correlate", "Shift of the speckle pattern between two images, as JSON on stdout.")
    kinds = "a field image, or any EXR, PNG, TIFF or JPEG"
    arguments_of.add_argument("reference", metavar="REF.exr", help=f"image before the motion: {kinds}")
    arguments_of.add_argument("moved", metavar="MOVED.exr", help="image after the motion")
    window_help = "side of the correlation window (default: 256, less on a small detector)"
    arguments_of.add_argument("--window", type=int, metavar="PX", help=window_help)
    arguments = arguments_of.parse_args(argv)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .images.pictures import read_image
    from .machine.quiet import muted
    from .measurement.compare import common_pitch, compare

    with muted():  # OpenEXR prints what is damaged in pictures of other programs, besides the error it raises
        reference, moved = read_image(arguments.reference), read_image(arguments.moved)
    pitch = common_pitch(reference.header, moved.header)
    result = compare(reference.intensity, moved.intensity, pitch, arguments.window)
    # JSON has no NaN.
    known = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in result.items()}
    print(json.dumps(known, indent=2))
    return 0


if __name__ == "__main__":
    raise SystemExit(command(main))
