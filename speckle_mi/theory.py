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

from speckle_mi.geometry import Pose, cross_matrix, vectors_across

UNIT_TOLERANCE = 1e-6
"""How far the length of a direction, or a right angle, may be off [1]; scene files give about seven digits."""

GRAZING_COSINE = 1e-9
"""Cosine to a surface normal [1] below which light counts as travelling along the surface."""


def first_order_displacement(
    spot: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    source_direction: np.ndarray,
    wavefront_radius: float,
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
    the laser. wavefront_radius: L_S [mm], + diverging, - converging, inf collimated. detector_centre: (3,) [mm].
    u, v: (3,) directions of increasing column and row. normal: (3,) surface normal at the spot; None is the target's z.

    Returns (2, 6): rows u, v; columns x, y, z [mm/mm], rx, ry, rz [mm/rad].
    Raises ValueError for a detector at the spot, grazing detection, or vectors that are not unit or orthogonal.
    """
    sight = np.asarray(detector_centre, dtype=np.float64) - np.asarray(spot, dtype=np.float64)
    distance = float(np.linalg.norm(sight))
    if not (np.isfinite(distance) and distance > 0):
        raise ValueError(f"detector_centre {_text(detector_centre)}, {distance} mm from the spot: must be apart")
    plane = _detector_axes(u, v)
    return _plane_displacement(
        spot, origin, axes, source_direction, wavefront_radius, sight / distance, distance, plane, normal
    )


def _plane_displacement(spot, origin, axes, source_direction, wavefront_radius, sight, distance, plane, normal):
    """(2, 6) displacement on a plane with axes ``plane`` (3, 2), ``distance`` [mm, signed] along ``sight``.

    The first-order condition times the distance, which leaves nothing to divide by when the plane nears the surface:
    t (1 - l l^T) T alpha = t [(1 - l l^T + L_O Q_S) a + L_O Omega x (l_S + l)].
    """
    axes = _frame_axes(axes)
    to_laser = _unit("source_direction", source_direction)
    normal = axes[:, 2] if normal is None else _unit("normal", normal)
    tangents = vectors_across(normal)
    across = _across(sight)
    plane_normal = np.cross(plane[:, 0], plane[:, 1])
    for name, cosine in (("target", sight @ normal), ("detector", sight @ plane_normal)):
        if abs(cosine) < GRAZING_COSINE:
            raise ValueError(
                f"grazing detection: the line of sight {_text(sight)} lies in the {name} plane (cosine to its normal "
                f"{cosine:.1e}), must be inclined to it"
            )
    material = _motion_of_point(spot, origin, axes)
    turned = np.hstack([np.zeros((3, 3)), -cross_matrix(to_laser + sight) @ axes])
    illumination = distance * _curvature(wavefront_radius) * _across(to_laser)
    change = (across + illumination) @ material + distance * turned
    return np.linalg.solve(tangents @ across @ plane, tangents @ change)


def per_degree(matrix: np.ndarray) -> np.ndarray:
    """The same (..., 6) sensitivities with rotations per degree: rx, ry, rz from [mm/rad] to [mm/deg]."""
    return np.asarray(matrix, dtype=np.float64) * np.array([1.0, 1.0, 1.0, *[np.pi / 180] * 3])


def project_on_target(matrix: np.ndarray, u: np.ndarray, v: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Displacements (2, k) along the detector's u, v projected on the target's x, y axes: A_zeta, A_eta of [2].

    The vector alpha_u u + alpha_v v is projected at right angles on axes[:, 0] and axes[:, 1], (2, k). A detector
    tilted by an angle in the xz plane measures 1/cos(angle) times the projected x value.
    """
    return _frame_axes(axes)[:, :2].T @ _detector_axes(u, v) @ np.asarray(matrix, dtype=np.float64)


def imaging_displacement(
    spot: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    source_direction: np.ndarray,
    wavefront_radius: float,
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
    whatever the illumination, and tilt about the spot has no effect. No division by dL occurs at any dL.

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
    sight = _unit("line_of_sight", line_of_sight)
    plane = _detector_axes(object_u, object_v, "object_u", "object_v")
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
    plane = _detector_axes(u, v)
    facing = np.cross(plane[:, 0], plane[:, 1])
    centre = np.asarray(aperture_centre, dtype=np.float64)
    ray = centre - np.asarray(spot, dtype=np.float64)
    depth = facing @ ray
    if abs(depth) <= GRAZING_COSINE * np.linalg.norm(ray):
        raise ValueError(
            f"aperture_centre {_text(centre)}: the line to it from the spot {_text(spot)} must cross the detector plane"
        )
    reach = facing @ (np.asarray(detector_centre, dtype=np.float64) - centre) / depth
    if reach <= 0:
        raise ValueError(f"aperture_centre {_text(centre)}: must lie between the spot and the detector plane")
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
    axes = _frame_axes(axes)
    to_laser = _unit("source_direction", source_direction)
    normal = axes[:, 2] if normal is None else _unit("normal", normal)
    _require_lit(to_laser, normal)
    return np.outer(to_laser, normal) @ _motion_of_point(spot, origin, axes) / (normal @ to_laser)


# Decorrelation: height of the peak of the intensity correlation, after the shift.


def beam_displacement_of_material(
    pose: Pose, spot: np.ndarray, origin: np.ndarray, axes: np.ndarray, source_direction: np.ndarray
) -> np.ndarray:
    """(3,) displacement [mm, world] across the beam of the material at the spot, by a motion of the target.

    (1 - l_S l_S^T)(P' - P), P' the place to which ``pose`` takes the material point P that lies at the spot; exact
    for finite rotations. Its length is the ``shift_perpendicular`` of `decorrelation_in_plane`.
    """
    axes = _frame_axes(axes)
    arm = axes.T @ (np.asarray(spot, dtype=np.float64) - np.asarray(origin, dtype=np.float64))
    moved = axes @ (pose.translation + pose.rotation @ arm - arm)
    return _across(_unit("source_direction", source_direction)) @ moved


def decorrelation_in_plane(shift_perpendicular: np.ndarray | float, beam_radius: float) -> np.ndarray:
    """Correlation exp(-a^2/w^2) after the material moved by a [mm] across a Gaussian beam of 1/e^2 radius w [mm]."""
    shift = np.asarray(shift_perpendicular, dtype=np.float64)
    return np.exp(-((shift / require_positive("beam_radius", beam_radius)) ** 2))


def decorrelation_axial(
    motion: np.ndarray | float, beam_radius: float, wavelength: float, detector_distance: float, wavefront_radius: float
) -> np.ndarray:
    """Correlation 1/(1 + b^2) after an axial motion a_z [mm], laser and detector along the normal of the target.

    b = (k w^2 a_z/4)(1/L_O^2 + 1/L_S^2): the paths' curvature changes across the Gaussian spot of radius w. All [mm].
    """
    curvature = 1 / require_positive("detector_distance", detector_distance) ** 2 + _curvature(wavefront_radius) ** 2
    wavenumber = 2 * np.pi / require_positive("wavelength", wavelength)
    phase = (
        wavenumber * require_positive("beam_radius", beam_radius) ** 2 / 4 * np.asarray(motion, np.float64) * curvature
    )
    return 1 / (1 + phase**2)


def decorrelation_circular_pupil(shift: np.ndarray | float) -> np.ndarray:
    """Correlation {(2/pi)[acos s - s sqrt(1 - s^2)]}^2 when light moves by s diameters across a circular pupil.

    shift: s, pattern motion in the pupil over the pupil's diameter [1], either sign; zero correlation from |s| = 1.
    """
    s = np.minimum(np.abs(np.asarray(shift, dtype=np.float64)), 1.0)
    return (2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))) ** 2


# Statistics of the pattern.


def contrast_of_equal_phasors(count: np.ndarray | int) -> np.ndarray:
    """Contrast sqrt(1 - 1/N) of the intensity of N >= 1 equal phasors of random phase [3]."""
    count = np.asarray(count, dtype=np.float64)
    if not np.all(count >= 1):
        raise ValueError(f"number of phasors {count}: must be 1 or more")
    return np.sqrt(1 - 1 / count)


def intensity_pdf(intensity: np.ndarray, mean: float = 1.0) -> np.ndarray:
    """Probability density exp(-I/<I>)/<I> of fully developed, polarised speckle; 0 below I = 0 [3]."""
    mean = require_positive("mean", mean)
    intensity = np.asarray(intensity, dtype=np.float64)
    return np.where(intensity >= 0, np.exp(-np.maximum(intensity, 0) / mean) / mean, 0.0)


def coherence_gaussian_beam(
    separation: np.ndarray | float, beam_radius: float, wavelength: float, distance: float
) -> np.ndarray:
    """|mu|^2 = exp[-(pi w r/(lambda z))^2] of points r [mm] apart at z [mm] from a spot of 1/e^2 radius w [mm].

    Beam, detector and target all face one another; `speckle_shape_gaussian_beam` is the formula for any tilt. [3]
    """
    blur = require_positive("wavelength", wavelength) * require_positive("distance", distance)
    scale = np.pi * require_positive("beam_radius", beam_radius) / blur
    return np.exp(-((scale * np.asarray(separation, dtype=np.float64)) ** 2))


def speckle_shape_gaussian_beam(
    beam_radius: float,
    wavelength: float,
    spot: np.ndarray,
    normal: np.ndarray,
    source_direction: np.ndarray,
    detector_centre: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
) -> np.ndarray:
    """(2, 2) matrix K [1/mm^2] of a speckle: |mu|^2 = exp(-d^T K d) for detector points d = (du, dv) [mm] apart.

    Any tilt of beam, target and detector. The path from a surface point p [mm, from the spot] to the two points
    differs by p . g, g = t Q_O T d; the footprint on the surface is Gaussian with exp(-2 p^T F^-1 p),
    F = w^2 (t (1 - l_S l_S^T) t^T)^-1; then |mu|^2 = exp[-(pi/lambda)^2 g^T F g] [3].
    Raises ValueError for grazing light or a detector at the spot.
    """
    sight = np.asarray(detector_centre, dtype=np.float64) - np.asarray(spot, dtype=np.float64)
    distance = require_positive("detector distance", float(np.linalg.norm(sight)))
    to_laser, normal = _unit("source_direction", source_direction), _unit("normal", normal)
    _require_lit(to_laser, normal)
    tangents = vectors_across(normal)
    footprint = require_positive("beam_radius", beam_radius) ** 2 * np.linalg.inv(
        tangents @ _across(to_laser) @ tangents.T
    )
    gradient = tangents @ _across(sight / distance) @ _detector_axes(u, v) / distance
    return (np.pi / require_positive("wavelength", wavelength)) ** 2 * gradient.T @ footprint @ gradient


def speckle_size_gaussian_beam(
    beam_radius: float,
    wavelength: float,
    spot: np.ndarray,
    normal: np.ndarray,
    source_direction: np.ndarray,
    detector_centre: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
) -> np.ndarray:
    """(2,) full width at half maximum of |mu|^2 in cuts along u and along v [mm]; see `speckle_shape_gaussian_beam`.

    Everything along the normal: 2 sqrt(ln 2) lambda z/(pi w). inf along a direction in which the light grazes.
    """
    shape = speckle_shape_gaussian_beam(
        beam_radius, wavelength, spot, normal, source_direction, detector_centre, u, v
    )
    with np.errstate(divide="ignore"):
        return 2 * np.sqrt(np.log(2) / np.diag(shape))


def shift_scatter(
    speckle_size_px: float, window_px: float, correlation: np.ndarray | float, factor: float = 0.6
) -> np.ndarray:
    """Standard deviation [px] of the measured shift of a pattern: K (s^2/n) sqrt((1 - c)/c).

    speckle_size_px: s; window_px: side n of the correlation window; correlation: peak c, inf from c <= 0;
    factor: K, about 0.6 for a Gaussian peak fit.
    """
    correlation = np.asarray(correlation, dtype=np.float64)
    lost = np.where(correlation > 0, (1 - correlation) / np.where(correlation > 0, correlation, 1.0), np.inf)
    scale = (
        factor * require_positive("speckle_size_px", speckle_size_px) ** 2 / require_positive("window_px", window_px)
    )
    return scale * np.sqrt(np.maximum(lost, 0.0))


# Vector algebra and validation.


def _motion_of_point(point: np.ndarray, origin: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(3, 6) displacement of a point of the target per unit motion: translation + Omega x (point - origin)."""
    arm = np.asarray(point, dtype=np.float64) - np.asarray(origin, dtype=np.float64)
    return np.hstack([axes, -cross_matrix(arm) @ axes])


def _across(direction: np.ndarray) -> np.ndarray:
    """(3, 3) projection 1 - l l^T on the plane across a unit vector."""
    return np.eye(3) - np.outer(direction, direction)


def _curvature(wavefront_radius: float) -> float:
    """1/L_S [1/mm]; 0 for a collimated beam."""
    radius = float(wavefront_radius)
    if radius == 0 or np.isnan(radius):
        raise ValueError(f"wavefront_radius = {radius} mm: must not be 0 (+ diverging, - converging, inf collimated)")
    return 1 / radius


def require_positive(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{name} = {value}: must be positive")
    return float(value)


def _require_lit(to_laser: np.ndarray, normal: np.ndarray) -> None:
    """ValueError where light along a unit vector (3,) grazes the surface of unit ``normal`` (3,)."""
    if abs(to_laser @ normal) < GRAZING_COSINE:
        raise ValueError(f"grazing illumination: source_direction {_text(to_laser)} lies in the surface, must leave it")


def _unit(name: str, vector: np.ndarray) -> np.ndarray:
    vector = np.asarray(vector, dtype=np.float64)
    length = np.linalg.norm(vector) if vector.shape == (3,) else np.nan
    if not abs(length - 1) <= UNIT_TOLERANCE:
        raise ValueError(f"{name} {_text(vector)}: must be a unit vector of 3 components, its length is {length:.6g}")
    return vector / length


def _detector_axes(u: np.ndarray, v: np.ndarray, name_u: str = "u", name_v: str = "v") -> np.ndarray:
    """(3, 2) columns u, v."""
    u, v = _unit(name_u, u), _unit(name_v, v)
    if abs(u @ v) > UNIT_TOLERANCE:
        raise ValueError(f"{name_u} {_text(u)}, {name_v} {_text(v)}: must be at right angles, have cosine {u @ v:.3g}")
    return np.column_stack([u, v])


def _frame_axes(axes: np.ndarray) -> np.ndarray:
    axes = np.asarray(axes, dtype=np.float64)
    if axes.shape != (3, 3) or not np.allclose(axes.T @ axes, np.eye(3), atol=UNIT_TOLERANCE):
        raise ValueError(f"axes {_text(axes)}: must be (3, 3) with orthonormal columns, the target's x, y, z")
    return axes


def _text(array: np.ndarray) -> str:
    return np.array2string(np.asarray(array, dtype=np.float64), precision=6, separator=", ").replace("\n", "")
