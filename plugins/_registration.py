"""Makes the plugins known to Mitsuba, whichever of the two is imported first and whenever a variant is set."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from speckle_mi.machine.around_import import around_import


def follow_mitsuba() -> None:
    """Registers the plugins for the active variant and for every variant set later.

    Correlation and theory run without Mitsuba, so it is not imported here: where it is not loaded yet, the
    registration waits for its import.
    """
    if sys.modules.get("mitsuba") is not None:
        _follow_variants()
    else:
        around_import("mitsuba", _followed)


@contextmanager
def _followed() -> Iterator[None]:
    yield
    _follow_variants()


def _follow_variants() -> None:
    mitsuba = sys.modules["mitsuba"]  # which puts another object in its place while it is being imported
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
