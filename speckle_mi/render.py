"""``python -m speckle_mi.render``: one field image of a scene."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from .command_line import add_detector, add_force, add_images, command, print_json, say, scene_parser
from .errors import InputError

if TYPE_CHECKING:
    from .geometry.pose import Pose

MAX_LAYERS = 1_000_000
"""Most fields of single scatterers in a file."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = scene_parser(
        "render", "Renders one field image of a scene.", "scenes/tilted_laser.xml -o moved.exr --pose x=0.02,ry=0.01"
    )
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
    shot_help = "which picture a camera takes there: another number has other noise (default: %(default)s)"
    parser.add_argument("--shot", type=int, default=0, metavar="N", help=shot_help)
    add_detector(parser)
    add_images(parser)
    add_force(parser)
    options = parser.parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .machine.files import require_distinct, require_output
    from .scene.load import open_scene

    pose = None if options.pose is None else _pose(options.pose)
    for flag, value in (("--per-source", options.per_source), ("--spp", options.spp), ("--shot", options.shot)):
        if value < 0:
            raise InputError(f"{flag} {value}: must not be negative")
    if options.per_source > MAX_LAYERS:
        raise InputError(f"--per-source {options.per_source}: must be at most {MAX_LAYERS} (layers of a file)")
    require_output(options.output, ".exr")
    if options.sources is not None:
        require_output(options.sources, ".npz")
    require_distinct(SCENE=options.scene, output=options.output, sources=options.sources)

    scene = open_scene(options.scene, options.defaults, options.variant)
    from .field.detectors import Simulations
    from .images.saved import require_saving
    from .machine.progress import progress_bars
    from .plan.cost import WORTH_SAYING, require_affordable
    from .scene.read import assemblies_from_scene

    assemblies = assemblies_from_scene(scene, options.detector, options.spp)
    files = {name: _Files.of(options, name if len(assemblies) > 1 else None) for name in assemblies}
    settings = {}
    for name, assembly in assemblies.items():
        if options.images:
            require_saving(assembly.camera, f"detector {name!r}")
        settings[name] = {
            "scene_hash": assembly.fingerprint(),
            "seed": assembly.seed,
            "pose": str(pose or assembly.pose),
            "per_source": options.per_source,
        } | ({"shot": options.shot} if assembly.camera else {})
        files[name].refuse_others(settings[name], options.force)
    simulations = Simulations(assemblies)
    cost = simulations.cost(pose)
    require_affordable(cost, options.force)
    if cost.seconds > WORTH_SAYING:
        say(options, f"expected: {cost}")
    with progress_bars(options.quiet):
        start = time.perf_counter()
        frames = simulations.frames(pose, shot=options.shot)
        seconds = time.perf_counter() - start
    written = {}
    for name, frame in frames.items():
        took = seconds if len(frames) == 1 else frame.seconds
        _write(files[name], assemblies[name], frame, settings[name], pose, options, took)
        written[name] = settings[name] | {
            "output": str(files[name].output), "plan": frame.plan, "warnings": list(frame.warnings), "seconds": took,
            "scatterers": frame.scatterers.count, "numerical_error": frame.numerical_error,
        }  # fmt: skip
    print_json(options, {"detectors": written} if len(written) > 1 else written[name])


@dataclass(frozen=True)
class _Files:
    """What is written of one detector: its image, what the sum was made of, what its camera saves."""

    output: Path
    sources: Path | None
    picture: Path | None

    @classmethod
    def of(cls, options, detector: str | None) -> _Files:
        """detector: its name, where it is one of several. Raises OSError where a file cannot be written."""
        from .machine.files import for_part, require_distinct, require_output

        output, sources = Path(options.output), options.sources and Path(options.sources)
        if detector is not None:
            output, sources = for_part(output, detector), sources and for_part(sources, detector)
            for path in filter(None, (output, sources)):
                require_output(path)
        picture = output.with_suffix(f".{options.images}") if options.images else None
        if picture:
            require_output(picture)
        require_distinct(SCENE=options.scene, output=output, sources=sources, images=picture)
        return cls(output, sources, picture)

    def refuse_others(self, settings: dict, force: bool) -> None:
        """InputError where there are results of other settings, unless forced."""
        from .field.sources import settings_of_sources
        from .machine.files import refuse_other_settings

        refuse_other_settings(self.output, settings_of_image(self.output, settings), settings, force)
        if self.picture and self.picture.exists() and not self.output.exists():
            refuse_other_settings(self.picture, None, settings, force)
        if self.sources:
            refuse_other_settings(self.sources, settings_of_sources(self.sources), settings, force)


def _write(files: _Files, assembly, frame, settings: dict, pose: Pose | None, options, seconds: float) -> None:
    """Writes what one detector sees, and says what was done for it."""
    from .field.sources import source_layers, write_sources
    from .images.exr import write_field
    from .images.saved import write_picture
    from .machine.progress import progress_bars

    with progress_bars(options.quiet):
        layers = source_layers(frame.parts, pose, options.per_source)
    image = replace(frame.image, header=frame.image.header | settings)
    write_field(files.output, image, layers)
    if files.sources:
        write_sources(files.sources, assembly, frame.scatterers, settings, frame.parts)
    if files.picture:
        write_picture(files.picture, image)
    for line in frame.plan:
        say(options, f"plan: {line}")
    for warning in frame.warnings:
        say(options, f"warning: {warning}")
    rows, columns = assembly.detector.shape
    say(options, f"{files.output}: {columns} x {rows} pixels, {frame.scatterers.count} scatterers, {seconds:.3g} s, "
                 f"numerical error {frame.numerical_error:.1e}")


def _pose(text: str) -> Pose:
    """The displacement that ``--pose`` gives, which must name one."""
    from .geometry.pose import Pose

    if not text.strip():
        raise InputError(f"--pose {text!r}: must name a displacement, for example x=0.02,ry=0.01")
    return Pose.parse(text)


def settings_of_image(path: str | os.PathLike, wanted: Iterable[str]) -> dict | None:
    """What an image says of the ``wanted`` settings; None where it is none of ours."""
    from .images.exr import read_header

    try:
        header = read_header(path)
    except ValueError:
        return None
    return {name: header.get(name) for name in wanted}


if __name__ == "__main__":
    raise SystemExit(command(main))
