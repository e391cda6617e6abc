"""Laser speckle of a moving rough surface, as a designed sensor will see it.

Importing this package makes its plugins known to Mitsuba (``laser``, ``rough_target``, ``aperture``, ``lens``,
``detector`` and ``coherent``) for the variant that is set, and for any that is set later::

    import mitsuba, speckle_mi
    mitsuba.set_variant("llvm_ad_mono")
    image = mitsuba.render(mitsuba.load_file("scene.xml"))
"""

import os as _os
import sys as _sys
from pathlib import Path as _Path

from .machine import interrupt as _interrupt

# A library leaves signals alone; a command answers them from its first moment on, before its heavy imports.
if _interrupt.is_command(_sys.argv, _sys.orig_argv):
    _interrupt.listen()

from .machine import llvm as _llvm  # noqa: E402
from .version import __version__ as __version__  # noqa: E402

# In a source tree the plugins lie beside this package, in an installation inside it.
_root = _Path(__file__).resolve().parent.parent
if (_root / "plugins" / "coherent.py").is_file():
    __path__.append(str(_root))

_llvm.prefer_packaged_library()

# FINUFFT's OpenMP threads would otherwise spin while they wait, and take the cores from NumPy's and Dr.Jit's threads:
# up to ten times slower on a machine that does anything else. Read when OpenMP is loaded, which is later than here.
_os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from .plugins._registration import follow_mitsuba as _follow_mitsuba  # noqa: E402  (after the search path is complete)

_follow_mitsuba()
