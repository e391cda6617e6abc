"""Colours as intensity: luminance by the primaries, and what other encodings of grey and colour mean."""

from __future__ import annotations

import numpy as np

LUMINANCE = {"R": 0.2126, "G": 0.7152, "B": 0.0722}
"""Weights of the colours in an image's intensity, for the primaries that OpenEXR assumes (Rec. 709)."""


def luminance(colours: np.ndarray) -> np.ndarray:
    """Luminance (rows, columns) of colours (rows, columns, 3), Rec. 709, in single precision as images are kept."""
    # A colour at a time: all in double precision would take eight times the image.
    return sum(np.float32(w) * colours[..., i].astype(np.float32) for i, w in enumerate(LUMINANCE.values()))


def luminance_weights(chromaticities: tuple[float, ...]) -> dict[str, float]:
    """Weights of R, G and B for the (x, y) of red, green, blue and white (SMPTE RP 177). Raises ValueError."""
    xy = np.asarray(chromaticities, dtype=float).reshape(4, 2)
    if not np.isfinite(xy).all() or np.any(xy[:, 1] <= 0.0):
        raise ValueError(f"chromaticities {[round(float(c), 4) for c in xy.ravel()]}: every y must be positive")
    to_xyz = np.array([xy[:, 0] / xy[:, 1], np.ones(4), (1.0 - xy.sum(axis=1)) / xy[:, 1]])
    try:
        weights = np.linalg.solve(to_xyz[:, :3], to_xyz[:, 3])
    except np.linalg.LinAlgError:
        raise ValueError("chromaticities: the three primaries lie on one line") from None
    return dict(zip("RGB", map(float, weights / weights.sum())))


def cmyk_luminance(inks: np.ndarray, full: float) -> np.ndarray:
    """Luminance (rows, columns), 0 to ``full``, of inks (rows, columns, 4) from 0 to ``full``."""
    rest = np.float32(full) - inks.astype(np.float32)
    return luminance(rest[..., :3] * rest[..., 3:]) / np.float32(full)
