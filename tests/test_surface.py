"""Scatterers belong to the material: where they are, how many, how high, and which of them are lit and seen."""

from __future__ import annotations

import numpy as np
import pytest
from scene_builder import (
    WORLD,
    direction,
    free_space,
)
from scipy import stats
from scipy.spatial import cKDTree

from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.geometry.rotation import rotation_matrix
from speckle_mi.scattering.beam import Beam
from speckle_mi.field.simulation import simulate, simulate_frame
from speckle_mi.scattering.facets import Facets
from speckle_mi.scattering.rough_surface import RoughSurface, illuminated_scatterers

pytestmark = pytest.mark.usefixtures("mitsuba")

WAVELENGTH = 632.8e-6
SIGMAS = 4.5  # Standard errors allowed: about one false alarm in 10^5 checks.
KS_999 = 1.95  # Kolmogorov-Smirnov statistic times sqrt(n) that chance exceeds once in a thousand.
ROUNDING = 1e-13  # [mm]: float64 rounding of coordinates of some 100 mm through a pose and back.


def normal_beam(radius=0.12, to_laser=direction(0)):
    return Beam.round(50 * to_laser, -to_laser, radius, -750.0, WAVELENGTH, np.zeros(3))


def patch(density=2000.0, roughness=0.8e-3, correlation_length=0.0, seed=0, width=4.0):
    return RoughSurface(Facets.rectangle(width, width), density, roughness, correlation_length, seed)


def material(surface, beam, frame=WORLD):
    """Scatterers' places in the target frame (n, 3), sorted by x."""
    places = frame.to_local(illuminated_scatterers(surface, beam, frame).position)
    return places[np.argsort(places[:, 0])]


def shared(a, b):
    """Pairs of rows of two sets of places that are one scatterer, and how many of ``a`` lie inside 2 beam radii."""
    distance, index = cKDTree(b[:, :2]).query(a[:, :2])
    return a[distance < 1e-6], b[index[distance < 1e-6]]


# Material


@pytest.mark.parametrize(
    "pose", [Pose(x=0.0625), Pose(x=0.1, y=-0.05, z=0.2), Pose(rz=90.0), Pose(x=0.02, rx=3, ry=-5, rz=20)], ids=str
)
def test_a_scatterer_under_the_beam_at_two_poses_is_the_same_scatterer(pose):
    surface, beam = patch(), normal_beam()
    rest, moved = material(surface, beam), material(surface, beam, WORLD.moved(pose))
    one, other = shared(rest, moved)
    assert len(one) > 0.3 * len(rest)  # most of the disc of three beam radii stays under the beam
    np.testing.assert_allclose(one, other, rtol=0, atol=ROUNDING)


def test_material_place_is_the_same_to_the_last_bit_at_every_height_of_the_target():
    surface, beam = patch(), normal_beam()
    # Under the beam at every height, whose radius changes a little along it.
    always = lambda places: places[np.linalg.norm(places[:, :2], axis=1) < 0.95 * beam.cutoffs[0]]  # noqa: E731
    rest = always(material(surface, beam))
    for z in (1.0, -3.0, 7.123456789):
        moved = always(illuminated_scatterers(surface, beam, WORLD.moved(Pose(z=z))).position)
        moved = moved[np.argsort(moved[:, 0])]
        np.testing.assert_array_equal(moved[:, :2], rest[:, :2])


def test_material_that_comes_back_under_the_beam_was_always_there():
    """A narrow beam on the moved target finds what a wide beam sees on the resting one, everywhere."""
    surface = patch()
    wide = material(surface, normal_beam(radius=0.6))
    pose = Pose(x=-0.7, y=0.4)
    narrow = material(surface, normal_beam(), WORLD.moved(pose))
    one, other = shared(narrow, wide)
    assert len(one) == len(narrow)
    np.testing.assert_allclose(one, other, rtol=0, atol=ROUNDING)


def test_place_in_the_world_does_not_change_the_material():
    surface = patch()
    axes = rotation_matrix(np.array([0.4, -1.1, 0.3]))
    frame = Frame(np.array([120.0, -30.0, 55.0]), axes)
    to_laser = axes @ direction(0)
    beam = Beam.round(frame.origin + 50 * to_laser, -to_laser, 0.12, -750.0, WAVELENGTH, frame.origin)
    one, other = shared(material(surface, beam, frame), material(surface, normal_beam()))
    assert len(one) >= len(material(surface, normal_beam())) - 2  # one on the edge may fall to either side
    np.testing.assert_allclose(one, other, rtol=0, atol=ROUNDING)


def test_frames_in_any_order_give_the_same_bits(shipped):
    assembly = shipped("tilted_laser", width=48, height=32)
    poses = [Pose(x=0.05), Pose(), Pose(ry=0.1), Pose(z=-0.1, rz=0.2)]
    first = [simulate(assembly, pose).field for pose in poses]
    for number in (2, 0, 3, 1, 2):
        np.testing.assert_array_equal(simulate(assembly, poses[number]).field, first[number])


def test_a_scene_loaded_again_gives_the_same_bits(shipped):
    one, other = (shipped("both_tilted", width=48, height=32, seed=5) for _ in range(2))
    np.testing.assert_array_equal(simulate(one, Pose(x=0.01)).field, simulate(other, Pose(x=0.01)).field)
    assert one.fingerprint() == other.fingerprint()


def test_surfaces_of_different_seeds_are_independent():
    beam = normal_beam()
    density = 2000.0
    phases = []
    for seed in (0, 1, 2, 2**40):
        places = material(patch(density, seed=seed), beam)
        cell = np.floor(places[:, :2] * np.sqrt(density)).astype(int)
        phases.append({tuple(c): place for c, place in zip(cell, places)})
    for a in range(len(phases)):
        for b in range(a):
            cells = sorted(set(phases[a]) & set(phases[b]))
            one, other = (np.array([phases[k][c] for c in cells]) for k in (a, b))
            assert len(cells) > 400
            correlations = [
                np.corrcoef((one[:, k] * np.sqrt(density)) % 1 if k < 2 else one[:, k],
                            (other[:, k] * np.sqrt(density)) % 1 if k < 2 else other[:, k])[0, 1]
                for k in range(3)
            ]
            assert np.abs(correlations).max() < SIGMAS / np.sqrt(len(cells))


def test_with_seed_is_the_seed_of_the_scene(shipped):
    sown = shipped("tilted_laser", width=16, height=16, seed=7)
    changed = shipped("tilted_laser", width=16, height=16).with_seed(7)
    np.testing.assert_array_equal(simulate(sown).field, simulate(changed).field)


# Number and places


@pytest.mark.parametrize("angle", [0, 35, 70])
@pytest.mark.parametrize("point_sources", [20, 100, 3000])
def test_expected_number_inside_the_footprint_is_point_sources(assemble, angle, point_sources):
    to_laser = direction(angle, 180)
    assembly = assemble(free_space(to_laser, target={"point_sources": point_sources, "width": 8.0}))
    surfaces = 40
    counts = []
    for seed in range(surfaces):
        surface = assembly.with_seed(seed).target.surface
        position = illuminated_scatterers(surface, assembly.beam, WORLD).position
        across = position - np.outer(position @ to_laser, to_laser)
        counts.append(np.sum(np.einsum("ij,ij->i", across, across) <= 0.12**2))
    # Cells hold one scatterer each, so only those cut by the rim vary: less than Poisson's sqrt(N).
    assert np.mean(counts) == pytest.approx(point_sources, abs=SIGMAS * np.sqrt(point_sources / surfaces))
    assert np.std(counts) < np.sqrt(point_sources)


def test_every_square_cell_holds_one_scatterer_at_a_random_place():
    density = 2000.0
    places = illuminated_scatterers(patch(density, width=1.0), normal_beam(radius=np.inf), WORLD).position
    pitch = density**-0.5
    cell, inside = np.divmod(places[:, :2] / pitch, 1)
    assert len(np.unique(cell, axis=0)) == len(places)
    # Only cells on the rim, cut by the patch, may be empty.
    middle = np.all(np.abs((cell + 0.5) * pitch) < 0.5 - pitch, axis=1)
    assert middle.sum() == np.prod([len(np.unique(cell[middle, k])) for k in (0, 1)])
    for k in (0, 1):
        assert stats.kstest(inside[middle, k], "uniform").statistic < KS_999 / np.sqrt(middle.sum())
    assert abs(np.corrcoef(inside[middle].T)[0, 1]) < SIGMAS / np.sqrt(middle.sum())
    assert np.abs(places[:, :2]).max() <= 0.5


def test_nothing_lies_outside_the_patch_and_the_beam():
    surface = RoughSurface(Facets.rectangle(0.2, 0.1), 50_000.0, 0.0, 0.0, 3)
    places = material(surface, normal_beam())
    assert np.abs(places[:, 0]).max() <= 0.1 and np.abs(places[:, 1]).max() <= 0.05
    assert len(places) == pytest.approx(50_000 * 0.02, abs=SIGMAS * np.sqrt(50_000 * 0.02))
    places = material(patch(50_000.0, roughness=0.0), normal_beam())
    assert np.hypot(places[:, 0], places[:, 1]).max() <= 3 * 0.12


def test_uniform_laser_lights_the_whole_patch_with_point_sources(assemble):
    assembly = assemble(
        free_space(laser={"beam_radius": None}, target={"point_sources": 2500, "width": 1.0, "height": 2.0})
    )
    scatterers = simulate_frame(assembly).scatterers
    assert scatterers.count == pytest.approx(2500, abs=SIGMAS * np.sqrt(2500))
    np.testing.assert_allclose(np.abs(scatterers.amplitude), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(scatterers.position[:, :2], axis=0), [1, 2], atol=0.1)


# Heights


def test_heights_are_gaussian_with_the_rms_roughness():
    heights = illuminated_scatterers(patch(20_000.0, roughness=0.8e-3, width=1), normal_beam(np.inf), WORLD).position[
        :, 2
    ]
    n = len(heights)
    assert stats.kstest(heights / 0.8e-3, "norm").statistic < KS_999 / np.sqrt(n)
    assert heights.std() == pytest.approx(0.8e-3, rel=SIGMAS / np.sqrt(2 * n))


def test_independent_heights_of_neighbours_are_uncorrelated():
    places = illuminated_scatterers(patch(20_000.0, width=1), normal_beam(np.inf), WORLD).position
    _, index = cKDTree(places[:, :2]).query(places[:, :2], k=2)
    correlation = np.corrcoef(places[:, 2], places[index[:, 1], 2])[0, 1]
    assert abs(correlation) < SIGMAS * np.sqrt(2 / len(places))  # nearest pairs are counted up to twice


PAIRED = 3000  # Scatterers of each surface whose pairs are averaged.


def _autocorrelation(places, length, bins):
    """Mean product of heights over their variance, in bins of distance, from pairs up to 2.5 correlation lengths."""
    rng = np.random.default_rng(0)
    some = rng.choice(len(places), PAIRED, replace=False)
    tree = cKDTree(places[:, :2])
    pairs = cKDTree(places[some, :2]).sparse_distance_matrix(tree, bins[-1] * length, output_type="coo_matrix")
    product = places[some[pairs.row], 2] * places[pairs.col, 2]
    index = np.digitize(pairs.data / length, bins) - 1
    keep = (index >= 0) & (index < len(bins) - 1) & (pairs.data > 0)
    count = np.bincount(index[keep], minlength=len(bins) - 1)
    return np.bincount(index[keep], product[keep], len(bins) - 1) / count


@pytest.mark.parametrize("facets", ["rectangle", "triangles"])
def test_correlated_heights_have_a_gaussian_autocorrelation(facets):
    length, rms, width, seeds = 0.012, 0.8e-3, 1.5, 3
    a = width / 2
    corners = np.array([[[-a, -a, 0], [a, -a, 0], [a, a, 0]], [[-a, -a, 0], [a, a, 0], [-a, a, 0]]])
    form = Facets.rectangle(width, width) if facets == "rectangle" else Facets.triangles(corners)
    bins = np.linspace(0, 2.5, 11)
    measured, variance = [], []
    for seed in range(seeds):
        places = illuminated_scatterers(
            RoughSurface(form, 40_000.0, rms, length, seed), normal_beam(np.inf), WORLD
        ).position
        measured.append(_autocorrelation(places, length, bins) / rms**2)
        variance.append(places[:, 2].var() / rms**2)
    # Independent patches of the surface: area over the integral pi l^2/2 of the squared autocorrelation.
    independent = seeds * width**2 / (np.pi * length**2 / 2)
    assert np.mean(variance) == pytest.approx(1, abs=SIGMAS * np.sqrt(2 / independent))
    middle = (bins[1:] ** 2 + bins[:-1] ** 2) / 2  # mean squared distance of pairs in a ring
    error = SIGMAS / np.sqrt(min(independent, seeds * PAIRED))
    np.testing.assert_allclose(np.mean(measured, axis=0), np.exp(-middle), atol=error)


def test_correlated_heights_are_material_too():
    surface, beam = patch(20_000.0, correlation_length=0.02), normal_beam()
    pose = Pose(x=0.1, rz=30)
    one, other = shared(material(surface, beam), material(surface, beam, WORLD.moved(pose)))
    assert len(one) > 500
    np.testing.assert_allclose(one, other, rtol=0, atol=ROUNDING)


# The user's own scatterers


def test_points_file_without_weights_scatters_at_its_points(assemble, tmp_path):
    rows = np.random.default_rng(3).uniform(-0.1, 0.1, (7, 3))
    path = tmp_path / "points.csv"
    path.write_text("x,y,z\n" + "\n".join(",".join(map(repr, map(float, row))) for row in rows))
    frame = Frame(np.array([1.0, 2.0, 3.0]), rotation_matrix(np.array([0.1, 0.2, -0.3])))
    scatterers = simulate_frame(
        assemble(free_space(target_frame=frame, target={"points": str(path), "roughness": 50.0})), Pose(x=0.05, ry=2)
    ).scatterers
    np.testing.assert_allclose(scatterers.position, frame.moved(Pose(x=0.05, ry=2)).to_world(rows), atol=ROUNDING)


def test_weights_of_a_points_file_multiply_the_lasers_field(assemble, tmp_path):
    rng = np.random.default_rng(4)
    rows = np.column_stack([rng.uniform(-0.1, 0.1, (5, 3)), rng.normal(size=(5, 2))])
    weighted, plain = tmp_path / "weighted.csv", tmp_path / "plain.csv"
    weighted.write_text("# made by hand\n\n" + "\n".join(",".join(map(repr, map(float, row))) for row in rows))
    plain.write_text("\n".join(",".join(map(repr, map(float, row[:3]))) for row in rows))
    one, other = (simulate_frame(assemble(free_space(target={"points": str(p)}))).scatterers for p in (weighted, plain))
    np.testing.assert_allclose(one.amplitude, other.amplitude * (rows[:, 3] + 1j * rows[:, 4]), atol=1e-14)


# Limits


def test_a_target_moved_out_of_the_beam_is_dark_and_says_so(assemble):
    assembly = assemble(free_space(target={"width": 0.5, "height": 0.5}))
    frame = simulate_frame(assembly, Pose(x=5))
    assert frame.scatterers.count == 0 and not frame.image.intensity.any()
    assert any("no light" in warning for warning in frame.warnings)


def test_too_many_scatterers_are_refused_before_memory_is_taken(assemble):
    assembly = assemble(free_space(target={"point_sources": 10**12}))
    with pytest.raises(ValueError, match="point_sources"):
        simulate(assembly)
