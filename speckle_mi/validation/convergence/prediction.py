"""How long a frame should take, before it is made: from those that were made, or from a few sources of it."""

from __future__ import annotations

import time
from dataclasses import replace

from ...field.simulation import simulate_frame
from ...geometry.pose import Pose
from .exact import ExactField
from .frame import MEASURED, Row, Setting
from .subject import Subject

PAIRS_PER_SECOND = 1e9
"""Of the direct sum, roughly: the first guess of what it takes behind openings."""

PROBE_SOURCES = 0.5
"""N1 of the frame that tells what the rays of one source cost, and whether the method applies: about five sources."""

MANY = 0.1
"""Scatterers a pixel from which a fast sum grows with their number; with fewer, by less than that."""


class Predictor:
    """Seconds that the frames of one method should take; it learns from each that was measured.

    Pairs grow like N1, and so does a fast sum once there are many scatterers; before, about like the root of N1.
    """

    def __init__(self, method: str, pixels: int) -> None:
        self.method, self.pixels = method, pixels
        self._known: dict[int, tuple[float, float]] = {}  # number of an accuracy -> (N1, seconds) of the latest frame
        self._coarser: dict[int, float] = {}  # N1 -> seconds of the accuracy before

    def knows(self, accuracy: int) -> bool:
        """Whether anything is known of an accuracy, by its number."""
        return accuracy in self._known

    def assume(self, accuracy: int, point_sources: float, seconds: float) -> None:
        """Takes it that a frame of that accuracy and N1 takes so long."""
        self._known[accuracy] = (point_sources, seconds)

    def seconds(self, accuracy: int, point_sources: int) -> float:
        """What a frame should take; 0 where nothing is known."""
        return max(self._grown(accuracy, point_sources), self._coarser.get(point_sources, 0.0))

    def learn(self, accuracy: int, row: Row) -> None:
        """Takes account of a row, measured or left out."""
        count = row.point_sources
        expected = self.seconds(accuracy, count)
        if row.status == MEASURED:
            self._known[accuracy] = (count, row.seconds_median)
        if self.method != "rays":
            # The next accuracy is not faster than the one before, whether that was measured or left out.
            self._coarser[count] = row.seconds_median if row.status == MEASURED else expected

    def _grown(self, accuracy: int, point_sources: int) -> float:
        if accuracy not in self._known:
            return 0.0
        count, seconds = self._known[accuracy]
        growth = 1.0 if self.method in ("direct", "rays") or count > MANY * self.pixels else 0.5
        return seconds * (point_sources / count) ** growth


def seconds_of_rays(subject: Subject, setting: Setting, exact: ExactField | None) -> float:
    """What a frame of rays should take [s], from one with few sources. Raises ValueError where rays do not apply."""
    probe = replace(setting, point_sources=min(PROBE_SOURCES, setting.point_sources)).of(subject.assembly)
    begin = time.perf_counter()
    traced = simulate_frame(probe, Pose()).scatterers.count
    seconds = time.perf_counter() - begin
    return seconds / max(traced, 1) * (exact.scatterers if exact else traced)


def seconds_behind_openings(subject: Subject, rows: list[Row]) -> float:
    """What ``direct`` should take [s] from the nodes on the last opening, as ``rows`` have them; 0 without."""
    nodes = max((row.opening_nodes for row in rows if row.opening_nodes is not None), default=0)
    return nodes * subject.assembly.detector.size / PAIRS_PER_SECOND
