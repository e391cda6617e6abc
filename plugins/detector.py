r"""
.. _sensor-detector:

Detector (:monosp:`detector`)
-----------------------------

.. pluginparameters::

 * - to_world
   - |transform|
   - Place of the detector's centre; its local +z looks at the light. Only rotation and translation.
   - |exposed|
 * - pixel_pitch
   - |float|
   - Distance of neighbouring pixels' centres [mm]. (Required)
   - |exposed|
 * - film
   - |film|
   - Numbers of pixels (``width``, ``height``).
   -

A camera, described by any of these; the image then has a channel ``DN`` with the numbers that it hands out:

.. pluginparameters::

 * - mean_electrons
   - |float|
   - Mean photoelectrons of a pixel: each frame is exposed so that its own mean is this [e-]. (Default: an eighth of
     the full well; 1000 without one; not with ``exposure``)
   -
 * - exposure
   - |float|
   - Exposure time [s]: electrons follow from the laser's ``power``, all of which falls on the target and is scattered
     evenly into its half space, or as its BSDF does with ``lobe``.
   -
 * - quantum_efficiency
   - |float|
   - Electrons a photon on the sensitive part, for ``exposure``. (Default: 1)
   -
 * - full_well
   - |float|
   - Charge at which a pixel saturates [e-]. (Default: none; with ``bit_depth`` eight times ``mean_electrons``)
   -
 * - bit_depth
   - |integer|
   - Bits of a number, 1 to 16. (Default: none, numbers count electrons and have no largest)
   -
 * - gain
   - |float|
   - Electrons for one step of a number [e-/DN]. (Default: full_well / (2^bit_depth - 1), 1 without ``bit_depth``)
   -
 * - black_level
   - |float|
   - Number without light or noise [DN]: what a read-out below it may fall to before it is cut off at 0. (Default: 0)
   -
 * - read_noise
   - |float|
   - Of the read-out, rms [e-]. (Default: 0)
   -
 * - dark_electrons
   - |float|
   - Mean electrons of a pixel in a frame that no light freed [e-]. (Default: 0)
   -
 * - prnu
   - |float|
   - Relative rms by which the pixels' responses differ, the same in every frame. (Default: 0)
   -
 * - fill_factor
   - |float|
   - Part of the pixel's area that is sensitive: a square in its middle, over which sub-pixels are spread and the
     intensity is averaged, by default over 9 of them. (Default: 1)
   -
 * - noise_seed
   - |integer|
   - Which camera: its noise and its pixels' responses. (Default: 0)
   -

Photons and dark electrons are Poisson numbers, read-out noise is normal: :mod:`speckle_mi.images.camera` has the
formula. Noise is a function of ``noise_seed``, the detector's id, the surface and the pose: the same frame is the same
picture, another one has independent noise. Of several detectors each must have an id.

A bare image sensor without a lens of its own: the field is computed in its plane. Seen along +z with +y up, columns
count to the right and rows downwards, as in every Mitsuba sensor; in the world, columns run along the local -x axis
and rows along the local -y axis. Images have the channels ``E.re`` and ``E.im``, the field at the pixel's centre,
and ``Y``, the intensity: by default |E|^2 at the pixel's centre; with a ``sampler`` whose ``sample_count`` is above 1
the mean over that many sub-pixels (rounded up to a square), as a pixel without gaps to its neighbours measures it.

To other integrators it is an irradiance meter.

.. tabs::
    .. code-tab:: xml

        <sensor type="detector">
            <transform name="to_world"><lookat origin="0,0,60" target="0,0,0" up="0,1,0"/></transform>
            <float name="pixel_pitch" value="0.006"/>
            <float name="mean_electrons" value="2000"/> <float name="read_noise" value="3"/>
            <float name="full_well" value="10000"/> <integer name="bit_depth" value="12"/>
            <film type="hdrfilm"> <integer name="width" value="744"/> <integer name="height" value="480"/> </film>
        </sensor>

    .. code-tab:: python

        'type': 'detector', 'pixel_pitch': 0.006, 'film': {'type': 'hdrfilm', 'width': 744, 'height': 480},
        'to_world': mi.ScalarTransform4f().look_at(origin=[0, 0, 60], target=[0, 0, 0], up=[0, 1, 0])
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from speckle_mi.geometry.plane import PlaneGrid
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, value_of
from ._camera import read_camera
from ._numbers import check_numbers, expose, read_numbers
from ._placement import Placement

_LIMITS = {"pixel_pitch": {"at_least": 1e-6, "at_most": 1e3, "unit": "mm"}}

_OVER_SENSITIVE_PART = 9
"""Sub-pixels that a pixel is averaged over where only its fill factor is said: within 2 % for speckle of 3 px."""


class Detector(mi.Sensor):
    role = "detector"

    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        read_numbers(self, props, _LIMITS)
        self.camera = read_camera(props)
        children = {name: child for name, child in props.objects()}
        for name, child in children.items():
            if isinstance(child, mi.Film):
                props[name] = _field_film(child, self.where)
        if not any(isinstance(child, mi.Sampler) for child in children.values()):
            # Mitsuba's own default takes four samples a pixel, and so four times the work.
            count = _OVER_SENSITIVE_PART if "fill_factor" in props else 1
            props["sampler"] = mi.load_dict({"type": "independent", "sample_count": count})
        super().__init__(props)

    def grid(self) -> PlaneGrid:
        """The pixel centres."""
        frame, pitch = self.placement.frame, value_of(self.pixel_pitch)
        columns, rows = (int(n) for n in self.film().size())
        u, v = -frame.axes[:, 0], -frame.axes[:, 1]
        corner = frame.origin - pitch * ((columns - 1) / 2 * u + (rows - 1) / 2 * v)
        return PlaneGrid(origin=corner, u=u, v=v, pitch=pitch, shape=(rows, columns))

    # What other integrators see: rays from all directions in front of the pixel, cosine-weighted.

    def sample_ray(self, time, wavelength_sample, position_sample, aperture_sample, active=True):
        grid, axes = self.grid(), self.placement.frame.axes
        rows, columns = grid.shape
        corner = mi.Point3f(*(grid.origin - 0.5 * grid.pitch * (grid.u + grid.v)).tolist())
        u, v = (
            mi.Vector3f(*grid.u.tolist()) * (grid.pitch * columns),
            mi.Vector3f(*grid.v.tolist()) * (grid.pitch * rows),
        )
        local = mi.warp.square_to_cosine_hemisphere(aperture_sample)
        wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), wavelength_sample, active)
        ray = dr.zeros(mi.Ray3f)
        ray.o = corner + position_sample.x * u + position_sample.y * v
        ray.d = sum((local[k] * mi.Vector3f(*axes[:, k].tolist()) for k in range(3)), start=mi.Vector3f(0))
        ray.maxt = dr.largest(mi.Float)
        ray.time = time
        ray.wavelengths = wavelengths
        return ray, weight * dr.pi

    def needs_aperture_sample(self):
        return True

    def bbox(self):
        return self.placement.bbox()

    def world_transform(self):
        return self.placement.to_world

    def traverse(self, callback) -> None:
        super().traverse(callback)
        expose(self, _LIMITS, callback)

    def parameters_changed(self, keys) -> None:
        super().parameters_changed(keys)
        self.placement.parameters_changed(keys, self.where)
        check_numbers(self, _LIMITS)

    def to_string(self) -> str:
        columns, rows = self.film().size()
        return f"Detector[{columns} x {rows} pixels, pixel_pitch = {value_of(self.pixel_pitch)} mm]"


def _field_film(film: mi.Film, where: str) -> mi.Film:
    """A film of the same size that stores one intensity and the field in single precision, without a filter."""
    if tuple(film.crop_size()) != tuple(film.size()):
        raise SceneError(
            f"{where}: the film is cropped to {tuple(film.crop_size())}, must be whole: set width and height"
        )
    columns, rows = (int(n) for n in film.size())
    return mi.load_dict(
        {
            "type": "hdrfilm",
            "width": columns,
            "height": rows,
            "pixel_format": "luminance",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        }
    )


mi.register_sensor("detector", Detector)
