"""The Dr.Jit array types of the active Mitsuba variant, without automatic differentiation."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

import mitsuba as mi

from ..errors import InputError

DEFAULT_VARIANT = "llvm_ad_mono"


def set_variant(name: str = DEFAULT_VARIANT) -> None:
    """Activates a Mitsuba variant. Raises InputError for one that does not exist or cannot be used here."""
    usable = [variant for variant in mi.variants() if is_usable(variant)]
    if name not in usable:
        raise InputError(f"variant {name!r}: must be one of {', '.join(usable)}")
    if name.startswith("llvm"):
        from . import llvm

        llvm.require_usable()
    if mi.variant() != name:
        try:
            mi.set_variant(name)
        except ImportError:
            if not name.startswith("cuda"):
                raise
            there = ", ".join(variant for variant in usable if not variant.startswith("cuda"))
            raise InputError(f"variant {name!r}: finds no GPU with a driver here, must be one of {there}") from None


def ensure_variant() -> str:
    """The active variant; the default one is activated where none is, as in a process that was sent an assembly."""
    if mi.variant() is None:
        set_variant()
    return mi.variant()


def is_usable(variant: str) -> bool:
    """Whether a variant computes one wavelength on a just-in-time compiled back end."""
    return variant in ("llvm_ad_mono", "cuda_ad_mono", "llvm_mono", "cuda_mono")


def arrays() -> ModuleType:
    """``drjit.llvm`` or ``drjit.cuda``, holding Float64, UInt64 and so on."""
    import drjit.cuda
    import drjit.llvm

    variant = mi.variant() or DEFAULT_VARIANT
    return drjit.cuda if variant.startswith("cuda") else drjit.llvm


@contextmanager
def kernels_beside(threads: int) -> Iterator[None]:
    """Inside, kernels begin as many threads fewer as there are ``threads`` that wait for them, and work on them.

    Threads of both kinds that outnumber the cores wait for one another: kernels beside two threads on two cores took a
    tenth more of the processors' time.
    """
    import drjit as dr

    before = dr.thread_count()
    dr.set_thread_count(max(1, before - threads + 1))
    try:
        yield
    finally:
        dr.set_thread_count(before)


def opaque(value: float):
    """A number as a Float64 that kernels read from memory, so that another value needs no new kernel."""
    import drjit as dr

    return dr.opaque(arrays().Float64, float(value))


def opaque_vector(vector):
    """A vector (3,) as an Array3f64 that kernels read from memory."""
    lanes = arrays()
    return lanes.Array3f64(*(opaque(component) for component in vector))
