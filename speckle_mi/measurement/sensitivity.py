"""Sensitivity of a sensor from measured shifts: slope through the origin, its interval, its scatter.

Three numbers are kept apart. The bias is the mean over surfaces against theory. The scatter is the spread over
surfaces: any correct simulation has it, and so has the real sensor, whose resolution it limits. The interval says how
well the mean is known. (How exact each field is, is another matter.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special  # its statistics take as long to import as all the rest

CONFIDENCE = 0.95

NOISE_FLOOR = 1e-3
"""Variance of a shift that remains at full correlation (sub-pixel bias), over its variance at a correlation of 1/2 [1].

A few thousandths of a pixel against some tenths; without it a frame at correlation 1 would outweigh all others."""


@dataclass(frozen=True)
class Sensitivity:
    """Slope of shift against displacement. NaN where it could not be measured; `note` then says why.

    value: mean over surfaces of the slope through the origin [unit]. ci95: (low, high) 95 % interval of that mean.
    theory: slope expected, None where there is none. scatter_um: rms over displacements of the standard deviation
    over surfaces of the shift [um]. unit: mm/mm or mm/deg. basis: what the interval rests on, "surfaces", "residuals"
    (a single surface; its frames share one pattern, so the interval may be narrow) or "none". frames_used,
    frames_dropped: frames apart from zero displacement that were measured, and not. note: warning, empty if none.
    """

    value: float
    ci95: tuple[float, float]
    theory: float | None
    scatter_um: float
    unit: str
    basis: str
    frames_used: int
    frames_dropped: int
    note: str = ""

    @property
    def bias(self) -> float | None:
        """Mean over surfaces less theory [unit]; None without theory."""
        return None if self.theory is None else self.value - self.theory

    def to_json(self) -> dict[str, float | int | str | None | list[float | None]]:
        """Plain numbers and what they rest on; None where nothing was measured or no theory exists."""
        return {
            "value": _plain(self.value),
            "ci95": [_plain(bound) for bound in self.ci95],
            "theory": _plain(self.theory),
            "bias": _plain(self.bias),
            "scatter_um": _plain(self.scatter_um),
            "unit": self.unit,
            "basis": self.basis,
            "frames_used": self.frames_used,
            "frames_dropped": self.frames_dropped,
            "note": self.note,
        }


def fit_sensitivity(
    displacements: np.ndarray,
    shifts: np.ndarray,
    correlation: np.ndarray | None = None,
    theory: float | None = None,
    unit: str = "mm/mm",
    sigma: np.ndarray | None = None,
) -> Sensitivity:
    """Sensitivity from the shifts that n displacements caused on several independent surfaces.

    Each surface's slope is a weighted least squares fit through the origin. The variance of a correlation peak's
    place is proportional to (1 - c)/c, c the peak's height, plus a small floor (`shift_weights`): a decorrelated
    frame counts little. The value is the mean of the slopes, each weighted with the precision that the same
    variances give it (all but equal, unless a surface has lost frames). The interval is Student's t over the
    surfaces with the spread they show, so errors that the frames of one surface share are counted in full.
    A single surface has only its residuals from the line, with n - 1 degrees of freedom.

    displacements: (n,) [mm or deg]. shifts: (surfaces, n) [um], NaN where not measured. correlation: (surfaces, n)
    peak heights, or None for equal weights (a centre of gravity); a frame whose correlation is not above 0 counts as
    not measured. sigma: (surfaces, n) standard uncertainties of the shifts [um], which take the place of the rule by
    correlation where all measured frames of a motion have one. theory: slope
    [unit]; None or NaN where there is none. unit: "mm/mm" or "mm/deg".

    Raises ValueError for arrays that do not fit together, or displacements that are not finite.
    """
    displacements, shifts, correlation = _checked(displacements, shifts, correlation)
    theory = None if theory is None or not np.isfinite(theory) else float(theory)
    moved = displacements != 0
    weights = shift_weights(shifts, correlation, sigma)[:, moved]
    displacements, shifts = displacements[moved], np.where(weights > 0, shifts[:, moved], 0.0)
    used = int(np.count_nonzero(weights))
    slope, low, high, basis, note = _slope(displacements, shifts, weights)
    return Sensitivity(
        value=slope,
        ci95=(low, high),
        theory=theory,
        scatter_um=_scatter(shifts, weights > 0),
        unit=unit,
        basis=basis,
        frames_used=used,
        frames_dropped=int(weights.size) - used,
        note=note,
    )


def shift_weights(
    shifts: np.ndarray, correlation: np.ndarray | None = None, sigma: np.ndarray | None = None
) -> np.ndarray:
    """Weights (surfaces, n) of shifts [1]: 1/((1 - c)/c + `NOISE_FLOOR`), 1 without correlation, 0 if not measured.

    With sigma, the shifts' standard uncertainties, 1/(sigma^2 + `NOISE_FLOOR` times the largest), and sigma the larger
    of the frame's own and the rms of all surfaces at that displacement.

    c is the lower of the frame's own peak and the mean peak of all surfaces at that displacement. Decorrelation is
    the same for every surface; close to 1 a single peak's chance height would give weights that differ tenfold.
    """
    shifts = np.asarray(shifts, dtype=np.float64)
    measured = np.isfinite(shifts)
    if correlation is None:
        return measured.astype(np.float64)
    correlation = np.asarray(correlation, dtype=np.float64)
    measured &= np.isfinite(correlation) & (correlation > 0)
    variance = None if sigma is None or not np.any(measured) else _variances(np.asarray(sigma, float), measured)
    if variance is not None:
        return np.where(measured, variance.max() / (variance + NOISE_FLOOR * variance.max()), 0.0)
    own = np.where(measured, np.minimum(correlation, 1.0), 0.0)
    mean = own.sum(axis=0) / np.maximum(measured.sum(axis=0), 1)
    peak = np.minimum(own, mean)
    # c/(1 - c + c floor) is the same without a division by a vanishing c.
    return peak / (1 - peak + peak * NOISE_FLOOR)


def _variances(sigma: np.ndarray, measured: np.ndarray) -> np.ndarray | None:
    """Variances (surfaces, n) to weight by, None where a frame that counts has none, or all are 0."""
    if not np.all(np.isfinite(sigma[measured])):
        return None
    square = np.where(measured, np.square(sigma), 0.0)
    mean = square.sum(axis=0) / np.maximum(measured.sum(axis=0), 1)
    variance = np.maximum(square, mean)
    return variance if variance.max() > 0.0 else None


def _slope(displacements, shifts, weights) -> tuple[float, float, float, str, str]:
    """(slope, low, high [mm per unit], basis, note) from frames that moved; weight 0 means not measured."""
    nothing = (np.nan, np.nan, np.nan, "none")
    if displacements.size == 0:
        return *nothing, "no displacement other than zero"
    if not np.any(weights > 0):
        return *nothing, "every frame is lost or decorrelated"
    scale = float(np.max(np.abs(displacements)))
    reach = displacements / scale  # Keeps the sums of squares far from overflow and underflow.
    leverage = np.sum(weights * reach**2, axis=1)
    seen = leverage > 0
    if not np.any(seen):
        return *nothing, "only vanishingly small displacements could be measured"
    weights, shifts, leverage = weights[seen], shifts[seen], leverage[seen]
    slopes = np.sum(weights * reach * shifts, axis=1) / leverage
    precision = leverage.sum()
    mean = float(np.sum(leverage * slopes) / precision)
    note = ""
    if slopes.size > 1:
        basis, freedom = "surfaces", slopes.size - 1
        variance = np.sum(leverage * (slopes - mean) ** 2) / freedom / precision
    else:
        basis, freedom = "residuals", int(np.count_nonzero(weights)) - 1
        if freedom == 0:
            basis, variance, note = "none", np.nan, "a single frame has a slope but no interval"
        else:
            variance = np.sum(weights * (shifts - slopes[:, None] * reach) ** 2) / freedom / precision
            note = "one surface: the interval is from its residuals and leaves out what its frames share"
    quantile = special.stdtrit(max(freedom, 1), 0.5 + CONFIDENCE / 2)
    half = float(quantile * np.sqrt(variance))
    to_mm = 1e-3 / scale
    result = to_mm * np.array([mean, mean - half, mean + half])
    if not np.isfinite(result[0]):
        return *nothing, f"the displacements, up to {scale:.3g}, are too small for the shifts"
    return float(result[0]), float(result[1]), float(result[2]), basis, note


def _scatter(shifts: np.ndarray, measured: np.ndarray) -> float:
    """rms over displacements of the standard deviation over surfaces [um]; NaN without two surfaces to compare."""
    count = measured.sum(axis=0)
    compared = count > 1
    if not np.any(compared):
        return np.nan
    shifts, measured, count = shifts[:, compared], measured[:, compared], count[compared]
    mean = shifts.sum(axis=0, where=measured) / count
    variance = np.sum((shifts - mean) ** 2, axis=0, where=measured) / (count - 1)
    return float(np.sqrt(variance.mean()))


def _checked(displacements, shifts, correlation):
    displacements = np.asarray(displacements, dtype=np.float64)
    if displacements.ndim != 1 or not np.all(np.isfinite(displacements)):
        raise ValueError(f"displacements of shape {displacements.shape}: must be a finite (n,) array")
    shifts = np.asarray(shifts, dtype=np.float64)
    if shifts.ndim != 2 or shifts.shape[1] != displacements.size:
        raise ValueError(f"shifts of shape {shifts.shape}: must be (surfaces, {displacements.size})")
    if correlation is not None:
        correlation = np.asarray(correlation, dtype=np.float64)
        if correlation.shape != shifts.shape:
            raise ValueError(f"correlation of shape {correlation.shape}: must be that of the shifts, {shifts.shape}")
    return displacements, shifts, correlation


def _plain(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
