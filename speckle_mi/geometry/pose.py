"""Where the target is moved to: six degrees of freedom, in millimetres and degrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .rotation import rotation_matrix

DEGREES_OF_FREEDOM = ("x", "y", "z", "rx", "ry", "rz")
"""Order of the six motions everywhere: translations along, then rotations about, the target's axes."""


def is_rotation(dof: str) -> bool:
    """Whether a degree of freedom is measured in degrees (a rotation) rather than millimetres."""
    return dof.startswith("r")


def unit_of(dof: str) -> str:
    """Unit of a motion."""
    return "deg" if is_rotation(dof) else "mm"


def sensitivity_unit(dof: str) -> str:
    """Unit of a sensitivity to a motion."""
    return f"mm/{unit_of(dof)}"


def motions_named(text: str, flag: str = "--dof") -> tuple[str, ...]:
    """The degrees of freedom in ``"x,ry"``. Raises InputError for an unknown one, or one that is named twice."""
    names = tuple(name.strip() for name in text.split(","))
    for name in names:
        if name not in DEGREES_OF_FREEDOM:
            raise InputError(f"{flag} {name!r}: must be one of {', '.join(DEGREES_OF_FREEDOM)}")
    if len(set(names)) != len(names):
        raise InputError(f"{flag} {text!r}: must name each motion once")
    return names


FARTHEST = 1e6
"""Largest coordinate of a part [mm]; a path of twice as much holds 1e-6 of a wavelength in double precision."""


@dataclass(frozen=True)
class Pose:
    """Displacement of the target from its rest place, in the target frame about its origin.

    x, y, z are translations [mm]; rx, ry, rz are the components of a rotation vector [deg].
    The rotation acts first, then the translation.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    rx: float = 0.0
    ry: float = 0.0
    rz: float = 0.0

    def __post_init__(self) -> None:
        for name in DEGREES_OF_FREEDOM:
            value = getattr(self, name)
            if not abs(value) <= FARTHEST:
                raise InputError(
                    f"pose {name} = {value}: must be a finite number of {unit_of(name)}, at most {FARTHEST:g} in size"
                )

    @classmethod
    def parse(cls, text: str) -> Pose:
        """Pose from ``"x=0.02,ry=0.01"`` (mm and degrees); an empty text is the rest pose."""
        values: dict[str, float] = {}
        for item in (part.strip() for part in (text.split(",") if text else ())):
            name, _, value = item.partition("=")
            name = name.strip()
            if name not in DEGREES_OF_FREEDOM:
                raise InputError(
                    f"pose {text!r}: unknown degree of freedom {name!r}, must be one of {', '.join(DEGREES_OF_FREEDOM)}"
                )
            if name in values:
                raise InputError(f"pose {text!r}: {name} is given twice")
            try:
                values[name] = float(value)
            except ValueError:
                raise InputError(
                    f"pose {item!r}: {value!r} is not a number, write for example x=0.02,ry=0.01"
                ) from None
        return cls(**values)

    def __str__(self) -> str:
        moved = [f"{name}={getattr(self, name)!r}" for name in DEGREES_OF_FREEDOM if getattr(self, name) != 0.0]
        return ",".join(moved)

    @property
    def translation(self) -> np.ndarray:
        """(3,) [mm]."""
        return np.array([self.x, self.y, self.z], dtype=np.float64)

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) rotation matrix."""
        return rotation_matrix(np.radians([self.rx, self.ry, self.rz]))
