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
from ._numbers import check_numbers, expose, read_numbers
from ._placement import Placement

_LIMITS = {"pixel_pitch": {"at_least": 1e-6, "at_most": 1e3, "unit": "mm"}}


class Detector(mi.Sensor):
    role = "detector"

    def __init__(self, props: mi.Properties) -> None:
        self.where = describe(props)
        self.placement = Placement(props)
        read_numbers(self, props, _LIMITS)
        children = {name: child for name, child in props.objects()}
        for name, child in children.items():
            if isinstance(child, mi.Film):
                props[name] = _field_film(child, self.where)
        if not any(isinstance(child, mi.Sampler) for child in children.values()):
            # Mitsuba's own default takes four samples a pixel, and so four times the work.
            props["sampler"] = mi.load_dict({"type": "independent", "sample_count": 1})
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
