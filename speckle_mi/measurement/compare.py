"""What two images of a pattern say together: shift, correlation, centres of gravity and statistics."""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError
from .correlator import correlate
from .speckle_statistics import centre_of_gravity, contrast, speckle_size


def compare(reference: np.ndarray, moved: np.ndarray, pitch: float | None, window: int | None = None) -> dict:
    """What the command prints: shift, correlation, centres of gravity and statistics of two images.

    pitch: [mm], None if unknown (lengths in um are then NaN). Raises InputError as `Correlator` does.
    """
    shift = correlate(reference, moved, window)
    um = math.nan if pitch is None else 1e3 * pitch
    centres = {"reference": centre_of_gravity(reference), "moved": centre_of_gravity(moved)}
    centres["shift"] = tuple(b - a for a, b in zip(centres["reference"], centres["moved"]))
    sizes = speckle_size(reference)
    return {
        "shift_u_px": shift.u_px,
        "shift_v_px": shift.v_px,
        "shift_u_um": shift.u_px * um,
        "shift_v_um": shift.v_px * um,
        "ncc": shift.ncc,
        "status": shift.status,
        "message": shift.message,
        "significance": shift.significance,
        "window": list(shift.window),
        **{f"cog_{name}_{axis}_um": c[i] * um for name, c in centres.items() for i, axis in enumerate("uv")},
        "contrast_reference": contrast(reference),
        "contrast_moved": contrast(moved),
        "speckle_size_u_px": sizes[0],
        "speckle_size_v_px": sizes[1],
        "speckle_size_u_um": sizes[0] * um,
        "speckle_size_v_um": sizes[1] * um,
    }


def common_pitch(*headers: dict) -> float | None:
    """Pixel pitch [mm] in the headers of field images, None if none has one. Raises InputError if they differ."""
    found = [header["pixel_pitch_mm"] for header in headers if "pixel_pitch_mm" in header]
    for pitch in found:
        if not isinstance(pitch, (int, float)) or not 0.0 < pitch < math.inf:
            raise InputError(f"pixel_pitch_mm = {pitch!r} in an image's header: must be a positive number")
    if found and not math.isclose(min(found), max(found), rel_tol=1e-6):
        raise InputError(f"the images' pixel pitches differ: {min(found):g} and {max(found):g} mm")
    return float(found[0]) if found else None
