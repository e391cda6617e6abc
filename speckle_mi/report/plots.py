"""Pictures of a sweep as PNG files: shifts, decorrelation, the speckle pattern.

Plain arrays in, a file out. Drawn on matplotlib's Agg canvas through objects, without global state, so it works
without a display and in any thread. A file appears whole or not at all.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from ..geometry.pose import DEGREES_OF_FREEDOM, is_rotation
from ..machine.files import replacing
from ..measurement.sensitivity import Sensitivity

MEAN, THEORY, LOST, SURFACE = "#0072B2", "#D55E00", "#CC79A7", "#8C8C8C"
"""Colours that the colour-blind can tell apart (Okabe and Ito) and that differ in lightness in print."""

FONT = 10.0  # [pt]
RESOLUTION = 160  # [dots per inch]

COMPRESSION = 3
"""Of PNG files: no larger than by the usual 6, and in a quarter of the time."""

LONGEST_ASPECT = 6.0
"""Side ratio from which an image is stretched across to be seen at all."""

MOST_COUNTS = 25
"""Displacements up to which the number of lost frames has room beside its mark."""


def plot_shifts(
    path: str | os.PathLike,
    displacement: np.ndarray,
    shifts: np.ndarray,
    theory: float | None,
    fitted: Sensitivity,
    dof: str,
    axis: str,
) -> None:
    """Shift of the pattern against displacement, and below it the residual; one motion, one axis.

    Every surface is a thin line, their mean a marker with the standard deviation over surfaces. The residual is
    against theory, or against the fitted slope where there is no theory. Displacements at which frames failed are
    marked with how many.

    path: PNG to write. displacement: (n,) [mm or deg]. shifts: (surfaces, n) [um], NaN where not measured.
    theory: slope [mm/mm or mm/deg] or None. fitted: its result, for the same data. dof: x, y, z, rx, ry or rz.
    axis: what moved, such as "u", "x" or "cog_u".
    """
    displacement, shifts = _sorted(displacement, shifts)
    theory = theory if theory is not None and np.isfinite(theory) else None
    slope = fitted.value if theory is None else theory
    figure = new_figure(6.4, 5.6)
    upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
    residual = shifts - 1e3 * slope * displacement
    for axes, values in ((upper, shifts), (lower, residual)):
        dress(axes)
        axes.axhline(0, color="0.8", linewidth=0.8, zorder=0)
        _surfaces_and_mean(axes, displacement, values)
    span = np.array([displacement.min(), displacement.max()]) if displacement.size else np.zeros(2)
    if np.isfinite(slope):
        name = "theory" if theory is not None else "fit"
        style = {"color": THEORY, "linewidth": 1.6, "zorder": 2}
        upper.plot(span, 1e3 * slope * span, label=f"{name} {slope:.4g} {fitted.unit}", **style)
        lower.axhline(0, **style)
    else:
        lower.text(0.5, 0.75, "no slope measured", transform=lower.transAxes, ha="center", va="center", color="0.4")
        lower.set_yticks([])
    if not np.all(np.isfinite(shifts)):
        _make_room_below(lower)
        _mark_lost(lower, displacement, shifts)
    upper.set_ylabel(f"shift along {_axis_name(axis)} (µm)")
    lower.set_ylabel("shift − theory (µm)" if theory is not None else "shift − fit (µm)")
    lower.set_xlabel(_motion_name(dof))
    upper.set_title(_result(fitted), loc="left", fontsize=FONT)
    legend_outside(figure, upper, lower, columns=2)
    figure.align_ylabels()
    write_picture(figure, path)


def plot_decorrelation(
    path: str | os.PathLike,
    displacements: Mapping[str, np.ndarray],
    correlations: Mapping[str, np.ndarray],
    theory: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> None:
    """Height of the correlation peak against displacement, a panel for every degree of freedom swept.

    path: PNG to write. displacements: dof -> (n,) [mm or deg]. correlations: dof -> (surfaces, n), NaN where not
    measured. theory: dof -> (displacement, correlation), two arrays (m,), for the motions that have a curve.
    Raises ValueError without any degree of freedom.
    """
    if not correlations:
        raise ValueError("correlations: no degree of freedom to plot, one or more are needed")
    dofs = sorted(correlations, key=DEGREES_OF_FREEDOM.index)
    columns = min(len(dofs), 3)
    rows = -(-len(dofs) // columns)
    figure = new_figure(max(2.9 * columns + 0.5, 4.8), 2.6 * rows + 0.7)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for panel in panels.flat[len(dofs) :]:
        panel.set_visible(False)
    for panel, dof in zip(panels.flat, dofs, strict=False):
        displacement, correlation = _sorted(displacements[dof], correlations[dof])
        dress(panel)
        _surfaces_and_mean(panel, displacement, correlation)
        if theory is not None and dof in theory:
            panel.plot(*_finite_curve(*theory[dof]), color=THEORY, linewidth=1.6, zorder=2, label="theory")
        _mark_lost(panel, displacement, correlation)
        panel.set_xlabel(_motion_name(dof))
    measured = np.concatenate([np.ravel(correlations[dof]) for dof in dofs])
    panels[0, 0].set_ylim(min(1.05 * np.nanmin(measured, initial=0.0), 0.0), 1.05)
    if not np.all(np.isfinite(measured)):
        _make_room_below(panels[0, 0])
    for panel in panels[:, 0]:
        panel.set_ylabel("peak correlation")
    legend_outside(figure, *panels.flat, columns=2 * columns)
    write_picture(figure, path)


def plot_speckle(path: str | os.PathLike, intensity: np.ndarray, pitch_mm: float, title: str = "") -> None:
    """Speckle image with axes in mm from its centre, u to the right, v (increasing row) downwards.

    White is the 99.5 % quantile of the intensity over its mean; dark is zero. An image more than `LONGEST_ASPECT`
    times longer than wide is stretched, and says so.

    path: PNG to write. intensity: (rows, columns), any unit; NaN is drawn in colour. pitch_mm: pixel pitch [mm].
    Raises ValueError for an image without pixels or a pitch that is not positive.
    """
    intensity = np.asarray(intensity, dtype=np.float64)
    if intensity.ndim != 2 or intensity.size == 0:
        raise ValueError(f"intensity of shape {intensity.shape}: must be (rows, columns) with at least one pixel")
    if not (np.isfinite(pitch_mm) and pitch_mm > 0):
        raise ValueError(f"pitch_mm = {pitch_mm}: must be positive")
    height, width = pitch_mm * np.array(intensity.shape)
    stretched = max(width / height, height / width) > LONGEST_ASPECT
    aspect = np.clip(height / width, 0.25, 1.6)
    tall = 4.9 * aspect
    wide = 4.9 if stretched else min(4.9, max(tall * width / height, 1.2))
    figure = new_figure(1.5 + wide, 1.0 + tall)
    axes = figure.add_subplot()
    relative, white = _relative_intensity(intensity)
    image = axes.imshow(
        np.ma.masked_invalid(relative),
        cmap="gray",
        vmin=0,
        vmax=white,
        extent=(-width / 2, width / 2, height / 2, -height / 2),
        aspect="auto" if stretched else "equal",
    )
    axes.set_facecolor(LOST)
    axes.tick_params(direction="out", labelsize=FONT - 1)
    axes.locator_params(axis="y", nbins=3 if aspect < 0.5 else 7)
    axes.set_xlabel("u (mm)")
    axes.set_ylabel("v (mm)")
    note = "sides not to scale" if stretched else ""
    axes.set_title("   ".join(filter(None, (title, note))), loc="left", fontsize=FONT)
    bar = figure.colorbar(image, cax=axes.inset_axes((1 + 0.1 / wide, 0, 0.12 / wide, 1)))
    bar.set_label("intensity / mean")
    bar.ax.tick_params(labelsize=FONT - 1)
    write_picture(figure, path)


def _relative_intensity(intensity: np.ndarray) -> tuple[np.ndarray, float]:
    """(intensity over its mean, level shown white); a dark or constant image stays finite."""
    finite = intensity[np.isfinite(intensity)]
    mean = finite.mean() if finite.size else 0.0
    if not mean > 0:
        return np.where(np.isfinite(intensity), 0.0, np.nan), 1.0
    return intensity / mean, float(max(np.quantile(finite, 0.995) / mean, 1.0))


def _surfaces_and_mean(axes: Axes, displacement: np.ndarray, values: np.ndarray) -> None:
    """Thin lines of the surfaces, broken where not measured; their mean with the standard deviation if several."""
    if len(values) == 1:
        style = {"color": MEAN, "linewidth": 0.7, "markersize": 4.5, "zorder": 3}
        axes.plot(displacement, values[0], "o-", label="one surface", **style)
    else:
        for number, surface in enumerate(values):
            name = "each surface" if number == 0 else None
            axes.plot(displacement, surface, color=SURFACE, linewidth=0.7, alpha=0.7, zorder=1, label=name)
    if len(values) < 2:
        return
    measured = np.isfinite(values)
    count = measured.sum(axis=0)
    seen = count > 0
    filled = np.where(measured, values, 0.0)
    mean = filled.sum(axis=0)[seen] / count[seen]
    deviation = np.where(measured[:, seen], filled[:, seen] - mean, 0.0)
    spread = np.sqrt(np.sum(deviation**2, axis=0) / np.maximum(count[seen] - 1, 1))
    bars = np.where(count[seen] > 1, spread, np.nan)
    style = {"color": MEAN, "markersize": 4.5, "elinewidth": 1.2, "capsize": 2.5, "zorder": 3}
    axes.errorbar(displacement[seen], mean, bars, fmt="o", label=f"mean ± s.d. of {len(values)} surfaces", **style)


def _mark_lost(axes: Axes, displacement: np.ndarray, values: np.ndarray) -> None:
    """Crosses along the lower edge where frames were not measured, with how many if there are several surfaces."""
    lost = np.sum(~np.isfinite(values), axis=0)
    where = lost > 0
    if not np.any(where):
        return
    edge = blended_transform_factory(axes.transData, axes.transAxes)
    style = {"color": LOST, "markersize": 5.5, "markeredgewidth": 1.6, "clip_on": False, "zorder": 4}
    height = np.full(np.count_nonzero(where), 0.04)
    axes.plot(displacement[where], height, "x", transform=edge, label="frames not measured", **style)
    if len(values) > 1 and displacement.size <= MOST_COUNTS:
        for x, number in zip(displacement[where], lost[where], strict=True):
            axes.text(x, 0.075, f"{number}", transform=edge, ha="center", va="bottom", fontsize=FONT - 3, color="0.3")


def _make_room_below(axes: Axes) -> None:
    """A strip without data along the lower edge, for the marks of frames that were not measured."""
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom - 0.16 * (top - bottom), top)


def _result(fitted: Sensitivity) -> str:
    """One line: the sensitivity with its interval and the scatter."""
    if not np.isfinite(fitted.value):
        return f"sensitivity not measured: {fitted.note}"
    low, high = fitted.ci95
    interval = f" (95 %: {low:.4g} … {high:.4g})" if np.isfinite(low) else ""
    scatter = f", scatter {fitted.scatter_um:.2g} µm" if np.isfinite(fitted.scatter_um) else ""
    return f"sensitivity {fitted.value:.4g}{interval} {fitted.unit}{scatter}"


def _motion_name(dof: str) -> str:
    if is_rotation(dof):
        return f"rotation of the target about {dof[1:]} (deg)"
    return f"motion of the target along {dof} (mm)"


def _axis_name(axis: str) -> str:
    return f"{axis[4:]}, centre of gravity" if axis.startswith("cog_") else axis


def _sorted(displacement: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) and (surfaces, n) in order of displacement."""
    displacement = np.asarray(displacement, dtype=np.float64)
    values = np.atleast_2d(np.asarray(values, dtype=np.float64))
    if values.shape[1:] != displacement.shape:
        raise ValueError(f"values of shape {values.shape}: must be (surfaces, {displacement.size})")
    order = np.argsort(displacement)
    return displacement[order], values[:, order]


def _finite_curve(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    return x[np.isfinite(y)], y[np.isfinite(y)]


def new_figure(width: float, height: float) -> Figure:
    """A figure of that size [inch] with an Agg canvas."""
    figure = Figure(figsize=(width, height), dpi=RESOLUTION, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.06)
    FigureCanvasAgg(figure)
    return figure


def dress(axes: Axes) -> None:
    """Frame, grid and font of every panel."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.93", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=FONT - 1)
    axes.margins(x=0.04, y=0.08)
    if axes.get_xscale() == "linear":
        axes.locator_params(axis="x", nbins=6)


def legend_outside(figure: Figure, *axes: Axes, columns: int, below: bool = False) -> None:
    """One legend for all axes, outside the data: above them or, under a title, below; in so many columns."""
    entries = {}
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        looks = {"frameon": False, "fontsize": FONT - 1, "handlelength": 1.6, "columnspacing": 1.4}
        place = f"outside {'lower' if below else 'upper'} left"
        figure.legend(entries.values(), entries.keys(), loc=place, ncols=columns, **looks)


def write_picture(figure: Figure, path: str | os.PathLike) -> None:
    """Writes the PNG, or the SVG where the path ends so, whole or not at all."""
    with replacing(path) as temporary:
        if str(path).lower().endswith(".svg"):
            figure.savefig(temporary, format="svg")
        else:
            figure.savefig(temporary, format="png", pil_kwargs={"compress_level": COMPRESSION})
