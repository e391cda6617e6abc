"""Counter-based random numbers: a value is a pure function of a seed and of integer coordinates.

The functions use only integer and elementary operators, so they take NumPy ``uint64`` arrays and Dr.Jit
``UInt64`` arrays alike and give the same bits for both, in any order and on any machine.

The mixing function is the finaliser of SplitMix64 (Steele, Lea and Flood 2014, DOI 10.1145/2660193.2660195).
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

Words = TypeVar("Words")
_GOLDEN = 0x9E3779B97F4A7C15
_MASK = (1 << 64) - 1


def mix(words: Words, kind: type = np.uint64) -> Words:
    """Bijective scrambling of 64-bit words. ``kind`` is the scalar or array type for the constants."""
    words = (words ^ (words >> kind(30))) * kind(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> kind(27))) * kind(0x94D049BB133111EB)
    return words ^ (words >> kind(31))


def mix_integer(value: int) -> int:
    """:func:`mix` of one Python integer, modulo 2^64."""
    value &= _MASK
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & _MASK
    return value ^ (value >> 31)


def seed_word(seed: int) -> int:
    """The 64-bit word with which :func:`cell_key` starts for surface number ``seed``."""
    return mix_integer(seed + _GOLDEN)


def cell_key(seed: Words, *coordinates: Words, kind: type = np.uint64) -> Words:
    """Key of a cell with integer coordinates on a surface; ``seed`` is an array holding its :func:`seed_word`."""
    key = seed
    for coordinate in coordinates:
        key = mix((key + kind(_GOLDEN)) ^ coordinate, kind)
        key = key * kind(0xD1342543DE82EF95) + kind(1)
    return key


def uniform_bits(key: Words, stream: int, kind: type = np.uint64) -> Words:
    """53 random bits of stream number ``stream`` for every key; times 2^-53 they are uniform in [0, 1)."""
    return mix(key + kind((stream + 1) * _GOLDEN & _MASK), kind) >> kind(11)
