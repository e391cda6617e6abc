"""What a program works with: the frames of an assembly, and what is measured from them."""

from __future__ import annotations

from ..field.detectors import Simulations
from ..field.simulation import Simulation
from ..geometry.pose import DEGREES_OF_FREEDOM
from .one_frame import RANGE, SURFACES, OneFrameSensitivity, measured_sensitivity


class SensorSimulation(Simulation):
    """Frames of one assembly, their derivatives, and the sensitivities that these tell of."""

    def sensitivity(
        self, dofs: tuple[str, ...] = DEGREES_OF_FREEDOM, surfaces: int = SURFACES, width: float = RANGE
    ) -> OneFrameSensitivity:
        """The sensitivity matrix from one frame of each of some surfaces, with intervals, beside first-order theory.

        dofs: which of x, y, z, rx, ry, rz; surfaces: how many, of the scene's seed and those that follow; width: of the
        range of displacements [mm or deg] for which the scatter of shifts is stated. Raises SceneError where the field
        cannot be computed as asked, InputError where the detector stays dark, or for the method ``rays``.
        """
        return measured_sensitivity(self, dofs, surfaces, width)


class SensorSimulations(Simulations):
    """The same of several detectors that look at one target."""

    of_one = SensorSimulation
