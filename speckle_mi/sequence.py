"""``python -m speckle_mi.sequence``: frames of a moving target in time, blurred by the exposure, and their track.

    python -m speckle_mi.sequence SCENE --motion M.csv --rate 200 --exposure 1e-3 --out DIR

A motion is a table with the columns time_s, x, y, z (mm), rx, ry, rz (deg), of which those that rest may be missing, or
a sum of sines, ramps and spins that begins at the time 0. Frame k's exposure begins k / rate after the motion's
beginning; truth.csv has the pose at its middle.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path

from .command_line import add_detector, add_force, command, print_json, say, scene_parser
from .errors import InputError

FRAMES = 50
"""Frames of a motion without an end unless asked otherwise."""

MAX_FRAMES = 1_000_000
"""Most frames of a sequence."""


def main(arguments: Sequence[str] | None = None) -> None:
    start = time.perf_counter()
    options = _parser().parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .experiments.sequence import SequenceSettings, run_sequence
    from .machine.files import for_part, require_folder
    from .scene.load import open_scene

    motion = _motion(options)
    _require_numbers(options)
    folder = require_folder(options.out or Path("results") / f"{Path(options.scene).stem}_sequence")
    scene = open_scene(options.scene, options.defaults, options.variant)
    from .field.blur import FEWEST, Shutter
    from .images.saved import require_saving
    from .plan.cost import WORTH_SAYING, require_affordable
    from .report import sequence_report as report
    from .scene.read import assemblies_from_scene

    assemblies = assemblies_from_scene(scene, options.detector)
    exposure = _exposure(options, assemblies)
    count = _count(options, motion, exposure)
    settings = SequenceSettings(count, options.rate, exposure, options.window, options.renew)
    savers = {name for name, one in assemblies.items() if one.camera is not None and one.camera.bit_depth}
    if options.images:
        for name, one in assemblies.items():
            require_saving(one.camera, f"detector {name!r}")
    cost = Shutter(assemblies, exposure).cost()
    require_affordable(cost, options.force)
    renders = settings.count * (3 * FEWEST if exposure else 1)
    if cost.seconds * renders > WORTH_SAYING:
        say(options, f"expected: {cost} where nothing moves, {settings.count} frames")
    _claim(folder, options.force)
    made = run_sequence(
        assemblies, motion, settings, folder / "frames", options.images or ("png" if savers else None), options.quiet
    )
    report.write_truth(folder / "truth.csv", made)
    report.write_track(folder / "track.csv", made, assemblies)
    for name, one in made.detectors.items():
        path = folder / "track.png"
        path = path if len(assemblies) == 1 else for_part(path, name)
        report.draw_track(path, made, one, 1e3 * assemblies[name].detector.pitch)
    report.write_videos(folder, made)
    summary = report.summarise_sequence(made, assemblies)
    summary |= {"scene": options.scene, "defaults": options.defaults, "seconds_total": time.perf_counter() - start}
    report.write_sequence_summary(folder / "sequence.json", summary)
    print_json(options, report.together(summary))
    for name, one in summary["detectors"].items():
        _say_track(options, name if len(assemblies) > 1 else "track", one)
    say(options, f"{folder}: {settings.count} frames of up to {summary['moments']} moments each, truth.csv, track.csv, "
                 f"track.png, preview.gif and sequence.json, {summary['seconds_total']:.1f} s in all")


def _parser():
    made = scene_parser(
        "sequence", "Frames of a moving target in time, blurred by the exposure, and their track.",
        "scenes/tilted_laser.xml --sine z=0.01,50 --rate 400 --exposure 1e-3 --frames 80",
    )  # fmt: skip
    made.add_argument("--motion", metavar="M.csv", help="table of time_s, x, y, z (mm), rx, ry, rz (deg)")
    for flag, shape, help_text in (
        ("--sine", "z=0.01,50", "amplitude (mm, deg), frequency (Hz) and perhaps a phase (deg) of a motion"),
        ("--ramp", "x=0.1", "speed of a motion (mm/s, deg/s)"),
        ("--spin", "rz=600", "turns a minute about an axis"),
    ):
        made.add_argument(flag, metavar=shape, action="append", default=[], help=f"{help_text}; may be repeated")
    made.add_argument("--rate", type=float, default=100.0, help="frames a second (default: %(default)s)")
    exposure_help = "time that light is collected for each frame, s (default: the camera's, else 0: no blur)"
    made.add_argument("--exposure", type=float, default=None, help=exposure_help)
    frames_help = f"number of frames (default: all of a table, else {FRAMES})"
    made.add_argument("--frames", type=int, default=None, help=frames_help)
    made.add_argument("--window", type=int, default=None, help="side of the correlation window, px (default: 256)")
    made.add_argument("--renew", type=float, default=0.8, help="correlation below which the track takes another "
                      "reference (default: %(default)s)")  # fmt: skip
    images_help = "what cameras save (default: png where one is described)"
    made.add_argument("--images", choices=("png", "tiff"), help=images_help)
    made.add_argument("--out", metavar="DIR", help="folder for the results (default: results/<scene>_sequence)")
    add_detector(made)
    add_force(made)
    return made


def _motion(options):
    """The motion that the flags describe. InputError for none, or two."""
    from .experiments.trajectory import formula_of, read_motion

    formulas = [*options.sine, *options.ramp, *options.spin]
    if options.motion is None and not formulas:
        raise InputError("--motion M.csv, --sine z=0.01,50, --ramp x=0.1 or --spin rz=600 must be given")
    if options.motion is not None and formulas:
        raise InputError("--motion: must be given without --sine, --ramp and --spin")
    if options.motion is not None:
        return read_motion(options.motion)
    return formula_of(options.sine, options.ramp, options.spin)


def _require_numbers(options) -> None:
    if not 0 < options.rate < math.inf:
        raise InputError(f"--rate {options.rate:g}: must be a finite number of frames a second above 0")
    if options.exposure is not None and not 0 <= options.exposure * options.rate <= 1:
        longest = 1 / options.rate
        raise InputError(f"--exposure {options.exposure:g}: must be 0 to {longest:g} s, from one frame to the next")
    if options.frames is not None and not 1 <= options.frames <= MAX_FRAMES:
        raise InputError(f"--frames {options.frames}: must be 1 to {MAX_FRAMES}")
    if options.window is not None and options.window < 4:
        raise InputError(f"--window {options.window}: must be at least 4 px")
    if not 0 < options.renew < 1:
        raise InputError(f"--renew {options.renew:g}: must be a correlation between 0 and 1")


def _exposure(options, assemblies) -> float:
    """The exposure [s]: that asked for, else the first camera's own."""
    if options.exposure is not None:
        return options.exposure
    known = [one.camera.exposure for one in assemblies.values() if one.camera is not None and one.camera.exposure]
    if known and known[0] * options.rate > 1:
        raise InputError(
            f"--rate {options.rate:g}: leaves no time for the camera's exposure of {known[0]:g} s, must be at most "
            f"{1 / known[0]:g} frames a second, or --exposure be given"
        )
    return known[0] if known else 0.0


def _count(options, motion, exposure: float) -> int:
    from .experiments.sequence import frames_in

    held = frames_in(motion, options.rate, exposure)
    if held is None:
        return options.frames or FRAMES
    if options.frames is not None and options.frames > held:
        raise InputError(f"--frames {options.frames}: must be at most the {held} that the motion lasts for")
    if held > MAX_FRAMES:
        raise InputError(f"--rate {options.rate:g}: would make {held} frames, must be at most {MAX_FRAMES}")
    return options.frames or held


def _claim(folder: Path, force: bool) -> None:
    """Makes the folder ready; InputError where it holds something and it may not be overwritten."""
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise InputError(f"{folder}: is not empty, give another --out or --force to write there")
    frames = folder / "frames"
    frames.mkdir(parents=True, exist_ok=True)
    for stale in (*frames.glob("frame_*"), *folder.glob("preview*.*"), *folder.glob("track*.*"),
                  folder / "truth.csv", folder / "sequence.json"):  # fmt: skip
        stale.unlink(missing_ok=True)


def _say_track(options, name: str, found: dict) -> None:
    drift, error = found["drift_um"], found["last_error_um"]
    beside = "" if error is None else f", off theory by {error['u']:+.2f}, {error['v']:+.2f} um"
    lost = f", lost {found['lost']} times" if found["lost"] else ""
    say(options, f"{name}: {found['renewals']} references renewed{lost}, drift {drift['u']:.2f}, {drift['v']:.2f} um "
                 f"(standard uncertainty at the end){beside}; contrast {found['contrast']:.3f}")  # fmt: skip
    for warning, count in found["warnings"].items():
        say(options, f"warning: {warning} ({count} frames)")


if __name__ == "__main__":
    raise SystemExit(command(main))
