"""Areal quadrature on openings: the points from which a diffraction integral is summed.

A sum over these points stands for the integral over the opening, edge included, of a field whose total phase (that of
the incident light plus k r to the point where it is looked at) changes by at most a given gradient. In polar
coordinates a Gauss-Legendre rule in the radius goes with a trapezoidal rule in the angle that has fewer nodes on
smaller rings; in a rectangle a Gauss-Legendre rule goes along each side. Both rules converge faster than
exponentially once they resolve the phase, which tells how many nodes are enough:

- n Gauss-Legendre nodes on [-1, 1] integrate e^{icx} with the error (4n + 1) |j_2n(c)| relative to the length: the
  first term beyond their degree of e^{icx} = sum_l (2l + 1) i^l j_l(c) P_l(x);
- n equidistant angles integrate e^{iz cos(theta)} with the error 2 |J_n(z)| (the first aliased term of the
  Jacobi-Anger series), and e^{i(z/2) cos(2 theta)}, the worst phase of the same gradient, with 2 |J_{n/2}(z/2)|.

Errors are relative to the aperture's L2 scale: the root mean square of the integral of e^{i g.x} over all gradients g
up to the given one, by Parseval's theorem A min(1, 2/(K R)) for a disc of area A. Lengths are mm, phases rad.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import fft
from scipy.special import jv, roots_legendre, spherical_jn

from ..errors import InputError
from ..geometry.frames import Frame
from ..geometry.outline import Circle, Rectangle
from ..geometry.plane import PlanePoints

LOOSEST, TIGHTEST = 1e-1, 1e-13
"""Range of the tolerance."""

MOST_NODES = 50_000_000
"""Most nodes of one opening."""

MOST_ALONG = 10_000
"""Most Gauss-Legendre nodes along a line; finding more takes many seconds."""

_BOUNDARY_SAMPLES = 4096
"""Angles at which a star-shaped boundary is looked at."""


def opening_nodes(
    outline: Circle | Rectangle,
    frame: Frame,
    phase_gradient: float | tuple[float, float],
    tolerance: float,
    tilt: float | None = None,
) -> tuple[PlanePoints, np.ndarray]:
    """Nodes on an opening in the plane z = 0 of ``frame``, and their weights (q,) [mm^2].

    phase_gradient: bound on the gradient of the total phase in the opening [rad/mm], of its length or of its components
    along x and y; tolerance: error of the integral relative to the L2 scale in the module's docstring.
    tilt: bound on the gradient's component across the radius, and on its length at the centre [rad/mm], where it is
    known that from there to the rim it stays below a straight line: a defocused wave, which needs fewer nodes than one
    that is as steep everywhere. Circles only.
    Raises ValueError for a gradient that is negative or not finite, a tolerance out of range and too many nodes.
    """
    gradient = _gradient(phase_gradient)
    _check(tolerance)
    if isinstance(outline, Rectangle):
        if tilt is not None:
            raise ValueError(f"tilt = {tilt} rad/mm: only for a circle, a rectangle takes phase_gradient along x and y")
        return _rectangle_nodes(outline, frame, gradient, tolerance)
    return star_nodes(
        lambda angle: np.full_like(angle, outline.radius), frame, phase_gradient, tolerance, tilt
    )


def estimated_nodes(
    outline: Circle | Rectangle, phase_gradient: float | tuple[float, float], tilt: float | None = None
) -> float:
    """About how many nodes :func:`opening_nodes` takes, to within a factor of two where there are many."""
    gradient = _gradient(phase_gradient)
    if isinstance(outline, Rectangle):
        return float(np.prod(gradient * outline.half_size / 2 + 8))
    total = float(gradient[0])
    across = total if tilt is None else min(total, float(_gradient(tilt)[0]))
    rings = _change_along(across, total) * outline.radius / 4 + 8
    return float(rings * (across * outline.radius / 2 + 24))


def star_nodes(
    boundary: Callable[[np.ndarray], np.ndarray],
    frame: Frame,
    phase_gradient: float | tuple[float, float],
    tolerance: float,
    tilt: float | None = None,
) -> tuple[PlanePoints, np.ndarray]:
    """Nodes inside a smooth curve around the origin of ``frame``, in its plane z = 0, and their weights (q,) [mm^2].

    boundary: distance (n,) [mm] of the curve from the origin at angles (n,) [rad] from x towards y; it must be smooth
    and of period 2 pi (a vignetted pupil, whose rim is one curve). The other parameters as in :func:`opening_nodes`.
    Raises ValueError also for a boundary that is not positive, or so rough that the quadrature would not converge.
    """
    gradient = _gradient(phase_gradient)
    total = float(gradient[0] if np.ndim(phase_gradient) == 0 else np.linalg.norm(gradient))
    across = total if tilt is None else min(total, float(_gradient(tilt)[0]))
    _check(tolerance)
    radius, slope, orders = _boundary_spectrum(boundary, tolerance)
    area, widest = np.pi * np.mean(radius**2), float(np.max(radius))
    # Half the error for each of the two rules.
    error = 0.5 * tolerance * min(1.0, 2.0 / max(total * np.sqrt(area / np.pi), 1e-300))

    # Along the curve t r(theta) the phase changes with both components of its gradient.
    per_angle = float(np.max(np.hypot(across * radius, total * slope)))
    count = _gauss_count(_change_along(across, total) * widest / 2, error) + 1  # the area's t: one degree more
    _check_count(count, count * max(1.0, per_angle / 2))
    t, radial = roots_legendre(count)
    t, radial = (1 + t) / 2, radial / 2
    angles = _angle_counts(per_angle * t, error) + orders
    _check_count(count, float(np.sum(angles)))

    ring = np.repeat(np.arange(t.size), angles)
    step = np.arange(ring.size) - np.repeat(np.cumsum(angles) - angles, angles)
    theta = 2 * np.pi * step / angles[ring]
    edge = np.asarray(boundary(theta), dtype=np.float64)
    r = t[ring] * edge
    weights = radial[ring] * t[ring] * edge**2 * (2 * np.pi / angles[ring])
    return _on_plane(frame, r * np.cos(theta), r * np.sin(theta)), weights


def _change_along(centre: float, edge: float) -> float:
    """Gradient of the even phase that takes as many Gauss-Legendre nodes as one growing from the centre to the edge.

    The nodes are as dense as 1/sin(phi) at x = -cos(phi), so that a place counts by its gradient times sin(phi).
    """
    phi = np.linspace(0, np.pi, 721)
    return float(np.max((centre + (edge - centre) * (1 - np.cos(phi)) / 2) * np.sin(phi)))


def _rectangle_nodes(
    outline: Rectangle, frame: Frame, gradient: np.ndarray, tolerance: float
) -> tuple[PlanePoints, np.ndarray]:
    half = np.array([outline.half_x, outline.half_y])
    change = gradient * half
    # Mean square of sin(c)/c over all c up to the given change, the L2 scale of each side.
    scale = np.sqrt(np.prod(np.minimum(1.0, np.pi / 2 / np.maximum(change, 1e-300))))
    counts = [_gauss_count(c, 0.5 * tolerance * scale) for c in change]
    _check_count(max(counts), float(np.prod(counts)))
    (x, wx), (y, wy) = (roots_legendre(n) for n in counts)
    a, b = np.meshgrid(half[0] * x, half[1] * y, indexing="ij")
    return _on_plane(frame, a.ravel(), b.ravel()), np.multiply.outer(half[0] * wx, half[1] * wy).ravel()


def _on_plane(frame: Frame, a: np.ndarray, b: np.ndarray) -> PlanePoints:
    return PlanePoints(np.asarray(frame.origin, dtype=np.float64), frame.axes[:, 0], frame.axes[:, 1], a, b)


def _amplitude_orders(error: float) -> int:
    """Orders up to which an amplitude such as cos(chi)/r counts.

    They fall tenfold from one to the next where an opening is seen from ten times its radius; seen from nearer by, its
    phase needs so many nodes that these few do not matter.
    """
    return int(np.ceil(-np.log10(error)))


def _gauss_count(change: float, error: float) -> int:
    """Fewest Gauss-Legendre nodes that resolve phases of up to ``change`` [rad] over half the interval."""
    fewest = int(np.ceil(change / 2))
    # Beyond degree c the Bessel function falls without a zero, within a few times c^(1/3).
    n = fewest + np.arange(1, 64 + int(8 * change ** (1 / 3) + 2 * np.log10(1 / error)))
    n = n[(4 * n + 1) * np.abs(spherical_jn(2 * n, change)) <= error][0]
    # An amplitude of the degree m raises that of the product by m, and each node is worth two degrees.
    return int(n) + _amplitude_orders(error) // 2


def _angle_counts(change: np.ndarray, error: float) -> np.ndarray:
    """Fewest equidistant angles (n,) for phases that change by up to ``change`` (n,) [rad per rad] around a ring."""
    astigmatic = 2 * _bessel_order(change / 2, error)
    return np.maximum(astigmatic, _bessel_order(change, error) + _amplitude_orders(error))


def _bessel_order(z: np.ndarray, error: float) -> np.ndarray:
    """Smallest orders (n,) with 2 |J_order(z)| <= error beyond the argument z (n,)."""
    low, high = np.floor(z), np.ceil(z + 32 + 8 * np.cbrt(z) + 2 * np.log10(1 / error))
    # From order z on, J falls with the order: bisection keeps 2 |J_high| <= error.
    while np.any(high - low > 1):
        middle = np.floor((low + high) / 2)
        enough = 2 * np.abs(jv(middle, z)) <= error
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high.astype(np.int64)


def _boundary_spectrum(
    boundary: Callable[[np.ndarray], np.ndarray], tolerance: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Radius (s,) [mm] of a boundary, its derivative (s,) [mm/rad], and the highest order that counts in its square."""
    angle = 2 * np.pi * np.arange(_BOUNDARY_SAMPLES) / _BOUNDARY_SAMPLES
    radius = np.asarray(boundary(angle), dtype=np.float64)
    if radius.shape != angle.shape or not np.all(np.isfinite(radius)) or not np.all(radius > 0):
        raise ValueError(
            f"boundary of the opening: must give a positive radius for every angle, smallest is {np.min(radius):g} mm"
        )
    spectrum = fft.rfft(radius)
    derivative = fft.irfft(1j * np.arange(spectrum.size) * spectrum, n=angle.size)
    square = np.abs(fft.rfft(radius**2))
    counting = np.flatnonzero(square[1:] > 0.1 * tolerance * square[0])
    orders = int(counting[-1]) + 1 if counting.size else 0
    if orders > _BOUNDARY_SAMPLES // 4:
        raise ValueError(
            f"boundary of the opening: has structure of order {orders} around the circle, must be below "
            f"{_BOUNDARY_SAMPLES // 4}: a smooth curve without corners"
        )
    return radius, derivative, orders


def _gradient(value: float | tuple[float, float]) -> np.ndarray:
    """Components (2,) of a gradient's bound; each is the whole where only its length is given."""
    gradient = np.broadcast_to(np.asarray(value, dtype=np.float64), (2,))
    if not (np.all(np.isfinite(gradient)) and np.all(gradient >= 0)):
        raise ValueError(f"phase gradient = {value} rad/mm: must be finite and not negative")
    return gradient


def _check(tolerance: float) -> None:
    if not TIGHTEST <= tolerance <= LOOSEST:
        raise ValueError(f"tolerance = {tolerance}: must be between {TIGHTEST:g} and {LOOSEST:g}")


def _check_count(along: int, nodes: float) -> None:
    if nodes > MOST_NODES or along > MOST_ALONG:
        raise InputError(
            f"the opening needs {nodes:.3g} nodes, {along} along a line, must need at most {MOST_NODES:.3g} and "
            f"{MOST_ALONG}: it is too large, or its light too steep, for a diffraction integral"
        )
