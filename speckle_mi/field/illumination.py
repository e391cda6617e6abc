"""The light on the target: of a beam as it is, or of one that optics have changed on its way."""

from __future__ import annotations

import threading

import numpy as np

from ..errors import InputError
from ..plan.setup import Setup
from ..plan.stage import LIGHT, Stage
from ..propagation.costs import Costs
from ..scattering.rough_surface import Scatterers
from ..scene.assembly import Assembly
from ..scene.errors import SceneError
from .light_factor import LightFactor
from .traced_light import TracedLight, aberration

_EXACT = 0.1
"""Of the tolerance, up to which aberrations of the light count for nothing."""

_BOXES_KEPT = 64
"""Boxes around the target whose light is kept."""

_STEPS = 16
"""Boxes begin and end at parts of the beam's width, and of a length along it, so that frames alike share them."""


class Illumination:
    """The light of one laser on the target at any pose. Holds what was summed: see :mod:`..field.traced_light`."""

    def __init__(self, assembly: Assembly, costs: Costs) -> None:
        self._path, self._beam, self._costs = assembly.path, assembly.beam, costs
        self._known: dict[tuple, LightFactor] = {}
        self._lock = threading.Lock()
        self._aberration = 0.0
        if self._path is not None and (self._path.bends or self._path.cut):
            self._aberration = aberration(self._path)

    def on(self, setup: Setup) -> Scatterers:
        """The scatterers under the light, at the pose of a setup. Raises SceneError where it cannot be computed."""
        target, beam = setup.assembly.target, setup.assembly.beam
        if target.points is not None:
            lit = target.points.at(setup.frame).lit_by(beam)
        else:
            lit = target.surface.scatterers(beam, setup.frame).at(setup.frame).lit_by(beam)
        factor = self.beside_beam(setup, lit)
        return lit if factor is None else factor.on(lit)

    def beside_beam(self, setup: Setup, lit: Scatterers) -> LightFactor | None:
        """What optics have made of the light where scatterers are, None where it is that of the beam."""
        tolerance = setup.assembly.options.tolerance
        if self._path is None or lit.count == 0 or not self._needs_sum(tolerance):
            return None
        low, high = self._box(lit.position)
        key = tolerance, *low, *high
        with self._lock:
            if key not in self._known:
                while len(self._known) >= _BOXES_KEPT:
                    self._known.pop(next(iter(self._known)))
                self._known[key] = self._summed(low, high, tolerance)
            return self._known[key]

    def stages(self, setup: Setup, lit: Scatterers) -> tuple[Stage, ...]:
        """What was done for the light, with its error."""
        if self._path is None:
            return ()
        factor = self.beside_beam(setup, lit)
        if factor is not None:
            error = float(np.hypot(factor.error, factor.beside if self._path.cut else 0.0))
            return (Stage(LIGHT, way=self._path.label, nodes=factor.nodes, error=error),)
        if not self._path.bends:
            return (Stage(LIGHT, way=self._path.label),)
        return (Stage(LIGHT, way=self._path.label, reason="along its axis", error=self._aberration),)

    def _needs_sum(self, tolerance: float) -> bool:
        return bool(self._path.cut) or self._aberration > _EXACT * tolerance

    def _summed(self, low: np.ndarray, high: np.ndarray, tolerance: float) -> LightFactor | None:
        try:
            return TracedLight(self._path, self._beam, tolerance, self._costs).factor(low, high)
        except InputError as error:
            if not self._path.cut:
                return None  # the Gaussian beam along its axis stands for it, with its error
            names = " and ".join(dict.fromkeys(repr(self._path.names[number]) for number in self._path.cut))
            raise SceneError(
                f"light over {self._path.label}: {names} cuts it, and what comes of that is not computed: {error}; "
                "make the beam narrower, or what cuts it wider"
            ) from None

    def _box(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A box in the beam's coordinates around points (n, 3), larger than it needs to be by a trace."""
        local = (points - self._beam.reference) @ self._beam.axes
        low, high = local.min(axis=0), local.max(axis=0)
        size = np.maximum(high - low, 1e-3 * float(np.max(self._beam.radii)))
        step = 2.0 ** np.ceil(np.log2(size)) / _STEPS
        return np.floor(low / step - 0.5) * step, np.ceil(high / step + 0.5) * step
