"""What a scene holds, as plain float64 data: laser beam, target, elements and detector.

Everything after this room works on an :class:`Assembly`: a value without any object of Mitsuba's in it, that can be
compared, hashed, pickled and sent to another process.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..geometry.frames import Frame
from ..geometry.plane import PlaneGrid
from ..geometry.pose import Pose
from ..images.camera import Camera
from ..machine.fingerprint import fingerprint
from ..scattering.beam import Beam
from ..scattering.footprint import mean_plane_normal
from ..scattering.rough_surface import PointScatterers, RoughSurface
from .body import Body
from .elements import Element
from .light_path import LightPath

GRAZING = 1e-9
"""Cosine of the angle of incidence below which the beam cannot light the target."""


@dataclass(frozen=True)
class Options:
    """What the integrator was asked for."""

    method: str = "auto"
    tolerance: float = 1e-4
    diffraction: bool = True
    rays_per_source: int = 1500


@dataclass(frozen=True, eq=False)
class Target:
    """The rough target at rest.

    frame: its place; surface or points: what scatters; body: its mesh, in its own frame; lobe: the BSDF that shapes its
    radiation, as ``mi.load_dict`` takes it, None for even radiation; point_sources: what the scene asked for; where:
    how messages call it.
    """

    frame: Frame
    surface: RoughSurface
    points: PointScatterers | None
    body: Body
    lobe: dict | None = None
    point_sources: int = field(default=0, compare=False)
    where: str = field(default="target", compare=False)

    @property
    def is_flat(self) -> bool:
        """Whether it is a single plane patch, which cannot shade itself."""
        return self.surface.facets.count == 1


@dataclass(frozen=True, eq=False)
class Light:
    """Light of one wavelength on the target, incoherent with all other: its intensity adds to theirs.

    name: of its field in an image's file, None for a sample of a line beside the line's middle; elements: as they are
    at its wavelength; index: of the medium around everything; weight: factor of its intensity in the image's; path: the
    optics that it has come over to the target, None where it is not traced.
    """

    name: str | None
    beam: Beam
    elements: tuple[Element, ...]
    index: float
    weight: float = 1.0
    path: LightPath | None = None


@dataclass(frozen=True)
class Spot:
    """Middle of what scatters: point (3,) [mm] and unit normal (3,), world, of the surface that is lit there.

    On a mesh the normal is that of the plane which fits the facets under the beam best.
    """

    point: np.ndarray
    normal: np.ndarray


@dataclass(frozen=True, eq=False)
class Assembly:
    """One beam, one target, one detector, the elements between, and what the scene asks of the integrator.

    pose: where the scene has its target, displaced from rest; sub_pixels: side of the square of sub-pixels that the
    intensity is averaged over; index: refractive index of the medium around everything, 1 for air. The beam's
    wavelength is that in this medium, and the elements' indices are relative to it. camera: what the detector's image
    goes through, None where nothing is said of it; power: of the laser [mW], None where it is not said.

    Of several lasers, or one of several lines or of a line with a width, the first is ``beam`` and the others are
    ``further``: incoherent with it, their intensities add up. light, weight: what the first is called, and its
    intensity's factor; longest_path: path difference [mm] up to which the samples of a line stand for it; in_spot:
    expected scatterers within the first beam's radii; path: the optics that the first light has come over to the
    target, None where it is not traced. Where the lasers' powers are said, fields are in proportion.
    """

    beam: Beam
    target: Target
    elements: tuple[Element, ...]
    detector: PlaneGrid
    options: Options
    pose: Pose
    sub_pixels: int = 1
    index: float = 1.0
    camera: Camera | None = None
    power: float | None = None
    light: str | None = field(default="laser", compare=False)
    weight: float = 1.0
    further: tuple[Light, ...] = ()
    longest_path: float = np.inf
    in_spot: float = field(default=0.0, compare=False)
    path: LightPath | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Assembly) and self._whole == other._whole

    def __hash__(self) -> int:
        return int(self._whole, 16)  # the same in every process, as texts' hashes are not

    @property
    def parts(self) -> tuple[Assembly, ...]:
        """The same for the light of each laser, line and sample of a line alone; their intensities add up, weighted."""
        if not self.further:
            return (self,)
        return (
            replace(self, further=()),
            *(
                replace(
                    self, beam=light.beam, elements=light.elements, index=light.index, light=light.name,
                    weight=light.weight, path=light.path, further=(),
                )
                for light in self.further
            ),
        )  # fmt: skip

    @property
    def named_parts(self) -> tuple[Assembly, ...]:
        """Those of them that are a laser's or a line's own, without the samples of a line's width."""
        return tuple(part for part in self.parts if part.light is not None)

    @property
    def seed(self) -> int:
        """Which surface."""
        return self.target.surface.seed

    @property
    def vacuum_wavelength(self) -> float:
        """Wavelength outside the medium that everything stands in [mm], as the scene gives it."""
        return self.beam.wavelength * self.index

    @property
    def sensitive_side(self) -> float:
        """Side of the part of a pixel that is sensitive, relative to the pitch: sub-pixels are spread over it."""
        return 1.0 if self.camera is None else float(np.sqrt(self.camera.fill_factor))

    @cached_property
    def spot(self) -> Spot:
        """The spot with the target at rest."""
        return self.spot_at(self.target.frame)

    def spot_at(self, frame: Frame) -> Spot:
        """Middle of what scatters with the target at ``frame``.

        Where the beam's axis first meets the surface, else its tangent plane at the spot at rest (where the axis runs
        along that, the material's own place); the mean of the user's own points.
        """
        target = self.target
        if target.points is not None:
            return Spot(frame.to_world(target.points.points.mean(axis=0)[None])[0], frame.axes[:, 2])
        met = target.surface.facets.first_met(frame, self.beam.origin, self.beam.axis)
        if met is not None:
            point, normal = met
            if not target.is_flat:
                mean = mean_plane_normal(target.surface.facets, self.beam, frame, point)
                normal = normal if mean is None else mean
            return Spot(point, normal)
        rest = target.surface.facets.first_met(target.frame, self.beam.origin, self.beam.axis)
        # Beside the surface its own plane stands for it.
        point, normal = rest if rest is not None else (target.frame.origin, target.frame.axes[:, 2])
        turn = frame.axes @ target.frame.axes.T
        place, normal = frame.origin + turn @ (point - target.frame.origin), turn @ normal
        slope = float(normal @ self.beam.axis)
        if abs(slope) < GRAZING:
            return Spot(place, normal)
        return Spot(self.beam.origin + (normal @ (place - self.beam.origin)) / slope * self.beam.axis, normal)

    def with_seed(self, seed: int) -> Assembly:
        """The same assembly with another surface."""
        surface = replace(self.target.surface, seed=seed)
        return replace(self, target=replace(self.target, surface=surface))

    def with_options(self, **changes) -> Assembly:
        """The same assembly with other options of the integrator."""
        return replace(self, options=replace(self.options, **changes))

    def fingerprint(self) -> str:
        """Hash of everything that determines the field but pose and seed, 16 hexadecimal digits."""
        return self._bare

    @cached_property
    def _bare(self) -> str:
        return fingerprint(replace(self.with_seed(0), pose=Pose()))

    @cached_property
    def _whole(self) -> str:
        return fingerprint(self._bare, self.pose, self.seed)
