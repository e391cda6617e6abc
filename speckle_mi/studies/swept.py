"""Sensitivities of one variant as a sweep measures them: frames of the displaced target against that at rest."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from ..experiments.chief_ray import axes_as_seen
from ..experiments.expectation import AXES, CENTRE_AXES, PATTERN_AXES, on_all_axes
from ..field.detectors import Simulations
from ..geometry.pose import DEGREES_OF_FREEDOM, Pose
from ..measurement.correlator import Correlator
from ..measurement.sensitivity import fit_sensitivity
from ..measurement.speckle_statistics import centre_of_gravity


def swept_sensitivities(
    simulations: Simulations, seeds: Sequence[int], displacements: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Sensitivities (k, d, 6 axes, 6 motions) of k surfaces on d detectors, curvatures, doubt and seconds of a surface.

    curvatures: (k, d, 6) kappa [1/mm^2 or 1/deg^2] of a correlation exp(-kappa q^2), by the farthest frame; doubt: (d,
    6, 6) by the fields' relative L2 error. displacements: (n,) from rest [mm or deg].
    """
    began, names, error = time.perf_counter(), list(simulations.by_detector), 0.0
    measured = np.full((len(seeds), len(names), len(AXES), 6), np.nan)
    curvature = np.full((len(seeds), len(names), 6), np.nan)
    for surface, seed in enumerate(seeds):
        rest = simulations.frames(Pose(), seed)
        error = max(error, *(frame.numerical_error for frame in rest.values()))
        at_rest = {name: frame.image.measured for name, frame in rest.items()}
        correlators = {name: Correlator(image) for name, image in at_rest.items()}
        for column, dof in enumerate(DEGREES_OF_FREEDOM):
            moved = [simulations.frames(Pose(**{dof: float(by)}), seed) for by in displacements]
            for number, (name, one) in enumerate(simulations.by_detector.items()):
                images = [frames[name].image.measured for frames in moved]
                along, correlation = _shifts(one.assembly, one.plan(Pose()), correlators[name], at_rest[name], images)
                for row, axis in enumerate(AXES):
                    weights = None if axis in CENTRE_AXES else correlation[None]
                    fit = fit_sensitivity(displacements, along[row][None], weights)
                    measured[surface, number, row, column] = fit.value
                farthest = int(np.argmax(np.abs(displacements)))
                left = np.clip(correlation[farthest], 1e-6, 1 - 1e-9)
                curvature[surface, number, column] = -np.log(left) / displacements[farthest] ** 2
    size = np.linalg.norm(measured[:, :, :2].mean(axis=0), axis=1, keepdims=True)
    doubt = np.broadcast_to(error * size, measured.shape[1:])
    return measured, curvature, doubt, (time.perf_counter() - began) / len(seeds)


def _shifts(assembly, plan, correlator: Correlator, rest: np.ndarray, images) -> tuple[np.ndarray, np.ndarray]:
    """Shifts (6, n) [um] along all axes and heights (n,) of the correlation's peak, NaN where there is none."""
    pixel, seen = 1e3 * assembly.detector.pitch, axes_as_seen(assembly, plan)
    shifts = [correlator.shift(image) for image in images]
    pattern = np.array([[one.u_px for one in shifts], [one.v_px for one in shifts]]) * pixel
    centre = np.array([np.subtract(centre_of_gravity(image), centre_of_gravity(rest)) for image in images]).T * pixel
    along = np.concatenate([on_all_axes(pattern, assembly, seen), centre])
    assert len(along) == len(PATTERN_AXES) + len(CENTRE_AXES)
    return along, np.array([one.ncc for one in shifts])
