"""One field image of an assembly: scatterers, visibility, coherent sums, radiation lobe, pixel average."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np

from ..geometry.plane import PlaneGrid
from ..geometry.pose import Pose
from ..images.field_image import FieldImage
from ..machine.backend import ensure_variant
from ..machine.cores import products_on_one_thread
from ..machine.interrupt import raised_as_such
from ..machine.progress import tell
from ..plan.cost import Cost, cost_of
from ..plan.plan import Plan, make_plan
from ..plan.setup import Setup
from ..plan.stage import NOTHING_SUMMED, PIXELS, Stage
from ..plan.visibility import pixels_in_view, visible_scatterers
from ..plan.way import Channel
from ..propagation.costs import costs_of
from ..scattering.rough_surface import Scatterers
from ..scene.assembly import Assembly, Options
from ..scene.tracer import Tracer
from .derivatives import DerivativeFields, derivative_fields
from .exposure import CameraFrame, picture_of
from .frame import FrameResult, LightOnDetector, header_of
from .illumination import Illumination
from .incoherent import added_up, by_photons, layers_of, named, stacked, together, too_few_samples
from .lobe import Lobe
from .resolution import too_few_scatterers
from .stages import ChannelField, channel_field, ray_channel

PLANS_KEPT = 256
"""Poses whose plans a simulation keeps."""

_PIXELS_AT_ONCE = 1 << 13

_UNLIT = (
    "no light: the beam misses the target at this pose, or no scatterer lies under it (see point_sources), "
    "the field is zero"
)


def simulate_frame(
    assembly: Assembly, pose: Pose | None = None, seed: int | None = None, options: Options | None = None
) -> FrameResult:
    """The frame of an assembly: a pure function of its arguments. See :meth:`Simulation.frame`."""
    return Simulation(assembly).frame(pose, seed, options)


def simulate(assembly: Assembly, pose: Pose | None = None) -> FieldImage:
    """The field image of ``assembly`` with its target at ``pose`` (default: the pose that the scene has it in)."""
    return simulate_frame(assembly, pose).image


def plan_of(assembly: Assembly, pose: Pose | None = None) -> Plan:
    """The plan of an assembly with its target at ``pose`` (default: at rest)."""
    return Simulation(assembly).plan(Pose() if pose is None else pose)


class Simulation:
    """Frames of one assembly.

    Holds what frames share and is worth keeping: the copied geometry that rays run in, and the plan of every pose.
    Frames do not depend on what was rendered before, and may be made from several threads.
    """

    def __init__(self, assembly: Assembly, tracer: Tracer | None = None) -> None:
        """tracer: of an assembly with the same target and elements, where there is one."""
        self.assembly = assembly
        self._costs = costs_of(ensure_variant())
        self._tracer = Tracer(assembly.elements, assembly.target) if tracer is None else tracer
        self._plans: dict[tuple[Pose, Options], Plan] = {}
        self._lobe: Lobe | None = None
        self._lamp = Illumination(assembly, self._costs)
        self._lock = threading.Lock()
        self._further = tuple(Simulation(part, self._tracer) for part in assembly.parts[1:])

    def plan(self, pose: Pose | None = None, options: Options | None = None) -> Plan:
        """What is done for a frame with the target at ``pose`` (default: the pose that the scene has it in).

        Raises SceneError where the field cannot be computed as asked.
        """
        return self._plan(self._setup(self.assembly, pose, options))

    def setup(self, pose: Pose | None = None) -> Setup:
        """What the plan of a frame is made for."""
        return self._setup(self.assembly, pose, None)

    def cost(self, pose: Pose | None = None, options: Options | None = None) -> Cost:
        """What a frame will cost, known beforehand from its plans. Raises SceneError as :meth:`plan`."""
        setup = self._setup(self.assembly, pose, options)
        own = cost_of(setup.assembly, self._plan(setup).channels)
        return together(own, [one.cost(pose, options) for one in self._further], setup.assembly)

    @raised_as_such()
    @products_on_one_thread()
    def frame(
        self, pose: Pose | None = None, seed: int | None = None, options: Options | None = None, shot: int = 0,
        lit: tuple[Scatterers, ...] | None = None,
    ) -> FrameResult:  # fmt: skip
        """The field image with everything that was found out on the way; of several lasers or lines, of all light.

        pose: displacement of the target from rest (default: the scene's); seed: which surface (default: the scene's);
        options: of the integrator (default: the scene's); shot: which of the pictures that a camera takes there, whose
        noise differs; lit: what :meth:`lit` gives, where it is known. Raises SceneError where the field cannot be
        computed as asked.
        """
        began = time.perf_counter()
        setup = self._setup(self._surface(seed), pose, options)
        lit = lit or (None,) * (1 + len(self._further))
        parts = [one._light(pose, seed, options, own) for one, own in zip((self, *self._further), lit, strict=True)]
        whole = added_up(setup.assembly, parts)
        # No seed is in the hash: of the assembly that all frames share it is computed once.
        scene_hash = (self.assembly if options is None else setup.assembly).fingerprint()
        photons = by_photons(parts)
        picture = picture_of(setup, self._plan(setup).channels, whole.intensity if photons is None else photons, shot)
        warnings = (*whole.warnings, *picture.warnings)
        count = whole.scatterers.count
        header = header_of(setup.assembly, scene_hash, setup.pose, count, whole.stages, whole.error, warnings)
        layers = layers_of(parts)
        image = FieldImage(whole.intensity, whole.field, header | picture.header, dn=picture.dn, layers=layers)
        seconds = time.perf_counter() - began
        return FrameResult(image, whole.scatterers, whole.stages, whole.error, warnings, seconds, named(parts), photons)

    def picture(self, photons: np.ndarray, pose: Pose | None = None, shot: int = 0) -> CameraFrame:
        """What the camera makes of light (rows, columns), as it counts it, with the target at ``pose``; see frame."""
        setup = self._setup(self.assembly, pose, None)
        return picture_of(setup, self._plan(setup).channels, photons, shot)

    def _light(
        self, pose: Pose | None, seed: int | None, options: Options | None, lit: Scatterers | None
    ) -> LightOnDetector:
        """What the first light alone brings to the detector."""
        setup = self._setup(self._surface(seed), pose, options)
        plan, warnings = self._plan(setup), []
        lit = self._lamp.on(setup) if lit is None else lit
        light = self._lamp.stages(setup, lit)
        warnings += too_few_samples(setup.assembly, lit)
        scatterers = _visible(setup, lit, plan, warnings)
        centre, intensity, stages, error = self._detect(setup, scatterers, plan, warnings)
        warnings += [*plan.warnings, *too_few_scatterers(setup, plan.channels)]
        stages, error = (*light, *stages), float(np.hypot(error, max((one.error or 0.0 for one in light), default=0.0)))
        if error > setup.assembly.options.tolerance:
            warnings.append(_beyond_tolerance(error, setup.assembly.options.tolerance, stages))
        return LightOnDetector(self.assembly, centre, intensity, scatterers, stages, error, tuple(warnings))

    @raised_as_such()
    @products_on_one_thread()
    def lit(self, pose: Pose | None = None, seed: int | None = None) -> tuple[Scatterers, ...]:
        """The scatterers under every beam, which do not depend on the detector, nor on what stands before it."""
        return tuple(one._lamp.on(one._setup(one._surface(seed), pose, None)) for one in (self, *self._further))

    @raised_as_such()
    @products_on_one_thread()
    def field_of(self, scatterers: Scatterers, pose: Pose | None = None) -> np.ndarray:
        """The field (rows, columns) at the pixel centres that given scatterers make with the target at ``pose``.

        Of several lasers, in the first one's light.
        """
        setup = self._setup(self.assembly, pose, None)
        return self._field(setup, scatterers, self._plan(setup), (0.0, 0.0), [])[0]

    @raised_as_such()
    @products_on_one_thread()
    def derivatives(
        self, pixels: np.ndarray, seed: int | None = None, lit: tuple[Scatterers, ...] | None = None
    ) -> DerivativeFields:
        """The field on some pixels with its derivatives by the target's motions from rest and along u and v.

        pixels: (m,) flat indices of the detector, row by row; seed: which surface (default: the scene's); lit:
        what :meth:`lit` gives at rest, where it is known. Of several lasers, lines or samples of a line all arrays have
        a first axis for these, whose intensities add up: fields are scaled by the roots of their weights. Raises
        SceneError as :meth:`frame`, InputError for ``rays``.
        """
        lit = lit or (None,) * (1 + len(self._further))
        found = [one._rates(pixels, seed, own) for one, own in zip((self, *self._further), lit, strict=True)]
        if not self._further:
            return found[0]
        return stacked(found, [one.assembly.weight for one in (self, *self._further)])

    def _rates(self, pixels: np.ndarray, seed: int | None, lit: Scatterers | None) -> DerivativeFields:
        """The derivatives of the first light alone."""
        setup = self._setup(self._surface(seed), Pose(), None)
        plan = self._plan(setup)
        lit = self._lamp.on(setup) if lit is None else lit
        setup = replace(setup, beside_beam=self._lamp.beside_beam(setup, lit))
        scatterers = _visible(setup, lit, plan, [])
        return derivative_fields(setup, plan, scatterers, pixels, self._radiation())

    def _surface(self, seed: int | None) -> Assembly:
        return self.assembly if seed is None else self.assembly.with_seed(seed)

    def _setup(self, assembly: Assembly, pose: Pose | None, options: Options | None) -> Setup:
        assembly = assembly if options is None else replace(assembly, options=options)
        return Setup(assembly, assembly.pose if pose is None else pose, self._tracer, self._costs)

    def _plan(self, setup: Setup) -> Plan:
        key = setup.pose, setup.assembly.options
        with self._lock:
            if key not in self._plans:
                while len(self._plans) >= PLANS_KEPT:
                    self._plans.pop(next(iter(self._plans)))
                self._plans[key] = make_plan(setup)
            return self._plans[key]

    def _radiation(self) -> Lobe | None:
        target = self.assembly.target
        if target.lobe is None:
            return None
        with self._lock:
            if self._lobe is None:
                self._lobe = Lobe(target.lobe, target.where)
            return self._lobe

    def _detect(
        self, setup: Setup, scatterers: Scatterers, plan: Plan, warnings: list[str]
    ) -> tuple[np.ndarray, np.ndarray, tuple[Stage, ...], float]:
        """Field at the pixel centres, intensity averaged over the pixels, stages and estimated error."""
        side = setup.assembly.sub_pixels
        offsets = setup.assembly.sensitive_side * _sub_pixel_offsets(side)
        centre, stages, error = self._field(setup, scatterers, plan, (0.0, 0.0), warnings)
        if side == 1:
            return centre, _intensity(centre), stages, error
        total = np.zeros(setup.assembly.detector.shape)
        for row, offset_v in enumerate(offsets):
            for offset_u in offsets:
                if offset_u == offset_v == 0:
                    total += _intensity(centre)
                    continue
                values, _, sub_error = self._field(setup, scatterers, plan, (offset_u, offset_v), warnings)
                total += _intensity(values)
                error = max(error, sub_error)
            tell("rows of sub-pixels", row + 1, side)
        return centre, (total / side**2).astype(np.float32), (*stages, Stage(PIXELS, count=side)), error

    def _field(
        self, setup: Setup, scatterers: Scatterers, plan: Plan, offset: tuple[float, float], warnings: list[str]
    ) -> tuple[np.ndarray, tuple[Stage, ...], float]:
        """Sum of all channels' fields at the pixel centres, shifted by ``offset`` pixels along u and v."""
        if scatterers.count == 0 or not plan.channels:
            dark = np.zeros(setup.assembly.detector.shape, complex)
            return dark, (*plan.stages, Stage(NOTHING_SUMMED)), 0.0
        parts = [self._part(setup, scatterers, channel, offset, warnings) for channel in plan.channels]
        stages = (*plan.stages, *(stage for part in parts for stage in part.stages))
        if len(parts) == 1:
            return parts[0].field, stages, float(np.hypot(parts[0].error, plan.left_out))
        total = sum(part.field for part in parts)
        error = np.sqrt(sum((part.error * np.linalg.norm(part.field)) ** 2 for part in parts))
        norm = np.linalg.norm(total)
        return total, stages, float(np.hypot(error / norm, plan.left_out)) if norm > 0 else 0.0

    def _part(
        self, setup: Setup, scatterers: Scatterers, channel: Channel, offset: tuple[float, float], warnings: list[str]
    ) -> ChannelField:
        """What one channel brings to the pixel centres, shifted by ``offset`` pixels along u and v."""
        grid = _shifted(channel.grid, offset)
        if setup.assembly.options.method == "rays":
            part, notes = ray_channel(setup, scatterers, channel, grid, self._radiation())
            warnings += [note for note in notes if note not in warnings]
        else:
            part = channel_field(setup, scatterers, channel, grid, self._radiation())
        if channel.interactions:
            return part
        seen = pixels_in_view(setup, grid)
        return part if np.all(seen) else replace(part, field=part.field * seen)


def _visible(setup: Setup, lit: Scatterers, plan: Plan, warnings: list[str]) -> Scatterers:
    """Those of them that laser and detector see."""
    if not np.any(lit.amplitude):
        warnings.append(_UNLIT)
        return lit.selected(np.zeros(0, dtype=np.int64))
    viewpoints = [channel.viewpoint for channel in plan.channels] or [setup.assembly.detector.centre]
    seen, note = visible_scatterers(setup, lit, viewpoints)
    if note or not np.any(seen.amplitude):
        warnings.append(note or _UNLIT)
    return seen


def _beyond_tolerance(error: float, tolerance: float, stages: tuple[Stage, ...]) -> str:
    """One line on an error larger than asked for, and where it comes from."""
    largest = max(stages, key=lambda stage: max(stage.error or 0.0, stage.predicted_error or 0.0))
    return f"the error of the field is {error:.1e}, more than the tolerance of {tolerance:.0e}: {largest}"


def _shifted(grid: PlaneGrid, offset: tuple[float, float]) -> PlaneGrid:
    return replace(grid, origin=grid.origin + grid.pitch * (offset[0] * grid.u + offset[1] * grid.v))


def _sub_pixel_offsets(side: int) -> np.ndarray:
    """Centres of ``side`` equal parts of a pixel, in pixels from its centre."""
    return (np.arange(side) - (side - 1) / 2) / side


def _intensity(values: np.ndarray) -> np.ndarray:
    """|E|^2 in float32, (rows, columns); a few rows at a time, which stay in the processor's cache."""
    intensity = np.empty(values.shape, dtype=np.float32)
    step = max(1, _PIXELS_AT_ONCE // values.shape[1])
    for row in range(0, len(values), step):
        some = values[row : row + step]
        intensity[row : row + step] = some.real**2 + some.imag**2
    return intensity
