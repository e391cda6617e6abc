"""FINUFFT, loaded so that its threads sleep while they wait.

They would otherwise spin, and take the cores from NumPy's and Dr.Jit's threads: up to ten times slower on a machine
that does anything else. OpenMP reads how it is to wait when it is loaded, which is when FINUFFT is imported.
"""

from __future__ import annotations

from .around_import import environment_unless_chosen

with environment_unless_chosen("OMP_WAIT_POLICY", "PASSIVE"):
    import finufft

__all__ = ["finufft"]
