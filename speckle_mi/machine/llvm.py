"""Finds an LLVM that Dr.Jit can use, before Dr.Jit looks for one itself.

Dr.Jit compiles its kernels with a shared LLVM library that it searches when it is first imported. With LLVM 16
and older it aborts the process in the middle of a run, and several Linux distributions install just such a
version. The package ``karellen-llvm-core`` brings a current one into the Python environment.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError
from .around_import import around_import, environment_unless_chosen

OLDEST_LLVM = 19
"""Oldest major version with which Dr.Jit 1.5 is known to work."""

_VARIABLE = "DRJIT_LIBLLVM_PATH"


class LLVMError(InputError):
    """No usable LLVM: the message says what to do."""


def packaged_library() -> Path | None:
    """The LLVM library installed as a Python package, or None where there is none."""
    import importlib.metadata

    try:
        files = importlib.metadata.distribution("karellen-llvm-core").files or []
    except importlib.metadata.PackageNotFoundError:
        return None
    found = [Path(f.locate()).resolve() for f in files if Path(f).name.startswith("libLLVM.so.")]
    # Relocatable installs may record another prefix than the one they ended up in.
    found += sorted(Path(sys.prefix, "lib").glob("libLLVM.so.*"))
    return next((path for path in found if path.is_file()), None)


def prefer_packaged_library() -> None:
    """Lets Dr.Jit find the packaged LLVM, unless the user has chosen one in the environment, which stays as it is.

    Where Dr.Jit has been imported already, with an LLVM that does not work and without having been used, its back ends
    are started anew, so that ``import mitsuba, speckle_mi`` works as well as the other order.
    """
    if sys.modules.get("drjit") is None:
        around_import("drjit", _pointed_to)
    elif _VARIABLE not in os.environ and packaged_library() and not _usable(loaded_version()) and is_unused():
        with _pointed_to():
            _restart_backends()


@contextmanager
def _pointed_to() -> Iterator[None]:
    """Inside, Dr.Jit, which looks for LLVM when its back ends start, finds the packaged one or the user's."""
    library = None if _VARIABLE in os.environ else packaged_library()
    if library is None:
        yield
        return
    with environment_unless_chosen(_VARIABLE, str(library)):
        yield


def loaded_version() -> tuple[int, int, int] | None:
    """Version of the LLVM that Dr.Jit has loaded, or None (Dr.Jit is imported if need be)."""
    import drjit as dr

    try:
        version = tuple(dr.detail.llvm_version())
    except Exception:  # Dr.Jit raises where no library was found
        return None
    return version if version[0] > 0 else None


def loaded_library() -> str | None:
    """Path of the LLVM that Dr.Jit has loaded, None where the system does not tell or there is none."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    version = loaded_version()
    paths = {line.split(maxsplit=5)[5] for line in lines if "libLLVM" in line}
    return next((path for path in sorted(paths) if version and str(version[0]) in Path(path).name), None)


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


def is_unused() -> bool:
    """Whether an imported Dr.Jit certainly has neither variables nor kernels: its own account of them says so.

    A Mitsuba variant that is active holds objects in its registry as well.
    """
    mitsuba = sys.modules.get("mitsuba")
    if mitsuba is not None and mitsuba.variant() is not None:
        return False
    import drjit as dr

    account = dr.whos(as_string=True)
    return "-- No variables registered --" in account and "Kernel launches   : 0 " in account


def _restart_backends() -> None:
    """Shuts Dr.Jit's back ends down and starts them again, which repeats the search for LLVM.

    Where the functions are missing (another Dr.Jit), the old LLVM stays and :func:`require_usable` explains what to do.
    """
    import ctypes

    import drjit

    core = ctypes.CDLL(str(Path(drjit.__file__).parent / "libdrjit-core.so"))
    try:
        shutdown, start = core._Z12jit_shutdowni, core._Z8jit_initj
    except AttributeError:
        return
    all_backends = 0b111
    shutdown(ctypes.c_int(0))
    start(ctypes.c_uint32(all_backends))
