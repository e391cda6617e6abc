"""One way of the light with everything that its field is computed from: surfaces, rims, openings, the detector seen."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from ..geometry.frames import Frame
from ..geometry.outline import Circle, OffsetCircle
from ..geometry.plane import PlaneGrid
from ..optics.aim import ChiefRay
from ..optics.sequence import Interaction
from ..optics.surface import Surface
from .onward import Onward
from .routes import Route
from .stage import Stage


_SAME_PLACE = 1e-6
"""Distance [mm] up to which two places are one: light has no direction between them."""

_ROOM = 1.5
"""Factor on how far a face bends beyond its rim, for rays aslant."""


@dataclass(frozen=True, eq=False)
class Rim:
    """An outline that light goes through, as a plane: where it stands in the order of interactions.

    name: element; plane: the plane of the rim with its outline; number: of the interaction whose outline it is;
    position: number of interactions before the plane; index: of the medium there; is_screen: whether it is an aperture
    or a mirror's edge rather than a lens's; normal: (3,) of the plane, on the side that light goes on to;
    slack: how far behind the curved surface beside it the plane may lie for rays outside the rim [mm]; whole: of a
    round window that stands in the way of nothing, the radius of the rim that it is a part of [mm].
    """

    name: str
    plane: Surface
    number: int
    position: int
    index: float
    is_screen: bool
    normal: np.ndarray
    slack: float = 0.0
    whole: float | None = None

    @property
    def end(self) -> Interaction:
        """The rim's plane, unbounded, as the end of a sequence."""
        return replace(Interaction.through(Surface(self.plane.frame), self.index), slack=self.slack)


@dataclass(frozen=True)
class PhaseGradient:
    """Bound on the gradient of the light's phase over an opening [rad/mm]: of its length, or along x and y.

    tilt: across the radius and at the centre, where from there to the rim it stays below a straight line, else None;
    terms: of the expansions that the sum to the opening and the one from it need, as sampled.
    """

    bound: float | tuple[float, float]
    tilt: float | None = None
    terms: tuple[int, int] = (1, 1)


@dataclass(frozen=True)
class Channel:
    """One route with everything that its field is computed from.

    interactions: with plane mirrors unfolded; grid: the detector as seen through them; openings: where the light is
    diffracted, in order; rims: all outlines on the way, which cast shadows where the light is not diffracted; stages:
    what is done for it; gradients: of the light's phase over every opening; left_out: what the waves of edges that are
    not diffracted at amount to, relative to the field; hidden: pixels (rows, columns) that something hides from a part
    of the last opening; branches: the interactions of all ways over the same faces, this one's among them, where there
    are several; cut_by: names of shapes that cast a shadow on the first opening; chiefs: chief rays of its legs that
    have been found, by what ``legs.rays_over`` calls them; onward: which parts of the openings light the detector.
    """

    route: Route
    interactions: tuple[Interaction, ...]
    grid: PlaneGrid
    openings: tuple[Rim, ...]
    rims: tuple[Rim, ...]
    stages: tuple[Stage, ...]
    gradients: tuple[PhaseGradient, ...] = ()
    left_out: float = 0.0
    hidden: np.ndarray | None = None
    branches: tuple[tuple[Interaction, ...], ...] = ()
    cut_by: tuple[str, ...] = ()
    onward: tuple[Onward | None, ...] = ()
    chiefs: dict[tuple, ChiefRay | None] = field(default_factory=dict, compare=False, repr=False)

    @property
    def has_power(self) -> bool:
        """Whether anything on the way refracts or reflects light, plane mirrors apart."""
        return any(interaction.bends for interaction in self.interactions)

    @property
    def viewpoint(self) -> np.ndarray:
        """(3,) where the light from the target goes first: a surface, or the detector's centre [mm]."""
        return self.interactions[0].place if self.interactions else self.grid.centre

    def leg(self, number: int) -> tuple[Interaction, ...]:
        """The refracting and reflecting interactions between point set ``number`` and the next."""
        first = self.openings[number - 1].position if number > 0 else 0
        last = self.openings[number].position if number < len(self.openings) else len(self.interactions)
        return tuple(i for i in self.interactions[first:last] if i.bends)


def without_rims(interactions: Iterable[Interaction]) -> tuple[Interaction, ...]:
    """Interactions at surfaces that go on beyond their rims: where rims have their own say, paths need none."""
    return tuple(replace(i, surface=replace(i.surface, outline=None)) for i in interactions)


def with_slack(interactions: tuple[Interaction, ...]) -> tuple[Interaction, ...]:
    """Interactions whose curved faces may lie behind the planes of their own rims, for rays outside these."""
    return tuple(
        replace(one, slack=max(one.slack, _beyond_rim(one.surface))) if one.action != "pass" else one
        for one in interactions
    )


def _beyond_rim(surface: Surface) -> float:
    """How far [mm] a curved face goes on to bend around its rim, at the corners of a square around it."""
    if surface.is_plane or surface.outline is None:
        return 0.0
    reach = surface.outline.reach
    return _ROOM * float(abs(surface.sag(reach, reach) - surface.sag(reach, 0.0)))


def rims_of(
    spot: np.ndarray, names: tuple[str, ...], interactions: tuple[Interaction, ...], end: np.ndarray
) -> tuple[Rim, ...]:
    """The outlines among the interactions of a way from ``spot`` (3,) to ``end`` (3,), in order.

    The edge of a face that does nothing to light is none: what diffraction takes on one side it gives on the other.
    """
    places = np.array([spot, *(i.place for i in interactions), end])
    return tuple(
        _rim(name, number, interaction, _travel(places, number))
        for number, (name, interaction) in enumerate(zip(names, interactions, strict=True))
        if interaction.surface.outline is not None and not interaction.is_nothing
    )


def _travel(places: np.ndarray, number: int) -> np.ndarray:
    """(3,) the direction in which light comes to interaction ``number``, which is at ``places[number + 1]``.

    From the last place before it that is not the same; where it is the first of all, towards the next.
    """
    here = places[number + 1]
    for before in places[number::-1]:
        if np.linalg.norm(here - before) > _SAME_PLACE:
            return here - before
    return next((after - here for after in places[number + 2 :] if np.linalg.norm(after - here) > _SAME_PLACE), here)


def _rim(name: str, number: int, interaction: Interaction, travel: np.ndarray) -> Rim:
    """The plane of an interaction's outline; ``travel`` (3,) is the direction in which light comes to it.

    The rim of a curved surface lies off its vertex by the sag there. Where the surface bulges against the light,
    rays meet first the surface and then the plane of its rim.
    """
    surface, outline = interaction.surface, interaction.surface.outline
    axis = surface.frame.axes[:, 2]
    normal = axis if travel @ axis > 0 else -axis
    is_screen = interaction.action == "pass"
    if is_screen or surface.is_plane:
        return Rim(name, surface, number, number, interaction.index_before, is_screen, normal)
    if not surface.has_flat_rim:
        # A cylinder's rim lies in no plane: the one through the part of it that light comes to first stands for it.
        heights = np.array([0.0, surface.sag(outline.reach, 0.0), surface.sag(0.0, outline.reach)])
        first = heights[np.argmin(heights * float(travel @ axis))]
        plane = Surface(Frame(surface.frame.origin + first * axis, surface.frame.axes), outline=outline)
        return Rim(name, plane, number, number, interaction.index_before, False, normal)
    if isinstance(outline, OffsetCircle):
        # Cut out beside the axis, a rim lies in no plane: the one through its middle stands for it.
        plane = Surface(Frame(surface.middle, surface.frame.axes), outline=Circle(outline.radius))
        return Rim(name, plane, number, number, interaction.index_before, False, normal)
    sag = surface.sag(outline.reach, 0.0)
    bulges = sag * float(travel @ axis) > 0
    if bulges and interaction.action == "reflect":
        sag = 0.0  # light never comes to the plane of a convex mirror's rim: take the one through its vertex
    plane = Surface(Frame(surface.frame.origin + sag * axis, surface.frame.axes), outline=outline)
    if bulges and interaction.action == "refract":
        return Rim(name, plane, number, number + 1, interaction.index_after, False, normal, _beyond_rim(surface))
    return Rim(name, plane, number, number, interaction.index_before, False, normal, _beyond_rim(surface))
