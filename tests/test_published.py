"""The paper's figures stand beside the paper's set-ups, and beside no other scene."""

from __future__ import annotations

import pytest
from conftest import SCENES

from speckle_mi.experiments.published import PUBLISHED, published_assembly
from speckle_mi.scene.write import frame_along, material, on_axis, shape

SHIPPED = {
    "tilted_laser": "tilted laser",
    "tilted_detector": "tilted detector",
    "both_tilted": "both tilted",
    "integrated_sensor": "integrated sensor",
}

UNSTATED = {"beam_radius": 0.2, "roughness": 3, "point_sources": 400, "seed": 7, "method": "direct", "tolerance": 1e-3}
"""Changes that leave a set-up the paper's."""

OTHERS = {
    "laser_angle": 36,
    "laser_distance": 55,
    "wavefront_radius": -700,
    "wavelength": 532,
    "detector_distance": 61,
    "pixel_pitch": 0.005,
    "width": 640,
}
"""Changes that make it another."""

LENS = shape("lens", "lens", on_axis(30.0), radius1=50.0, radius2=-50.0, thickness=5.0, diameter=20.0, ior=1.5151).xml()
WALL = shape("disk", "wall", frame_along([0, 0, 1.0], [90.0, 0, 5.0]), [material("diffuse")]).xml()


def with_part(name: str, part: str) -> str:
    """A shipped scene with one part more."""
    return (SCENES / f"{name}.xml").read_text(encoding="utf-8").replace("</scene>", f"{part}</scene>")


def test_every_set_up_of_the_paper_is_shipped():
    assert {published.name for published in PUBLISHED} == set(SHIPPED.values())


@pytest.mark.parametrize("scene", SHIPPED)
def test_the_papers_scenes_are_recognised(shipped, scene):
    assert published_assembly(shipped(scene)).name == SHIPPED[scene]
    assert published_assembly(shipped(scene, **UNSTATED)).name == SHIPPED[scene]


@pytest.mark.parametrize("scene", ["tilted_laser", "integrated_sensor"])
@pytest.mark.parametrize("name", OTHERS)
def test_a_scene_that_differs_in_what_the_paper_states_is_not_the_papers(shipped, scene, name):
    assert published_assembly(shipped(scene, **{name: OTHERS[name]})) is None


@pytest.mark.parametrize("scene", ["tilted_laser", "integrated_sensor"])
@pytest.mark.parametrize("part", [LENS, WALL], ids=["lens", "wall"])
def test_a_scene_with_a_further_element_is_not_the_papers(assemble, scene, part):
    assert published_assembly(assemble(with_part(scene, part))) is None


def test_the_integrated_sensor_is_recognised_by_its_aperture(shipped):
    assert published_assembly(shipped("integrated_sensor", aperture_radius=0.6)) is None
    assert published_assembly(shipped("integrated_sensor", aperture_distance=40)) is None


def test_the_papers_laser_and_detector_stand_on_opposite_sides(shipped):
    assert published_assembly(shipped("both_tilted", laser_angle=-17.5, detector_angle=-17.5)) is not None
    assert published_assembly(shipped("both_tilted", laser_angle=-17.5)) is None
