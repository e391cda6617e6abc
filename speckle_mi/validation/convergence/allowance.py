"""The time that a study may take, and how its parts share it."""

from __future__ import annotations

import time

SHARES = {"exact": 0.15, "auto": 0.15, "direct": 0.05, "fast": 0.1, "rays": 0.4, "surfaces": 0.15}
"""Of the time, in the order in which it is spent; what a part leaves over goes to those after it."""

SHARE_OF_STEP = 2 / 3
"""Of a part's time left that one step of it may take, so that those after it, which take longest, get their turn."""


class Allowance:
    """Time [s] in parts: each may take its share, as in :data:`SHARES`, of what the parts before it have left."""

    def __init__(self, seconds: float) -> None:
        self.end, self.waiting = time.perf_counter() + seconds, dict(SHARES)

    def begin_part(self, name: str) -> None:
        """Starts a part; whatever it may take is ``left``, and a step of it ``step_left``."""
        share = self.waiting[name] / sum(self.waiting.values())
        del self.waiting[name]
        now = time.perf_counter()
        self.part_end = self.step_end = now + share * max(self.end - now, 0.0)

    def begin_step(self, share: float) -> None:
        """Starts a step of the part, which may take ``share`` of what is left of it."""
        self.step_end = time.perf_counter() + share * max(self.left, 0.0)

    @property
    def left(self) -> float:
        return self.part_end - time.perf_counter()

    @property
    def step_left(self) -> float:
        return self.step_end - time.perf_counter()
