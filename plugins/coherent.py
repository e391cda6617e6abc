r"""
.. _integrator-coherent:

Coherent integrator (:monosp:`coherent`)
----------------------------------------

.. pluginparameters::

 * - method
   - |string|
   - ``auto`` chooses the fastest way that keeps the tolerance, ``direct`` sums every pair of scatterer and pixel,
     ``fast`` always expands, ``rays`` interpolates the paths of a fan of rays. (Default: auto)
   -
 * - tolerance
   - |float|
   - Largest relative L2 error of the field for ``auto`` and ``fast``, 1e-8 to 1e-1. (Default: 1e-4)
   -
 * - diffraction
   - |boolean|
   - Whether light is diffracted at openings; otherwise they cast geometric shadows. (Default: true)
   -
 * - rays_per_source
   - |integer|
   - Rays of each scatterer, for ``rays`` only, 16 to 1000000. (Default: 1500)
   -

Adds up the complex field exp(+i k L) of every scatterer of the ``rough_target`` under the ``laser`` on the pixels of
the ``detector``, with L the optical path length. Its images have the channels ``Y``, ``E.re`` and ``E.im``, and ``DN``
where the detector describes a camera.

.. tabs::
    .. code-tab:: xml

        <integrator type="coherent">
            <string name="method" value="auto"/>
            <float name="tolerance" value="1e-4"/>
        </integrator>

    .. code-tab:: python

        'type': 'coherent', 'method': 'auto', 'tolerance': 1e-4
"""

from __future__ import annotations

import warnings

import mitsuba as mi
import numpy as np

from speckle_mi.field.ray_method import FEWEST_RAYS
from speckle_mi.field.simulation import Simulation
from speckle_mi.machine import llvm
from speckle_mi.scene.assembly import Assembly, Options
from speckle_mi.scene.read import assembly_from_scene
from speckle_mi.scene.parameters import describe, read_boolean, read_choice, read_integer, read_number

_METHODS = ("auto", "direct", "fast", "rays")


class Coherent(mi.SamplingIntegrator):
    role = "coherent"

    def __init__(self, props: mi.Properties) -> None:
        if mi.variant().startswith("llvm"):
            llvm.require_usable()
        self.where = describe(props)
        self.options = Options(
            method=read_choice(props, "method", Options.method, _METHODS),
            tolerance=read_number(props, "tolerance", Options.tolerance, at_least=1e-8, at_most=1e-1),
            diffraction=read_boolean(props, "diffraction", Options.diffraction),
            rays_per_source=read_integer(
                props, "rays_per_source", Options.rays_per_source, at_least=FEWEST_RAYS, at_most=10**6
            ),
        )
        self.simulation: Simulation | None = None
        super().__init__(props)

    def aov_names(self) -> list[str]:
        return ["E.re", "E.im"]

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        frame = self._simulation_of(assembly_from_scene(scene, sensor, spp)).frame()
        for warning in frame.warnings:
            warnings.warn(warning, stacklevel=2)
        film = sensor.film()
        film.prepare(self.aov_names() + list(_further_channels(frame.image)))
        film.put_block(mi.ImageBlock(_film_channels(frame.image)))
        return film.develop() if develop else mi.TensorXf()

    def _simulation_of(self, assembly: Assembly) -> Simulation:
        """That of the last render where nothing has changed since, so that plans and geometry are made once."""
        held = self.simulation
        if held is None or held.assembly != assembly:
            self.simulation = held = Simulation(assembly)
        return held

    def to_string(self) -> str:
        return f"Coherent[method = {self.options.method}, tolerance = {self.options.tolerance}]"


def _further_channels(image) -> dict[str, np.ndarray]:
    """A camera's numbers, and the fields of several lasers, by the names of their channels."""
    channels = {} if image.dn is None else {"DN": image.dn}
    for name, values in image.layers.items():
        channels |= {f"{name}.re": values.real, f"{name}.im": values.imag}
    return channels


def _film_channels(image) -> mi.TensorXf:
    """The image as a film stores it: R, G, B, weight, then the field, and what else there is."""
    further = _further_channels(image)
    rows, columns = image.intensity.shape
    channels = np.empty((rows, columns, 6 + len(further)), dtype=np.float32)
    channels[..., :3] = image.intensity[..., None]
    channels[..., 3] = 1
    channels[..., 4] = image.field.real
    channels[..., 5] = image.field.imag
    for number, values in enumerate(further.values(), start=6):
        channels[..., number] = values
    return mi.TensorXf(channels)


mi.register_integrator("coherent", Coherent)
