"""Finds an LLVM that Dr.Jit can use, before Dr.Jit looks for one itself.

Dr.Jit compiles its kernels with a shared LLVM library that it searches when it is first imported. With LLVM 16
and older it aborts the process in the middle of a run, and several Linux distributions install just such a
version. The package ``karellen-llvm-core`` brings a current one into the Python environment.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import sys
from pathlib import Path

OLDEST_LLVM = 19
"""Oldest major version with which Dr.Jit 1.5 is known to work."""

_VARIABLE = "DRJIT_LIBLLVM_PATH"


class LLVMError(RuntimeError):
    """No usable LLVM: the message says what to do."""


def packaged_library() -> Path | None:
    """The LLVM library installed as a Python package, or None where there is none."""
    try:
        files = importlib.metadata.distribution("karellen-llvm-core").files or []
    except importlib.metadata.PackageNotFoundError:
        return None
    found = [Path(f.locate()).resolve() for f in files if Path(f).name.startswith("libLLVM.so.")]
    # Relocatable installs may record another prefix than the one they ended up in.
    found += sorted(Path(sys.prefix, "lib").glob("libLLVM.so.*"))
    return next((path for path in found if path.is_file()), None)


def prefer_packaged_library() -> None:
    """Points Dr.Jit to the packaged LLVM unless the user has chosen one in the environment.

    Where Dr.Jit has been imported already but no Mitsuba variant is active, its back ends are started anew,
    so that ``import mitsuba, speckle_mi`` works as well as the other order.
    """
    if _VARIABLE in os.environ:
        return
    library = packaged_library()
    if library is None:
        return
    os.environ[_VARIABLE] = str(library)
    if sys.modules.get("drjit") is not None and not _usable(loaded_version()) and not _variant_active():
        _restart_backends()


def loaded_version() -> tuple[int, int, int] | None:
    """Version of the LLVM that Dr.Jit has loaded, or None (Dr.Jit is imported if need be)."""
    import drjit as dr

    try:
        version = tuple(dr.detail.llvm_version())
    except Exception:  # Dr.Jit raises where no library was found
        return None
    return version if version[0] > 0 else None


def require_usable() -> None:
    """Raises :class:`LLVMError` unless an LLVM that works is loaded."""
    version = loaded_version()
    if _usable(version):
        return
    found = "no LLVM was found" if version is None else f"LLVM {'.'.join(map(str, version))} was found"
    raise LLVMError(
        f"{found}, but speckle_mi needs LLVM {OLDEST_LLVM} or later (older ones abort the process): "
        f"run 'pip install karellen-llvm-core', or set {_VARIABLE} to a libLLVM.so of version {OLDEST_LLVM} or later, "
        "and import speckle_mi before choosing a Mitsuba variant"
    )


def _usable(version: tuple[int, int, int] | None) -> bool:
    return version is not None and version[0] >= OLDEST_LLVM


def _variant_active() -> bool:
    mitsuba = sys.modules.get("mitsuba")
    return mitsuba is not None and mitsuba.variant() is not None


def _restart_backends() -> None:
    """Shuts Dr.Jit's back ends down and starts them again, which repeats the search for LLVM.

    Only done while nothing has been computed. Where the functions are missing (another Dr.Jit), the old LLVM
    stays and :func:`require_usable` explains what to do.
    """
    import drjit

    core = ctypes.CDLL(str(Path(drjit.__file__).parent / "libdrjit-core.so"))
    try:
        shutdown, start = core._Z12jit_shutdowni, core._Z8jit_initj
    except AttributeError:
        return
    all_backends = 0b111
    shutdown(ctypes.c_int(0))
    start(ctypes.c_uint32(all_backends))
