"""The optics that a laser's light comes over to the target, and the beam that they make of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..geometry.frames import Frame
from ..optics.gaussian import CarriedBeam, carried_beam
from ..optics.sequence import Interaction, Sequence, amplitude_of
from ..optics.surface import Surface
from ..optics.trace import trace
from ..scattering.beam import Beam
from ..scattering.beam_kernel import TRUNCATION

AROUND = 16
"""Rays on every ring around the axis that are looked at for what cuts the light."""

RINGS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
"""Radii of these rings, relative to the beam's own radius: beyond the last lies 1.5e-8 of the power."""

_SMALL = 20.0
"""Wavelengths across the light where it leaves the last surface below which rays tell nothing of its wavefront."""

CUT_OFF = 4.0
"""Radii of a beam that something cuts, up to which it is taken into account: its light falls off slowly."""


@dataclass(frozen=True, eq=False)
class LightPath:
    """own: the beam as it leaves the laser, given there; names: of the elements in order; interactions: at each; cut:
    numbers of those whose outlines cut the light."""

    own: Beam
    names: tuple[str, ...]
    interactions: tuple[Interaction, ...]
    cut: tuple[int, ...] = ()

    @property
    def label(self) -> str:
        """The way in words, for example ``laser - lens - lens - target``."""
        return " - ".join(["laser", *self.names, "target"])

    @property
    def bends(self) -> bool:
        """Whether anything on it refracts light, or reflects it from a curved surface."""
        return any(one.bends and not (one.action == "reflect" and one.surface.is_plane) for one in self.interactions)

    @cached_property
    def carried(self) -> CarriedBeam:
        """The beam where it leaves the last surface, with the curvatures that fit its light best.

        Aberrations bend the wavefront beside the axis more or less than on it: what exactly traced rays have beside the
        beam along the axis is fitted by a quadratic form, every ray by its power.
        """
        along = self._along_axis
        if not self.bends:
            return along
        plane = Frame(along.place, np.column_stack([along.basis, along.direction]))
        places, off, weight = self.off_beam(along)
        x, y = plane.to_local(places)[:, :2].T
        size = np.hypot(x, y)
        if len(x) < len(RINGS) * AROUND // 2 or np.average(size, weights=weight) < _SMALL * self.own.wavelength:
            return along
        terms = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=1)
        root = np.sqrt(weight)
        *_, xx, xy, yy = np.linalg.lstsq(terms * root[:, None], off * root, rcond=None)[0] / self.own.wavenumber
        return replace(along, curvatures=along.curvatures + np.array([[xx, xy], [xy, yy]]))

    def off_beam(self, beam: CarriedBeam) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Phases (n,) [rad] of traced rays beside those of a beam where it leaves the last surface, places, powers.

        places: (n, 3) where the rays cross the plane across the beam there; powers: (n,) of their light.
        """
        starts, launches, normal_at = self.rays_around()
        plane = Frame(beam.place, np.column_stack([beam.basis, beam.direction]))
        whole = (replace(one, surface=replace(one.surface, outline=None)) for one in self.interactions)
        traced = trace(Sequence((*whole, Interaction.through(Surface(plane)))), starts, launches)
        good = np.all(np.isfinite(traced.points[-1]), axis=1)
        ring = np.repeat(RINGS, AROUND)[good]
        length = traced.optical_path_length - np.linalg.norm(normal_at - starts, axis=1)
        phase = self.own.log_field(normal_at[good]).imag + self.own.wavenumber * length[good]
        places, weight = traced.points[-1, good], ring * np.exp(-2 * ring**2)
        off = phase - self._beam(beam, beam).log_field(places).imag
        return places, off - np.average(off, weights=weight), weight

    @cached_property
    def _along_axis(self) -> CarriedBeam:
        """The beam where it leaves the last surface, as light close to the axis has it."""
        own = self.own
        outlines = {number: self.interactions[number].surface.outline for number in self.cut}
        stops = {number: float(np.sqrt(np.prod(outline.half_size))) for number, outline in outlines.items()}
        curvatures = np.diag(own.inverse_parameters)
        return carried_beam(self.interactions, own.origin, own.axes, curvatures, own.wavelength, stops)

    @property
    def corners(self) -> np.ndarray:
        """(n, 3) points of the beam's axis: the laser, and every surface [mm]."""
        return np.concatenate([self.own.origin[None], self._along_axis.points])

    def beam_at(self, point: np.ndarray) -> Beam:
        """The Gaussian beam behind the optics, given where its axis comes closest to a point (3,).

        Its strength counts what was lost on the way: that of a beam of all the laser's power is 1.
        """
        last = self.carried
        return self._beam(last, last.on(float((point - last.place) @ last.direction)))

    def _beam(self, last: CarriedBeam, here: CarriedBeam) -> Beam:
        """A beam from the last surface, given at a place of its axis."""
        across, curvatures, _ = here.principal
        axes = np.column_stack([across[:, 0], np.cross(here.direction, across[:, 0]), here.direction])
        with np.errstate(divide="ignore"):
            radii, wavefronts = np.sqrt(self.own.wavelength / (np.pi * curvatures.imag)), 1 / curvatures.real
        strength = self.own.strength * amplitude_of(self.interactions)
        return Beam(
            last.place, axes, radii, wavefronts, self.own.wavelength, here.place, strength, last.path,
            CUT_OFF if self.cut else TRUNCATION,
        )  # fmt: skip

    def rays_around(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays around the axis: starts, launches (n, 3), and the places (n, 3) where they are normal to the wavefront.

        Rings of them on the plane across the beam where it meets the first surface; they start as far before it as the
        laser is.
        """
        own = self.own
        length = float((self.corners[1] - own.origin) @ own.axis) if self.interactions else 0.0
        middle = own.origin + length * own.axis
        angle = 2 * np.pi * np.arange(AROUND) / AROUND
        circle = np.multiply.outer(RINGS, np.stack([np.cos(angle), np.sin(angle)], axis=1)).reshape(-1, 2)
        places = middle + (circle * own.radii_at(middle)) @ own.across
        launches = -own.directions_to_source(places)
        return places - length * launches, launches, places
