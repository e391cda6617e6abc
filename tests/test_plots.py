"""Plots show the numbers they were given, for any amount of data, and appear whole or not at all."""

from __future__ import annotations

import ast
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread

from speckle_mi.report import plots
from speckle_mi.measurement.sensitivity import fit_sensitivity

STEPS = np.linspace(-0.1, 0.1, 10)
SLOPE = 0.9


@pytest.fixture
def drawn(monkeypatch):
    """The figures drawn, in order, besides being written."""
    figures, write = [], plots.write_picture
    monkeypatch.setattr(plots, "write_picture", lambda figure, path: (figures.append(figure), write(figure, path)))
    return figures


def surfaces(count=4, noise_um=2.0):
    rng = np.random.default_rng(count)
    return 1e3 * SLOPE * STEPS + noise_um * rng.normal(size=(count, STEPS.size)) * abs(STEPS) / 0.1


def draw_shifts(path, shifts, theory=SLOPE, steps=STEPS, dof="x", axis="u"):
    fit = fit_sensitivity(steps, shifts, theory=theory)
    plots.plot_shifts(path, steps, shifts, theory, fit, dof, axis)
    return fit


def lines(axes, colour):
    return [line for line in axes.get_lines() if to_hex(line.get_color()) == colour.lower()]


def legend_labels(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_residual_panel_shows_the_shifts_less_theory(tmp_path, drawn):
    shifts = surfaces()
    draw_shifts(tmp_path / "x.png", shifts)
    upper, lower = drawn[0].axes
    for axes, expected in ((upper, shifts), (lower, shifts - 1e3 * SLOPE * STEPS)):
        thin = lines(axes, plots.SURFACE)
        np.testing.assert_allclose([line.get_ydata() for line in thin], expected)
        mean = lines(axes, plots.MEAN)[0]
        np.testing.assert_allclose(mean.get_ydata(), expected.mean(axis=0), atol=1e-12)
    theory = lines(upper, plots.THEORY)[0]
    np.testing.assert_allclose(theory.get_ydata(), 1e3 * SLOPE * theory.get_xdata())
    assert imread(tmp_path / "x.png").shape[2] == 4


def test_error_bars_are_the_standard_deviation_over_surfaces(tmp_path, drawn):
    shifts = surfaces(6)
    shifts[:5, 0] = np.nan
    draw_shifts(tmp_path / "x.png", shifts)
    (bars,) = drawn[0].axes[0].collections
    length = [np.ptp(segment[:, 1]) for segment in bars.get_segments() if len(segment)]
    # A displacement that one surface alone has measured gets no bar.
    np.testing.assert_allclose(length, 2 * shifts[:, 1:].std(axis=0, ddof=1))


def test_frames_that_failed_are_marked_and_counted(tmp_path, drawn):
    shifts = surfaces()
    shifts[0, 2] = shifts[0, 7] = shifts[3, 7] = np.nan
    draw_shifts(tmp_path / "x.png", shifts)
    lower = drawn[0].axes[1]
    (crosses,) = lines(lower, plots.LOST)
    np.testing.assert_array_equal(crosses.get_xdata(), STEPS[[2, 7]])
    assert [text.get_text() for text in lower.texts] == ["1", "2"]
    assert "frames not measured" in legend_labels(drawn[0])


def test_displacements_in_any_order_draw_the_same_line(tmp_path, drawn):
    shifts, order = surfaces(), np.random.default_rng(0).permutation(STEPS.size)
    draw_shifts(tmp_path / "x.png", shifts[:, order], steps=STEPS[order])
    np.testing.assert_allclose(lines(drawn[0].axes[0], plots.SURFACE)[0].get_ydata(), shifts[0])


def test_labels_carry_units_and_the_legend_stays_outside_the_data(tmp_path, drawn):
    draw_shifts(tmp_path / "ry.png", surfaces(), dof="ry", axis="cog_v")
    figure = drawn[0]
    upper, lower = figure.axes
    assert "(µm)" in upper.get_ylabel() and "centre of gravity" in upper.get_ylabel()
    assert "(µm)" in lower.get_ylabel() and "(deg)" in lower.get_xlabel()
    legend, title = figure.legends[0].get_window_extent(), upper.title.get_window_extent()
    assert legend.y0 >= upper.get_window_extent().y1
    for box in (legend, title):
        assert box.x0 >= 0 and box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height


NOTHING = np.full((3, 10), np.nan)
SHIFT_CASES = {
    "one surface without theory": (surfaces(1), None, STEPS),
    "two surfaces": (surfaces(2), SLOPE, STEPS),
    "sixty surfaces": (surfaces(60), SLOPE, STEPS),
    "nothing measured": (NOTHING, None, STEPS),
    "nothing measured but theory known": (NOTHING, SLOPE, STEPS),
    "one frame": (np.array([[90.0]]), SLOPE, STEPS[-1:]),
    "no displacement": (np.zeros((3, 0)), None, STEPS[:0]),
    "many lost displacements": (np.full((2, 200), np.nan), SLOPE, np.linspace(-1, 1, 200)),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", SHIFT_CASES)
def test_shifts_are_drawn_for_any_amount_of_data(tmp_path, case):
    shifts, theory, steps = SHIFT_CASES[case]
    draw_shifts(tmp_path / "x.png", shifts, theory, steps)
    assert imread(tmp_path / "x.png").ndim == 3


def test_decorrelation_has_a_panel_per_motion_in_their_fixed_order_with_theory_where_known(tmp_path, drawn):
    peak = np.exp(-((STEPS / 0.12) ** 2)) - np.array([[0.0], [0.02]])
    correlations = {dof: peak.copy() for dof in ("rz", "y", "x", "rx")}
    correlations["y"][1, 3] = np.nan
    fine = np.linspace(-0.1, 0.1, 50)
    theory = {"x": (fine, np.exp(-((fine / 0.12) ** 2)))}
    plots.plot_decorrelation(tmp_path / "c.png", dict.fromkeys(correlations, STEPS), correlations, theory)
    panels = [axes for axes in drawn[0].axes if axes.get_visible()]
    assert [axes.get_xlabel().split()[-2] for axes in panels] == ["x", "y", "x", "z"]
    assert [len(lines(axes, plots.THEORY)) for axes in panels] == [1, 0, 0, 0]
    assert [len(lines(axes, plots.LOST)) for axes in panels] == [0, 1, 0, 0]
    np.testing.assert_allclose(lines(panels[0], plots.SURFACE)[1].get_ydata(), peak[1])
    legend = drawn[0].legends[0].get_window_extent()
    assert legend.y0 >= panels[0].get_window_extent().y1 and legend.x1 <= drawn[0].bbox.width


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("count", [1, 2, 6])
def test_decorrelation_is_drawn_for_one_to_six_motions_and_lost_frames(tmp_path, drawn, count):
    dofs = plots.DEGREES_OF_FREEDOM[:count]
    correlations = {dof: np.full((2, 10), np.nan) for dof in dofs}
    plots.plot_decorrelation(tmp_path / "c.png", dict.fromkeys(dofs, STEPS), correlations)
    assert drawn[0].legends[0].get_window_extent().x1 <= drawn[0].bbox.width
    with pytest.raises(ValueError, match="no degree of freedom"):
        plots.plot_decorrelation(tmp_path / "none.png", {}, {})


def test_speckle_axes_are_millimetres_from_the_centre_with_v_downwards(tmp_path, drawn):
    intensity = np.random.default_rng(0).exponential(size=(30, 50))
    plots.plot_speckle(tmp_path / "s.png", intensity, 0.01, "title")
    axes = drawn[0].axes[0]
    left, right, bottom, top = axes.images[0].get_extent()
    np.testing.assert_allclose([left, right, top, bottom], [-0.25, 0.25, -0.15, 0.15])
    assert axes.get_ylim()[0] > axes.get_ylim()[1] and axes.get_aspect() == 1
    np.testing.assert_allclose(axes.images[0].get_array().mean(), 1)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("shape", [(1, 1), (1, 4096), (4096, 1), (3, 700), (64, 64), (480, 744)])
def test_speckle_images_of_any_shape_are_drawn_at_a_printable_size(tmp_path, drawn, shape):
    intensity = np.random.default_rng(0).exponential(size=shape)
    plots.plot_speckle(tmp_path / "s.png", intensity, 0.006, "pattern")
    rows, columns, _ = imread(tmp_path / "s.png").shape
    assert 200 < rows < 2000 and 300 < columns < 2000
    stretched = max(shape) / min(shape) > plots.LONGEST_ASPECT
    assert ("not to scale" in drawn[0].axes[0].get_title(loc="left")) == stretched


@pytest.mark.parametrize("shape", [(744, 480), (1000, 170), (480, 744), (240, 720)])
def test_a_speckle_image_fills_its_picture_and_no_label_is_cut_off(tmp_path, shape):
    plots.plot_speckle(tmp_path / "s.png", np.random.default_rng(0).exponential(size=shape), 0.006, "pattern")
    ink = imread(tmp_path / "s.png")[..., :3].min(axis=-1) < 0.8
    for side in (ink, ink.T):
        drawn = np.flatnonzero(side.any(axis=1))
        before, behind = drawn[0], len(side) - 1 - drawn[-1]
        assert 3 <= before < 60 and 3 <= behind < 60


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [0.0, 1e-30, 1e30, np.nan])
def test_constant_dark_and_lost_speckle_images_are_drawn(tmp_path, value):
    plots.plot_speckle(tmp_path / "s.png", np.full((20, 30), value), 0.006)
    assert (tmp_path / "s.png").stat().st_size > 0


def test_speckle_without_pixels_or_pitch_is_refused(tmp_path):
    with pytest.raises(ValueError, match="intensity of shape"):
        plots.plot_speckle(tmp_path / "s.png", np.zeros((0, 4)), 0.006)
    with pytest.raises(ValueError, match="pitch_mm = 0"):
        plots.plot_speckle(tmp_path / "s.png", np.ones((4, 4)), 0.0)
    assert not list(tmp_path.iterdir())


def test_failed_plot_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    target = tmp_path / "s.png"
    target.write_bytes(b"old")

    def fail(*_arguments, **_keywords):
        raise OSError("disk full")

    monkeypatch.setattr(plots.Figure, "savefig", fail)
    with pytest.raises(OSError, match="disk full"):
        plots.plot_speckle(target, np.ones((4, 4)), 0.006)
    assert target.read_bytes() == b"old" and list(tmp_path.iterdir()) == [target]


@pytest.mark.skipif(os.name != "posix", reason="file rights are POSIX")
def test_picture_replaces_the_old_file_with_ordinary_rights(tmp_path):
    target, ordinary = tmp_path / "s.png", tmp_path / "ordinary"
    target.write_bytes(b"old")
    ordinary.touch()
    plots.plot_speckle(target, np.ones((4, 4)), 0.006)
    assert target.read_bytes().startswith(b"\x89PNG")
    assert stat.S_IMODE(target.stat().st_mode) == stat.S_IMODE(ordinary.stat().st_mode)
    assert {path.name for path in tmp_path.iterdir()} == {"s.png", "ordinary"}


def test_plots_are_drawn_without_the_global_state_of_pyplot():
    tree = ast.parse(Path(plots.__file__).read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not any("pyplot" in name for name in names)
