"""What a scene file can name. Each module defines and registers one Mitsuba plugin."""

from __future__ import annotations

import importlib
import sys

NAMES = ("laser", "rough_target", "aperture", "lens", "mirror", "beam_splitter", "detector", "coherent")


def register() -> None:
    """Defines the plugin classes for the active Mitsuba variant and registers them by name."""
    for name in NAMES:
        qualified = f"{__name__}.{name}"
        # The classes derive from the variant's own base classes, so another variant needs them made again.
        if qualified in sys.modules:
            importlib.reload(sys.modules[qualified])
        else:
            importlib.import_module(qualified)
