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
   - Vacuum wavelength [nm]; as a |string| also of several lines, such as ``632.8, 780``. (Required)
   - |exposed|
 * - wavelengths
   - |string|
   - The same as ``wavelength`` with several.
   -
 * - weights
   - |string|
   - Powers of these lines relative to one another. (Default: all alike)
   -
 * - linewidth
   - |float|
   - Full width at half maximum of a line's Gaussian spectrum [nm], at most 5 % of the wavelength. (Default: 0)
   - |exposed|
 * - spectral_samples
   - |integer|
   - Wavelengths that stand for a line with a width, odd, 3 to 999. (Default: 15)
   -
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
 * - beam_radius_x, beam_radius_y
   - |float|
   - The same as ``beam_radius``, along the laser's local x and y axes: an elliptical beam. (Default: ``beam_radius``)
   - |exposed|
 * - wavefront_radius_x, wavefront_radius_y
   - |float|
   - The same as ``wavefront_radius``, along the laser's local x and y axes: an astigmatic beam.
     (Default: ``wavefront_radius``)
   - |exposed|
 * - traced
   - |boolean|
   - Whether its light goes over what stands on its way to the target; its radii are then those where the laser stands.
     (Default: false)
   -
 * - power
   - |float|
   - Power of the beam [mW], of all its lines together, from which a detector's ``exposure`` makes electrons. Of several
     lasers all or none say it. (Default: not said)
   -

A coherent Gaussian beam. Unless it is ``traced`` its light reaches the target unobstructed, whatever stands there, and
the wavefront radius is independent of the laser's distance, since collimating optics usually stand in the laser. To
other integrators it is a collimated beam of one unit of power.

With ``traced`` the light goes through collimators, over fold mirrors and beam splitters, past edges: its axis is
followed to the target at rest, exactly, and the Gaussian beam is carried along it. ``beam_radius`` and
``wavefront_radius`` are then the laser's own, at its place, where a diode has its waist (``inf``). What lenses and
edges make of the light beside that (aberrations, diffraction at every outline that cuts it within three radii) is a
Rayleigh-Sommerfeld sum over the beam's cross-section with exactly traced paths, to the scene's tolerance; where that
takes too many nodes (a wide beam far out of focus) the Gaussian beam stands for it, and its aberrations, as rays have
them, are part of the stated error. Losses count: the field is in units of a beam of the same radii with all the power.
Left out are ghosts, light that misses the way of the axis, and what detectors keep off; first-order theory takes the
Gaussian beam. Refused, by name, are light whose axis is blocked, that comes by two ways or is cut beside its way by
something that is no opening on it, and light without a ``beam_radius``.

Both radii are those at one place, where the beam's axis meets the target at rest (the laser, if traced). From there on
they follow Gaussian optics: with the wavelength they determine the waist, w(s) = w |1 + s (1/R + i lambda/(pi w^2))| at
the distance s along the axis, through which the light goes on as a diverging beam, with Gouy's phase. A target that is
moved along the beam is lit by the radius there. Wavefronts are spheres of the local radius, so that far from the waist
the light is a spherical wave. The field's relative error is about the square of the divergence, lambda/(pi w_waist)
[rad]: 3e-6 for a waist of 0.12 mm, 2e-3 for one of 5 um; more than 0.35 rad is refused.

A laser diode's beam is wider along its fast axis, and may have its two waists at two places. The local x and y axes are
the beam's own: ``to_world`` turns them (``up`` of a ``lookat`` is the local y axis as far as the direction allows, and
x is across both). Each axis then has its own waist and half of Gouy's phase. Wavefronts are spheres where both
curvatures are equal, cylinders where one is zero, and between these to the square of the divergence; scatterers are
counted in the ellipse of both radii (``point_sources`` of the target).

Light of different wavelengths and of different lasers is incoherent: the detector sees the sum of the intensities. All
of it lights the same scatterers, which lie as densely as the light asks for that needs them most densely. Every field
stands in the image's file: ``E.re``, ``E.im`` are those of the first laser's first line; of several lasers or lines
each laser has a layer ``<id>.E`` as well, and a further line number n of it ``<id>.line<n>.E``. The lines of a laser
share its power by their ``weights``, which are in their fields. Where the lasers' powers are said, all fields are in
proportion to the roots of what falls on a unit of the surface, in the unit in which the first laser's is that of its
beam alone; otherwise each has its own unit, the same amplitude in the middle of its spot. A camera counts photons: of
light of twice the wavelength twice as many.

A line with a ``linewidth`` is summed at ``spectral_samples`` wavelengths evenly spaced in wavenumber, which takes as
many times as long as one; the field written is that of its middle. Where paths differ by dL, its light is coherent by
exp(-(pi dL linewidth/wavelength^2)^2 / (4 ln 2)). More samples are needed the longer the paths are that differ: a
warning says when there are too few.

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
        <emitter type="laser">   <!-- a diode: wider across the plane of incidence, astigmatic -->
            <transform name="to_world"><lookat origin="-28.68,0,40.96" target="0,0,0" up="0,1,0"/></transform>
            <float name="wavelength" value="785"/>
            <float name="beam_radius_x" value="0.1"/> <float name="beam_radius_y" value="0.3"/>
            <float name="wavefront_radius_x" value="-200"/> <float name="wavefront_radius_y" value="-280"/>
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
from speckle_mi.scene.parameters import describe, read_boolean, read_number
from ._beam import beam_of, check_beam, read_beam
from ._numbers import expose, in_words
from ._placement import Placement
from ._spectrum import LaserLine, check_spectrum, lines_of, read_spectrum, wavelengths_of

_POWER = {"above": 0.0, "at_most": 1e9, "unit": "mW"}


class Laser(mi.Emitter):
    role = "laser"

    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        self.spectrum = read_spectrum(self, props)
        self.shape = read_beam(self, props)
        self.traced = read_boolean(props, "traced", False)
        self.power = read_number(props, "power", **_POWER) if "power" in props else None
        self._check()
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.DeltaDirection

    def beam(self) -> Beam:
        """The beam of the longest wavelength, given at the laser's own place until it is aimed at a target."""
        return beam_of(self, max(wavelengths_of(self)) * 1e-6)

    def lines(self) -> list[LaserLine]:
        """All its light, incoherent from one wavelength to the next."""
        return lines_of(self)

    def _check(self) -> None:
        check_spectrum(self, self.spectrum)
        check_beam(self, self.shape, self.beam)
        if self.traced and self.beam().is_uniform:
            raise SceneError(f"{self.where}: is traced, but has no 'beam_radius': light without a width has no end")

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
        beam = self.beam()
        if beam.is_uniform:
            return mi.Spectrum(1.0)
        inverse = [mi.Vector3f(*(axis / radius).tolist()) for axis, radius in zip(beam.across, beam.radii, strict=True)]
        squares = sum(dr.dot(across, axis) ** 2 for axis in inverse)
        return mi.Spectrum(2 / (np.pi * beam.radius**2) * dr.exp(-2 * squares))

    def bbox(self):
        return self.placement.bbox()

    def world_transform(self):
        return self.placement.to_world

    def traverse(self, callback) -> None:
        expose(self, (*self.spectrum, *self.shape), callback)

    def parameters_changed(self, keys) -> None:
        self.placement.parameters_changed(keys, self.where)
        self._check()

    def to_string(self) -> str:
        colours = ", ".join(f"{wavelength:g}" for wavelength in wavelengths_of(self))
        return f"Laser[wavelength = {colours} nm, {in_words(self, self.shape, ' mm')}]"


mi.register_emitter("laser", Laser)
