"""The beam that a laser's parameters describe: radii and curvatures along its local axes, and which are refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mitsuba as mi
import numpy as np

from speckle_mi.scattering.beam import Beam
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import value_of
from ._numbers import check_numbers, read_numbers

_RADIUS = {"at_least": 1e-6, "at_most": 1e5, "infinite": True, "unit": "mm"}
_WAVEFRONT = {"infinite": True, "unit": "mm"}

_LIMITS = {
    f"{name}{axis}": limits
    for name, limits in (("beam_radius", _RADIUS), ("wavefront_radius", _WAVEFRONT))
    for axis in ("", "_x", "_y")
}
_ROUND = ("beam_radius", "wavefront_radius")

_STEEPEST = 0.35
"""Largest divergence [rad] of a beam: its field is then off by a tenth, see :class:`Beam`."""

_SHORTEST, _LONGEST = 1e-9, 1e15
"""Size of a wavefront radius [mm] that double precision can square and take from a path."""


def read_beam(laser, props: mi.Properties) -> Mapping[str, Mapping[str, object]]:
    """Gives a laser the radii that its scene states; returns their names with their limits.

    Those of both axes together stand for an axis whose own is not given. SceneError where nothing is left for them.
    """
    shape = {}
    for name in _ROUND:
        axes = [f"{name}{axis}" for axis in ("_x", "_y") if f"{name}{axis}" in props]
        if len(axes) == 2 and name in props:
            raise SceneError(
                f"{laser.where}: parameter {name!r} says nothing beside {axes[0]!r} and {axes[1]!r}, must be left out"
            )
        for known in axes if len(axes) == 2 else (name, *axes):
            shape[known] = _LIMITS[known]
    read_numbers(laser, props, shape, dict.fromkeys(_ROUND, np.inf))
    return shape


def radii_of(laser, name: str) -> np.ndarray:
    """(2,) values along the laser's x and y of ``beam_radius`` or ``wavefront_radius`` [mm]."""
    along = [getattr(laser, f"{name}{axis}", None) for axis in ("_x", "_y")]
    return np.array([value_of(getattr(laser, name) if value is None else value) for value in along], dtype=np.float64)


def beam_of(laser, wavelength: float, share: float = 1.0) -> Beam:
    """A laser's beam of a wavelength [mm], given at its own place until it is aimed at a target.

    share: of the laser's power that it has.
    """
    frame = laser.placement.frame
    return Beam(
        origin=frame.origin,
        axes=frame.axes,
        radii=radii_of(laser, "beam_radius"),
        wavefront_radii=radii_of(laser, "wavefront_radius"),
        wavelength=wavelength,
        reference=frame.origin,
        strength=float(np.sqrt(share)),
    )


def check_beam(laser, shape: Mapping[str, Mapping[str, object]], beam: Callable[[], Beam]) -> None:
    """SceneError where a laser's radii describe no beam."""
    check_numbers(laser, shape)
    for name in shape:
        value = abs(value_of(getattr(laser, name)))
        if name.startswith("wavefront") and not (_SHORTEST <= value <= _LONGEST or np.isinf(value)):
            raise SceneError(
                f"{laser.where}: parameter {name!r} is {value_of(getattr(laser, name)):g} mm, must not be 0 "
                f"but {_SHORTEST:g} to {_LONGEST:g} mm in size, or inf (collimated)"
            )
    radii = radii_of(laser, "beam_radius")
    if np.isinf(radii).sum() == 1:
        raise SceneError(
            f"{laser.where}: a beam of beam_radius_x {radii[0]:g} mm and beam_radius_y {radii[1]:g} mm ends in one "
            "direction only, must have both radii finite (a line of light is a beam with one large radius) or both inf"
        )
    light = beam()
    if light.divergence > _STEEPEST:
        names = "".join(f"{name} {value_of(getattr(laser, name)):g} mm and " for name in shape).removesuffix(" and ")
        raise SceneError(
            f"{laser.where}: a beam of {names} diverges by {light.divergence:.3g} rad from its waist, must diverge "
            f"by at most {_STEEPEST} rad: steeper light is not a Gaussian beam"
        )
