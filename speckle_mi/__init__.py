"""Laser speckle of a moving rough surface, as a designed sensor will see it.

In a program or a notebook::

    import speckle_mi as smi
    assembly = smi.load_scene("scene.xml", beam_radius=0.2)
    simulation = smi.Simulation(assembly)
    rest, moved = (simulation.frame(smi.Pose(x=x)).image for x in (0.0, 0.01))
    print(smi.Correlator(rest.intensity).shift(moved.intensity))
    print(simulation.sensitivity().fits["x"]["u"])

Of several detectors, each maybe with a camera, at once::

    both = smi.Simulations(smi.load_detectors("scenes/two_cameras.xml"))
    print({name: frame.image.measured.mean() for name, frame in both.frames(smi.Pose(z=0.01)).items()})

What is named here is imported when it is first used. ``python -m speckle_mi`` lists the commands. Importing the package
does nothing else but make its plugins known to Mitsuba (``laser``, ``rough_target``, ``aperture``, ``lens``,
``detector`` and ``coherent``), for the variant that is set and for any that is set later::

    import mitsuba, speckle_mi
    mitsuba.set_variant("llvm_ad_mono")
    image = mitsuba.render(mitsuba.load_file("scene.xml"))
"""

from pathlib import Path as _Path

from .machine import llvm as _llvm
from .version import __version__ as __version__

# In a source tree the plugins lie beside this package, in an installation inside it.
_root = _Path(__file__).resolve().parent.parent
if (_root / "plugins" / "coherent.py").is_file():
    __path__.append(str(_root))

_llvm.prefer_packaged_library()

from .plugins._registration import follow_mitsuba as _follow_mitsuba  # noqa: E402  (after the search path is complete)

_follow_mitsuba()

_PUBLIC = {
    "Assembly": "scene.assembly",
    "Correlator": "measurement.correlator",
    "FieldImage": "images.field_image",
    "Pose": "geometry.pose",
    "Simulation": "experiments.simulation:SensorSimulation",
    "Simulations": "experiments.simulation:SensorSimulations",
    "compare_scenes": "studies.comparison",
    "expected_sensitivity": "experiments.expectation",
    "fit_sensitivity": "measurement.sensitivity",
    "load_detectors": "scene.load",
    "load_scene": "scene.load",
    "one_frame_sensitivity": "experiments.one_frame",
    "optimise_scene": "studies.optimisation",
    "propagate_tolerances": "studies.uncertainty",
    "read_image": "images.pictures",
    "theory": "theory",
}
"""What a program needs, and where it is defined: by another name behind a colon."""

__all__ = list(_PUBLIC)


def __getattr__(name: str) -> object:
    """Imports what is public when it is asked for: Mitsuba, plots and the like are loaded by their users only."""
    from importlib import import_module

    if name not in _PUBLIC:
        public = ", ".join(_PUBLIC)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}, its public names are {public}")
    place, _, own = _PUBLIC[name].partition(":")
    module = import_module(f"{__name__}.{place}")
    return module if name == "theory" else getattr(module, own or name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
