r"""
.. _emitter-laser:

Laser (:monosp:`laser`)
-----------------------

.. pluginparameters::

 * - to_world
   - |transform|
   - Place of the laser and its direction, local +z. Aim it at the origin of the target. Only rotation and translation.
   - |exposed|
 * - wavelength
   - |float|
   - Vacuum wavelength [nm]. (Required)
   - |exposed|
 * - beam_radius
   - |float|
   - 1/e^2 intensity radius where the beam meets the target at rest, perpendicular to it [mm].
     (Default: inf, uniform light)
   - |exposed|
 * - wavefront_radius
   - |float|
   - Radius of curvature of the wavefront where the beam meets the target at rest [mm]; positive: diverging,
     negative: converging. (Default: inf, collimated)
   - |exposed|

A coherent Gaussian beam. Its light reaches the target unobstructed: it is not traced through the elements between
target and detector. The wavefront radius is independent of the laser's distance, since collimating optics
usually stand in the laser. To other integrators it is a collimated beam of one unit of power.

Both radii are those at one place, where the beam's axis meets the target at rest. From there on they follow Gaussian
optics: with the wavelength they determine the waist, w(s) = w |1 + s (1/R + i lambda/(pi w^2))| at the distance s along
the axis, through which the light goes on as a diverging beam, with Gouy's phase. A target that is moved along the beam
is lit by the radius there. Wavefronts are spheres of the local radius, so that far from the waist the light is a
spherical wave. The field's relative error is about the square of the divergence, lambda/(pi w_waist) [rad]: 3e-6 for a
waist of 0.12 mm, 2e-3 for one of 5 um; more than 0.35 rad is refused.

Uniform light has the same amplitude everywhere; spherical, it goes through a point focus, behind which it diverges
with the opposite sign.

.. tabs::
    .. code-tab:: xml

        <emitter type="laser">
            <transform name="to_world"><lookat origin="-28.68,0,40.96" target="0,0,0" up="0,1,0"/></transform>
            <float name="wavelength" value="632.8"/>
            <float name="beam_radius" value="0.12"/>
            <float name="wavefront_radius" value="-750"/>
        </emitter>

    .. code-tab:: python

        'type': 'laser', 'wavelength': 632.8, 'beam_radius': 0.12, 'wavefront_radius': -750.0,
        'to_world': mi.ScalarTransform4f().look_at(origin=[-28.68, 0, 40.96], target=[0, 0, 0], up=[0, 1, 0])
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from speckle_mi.scattering.beam import Beam
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, value_of
from ._numbers import check_numbers, expose, read_numbers
from ._placement import Placement

_LIMITS = {
    "wavelength": {"at_least": 1.0, "at_most": 1e6, "unit": "nm"},
    "beam_radius": {"at_least": 1e-6, "at_most": 1e5, "infinite": True, "unit": "mm"},
    "wavefront_radius": {"infinite": True, "unit": "mm"},
}
_DEFAULTS = {"beam_radius": np.inf, "wavefront_radius": np.inf}

_STEEPEST = 0.35
"""Largest divergence [rad] of a beam: its field is then off by a tenth, see :class:`Beam`."""

_SHORTEST, _LONGEST = 1e-9, 1e15
"""Size of a wavefront radius [mm] that double precision can square and take from a path."""


class Laser(mi.Emitter):
    role = "laser"

    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        read_numbers(self, props, _LIMITS, _DEFAULTS)
        self._check()
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.DeltaDirection

    def beam(self) -> Beam:
        """The beam, with its wavefront radius given at the laser's own place until it is aimed at a target."""
        frame = self.placement.frame
        return Beam(
            origin=frame.origin,
            axis=frame.axes[:, 2],
            radius=value_of(self.beam_radius),
            wavefront_radius=value_of(self.wavefront_radius),
            wavelength=value_of(self.wavelength) * 1e-6,
            reference=frame.origin,
        )

    def _check(self) -> None:
        check_numbers(self, _LIMITS)
        radius = abs(value_of(self.wavefront_radius))
        if not (_SHORTEST <= radius <= _LONGEST or np.isinf(radius)):
            raise SceneError(
                f"{self.where}: parameter 'wavefront_radius' is {value_of(self.wavefront_radius):g} mm, must not be 0 "
                f"but {_SHORTEST:g} to {_LONGEST:g} mm in size, or inf (collimated)"
            )
        divergence = self.beam().divergence
        if divergence > _STEEPEST:
            raise SceneError(
                f"{self.where}: a beam of beam_radius {value_of(self.beam_radius):g} mm and wavefront_radius "
                f"{value_of(self.wavefront_radius):g} mm diverges by {divergence:.3g} rad from its waist, must diverge "
                f"by at most {_STEEPEST} rad: steeper light is not a Gaussian beam"
            )

    # What other integrators see: a collimated beam whose irradiance is that of one unit of power.

    def sample_direction(self, it, sample, active=True):
        frame = self.placement.frame
        axis = mi.Vector3f(*frame.axes[:, 2].tolist())
        offset = it.p - mi.Point3f(*frame.origin.tolist())
        distance = dr.dot(offset, axis)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p = it.p - distance * axis
        ds.n = axis
        ds.d = -axis
        ds.dist = distance
        ds.time = it.time
        ds.pdf = 1.0
        ds.delta = True
        ds.emitter = mi.EmitterPtr(self)
        return ds, self._irradiance(offset - distance * axis) & (active & (distance > 0))

    def eval_direction(self, it, ds, active=True):
        return mi.Spectrum(0.0)

    def pdf_direction(self, it, ds, active=True):
        return mi.Float(0.0)

    def eval(self, si, active=True):
        return mi.Spectrum(0.0)

    def _irradiance(self, across):
        radius = value_of(self.beam_radius)
        if np.isinf(radius):
            return mi.Spectrum(1.0)
        return mi.Spectrum(2 / (np.pi * radius**2) * dr.exp(-2 * dr.squared_norm(across) / radius**2))

    def bbox(self):
        return self.placement.bbox()

    def world_transform(self):
        return self.placement.to_world

    def traverse(self, callback) -> None:
        expose(self, _LIMITS, callback)

    def parameters_changed(self, keys) -> None:
        self.placement.parameters_changed(keys, self.where)
        self._check()

    def to_string(self) -> str:
        return (
            f"Laser[wavelength = {value_of(self.wavelength)} nm, beam_radius = {value_of(self.beam_radius)} mm, "
            f"wavefront_radius = {value_of(self.wavefront_radius)} mm]"
        )


mi.register_emitter("laser", Laser)
