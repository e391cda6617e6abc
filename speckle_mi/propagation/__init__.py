"""Coherent sums from points to points: the one propagator behind free space, apertures and pupils."""

from .choose import SumResult, coherent_sum
from .paths import FreeSpace, Path, RayleighSommerfeld

__all__ = ["FreeSpace", "Path", "RayleighSommerfeld", "SumResult", "coherent_sum"]
