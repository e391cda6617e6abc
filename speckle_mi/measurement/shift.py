"""The shift of a pattern as a value: where its features went, how sure that is, or why it is not known."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Shift:
    """Where the features of a pattern went.

    u_px, v_px: shift along columns and rows [px]; NaN unless ``status`` is "ok" (and along an axis on which
    the image has a single pixel). ncc: interpolated peak of the correlation, NaN if there is none to speak of.
    status: "ok", "not significant", "rotated", "ambiguous", "fixed pattern", "left the detector" or "no contrast";
    message: one sentence saying why and what helps; if ok, what was noticed on the way, mostly nothing.
    significance: NCC at the peak's pixel over the least that is significant. window: (rows, columns) of the template
    the result rests on [px]. sigma_u_px, sigma_v_px: standard uncertainties of the shift [px], from the residual and
    the gradients of the two images; correlation_uv: of the errors of u and v [1].
    """

    u_px: float
    v_px: float
    ncc: float
    status: str
    message: str
    significance: float
    window: tuple[int, int]
    sigma_u_px: float = math.nan
    sigma_v_px: float = math.nan
    correlation_uv: float = math.nan

    @property
    def ok(self) -> bool:
        return self.status == "ok"


def no_shift(
    status: str, message: str, window: tuple[int, int], ncc: float = math.nan, significance: float = math.nan
) -> Shift:
    return Shift(math.nan, math.nan, ncc, status, message, significance, window)
