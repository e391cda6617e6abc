"""What a sequence leaves behind besides its frames: truth.csv, track.csv, sequence.json, a picture and a video."""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from ..experiments.sequence import DetectorSequence, FrameSequence
from ..geometry.pose import DEGREES_OF_FREEDOM
from ..machine.files import for_part, replacing, write_csv, write_json
from ..machine.system import system_information
from ..scene.assembly import Assembly
from .plots import FONT, MEAN, THEORY, dress, legend_outside, new_figure, write_picture

TRUTH = ("frame", "time_s", "begin_s", "end_s", *DEGREES_OF_FREEDOM, "moments", "blur_error")
TRACK = ("frame", "time_s", "u_um", "v_um", "sigma_u_um", "sigma_v_um", "predicted_u_um", "predicted_v_um",
         "error_u_um", "error_v_um", "ncc", "reference", "status", "contrast")  # fmt: skip

_FASTEST_GIF = 50.0
"""Pictures a second that viewers of GIF keep up with."""


def write_truth(path: Path, made: FrameSequence) -> None:
    """A row a frame: the time of the middle of its exposure and the pose there, when the exposure began and ended, how
    many moments its mean is made of, and how sure that is."""
    rows = (
        {"frame": number, "time_s": middle, "begin_s": begin, "end_s": begin + made.settings.exposure,
         "moments": made.moments[number], "blur_error": made.blur_errors[number]}
        | {dof: getattr(made.poses[number], dof) for dof in DEGREES_OF_FREEDOM}
        for number, (begin, middle) in enumerate(zip(made.begins, made.middles, strict=True))
    )  # fmt: skip
    write_csv(path, TRUTH, rows)


def write_track(path: Path, made: FrameSequence, assemblies: Mapping[str, Assembly]) -> None:
    """A row a frame, of several detectors one for each, named in a column ``detector``."""
    several = len(assemblies) > 1
    rows = (
        ({"detector": name} if several else {}) | row
        for name, one in made.detectors.items()
        for row in _track_rows(made, one, 1e3 * assemblies[name].detector.pitch)
    )
    write_csv(path, [*(["detector"] if several else []), *TRACK], rows)


def _track_rows(made: FrameSequence, one: DetectorSequence, pixel: float) -> Iterator[dict]:
    for number, point in enumerate(one.track.points):
        place = pixel * np.array([point.u, point.v])
        sigma = pixel * np.array([point.sigma_u, point.sigma_v])
        error = place - one.predicted[number]
        numbers = [made.middles[number], *place, *sigma, *one.predicted[number], *error, point.ncc]
        cells = [None if not math.isfinite(value) else float(value) for value in numbers]
        yield dict(zip(TRACK, [number, *cells, point.reference, point.status, one.contrasts[number]], strict=True))


def summarise_sequence(made: FrameSequence, assemblies: Mapping[str, Assembly]) -> dict:
    """Settings, errors, and of every track its references, its drift and what it is off theory by."""
    settings = made.settings
    return {
        "frames": settings.count,
        "rate_hz": settings.rate,
        "exposure_s": settings.exposure,
        "moments": max(made.moments),
        "blur_error": max(made.blur_errors),
        "numerical_error": made.numerical_error,
        "detectors": {name: _summary(one, 1e3 * assemblies[name].detector.pitch)
                      for name, one in made.detectors.items()},
        "system": system_information(),
    }  # fmt: skip


def _summary(one: DetectorSequence, pixel: float) -> dict:
    points = one.track.points
    place = pixel * np.array([[point.u, point.v] for point in points])
    sigma = pixel * np.array([[point.sigma_u, point.sigma_v] for point in points])
    error = place - np.array(one.predicted)
    known = np.all(np.isfinite(error), axis=1)
    renewals = len(one.track.references) - 1
    drift = sigma[np.flatnonzero(np.all(np.isfinite(sigma), axis=1))[-1]]
    rms = np.sqrt(np.mean(error[known] ** 2, axis=0)) if known.any() else np.full(2, np.nan)
    return {
        "references": one.track.references,
        "renewals": renewals,
        "lost": sum(point.status != "ok" for point in points),
        "drift_um": _pair(drift),
        "drift_per_root_of_renewals_um": _pair(drift / math.sqrt(max(renewals, 1))),
        "last_error_um": _pair(error[known][-1]) if known.any() else None,
        "rms_error_um": _pair(rms) if known.any() else None,
        "contrast": float(np.mean(one.contrasts)),
        "warnings": one.warnings,
    }


def _pair(values: np.ndarray) -> dict[str, float]:
    return {"u": float(values[0]), "v": float(values[1])}


def draw_track(path: Path, made: FrameSequence, one: DetectorSequence, pixel: float) -> None:
    """The track with theory, and below it what it is off by, with twice the drift that it states; pixel [um]."""
    time = np.array(made.middles)
    place = pixel * np.array([[point.u, point.v] for point in one.track.points])
    sigma = pixel * np.array([[point.sigma_u, point.sigma_v] for point in one.track.points])
    predicted = np.array(one.predicted)
    figure = new_figure(6.4, 5.6)
    upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
    for axes in (upper, lower):
        dress(axes)
    for axis, colour, mark in ((0, MEAN, "o"), (1, THEORY, "s")):
        name = "uv"[axis]
        looks = {"color": colour, "markersize": 2.5, "linewidth": 0}
        upper.plot(time, place[:, axis], mark, label=f"{name} tracked", **looks)
        style = {"color": colour, "linewidth": 1, "linestyle": "-" if axis == 0 else "--"}
        upper.plot(time, predicted[:, axis], label=f"{name} theory", **style)
        error = place[:, axis] - predicted[:, axis]
        lower.plot(time, error, mark, **looks)
        wide = np.where(np.isfinite(sigma[:, axis]) & np.isfinite(error), 2 * sigma[:, axis], np.nan)
        lower.fill_between(time, -wide, wide, color=colour, alpha=0.15, linewidth=0, label=f"{name}: 2 x stated drift")
    upper.set_ylabel("pattern's displacement (µm)")
    lower.set_ylabel("tracked − theory (µm)")
    lower.set_xlabel("time (s)")
    upper.set_title(f"{len(one.track.references) - 1} references renewed", loc="left", fontsize=FONT)
    legend_outside(figure, upper, lower, columns=3)
    figure.align_ylabels()
    write_picture(figure, path)


def write_videos(folder: Path, made: FrameSequence) -> list[Path]:
    """Small videos of what every detector sees: ``preview.gif``, and ``preview.mp4`` where there is ffmpeg."""
    written = []
    for name, one in made.detectors.items():
        path = folder / "preview.gif"
        path = path if len(made.detectors) == 1 else for_part(path, name)
        rate = made.settings.rate * len(one.thumbnails) / made.settings.count
        _write_gif(path, one.thumbnails, rate)
        written.append(path)
        if program := shutil.which("ffmpeg"):
            written.append(path.with_suffix(".mp4"))
            _write_mp4(program, written[-1], one.thumbnails, rate)
    return written


def _grey(levels: np.ndarray) -> np.ndarray:
    """Roots of intensity as intensity."""
    return np.round((levels / 255.0) ** 2 * 255).astype(np.uint8)


def _write_gif(path: Path, thumbnails: list[np.ndarray], rate: float) -> None:
    first, *others = (Image.fromarray(_grey(levels)) for levels in thumbnails)
    with replacing(path) as temporary:
        first.save(temporary, format="gif", save_all=True, append_images=others, loop=0,
                   duration=1e3 / min(rate, _FASTEST_GIF))  # fmt: skip


def _write_mp4(program: str, path: Path, thumbnails: list[np.ndarray], rate: float) -> None:
    rows, columns = thumbnails[0].shape
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"  # most players want even sides
    with replacing(path) as temporary:
        arguments = [program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "gray",
                     "-s", f"{columns}x{rows}", "-r", f"{min(rate, _FASTEST_GIF):g}", "-i", "-", "-vf", even,
                     "-pix_fmt", "yuv420p", "-f", "mp4", str(temporary)]  # fmt: skip
        frames = b"".join(_grey(levels).tobytes() for levels in thumbnails)
        done = subprocess.run(arguments, input=frames, capture_output=True, check=False)
        if done.returncode:
            said = done.stderr.decode(errors="replace").strip().splitlines()
            raise OSError(f"{path}: ffmpeg could not write it ({said[-1] if said else done.returncode})")


def together(summary: dict) -> dict:
    """The summary as it is written: of one detector without a name for it."""
    detectors = summary["detectors"]
    if len(detectors) > 1:
        return summary
    return {name: value for name, value in summary.items() if name != "detectors"} | next(iter(detectors.values()))


def write_sequence_summary(path: Path, summary: dict) -> None:
    """Writes sequence.json."""
    write_json(path, together(summary))
