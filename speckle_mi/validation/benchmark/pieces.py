"""What is around the sums: the kernel by itself, correlation, writing, placing scatterers, whole commands."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial

from ...field.simulation import simulate
from ...geometry.pose import Pose
from ...images.exr import write_field
from ...machine.interrupt import scratch_folder
from ...machine.run_times import timed
from ...measurement.correlator import Correlator
from ...propagation.direct import direct_sum
from ...propagation.paths import FreeSpace
from ...scattering.rough_surface import illuminated_scatterers
from ...scene.load import load_scene
from ...scene.shipped import folder as folder_of_scenes
from .commands import command_times
from .one_frame import SURFACES, against_sweep
from .specimen import SCENE, Specimen
from .studies import engine_overhead, frame_budget, many_frames, sweep_budget

PAIRS_SOURCES, QUICK_PAIRS_SOURCES = 4096, 512
"""Scatterers by which the pairs that the kernel sums in a second are counted."""

PLACED, QUICK_PLACED = (100_000, 1_000_000), (1_000,)
"""Numbers of scatterers whose placing is timed."""

MOVED = 0.012
"""Displacement [mm] along x of the frame that is correlated: a tenth of the beam's radius."""


def pieces(specimen: Specimen, quick: bool) -> dict[str, dict]:
    """Name -> {seconds, what}: kernel, correlation, writing, scatterers, warm start, studies."""
    rest, moved = (simulate(specimen.assembly, Pose(x=x)) for x in (0.0, MOVED))
    found = {"direct kernel": _kernel(specimen, QUICK_PAIRS_SOURCES if quick else PAIRS_SOURCES)}
    correlator = Correlator(rest.intensity)
    size = "{1} x {0}".format(*specimen.grid.shape)
    found["correlation of a frame"] = asdict(timed(lambda: correlator.shift(moved.intensity))) | {
        "what": f"{size}, window {correlator.window}"
    }
    with scratch_folder() as folder:
        path = folder / "frame.exr"
        found["EXR writing"] = asdict(timed(lambda: write_field(path, rest))) | {"what": f"{size}, three channels"}
        found |= command_times(folder, SCENE, specimen.grid.shape, quick)
        found |= frame_budget(specimen, folder)
        found |= sweep_budget(folder, folder / "tilted_laser.xml", quick)
        found |= engine_overhead(folder, quick)
        if not quick:
            found |= many_frames(folder, folder / "tilted_laser.xml")
    for count in QUICK_PLACED if quick else PLACED:
        target = specimen.denser(count).target
        timing = timed(partial(illuminated_scatterers, target.surface, specimen.assembly.beam, target.frame))
        found[f"scatterers, {count:,}"] = asdict(timing) | {"what": "places, heights, illumination"}
    found |= against_sweep("free space", specimen.assembly, surfaces=2 if quick else SURFACES)
    if not quick:
        found |= against_sweep("lens", load_scene(folder_of_scenes() / "imaging.xml"))
    return found


def _kernel(specimen: Specimen, count: int) -> dict:
    """The direct kernel on all pixels."""
    position, amplitude = specimen.scatterers(count)
    timing = timed(lambda: direct_sum(FreeSpace(), position, amplitude, specimen.grid, specimen.wavelength))
    pairs = count * specimen.grid.size / timing.median
    return asdict(timing) | {"what": f"{pairs / 1e9:.2f} billion pairs a second", "pairs_per_second": pairs}
