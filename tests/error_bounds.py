"""Whether the stated ``numerical_error`` is a bound, over random renders.

    python tests/error_bounds.py [FIRST:LAST]

Point sources in a patch, seen in free space, through a lens, or through a lens and a stop; spans, distances, counts,
pixels and tolerances are drawn at random. The truth is, in free space, the plain float64 sum over all pairs, and with a
lens the same scene at ``direct`` and a tolerance of 1e-7. What a plan leaves out, the wave of an edge that the light is
clear of, is missing in both: it is bounded and not known, so that what the sums state is compared alone.

The sum to a stop is judged where it sends light to the detector: of draws 137 to 287 the 51 behind a stop state 1.37 to
3.09 times the true error, one of them more than three times, and one (272) 0.99 times.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from exact_optics import bench, element_xml, tilted
from scene_builder import detector_frame, direction

from speckle_mi.field.simulation import simulate_frame
from speckle_mi.geometry.frames import Frame
from speckle_mi.plan.stage import SUM
from speckle_mi.propagation.paths import FreeSpace
from speckle_mi.propagation.reference import reference_sum

WAVELENGTH = 632.8e-6
FREE, LENS, STOPPED = "free space", "lens", "lens and stop"
KINDS = FREE, LENS, STOPPED
RENDERS = 135
TIGHTEST = 1e-7
"""Of the truth behind a lens: a hundredth of the smallest tolerance drawn."""


@dataclass(frozen=True)
class Outcome:
    """kind of scene; tolerance asked for; stated: of the sums; true: relative L2 error of the field."""

    kind: str
    tolerance: float
    stated: float
    true: float

    @property
    def ratio(self) -> float:
        """Stated over true."""
        return self.stated / self.true


def scene(kind: str, random: np.random.Generator, folder: Path, tolerance: float, method: str) -> str:
    """The scene of one draw; what is drawn does not depend on the last two."""
    count, span = int(10 ** random.uniform(1.5, 2.7)), 10 ** random.uniform(-1.5, 0.0 if kind == FREE else -0.5)
    sources = np.c_[random.uniform(-span, span, (count, 2)), random.uniform(-0.02, 0.02, count)]
    pixels, pitch = tuple(random.integers(12, 36, 2)), 10 ** random.uniform(-2.5, -1.5)
    place = random.uniform(-2.0, 2.0, 2)
    if kind == FREE:
        z, elements = random.uniform(15.0, 90.0), []
    else:
        at, focal = random.uniform(25.0, 40.0), random.uniform(18.0, 60.0)
        form = dict(radius1=focal, radius2=-focal, thickness=4.0, diameter=14.0, ior=1.5)
        axes = tilted(*random.uniform(-3.0, 3.0, 3))
        elements = [element_xml("lens", "lens", Frame(np.array([0.0, 0.0, at]), axes), **form)]
        radius = random.uniform(0.5, 1.5)
        if kind == STOPPED:
            frame = Frame(np.array([0.0, 0.0, at + 6.0]), np.eye(3))
            elements.append(element_xml("aperture", "stop", frame, radius=radius, outer_radius=15.0))
        z, place = at + random.uniform(7.0, 12.0), 0.3 * place
    axes = tilted(*random.uniform(-8.0, 8.0, 3)) @ detector_frame(direction(0), 1.0).axes
    detector = Frame(np.array([*place, z]), axes)
    return bench(folder, sources, detector, elements, pixels=pixels, pitch=pitch, tolerance=tolerance, method=method,
                 diffraction=kind == STOPPED)  # fmt: skip


def outcome(number: int, assemble, folder: Path) -> Outcome:
    """One render of the series; assemble: the text of a scene -> its assembly."""
    kind = KINDS[number % len(KINDS)]
    tolerance = 10 ** np.random.default_rng([number, 1]).uniform(-5.0, -2.0)

    def frame(tolerance: float, method: str):
        assembly = assemble(scene(kind, np.random.default_rng(number), folder, tolerance, method))
        return assembly, simulate_frame(assembly)

    assembly, made = frame(tolerance, ("auto", "fast")[number // len(KINDS) % 2])
    if kind == FREE:
        weights, points = made.scatterers.amplitude, assembly.detector.points()
        exact = reference_sum(FreeSpace(), made.scatterers.position, weights, points, WAVELENGTH)
    else:
        exact = frame(TIGHTEST, "direct")[1].image.field.ravel()
    true = np.linalg.norm(made.image.field.ravel() - exact) / np.linalg.norm(exact)
    stated = np.linalg.norm([stage.error for stage in made.stages if stage.kind == SUM])
    assert stated <= made.numerical_error * (1 + 1e-9)
    return Outcome(kind, tolerance, float(stated), float(true))


def main() -> None:
    import mitsuba as mi

    from speckle_mi.machine.backend import DEFAULT_VARIANT, set_variant
    from speckle_mi.scene.read import assembly_from_scene

    set_variant(DEFAULT_VARIANT)
    mi.set_log_level(mi.LogLevel.Error)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        first, last = map(int, sys.argv[1].split(":")) if len(sys.argv) > 1 else (0, RENDERS)
        for number in range(first, last):
            found.append(outcome(number, lambda text: assembly_from_scene(mi.load_string(text)), Path(folder)))
            one = found[-1]
            print(f"{number:4d} {one.kind:14s} {one.tolerance:.1e} stated {one.stated:.2e} true {one.true:.2e}"
                  f" ratio {one.ratio:.2f}", flush=True)  # fmt: skip
    ratios = np.array([one.ratio for one in found])
    print(f"{len(found)} renders: {np.sum(ratios < 1)} true errors above the stated one (worst {1 / ratios.min():.2f}"
          f" times), {np.sum(ratios > 3)} stated more than 3 times above (worst {ratios.max():.2f})")  # fmt: skip


if __name__ == "__main__":
    main()
