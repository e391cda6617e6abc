"""Closed formulas of laser speckle: displacement, decorrelation, speckle statistics, imaging, triangulation.

First-order theory that a simulation is compared with. Lengths in mm, angles in rad (`per_degree` converts a result),
world coordinates, float64. A motion is (x, y, z, rx, ry, rz): translation along, then right-handed rotation about,
the target's axes through its origin. Directions point away from the target: towards the laser, towards the detector.

References
----------
[1] I. Yamaguchi, Optica Acta 28, 1359-1376 (1981), doi:10.1080/713820454: displacement and decorrelation.
[2] Opt. Eng. 61(6), 061410 (2022), doi:10.1117/1.OE.61.6.061410: Eqs. (1)-(7), special case of [1].
[3] J. W. Goodman, Speckle Phenomena in Optics (2007): statistics, coherence of a speckle pattern.
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..geometry.rotation import cross_matrix, vectors_across
from .directions import (
    GRAZING_COSINE,
    detector_axes,
    frame_axes,
    require_lit,
    text,
    unit,
    wave_hessian,
)


def first_order_displacement(
    spot: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    source_direction: np.ndarray,
    wavefront_radius: float | np.ndarray,
    detector_centre: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    normal: np.ndarray | None = None,
) -> np.ndarray:
    """Displacement of the free-space speckle pattern on the detector per unit rigid motion of the target.

    A scatterer at P sends light to D over the optical path psi(P) + |P - D|. A motion moves it by
    a(P) = translation + Omega x (P - origin); the pattern at D reappears at D + A where the path changes by the same
    amount for every scatterer of the spot, that is where the change has no gradient along the surface. With
    grad psi = -l_S, grad |P - D| = -l and the Hessians Q = (1 - l l^T)/L of both, that gradient is to first order
    (1 + [Omega]x)^T (-l_S - l + (Q_S + Q_O) a - Q_O A) + l_S + l, hence

        t Q_O T alpha = t [(Q_S + Q_O) a + Omega x (l_S + l)],    A = T alpha,

    t the projection on the tangent plane at the spot. Positive: the pattern moves along +u, +v. Ref. [1]; with a
    detector that faces the spot, projected on the target (`project_on_target`), it is Eqs. (1)-(7) of [2], where the
    second L_O L_O/(L_S L_S) of Eq. (2) is a misprint of L_O/L_S and Omega_x is counted left-handed in Eqs. (2), (7).

    spot: (3,) where the beam axis meets the surface [mm]. origin: (3,) rotation centre, the target's origin [mm].
    axes: (3, 3) columns are the target's x, y, z axes. source_direction: (3,) unit vector l_S from the spot towards
    the laser. wavefront_radius: L_S [mm], + diverging, - converging, inf collimated; of an astigmatic wave its Hessian
    Q_S, (3, 3) [1/mm], from `astigmatic_wave`. detector_centre: (3,) [mm].
    u, v: (3,) directions of increasing column and row. normal: (3,) surface normal at the spot; None is the target's z.

    Returns (2, 6): rows u, v; columns x, y, z [mm/mm], rx, ry, rz [mm/rad].
    Raises ValueError for a detector at the spot, grazing detection, or vectors that are not unit or orthogonal.
    """
    sight = np.asarray(detector_centre, dtype=np.float64) - np.asarray(spot, dtype=np.float64)
    distance = float(np.linalg.norm(sight))
    if not (np.isfinite(distance) and distance > 0):
        raise ValueError(f"detector_centre {text(detector_centre)}, {distance} mm from the spot: must be apart")
    plane = detector_axes(u, v)
    return _plane_displacement(
        spot, origin, axes, source_direction, wavefront_radius, sight / distance, distance, plane, normal
    )


def _plane_displacement(spot, origin, axes, source_direction, wavefront_radius, sight, distance, plane, normal):
    """(2, 6) displacement on a plane with axes ``plane`` (3, 2), ``distance`` [mm, signed] along ``sight``.

    Seen across the line of sight, a ray's end moves on the plane as its beginning does, and by the distance per tilt.
    """
    plane_normal = np.cross(plane[:, 0], plane[:, 1])
    _require_view("detector", sight, plane_normal)
    across = vectors_across(sight)
    foreshortened = np.linalg.inv(across @ plane)
    return system_displacement(
        spot, origin, axes, source_direction, wavefront_radius, sight, across,
        foreshortened, distance * foreshortened, normal,
    )


def system_displacement(
    spot: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    source_direction: np.ndarray,
    wavefront_radius: float | np.ndarray,
    line_of_sight: np.ndarray,
    across: np.ndarray,
    magnification: np.ndarray,
    lever: np.ndarray,
    normal: np.ndarray | None = None,
) -> np.ndarray:
    """Displacement of the pattern behind any optics, astigmatic or not, per unit rigid motion of the target.

    Let V(P, D) be the optical path from P on the target to D on the detector, and psi(P) that of the light from the
    laser. The ray from P to D leaves along l, so that grad_P V = -l; grad psi = -l_S. A motion a(P) = translation +
    Omega x (P - origin) changes the path of the scatterer at P by (grad psi + grad V).a, and the pattern reappears at
    D + A where the change of the whole path has no gradient along the surface (a constant is of no account): for every
    s in it

        s.[V_PD A + d/dP((grad psi + grad V).a)] = 0.

    Rays tell the second derivatives of V. The end of a ray moves by M per shift of its beginning across l, and by B,
    the lever, per tilt dl of it: dD = M dP + B dl. At fixed P that is V_PD dD = -dl = -B^-1 dD, at fixed D it is
    V_PP dP = -dl = B^-1 M dP. With Q_S = (1 - l_S l_S^T)/L_S the Hessian of psi, and dl standing for B^-1 (A - M a),

        alpha = M (a across l) + B dl,    t.dl = t.[Q_S a + Omega x (l_S + l)],

    t the tangents at the spot: two equations for dl, which lies across l. Nothing is divided by the lever, so that it
    may vanish in one direction or in both: M a is all of the motion in focus. Off its axis a system's lever differs in
    the tangential and the sagittal direction. In free space M = 1, B = L_O, see `first_order_displacement`. Ref. [1].

    spot ... wavefront_radius, normal: as in `first_order_displacement`. line_of_sight: (3,) unit vector l of the chief
    ray at the spot. across: (2, 3) unit vectors at right angles to it and to each other. magnification: (2, 2) M
    [mm/mm] and lever: (2, 2) B [mm/rad], to (u, v) on the detector from components along ``across``.

    Limits: those of `imaging_displacement`. Returns (2, 6) [mm/mm], [mm/rad]. Raises ValueError as
    `first_order_displacement`, or for a matrix that is not (2, 2) and finite.
    """
    for name, matrix in (("magnification", magnification), ("lever", lever)):
        if np.shape(matrix) != (2, 2) or not np.all(np.isfinite(matrix)):
            raise ValueError(f"{name} {matrix!r}: must be a (2, 2) matrix of finite numbers")
    axes = frame_axes(axes)
    to_laser, sight = unit("source_direction", source_direction), unit("line_of_sight", line_of_sight)
    normal = axes[:, 2] if normal is None else unit("normal", normal)
    _require_view("target", sight, normal)
    tangents = vectors_across(normal)
    material = _motion_of_point(spot, origin, axes)
    turned = np.hstack([np.zeros((3, 3)), -cross_matrix(to_laser + sight) @ axes])
    change = wave_hessian(wavefront_radius, to_laser) @ material + turned
    tilt = np.linalg.solve(tangents @ across.T, tangents @ change)
    return magnification @ across @ material + lever @ tilt


def wavelength_displacement(
    spot: np.ndarray,
    normal: np.ndarray,
    source_direction: np.ndarray,
    detector_centre: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
) -> np.ndarray:
    """(2,) displacement [mm] along u, v of the free-space pattern per relative change of the wavelength.

    The phase k (psi + |P - D|) of the scatterers has the gradient -k t (l_S + l) along the surface. In light of k', a
    little smaller by dlambda/lambda, the same is found at D + A: t Q_O T alpha = (dlambda/lambda) t (l_S + l). The
    pattern moves away from where light would be reflected by a mirror, in proportion to the tilt between that and the
    detector, which is what a dual-wavelength sensor measures. Besides it is magnified about that direction.

    Arguments as in `first_order_displacement`.
    """
    normal, to_laser = unit("normal", normal), unit("source_direction", source_direction)
    sight = np.asarray(detector_centre, dtype=np.float64) - np.asarray(spot, dtype=np.float64)
    distance = float(np.linalg.norm(sight))
    sight, tangents = sight / distance, vectors_across(normal)
    _require_view("target", sight, normal)
    moved = tangents @ (np.eye(3) - np.outer(sight, sight)) @ detector_axes(u, v) / distance
    return np.linalg.solve(moved, tangents @ (to_laser + sight))


def _require_view(name: str, sight: np.ndarray, normal: np.ndarray) -> None:
    """ValueError where the line of sight lies in the plane of unit ``normal`` that is called ``name``."""
    if abs(sight @ normal) < GRAZING_COSINE:
        raise InputError(
            f"grazing detection: the line of sight {text(sight)} lies in the {name} plane (cosine to its normal "
            f"{sight @ normal:.1e}), must be inclined to it"
        )


def per_degree(matrix: np.ndarray) -> np.ndarray:
    """The same (..., 6) sensitivities with rotations per degree: rx, ry, rz from [mm/rad] to [mm/deg]."""
    return np.asarray(matrix, dtype=np.float64) * np.array([1.0, 1.0, 1.0, *[np.pi / 180] * 3])


def project_on_target(matrix: np.ndarray, u: np.ndarray, v: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Displacements (2, k) along the detector's u, v projected on the target's x, y axes: A_zeta, A_eta of [2].

    The vector alpha_u u + alpha_v v is projected at right angles on axes[:, 0] and axes[:, 1], (2, k). A detector
    tilted by an angle in the xz plane measures 1/cos(angle) times the projected x value.
    """
    return frame_axes(axes)[:, :2].T @ detector_axes(u, v) @ np.asarray(matrix, dtype=np.float64)


def imaging_displacement(
    spot: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    source_direction: np.ndarray,
    wavefront_radius: float | np.ndarray,
    line_of_sight: np.ndarray,
    object_u: np.ndarray,
    object_v: np.ndarray,
    magnification: float | np.ndarray,
    defocus: float = 0.0,
    normal: np.ndarray | None = None,
) -> np.ndarray:
    """Displacement of an imaged speckle pattern on the detector per unit rigid motion of the target.

    A lens images a plane in object space on the detector; the pattern on that plane moves as in free space at the
    distance dL from the surface, and the lens magnifies it: alpha = M alpha_object(L_O -> dL). In focus, dL = 0, the
    condition becomes t (1 - l l^T) (T alpha_object - a) = 0: alpha = M times the motion seen across the line of sight,
    whatever the illumination, and tilt about the spot has no effect. No division by dL occurs at any dL. Where the
    defocus depends on the direction, `system_displacement` takes the whole lever.

    spot ... wavefront_radius, normal: as in `first_order_displacement`; the spot is where the chief ray of the
    detector's centre meets the lit surface. line_of_sight: (3,) unit vector l of that ray, from the spot towards the
    lens. object_u, object_v: (3,) axes of the imaged plane. magnification: transverse, either signed (negative:
    inverted along both axes) or (2, 2), (u, v) = M (object_u, object_v). defocus: dL [mm] from the spot to the imaged
    plane along l, + towards the lens, - behind the surface.

    Limits: an aberration-free lens whose pupil passes the same cone before and after the motion, and a motion that
    is small against the depth of focus. Ref. [1].

    Returns (2, 6) [mm/mm], [mm/rad]. Raises ValueError as `first_order_displacement`, or for a bad magnification.
    """
    matrix = np.asarray(magnification, dtype=np.float64)
    if matrix.shape not in ((), (2, 2)) or not np.all(np.isfinite(matrix)):
        raise ValueError(f"magnification {magnification!r}: must be a finite number or a (2, 2) matrix of them")
    if not np.isfinite(defocus):
        raise ValueError(f"defocus = {defocus} mm: must be finite")
    sight = unit("line_of_sight", line_of_sight)
    plane = detector_axes(object_u, object_v, "object_u", "object_v")
    object_side = _plane_displacement(
        spot, origin, axes, source_direction, wavefront_radius, sight, float(defocus), plane, normal
    )
    return matrix @ object_side if matrix.ndim else float(matrix) * object_side


def centre_of_gravity_aperture(
    spot: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    source_direction: np.ndarray,
    aperture_centre: np.ndarray,
    detector_centre: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    normal: np.ndarray | None = None,
) -> np.ndarray:
    """Motion of the light's centre of gravity behind a small aperture per unit rigid motion of the target.

    Triangulation: the spot S slides along the fixed beam axis to where the moved surface is,
    dS = l_S (n . a)/(n . l_S) with a = translation + Omega x (S - origin); material moving along the surface, and
    rotation about the spot, leave it where it is. Its central projection X = C + tau r, r = C - S, through the
    aperture centre C on the detector plane with normal N moves by dX = -tau (1 - r N^T/(N . r)) dS.
    For a detector parallel to the target: tan(theta) (L_O - L_A)/L_A, 0.67 in Sec. 5.3 of [2].

    Arguments as in `first_order_displacement`; detector_centre is any point of the detector plane.
    Returns (2, 6) along u, v [mm/mm], [mm/rad]. Raises ValueError for grazing light, or an aperture in the plane of
    the detector or at the spot.
    """
    slide = spot_displacement(spot, origin, axes, source_direction, normal)
    plane = detector_axes(u, v)
    facing = np.cross(plane[:, 0], plane[:, 1])
    centre = np.asarray(aperture_centre, dtype=np.float64)
    ray = centre - np.asarray(spot, dtype=np.float64)
    depth = facing @ ray
    if abs(depth) <= GRAZING_COSINE * np.linalg.norm(ray):
        raise InputError(
            f"aperture_centre {text(centre)}: the line to it from the spot {text(spot)} must cross the detector plane"
        )
    reach = facing @ (np.asarray(detector_centre, dtype=np.float64) - centre) / depth
    if reach <= 0:
        raise InputError(f"aperture_centre {text(centre)}: must lie between the spot and the detector plane")
    return -reach * plane.T @ (np.eye(3) - np.outer(ray, facing) / depth) @ slide


def spot_displacement(
    spot: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    source_direction: np.ndarray,
    normal: np.ndarray | None = None,
) -> np.ndarray:
    """(3, 6) displacement of the laser's spot along the fixed beam axis, dS = l_S (n . a)/(n . l_S), world.

    Arguments as in `first_order_displacement`. Per unit motion [mm/mm], [mm/rad]; ValueError for grazing light.
    """
    axes = frame_axes(axes)
    to_laser = unit("source_direction", source_direction)
    normal = axes[:, 2] if normal is None else unit("normal", normal)
    require_lit(to_laser, normal)
    return np.outer(to_laser, normal) @ _motion_of_point(spot, origin, axes) / (normal @ to_laser)


# Vector algebra and validation.


def _motion_of_point(point: np.ndarray, origin: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(3, 6) displacement of a point of the target per unit motion: translation + Omega x (point - origin)."""
    arm = np.asarray(point, dtype=np.float64) - np.asarray(origin, dtype=np.float64)
    return np.hstack([axes, -cross_matrix(arm) @ axes])
