"""``python -m speckle_mi.render``: one field image of a scene."""

from __future__ import annotations

import json
import os
import time
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from .cli import add_force, command, load_scene, say, scene_parser
from .exr import read_header, write_field
from .files import refuse_other_settings, replacing, require_distinct, require_output
from .geometry import Pose
from .memory import excess
from .progress import progress_bars, tell

BYTES_PER_LAYER = 24
"""Memory of a pixel of one scatterer's field while it is being written: complex128 and its two float32 channels."""

MAX_LAYERS = 1_000_000
"""Most fields of single scatterers in a file."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = scene_parser("render", "Renders one field image of a scene.")
    parser.add_argument("-o", "--output", required=True, metavar="F.exr", help="EXR file to write")
    parser.add_argument("--pose", metavar="x=0.02,ry=0.01", help="displacement of the target (mm, deg)")
    parser.add_argument("--sources", metavar="F.npz", help="also write what the sum was made of")
    parser.add_argument(
        "--per-source",
        type=int,
        default=0,
        metavar="K",
        help="also write the fields of the first K scatterers, as layers",
    )
    spp_help = "sub-pixels a pixel that the intensity is averaged over (default: the scene's, else 1)"
    parser.add_argument("--spp", type=int, default=0, help=spp_help)
    add_force(parser)
    options = parser.parse_args(arguments)
    pose = None if options.pose is None else _pose(options.pose)
    for flag, value in (("--per-source", options.per_source), ("--spp", options.spp)):
        if value < 0:
            raise ValueError(f"{flag} {value}: must not be negative")
    if options.per_source > MAX_LAYERS:
        raise ValueError(f"--per-source {options.per_source}: must be at most {MAX_LAYERS} (layers of a file)")
    require_output(options.output, ".exr")
    if options.sources is not None:
        require_output(options.sources, ".npz")
    require_distinct(SCENE=options.scene, output=options.output, sources=options.sources)

    scene = load_scene(options.scene, options.defaults, options.variant)
    from .assembly import assembly_from_scene
    from .simulate import simulate_frame

    assembly = assembly_from_scene(scene, spp=options.spp)
    settings = {
        "scene_hash": assembly.fingerprint(),
        "seed": assembly.seed,
        "pose": str(pose or assembly.pose),
        "per_source": options.per_source,
    }
    refuse_other_settings(options.output, settings_of_image(options.output, settings), settings, options.force)
    if options.sources:
        refuse_other_settings(options.sources, settings_of_sources(options.sources), settings, options.force)
    with progress_bars(options.quiet):
        start = time.perf_counter()
        frame = simulate_frame(assembly, pose)
        seconds = time.perf_counter() - start
        layers = source_layers(assembly, frame.scatterers, pose, options.per_source)
    image = replace(frame.image, header=frame.image.header | settings)
    write_field(options.output, image, layers)
    if options.sources:
        write_sources(options.sources, assembly, frame.scatterers, settings)
    for line in frame.plan:
        say(options, f"plan: {line}")
    for warning in frame.warnings:
        say(options, f"warning: {warning}")
    rows, columns = assembly.detector.shape
    say(options, f"{options.output}: {columns} x {rows} pixels, {frame.scatterers.count} scatterers, {seconds:.3g} s, "
                 f"numerical error {frame.numerical_error:.1e}")


def _pose(text: str) -> Pose:
    """The displacement that ``--pose`` gives, which must name one."""
    if not text.strip():
        raise ValueError(f"--pose {text!r}: must name a displacement, for example x=0.02,ry=0.01")
    return Pose.parse(text)


def source_layers(assembly, scatterers, pose: Pose | None, count: int) -> dict[str, np.ndarray]:
    """Complex fields (rows, columns) of the first ``count`` scatterers alone, by the names of their layers.

    Raises ValueError where they take more memory than the machine has.
    """
    from .simulate import field_of

    asked, count = count, min(count, scatterers.count)
    if too_much := excess(count * assembly.detector.size * BYTES_PER_LAYER):
        raise ValueError(f"--per-source {asked}: the layers {too_much}")
    digits = max(3, len(str(count)))
    layers = {}
    for number in range(count):
        layers[f"source{number:0{digits}d}"] = field_of(assembly, scatterers.selected(np.array([number])), pose)
        tell("layers", number + 1, count)
    return layers


def settings_of_image(path: str | os.PathLike, wanted: Iterable[str]) -> dict | None:
    """What an image says of the ``wanted`` settings; None where it is none of ours."""
    try:
        header = read_header(path)
    except ValueError:
        return None
    return {name: header.get(name) for name in wanted}


def settings_of_sources(path: str | os.PathLike) -> object:
    """The settings with which ``--sources`` wrote a file; None where it did not."""
    try:
        with zipfile.ZipFile(path) as archive:
            return json.loads(archive.comment)
    except (OSError, ValueError, zipfile.BadZipFile):
        return None


def write_sources(path: str | os.PathLike, assembly, scatterers, settings: dict | None = None) -> None:
    """Writes position, amplitude and pixel geometry, with which the field can be checked independently.

    In free space without a lobe the field is the sum of ``amplitude * exp(i k r) / r`` over ``position`` exactly. The
    settings stand in the archive's comment.
    """
    grid = assembly.detector
    with replacing(path) as temporary, open(temporary, "w+b") as file:
        np.savez(
            file,
            position=scatterers.position,
            amplitude=scatterers.amplitude,
            pixel_origin=grid.origin,
            u=grid.u,
            v=grid.v,
            pitch=grid.pitch,
            wavelength=assembly.beam.wavelength,
        )
        with zipfile.ZipFile(file, "a") as archive:
            archive.comment = json.dumps(settings or {}).encode()


if __name__ == "__main__":
    raise SystemExit(command(main))
