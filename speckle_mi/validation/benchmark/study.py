"""What the benchmark measures: sums beside their peers, how frames scale, and everything around the sums."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial

import numpy as np

from ...geometry.plane import PlaneGrid
from ...geometry.pose import Pose
from ...machine.interrupt import scratch_folder
from ...machine.run_times import timed
from .commands import command_times
from .peers import fresnel_sum, numba_sum, numpy_sum

TOLERANCE = 1e-4
RANK_TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)

PEER_SECONDS, QUICK_PEER_SECONDS = 2.0, 0.3
"""A peer sums as many pixels as it manages in about this time, and is scaled to all."""

JUDGED_PAIRS, DIRECT_PAIRS = 20_000_000, 4_000_000_000
PAIRS_SOURCES = 4096

SCENE = """<scene version="3.0.0">
  <default name="point_sources" value="100"/>
  <default name="width" value="744"/> <default name="height" value="480"/>
  <integrator type="coherent"/>
  <emitter type="laser" id="laser">
    <transform name="to_world"><rotate x="1" angle="180"/><translate z="50"/><rotate y="-1" angle="35"/></transform>
    <float name="wavelength" value="632.8"/> <float name="beam_radius" value="0.12"/>
    <float name="wavefront_radius" value="-750"/>
  </emitter>
  <shape type="rough_target" id="target">
    <float name="width" value="4"/> <float name="height" value="4"/> <float name="roughness" value="0.8"/>
    <integer name="point_sources" value="$point_sources"/>
  </shape>
  <sensor type="detector" id="detector">
    <transform name="to_world"><rotate y="1" angle="180"/><translate z="60"/></transform>
    <float name="pixel_pitch" value="0.006"/>
    <film type="hdrfilm"><integer name="width" value="$width"/><integer name="height" value="$height"/></film>
  </sensor>
</scene>
"""
"""The paper's tilted laser (Opt. Eng. 61(6) 061410, 2022, Fig. 5a), as in scenes/tilted_laser.xml."""


@dataclass(frozen=True)
class Entry:
    """One way of summing: seconds (scaled where ``share`` of the pixels, below 1, was summed) and relative L2 error."""

    name: str
    scatterers: int
    seconds: float
    q1: float
    q3: float
    runs: int
    share: float
    error: float | None
    plan: str = ""


@dataclass
class Bench:
    """The assembly and what the measurements on it share."""

    assembly: object
    peer_seconds: float
    quick: bool

    @property
    def grid(self) -> PlaneGrid:
        return self.assembly.detector

    @property
    def wavelength(self) -> float:
        return self.assembly.beam.wavelength

    def scatterers(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Places (count, 3) [mm] and amplitudes of exactly so many scatterers under the beam."""
        from ...scattering.rough_surface import illuminated_scatterers

        lit = illuminated_scatterers(
            self._denser(1.1 * count + 20).target.surface, self.assembly.beam, self.assembly.target.frame
        )
        pick = np.sort(np.random.default_rng(0).permutation(lit.count)[:count])
        return np.ascontiguousarray(lit.position[pick]), lit.amplitude[pick]

    def _denser(self, summed: float):
        """The assembly with about ``summed`` scatterers under the beam, out to where its light ends."""
        target = self.assembly.target
        surface = replace(target.surface, density=summed / self.lit_area)
        return replace(self.assembly, target=replace(target, surface=surface))

    @cached_property
    def lit_area(self) -> float:
        """Area [mm^2] of the target that scatterers are summed from."""
        from ...scattering.rough_surface import illuminated_scatterers

        density, target = 1e5, self.assembly.target
        surface = replace(target.surface, density=density)
        return illuminated_scatterers(surface, self.assembly.beam, target.frame).count / density

    # Sums beside peers

    def sums(self, count: int) -> list[Entry]:
        """Ours and the peers' on the same scatterers; ours first."""
        from ...propagation.coherent_sum import coherent_sum
        from ...propagation.paths import FreeSpace
        from ...propagation.reference import reference_sum

        position, amplitude = self.scatterers(count)
        points = self.grid.points()
        judged = np.random.default_rng(1).integers(len(points), size=int(np.clip(JUDGED_PAIRS // count, 16, 512)))
        exact = reference_sum(FreeSpace(), position, amplitude, points[judged], self.wavelength)

        def error(field: np.ndarray) -> float:
            return float(np.linalg.norm(field.reshape(-1)[judged] - exact) / np.linalg.norm(exact))

        def whole(name: str, work: Callable[[], np.ndarray], plan: str = "") -> Entry:
            timing = timed(work)
            return Entry(name, count, timing.median, timing.q1, timing.q3, timing.runs, 1.0, error(work()), plan)

        def auto() -> np.ndarray:
            return coherent_sum(FreeSpace(), position, amplitude, self.grid, self.wavelength, "auto", TOLERANCE).field

        result = coherent_sum(FreeSpace(), position, amplitude, self.grid, self.wavelength, "auto", TOLERANCE)
        entries = [whole(f"auto {TOLERANCE:.0e}", auto, result.plan)]
        entries.append(self._direct(position, amplitude, error))
        entries.append(self._on_a_part("NumPy float64", numpy_sum, position, amplitude, points, judged, exact))
        compiled = numba_sum()
        if compiled is not None:
            compiled(position[:2], amplitude[:2], points[:2], self.wavelength)
            entries.append(self._on_a_part("numba float64", compiled, position, amplitude, points, judged, exact))
        entries.append(whole("FINUFFT, Fresnel", lambda: fresnel_sum(position, amplitude, self.grid, self.wavelength)))
        return entries

    def _direct(self, position: np.ndarray, amplitude: np.ndarray, error: Callable[[np.ndarray], float]) -> Entry:
        """The direct kernel, on a part of the rows where all of them would take long (its error is then not judged)."""
        from ...propagation.paths import FreeSpace
        from ...propagation.direct import direct_sum

        rows, columns = self.grid.shape
        some = int(np.clip(DIRECT_PAIRS // (len(position) * columns), 1, rows))
        part = replace(self.grid, shape=(some, columns))

        def work() -> np.ndarray:
            return direct_sum(FreeSpace(), position, amplitude, part, self.wavelength)

        timing, scale = timed(work), rows / some
        judged = error(work()) if some == rows else None
        times = (scale * timing.median, scale * timing.q1, scale * timing.q3)
        return Entry("direct", len(position), *times, timing.runs, 1 / scale, judged)

    def _on_a_part(self, name, work, position, amplitude, points, judged, exact) -> Entry:
        """A peer on as many pixels as it manages in its time, scaled to all of them."""
        count = len(judged)
        begin = time.perf_counter()
        found = work(position, amplitude, points[judged], self.wavelength)
        rate = count / (time.perf_counter() - begin)
        number = int(np.clip(rate * self.peer_seconds, count, len(points)))
        some = points if number == len(points) else points[:: max(1, len(points) // number)]
        if len(some) < 2 * count:
            some = points[judged]
        timing = timed(lambda: work(position, amplitude, some, self.wavelength), runs=3, seconds=self.peer_seconds)
        scale = len(points) / len(some)
        error = float(np.linalg.norm(found - exact) / np.linalg.norm(exact))
        return Entry(
            name,
            len(position),
            scale * timing.median,
            scale * timing.q1,
            scale * timing.q3,
            timing.runs,
            1 / scale,
            error,
        )

    # Scaling

    def scaling(self, counts: Sequence[int]) -> dict:
        """Ours with more scatterers (whole frames), with four times the pixels, and against the expansion's rank."""
        from ...propagation.coherent_sum import coherent_sum
        from ...propagation.paths import FreeSpace
        from ...field.simulation import simulate_frame

        frames = {}
        for count in counts:
            assembly = self._denser(count)
            frames[count] = asdict(timed(lambda assembly=assembly: simulate_frame(assembly, Pose())))
        count = min(100_000, counts[-1])
        position, amplitude = self.scatterers(count)

        def seconds(grid: PlaneGrid, tolerance: float = TOLERANCE) -> tuple[float, object]:
            def work():
                return coherent_sum(FreeSpace(), position, amplitude, grid, self.wavelength, "auto", tolerance)

            return timed(work).median, work()

        grid, (rows, columns) = self.grid, self.grid.shape
        finer = replace(
            grid,
            pitch=grid.pitch / 2,
            origin=grid.origin - grid.pitch / 4 * (grid.u + grid.v),
            shape=(2 * rows, 2 * columns),
        )
        corner = grid.origin - grid.pitch / 2 * (columns * grid.u + rows * grid.v)
        larger = replace(grid, origin=corner, shape=(2 * rows, 2 * columns))
        base = seconds(grid)[0]
        ranks = []
        for tolerance in RANK_TOLERANCES:
            spent, result = seconds(grid, tolerance)
            found = re.search(r"rank (\d+)", result.plan)
            ranks.append({"tolerance": tolerance, "rank": int(found.group(1)) if found else None, "seconds": spent,
                          "error": result.numerical_error, "plan": result.plan})  # fmt: skip
        return {
            "frames": frames, "scatterers": count, "seconds": base,
            "pixels_x4_finer": seconds(finer)[0], "pixels_x4_larger": seconds(larger)[0], "rank": ranks,
        }  # fmt: skip

    # What the choice between the sums rests on

    def costs(self) -> dict[str, dict[str, float]]:
        """Name of a cost -> {recorded, measured} [s]: what decides how a field is summed, and what it takes here."""
        from ...propagation.phasors import active_variant
        from ...propagation.costs import RECORDED, measured_costs

        recorded, measured = asdict(RECORDED), asdict(measured_costs(active_variant()))
        return {name: {"recorded": recorded[name], "measured": measured[name]} for name in recorded}

    # What is around the sums

    def pieces(self) -> dict[str, dict]:
        """Name -> {seconds, what}: kernel, correlation, writing, scatterers, warm start."""
        from ...measurement.correlator import Correlator
        from ...images.exr import write_field
        from ...propagation.paths import FreeSpace
        from ...propagation.direct import direct_sum
        from ...field.simulation import simulate
        from ...scattering.rough_surface import illuminated_scatterers

        found: dict[str, dict] = {}
        position, amplitude = self.scatterers(PAIRS_SOURCES // (8 if self.quick else 1))
        kernel = timed(lambda: direct_sum(FreeSpace(), position, amplitude, self.grid, self.wavelength))
        pairs = len(position) * self.grid.size / kernel.median
        found["direct kernel"] = asdict(kernel) | {
            "what": f"{pairs / 1e9:.2f} billion pairs a second",
            "pairs_per_second": pairs,
        }
        rest, moved = (simulate(self.assembly, Pose(x=x)) for x in (0.0, 0.012))
        correlator = Correlator(rest.intensity)
        size = "{1} x {0}".format(*self.grid.shape)
        found["correlation of a frame"] = asdict(timed(lambda: correlator.shift(moved.intensity))) | {
            "what": f"{size}, window {correlator.window}"
        }
        with scratch_folder() as folder:
            path = folder / "frame.exr"
            found["EXR writing"] = asdict(timed(lambda: write_field(path, rest))) | {"what": f"{size}, three channels"}
            found |= command_times(folder, SCENE, self.grid.shape, self.quick)
        for count in (1_000,) if self.quick else (100_000, 1_000_000):
            target = self._denser(count).target
            place = partial(illuminated_scatterers, target.surface, self.assembly.beam, target.frame)
            timing = timed(place)
            found[f"scatterers, {count:,}"] = asdict(timing) | {"what": "places, heights, illumination"}
        return found
