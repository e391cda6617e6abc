"""Laser speckle of a moving rough surface, as a designed sensor will see it.

Importing this package makes its plugins known to Mitsuba (``laser``, ``rough_target``, ``aperture``, ``lens``,
``detector`` and ``coherent``) for the variant that is set, and for any that is set later::

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
