"""Light of a ``traced`` laser: over mirrors, splitters, lenses and past edges to the target, against beams by hand,
Huygens sums and moved geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exact_optics import fermat, lens_surfaces
from scene_builder import WORLD, detector_frame, detector_xml, direction, frame_along, integrator_xml, laser_xml
from scene_builder import scene_of, target_xml
from scipy.special import roots_legendre

from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.experiments.one_frame import one_frame_sensitivity
from speckle_mi.field.simulation import Simulation, simulate_frame
from speckle_mi.geometry.frames import Frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.write import shape, write_points

TOLERANCE = 1e-4  # relative L2, of the scenes
SAME = 1e-7  # relative L2: paths over a mirror are those to its image, and sums are partly in single precision
STANDARD_ERRORS = 4
WAVELENGTH = 632.8e-6
TO_LASER = direction(35, 180)
N = 1.5151


def on_way(distance: float, turn=0.0) -> Frame:
    """A place on the straight line from the target to the laser, z along the light, turned about y [deg]."""
    axes = frame_along(-TO_LASER, np.zeros(3)).axes
    angle = np.radians(turn)
    c, s = np.cos(angle), np.sin(angle)
    return Frame(distance * TO_LASER, axes @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))


def traced(frame: Frame, **values) -> str:
    return laser_xml(frame, **{"beam_radius": 0.3, "wavefront_radius": None, "traced": True} | values)


def hand(frame: Frame, **values) -> str:
    return laser_xml(frame, **values)


def lens(distance: float, turn=0.0, name="lens", **values) -> str:
    return shape("lens", name, on_way(distance, turn), **{"diameter": 8.0, "ior": N} | values).xml()


def mirror(place, normal, name="mirror", **values) -> str:
    frame = frame_along(np.asarray(normal, float) / np.linalg.norm(normal), np.asarray(place, float))
    return shape("mirror", name, frame, **{"diameter": 12.0} | values).xml()


def scene(*parts: str, target=None, **options) -> str:
    return scene_of(
        integrator_xml(**{"tolerance": TOLERANCE} | options), *parts, target_xml(WORLD, **(target or {})),
        detector_xml(detector_frame(direction(25), 60.0), 24, 20, 0.02),
    )  # fmt: skip


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Relative L2 difference of two fields, a constant phase aside."""
    turned = np.vdot(one, other)
    return float(np.linalg.norm(one * turned / abs(turned) - other) / np.linalg.norm(other))


# What needs no lens


FOLD = 30 * TO_LASER, direction(-10, 180) - TO_LASER  # light that comes from above goes on to the target
BEHIND_FOLD = Frame(FOLD[0] + 50 * direction(-10, 180), frame_along(-direction(-10, 180), np.zeros(3)).axes)


def test_without_anything_in_its_way_traced_light_is_the_beam_carried_from_the_laser(assemble):
    """Radii are those at the laser: 80 mm on they are what q = q_0 + 80 mm says."""
    beam = assemble(scene(traced(on_way(80.0), wavefront_radius=-120.0))).beam
    q = 1 / (1 / -120 + 1j * WAVELENGTH / (np.pi * 0.3**2)) + 80
    np.testing.assert_allclose(beam.radii, np.sqrt(WAVELENGTH / (np.pi * (1 / q).imag)), rtol=1e-12)
    np.testing.assert_allclose(beam.wavefront_radii, 1 / (1 / q).real, rtol=1e-12)


def test_light_over_a_mirror_is_that_of_the_image_of_the_laser_times_the_root_of_the_reflectance(assemble):
    folded = assemble(scene(traced(BEHIND_FOLD), mirror(*FOLD, reflectance=0.64)))
    assert folded.path.label == "laser - mirror - target"
    beam = folded.beam
    np.testing.assert_allclose(beam.axis, -TO_LASER, atol=1e-14)
    by_hand = hand(on_way(80.0), beam_radius=float(beam.radii[0]), wavefront_radius=float(beam.wavefront_radii[0]))
    expected = simulate_frame(assemble(scene(by_hand, mirror(*FOLD))))
    frame = simulate_frame(folded)
    assert apart(frame.image.field, 0.8 * expected.image.field) < SAME
    assert frame.plan[0] == "light over laser - mirror - target: as it leaves the laser"


def test_a_splitter_takes_its_share_of_the_light(assemble):
    splitter = shape("beam_splitter", "splitter", on_way(40.0, 30.0), width=12.0, height=12.0, reflectance=0.36).xml()
    parts = traced(on_way(80.0)), splitter
    alone = simulate_frame(assemble(scene(parts[0])))
    assert apart(simulate_frame(assemble(scene(*parts))).image.field, 0.8 * alone.image.field) < 1e-6


def test_a_tilted_plate_moves_the_light_aside_by_snells_law(assemble):
    plate = shape("beam_splitter", "plate", on_way(40.0, 45.0), width=20.0, height=20.0, thickness=3.0, ior=1.5).xml()
    beam = assemble(scene(traced(on_way(80.0)), plate)).beam
    aside = 3.0 * np.sin(np.pi / 4) * (1 - np.cos(np.pi / 4) / np.sqrt(1.5**2 - 0.5))
    offset = beam.origin - (beam.origin @ TO_LASER) * TO_LASER
    assert np.linalg.norm(offset) == pytest.approx(aside, rel=1e-12)
    np.testing.assert_allclose(beam.axis, -TO_LASER, atol=1e-14)


# Lenses


def carried(q: complex, *steps: float) -> complex:
    """q over lengths and, as pairs, thin lenses."""
    for step in steps:
        q = q + step if not isinstance(step, tuple) else 1 / (1 / q - 1 / step[0])
    return q


def test_light_through_a_thin_lens_of_long_focus_is_the_same_beam_written_by_hand(assemble):
    radius, thickness = 400.0, 0.05
    focus = 1 / ((N - 1) * (2 / radius - (N - 1) * thickness / (N * radius**2)))
    q = carried(-1j * np.pi * 0.3**2 / WAVELENGTH, 40.0, (focus,), 40.0)
    by_hand = {"beam_radius": np.sqrt(WAVELENGTH / (np.pi * (1 / q).imag)), "wavefront_radius": 1 / (1 / q).real}
    glass = lens(40.0, radius1=radius, radius2=-radius, thickness=thickness, diameter=4.0)
    through, written = (assemble(scene(one, glass)) for one in (traced(on_way(80.0)), hand(on_way(80.0), **by_hand)))
    np.testing.assert_allclose(through.beam.radii, by_hand["beam_radius"], rtol=1e-3)
    np.testing.assert_allclose(through.beam.wavefront_radii, by_hand["wavefront_radius"], rtol=1e-3)
    np.testing.assert_allclose(through.beam.axis, written.beam.axis, atol=1e-14)
    spot = np.random.default_rng(5).normal(size=(200, 3)) * [0.15, 0.15, 0.002]
    assert apart(through.beam.field(spot), written.beam.field(spot)) < 2e-3
    # With the very radii the scatterers are the same too, and nothing but the sum's own error is left.
    exact = {"beam_radius": float(through.beam.radii[0]), "wavefront_radius": float(through.beam.wavefront_radii[0])}
    same = assemble(scene(hand(on_way(80.0), **exact), glass))
    assert apart(simulate_frame(through).image.field, simulate_frame(same).image.field) < TOLERANCE
    one, other = (expected_sensitivity(assembly) for assembly in (through, same))
    for axis in ("u", "v"):
        np.testing.assert_allclose(one[axis], other[axis], rtol=1e-6, atol=1e-9)


def test_both_axes_of_an_elliptical_beam_are_carried_through_a_cylinder_lens_by_themselves(assemble):
    glass = lens(40.0, radius1=60.0, form1="cylinder_x", thickness=0.05, diameter=3.0)
    beam = assemble(scene(traced(on_way(80.0), beam_radius=None, beam_radius_x=0.1, beam_radius_y=0.4), glass)).beam
    for axis, (w, steps) in enumerate(((0.1, (40.0, (60 / (N - 1),), 40.0)), (0.4, (80.0,)))):
        q = 1 / carried(-1j * np.pi * w**2 / WAVELENGTH, *steps)
        found = int(np.argmax(np.abs(beam.across @ on_way(0.0).axes[:, axis])))
        assert beam.radii[found] == pytest.approx(np.sqrt(WAVELENGTH / (np.pi * q.imag)), rel=1e-3)
        assert beam.wavefront_radii[found] == pytest.approx(1 / q.real, rel=1e-3)


ABERRATED = {"radius2": -16.0, "thickness": 2.0}
"""A plano-convex lens with its plane to parallel light, as nobody should have it: f = 31 mm."""

FAST = {"beam_radius": 0.9}


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    """Places around the focus, (n, 3) [mm]."""
    rng = np.random.default_rng(7)
    return rng.normal(size=(8, 3)) * [0.006, 0.006, 0.02]


def huygens(sources, values, areas, normal, surfaces, points) -> np.ndarray:
    """The Rayleigh-Sommerfeld sum (m,) over a plane, paths over the surfaces by Fermat's principle."""
    k, step, field = 2 * np.pi / WAVELENGTH, 1e-5, []
    start = np.zeros((2 * len(surfaces), len(sources)))
    for number in range(len(surfaces)):
        local = (sources - surfaces[number].vertex) @ surfaces[number].axes
        start[2 * number : 2 * number + 2] = 0.9 * local[:, :2].T
    for point in points:
        goal = np.broadcast_to(point, sources.shape)
        length, amplitude = fermat(sources, surfaces, goal, start)
        cosine = -np.diff([fermat(sources + d * normal, surfaces, goal, start)[0] for d in (-step, step)], axis=0)[0]
        phasor = np.exp(1j * k * length)
        field.append(np.sum(values * areas * amplitude * phasor * cosine / (2 * step)) / (1j * WAVELENGTH))
    return np.array(field)


def test_light_of_an_aberrated_focus_is_the_huygens_sum_over_the_cross_section(assemble, tmp_path, places):
    write_points(tmp_path / "points.csv", places)
    target = {"points": str(tmp_path / "points.csv"), "point_sources": None, "roughness": None}
    assembly = assemble(scene(traced(on_way(60.0), **FAST), lens(33.08, **ABERRATED), target=target))
    simulation = Simulation(assembly)
    (lit,) = simulation.lit()
    frame = on_way(33.08)
    surfaces = lens_surfaces(frame.origin, frame.axes, 0.0, -16.0, 2.0, N)
    x, weight = roots_legendre(44)
    half = 3.6 * 0.9
    a, b = (part.ravel() for part in np.meshgrid(half * x, half * x))
    own = assembly.path.own
    sources = frame.origin - 1.0 * frame.axes[:, 2] + np.stack([a, b], axis=1) @ own.across
    areas = np.outer(half * weight, half * weight).ravel()
    expected = huygens(sources, own.field(sources), areas, own.axis, surfaces, places)
    expected = expected * np.sqrt(np.prod(assembly.beam.radii) / np.prod(own.radii))
    assert apart(lit.amplitude, expected) < 3 * TOLERANCE
    assert apart(assembly.beam.field(places), expected) > 0.03  # the Gaussian beam is not all of it
    frame = simulation.frame()
    assert frame.plan[0].startswith("light over laser - lens - lens - target: summed from")


def test_light_past_an_edge_is_the_diffraction_integral_over_the_opening(assemble, tmp_path):
    rng = np.random.default_rng(8)
    points = rng.uniform(-0.3, 0.3, size=(30, 3)) * [1, 1, 0.05]
    write_points(tmp_path / "points.csv", points)
    target = {"points": str(tmp_path / "points.csv"), "point_sources": None, "roughness": None}
    stop = shape("aperture", "stop", on_way(40.0), radius=0.25).xml()
    assembly = assemble(scene(traced(on_way(80.0)), stop, target=target))
    (lit,) = Simulation(assembly).lit()
    own = assembly.path.own
    t, weight = roots_legendre(120)
    r, angle = 0.125 * (1 + t), 2 * np.pi * np.arange(400) / 400
    ring = np.stack([np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel()], axis=1)
    nodes = 40 * TO_LASER + ring @ own.across
    areas = np.repeat(0.125 * weight * r * 2 * np.pi / 400, 400)
    offset = points[:, None] - nodes
    distance = np.linalg.norm(offset, axis=2)
    k = 2 * np.pi / WAVELENGTH
    spread = (1 + 1j / (k * distance)) * (offset @ own.axis) / (1j * WAVELENGTH * distance**2)
    expected = np.sum(own.field(nodes) * areas * spread * np.exp(1j * k * distance), axis=1)
    expected = expected * np.sqrt(np.prod(assembly.beam.radii) / np.prod(own.radii))
    assert apart(lit.amplitude, expected) < 3 * TOLERANCE


def test_an_edge_takes_its_part_of_the_power(assemble):
    """A stop of the beam's own radius lets 1 - 1/e^2 of it through; the speckle is dimmer by that."""
    stop = shape("aperture", "stop", on_way(40.0), radius=0.3).xml()
    target = {"point_sources": 3000}
    cut = Simulation(assemble(scene(traced(on_way(80.0)), stop, target=target, tolerance=1e-2)))
    (lit,) = cut.lit()
    surface = cut.assembly.target.surface
    power = np.sum(np.abs(lit.amplitude) ** 2) / surface.density * abs(TO_LASER[2])
    whole = np.pi * np.prod(cut.assembly.beam.radii) / 2
    assert power / whole == pytest.approx(1 - np.exp(-2), rel=0.02)


# Motion


def test_derivatives_by_the_targets_motions_hold_the_slopes_of_the_lights_phase_and_amplitude(assemble, tmp_path):
    """Against differences of fields rendered at moved poses, in the rings behind an edge."""
    points = np.random.default_rng(9).normal(size=(12, 3)) * [0.05, 0.05, 0.003]
    write_points(tmp_path / "points.csv", points)
    target = {"points": str(tmp_path / "points.csv"), "point_sources": None, "roughness": None}
    stop = shape("aperture", "stop", on_way(40.0), radius=0.15).xml()
    simulation = Simulation(assemble(scene(traced(on_way(80.0)), stop, target=target, tolerance=1e-7)))
    pixels = np.arange(0, 480, 7)
    found = simulation.derivatives(pixels).by_motion
    for number, (dof, step) in enumerate({"x": 2e-6, "y": 2e-6, "z": 2e-6, "rx": 2e-3, "ry": 2e-3, "rz": 2e-3}.items()):
        ahead, behind = (simulation.frame(Pose(**{dof: sign * step})).image.field.ravel()[pixels] for sign in (1, -1))
        difference = (ahead - behind) / (2 * (step if number < 3 else np.radians(step)))
        assert np.linalg.norm(found[number] - difference) < 1e-3 * np.linalg.norm(difference), dof


def test_a_target_that_is_moved_along_the_beam_is_lit_by_what_is_there(assemble):
    glass = lens(40.0, radius1=60.0, radius2=-60.0, thickness=2.0)
    simulation = Simulation(assemble(scene(traced(on_way(80.0)), glass, target={"point_sources": 2000}, tolerance=1e-2)))
    beam = simulation.assembly.beam
    for z in (-1.5, 1.5):
        (lit,) = simulation.lit(Pose(z=z))
        local = (lit.position - beam.reference) @ beam.axes
        power = np.abs(lit.amplitude) ** 2
        middle = np.average(local[:, :2], axis=0, weights=power)
        spread = 2 * np.sqrt(np.average((local[:, 1] - middle[1]) ** 2, weights=power))
        width = beam.radii_at(simulation._setup(simulation.assembly, Pose(z=z), None).spot.point)[1]
        assert spread == pytest.approx(width, rel=0.1)


# What is refused


@pytest.mark.parametrize(
    "parts, message",
    [
        ([shape("rectangle", "wall", on_way(40.0), ['<bsdf type="diffuse"/>'], size=(5, 5, 1)).xml()],
         "its light comes to the target by no way, its axis ends at 'wall'"),
        ([mirror(30 * TO_LASER, (0, 0, 1.0))], "its axis ends at nothing, past all that stands there"),
        ([shape("aperture", "stop", Frame(on_way(40.0).origin + [0, 2.0, 0], on_way(40.0).axes), radius=0.5).xml()],
         "its axis ends at 'stop'"),
        ([shape("rectangle", "edge", Frame(on_way(40.0).origin + [0, 5.1, 0], on_way(40.0).axes),
                ['<bsdf type="diffuse"/>'], size=(5, 5, 1)).xml()], "'edge' cuts its light beside the way"),
    ],
)  # fmt: skip
def test_light_that_does_not_come_to_the_target_is_refused_by_what_blocks_it(assemble, parts, message):
    with pytest.raises(SceneError, match=message):
        assemble(scene(traced(on_way(80.0)), *parts))


def test_light_by_two_ways_is_refused(assemble):
    splitter = shape("beam_splitter", "splitter", on_way(40.0, 45.0), width=12.0, height=12.0).xml()
    side = on_way(40.0).axes @ [1.0, 0.0, 0.0]
    place = 40 * TO_LASER - 20 * side
    back = -place / np.linalg.norm(place) + side
    two = traced(on_way(80.0)), splitter, mirror(place, back)
    label = "by laser - splitter - target and by laser - splitter - mirror - target"
    with pytest.raises(SceneError, match=label):
        assemble(scene(*two))


def test_traced_light_without_a_width_is_refused(load):
    with pytest.raises(RuntimeError, match="is traced, but has no 'beam_radius'"):
        load(scene(traced(on_way(80.0), beam_radius=None)))


def test_of_several_lasers_each_is_traced_by_itself(assemble):
    """And of a lens's glass each wavelength sees its own index."""
    glass = lens(40.0, radius1=60.0, radius2=-60.0, thickness=2.0, ior=None, glass="N-SF11")
    both = traced(on_way(80.0), id="red"), traced(on_way(80.0), id="blue", wavelength=450.0)
    assembly = assemble(scene(*both, hand(frame_along([0, 0, -1.0], [0, 0, 50.0]), id="plain"), glass))
    red, blue, plain = assembly.parts
    assert red.path.names == blue.path.names == ("lens", "lens") and plain.path is None
    assert blue.beam.wavefront_radii[0] != pytest.approx(red.beam.wavefront_radii[0], rel=1e-2)
    alone = assemble(scene(both[1], glass))
    np.testing.assert_array_equal(alone.beam.radii, blue.beam.radii)
    assert replace(assembly, path=None) != assembly


def test_the_coaxial_sensor_moves_its_pattern_as_its_wavefront_and_distance_say(shipped):
    """By 1 + L_O/L_S across, by 2 L_O for a tilt, L_O shorter by the plate; and one frame a surface agrees."""
    assembly = shipped("coaxial", width=64, height=64, pixel_pitch=0.04, point_sources=150)
    assert assembly.path.label == "laser - collimator - collimator - splitter - target"
    (wavefront,) = set(np.round(assembly.beam.wavefront_radii, 6))
    theory = expected_sensitivity(assembly)
    # A plate of thickness t at 45 degrees: across the plane of incidence the light comes from nearer by t (1 - c/s).
    n = assembly.elements[[one.name for one in assembly.elements].index("splitter")].index
    s = np.sqrt(n**2 - 0.5)
    nearer = 1.0 * (np.sqrt(0.5) - 0.5 / s)
    distance = 70.0 - nearer
    assert abs(theory["v"][1]) == pytest.approx(1 + distance / wavefront, rel=2e-3)
    assert abs(theory["v"][3]) == pytest.approx(2 * distance * np.pi / 180, rel=2e-3)
    found = one_frame_sensitivity(assembly, surfaces=4)
    for dof, axis in (("x", "u"), ("y", "v"), ("rx", "v"), ("ry", "u")):
        fit = found.fits[dof][axis]
        room = max(0.01 * abs(fit.theory), STANDARD_ERRORS * found.scatter[dof][axis] / np.sqrt(4))
        assert fit.value == pytest.approx(fit.theory, abs=room), dof
