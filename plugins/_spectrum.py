"""The wavelengths that a laser's parameters describe: one, several lines, and the width of a line."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from speckle_mi.scattering.beam import Beam
from speckle_mi.scattering.spectrum import line_samples, longest_path
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import check_number, describe, read_integer, value_of
from ._beam import beam_of
from ._numbers import check_numbers, read_numbers

_WAVELENGTH = {"at_least": 1.0, "at_most": 1e6, "unit": "nm"}
_LINEWIDTH = {"at_least": 0.0, "at_most": 1e3, "unit": "nm"}

_SAMPLES, _FEWEST, _MOST = 15, 3, 999
"""Samples of a line unless asked otherwise, and how many there may be."""

_MOST_LINES = 100

_WIDEST = 0.05
"""Largest width of a line relative to its wavelength: what is nearly of one colour."""


@dataclass(frozen=True)
class LaserLine:
    """Light of one wavelength. number: of the line, from 0, None for a sample beside its middle; weight: factor of its
    intensity; longest_path: path difference [mm] up to which the samples stand for the line."""

    number: int | None
    beam: Beam
    weight: float
    longest_path: float


def read_spectrum(laser, props: mi.Properties) -> dict:
    """Gives a laser its wavelengths; returns the names of its numbers with their limits. SceneError for bad ones."""
    laser.lines_nm, laser.shares = (), (1.0,)
    numbers = {"linewidth": _LINEWIDTH}
    if "wavelengths" in props and "wavelength" in props:
        raise SceneError(f"{laser.where}: has 'wavelength' and 'wavelengths', must have one of them")
    name = "wavelengths" if "wavelengths" in props else "wavelength" if _is_list(props, "wavelength") else None
    if name is not None:
        laser.lines_nm = _numbers_in(laser.where, props, name, _WAVELENGTH)
        laser.shares = (1 / len(laser.lines_nm),) * len(laser.lines_nm)
    else:
        numbers = {"wavelength": _WAVELENGTH} | numbers
    if "weights" in props:
        weights = _numbers_in(laser.where, props, "weights", {"at_least": 1e-9, "at_most": 1e9})
        if len(weights) != max(1, len(laser.lines_nm)):
            raise SceneError(
                f"{laser.where}: parameter 'weights' has {len(weights)} numbers, must have one for each of the "
                f"{max(1, len(laser.lines_nm))} wavelengths"
            )
        laser.shares = tuple(weight / sum(weights) for weight in weights)
    read_numbers(laser, props, numbers, {"linewidth": 0.0})
    laser.spectral_samples = read_integer(props, "spectral_samples", _SAMPLES, at_least=_FEWEST, at_most=_MOST)
    if laser.spectral_samples % 2 == 0:
        raise SceneError(
            f"{laser.where}: parameter 'spectral_samples' is {laser.spectral_samples}, must be odd: one is the middle"
        )
    return numbers


def check_spectrum(laser, numbers: dict) -> None:
    """SceneError where a laser's numbers describe no line."""
    check_numbers(laser, numbers)
    width, shortest = value_of(laser.linewidth), min(wavelengths_of(laser))
    if width > _WIDEST * shortest:
        raise SceneError(
            f"{laser.where}: parameter 'linewidth' is {width:g} nm, must be at most {_WIDEST:.0%} of the wavelength, "
            f"{_WIDEST * shortest:g} nm"
        )


def wavelengths_of(laser) -> tuple[float, ...]:
    """Vacuum wavelengths of a laser's lines [nm]."""
    return laser.lines_nm or (value_of(laser.wavelength),)


def lines_of(laser) -> list[LaserLine]:
    """All light of a laser: the middle of every line, followed by the samples of its width."""
    lines, width = [], value_of(laser.linewidth)
    for number, (middle, share) in enumerate(zip(wavelengths_of(laser), laser.shares, strict=True)):
        count = laser.spectral_samples
        samples, weights = line_samples(middle, width, count)
        limit = longest_path(middle * 1e-6, width * 1e-6, count) if width else np.inf
        for k, (wavelength, weight) in enumerate(zip(samples, weights, strict=True)):
            beam = beam_of(laser, wavelength * 1e-6, share)
            lines.append(LaserLine(None if k else number, beam, float(weight), limit))
    return lines


def _is_list(props: mi.Properties, name: str) -> bool:
    """Whether a parameter is a text of several words."""
    return name in props and isinstance(props[name], str) and len(props[name].replace(",", " ").split()) > 1


def _numbers_in(where: str, props: mi.Properties, name: str, limits: dict) -> tuple[float, ...]:
    """The numbers of a text, separated by commas or spaces."""
    text = props[name]
    if not isinstance(text, str):
        raise SceneError(f"{describe(props)}: parameter {name!r} is {text!r}, must be a text of numbers: '632.8, 780'")
    words = text.replace(",", " ").split()
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        raise SceneError(f"{where}: parameter {name!r} is {text!r}, must be numbers with commas between") from None
    if not 1 <= len(numbers) <= _MOST_LINES:
        raise SceneError(f"{where}: parameter {name!r} has {len(numbers)} numbers, must have 1 to {_MOST_LINES}")
    for number in numbers:
        check_number(where, name, number, **limits)
    return numbers
