"""Whole commands timed by the benchmark, in processes of their own: seconds from start to end, and peak memory."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ...machine.run_times import Timing

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


def command_times(folder: Path, scene_xml: str, shape: tuple[int, int], quick: bool) -> dict[str, dict]:
    """Whole commands on a scene, a file in ``folder``, from start to end; the first render warms the kernel cache.

    shape: (rows, columns) of the detector, where the scene's is not asked for.
    """
    scene = folder / "tilted_laser.xml"
    scene.write_text(scene_xml, encoding="utf-8")
    small = ["-D", f"width={shape[1]}", "-D", f"height={shape[0]}"]
    render = ["render", str(scene), "-o", str(folder / "frame.exr"), "--quiet", "--force"]
    runs = [seconds_and_memory([*render, *small])[0] for _ in range(2 if quick else 4)]
    warm = runs[1:]
    timing = Timing(float(np.median(warm)), min(warm), max(warm), len(warm), runs[0])
    found = {"start-up and one frame, warm": asdict(timing) | {"what": "python -m speckle_mi.render"}}
    if quick:
        return found
    # Out to where its light ends, the beam lights nine times the area that point_sources are counted in.
    many = ["-D", "point_sources=11100"]
    sweep = ["sweep", str(scene), "--out", str(folder / "sweep"), "--seeds", "1", "--quiet", *many]
    seconds, memory = seconds_and_memory(sweep)
    found["sweep, 61 frames"] = single(seconds, memory, "of 100,000 scatterers each, cold start")
    large = ["-D", "point_sources=111000", "-D", "width=2000", "-D", "height=2000"]
    seconds, memory = seconds_and_memory([*render, *large])
    found["render, 4 million pixels"] = single(seconds, memory, "of 1,000,000 scatterers, cold start")
    return found


def single(seconds: float, memory: float | None, what: str) -> dict:
    """An entry of the benchmark that was measured once."""
    peak = "" if memory is None else f", peak {memory:.0f} MB"
    timing = Timing(seconds, seconds, seconds, 1, seconds)
    return asdict(timing) | {"what": what + peak, "peak_memory_mb": memory}


def seconds_and_memory(arguments: list[str]) -> tuple[float, float | None]:
    """Seconds and peak memory [MB] (None where the system does not tell) of ``python -m speckle_mi.<arguments>``."""
    line = [sys.executable, "-m", f"speckle_mi.{arguments[0]}", *arguments[1:]]
    done = subprocess.run([sys.executable, "-c", _MEASURING, *line], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"speckle_mi.{arguments[0]} failed: {done.stderr.strip()}")
    seconds, memory = map(float, done.stdout.split())
    return seconds, None if np.isnan(memory) else memory
