"""What the benchmark measures on: the paper's tilted laser, with any number of scatterers under its beam."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...geometry.plane import PlaneGrid
from ...scattering.rough_surface import illuminated_scatterers
from ...scene.write import Default, aimed, detector, direction, integrator, laser, rough_target, scene_text

SCENE = scene_text(
    integrator(),
    laser(aimed(50 * direction(35, 180), x_hint=(1.0, 0.0, 0.0)), beam_radius=0.12, wavefront_radius=-750.0),
    rough_target(width=4.0, height=4.0, roughness=0.8, point_sources=Default("point_sources", 100)),
    detector(aimed(60 * direction(0)), Default("width", 744), Default("height", 480)),
)
"""The paper's tilted laser (Opt. Eng. 61(6) 061410, 2022, Fig. 5a), as in scenes/tilted_laser.xml."""

_PROBED_DENSITY = 1e5
"""Scatterers [1/mm^2] by whose number the lit area is measured: some ten thousand, known to a percent."""


@dataclass(frozen=True)
class Specimen:
    """An assembly, and the area [mm^2] of its target that scatterers are summed from."""

    assembly: object
    lit_area: float

    @classmethod
    def of(cls, assembly) -> Specimen:
        target = assembly.target
        surface = replace(target.surface, density=_PROBED_DENSITY)
        return cls(assembly, illuminated_scatterers(surface, assembly.beam, target.frame).count / _PROBED_DENSITY)

    @property
    def grid(self) -> PlaneGrid:
        return self.assembly.detector

    @property
    def wavelength(self) -> float:
        return self.assembly.beam.wavelength

    def denser(self, summed: float):
        """The assembly with about ``summed`` scatterers under the beam, out to where its light ends."""
        target = self.assembly.target
        surface = replace(target.surface, density=summed / self.lit_area)
        return replace(self.assembly, target=replace(target, surface=surface))

    def scatterers(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Places (count, 3) [mm] and amplitudes (count,) of exactly so many scatterers under the beam."""
        target = self.denser(1.1 * count + 20).target
        lit = illuminated_scatterers(target.surface, self.assembly.beam, target.frame)
        pick = np.sort(np.random.default_rng(0).permutation(lit.count)[:count])
        return np.ascontiguousarray(lit.position[pick]), lit.amplitude[pick]
