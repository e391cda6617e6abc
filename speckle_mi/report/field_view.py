"""A field image looked at: intensity, amplitude, phase, spectrum, and the law of its intensity."""

from __future__ import annotations

import os

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..measurement.field_statistics import FieldStatistics, power_spectrum
from .plots import FONT, MEAN, THEORY, dress, new_figure, write_picture

_DECIBELS = 60.0
"""Range of the spectrum that is shown [dB]."""

_FAINTEST = 1e-6
"""Least density that is shown of the intensity's law."""


def draw_field(
    path: str | os.PathLike, intensity: np.ndarray, field: np.ndarray | None, pitch: float | None,
    statistics: FieldStatistics, title: str,
) -> None:  # fmt: skip
    """Writes the picture, PNG or SVG by the ending of ``path``.

    intensity: (rows, columns), any unit; field: complex of the same shape, None where it is not known; pitch [mm]:
    axes are pixels without it.
    """
    rows, columns = intensity.shape
    unit, step = ("mm", pitch) if pitch is not None else ("px", 1.0)
    half = 0.5 * step * np.array([columns, rows])
    place = {"extent": (-half[0], half[0], half[1], -half[1])}
    figure = new_figure(11.0, 7.2 if field is not None else 4.2)
    panels = figure.subplots(2 if field is not None else 1, 3).ravel()
    mean = statistics.mean or 1.0
    _picture(figure, panels[0], intensity / mean, "intensity / mean", unit, place, cmap="gray", vmin=0,
             vmax=max(1.0, float(np.quantile(intensity / mean, 0.995))))  # fmt: skip
    rest = panels[1:]
    if field is not None:
        amplitude = np.abs(field)
        rms = float(np.sqrt(np.mean(amplitude**2))) or 1.0
        _picture(figure, rest[0], amplitude / rms, "amplitude / rms", unit, place, cmap="gray", vmin=0,
                 vmax=max(1.0, float(np.quantile(amplitude / rms, 0.995))))  # fmt: skip
        _picture(figure, rest[1], np.angle(field), "phase (rad)", unit, place, cmap="twilight", vmin=-np.pi, vmax=np.pi)
        rest = rest[2:]
    decibels = 10 * np.log10(np.maximum(power_spectrum(intensity if field is None else field), 1e-30))
    nyquist = 0.5 / step
    where = {"extent": (-nyquist, nyquist, nyquist, -nyquist)}
    what = "spectrum of the intensity (dB)" if field is None else "spectrum of the field (dB)"
    _picture(figure, rest[0], decibels, what, f"1/{unit}", where, cmap="magma", vmin=-_DECIBELS, vmax=0)
    _law(rest[1], statistics)
    if field is not None:
        _words(rest[2], statistics, pitch, title)
    else:
        figure.suptitle(title, x=0.02, ha="left", fontsize=FONT)
    write_picture(figure, path)


def _picture(figure: Figure, axes: Axes, values, title: str, unit: str, place: dict, **looks) -> None:
    image = axes.imshow(values, aspect="equal", interpolation="nearest", **place, **looks)
    axes.set_title(title, loc="left", fontsize=FONT)
    axes.tick_params(labelsize=FONT - 2)
    axes.locator_params(nbins=5)
    axes.set_xlabel(f"u ({unit})", fontsize=FONT - 1)
    axes.set_ylabel(f"v ({unit})", fontsize=FONT - 1)
    bar = figure.colorbar(image, ax=axes, shrink=0.85)
    bar.ax.tick_params(labelsize=FONT - 2)


def _law(axes: Axes, statistics: FieldStatistics) -> None:
    """The density of the intensity beside that of developed speckle, exp(-I)."""
    dress(axes)
    levels, densities = statistics.law
    seen = densities > 0
    axes.semilogy(levels, np.exp(-levels), color=THEORY, linewidth=1.4, label="developed speckle")
    axes.semilogy(levels[seen], densities[seen], "o", color=MEAN, markersize=3, label="image")
    axes.set_ylim(_FAINTEST, 3.0)
    axes.set_xlabel("intensity / mean", fontsize=FONT - 1)
    axes.set_ylabel("probability density", fontsize=FONT - 1)
    axes.set_title("law of the intensity", loc="left", fontsize=FONT)
    axes.legend(frameon=False, fontsize=FONT - 2)


def _words(axes: Axes, statistics: FieldStatistics, pitch: float | None, title: str) -> None:
    axes.axis("off")
    for line, word in enumerate([title, *words_of(statistics, pitch)]):
        axes.annotate(word, (0, 1), (0, -1.7 * FONT * line), xycoords="axes fraction", textcoords="offset points",
                      fontsize=FONT - 1, va="top", weight="bold" if line == 0 else "normal")  # fmt: skip


def words_of(statistics: FieldStatistics, pitch: float | None) -> list[str]:
    """The statistics in lines."""
    u, v = statistics.size
    um = "" if pitch is None else f" ({1e3 * pitch * u:.3g} x {1e3 * pitch * v:.3g} µm)"
    return [
        f"contrast {statistics.contrast:.4f}",
        f"speckle size {u:.3g} x {v:.3g} px{um}",
        f"about {statistics.speckles:.4g} speckles",
        f"centre of gravity {statistics.centre[0]:+.3f}, {statistics.centre[1]:+.3f} px",
        f"mean {statistics.mean:.4g}, largest {statistics.largest / (statistics.mean or 1):.3g} means",
    ]
