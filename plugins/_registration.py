"""Makes the plugins known to Mitsuba, whichever of the two is imported first and whenever a variant is set."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import sys
from types import ModuleType


def follow_mitsuba() -> None:
    """Registers the plugins for the active variant and for every variant set later.

    Correlation and theory run without Mitsuba, so it is not imported here: where it is not loaded yet, the
    registration waits for its import.
    """
    if sys.modules.get("mitsuba") is not None:
        _follow_variants(sys.modules["mitsuba"])
    else:
        sys.meta_path.insert(0, _AfterMitsuba())


def _follow_variants(mitsuba: ModuleType) -> None:
    mitsuba.detail.add_variant_callback(_on_variant)
    if mitsuba.variant() is not None:
        _on_variant(None, mitsuba.variant())


def _on_variant(_: str | None, variant: str) -> None:
    from speckle_mi.machine.backend import is_usable

    if is_usable(variant):
        from speckle_mi.scene.exact_transforms import remember_transforms

        from . import register

        register()
        remember_transforms(sys.modules["mitsuba"])


class _AfterMitsuba(importlib.abc.MetaPathFinder):
    """Finds Mitsuba as everyone else does, and hooks the registration behind its import."""

    def find_spec(self, name, path=None, target=None):
        if name != "mitsuba":
            return None
        sys.meta_path.remove(self)
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_follow(module: ModuleType) -> None:
                execute(module)
                # Mitsuba puts another object in its place while it is being imported.
                _follow_variants(sys.modules["mitsuba"])

            spec.loader.exec_module = execute_and_follow
        return spec
