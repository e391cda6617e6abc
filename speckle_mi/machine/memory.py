"""How much memory the machine has, so that what cannot fit is refused before any is taken."""

from __future__ import annotations

import os


def physical_memory() -> float:
    """Memory of the machine [bytes], inf where the system does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def excess(needed: float) -> str:
    """In words, how ``needed`` [bytes] exceed the machine's memory; empty where they fit."""
    there = physical_memory()
    if needed <= there:
        return ""
    return f"need about {needed / 1e9:.3g} GB, must need at most the {there / 1e9:.3g} GB of this machine"
