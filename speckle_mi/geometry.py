"""Rigid motions and planes of points, the geometry that everything else is written in.

Lengths are millimetres and angles radians unless a name says otherwise; all arrays are float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DEGREES_OF_FREEDOM = ("x", "y", "z", "rx", "ry", "rz")
"""Order of the six motions everywhere: translations along, then rotations about, the target's axes."""


def is_rotation(dof: str) -> bool:
    """Whether a degree of freedom is measured in degrees (a rotation) rather than millimetres."""
    return dof.startswith("r")


def rotation_matrix(rotation_vector: np.ndarray) -> np.ndarray:
    """Exact rotation about ``rotation_vector`` (3,) [rad] by its length (Rodrigues' formula), (3, 3)."""
    vector = np.asarray(rotation_vector, dtype=np.float64)
    angle = float(np.linalg.norm(vector))
    cross = cross_matrix(vector)
    # sin(a)/a and (1 - cos(a))/a^2 by sinc, which keep full precision down to a = 0.
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half * half * (cross @ cross)


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """(3, 3) matrix that multiplies by ``vector`` (3,) from the left: vector x."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def vectors_across(direction: np.ndarray) -> np.ndarray:
    """(2, 3) orthonormal rows that span the plane across the unit vector ``direction`` (3,)."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(direction, first)])


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
                unit = "deg" if is_rotation(name) else "mm"
                raise ValueError(
                    f"pose {name} = {value}: must be a finite number of {unit}, at most {FARTHEST:g} in size"
                )

    @classmethod
    def parse(cls, text: str) -> Pose:
        """Pose from ``"x=0.02,ry=0.01"`` (mm and degrees); an empty text is the rest pose."""
        values: dict[str, float] = {}
        for item in (part.strip() for part in (text.split(",") if text else ())):
            name, _, value = item.partition("=")
            name = name.strip()
            if name not in DEGREES_OF_FREEDOM:
                raise ValueError(
                    f"pose {text!r}: unknown degree of freedom {name!r}, must be one of {', '.join(DEGREES_OF_FREEDOM)}"
                )
            if name in values:
                raise ValueError(f"pose {text!r}: {name} is given twice")
            try:
                values[name] = float(value)
            except ValueError:
                raise ValueError(
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


@dataclass(frozen=True)
class Frame:
    """A Cartesian frame in the world: ``origin`` (3,) [mm], ``axes`` (3, 3) with unit columns x, y, z."""

    origin: np.ndarray
    axes: np.ndarray

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """World coordinates (n, 3) of local points (n, 3)."""
        return self.origin + np.asarray(points) @ self.axes.T

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """Local coordinates (n, 3) of world points (n, 3)."""
        return (np.asarray(points) - self.origin) @ self.axes

    def moved(self, pose: Pose) -> Frame:
        """The frame after a rigid motion given in its own axes about its own origin."""
        return Frame(self.origin + self.axes @ pose.translation, self.axes @ pose.rotation)


@dataclass(frozen=True)
class PlanePoints:
    """Points on a plane: ``origin + a u + b v``.

    origin: (3,) [mm]; u, v: (3,) orthonormal; a, b: (m,) coordinates [mm].
    """

    origin: np.ndarray
    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    b: np.ndarray

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit normal u x v."""
        return np.cross(self.u, self.v)

    @property
    def size(self) -> int:
        return int(self.a.size)

    def points(self) -> np.ndarray:
        """World positions (m, 3) [mm]."""
        return self.origin + self.a.reshape(-1, 1) * self.u + self.b.reshape(-1, 1) * self.v


@dataclass(frozen=True)
class PlaneGrid:
    """Regular grid of points on a plane, row-major: ``origin + column * pitch * u + row * pitch * v``.

    origin: (3,) centre of pixel (row 0, column 0) [mm]; u, v: (3,) orthonormal directions of
    increasing column and row; pitch [mm]; shape = (rows, columns).
    """

    origin: np.ndarray
    u: np.ndarray
    v: np.ndarray
    pitch: float
    shape: tuple[int, int]

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit normal u x v."""
        return np.cross(self.u, self.v)

    @property
    def size(self) -> int:
        return self.shape[0] * self.shape[1]

    @property
    def centre(self) -> np.ndarray:
        """(3,) middle of the grid [mm]."""
        rows, columns = self.shape
        return self.origin + self.pitch * ((columns - 1) / 2 * self.u + (rows - 1) / 2 * self.v)

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the sides along u and v, to the outer edges of the pixels [mm]."""
        return 0.5 * self.pitch * self.shape[1], 0.5 * self.pitch * self.shape[0]

    @property
    def columns(self) -> np.ndarray:
        """(columns,) coordinate along u from ``origin`` [mm]."""
        return self.pitch * np.arange(self.shape[1])

    @property
    def rows(self) -> np.ndarray:
        """(rows,) coordinate along v from ``origin`` [mm]."""
        return self.pitch * np.arange(self.shape[0])

    def points(self) -> np.ndarray:
        """World positions (rows * columns, 3) [mm], row-major."""
        grid = self.origin + self.rows[:, None, None] * self.v + self.columns[None, :, None] * self.u
        return grid.reshape(-1, 3)
