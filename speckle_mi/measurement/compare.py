"""What two images of a pattern say together: shift, correlation, centres of gravity and statistics."""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError
from .correlator import Correlator
from .deformation import FITS, Deformation
from .light import middle
from .speckle_statistics import centre_of_gravity, contrast, contrast_and_size

LARGEST_PIECE = 1024
"""Side of the middle piece of larger images from which the contrast is taken [px]."""


class Comparison:
    """A reference image, its statistics and its correlator, to be compared with any number of moved images.

    reference: (rows, columns) intensity. pitch: [mm], None if unknown (lengths in um are then NaN). window, mask,
    smoothing: of `Correlator`, which says what raises. fit: "shift", or one of `FITS` to be told of rotation and strain
    too.
    """

    def __init__(
        self,
        reference: np.ndarray,
        pitch: float | None,
        window: int | None = None,
        fit: str = "shift",
        mask: np.ndarray | None = None,
        smoothing: float | None = None,
    ) -> None:
        if fit not in FITS:
            raise InputError(f"fit = {fit}: must be one of {', '.join(FITS)}")
        self.correlator = Correlator(reference, window, mask=mask, smoothing=smoothing)
        self.um = math.nan if pitch is None else 1e3 * pitch
        self.fit = fit
        self.centre = centre_of_gravity(reference)
        self.contrast, self.sizes = contrast_and_size(middle(np.asarray(reference), LARGEST_PIECE))

    def with_moved(self, moved: np.ndarray, note: str = "") -> dict:
        """What the command prints of a moved image (rows, columns)."""
        (shift, found), um = self.correlator.shift_and_deformation(moved, self.fit), self.um
        result = {
            "shift_u_px": shift.u_px,
            "shift_v_px": shift.v_px,
            "shift_u_um": shift.u_px * um,
            "shift_v_um": shift.v_px * um,
            "sigma_u_px": shift.sigma_u_px,
            "sigma_v_px": shift.sigma_v_px,
            "sigma_u_um": shift.sigma_u_px * um,
            "sigma_v_um": shift.sigma_v_px * um,
            "correlation_uv": shift.correlation_uv,
            "ncc": shift.ncc,
            "status": shift.status,
            "message": "; ".join(filter(None, (shift.message, note))),
            "significance": shift.significance,
            "window": list(shift.window),
            **centres(self.centre, centre_of_gravity(moved), um),
            "contrast_reference": self.contrast,
            "contrast_moved": contrast(middle(np.asarray(moved), LARGEST_PIECE)),
            "speckle_size_u_px": self.sizes[0],
            "speckle_size_v_px": self.sizes[1],
            "speckle_size_u_um": self.sizes[0] * um,
            "speckle_size_v_um": self.sizes[1] * um,
        }
        if self.fit != "shift":
            result |= _deformed(self.fit, found)
            if found is None and shift.ok:
                result["message"] = "; ".join(filter(None, (result["message"], f"no fit of {self.fit} was found")))
        return result


def centres(reference: tuple[float, float], moved: tuple[float, float], um: float) -> dict[str, float]:
    """What the command prints of two centres of gravity (u, v) [px]; um: the pixel pitch [um], NaN if unknown."""
    places = {"reference": reference, "moved": moved, "shift": tuple(b - a for a, b in zip(reference, moved))}
    return {
        f"cog_{name}_{axis}_{unit}": place * scale
        for unit, scale in (("px", 1.0), ("um", um))
        for name, pair in places.items()
        for axis, place in zip("uv", pair)
    }


def _deformed(fit: str, found: Deformation | None) -> dict:
    """Rotation and strain, and the shift of the window's middle that goes with them; NaN where none was found."""
    nothing = (math.nan,) * 3
    if found is None:
        found = Deformation(nothing[:2], nothing[:2], math.nan, math.nan, nothing, nothing, math.nan)
    return {
        "fit": fit,
        "fit_correlation": found.correlation,
        "fit_shift_u_px": found.shift[0],
        "fit_shift_v_px": found.shift[1],
        "sigma_fit_shift_u_px": found.sigma_shift[0],
        "sigma_fit_shift_v_px": found.sigma_shift[1],
        "rotation_deg": math.degrees(found.rotation),
        "sigma_rotation_deg": math.degrees(found.sigma_rotation),
        **{f"strain_{name}": value for name, value in zip(("uu", "vv", "uv"), found.strain)},
        **{f"sigma_strain_{name}": value for name, value in zip(("uu", "vv", "uv"), found.sigma_strain)},
    }


def compare(reference: np.ndarray, moved: np.ndarray, pitch: float | None, window: int | None = None) -> dict:
    """What the command prints: shift, correlation, centres of gravity and statistics of two images.

    pitch: [mm], None if unknown (lengths in um are then NaN). Raises InputError as `Correlator` does.
    """
    return Comparison(reference, pitch, window).with_moved(moved)


def common_pitch(*headers: dict) -> float | None:
    """Pixel pitch [mm] in the headers of field images, None if none has one. Raises InputError if they differ."""
    found = [header["pixel_pitch_mm"] for header in headers if "pixel_pitch_mm" in header]
    for pitch in found:
        if not isinstance(pitch, (int, float)) or not 0.0 < pitch < math.inf:
            raise InputError(f"pixel_pitch_mm = {pitch!r} in an image's header: must be a positive number")
    if found and not math.isclose(min(found), max(found), rel_tol=1e-6):
        raise InputError(f"the images' pixel pitches differ: {min(found):g} and {max(found):g} mm")
    return float(found[0]) if found else None
