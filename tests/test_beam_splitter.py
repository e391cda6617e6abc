"""Shape ``beam_splitter`` on the way to the detector: what it reflects, what it lets through, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from scene_builder import WORLD, detector_frame, detector_xml, direction, frame_along, integrator_xml, laser_xml
from scene_builder import scene_of, target_xml

import speckle_mi  # noqa: F401  (finds LLVM and registers the plugins)
from speckle_mi.experiments.layout import layout_of
from speckle_mi.experiments.expectation import expected_sensitivity
from speckle_mi.field.simulation import simulate_frame
from speckle_mi.geometry.frames import Frame
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.write import shape

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_mono")

SAME = 1e-12  # relative L2: the same sums in the same order
TOLERANCE = 1e-6  # of the scenes, relative L2
PLACE = np.array([0.0, 0.0, 30.0])
R = 0.3


def facing(normal, place=PLACE) -> Frame:
    """A frame at ``place`` with its z along ``normal``."""
    return frame_along(np.asarray(normal, float) / np.linalg.norm(normal), np.asarray(place, float))


def splitter(normal=(1.0, 0.0, -1.0), name="splitter", place=PLACE, **values) -> str:
    size = {} if "diameter" in values else {"width": 30.0, "height": 24.0}
    return shape("beam_splitter", name, facing(normal, place), **({"reflectance": R} | size | values)).xml()


def mirror(normal=(1.0, 0.0, -1.0), place=PLACE, name="mirror", diameter=30.0) -> str:
    return shape("mirror", name, facing(normal, place), diameter=diameter).xml()


STRAIGHT = detector_frame(direction(0), 60.0)
ASIDE = Frame(PLACE + [40.0, 0.0, 0.0], np.stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], axis=1))
"""A detector beside the splitter that looks along -x; light that comes up is turned to it by a normal (1, 0, -1)."""


def wall_at(x: float, z: float) -> str:
    """What keeps light from going straight to a detector beside the splitter."""
    inside = ['<bsdf type="diffuse"/>']
    return shape("rectangle", "wall", facing((1.0, 0.0, 0.0), (x, 0.0, z)), inside, size=(8, 8, 1)).xml()


BAFFLE = wall_at(14.0, 8.0)


def scene(*parts: str, detector: Frame = STRAIGHT, target=None, **options) -> str:
    place = frame_along(-direction(35, 180), 50 * direction(35, 180))
    return scene_of(
        integrator_xml(tolerance=TOLERANCE, **options), laser_xml(place),
        target_xml(WORLD, **(target or {})), detector_xml(detector, 24, 20, 0.02), *parts,
    )  # fmt: skip


def field(assemble, *parts: str, **what) -> np.ndarray:
    return simulate_frame(assemble(scene(*parts, **what))).image.field


def apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def test_what_a_coating_without_a_plate_lets_through_is_the_field_without_it_times_the_root_of_its_share(assemble):
    assert apart(field(assemble, splitter()), np.sqrt(1 - R) * field(assemble)) < SAME


@pytest.mark.parametrize("normal", [(1.0, 0.0, -1.0), (-1.0, 0.0, 1.0)])
def test_what_it_reflects_is_the_field_over_a_mirror_times_the_root_of_the_reflectance(assemble, normal):
    over = field(assemble, mirror(), BAFFLE, detector=ASIDE)
    assert apart(field(assemble, splitter(normal), BAFFLE, detector=ASIDE), np.sqrt(R) * over) < SAME


def test_a_reflectance_of_nothing_or_all_leaves_one_way_of_the_light(assemble):
    assert apart(field(assemble, splitter(reflectance=0.0)), field(assemble)) < SAME
    over = field(assemble, mirror(), BAFFLE, detector=ASIDE)
    assert apart(field(assemble, splitter(reflectance=1.0), BAFFLE, detector=ASIDE), over) < SAME


def test_light_through_a_tilted_plate_is_that_through_a_window_of_the_glass(assemble):
    normal = (1.0, 0.0, -1.5)
    plate = field(assemble, splitter(normal, diameter=30.0, thickness=3.0, glass="N-BK7"))
    window = shape("lens", "window", facing(normal), diameter=30.0, thickness=3.0, glass="N-BK7").xml()
    assert apart(plate, np.sqrt(1 - R) * field(assemble, window)) < SAME


def test_light_that_comes_through_the_back_of_a_plate_is_reflected_inside_it(assemble):
    """As by a mirror that touches a window."""
    normal = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2)  # the plate lies below the coating, towards the target
    plate = field(assemble, splitter(-normal, thickness=2.0, ior=1.5), BAFFLE, detector=ASIDE)
    window = shape("lens", "window", facing(-normal), diameter=30.0, thickness=2.0, ior=1.5).xml()
    folded = field(assemble, window, mirror(normal), BAFFLE, detector=ASIDE)
    assert apart(plate, np.sqrt(R) * folded) < TOLERANCE


def test_light_on_the_coated_front_of_a_plate_does_not_enter_it(assemble):
    over = field(assemble, mirror(), BAFFLE, detector=ASIDE)
    front = field(assemble, splitter((-1.0, 0.0, 1.0), thickness=2.0, ior=1.5), BAFFLE, detector=ASIDE)
    assert apart(front, np.sqrt(R) * over) < SAME


def test_both_arms_of_an_interferometer_add_up_as_spherical_waves_from_their_images(assemble, tmp_path):
    """Through to a mirror and back over the coating, and over it to a second mirror and back through."""
    np.savetxt(tmp_path / "points.csv", [[0.02, -0.01, 0.0]], delimiter=",")
    arms = (
        mirror((0.0, 0.0, -1.0), [0.0, 0.0, 50.0], "far", 8.0),
        mirror((-1.0, 0.0, 0.0), [25.0, 0.0, 30.0], "aside", 8.0),
    )
    aside = Frame(PLACE - [20.0, 0.0, 0.0], np.stack([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], axis=1))
    wall = wall_at(-14.0, 14.0)
    target = {"points": str(tmp_path / "points.csv")}
    assembly = assemble(scene(splitter(), *arms, wall, detector=aside, target=target, diffraction=False))
    frame = simulate_frame(assembly)
    point, amplitude = frame.scatterers.position[0], frame.scatterers.amplitude[0]

    def over(place, normal, at):
        normal = np.asarray(normal, float) / np.linalg.norm(normal)
        return at - 2 * ((at - place) @ normal) * normal

    tilt = (1.0, 0.0, -1.0)
    images = (
        over(PLACE, tilt, over(np.array([0.0, 0.0, 50.0]), (0, 0, 1), point)),
        over(np.array([25.0, 0.0, 30.0]), (1, 0, 0), over(PLACE, tilt, point)),
    )
    k = 2 * np.pi / assembly.beam.wavelength
    distances = [np.linalg.norm(assembly.detector.points() - image, axis=1) for image in images]
    expected = amplitude * np.sqrt(R * (1 - R)) * sum(np.exp(1j * k * r) / r for r in distances)
    assert apart(frame.image.field.ravel(), expected) < 10 * TOLERANCE
    incoherent = sum(1 / r**2 for r in distances) * abs(amplitude) ** 2 * R * (1 - R)
    assert np.ptp(frame.image.intensity.ravel() / incoherent) > 0.3  # fringes


def test_first_order_theory_behind_a_splitter_is_that_of_the_mirror_in_its_place(assemble):
    split, fold = (assemble(scene(part, BAFFLE, detector=ASIDE)) for part in (splitter(), mirror()))
    one, other = expected_sensitivity(split), expected_sensitivity(fold)
    for axis in ("u", "v"):
        np.testing.assert_allclose(one[axis], other[axis], rtol=1e-9, atol=1e-9)


PLATE = {"thickness": 3.0, "ior": 1.5}


@pytest.mark.parametrize("values", [{}, PLATE, {"diameter": 20.0} | PLATE])
def test_it_is_drawn_where_it_stands(assemble, values):
    layout = layout_of({"detector": assemble(scene(splitter(**values)))})
    (part,) = [part for part in layout.parts if part.name == "splitter"]
    points = np.concatenate([line.points for line in part.lines[0]])
    assert np.linalg.norm(points.mean(axis=0) - PLACE) < 4.0


def test_light_that_meets_the_edge_of_a_plate_ends_there(assemble):
    standing = facing((1.0, 0.0, 0.0), (-10.0, 0.0, 30.0))
    plate = shape("beam_splitter", "plate", standing, width=20.0, height=20.0, thickness=20.0, ior=1.5).xml()
    frame = simulate_frame(assemble(scene(plate)))
    assert not np.any(frame.image.field) and any("'plate'" in line for line in frame.warnings)


@pytest.mark.parametrize(
    "values, message",
    [
        ({"width": 10.0}, "'height' is missing"),
        ({"diameter": 10.0, "width": 10.0}, "has 'diameter' and 'width', must have one or the other"),
        ({"diameter": 10.0, "reflectance": 1.2}, "'reflectance' is 1.2, must be at least 0 and at most 1"),
        ({"diameter": 10.0, "ior": 1.5}, "has 'ior', but no plate: its 'thickness' is 0"),
        ({"diameter": 10.0, "thickness": 1.0}, "'ior' is missing"),
        ({"diameter": 10.0, "glass": "N-BK7"} | PLATE, "has 'ior' and 'glass', must have one of them"),
        ({"diameter": 10.0, "thickness": 1.0, "glass": "N-BK77"}, "N-BK7"),
        ({"diameter": 10.0, "thickness": 1e-9, "ior": 1.5}, "'thickness' is 1e-09 mm, must be at least 1e-06 mm"),
        ({"diameter": 10.0, "thickness": -1.0, "ior": 1.5}, "'thickness' is -1 mm, must be at least 0 mm"),
        ({"diameter": 10.0, "bsdf": {"type": "conductor"}}, "has a BSDF, must have none"),
    ],
)
def test_impossible_splitters_are_refused(values, message):
    with pytest.raises(RuntimeError, match=message):
        mi.load_dict({"type": "beam_splitter"} | values)


def test_it_follows_when_it_is_moved_and_changed():
    part = mi.load_dict({"type": "beam_splitter", "diameter": 10.0})
    parameters = mi.traverse(part)
    parameters["reflectance"] = 0.2
    parameters["to_world"] = mi.Transform4f().translate([0, 0, 7.0])
    parameters.update()
    element = part.element()
    assert element.reflectance(0) == pytest.approx(0.2) and element.faces[0].frame.origin[2] == pytest.approx(7.0)
    parameters["thickness"] = 2.0
    with pytest.raises(SceneError, match="'thickness' is 2 mm, must be 0"):
        parameters.update()
