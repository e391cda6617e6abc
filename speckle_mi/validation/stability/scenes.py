"""Scenes for the cases, from directions and distances, and the exact sums they are compared with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...geometry.frames import Frame
from ...geometry.plane import PlaneGrid
from ...geometry.pose import Pose
from ...geometry.rotation import rotation_matrix
from ...scene import write
from ...scene.write import ORIGIN, Plugin

WAVELENGTH = 632.8e-6
"""Default wavelength [mm]."""

SAMPLED_PIXELS = 400
"""Pixels on which a field is compared with an exact sum."""

@dataclass(frozen=True)
class Bench:
    """A laser, a target at the origin facing +z, and a detector that looks at it; all parts may be moved together.

    laser_angle, detector_angle: from the normal in the xz plane [deg]; distances [mm]; detector_turn: 180 deg looks at
    the target, 0 away from it; detector_frame: its place, instead of angle and distance; laser, target, detector,
    integrator: parameters of the plugins; elements: other parts; world: where the whole bench stands;
    backwards: writes the parts in the opposite order.
    """

    laser_angle: float = 35.0
    laser_distance: float = 50.0
    detector_angle: float = 0.0
    detector_distance: float = 60.0
    detector_turn: float = 180.0
    detector_frame: Frame | None = None
    target_frame: Frame = ORIGIN
    laser: dict = field(default_factory=dict)
    target: dict = field(default_factory=dict)
    detector: dict = field(default_factory=dict)
    integrator: dict = field(default_factory=dict)
    elements: tuple[Plugin, ...] = ()
    world: Frame = ORIGIN
    backwards: bool = False

    def xml(self) -> str:
        """The scene file."""
        laser = {"wavelength": WAVELENGTH * 1e6, "beam_radius": 0.12, "wavefront_radius": -750.0} | self.laser
        target = {"roughness": 0.8, "point_sources": 100} | self.target
        parts = [
            write.integrator(**self.integrator),
            write.laser(self._place(self.laser_angle, self.laser_distance), **laser),
            write.rough_target(self.target_frame, **target),
            write.detector(self._detector_place(), **{"width": 48, "height": 48} | self.detector),
            *self.elements,
        ]
        parts = [part if part.frame is None else part.at(self.in_world(part.frame)) for part in parts]
        return write.scene_text(*(parts[::-1] if self.backwards else parts))

    def assembly(self):
        """The assembly of the scene."""
        import mitsuba as mi

        from ...scene.read import assembly_from_scene

        return assembly_from_scene(mi.load_string(self.xml()))

    def frame(self, pose: Pose | None = None):
        """The simulated frame."""
        from ...field.simulation import simulate_frame

        return simulate_frame(self.assembly(), pose)

    def field(self, pose: Pose | None = None) -> np.ndarray:
        """The field (rows, columns)."""
        return self.frame(pose).image.field

    def with_(self, **changes) -> Bench:
        """Another bench: dictionaries are merged, everything else is replaced."""
        merged = {
            name: getattr(self, name) | value if isinstance(value, dict) else value for name, value in changes.items()
        }
        return replace(self, **merged)

    def _place(self, angle: float, distance: float, turn: float = 180.0) -> Frame:
        """Place at ``distance`` in a direction, its local +z turned back to the origin (for a turn of 180 deg)."""
        axes = rotation_matrix(np.radians([0.0, angle, 0.0]))
        facing = axes @ rotation_matrix(np.radians([0.0, turn, 0.0]))
        return Frame(distance * axes[:, 2], facing)

    def _detector_place(self) -> Frame:
        if self.detector_frame is not None:
            return self.detector_frame
        return self._place(self.detector_angle, self.detector_distance, self.detector_turn)

    def in_world(self, frame: Frame) -> Frame:
        """A place on the bench as a place in the world."""
        return Frame(self.world.to_world(frame.origin[None])[0], self.world.axes @ frame.axes)


def lens(z: float, **values) -> Plugin:
    """A lens with its front vertex on the z axis."""
    return write.shape("lens", "lens", write.on_axis(z), **values)


def aperture(z: float, name: str = "stop", **values) -> Plugin:
    """An aperture on the z axis."""
    return write.shape("aperture", name, write.on_axis(z), **values)


# Exact sums, written down independently of the propagation


def sampled_pixels(grid: PlaneGrid, count: int = SAMPLED_PIXELS) -> np.ndarray:
    """Flat indices (n,) of pixels: all of a small detector, else corners and a random choice."""
    if grid.size <= count:
        return np.arange(grid.size)
    rows, columns = grid.shape
    corners = [0, columns - 1, (rows - 1) * columns, grid.size - 1]
    return np.unique(np.append(np.random.default_rng(1).integers(grid.size, size=count), corners))


def pixel_centres(grid: PlaneGrid, pick: np.ndarray) -> np.ndarray:
    """World positions (n, 3) [mm] of pixels by their flat indices."""
    row, column = np.divmod(pick, grid.shape[1])
    return grid.origin + grid.pitch * (column[:, None] * grid.u + row[:, None] * grid.v)


def exact_sum(position: np.ndarray, amplitude: np.ndarray, places: np.ndarray, wavelength: float) -> np.ndarray:
    """sum_j c_j e^{ikr}/r at places (m, 3), path lengths in extended precision where the machine has it, (m,)."""
    out = np.empty(len(places), dtype=np.complex128)
    extended, unit = position.astype(np.longdouble), np.longdouble(wavelength)
    for number, place in enumerate(places):
        r = np.sqrt(np.sum(np.square(place.astype(np.longdouble) - extended), axis=1))
        turns = r / unit
        phase = 2 * np.pi * (turns - np.round(turns)).astype(np.float64)
        terms = amplitude * np.exp(1j * phase) / r.astype(np.float64)
        out[number] = np.sum(terms.astype(np.clongdouble))
    return out


def exact_laser(beam, points: np.ndarray) -> np.ndarray:
    """The laser's field at points (n, 3) from its definition, in extended precision, (n,)."""
    wide = np.longdouble
    from_reference = points.astype(wide) - beam.reference.astype(wide)
    axis = beam.axis.astype(wide)
    axis /= np.sqrt(axis @ axis)
    along = from_reference @ axis
    bow, squared, modes = 0, 0, 1 + 0j
    for direction, radius, bend in zip(beam.across, beam.radii, beam.wavefront_radii, strict=True):
        across = (from_reference - along[:, None] * axis) @ direction.astype(wide)
        spread = 0 if beam.is_uniform else wide(beam.wavelength) / (wide(np.pi) * wide(radius) ** 2)
        step = 1 + along * (1 / wide(bend) + 1j * spread)  # q / q_0
        inverse = (1 / wide(bend) + 1j * spread) / step
        bow, squared = bow + inverse.real * across**2, squared + (inverse.real * across) ** 2
        if beam.is_uniform:  # a focus that lies behind turns the phase, one that lies before turns it back
            modes = modes * np.where(step.real < 0, np.where(along > 0, -1j, 1j), 1)
        else:
            decay = np.exp(-(across**2) * (wide(np.pi) / wide(beam.wavelength)) * inverse.imag)
            modes = modes * (decay / np.sqrt(step)).astype(complex)
    # Less the path along the axis: R - sqrt(R^2 + r^2) without its cancellation.
    path = along + bow / (1 + np.sqrt(1 + squared))
    turns = (path + wide(beam.reference_path)) / wide(beam.wavelength)
    return modes * np.exp(2j * np.pi * (turns - np.round(turns)).astype(np.float64))


def against_exact_sum(bench: Bench, pose: Pose | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Field and exact sum of the same scatterers on sampled pixels of a bench in free space, (n,) each."""
    from ...field.simulation import simulate_frame

    assembly = bench.assembly()
    frame = simulate_frame(assembly, pose)
    pick = sampled_pixels(assembly.detector)
    places, lit = pixel_centres(assembly.detector, pick), frame.scatterers
    reference = exact_sum(lit.position, lit.amplitude, places, assembly.beam.wavelength)
    return frame.image.field.ravel()[pick], reference
