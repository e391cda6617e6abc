"""Where a plugin stands: its ``to_world``, exposed to ``mi.traverse`` and kept in float64."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from speckle_mi.geometry.frames import Frame
from speckle_mi.scene.parameters import check_rigid, read_rigid_transform


class Placement:
    """The rigid transform of a plugin.

    Mitsuba's own transforms are single precision, which moves a part by micrometres at a distance of metres. The
    double-precision transform of the scene file therefore stays in use until ``to_world`` is changed.
    """

    def __init__(self, props: mi.Properties) -> None:
        self.put(read_rigid_transform(props))

    def put(self, matrix: np.ndarray) -> None:
        """Takes a rigid (4, 4) transform in double precision."""
        self.frame = Frame(origin=matrix[:3, 3].copy(), axes=matrix[:3, :3].copy())
        self.to_world = mi.Transform4f(matrix)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        """The box of a plugin without extent: the place where it stands."""
        point = mi.ScalarPoint3f(*self.frame.origin.tolist())
        return mi.ScalarBoundingBox3f(point, point)

    def traverse(self, callback) -> None:
        callback.put("to_world", self.to_world, mi.ParamFlags.NonDifferentiable)

    def parameters_changed(self, keys, where: str) -> None:
        """Takes a changed ``to_world`` over; SceneError if it does more than rotate and translate."""
        if "to_world" in keys:
            matrix = np.asarray(self.to_world.matrix, dtype=np.float64).reshape(4, 4, -1)[..., 0]
            self.put(check_rigid(where, matrix))
