"""What the tests share: the Mitsuba variant, scenes and their assemblies, and the order from fast to slow."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SCENES = ROOT / "scenes"

SLOW_LAST = (
    "test_random_ways",
    "test_shadows",
    "test_optics_fields",
    "test_optics_scene",
    "test_imaging_speckle",
    "test_commands",
    "test_sensitivity_free_space",
)
"""Files that take longest, in the order in which they run after all others."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def place(item: pytest.Item) -> int:
        name = item.path.stem
        return SLOW_LAST.index(name) + 1 if name in SLOW_LAST else 0

    items.sort(key=place)  # stable: otherwise the order stays as it is


@pytest.fixture(scope="session")
def mitsuba():
    """Mitsuba with the default variant, set once, without its notes on monochrome films."""
    import mitsuba as mi

    from speckle_mi.machine.backend import set_variant

    set_variant()
    mi.set_log_level(mi.LogLevel.Error)
    return mi


@pytest.fixture(scope="session")
def load(mitsuba):
    """Loads a scene from its XML text."""
    return mitsuba.load_string


@pytest.fixture(scope="session")
def assemble(mitsuba):
    """The assembly of a scene given as XML text."""
    from speckle_mi.scene.read import assembly_from_scene

    def assemble(text: str, spp: int = 0):
        return assembly_from_scene(mitsuba.load_string(text), spp=spp)

    return assemble


@pytest.fixture(scope="session")
def shipped(mitsuba):
    """The assembly of a scene in ``scenes/`` with values of its <default>s."""
    from speckle_mi.scene.read import assembly_from_scene

    def shipped(name: str, **defaults):
        values = {key: str(value) for key, value in defaults.items()}
        return assembly_from_scene(mitsuba.load_file(str(SCENES / f"{name}.xml"), **values))

    return shipped
