"""What the camera alone makes a measured sensitivity uncertain by."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..experiments.chief_ray import axes_as_seen
from ..experiments.expectation import AXES, on_all_axes
from ..field.simulation import Simulation
from ..geometry.pose import Pose
from ..measurement.correlator import Correlator
from ..scene.assembly import Assembly


def camera_uncertainty(assemblies: Mapping[str, Assembly], width: float) -> np.ndarray:
    """(d, 6 axes, 6 motions) standard uncertainty [mm/mm or mm/deg] by camera noise, NaN where no camera is described.

    That of the shift between two pictures of the same light, over the rms of displacements spread evenly over a range
    of ``width`` [mm or deg], as the scatter of surfaces is stated.
    """
    found = np.full((len(assemblies), len(AXES), 6), np.nan)
    for number, assembly in enumerate(assemblies.values()):
        if assembly.camera is None:
            continue
        simulation = Simulation(assembly)
        first, second = (simulation.frame(Pose(), shot=shot).image.measured for shot in (0, 1))
        shift = Correlator(first).shift(second)
        sigma = np.diag([shift.sigma_u_px, shift.sigma_v_px]) * assembly.detector.pitch
        along = on_all_axes(sigma, assembly, axes_as_seen(assembly, simulation.plan(Pose())))
        found[number, :4] = (np.linalg.norm(along, axis=1) * np.sqrt(12) / width)[:, None]
    return found
