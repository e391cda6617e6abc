"""``python -m speckle_mi.benchmark``: how fast the sums are, beside peers measured in the same run.

    python -m speckle_mi.benchmark [--quick] [--out FILE.json]

The paper's tilted laser (744 x 480 pixels of 6 um at 60 mm, beam radius 0.12 mm). Ours: the coherent sum ``auto`` at
1e-4 and ``direct``. Peers: the float64 sum vectorised in NumPy, the same compiled by numba on all cores (if numba is
installed), and FINUFFT used plainly with the Fresnel approximation. A peer that would take too long sums a part of the
pixels and is scaled up, which the table marks. Times are medians of warm runs, errors relative L2 against the float64
sum on sampled pixels.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from .cli import add_force, command, parser, say
from .files import identity_in, refuse_other_settings, require_output, write_json
from .geometry import PlaneGrid, Pose
from .interrupt import scratch_folder

SCATTERERS, QUICK_SCATTERERS = (100, 1_000, 10_000, 100_000, 1_000_000), (100, 1_000)
PIXELS, QUICK_PIXELS = (744, 480), (186, 120)
TOLERANCE = 1e-4
RANK_TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)

PEER_SECONDS, QUICK_PEER_SECONDS = 2.0, 0.3
"""A peer sums as many pixels as it manages in about this time, and is scaled to all."""

RUNS, RUN_SECONDS = 9, 2.0
"""Warm runs, fewer (at least three) where they take longer than this together."""

JUDGED_PAIRS, DIRECT_PAIRS = 20_000_000, 4_000_000_000
PAIRS_SOURCES = 4096
FRESNEL_EPS = 1e-6
"""What FINUFFT is asked for: its own error then hides behind the approximation's."""

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
class Timing:
    """Seconds of warm runs: median and quartiles; first: of the first run, which may compile."""

    median: float
    q1: float
    q3: float
    runs: int
    first: float


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


def timed(work: Callable[[], object], runs: int = RUNS, seconds: float = RUN_SECONDS) -> Timing:
    """Median and quartiles of warm runs of ``work``."""
    begin = time.perf_counter()
    work()
    first = time.perf_counter() - begin
    times: list[float] = []
    while len(times) < runs and (len(times) < 3 or sum(times) < seconds):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    median, q1, q3 = (float(value) for value in np.quantile(times, (0.5, 0.25, 0.75)))
    return Timing(median, q1, q3, len(times), first)


# Peers


def numpy_sum(position: np.ndarray, amplitude: np.ndarray, points: np.ndarray, wavelength: float) -> np.ndarray:
    """sum_j c_j e^{ikr}/r at points (m, 3) in float64, vectorised over thousands of pairs at a time."""
    wavenumber = 2 * np.pi / wavelength
    field = np.zeros(len(points), dtype=np.complex128)
    step = max(1, (1 << 20) // min(len(position), 4096))
    for first in range(0, len(points), step):
        some = points[first : first + step]
        for start in range(0, len(position), 4096):
            chunk = slice(start, start + 4096)
            r = np.sqrt(sum(np.subtract.outer(position[chunk, axis], some[:, axis]) ** 2 for axis in range(3)))
            field[first : first + step] += amplitude[chunk] @ (np.exp(1j * wavenumber * r) / r)
    return field


def numba_sum() -> Callable[..., np.ndarray] | None:
    """The same double loop compiled by numba, pixels on all cores, fastmath off; None without numba."""
    try:
        import numba
    except ImportError:
        return None

    @numba.njit(parallel=True, fastmath=False)
    def summed(position, amplitude, points, wavelength):
        wavenumber = 2 * np.pi / wavelength
        field = np.empty(len(points), dtype=np.complex128)
        for m in numba.prange(len(points)):
            x, y, z = points[m]
            real = imaginary = 0.0
            for j in range(len(position)):
                dx, dy, dz = x - position[j, 0], y - position[j, 1], z - position[j, 2]
                r = np.sqrt(dx * dx + dy * dy + dz * dz)
                cosine, sine = np.cos(wavenumber * r) / r, np.sin(wavenumber * r) / r
                a, b = amplitude[j].real, amplitude[j].imag
                real += a * cosine - b * sine
                imaginary += a * sine + b * cosine
            field[m] = complex(real, imaginary)
        return field

    return summed


def fresnel_sum(position: np.ndarray, amplitude: np.ndarray, grid: PlaneGrid, wavelength: float) -> np.ndarray:
    """The Fresnel approximation by one type-1 NUFFT onto the pixel grid, (rows, columns).

    r = L - z + (X^2 + Y^2)/(2L) - (X x + Y y)/L + (x^2 + y^2)/(2L), with x, y, z the scatterer's place along u, v and
    towards the detector, X, Y the pixel's, L the distance; the amplitude 1/L. Good far away and near the axis.
    """
    import finufft

    k = 2 * np.pi / wavelength
    rows, columns = grid.shape
    foot = grid.centre - position.mean(axis=0)
    distance = abs(float(foot @ grid.normal))
    towards = grid.normal * np.sign(foot @ grid.normal)
    origin = grid.centre - distance * towards
    x, y, z = ((position - origin) @ axis for axis in (grid.u, grid.v, towards))
    # finufft's mode numbers run from -n/2 (rounded down): the pixel they stand on, not the middle, is the origin.
    middle_x, middle_y = (0.5 * grid.pitch if n % 2 == 0 else 0.0 for n in (columns, rows))
    weights = amplitude * np.exp(
        1j * k * ((x * x + y * y) / (2 * distance) - z - (middle_x * x + middle_y * y) / distance)
    )
    rate = k * grid.pitch / distance
    wrapped = [np.mod(rate * value + np.pi, 2 * np.pi) - np.pi for value in (y, x)]
    sums = finufft.nufft2d1(*wrapped, weights, (rows, columns), isign=-1, eps=FRESNEL_EPS)
    across = (grid.columns - grid.columns[-1] / 2) ** 2 + ((grid.rows - grid.rows[-1] / 2) ** 2)[:, None]
    return sums * np.exp(1j * k * (distance + across / (2 * distance))) / distance


# The measurements


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
        from .surface import illuminated_scatterers

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
        from .surface import illuminated_scatterers

        density, target = 1e5, self.assembly.target
        surface = replace(target.surface, density=density)
        return illuminated_scatterers(surface, self.assembly.beam, target.frame).count / density

    # Sums beside peers

    def sums(self, count: int) -> list[Entry]:
        """Ours and the peers' on the same scatterers; ours first."""
        from .propagation import FreeSpace, coherent_sum
        from .propagation.reference import reference_sum

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
        from .propagation import FreeSpace
        from .propagation.direct import direct_sum

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
        from .propagation import FreeSpace, coherent_sum
        from .simulate import simulate_frame

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

    # What is around the sums

    def pieces(self) -> dict[str, dict]:
        """Name -> {seconds, what}: kernel, correlation, writing, scatterers, warm start."""
        from .correlate import Correlator
        from .exr import write_field
        from .propagation import FreeSpace
        from .propagation.direct import direct_sum
        from .simulate import simulate
        from .surface import illuminated_scatterers

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
            found |= self._commands(folder)
        for count in (1_000,) if self.quick else (100_000, 1_000_000):
            target = self._denser(count).target
            place = partial(illuminated_scatterers, target.surface, self.assembly.beam, target.frame)
            timing = timed(place)
            found[f"scatterers, {count:,}"] = asdict(timing) | {"what": "places, heights, illumination"}
        return found

    def _commands(self, folder: Path) -> dict[str, dict]:
        """Whole commands in processes of their own, from start to end; the first render warms the kernel cache."""
        scene = folder / "tilted_laser.xml"
        scene.write_text(SCENE, encoding="utf-8")
        small = ["-D", f"width={self.grid.shape[1]}", "-D", f"height={self.grid.shape[0]}"]
        render = ["render", str(scene), "-o", str(folder / "f.exr"), "--quiet", *small]
        runs = [_command(render)[0] for _ in range(2 if self.quick else 4)]
        warm = runs[1:]
        found = {"start-up and one frame, warm": {"median": float(np.median(warm)), "q1": min(warm), "q3": max(warm),
                 "runs": len(warm), "first": runs[0], "what": "python -m speckle_mi.render"}}  # fmt: skip
        if self.quick:
            return found
        # Out to where its light ends, the beam lights nine times the area that point_sources are counted in.
        sweep = [
            "sweep",
            str(scene),
            "--out",
            str(folder / "sweep"),
            "--seeds",
            "1",
            "--quiet",
            "-D",
            "point_sources=11100",
        ]
        seconds, memory = _command(sweep)
        found["sweep, 61 frames"] = _single(seconds, memory, "of 100,000 scatterers each, cold start")
        large = ["-D", "point_sources=111000", "-D", "width=2000", "-D", "height=2000"]
        seconds, memory = _command([*render[:5], *large])
        found["render, 4 million pixels"] = _single(seconds, memory, "of 1,000,000 scatterers, cold start")
        return found


def _single(seconds: float, memory: float | None, what: str) -> dict:
    peak = "" if memory is None else f", peak {memory:.0f} MB"
    return {
        "median": seconds,
        "q1": seconds,
        "q3": seconds,
        "runs": 1,
        "first": seconds,
        "what": what + peak,
        "peak_memory_mb": memory,
    }


_MEASURING = """
import subprocess, sys, time
begin = time.perf_counter()
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
seconds = time.perf_counter() - begin
try:
    import resource
    print(seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)
except ImportError:
    print(seconds, "nan")
sys.exit(done.returncode)
"""
"""Runs a command from a small process: the peak memory that the system tells of one includes its parent's size."""


def _command(arguments: list[str]) -> tuple[float, float | None]:
    """Seconds and peak memory [MB] (None where the system does not tell) of ``python -m speckle_mi.<arguments>``."""
    line = [sys.executable, "-m", f"speckle_mi.{arguments[0]}", *arguments[1:]]
    done = subprocess.run([sys.executable, "-c", _MEASURING, *line], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"speckle_mi.{arguments[0]} failed: {done.stderr.strip()}")
    seconds, memory = map(float, done.stdout.split())
    return seconds, None if np.isnan(memory) else memory


def main(arguments: Sequence[str] | None = None) -> None:
    from .backend import DEFAULT_VARIANT

    made = parser("benchmark", "Measures speed and error beside peers, in one run.")
    made.add_argument("--out", metavar="FILE.json", help="also write the figures as JSON")
    made.add_argument(
        "--quick", action="store_true", help="few scatterers, few pixels: does it work, not how fast is it"
    )
    add_force(made)
    made.add_argument("--variant", default=DEFAULT_VARIANT, help="Mitsuba variant (default: %(default)s)")
    options = made.parse_args(arguments)
    identity = {"quick": options.quick, "variant": options.variant}
    if options.out:
        require_output(options.out)
        refuse_other_settings(options.out, identity_in(options.out), identity, options.force)
    bench = Bench(_assembly(options), QUICK_PEER_SECONDS if options.quick else PEER_SECONDS, options.quick)
    counts = QUICK_SCATTERERS if options.quick else SCATTERERS
    from .sysinfo import system_information

    begin = time.perf_counter()
    console = _console(options.quiet)
    system = system_information() | {"numba": _numba_version()}
    names = ("processor", "cores", "system", "speckle_mi", "python", "mitsuba", "drjit", "numpy", "finufft", "numba",
             "LLVM")  # fmt: skip
    console.print("machine: " + ", ".join(f"{name} {system[name]}" for name in names if name in system), markup=False)
    # Every part is shown and kept when it is done: an interrupt loses no more than the part it falls into.
    content = {"identity": identity, "pixels": list(bench.grid.shape[::-1]), "tolerance": TOLERANCE, "system": system}

    def keep(name: str, figures: object) -> None:
        content[name] = figures
        if options.out:
            write_json(options.out, content)

    entries: list[Entry] = []
    for count in counts:
        say(options, f"sums of {count:,} scatterers ...")
        entries += bench.sums(count)
        keep("sums", [asdict(entry) for entry in entries])
    _print_sums(console, bench, entries)
    say(options, "scaling ...")
    scaling = bench.scaling(counts)
    keep("scaling", scaling)
    _print_scaling(console, scaling)
    say(options, "everything around the sums ...")
    pieces = bench.pieces()
    keep("pieces", pieces)
    _print_pieces(console, pieces)
    say(options, f"{time.perf_counter() - begin:.0f} s in all")


def _assembly(options):
    """The tilted laser, on few pixels if it is to be quick."""
    import mitsuba as mi

    from .assembly import assembly_from_scene
    from .backend import set_variant

    set_variant(options.variant)
    mi.set_log_level(mi.LogLevel.Error)
    width, height = QUICK_PIXELS if options.quick else PIXELS
    return assembly_from_scene(mi.load_string(SCENE, width=str(width), height=str(height)))


def _numba_version() -> str:
    try:
        import numba
    except ImportError:
        return "not installed"
    return numba.__version__


# Words


def _console(quiet: bool):
    from rich.console import Console

    return Console(width=None if os.isatty(1) else 130, highlight=False, quiet=quiet)


def _print_sums(console, bench: Bench, entries: list[Entry]) -> None:
    console.print(_sums_table(bench, entries))
    console.print(
        "~ summed on a part of the pixels and scaled up. Errors: relative L2 against the float64 sum on sampled pixels."
    )


def _print_pieces(console, pieces: dict[str, dict]) -> None:
    table = _table("Around the sums", ("what", "median", "quartiles", "first", ""), left=(0, 4))
    for name, piece in pieces.items():
        quartiles = _between(piece["q1"], piece["q3"]) if piece["runs"] > 1 else ""
        table.add_row(name, _duration(piece["median"]), quartiles, _duration(piece["first"]), piece["what"])
    console.print(table)


def _sums_table(bench: Bench, entries: list[Entry]):
    """Every way of summing; the ratio says how many times longer than ours, ``auto``, it takes."""
    rows, columns = bench.grid.shape
    heads = ("scatterers", "method", "time", "quartiles", "ours faster by", "error", "how")
    table = _table(f"Coherent sum on {columns} x {rows} pixels", heads, left=(1, 6))
    ours = {entry.scatterers: entry.seconds for entry in entries if entry.name.startswith("auto")}
    for number, entry in enumerate(entries):
        mark = "" if entry.share == 1 else "~"
        ratio = "" if entry.name.startswith("auto") else f"{mark}{entry.seconds / ours[entry.scatterers]:,.3g}"
        ends = number + 1 == len(entries) or entries[number + 1].scatterers != entry.scatterers
        table.add_row(
            f"{entry.scatterers:,}", entry.name, mark + _duration(entry.seconds), _between(entry.q1, entry.q3),
            ratio, "" if entry.error is None else f"{entry.error:.1e}", entry.plan.split(" (")[0], end_section=ends,
        )  # fmt: skip
    return table


def _print_scaling(console, scaling: dict) -> None:
    table = _table(
        "Whole frames: scatterers, sum, intensity",
        ("scatterers", "time", "quartiles", "first", "of the one before"),
        left=(),
    )
    before = None
    for count, timing in scaling["frames"].items():
        growth = "" if before is None else f"{timing['median'] / before:.2f}"
        table.add_row(f"{count:,}", _duration(timing["median"]), _between(timing["q1"], timing["q3"]),
                      _duration(timing["first"]), growth)  # fmt: skip
        before = timing["median"]
    console.print(table)
    base = scaling["seconds"]
    console.print(
        f"four times the pixels, {scaling['scatterers']:,} scatterers: "
        f"{scaling['pixels_x4_finer'] / base:.2f} times the time for "
        f"finer ones, {scaling['pixels_x4_larger'] / base:.2f} for a larger detector"
    )
    table = _table(
        f"Time against rank, {scaling['scatterers']:,} scatterers",
        ("tolerance", "rank", "time", "error", "how"),
        left=(4,),
    )
    for entry in scaling["rank"]:
        rank = "-" if entry["rank"] is None else str(entry["rank"])
        table.add_row(f"{entry['tolerance']:.0e}", rank, _duration(entry["seconds"]),
                      f"{entry['error']:.1e}", entry["plan"].split(" (")[0])  # fmt: skip
    console.print(table)


def _table(title: str, heads: Sequence[str], left: Sequence[int]):
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left")
    for number, head in enumerate(heads):
        table.add_column(head, justify="left" if number in left else "right")
    return table


def _between(low: float, high: float) -> str:
    return f"{_duration(low)} - {_duration(high)}"


def _duration(seconds: float) -> str:
    if seconds < 1e-3:
        return f"{1e6 * seconds:.3g} us"
    if seconds < 1:
        return f"{1e3 * seconds:.3g} ms"
    return (
        f"{seconds:.3g} s"
        if seconds < 100
        else f"{seconds / 60:.3g} min"
        if seconds < 6000
        else f"{seconds / 3600:.3g} h"
    )


if __name__ == "__main__":
    raise SystemExit(command(main))
