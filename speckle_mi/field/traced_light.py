"""The light that optics send to the target: a coherent sum over the cross-section of the beam, over traced paths.

Where a laser's light comes over lenses, curved mirrors or edges that cut it, the Gaussian beam along its axis is
not all of it: there are aberrations, and what edges diffract. Its field on a plane across it before the first of these,
in closed form, is summed to places around the target by the Rayleigh-Sommerfeld integral, over every edge that cuts it
in turn; on the way from one to the next paths are traced and interpolated, as on the way to the detector. What the sum
gives beside the phase of the Gaussian beam is smooth: it is known at Chebyshev nodes in a box, and interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import InputError
from ..geometry.frames import Frame
from ..geometry.outline import Circle
from ..geometry.pairs import all_pairs
from ..geometry.plane import PlaneGrid, PlanePoints
from ..optics.aim import aim
from ..optics.sequence import Interaction, Sequence, amplitude_of
from ..optics.surface import Surface
from ..optics.trace import trace
from ..optics.traced_path import TracedLeg
from ..optics.unfold import unfold
from ..plan.places import hole_places
from ..plan.relay import NEAR_CAUSTIC
from ..plan.way import Rim, rims_of, with_slack, without_rims
from ..propagation.chebyshev import axis_tails, chebyshev_nodes, tensor_coefficients
from ..propagation.coherent_sum import coherent_sum
from ..propagation.costs import Costs
from ..propagation.opening_quadrature import estimated_nodes, opening_nodes
from ..propagation.paths import RayleighSommerfeld
from ..scattering.beam import Beam
from ..scene.light_path import LightPath
from .light_factor import LightFactor

_PARTS = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Parts of the way to the first surface at which the cross-section may be taken; the one that needs fewest nodes is."""

_AROUND = 8
"""Places around it at which the slope of the phase is looked at, on its edge and halfway."""

_ENVELOPE = 4.0
"""Slope [1/radius] at which a Gaussian envelope of the amplitude is resolved, beside the phase's."""

_ROOM = 1.2
"""Factor on the steepest phase that was found at a few places."""

_FEW_NODES = 150_000
"""Nodes of a cross-section up to which it need not have fewer."""

MOST_NODES = 1_000_000
"""Nodes of a cross-section or an edge beyond which the sum is not done."""

_FIRST, _MOST = (20, 20, 3), (160, 160, 24)
"""Nodes across the beam and along it that are tried first, and at most."""

_TRIES = 6
_QUADRATURE = 1e-3
"""Of the tolerance, to which integrals over a cross-section are resolved: they converge fast, and cost little."""

_SHARE = 0.3
"""Of the tolerance, what each part of the sum may add to the error."""


Goals = list[tuple[Interaction, np.ndarray]]
"""Planes that light goes to, with places (m, 3) on each."""


@dataclass(frozen=True)
class _Source:
    """A plane that light is summed from: points (n, 3), weights (n,), its normal (3,), and how many interactions lie
    before it."""

    points: np.ndarray
    weights: np.ndarray
    normal: np.ndarray
    index: float
    position: int


class TracedLight:
    """The light of one laser over its optics, wherever around the target it is asked for.

    path: the optics; beam: the Gaussian beam behind them, given at the target at rest; tolerance: relative L2 error of
    the field that is to be kept. Raises InputError where the sum would take too many nodes, or where no ray connects
    what it goes over.
    """

    def __init__(self, path: LightPath, beam: Beam, tolerance: float, costs: Costs) -> None:
        self._path, self._beam, self._tolerance, self._costs = path, beam, tolerance, costs
        self._wavelength = beam.wavelength
        # What is before the target is seen without plane mirrors, and so is the target.
        here, ahead = (
            PlaneGrid(beam.reference + step * beam.axis, *beam.across, pitch=1.0, shape=(1, 1)) for step in (0.0, 1.0)
        )
        self._interactions, image = unfold(tuple(map(_with_room, with_slack(path.interactions))), here)
        self._axes = np.column_stack([image.u, image.v, unfold(path.interactions, ahead)[1].origin - image.origin])
        self._middle = image.origin

    def factor(self, low: np.ndarray, high: np.ndarray) -> LightFactor:
        """The light in a box (3,) to (3,) of the beam's coordinates. Raises InputError as above."""
        sources, error = self._sources(self._faces(low, high))
        orders = list(_FIRST)
        for _ in range(_TRIES):
            values, summed = self._on_nodes(sources, low, high, orders)
            parts = np.stack([values.real.ravel(), values.imag.ravel()], axis=1)
            tails = axis_tails(tensor_coefficients(parts, tuple(orders)))
            enough = tails <= _SHARE * self._tolerance
            coarse = [axis for axis in range(3) if not enough[axis] and orders[axis] < _MOST[axis]]
            if not coarse:
                break
            for axis in coarse:
                # A series converges geometrically: what is far from converged needs more.
                missing = np.log10(tails[axis] / (_SHARE * self._tolerance))
                orders[axis] = min(_MOST[axis], int((1.3 + 0.3 * min(missing, 4.0)) * orders[axis]) + 1)
        total = float(np.sqrt(error**2 + summed**2 + np.sum(tails**2)))
        return LightFactor(self._beam, low, high, values, len(sources.points), total)

    def _faces(self, low: np.ndarray, high: np.ndarray) -> Goals:
        """Planes across the beam at both ends of a box, each with its corners and its middle (5, 3)."""
        corners = np.array([[a, b] for a in (low[0], high[0]) for b in (low[1], high[1])])
        across = np.concatenate([corners, corners.mean(axis=0, keepdims=True)])
        faces = []
        for along in (low[2], high[2]):
            plane = Surface(Frame(self._world(np.array([[0.0, 0.0, along]]))[0], self._axes))
            faces.append((Interaction.through(plane), self._world(np.column_stack([across, np.full(5, along)]))))
        return faces

    def _world(self, local: np.ndarray) -> np.ndarray:
        """Places (n, 3) of the beam's coordinates as they are seen without plane mirrors."""
        return self._middle + local @ self._axes.T

    def _on_nodes(self, source: _Source, low, high, orders) -> tuple[np.ndarray, float]:
        """Amplitudes (a, b, c) beside the beam's phase at the nodes of a box, and the relative error of the sums."""
        x, y, z = ((a + b) / 2 + (b - a) / 2 * chebyshev_nodes(n) for a, b, n in zip(low, high, orders, strict=True))
        a, b = (part.ravel() for part in np.meshgrid(x, y, indexing="ij"))
        values, errors = np.empty((len(x), len(y), len(z)), dtype=np.complex128), []
        beam, own = self._beam, self._path.own
        unit = np.sqrt(np.prod(beam.radii) / np.prod(own.radii)) * amplitude_of(self._path.interactions)
        unit = unit * np.exp(1j * self._gouy)
        for number, along in enumerate(z):
            frame = Frame(self._middle + along * self._axes[:, 2], self._axes)
            plane = PlanePoints(frame.origin, frame.axes[:, 0], frame.axes[:, 1], a, b)
            path = self._leg(source, Interaction.through(Surface(frame)), len(self._interactions))
            result = coherent_sum(path, source.points, source.weights, plane, *self._how)
            places = beam.reference + np.column_stack([a, b, np.full(len(a), along)]) @ beam.axes.T
            field = beam.field(places)
            values[:, :, number] = (unit * result.field * np.abs(field) / field).reshape(len(x), len(y))
            errors.append(result.numerical_error)
        return values, max(errors)

    @property
    def _how(self) -> tuple:
        """Wavelength, method, tolerance and costs of the sums."""
        return self._wavelength, "auto", max(_SHARE * self._tolerance, 1e-8), self._costs

    @cached_property
    def _gouy(self) -> float:
        last = self._path.carried
        return last.on(float((self._beam.reference - last.place) @ last.direction)).gouy

    # From plane to plane

    def _sources(self, ends: Goals) -> tuple[_Source, float]:
        """The last plane before the target that light is summed from, and the error of what led there.

        ends: planes around the target with places (n, 3) on each.
        """
        rims = self._rims
        goals = [[(rim.end, hole_places(rim.plane, (0.0, 1.0), 8))] for rim in rims] + [ends]
        first = self._first_rim()
        if first is not None:
            source, goals, rims = self._on_rim(first, goals[1]), goals[1:], rims[1:]
        else:
            source = self._cross_section(goals[0])
        errors = [0.0]
        for number, rim in enumerate(rims):
            source, error = self._over(rim, goals[number + 1], source)
            errors.append(error)
        return source, float(np.sqrt(np.sum(np.square(errors))))

    @cached_property
    def _rims(self) -> list[Rim]:
        """The edges that cut the light, in order; of the rims of one lens the first that does."""
        rims = rims_of(self._path.own.origin, self._path.names, self._interactions, self._middle)
        found: list[Rim] = []
        for rim in rims:
            if rim.number in self._path.cut and not (found and found[-1].name == rim.name):
                before = not self._between(0, rim.number)
                # The rim of a first face is taken before it, where the light's field is known.
                found.append(replace(rim, position=rim.number, index=1.0) if before else rim)
        return found

    def _first_rim(self) -> Rim | None:
        """The first edge, where the light comes to it unchanged."""
        if not self._rims or self._between(0, self._rims[0].position):
            return None
        return self._rims[0]

    def _between(self, first: int, last: int) -> tuple[Interaction, ...]:
        return without_rims(one for one in self._interactions[first:last] if one.bends)

    def _leg(self, source: _Source, end: Interaction, last: int):
        """What leads from a source to a plane behind so many interactions."""
        between = self._between(source.position, last)
        if between:
            return TracedLeg(Sequence((*between, end)), self._wavelength, (source.normal, source.index))
        return RayleighSommerfeld(source.normal, self._wavelength)

    def _launches(self, position: int, last: int, places: np.ndarray, goals: Goals) -> np.ndarray:
        """(k, 3) directions in which rays leave each of places (n, 3) for all goals, behind so many interactions.

        Raises InputError where there is no ray, or a caustic between.
        """
        between, found = self._between(position, last), []
        for end, points in goals:
            aimed = aim(Sequence((*between, end)), *all_pairs(places, points))
            if not np.all(aimed.converged) or np.ptp(aimed.caustics) or np.min(aimed.spread) < NEAR_CAUSTIC:
                raise InputError("rays over the optics do not connect every place of the light with every other once")
            found.append(aimed.launch.reshape(len(places), len(points), 3))
        return np.concatenate(found, axis=1)

    def _cross_section(self, goals: Goals) -> _Source:
        """The beam on a plane across it before the first surface, where that needs fewest nodes."""
        own = self._path.own
        whole = float((self._path.corners[1] - own.origin) @ own.axis)
        reach = np.sqrt(-np.log(_SHARE * min(self._tolerance, 1e-2)))
        last = self._rims[0].position if self._rims else len(self._interactions)
        angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
        circle = np.multiply.outer((0.5, 1.0), np.stack([np.cos(angle), np.sin(angle)], axis=1)).reshape(-1, 2)
        best, failure = None, None
        for part in _PARTS:
            middle = own.origin + part * whole * own.axis
            half = reach * own.radii_at(middle)
            places = middle + (np.concatenate([np.zeros((1, 2)), circle]) * half) @ own.across
            try:
                launch = self._launches(0, last, places, goals)
            except InputError as error:
                failure = error
                continue
            turned = (launch + own.directions_to_source(places)[:, None]) @ own.across.T
            slope = own.wavenumber * np.abs(turned).max(axis=(0, 1)) * _ROOM + _ENVELOPE * reach / half
            if best is None or np.prod(slope * half) < np.prod(best[2] * best[1]):
                best = middle, half, slope
            if best is not None and estimated_nodes(Circle(1.0), float(np.linalg.norm(slope * half))) < _FEW_NODES:
                break  # nearest to the surface paths are the smoothest
        if best is None:
            raise failure
        return self._beam_nodes(*best)

    def _beam_nodes(self, middle: np.ndarray, half: np.ndarray, slope: np.ndarray) -> _Source:
        """The beam on an ellipse of half sides (2,) across it [mm], with a slope (2,) of the phase [rad/mm]."""
        own = self._path.own
        steepest = float(np.linalg.norm(slope * half))  # on the unit circle that is stretched to it
        _require_few(estimated_nodes(Circle(1.0), steepest))
        nodes, areas = opening_nodes(Circle(1.0), Frame(np.zeros(3), np.eye(3)), steepest, self._quadrature)
        points = middle + (np.stack([nodes.a, nodes.b], axis=1) * half) @ own.across
        return _Source(points, own.field(points) * areas * np.prod(half), own.axis, 1.0, 0)

    @property
    def _quadrature(self) -> float:
        return max(_QUADRATURE * self._tolerance, 1e-12)

    def _rim_nodes(self, rim: Rim, goals: Goals) -> tuple[PlanePoints, np.ndarray]:
        """Nodes on an edge that resolve its light on the way to goals, and their areas."""
        starts, launches, _ = self._path.rays_around()
        following = next((one.position for one in self._rims if one.number > rim.number), len(self._interactions))
        arrived = trace(Sequence((*self._between(0, rim.position), rim.end)), starts, launches)
        good = np.all(np.isfinite(arrived.points[-1]), axis=1)
        places, directions = arrived.points[-1, good], arrived.directions[good]
        local = rim.plane.frame.to_local(places)
        inside = np.all(rim.plane.outline.margins(*local[:, :2].T) > -0.2, axis=0)
        if not np.any(inside):
            raise InputError(f"the light does not come through {rim.name!r}")
        places, directions = places[inside], directions[inside]
        launch = self._launches(rim.position, following, places, goals)
        turned = (launch - directions[:, None]) @ rim.plane.frame.axes[:, :2]
        slope = self._path.own.wavenumber * rim.index * np.abs(turned).max(axis=(0, 1)) * _ROOM
        slope = slope + _ENVELOPE / float(np.sqrt(np.prod(rim.plane.outline.half_size)))
        gradient = float(np.linalg.norm(slope)) if rim.plane.outline.is_round else tuple(slope)
        _require_few(estimated_nodes(rim.plane.outline, gradient))
        return opening_nodes(rim.plane.outline, rim.plane.frame, gradient, self._quadrature)

    def _on_rim(self, rim: Rim, goals: Goals) -> _Source:
        """The beam in the first edge, which it comes to unchanged."""
        nodes, areas = self._rim_nodes(rim, goals)
        points = nodes.points()
        return _Source(points, self._path.own.field(points) * areas, rim.normal, rim.index, rim.position)

    def _over(self, rim: Rim, goals: Goals, source: _Source) -> tuple[_Source, float]:
        """The light in a further edge, summed from the plane before, and the error of the sum."""
        nodes, areas = self._rim_nodes(rim, goals)
        path = self._leg(source, rim.end, rim.position)
        found = coherent_sum(path, source.points, source.weights, nodes, *self._how)
        return _Source(nodes.points(), found.field * areas, rim.normal, rim.index, rim.position), found.numerical_error


def _with_room(interaction: Interaction) -> Interaction:
    """An interaction that light may come to from the plane of its own rim, wherever the surface bulges to."""
    surface = interaction.surface
    if surface.is_plane or surface.outline is None:
        return interaction
    reach = surface.outline.reach
    depth = max(abs(float(surface.sag(reach, 0.0))), abs(float(surface.sag(0.0, reach))))
    return replace(interaction, slack=interaction.slack + 2 * depth)


def _require_few(count: float) -> None:
    if count > MOST_NODES:
        raise InputError(f"the sum over the light's cross-section needs {count:.1e} nodes, at most {MOST_NODES:.0e}")


def aberration(path: LightPath) -> float:
    """Root mean square [rad] by which the phase of exactly traced rays is off that of the Gaussian beam.

    Behind the last surface, every ray by its power: about the relative L2 error of a field without aberrations.
    """
    _, off, weight = path.off_beam(path.carried)
    return float(np.sqrt(np.average(off**2, weights=weight)))
