"""Random scenes with elements against independent optics: none dark, none off by more than its stated error.

``pytest tests/test_random_ways.py`` judges SAMPLE scenes of all kinds. ``python tests/test_random_ways.py``
judges all 300 (or ``--kind``, ``--numbers``) and prints a table. A scene holds when the field on its compared pixels
differs from the reference, one global phase removed, by no more than the stated ``numerical_error``, or what single
precision stores, and the reference's own error. The stated error is one of the whole frame's L2 norm, so the scale is
the frame's root mean square, or that of the compared pixels where they are the brighter. Refusals are failures but for
a share of ALLOWED_REFUSALS.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

import random_ways  # noqa: E402

SAMPLE = 60
"""Scenes judged in a run of the tests; the command judges all."""

STORAGE = 3e-7
"""Relative L2 error that the single precision of an image's E.re and E.im may make."""

ALLOWED_REFUSALS = 0.02
DARK = 1e-3
"""A field weaker than this part of the reference's is dark."""

LONGEST = 30.0
"""Seconds within which a scene has to be done."""


@dataclass(frozen=True)
class Verdict:
    """What became of a scene: right, wrong, dark, refused or slow; its true error and the one stated, seconds."""

    scene: random_ways.Scene
    outcome: str
    error: float
    stated: float
    seconds: float
    words: str

    @property
    def line(self):
        s = self.scene
        return (f"{s.number:4d} {s.kind:18s} {self.outcome:8s} error {self.error:8.1e} stated {self.stated:8.1e} "
                f"tolerance {s.tolerance:.0e} reference {s.error:7.1e} {self.seconds:6.1f} s  {s.note} {self.words}")


def field_on_pixels(path: Path, rows, columns):
    """(field (m,), the frame's rms amplitude, stated error, warnings) of a scene as the command stores it."""
    import OpenEXR

    from speckle_mi.render import main as render

    output = str(path.with_name("field.exr"))
    render([str(path), "-o", output, "--quiet"])
    part = OpenEXR.File(output, separate_channels=True).parts[0]
    field = part.channels["E.re"].pixels + 1j * part.channels["E.im"].pixels.astype(complex)
    rms = float(np.sqrt(np.mean(np.abs(field) ** 2)))
    return field[rows, columns], rms, float(part.header["numerical_error"]), part.header.get("warnings", "")


def relative_error(got, want, rms):
    """Root mean square error with one global phase removed, relative to ``rms`` or to that of ``want`` if larger."""
    phase = np.vdot(want, got)
    phase = phase / abs(phase) if abs(phase) else 1.0
    error, scale = (float(np.sqrt(np.mean(np.abs(x) ** 2))) for x in (got / phase - want, want))
    return error / max(scale, rms)


def judged(scene: random_ways.Scene, limit: float = 0.0) -> Verdict:
    """Renders a scene and compares; after ``limit`` seconds, where given, it counts as slow."""
    with tempfile.TemporaryDirectory() as folder:
        path, start = scene.write(Path(folder)), time.perf_counter()
        try:
            with _no_longer_than(limit):
                got, rms, stated, warnings = field_on_pixels(path, scene.rows, scene.columns)
        except TimeoutError:
            return Verdict(scene, "slow", np.nan, np.nan, time.perf_counter() - start, "")
        except (ValueError, RuntimeError) as refusal:
            words = " ".join(str(refusal).split()).replace(folder + "/", "")
            return Verdict(scene, "refused", np.nan, np.nan, time.perf_counter() - start, words)
    seconds = time.perf_counter() - start
    error = relative_error(got, scene.field, rms)
    if np.linalg.norm(got) < DARK * np.linalg.norm(scene.field):
        outcome = "dark"
    else:
        outcome = "right" if error <= max(stated, STORAGE) + scene.error else "wrong"
    return Verdict(scene, outcome, error, stated, seconds, str(warnings))


class _no_longer_than:
    """Raises TimeoutError inside the block after some seconds; 0: never."""

    def __init__(self, seconds):
        self.seconds = seconds

    def __enter__(self):
        if self.seconds:
            def stop(*_):
                raise TimeoutError

            self.before = signal.signal(signal.SIGALRM, stop)
            signal.setitimer(signal.ITIMER_REAL, self.seconds)

    def __exit__(self, *_):
        if self.seconds:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, self.before)


def sampled():
    """Numbers of SAMPLE scenes (fewer where there are not so many) spread evenly over all kinds' scenes."""
    numbers = random_ways.numbers_of(random_ways.KINDS)
    if len(numbers) <= SAMPLE:
        return numbers
    return [numbers[i] for i in np.linspace(0, len(numbers) - 1, SAMPLE).round().astype(int)]


REFUSED: list[int] = []


@pytest.mark.parametrize("number", sampled(), ids=lambda n: f"{n}-{random_ways.kind_of(n)}")
def test_the_stated_error_bounds_the_true_one(mitsuba, number):
    verdict = judged(random_ways.scene(number))
    if verdict.outcome == "refused":
        REFUSED.append(number)
        assert len(REFUSED) <= ALLOWED_REFUSALS * len(sampled()), verdict.line
        return
    assert verdict.outcome == "right", verdict.line


def test_a_scene_is_the_same_whenever_it_is_drawn():
    one, two = random_ways.scene(0), random_ways.scene(0)
    assert one.xml == two.xml
    assert np.array_equal(one.field, two.field)


def summary(verdicts):
    """A table: kind by kind, how many came out how, and the largest error."""
    outcomes = ("right", "wrong", "dark", "refused", "slow")
    lines = [f"{'kind':18s} " + " ".join(f"{o:>8s}" for o in outcomes)
             + "  worst error  error/stated  longest s  reference"]
    for kind in random_ways.KINDS:
        mine = [v for v in verdicts if v.scene.kind == kind]
        if not mine:
            continue
        counts = " ".join(f"{sum(v.outcome == o for v in mine):8d}" for o in outcomes)
        errors = [v.error for v in mine if np.isfinite(v.error)] or [np.nan]
        ratios = [v.error / max(v.stated, STORAGE) for v in mine if np.isfinite(v.error)] or [np.nan]
        lines.append(f"{kind:18s} {counts}  {max(errors):11.1e}  {max(ratios):12.2g}  "
                     f"{max(v.seconds for v in mine):9.1f}  {max(v.scene.error for v in mine):.1e}")
    totals = " ".join(f"{sum(v.outcome == o for v in verdicts):8d}" for o in outcomes)
    return "\n".join([*lines, f"{'all':18s} {totals}"])


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kind", action="append", choices=list(random_ways.KINDS), help="only these kinds")
    parser.add_argument("--numbers", metavar="A:B", default=f"0:{random_ways.COUNT}", help="only these scenes")
    parser.add_argument("--limit", type=float, default=LONGEST, help="seconds after which a scene counts as slow")
    options = parser.parse_args(arguments)
    first, last = (int(x) for x in options.numbers.split(":"))
    kinds = options.kind or list(random_ways.KINDS)
    import mitsuba

    from speckle_mi.machine.backend import set_variant

    set_variant()
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    verdicts = []
    for number in range(first, last):
        if random_ways.kind_of(number) not in kinds:
            continue
        try:
            verdicts.append(judged(random_ways.scene(number), options.limit))
        except RuntimeError as undrawn:
            print(undrawn, flush=True)
            continue
        print(verdicts[-1].line, flush=True)
    print(summary(verdicts))
    refused = sum(v.outcome == "refused" for v in verdicts)
    failed = sum(v.outcome not in ("right", "refused") for v in verdicts)
    return int(failed > 0 or refused > ALLOWED_REFUSALS * len(verdicts))


if __name__ == "__main__":
    raise SystemExit(main())
