"""Ray aiming: the ray from a source through a given point on the last plane, its path length, amplitude and caustics.

The launch direction is found by Newton's method with the exact Jacobian of the ray map (tangents carried through the
trace), damped by shortening steps that do not bring the ray closer. The same Jacobian is the ray tube: it gives the
geometric amplitude, and where it vanishes between source and target the ray has touched a caustic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from speckle_mi.optics.surfaces import Sequence, dot
from speckle_mi.optics.trace import Log, RayStatus, march, paired_rows

TARGET_TOLERANCE = 1e-8
"""Distance [mm] from ray to target that counts as hit. The path length is corrected for it to first order, so what is
left of it in the path is its square over the wavefront's radius."""
NEWTON_GOAL = 1e-7
"""Miss [mm] from which one more Newton step ends far below ``TARGET_TOLERANCE``."""
PLANE_TOLERANCE = 1e-6
"""Distance [mm] that a target may lie off the last plane by rounding; also corrected for."""
MAXIMUM_STEP = 0.3
"""Largest change of the launch direction [rad] in one Newton step."""
MAXIMUM_ITERATIONS = 40
CONTINUATION_STEPS = 12
"""Stages in which source and target move from a ray that is known to the one that Newton did not find directly."""


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
        """(n,) amplitude with the factor exp(-i pi/2) of every focal line on the way (phasor e^{+ikL}: Gouy's phase)."""
        return self.amplitude * np.array([1.0, -1.0j, -1.0, 1.0j])[self.caustics % 4]


def aim(sequence: Sequence, sources: np.ndarray, targets: np.ndarray) -> AimedPaths:
    """Rays from ``sources`` (n, 3) through ``targets`` (n, 3) on the last surface of ``sequence``, world [mm].

    Where several rays reach a target (beyond a caustic), the one continuously connected with the chief ray is found:
    the ray between the middles of sources and targets that leaves closest to the first vertex.
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
    chief = _chief_ray(sequence, source.mean(axis=1), target.mean(axis=1))
    if chief is None:
        direction = np.full_like(source, np.nan)
    else:
        direction = _newton(sequence, source, target, _linear_start(sequence, chief, source, target))
        lost = ~np.isfinite(direction[0])
        if lost.any():
            direction[:, lost] = _continuation(sequence, chief, source[:, lost], target[:, lost])
    return _evaluate(sequence, sources, targets, direction)


@dataclass(frozen=True)
class _ChiefRay:
    """A ray known to get through: source, landing point and launch direction, (3, 1) each."""

    source: np.ndarray
    landing: np.ndarray
    direction: np.ndarray


def _chief_ray(sequence: Sequence, source: np.ndarray, target: np.ndarray) -> _ChiefRay | None:
    """The ray through ``target`` that leaves closest to the first vertex; else that of a fan which lands closest.

    None when no ray of the fan comes through.
    """
    straight = target - source
    axis = sequence.interactions[0].surface.frame.origin - source
    axis = axis if np.linalg.norm(axis) > 0.0 else straight
    axis = axis[:, None] / np.linalg.norm(axis)
    polar, azimuth = (mesh.ravel() for mesh in np.meshgrid([0.01, 0.03, 0.1, 0.3, 0.8], np.arange(8) * (np.pi / 4)))
    e1, e2 = _transverse(axis)
    cone = np.cos(polar) * axis + np.sin(polar) * (np.cos(azimuth) * e1 + np.sin(azimuth) * e2)
    fan = np.concatenate([axis, straight[:, None] / np.linalg.norm(straight), cone], axis=1)
    count = fan.shape[1]
    origin = np.repeat(source[:, None], count, axis=1)
    aimed = _newton(sequence, origin, np.repeat(target[:, None], count, axis=1), fan)
    for candidates, found in ((aimed, True), (fan, False)):
        good = np.isfinite(candidates[0])
        landing, status = _landings(sequence, origin, candidates)
        for worst in (RayStatus.OK, RayStatus.OUTSIDE_OUTLINE):
            usable = np.flatnonzero(good & (status <= worst))
            if usable.size:
                miss = np.linalg.norm(landing - target[:, None], axis=0)
                order = -dot(candidates, axis) if found else miss
                best = usable[np.argmin(order[usable])]
                return _ChiefRay(source[:, None], landing[:, best : best + 1], candidates[:, best : best + 1])
    return None


def _landings(sequence: Sequence, source: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World points (3, n) on the last plane and status (n,)."""
    log = Log(source.shape[1])
    for step in march(sequence, np.stack([source, direction], axis=1)):
        log.add(step)
    return sequence.last.surface.frame.to_world(step.state[:, 0].T).T, log.status


def _linear_start(sequence: Sequence, chief: _ChiefRay, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Launch directions (3, n) from the ray map linearised about the chief ray, no symmetry assumed."""
    e1, e2 = _transverse(chief.direction)
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
    return _turned(chief.direction, e1, e2, angles)


def _newton(sequence: Sequence, source: np.ndarray, target: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Launch directions of the rays through ``target``, NaN where none was found from ``start``; all (3, n)."""
    aim_xy = (sequence.last.surface.frame.axes.T @ (target - sequence.last.surface.frame.origin[:, None]))[:2]
    result = np.full_like(start, np.nan)
    active = np.arange(start.shape[1])
    direction, trial = start.copy(), start.copy()
    miss = np.full(active.size, np.inf)
    step = np.zeros((2, active.size))
    for _ in range(MAXIMUM_ITERATIONS):
        e1, e2 = _transverse(trial)
        for last in march(sequence, _launch_state(source[:, active], trial, e1, e2)):
            pass
        residual = aim_xy[:, active] - last.state[:2, 0]
        trial_miss = np.hypot(*residual)
        better = trial_miss < miss
        newton_step = _solve(last.state[:2, 2], last.state[:2, 3], residual)
        done = better & (trial_miss < NEWTON_GOAL)
        result[:, active[done]] = _turned(trial, e1, e2, newton_step)[:, done]
        # A step belongs to the transverse frame of the direction it starts from: the trial if accepted, else the old.
        direction = np.where(better, trial, direction)
        step = np.where(better, newton_step, 0.25 * step)
        miss = np.where(better, trial_miss, miss)
        keep = ~done & np.isfinite(miss)
        if not keep.any():
            break
        active, direction, step, miss = active[keep], direction[:, keep], step[:, keep], miss[keep]
        trial = _turned(direction, *_transverse(direction), step)
    return result


def _continuation(sequence: Sequence, chief: _ChiefRay, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Like ``_newton``, with source and target moved over in stages from the chief ray's."""
    direction = np.repeat(chief.direction, source.shape[1], axis=1)
    for part in np.linspace(0.0, 1.0, CONTINUATION_STEPS + 1)[1:]:
        direction = _newton(
            sequence,
            chief.source + part * (source - chief.source),
            chief.landing + part * (target - chief.landing),
            direction,
        )
    return direction


def _evaluate(sequence: Sequence, sources: np.ndarray, targets: np.ndarray, direction: np.ndarray) -> AimedPaths:
    """Trace the rays found, with their tubes."""
    n = sources.shape[0]
    log, caustics, length = Log(n), np.zeros(n, dtype=np.int64), np.zeros(n)
    with np.errstate(invalid="ignore", divide="ignore"):
        for step in march(sequence, _launch_state(sources.T, direction, *_transverse(direction)), tubes=True):
            log.add(step)
            caustics += _zeros_between(*step.tube, step.length)
            length += np.abs(step.length)
        axes = sequence.last.surface.frame.axes
        arrival = axes @ step.state[:, 1]
        landing = sequence.last.surface.frame.to_world(step.state[:, 0].T)
        a0, a1, a2 = step.tube
        section, slope = a0 + step.length * (a1 + step.length * a2), a1 + 2.0 * step.length * a2
        bend = np.sqrt(np.maximum(slope * slope - 4.0 * section * a2, 0.0))
        focal_distance = np.where(section == 0.0, 0.0, 2.0 * np.abs(section) / (np.abs(slope) + bend))
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
            caustics=np.where(np.isnan(lost), -1, caustics),
            spread=np.abs(section) / length**2 + lost,
            focal_distance=focal_distance + lost,
            margins=log.stacked_margins() + lost,
            status=status,
        )


def _zeros_between(a0: np.ndarray, a1: np.ndarray, a2: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Zeros of a0 + a1 t + a2 t^2 in 0 < t < length, (n,) int.

    The tube's wavefront has two real principal curvatures (Malus and Dupin), so the zeros are real: counted by signs,
    which still finds the double zero of a point focus when rounding makes its discriminant negative.
    """
    end = a0 + length * (a1 + length * a2)
    turn = -0.5 * a1 / a2
    one = a0 * end < 0.0
    two = (a0 * end > 0.0) & (a0 * a2 > 0.0) & (turn > 0.0) & (turn < length)
    return np.where(one, 1, np.where(two, 2, 0))


def _launch_state(source: np.ndarray, direction: np.ndarray, e1: np.ndarray, e2: np.ndarray) -> np.ndarray:
    """Rays with tangents along two orthonormal launch angles: their Jacobian is per solid angle."""
    zero = np.zeros_like(source)
    return np.stack([source, direction, zero, zero, e1, e2], axis=1)


def _transverse(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3, n) that make an orthonormal frame with unit ``direction`` (3, n).

    T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
    """
    x, y, z = direction
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x]), np.stack([b, sign + y * y * a, -y])


def _turned(direction: np.ndarray, e1: np.ndarray, e2: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """``direction`` (3, n) turned by small ``angles`` (2, n) towards e1, e2; unit."""
    turned = direction + angles[0] * e1 + angles[1] * e2
    return turned / np.sqrt(dot(turned, turned))


def _solve(first: np.ndarray, second: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Newton step (2, n) [rad], at most ``MAXIMUM_STEP`` long; ``first``, ``second`` (2, n): the Jacobian's columns."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        determinant = first[0] * second[1] - first[1] * second[0]
        step = np.stack(
            [residual[0] * second[1] - residual[1] * second[0], first[0] * residual[1] - first[1] * residual[0]]
        )
        step /= determinant
        # On a caustic the Jacobian is singular: no step, rather than a meaningless one.
        step = np.where(np.isfinite(step), step, 0.0)
        norm = np.hypot(*step)
        return np.where(norm > MAXIMUM_STEP, step * (MAXIMUM_STEP / norm), step)
