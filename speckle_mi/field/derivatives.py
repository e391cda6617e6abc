"""The field on some pixels with its derivatives by the target's six motions and along the detector's axes.

Only what leads from the scatterers to the first opening knows of the target's pose. There the derivatives are coherent
sums as the field is; every stage behind is linear and carries them as it carries the field. The plan is held: its
openings, shadows and pixels in view change at edges only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..geometry.motion import Motion
from ..geometry.plane import PlanePoints
from ..geometry.pose import DEGREES_OF_FREEDOM
from ..optics.sequence import amplitude_of, detector_plane
from ..plan.plan import Plan
from ..plan.setup import Lighting, Setup
from ..plan.opening_shadows import has_shadow
from ..plan.shadows import is_clear
from ..plan.visibility import pixels_in_view
from ..plan.way import Channel
from ..propagation.area import points_at
from ..propagation.carried import carried
from ..propagation.free_space_rates import free_space_rates
from ..propagation.paths import FreeSpace, RayleighSommerfeld
from ..propagation.rates import STEP, RatePath, centre_of_power, differentiable, gradient_at
from ..scattering.rough_surface import Scatterers
from . import lobe as radiation
from .lobe import Lobe, LobeRate
from .openings import nodes_on
from .stages import leg_path, on_detector, on_first_opening, summed

FEW_PAIRS = 1 << 28
"""Pairs of scatterer and place in free space up to which one pass over all of them is taken."""

LOOSEST = 1e-4
"""Tolerance [relative L2] of the sums at most: a derivative's part that counts is smaller than the whole of it."""

EVERY_PAIR = 1e-6
"""Error [relative L2] of a pass over all pairs, whose phasors are float32."""

_FINE = 1e-2
"""Part of the usual step for light that may be finer than a beam."""

QUADRATURE = 1e-7
"""Error of an integral over an opening, relative to its L2 scale."""


@dataclass(frozen=True)
class DerivativeFields:
    """The field on m places of the detector and its first derivatives, complex128.

    field: (m,); by_motion: (6, m) by the target's motions x, y, z [1/mm] and rx, ry, rz [1/rad], material scatterers
    staying what they are; along: (2, m) by steps of the place along u and v [1/mm]; error: relative L2 error that each
    was computed to, less what all scatterers have in common.
    """

    field: np.ndarray
    by_motion: np.ndarray
    along: np.ndarray
    error: float = 0.0

    def __add__(self, other: DerivativeFields) -> DerivativeFields:
        return DerivativeFields(
            self.field + other.field, self.by_motion + other.by_motion, self.along + other.along,
            max(self.error, other.error),
        )  # fmt: skip


@dataclass(frozen=True)
class _Rates:
    """Values (7, n) of field and derivatives at n places; a derivative is its row plus its constant times the field.

    error: relative L2 error of the rows.
    """

    values: np.ndarray
    constants: np.ndarray
    error: float

    @property
    def whole(self) -> np.ndarray:
        """(6, n) the derivatives."""
        return self.values[1:] + self.constants[:, None] * self.values[0]


def derivative_fields(
    setup: Setup, plan: Plan, scatterers: Scatterers, pixels: np.ndarray, lobe: Lobe | None
) -> DerivativeFields:
    """The field on the pixels (m,), flat indices of the detector, with its derivatives.

    plan: of the setup; scatterers: those that laser and detector see. Raises InputError for the method ``rays``, and
    SceneError as the frame itself.
    """
    if setup.assembly.options.method == "rays":
        raise InputError("method 'rays' has no derivatives: set the integrator's method to auto")
    setup = _tight(setup)
    total = DerivativeFields(*(np.zeros((*rows, len(pixels)), complex) for rows in ((), (6,), (2,))))
    if scatterers.count == 0:
        return total
    for channel in plan.channels:
        total += _of_channel(setup, scatterers, channel, pixels, lobe)
    return total


def _tight(setup: Setup) -> Setup:
    options = setup.assembly.options
    return replace(setup, assembly=setup.assembly.with_options(tolerance=min(options.tolerance, LOOSEST)))


def _of_channel(
    setup: Setup, scatterers: Scatterers, channel: Channel, pixels: np.ndarray, lobe: Lobe | None
) -> DerivativeFields:
    grid, factor = channel.grid, amplitude_of(channel.interactions)
    places = points_at(grid, pixels)
    if not channel.openings:
        if not channel.interactions:
            factor = factor * np.broadcast_to(pixels_in_view(setup, grid), grid.shape).flat[pixels]
        rates, along = _without_openings(setup, scatterers, channel, places, lobe)
    else:
        rates, along = _over_openings(setup, scatterers, channel, places, lobe)
    return DerivativeFields(factor * rates.values[0], factor * rates.whole, factor * along, rates.error)


def _motions(setup: Setup) -> list[Motion]:
    return [Motion.of(dof, setup.frame) for dof in DEGREES_OF_FREEDOM]


def _without_openings(setup, scatterers: Scatterers, channel: Channel, places: PlanePoints, lobe: Lobe | None):
    """_Rates at the places, and derivatives (2, m) along u and v, where the light is diffracted nowhere."""
    wavelength = setup.assembly.beam.wavelength
    path = leg_path(channel, 0, detector_plane(channel.grid), None, wavelength)
    alone = _few_pairs(path, scatterers, places.size, lobe)
    if alone and is_clear(setup, channel, scatterers.position, setup.frame.axes):
        return _in_free_space(setup, scatterers, places)

    def field(path, lobe, lit=scatterers):
        return on_detector(setup, channel, path, lit, places, lobe)[0]

    path = _cheap(path, scatterers.position, places, wavelength)
    rates = _at_first(setup, scatterers, path, places, lobe, field)
    lit = scatterers.position, scatterers.amplitude
    along = [_along(axis, path, *lit, wavelength) for axis in (places.u, places.v)]
    slopes = [rate.common(places.points()) * rates.values[0] for rate in along]
    if scatterers.count > 1:
        slopes = [slope + field(rate, lobe) for slope, rate in zip(slopes, along, strict=True)]
    if lobe is not None:
        step = _lobe_step(setup, places)
        for number, axis in enumerate((places.u, places.v)):
            slopes[number] = slopes[number] + field(path, LobeRate(lobe, None, axis, step))
    return rates, np.array(slopes)


def _few_pairs(path, scatterers: Scatterers, points: int, lobe: Lobe | None) -> bool:
    """Whether one pass over all pairs in free space serves, if nothing casts a shadow."""
    return isinstance(path, FreeSpace) and lobe is None and scatterers.count * points <= FEW_PAIRS


def _in_free_space(setup: Setup, scatterers: Scatterers, places: PlanePoints) -> tuple[_Rates, np.ndarray]:
    gradients = light_gradients(setup.light, scatterers.position)
    wavelength = setup.assembly.beam.wavelength
    found = free_space_rates(scatterers.position, scatterers.amplitude, gradients, places, wavelength)
    rows = np.array([found.by_motion(motion.shift, motion.turn, motion.origin) for motion in _motions(setup)])
    common = rows @ found.field.conj() / max(np.vdot(found.field, found.field).real, 1e-300)
    values = np.array([found.field, *(rows - common[:, None] * found.field)])
    return _Rates(values, common, EVERY_PAIR), found.along


def light_gradients(light: Lighting, points: np.ndarray) -> np.ndarray:
    """Gradient (n, 3) complex of the logarithm of the light's field at points (n, 3) [1/mm]."""
    ahead, behind = ((points + step[:, None]).reshape(-1, 3) for step in (STEP * np.eye(3), -STEP * np.eye(3)))
    return (light.log_ratio(ahead, behind).reshape(3, -1) / (2 * STEP)).T


def _over_openings(setup, scatterers: Scatterers, channel: Channel, places: PlanePoints, lobe: Lobe | None):
    """_Rates at the places, and derivatives (2, m) along u and v, behind the channel's openings."""
    wavelength, options = setup.assembly.beam.wavelength, setup.assembly.options
    tolerance = max(options.tolerance / (len(channel.openings) + 1), 1e-8)
    how = wavelength, options.method, tolerance, setup.costs
    rates, sources, opening = None, None, None
    for number, rim in enumerate(channel.openings):
        nodes, areas = nodes_on(channel, number, QUADRATURE)
        path = leg_path(channel, number, rim.end, opening, wavelength)
        if number == 0:
            rates = _on_first(setup, scatterers, channel, path, nodes, tolerance, lobe)
        else:
            rates = _carried(rates, channel, path, sources, nodes, how)
        rates = replace(rates, values=rates.values * areas, error=options.tolerance)
        sources, opening = nodes.points(), (rim.normal, rim.index)
    path = leg_path(channel, len(channel.openings), detector_plane(channel.grid), opening, wavelength)
    if isinstance(path, RayleighSommerfeld):
        found = carried(path, sources, rates.values, places, wavelength)
        return replace(rates, values=found.values), found.along
    on_places = _carried(rates, channel, path, sources, places, how)
    field, slow, slopes = rates.values[0], _cheap(path, sources, places, wavelength), []
    for axis in (places.u, places.v):
        rate = _along(axis, slow, sources, field, wavelength)
        slope = summed(channel, rate, sources, field, places, *how).field
        slopes.append(slope + rate.common(places.points()) * on_places.values[0])
    return on_places, np.array(slopes)


def _on_first(setup, scatterers, channel, path, nodes, tolerance, lobe) -> _Rates:
    rim, wavelength = channel.openings[0], setup.assembly.beam.wavelength
    alone = _few_pairs(path, scatterers, nodes.size, lobe)
    if alone and not has_shadow(channel, rim, scatterers.position, setup.frame.axes):
        return _in_free_space(setup, scatterers, nodes)[0]
    path = _cheap(path, scatterers.position, nodes, wavelength)

    def field(path, lobe, lit=scatterers):
        return on_first_opening(setup, channel, rim, path, lit, nodes, tolerance, lobe)[0]

    return _at_first(setup, scatterers, path, nodes, lobe, field)


def _carried(rates: _Rates, channel, path, sources, target: PlanePoints, how) -> _Rates:
    rows = [summed(channel, path, sources, row, target, *how).field for row in rates.values]
    return replace(rates, values=np.array(rows))


def _at_first(setup: Setup, scatterers: Scatterers, path, target: PlanePoints, lobe: Lobe | None, field) -> _Rates:
    """Field and derivatives at the first places that the light comes to.

    field: (path, lobe, scatterers as they are unless others are given) -> (m,) their sum there.
    """
    wavelength, points = setup.assembly.beam.wavelength, target.points()
    rows, constants = [field(path, lobe)], []
    middle = centre_of_power(scatterers.position, scatterers.amplitude)
    gradient = gradient_at(path, wavelength, middle, points)
    for motion in _motions(setup):
        reach = float(np.linalg.norm(motion.velocity(scatterers.position), axis=1).max(initial=1e-3))
        light = _lit(setup.assembly.beam, motion, reach)
        rate = RatePath(path, wavelength, middle, motion.velocity, None, light, reach)
        common = motion.velocity(middle[None])[0] @ gradient + light(middle[None])[0]
        constants.append(common.mean())
        row = (common - constants[-1]) * rows[0]
        if scatterers.count > 1:  # one alone has nothing but what is common
            row = row + field(rate, lobe)
        if setup.beside_beam is not None:
            row = row + field(path, lobe, _beside_beam(setup, scatterers, motion, reach))
        if lobe is not None:
            step = radiation.STEP if np.any(motion.turn) else _lobe_step(setup, target)
            row = row + field(path, LobeRate(lobe, motion, None, step))
        rows.append(row)
    return _Rates(np.array(rows), np.array(constants), setup.assembly.options.tolerance)


def _beside_beam(setup: Setup, scatterers: Scatterers, motion: Motion, reach: float) -> Scatterers:
    """Scatterers with the rate at which their light changes beside the beam's own change.

    A sum of its own: unlike a beam's logarithm, that of light which optics have changed is rough where it is dim.
    """
    rates = [_lit(one, motion, reach, _FINE)(scatterers.position) for one in (setup.light, setup.assembly.beam)]
    return replace(scatterers, amplitude=scatterers.amplitude * (rates[0] - rates[1]))


def _lit(lighting: Lighting, motion: Motion, reach: float, part: float = 1.0):
    """points (n, 3) -> rate (n,) at which the light on them changes as they move; part: of the usual step."""

    def rate(points: np.ndarray) -> np.ndarray:
        step = part * STEP / reach
        move = step * motion.velocity(points)
        return lighting.log_ratio(points + move, points - move) / (2 * step)

    return rate


def _along(axis: np.ndarray, path, sources: np.ndarray, weights: np.ndarray, wavelength: float) -> RatePath:
    return RatePath(path, wavelength, centre_of_power(sources, weights), None, axis)


def _cheap(path, sources: np.ndarray, target: PlanePoints, wavelength: float):
    return path if isinstance(path, FreeSpace) else differentiable(path, sources, target, wavelength)


def _lobe_step(setup: Setup, target: PlanePoints) -> float:
    """Shift [mm] that turns directions to the target by ``STEP``."""
    middle = target.points().mean(axis=0)
    return radiation.STEP * float(np.linalg.norm(middle - setup.spot.point))
