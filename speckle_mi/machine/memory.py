"""How much memory there is to use, so that what cannot fit is refused before any is taken."""

from __future__ import annotations

import os
from pathlib import Path

from . import cgroup


def usable_memory(process: Path = cgroup.PROCESS) -> float:
    """Memory that this process may take [bytes]: the machine's, less by a limit of its group; inf where none says."""
    return min(_physical_memory(), cgroup.memory_limit(process))


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def excess(needed: float) -> str:
    """In words, how ``needed`` [bytes] exceed the memory there is to use; empty where they fit."""
    there = usable_memory()
    if needed <= there:
        return ""
    return f"need about {needed / 1e9:.3g} GB, must need at most the {there / 1e9:.3g} GB that this process may use"
