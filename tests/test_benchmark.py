"""The benchmark: its peers are right where they claim to be, and it tells what it measured. Nothing here is timed."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest

from speckle_mi.benchmark import QUICK_SCATTERERS, main
from speckle_mi.validation.benchmark.peers import FRESNEL_EPS, fresnel_sum, numba_sum, numpy_sum
from speckle_mi.validation.benchmark.tables import COSTS
from speckle_mi.geometry.plane import PlaneGrid
from speckle_mi.propagation.paths import FreeSpace
from speckle_mi.propagation.costs import Costs
from speckle_mi.propagation.reference import reference_sum

WAVELENGTH = 632.8e-6
ROUNDING = 1e-9
"""Of a float64 phase of 600,000 radians that is not reduced before its sine is taken, with a margin."""


@pytest.fixture(scope="module")
def sources() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(2)
    position = np.column_stack([0.1 * random.normal(size=(40, 2)), 1e-3 * random.normal(size=40)])
    return position, random.normal(size=40) + 1j * random.normal(size=40)


def grid_at(distance: float, shape: tuple[int, int], pitch: float, u=(1.0, 0, 0), v=(0, -1.0, 0)) -> PlaneGrid:
    u, v = np.array(u), np.array(v)
    centre = np.array([0.0, 0, distance])
    return PlaneGrid(centre - pitch * ((shape[1] - 1) / 2 * u + (shape[0] - 1) / 2 * v), u, v, pitch, shape)


def relative(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found.ravel() - exact.ravel()) / np.linalg.norm(exact))


def test_peers_in_float64_are_the_exact_sum(sources):
    points = grid_at(60, (9, 14), 0.2).points()
    exact = reference_sum(FreeSpace(), *sources, points, WAVELENGTH)
    assert relative(numpy_sum(*sources, points, WAVELENGTH), exact) < ROUNDING
    compiled = numba_sum()
    if compiled is not None:
        assert relative(compiled(*sources, points, WAVELENGTH), exact) < ROUNDING


@pytest.mark.parametrize("shape", [(8, 12), (9, 12), (9, 13)])
@pytest.mark.parametrize(
    "axes", [((1.0, 0, 0), (0, -1.0, 0)), ((0, 1.0, 0), (1.0, 0, 0)), ((-1.0, 0, 0), (0, -1.0, 0))]
)
def test_fresnel_sum_is_exact_far_away_for_any_axes_and_parity(sources, shape, axes):
    """At 10 m the first neglected term of the path, (D - P)^4/(8 L^3), is below 1e-9 wavelengths."""
    grid = grid_at(10_000.0, shape, 1.0, *axes)
    exact = reference_sum(FreeSpace(), *sources, grid.points(), WAVELENGTH)
    neglected_amplitude = 1e-6
    assert relative(fresnel_sum(*sources, grid, WAVELENGTH), exact) < 10 * FRESNEL_EPS + neglected_amplitude


def test_quick_benchmark_reports_ours_beside_the_peers(mitsuba, tmp_path, capsys):
    main(["--quick", "--out", str(tmp_path / "benchmark.json")])
    content = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))
    for count in QUICK_SCATTERERS:
        entries = {entry["name"]: entry for entry in content["sums"] if entry["scatterers"] == count}
        assert {"auto 1e-04", "direct", "NumPy float64", "FINUFFT, Fresnel"} <= set(entries)
        assert entries["auto 1e-04"]["error"] < 1e-4
        assert entries["direct"]["error"] < 1e-6
        assert entries["NumPy float64"]["error"] < ROUNDING
        assert all(entry["seconds"] > 0 for entry in entries.values())
    assert {"frames", "pixels_x4_finer", "pixels_x4_larger", "rank"} <= set(content["scaling"])
    assert {"direct kernel", "correlation of a frame", "EXR writing", "start-up and one frame, warm"} <= set(
        content["pieces"]
    )
    budget = {name for name in content["pieces"] if name.startswith(("frame: ", "sweep: "))}
    assert {"frame: shift", "sweep: whole", "sweep: frames", "sweep: pictures"} <= budget
    assert all(0 <= content["pieces"][name]["lost"] < 1 for name in ("engine: this process", "engine: 2 workers"))
    one_frame = content["pieces"]["sensitivities, free space"]
    assert 0 < one_frame["median"] and f"{one_frame['sweep_takes_times']:.0f} times" in one_frame["what"]
    assert set(content["costs"]) == set(COSTS) == {column.name for column in fields(Costs)}
    assert all(cost["measured"] > 0 for cost in content["costs"].values())
    text = capsys.readouterr().out
    for word in ("processor", "ours faster by", "billion pairs a second", "measured / recorded"):
        assert word in text


def test_output_into_a_folder_that_does_not_exist_is_refused_before_any_work(tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        main(["--out", str(tmp_path / "nowhere" / "f.json")])
