"""Kills a sweep at random instants and goes on with it until it is done; then compares it with one that was let be.

    python tests/kill_and_resume.py [--kills 20] [--scheduler local:2]

Prints what every kill left and ends with status 1 where a row differs, more than the frames in flight were made again,
or a fragment is left.
"""

from __future__ import annotations

import argparse
import csv
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCENE = Path(__file__).resolve().parent.parent / "scenes" / "tilted_laser.xml"
SWEEP = ["--steps", "4", "-D", "width=96", "-D", "height=96", "-D", "beam_radius=0.3", "--quiet"]
"""25 frames a surface of 96 x 96 pixels."""

IN_FLIGHT = 16
"""Frames that may be made or written when a kill comes: two a thread, eight that wait to be written."""


def started(out: Path, *more: str) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-m", "speckle_mi.sweep", str(SCENE), *SWEEP, "--out", str(out), *more])


def rows(out: Path) -> list[dict]:
    with open(out / "sweep.csv", newline="", encoding="utf-8") as file:
        return [{name: value for name, value in row.items() if name != "seconds"} for row in csv.DictReader(file)]


def finished(out: Path) -> int:
    """Frames in the journal."""
    path = out / "jobs" / "jobs.jsonl"
    return path.read_bytes().count(b"\n") if path.is_file() else 0


def fragments(out: Path) -> list[str]:
    return [path.name for path in out.rglob(".*")]


def killed_and_resumed(folder: Path, kills: int, seed: int = 0, *more: str) -> list[str]:
    """What is wrong after that many kills at random instants of a sweep, and of every one that goes on from it."""
    more = ("--seeds", str(max(3, kills)), *more)
    draw, wrong = random.Random(seed), []
    began = time.monotonic()
    if started(folder / "whole", *more).wait():
        return ["the sweep itself fails"]
    seconds, frames = time.monotonic() - began, finished(folder / "whole")
    out, before = folder / "killed", 0
    for number in range(kills):
        process = started(out, *more)
        if number % 4:  # three of four while frames are made, the others anywhere from the start on
            while process.poll() is None and finished(out) <= before:
                time.sleep(0.002)
            time.sleep(draw.uniform(0.0, 0.7) * seconds / kills)
        else:
            time.sleep(draw.uniform(0.0, 0.3) * seconds)
        process.send_signal(signal.SIGKILL)
        process.wait()
        now = finished(out)
        print(f"kill {number + 1}: {before} frames were there, {now} are now", flush=True)
        if now < before:
            wrong.append(f"kill {number + 1} lost {before - now} finished frames")
        before = now
    images = {path.name: path.stat().st_mtime_ns for path in (out / "frames").glob("[!.]*.exr")} if before else {}
    if started(out, *more).wait():
        return [*wrong, "the sweep does not go on"]
    if rows(out) != rows(folder / "whole"):
        wrong.append("rows differ")
    again = sum((out / "frames" / name).stat().st_mtime_ns != when for name, when in images.items())
    if again > IN_FLIGHT:
        wrong.append(f"{again} frames were made again, at most {IN_FLIGHT} were in flight")
    if finished(out) != frames:
        wrong.append(f"{finished(out)} frames are in the journal, must be {frames}: each once")
    return wrong + [f"a fragment is left: {name}" for name in fragments(out)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--scheduler", default=None)
    options = parser.parse_args()
    more = () if options.scheduler is None else ("--scheduler", options.scheduler)
    with tempfile.TemporaryDirectory() as folder:
        wrong = killed_and_resumed(Path(folder), options.kills, 0, *more)
    print("\n".join(wrong) or f"{options.kills} kills: the same rows, nothing lost, no fragment")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
