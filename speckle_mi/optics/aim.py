"""Ray aiming: the ray from a source through a given point on the last plane, its path length, amplitude and caustics.

The launch direction is found by Newton's method with the exact Jacobian of the ray map (tangents carried through the
trace). The same Jacobian is the ray tube: it gives the geometric amplitude, and where it vanishes between source and
target the ray has touched a caustic.

Near a focus several rays reach a target, all of them exact: with spherical aberration one from the middle of the pupil
and two from far outside. The caustics they have touched tell their branches apart. A chief ray in the middle of the
outlines gives the branch; its rays are found by Newton's method from the ray map linearised about the chief ray, else
by continuation from it. Only a target that the branch does not reach is searched from many sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from .launch import MAXIMUM_STEP, launch_state, newton_step, transverse, turned
from .sequence import Sequence
from .surface import dot
from .trace import Caustics, Log, RayStatus, march, paired_rows, tube_at_end

TARGET_TOLERANCE = 1e-8
"""Distance [mm] from ray to target that counts as hit. The path length is corrected for it to first order, so what is
left of it in the path is its square over the wavefront's radius."""

NEWTON_GOAL = 1e-7
"""Miss [mm] from which one more Newton step ends far below ``TARGET_TOLERANCE``."""

PLANE_TOLERANCE = 1e-6
"""Distance [mm] that a target may lie off the last plane by rounding; also corrected for."""

MAXIMUM_ITERATIONS, MOST_WORSE = 40, 6
"""Of Newton's method; and of shorter and shorter steps, each a quarter, that bring a ray no closer: it is at a fold."""

CONTRACTION, CONTRACTING_ITERATIONS = 0.5, 12
"""Largest ratio of a Newton step to the one before with which the iteration is trusted to end at the root next to its
start. Natural monotonicity test: P. Deuflhard, "Newton Methods for Nonlinear Problems", Springer 2004, section 2.1."""

FIRST_STAGE, LAST_STAGE = 0.25, 2.0**-8
"""Part of the way from the chief ray's ends to a ray's own that continuation tries first, and the one at which it gives
up: the branch has ended in a fold."""

SEARCH_ANGLES = np.array([0.01, 0.03, 0.1, 0.3, 0.8])

PROBE_ANGLES = np.geomspace(1e-3, 0.8, 14)
"""Angles [rad] to the direction of the first vertex at which a search starts, and at which is looked for free rays."""

SEARCH_BATCH = 1000
"""Targets searched at once, to bound the memory."""


@dataclass(frozen=True, eq=False)
class AimedPaths:
    """Rays from n sources to n targets. Where ``converged`` is false, everything but the status is NaN (counts: -1).

    optical_path_length: (n,) sum of index times length from source to target [mm];
    launch, arrival: (n, 3) unit directions at the source and at the target, world;
    amplitude: (n,) geometric amplitude sqrt(dOmega_source / (dA_target |cos chi_target|)) [1/mm] of a source of unit
    amplitude at unit distance, 1/r in free space; reflection losses are not in it;
    caustics: (n,) focal lines the ray touched on its way; the field is amplitude * exp(i k L - i pi/2 caustics);
    spread: (n,) cross section of the ray tube per solid angle over the square of the geometric length: 1 in free space,
    0 on a caustic;
    focal_distance: (n,) distance [mm] along the arriving ray from the target to the nearest focal line, either side,
    inf for a collimated tube; geometric optics needs it to be many depths of focus;
    margins: (r, n) clearance of the rims listed in ``Sequence.rims``, > 0 inside;
    status: (n,) RayStatus codes; a ray beyond a rim is converged all the same.
    """

    optical_path_length: np.ndarray
    launch: np.ndarray
    arrival: np.ndarray
    amplitude: np.ndarray
    caustics: np.ndarray
    spread: np.ndarray
    focal_distance: np.ndarray
    margins: np.ndarray
    status: np.ndarray

    @property
    def converged(self) -> np.ndarray:
        """(n,) a ray through the target exists and is physical; it may be vignetted, see ``margins``."""
        return self.status <= RayStatus.OUTSIDE_OUTLINE

    @property
    def complex_amplitude(self) -> np.ndarray:
        """(n,) amplitude with the factor exp(-i pi/2) of every focal line on the way (Gouy's phase for e^{+ikL})."""
        return self.amplitude * np.array([1.0, -1.0j, -1.0, 1.0j])[self.caustics % 4]


def aim(
    sequence: Sequence, sources: np.ndarray, targets: np.ndarray, near: np.ndarray | None = None,
    chief: ChiefRay | None = None,
) -> AimedPaths:  # fmt: skip
    """Rays from ``sources`` (n, 3) through ``targets`` (n, 3) on the last surface of ``sequence``, world [mm].

    near: (n, 3) launch directions of known rays close by, whose branch is then taken, in a tenth of the time.
    chief: what :func:`chief_ray` finds from the sources' mean to the targets', where it is known.

    Where several rays reach a target (near a focus), one inside all outlines is taken before the others, and then the
    one that leaves closest to the first vertex.
    Raises ValueError when the last surface is not a plane that light passes, or a target is not on it.
    """
    sources, targets = paired_rows(sources, targets, "sources", "targets")
    last = sequence.last.surface
    if not (last.is_plane and sequence.last.action == "pass"):
        raise ValueError("aim: the last interaction must be a plane that light passes ('pass'), where the targets lie")
    off = np.abs(last.frame.to_local(targets)[:, 2]).max(initial=0.0)
    if not off <= PLANE_TOLERANCE:
        raise ValueError(f"aim: targets lie up to {off:.3g} mm off the last plane, must be on it")
    if sources.shape[0] == 0:
        return _evaluate(sequence, sources, targets, np.empty((3, 0)))
    source, target = sources.T, targets.T
    if near is None and not any(interaction.bends for interaction in sequence.interactions):
        near = _straight(sources, targets)
    if near is not None:
        found = _evaluate(sequence, sources, targets, _contract(sequence, source, target, near.T))
        if np.all(found.converged):
            return found
    if chief is None:
        chief = chief_ray(sequence, source.mean(axis=1, keepdims=True), target.mean(axis=1, keepdims=True))
    if chief is None:
        return _evaluate(sequence, sources, targets, _search(sequence, source, target))
    direction = _contract(sequence, source, target, _linear_start(sequence, chief, source, target))
    found = _evaluate(sequence, sources, targets, direction)
    for method in (partial(_continuation, chief), _search):
        rest = ~chief.settles(found)
        if not rest.any():
            break
        direction[:, rest] = method(sequence, source[:, rest], target[:, rest])
        found = _evaluate(sequence, sources, targets, direction)
    return found


def rays_between(
    sequence: Sequence, source: np.ndarray, target: np.ndarray, starts: np.ndarray, apart: float
) -> np.ndarray:
    """Launch directions (k, 3) of all rays from ``source`` to ``target`` (3,) that Newton's method finds.

    starts: (n, 3) unit directions that it begins at; apart: angle [rad] from which on two rays are not the same.
    """
    origin, aims = (np.repeat(place[:, None], len(starts), axis=1) for place in (source, target))
    direction = _newton(sequence, origin, aims, starts.T)
    _, status, _ = _follow(sequence, origin, direction)
    found: list[np.ndarray] = []
    for one in direction.T[status <= RayStatus.OUTSIDE_OUTLINE]:
        if all(np.linalg.norm(one - other) > apart for other in found):
            found.append(one)
    return np.array(found).reshape(-1, 3)


def _straight(sources: np.ndarray, targets: np.ndarray) -> np.ndarray | None:
    """Unit directions (n, 3) from sources to targets, None where one has none."""
    along = targets - sources
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return along / length if np.all(length > 0) else None


@dataclass(frozen=True)
class ChiefRay:
    """A ray known to get through: source, landing point and launch direction, (3, 1) each.

    caustics: focal lines it touched; folded: whether rays of other branches get through the outlines, too.
    """

    source: np.ndarray
    landing: np.ndarray
    direction: np.ndarray
    caustics: int
    folded: bool

    def settles(self, found: AimedPaths) -> np.ndarray:
        """(n,) rays of the chief ray's branch which no ray of another is to be preferred to."""
        worst = RayStatus.OK if self.folded else RayStatus.OUTSIDE_OUTLINE
        return (found.status <= worst) & (found.caustics == self.caustics)


def chief_ray(sequence: Sequence, source: np.ndarray, target: np.ndarray) -> ChiefRay | None:
    """The ray from ``source`` (3, 1) to ``target`` (3, 1), on the branch of the free ray closest to the first vertex.

    Where that branch does not reach the target, the free ray itself; where no ray is free, what a search finds, else
    the ray of a fan that lands closest. None when no ray of the fan comes through.
    """
    axis = _to_first_vertex(sequence, source, target)
    starts = _fan(source, target, axis, SEARCH_ANGLES)
    origin, aims = np.broadcast_to(source, starts.shape), np.broadcast_to(target, starts.shape)
    aimed = _newton(sequence, origin, aims, starts)
    probes = _fan(source, target, axis, PROBE_ANGLES)
    direction = np.concatenate([aimed, probes], axis=1)
    landing, status, caustics = _follow(sequence, np.broadcast_to(source, direction.shape), direction)
    reaches = np.arange(status.size) < aimed.shape[1]
    free, nearness = status == RayStatus.OK, dot(direction, axis)
    branch = free & ~reaches
    if branch.any():
        middle = np.flatnonzero(branch)[np.argmax(nearness[branch])]
        on_branch = reaches & (status <= RayStatus.OUTSIDE_OUTLINE) & (caustics == caustics[middle])
        best = _preferred(status, nearness, on_branch) if on_branch.any() else middle
    else:
        usable = status <= RayStatus.OUTSIDE_OUTLINE
        if not usable.any():
            return None
        miss = np.linalg.norm(landing - target, axis=0)
        found = usable & reaches
        best = _preferred(status, nearness, found) if found.any() else np.argmin(np.where(usable, miss, np.inf))
    folded = bool(np.any(caustics[free] != caustics[best]))
    one = slice(best, best + 1)
    return ChiefRay(source, landing[:, one], direction[:, one], int(caustics[best]), folded)


def _search(sequence: Sequence, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Launch directions (3, n) of the preferred rays, each found by itself from a fan of starts, NaN where none."""
    result = np.full(source.shape, np.nan)
    for first in range(0, source.shape[1], SEARCH_BATCH):
        batch = slice(first, first + SEARCH_BATCH)
        axis = _to_first_vertex(sequence, source[:, batch], target[:, batch])
        starts = _fan(source[:, batch], target[:, batch], axis, SEARCH_ANGLES)
        n, count = axis.shape[1], starts.shape[1] // axis.shape[1]
        origin, aims = np.tile(source[:, batch], count), np.tile(target[:, batch], count)
        direction = _newton(sequence, origin, aims, starts)
        _, status, _ = _follow(sequence, origin, direction)
        nearness = dot(direction, np.tile(axis, count))
        usable = status <= RayStatus.OUTSIDE_OUTLINE
        best = _preferred(status.reshape(count, n), nearness.reshape(count, n), usable.reshape(count, n))
        found = direction.reshape(3, count, n)[:, best, np.arange(n)]
        result[:, batch] = np.where(usable.reshape(count, n).any(axis=0), found, np.nan)
    return result


def _preferred(status: np.ndarray, nearness: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Index along the first axis of the usable ray to prefer: inside all outlines, then closest to the first vertex."""
    merit = np.where(usable, nearness - 4.0 * (status != RayStatus.OK), -np.inf)  # cosines differ by 2 at most
    return np.argmax(merit, axis=0)


def _to_first_vertex(sequence: Sequence, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Unit directions (3, n) from the sources to where the first surface has its light, else to the target."""
    axis = sequence.interactions[0].place[:, None] - source
    axis = np.where(np.any(axis != 0.0, axis=0), axis, target - source)
    return axis / np.maximum(np.sqrt(dot(axis, axis)), 1e-300)


def _fan(source: np.ndarray, target: np.ndarray, axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Directions (3, m n), m for each of n rays, m the slower index: ``axis``, straight, cones about the axis."""
    straight = target - source
    straight = np.where(np.any(straight != 0.0, axis=0), straight, axis)
    straight = straight / np.sqrt(dot(straight, straight))
    polar, azimuth = (mesh.reshape(-1, 1) for mesh in np.meshgrid(angles, np.arange(8) * (np.pi / 4)))
    e1, e2 = (e[:, None] for e in transverse(axis))
    cones = np.cos(polar) * axis[:, None] + np.sin(polar) * (np.cos(azimuth) * e1 + np.sin(azimuth) * e2)
    return np.concatenate([axis, straight, cones.reshape(3, -1)], axis=1)


def _follow(
    sequence: Sequence, source: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World points (3, n) on the last plane, status (n,) and number of caustics (n,)."""
    log, caustics = Log(source.shape[1]), Caustics(source.shape[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        for step in march(sequence, launch_state(source, direction, *transverse(direction)), tubes=True):
            log.add(step)
            caustics.add(step)
        return sequence.last.surface.frame.to_world(step.state[:, 0].T).T, log.status, caustics.count


def _linear_start(sequence: Sequence, chief: ChiefRay, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Launch directions (3, n) from the ray map linearised about the chief ray, no symmetry assumed."""
    e1, e2 = transverse(chief.direction)
    state = np.zeros((3, 12, 1))
    state[:, 0], state[:, 1] = chief.source, chief.direction
    state[:, 2:5, 0] = np.eye(3)
    state[:, 10], state[:, 11] = e1, e2
    for step in march(sequence, state):
        pass
    by_source, by_direction = step.state[:2, 2:5, 0], step.state[:2, 5:7, 0]
    axes = sequence.last.surface.frame.axes
    wanted = (axes.T @ (target - chief.landing))[:2] - by_source @ (source - chief.source)
    # Regularised: where source and target are conjugate the direction is undetermined, and zero is the best guess.
    angles = np.linalg.lstsq(by_direction, wanted, rcond=1e-3)[0]
    angles *= np.minimum(1.0, MAXIMUM_STEP / np.maximum(np.hypot(*angles), MAXIMUM_STEP))
    return turned(chief.direction, e1, e2, angles)


def _newton(sequence: Sequence, source: np.ndarray, target: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Launch directions of rays through ``target``, NaN where none was found from ``start``; all (3, n).

    Damped by shortening steps that do not bring the ray closer: finds a ray from far away, but not always the nearest.
    """
    aim_xy = (sequence.last.surface.frame.axes.T @ (target - sequence.last.surface.frame.origin[:, None]))[:2]
    result = np.full_like(start, np.nan)
    active = np.arange(start.shape[1])
    direction, trial = start.copy(), start.copy()
    miss = np.full(active.size, np.inf)
    step, worse = np.zeros((2, active.size)), np.zeros(active.size, dtype=int)
    for _ in range(MAXIMUM_ITERATIONS):
        e1, e2 = transverse(trial)
        for last in march(sequence, launch_state(source[:, active], trial, e1, e2)):
            pass
        residual = aim_xy[:, active] - last.state[:2, 0]
        trial_miss = np.hypot(*residual)
        better = trial_miss < miss
        onward = newton_step(last.state[:2, 2], last.state[:2, 3], residual)
        done = better & (trial_miss < NEWTON_GOAL)
        result[:, active[done]] = turned(trial, e1, e2, onward)[:, done]
        # A step belongs to the transverse frame of the direction it starts from: the trial if accepted, else the old.
        direction = np.where(better, trial, direction)
        step = np.where(better, onward, 0.25 * step)
        miss, worse = np.where(better, trial_miss, miss), np.where(better, 0, worse + 1)
        keep = ~done & np.isfinite(miss) & (worse < MOST_WORSE)
        if not keep.any():
            break
        active, direction, step = active[keep], direction[:, keep], step[:, keep]
        miss, worse = miss[keep], worse[keep]
        trial = turned(direction, *transverse(direction), step)
    return result


def _contract(sequence: Sequence, source: np.ndarray, target: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Like ``_newton``, but only where the steps contract from the start on, so that the root is the one next to it."""
    aim_xy = (sequence.last.surface.frame.axes.T @ (target - sequence.last.surface.frame.origin[:, None]))[:2]
    result = np.full_like(start, np.nan)
    active, direction = np.arange(start.shape[1]), start
    longest = np.full(active.size, np.inf)
    for _ in range(CONTRACTING_ITERATIONS):
        e1, e2 = transverse(direction)
        for last in march(sequence, launch_state(source[:, active], direction, e1, e2)):
            pass
        residual = aim_xy[:, active] - last.state[:2, 0]
        miss, step = np.hypot(*residual), newton_step(last.state[:2, 2], last.state[:2, 3], residual)
        length = np.hypot(*step)
        contracts = np.isfinite(miss) & (length <= longest)
        direction = turned(direction, e1, e2, step)
        done = contracts & (miss < NEWTON_GOAL)
        result[:, active[done]] = direction[:, done]
        keep = contracts & ~done
        if not keep.any():
            break
        active, direction, longest = active[keep], direction[:, keep], CONTRACTION * length[keep]
    return result


def _continuation(chief: ChiefRay, sequence: Sequence, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Launch directions (3, n) of the chief ray's branch, NaN where it does not reach ``target`` (3, n).

    Source and target move over from the chief ray's in stages, shorter ones where the rays turn quickly.
    """
    n = source.shape[1]
    result, direction = np.full_like(source, np.nan), np.repeat(chief.direction, n, axis=1)
    part, stage, active = np.zeros(n), np.full(n, FIRST_STAGE), np.arange(n)
    while active.size:
        ahead = np.minimum(part + stage, 1.0)
        moved = _contract(
            sequence,
            chief.source + ahead * (source[:, active] - chief.source),
            chief.landing + ahead * (target[:, active] - chief.landing),
            direction,
        )
        good = np.isfinite(moved[0])
        part, direction = np.where(good, ahead, part), np.where(good, moved, direction)
        stage = np.where(good, 2.0 * stage, 0.5 * stage)
        arrived = part >= 1.0
        result[:, active[arrived]] = direction[:, arrived]
        keep = ~arrived & (stage > LAST_STAGE)
        active, direction, part, stage = active[keep], direction[:, keep], part[keep], stage[keep]
    return result


def _evaluate(sequence: Sequence, sources: np.ndarray, targets: np.ndarray, direction: np.ndarray) -> AimedPaths:
    """Trace the rays found, with their tubes."""
    n = sources.shape[0]
    log, caustics, length = Log(n), Caustics(n), np.zeros(n)
    with np.errstate(invalid="ignore", divide="ignore"):
        for step in march(sequence, launch_state(sources.T, direction, *transverse(direction)), tubes=True):
            log.add(step)
            caustics.add(step)
            length += np.abs(step.length)
        axes = sequence.last.surface.frame.axes
        arrival = axes @ step.state[:, 1]
        landing = sequence.last.surface.frame.to_world(step.state[:, 0].T)
        section, focal_distance = tube_at_end(step)
        offset = (targets - landing).T
        path = log.optical_path_length + sequence.last.index_before * dot(arrival, offset)
        status = log.status
        hit = np.hypot(*(axes.T @ offset)[:2]) < TARGET_TOLERANCE
        status[~np.isfinite(direction[0]) | ((status <= RayStatus.OUTSIDE_OUTLINE) & ~hit)] = RayStatus.NOT_CONVERGED
        lost = np.where(status <= RayStatus.OUTSIDE_OUTLINE, 0.0, np.nan)  # added to every result
        return AimedPaths(
            optical_path_length=path + lost,
            launch=(direction + lost).T,
            arrival=(arrival + lost).T,
            amplitude=1.0 / np.sqrt(np.abs(section)) + lost,
            caustics=np.where(np.isnan(lost), -1, caustics.count),
            spread=np.abs(section) / length**2 + lost,
            focal_distance=focal_distance + lost,
            margins=log.stacked_margins() + lost,
            status=status,
        )
