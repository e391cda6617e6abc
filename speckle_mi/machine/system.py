"""What a report about a result should name: versions, LLVM, variants, cores, processor."""

from __future__ import annotations

import importlib.metadata
import platform

from ..version import __version__
from . import llvm
from .cores import usable_cores

_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "finufft", "OpenEXR", "scikit-image", "matplotlib", "rich")


def system_information() -> dict[str, str]:
    """Names and values of everything that a report about a result should name."""
    import mitsuba as mi

    from .backend import is_usable

    version = llvm.loaded_version()
    found = ".".join(map(str, version)) if version else "none"
    if version and version[0] < llvm.OLDEST_LLVM:
        found += f" (too old, must be {llvm.OLDEST_LLVM} or later: pip install karellen-llvm-core)"
    information = {
        "speckle_mi": __version__,
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
        "LLVM": found,
        "LLVM library": llvm.loaded_library() or "unknown",
        "variants": ", ".join(filter(is_usable, mi.variants())),
        "GPU": "yes" if _has_cuda() else "no",
        "cores": str(usable_cores()),
        "processor": _processor(),
        "system": platform.platform(),
    }
    return information


def _has_cuda() -> bool:
    import drjit as dr

    return dr.has_backend(dr.JitBackend.CUDA)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "unknown"
