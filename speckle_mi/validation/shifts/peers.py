"""Other ways to measure a shift, as their authors describe them: (reference, moved, window) -> (u, v) [px]."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import logging
from collections.abc import Iterator

import numpy as np
from scipy import ndimage, optimize


def _middle(image: np.ndarray, window: int) -> tuple[np.ndarray, tuple[int, int]]:
    top, left = ((n - window) // 2 for n in image.shape)
    return image[top : top + window, left : left + window], (top, left)


def _surface(reference: np.ndarray, moved: np.ndarray, window: int) -> tuple[np.ndarray, tuple[int, int], np.ndarray]:
    """Normalised correlation of the middle window, its largest pixel, and the place of no shift."""
    from skimage.feature import match_template

    piece, corner = _middle(reference, window)
    surface = match_template(moved, piece)
    return surface, np.unravel_index(int(np.argmax(surface)), surface.shape), np.array(corner)


def _followed(
    reference: np.ndarray, moved: np.ndarray, window: int
) -> tuple[np.ndarray, np.ndarray, tuple[int, int], tuple[int, int]]:
    """Middle window, window where its pattern went, first pixel (v, u) of the one and whole distance (v, u) between."""
    piece, (top, left) = _middle(reference, window)
    _, peak, origin = _surface(reference, moved, window)
    dv, du = (int(d) for d in np.subtract(peak, origin))
    other = moved[top + dv : top + dv + window, left + du : left + du + window]
    return piece, other, (top, left), (dv, du)


def interpolated_ncc(reference: np.ndarray, moved: np.ndarray, window: int) -> tuple[float, float]:
    """Maximum of the correlation surface interpolated by a quintic spline."""
    surface, top, origin = _surface(reference, moved, window)
    first = [max(0, i - 8) for i in top]
    patch = surface[tuple(slice(f, f + 17) for f in first)]
    coefficients = ndimage.spline_filter(patch, 5, mode="mirror")

    def negative(place: np.ndarray) -> float:
        return -ndimage.map_coordinates(coefficients, place[:, None], order=5, mode="mirror", prefilter=False)[0]

    start = np.subtract(top, first).astype(float)
    found = optimize.minimize(negative, start, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-14})
    v, u = found.x + first - origin
    return float(u), float(v)


def ic_gn(reference: np.ndarray, moved: np.ndarray, window: int) -> tuple[float, float]:
    """Inverse compositional Gauss-Newton on quintic splines (B. Pan et al., DOI 10.1007/s11340-013-9717-6)."""
    _, top, origin = _surface(reference, moved, window)
    place = np.subtract(top, origin).astype(float)
    splines = [ndimage.spline_filter(image, 5, mode="mirror") for image in (reference, moved)]
    v, u = np.mgrid[:window, :window] + origin[:, None, None].astype(float)

    def at(spline: np.ndarray, dv: float, du: float) -> np.ndarray:
        return ndimage.map_coordinates(spline, [v + dv, u + du], order=5, mode="mirror", prefilter=False)

    step = 1e-3
    values = at(splines[0], 0.0, 0.0)
    gradients = [at(splines[0], dv, du) - at(splines[0], -dv, -du) for dv, du in ((step, 0.0), (0.0, step))]
    jacobian = np.stack([g.ravel() for g in gradients]) / (2 * step)
    values = (values - values.mean()).ravel()
    inverse = np.linalg.inv(jacobian @ jacobian.T)
    for _ in range(20):
        other = at(splines[1], *place).ravel()
        other -= other.mean()
        change = inverse @ (jacobian @ (other * np.linalg.norm(values) / np.linalg.norm(other) - values))
        place -= change
        if np.abs(change).max() < 1e-5:
            break
    return float(place[1]), float(place[0])


def scikit_image(reference: np.ndarray, moved: np.ndarray, window: int) -> tuple[float, float]:
    """Upsampled cross-correlation of the two middle windows (M. Guizar-Sicairos et al., DOI 10.1364/OL.33.000156).

    A second pass takes the window where the first has found it, as users of it do.
    """
    from skimage.registration import phase_cross_correlation

    piece, other, _, (dv, du) = _followed(reference, moved, window)
    shift, _, _ = phase_cross_correlation(piece, other, upsample_factor=100, normalization=None)
    return du - float(shift[1]), dv - float(shift[0])


def openpiv(reference: np.ndarray, moved: np.ndarray, window: int) -> tuple[float, float]:
    """OpenPIV's window of particle image velocimetry, Gaussian peak; placed where the pattern went. ImportError."""
    from openpiv.pyprocess import extended_search_area_piv

    piece, other, _, (dv, du) = _followed(reference, moved, window)
    u, v, _ = extended_search_area_piv(
        piece, other, window, overlap=0, search_area_size=window, sig2noise_method="peak2peak",
        normalized_correlation=True,
    )  # fmt: skip
    return du + float(u[0, 0]), dv + float(v[0, 0])


_MUDIC_PAD, _MUDIC_FRAME = 10, 14
"""Pixels around the window that muDIC's solver wants, and with room to move [px]."""


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Without what muDIC prints and logs as it goes; it sets up the log of all when it is imported."""
    root = logging.getLogger()
    level, handlers, disabled = root.level, list(root.handlers), root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        logging.disable(disabled)
        root.setLevel(level)
        root.handlers[:] = handlers


def mudic(reference: np.ndarray, moved: np.ndarray, window: int) -> tuple[float, float]:
    """muDIC: one bilinear element as large as the window, on cubic splines; placed where the pattern went."""
    with _silent():
        import muDIC
        from muDIC.IO.image_stack import image_stack_from_list

        _, _, (top, left), (dv, du) = _followed(reference, moved, window)
        side = window + 2 * _MUDIC_FRAME
        frames = [
            image[v - _MUDIC_FRAME :, u - _MUDIC_FRAME :][:side, :side]
            for image, v, u in ((reference, top, left), (moved, top + dv, left + du))
        ]
        images = image_stack_from_list(frames)
        ends = {"c1": _MUDIC_FRAME, "c2": _MUDIC_FRAME + window}
        corners = {f"{axis}{end}": place for end, place in ends.items() for axis in "XY"}
        mesh = muDIC.Mesher(deg_e=1, deg_n=1).mesh(images, n_elx=1, n_ely=1, GUI=False, **corners)
        found = muDIC.DICAnalysis(muDIC.DICInput(mesh, images, ref_update_frames=[], pad=_MUDIC_PAD)).run()
    u, v = (float(np.diff(nodes[:, :2], axis=1).mean()) for nodes in (found.xnodesT, found.ynodesT))
    return du + u, dv + v


PEERS = {
    "IC-GN": ic_gn,
    "interpolated NCC": interpolated_ncc,
    "scikit-image x100": scikit_image,
    "OpenPIV": openpiv,
    "muDIC": mudic,
}

_PACKAGES = {"OpenPIV": "openpiv", "muDIC": "muDIC"}
"""What peers need that this package does not depend on."""


def installed() -> dict:
    """Peers that can be run here."""
    return {name: peer for name, peer in PEERS.items() if importlib.util.find_spec(_PACKAGES.get(name, "numpy"))}
