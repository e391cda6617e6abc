"""Random scenes whose derivative fields are compared with central differences of rendered fields.

Elements come from the benches of ``random_ways``; between them stand scenes of free space with everything tilted, on a
patch and on the user's own points, some with a lobe. ``python tests/derivative_scenes.py`` judges all of them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import random_ways  # noqa: E402
from scene_builder import direction, free_space  # noqa: E402

COUNT = 66
"""Scenes that are judged by the command, some sixty: a few are refused by any frame, or take too long."""

LONGEST = 20.0
"""Seconds that a frame may be expected to take; a comparison takes fifty."""

SEED = 20240711
DERIVATIVE_TOLERANCE = 1e-3
"""Relative L2 difference allowed between a derivative field and central differences."""

AGREEMENT, HALVINGS = 3e-4, 3
"""Two differences agree, relative L2, and how often the step is halved until they do."""

EXACT, RENDERED = (1e-7, 4e-3), (1e-6, 2e-2)
"""Tolerance of fields, and phase [rad] by which the outermost scatterer is moved at first: in free space, where a sum
in double precision is cheap, and behind elements."""

CLUSTER = 0.01
"""Size [mm] of the cluster of sources where there are elements."""


def scene_text(number: int, folder: Path) -> str:
    """The text of a scene: every third one is free space, the others have elements."""
    rng = np.random.default_rng([SEED, number])
    if number % 3:
        path = random_ways.scene(number).write(folder)
        # One source there has a cluster of others around it here: what all have in common is easy.
        source = np.loadtxt(folder / "points.csv", delimiter=",", ndmin=2)[:1]
        cluster = source + CLUSTER * np.vstack([np.zeros(3), rng.normal(size=(11, 3)) * [1, 1, 0.05]])
        np.savetxt(folder / "points.csv", cluster, delimiter=",", fmt="%.17g")
        return path.read_text().replace('value="points.csv"', f'value="{folder / "points.csv"}"')
    tilt = np.linalg.qr(np.eye(3) + 0.15 * rng.normal(size=(3, 3)))[0]
    tilt *= np.sign(np.diag(tilt))
    return free_space(
        direction(*rng.uniform(-50, 50, 2)),
        direction(*rng.uniform(-50, 50, 2)),
        laser_distance=rng.uniform(20, 200),
        detector_distance=rng.uniform(10, 200),
        tilt=tilt if np.linalg.det(tilt) > 0 else None,
        laser={"beam_radius": rng.uniform(0.05, 0.5), "wavefront_radius": rng.choice([-750.0, 30.0, 200.0])},
        target={"point_sources": 60, "roughness": rng.uniform(0.1, 2)},
        detector={"width": 24, "height": 18, "pixel_pitch": rng.uniform(0.005, 0.1)},
    )


def pixels_of(assembly) -> np.ndarray:
    return np.arange(0, assembly.detector.size, 7)


def central(field_at, start: float) -> np.ndarray:
    """Central difference of ``field_at`` (step -> (m,)) with the step halved until it agrees with the last."""
    previous, step = None, start
    for _ in range(HALVINGS):
        found = (field_at(step) - field_at(-step)) / (2 * step)
        if previous is not None and np.linalg.norm(found - previous) <= AGREEMENT * np.linalg.norm(found):
            return found
        previous, step = found, step / 2
    return found


def compared(assembly) -> dict[str, float]:
    """Relative L2 difference of every derivative field from central differences of fields rendered more finely."""
    from speckle_mi import Pose, Simulation
    from speckle_mi.geometry.motion import Motion
    from speckle_mi.geometry.pose import DEGREES_OF_FREEDOM

    pixels, wavenumber = pixels_of(assembly), assembly.beam.wavenumber
    found = Simulation(assembly).derivatives(pixels)
    tolerance, phase = RENDERED if assembly.elements else EXACT
    exact = Simulation(assembly.with_options(tolerance=tolerance))
    scatterers = exact.frame(Pose()).scatterers
    light = assembly.beam.field(scatterers.position)
    differences = {"field": _difference(found.field, exact.field_of(scatterers, Pose()).ravel()[pixels])}
    for number, dof in enumerate(DEGREES_OF_FREEDOM):
        motion = Motion.of(dof, assembly.target.frame)

        def field_at(step: float) -> np.ndarray:
            places = motion.moved(scatterers.position, step)
            amplitude = scatterers.amplitude * assembly.beam.field(places) / light
            normal = motion.turned(scatterers.normal[:1], step)
            moved = replace(
                scatterers, position=places, amplitude=amplitude,
                normal=np.broadcast_to(normal, places.shape) if scatterers.on_plane
                else motion.turned(scatterers.normal, step),
            )  # fmt: skip
            return exact.field_of(moved, Pose()).ravel()[pixels]

        fastest = np.linalg.norm(motion.velocity(scatterers.position), axis=1).max()
        step = phase / (2 * wavenumber * fastest)
        differences[dof] = _difference(found.by_motion[number], central(field_at, step))
    grid = assembly.detector
    for number, axis in enumerate("uv"):

        def beside(step: float) -> np.ndarray:
            shifted = replace(grid, origin=grid.origin + step * getattr(grid, axis))
            there = Simulation(replace(exact.assembly, detector=shifted))
            return there.field_of(scatterers, Pose()).ravel()[pixels]

        differences[axis] = _difference(found.along[number], central(beside, phase / wavenumber))
    return differences


def _difference(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / max(np.linalg.norm(expected), 1e-300))


def judged(number: int) -> dict[str, float]:
    """:func:`compared` for a scene."""
    import mitsuba

    from speckle_mi import Pose, Simulation
    from speckle_mi.scene.read import assembly_from_scene

    with tempfile.TemporaryDirectory() as folder:
        assembly = assembly_from_scene(mitsuba.load_string(scene_text(number, Path(folder))))
        seconds = Simulation(assembly).cost(Pose()).seconds
        if seconds > LONGEST:
            raise RuntimeError(f"a frame is expected to take {seconds:.0f} s")
        return compared(assembly)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--numbers", metavar="A:B", default=f"0:{COUNT}", help="only these scenes")
    options = parser.parse_args(arguments)
    import mitsuba

    from speckle_mi.machine.backend import set_variant

    set_variant()
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    first, last = (int(part) for part in options.numbers.split(":"))
    wrong = 0
    for number in range(first, last):
        began = time.perf_counter()
        kind = random_ways.kind_of(number) if number % 3 else "free space"
        try:
            differences = judged(number)
        except (ValueError, RuntimeError) as refusal:
            print(f"{number:3d} {kind:20s} refused: {' '.join(str(refusal).split())[:150]}", flush=True)
            continue
        worst = max(differences, key=differences.get)
        wrong += differences[worst] > DERIVATIVE_TOLERANCE
        print(f"{number:3d} {kind:20s} worst {worst:5s} {differences[worst]:.1e}  "
              f"{time.perf_counter() - began:5.1f} s", flush=True)  # fmt: skip
    print(f"{wrong} of {last - first} beyond {DERIVATIVE_TOLERANCE:g}")
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
