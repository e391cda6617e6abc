"""One frame of many surfaces against first-order theory: curved targets, tilted cameras, small spots."""

from __future__ import annotations

import pytest
from exact_optics import element_xml
from scene_builder import (
    detector_xml,
    direction,
    frame_along,
    free_space,
    integrator_xml,
    laser_xml,
    scene_of,
    target_xml,
)
from test_one_frame import require_theory
from test_surface_mesh import shaft, write_mesh

from speckle_mi.experiments.expectation import expected_sensitivity


@pytest.fixture(scope="module")
def simulate(mitsuba):
    from speckle_mi.field.simulation import Simulation

    return Simulation


def test_one_frame_of_a_shaft_agrees_with_theory(assemble, simulate, tmp_path):
    path = write_mesh(tmp_path / "shaft.obj", shaft(8.0, 4.0, 720))
    text = free_space(
        direction(25, 180), direction(0), laser={"beam_radius": 0.15, "wavefront_radius": -200.0},
        target={"filename": str(path), "point_sources": 400},
        detector={"width": 360, "height": 360, "pixel_pitch": 0.008},
    )  # fmt: skip
    require_theory(simulate(assemble(text)), seeds=12)


def test_one_frame_of_a_scheimpflug_camera_agrees_with_theory(assemble, simulate):
    """A lens at 30 degrees to the surface's normal images it 1:1 on a detector that is tilted the other way."""
    sight = direction(30, 0)
    text = scene_of(
        integrator_xml(),
        laser_xml(frame_along(-direction(20, 180), 50 * direction(20, 180)), beam_radius=0.1),
        target_xml(width=4.0, height=4.0, point_sources=400),
        element_xml("lens", "lens", frame_along(sight, 97.0685 * sight), radius1=50.0, radius2=-50.0, thickness=5.0,
                    diameter=20.0, ior=1.5151),
        element_xml("aperture", "stop", frame_along(sight, 103 * sight), radius=1.5, outer_radius=15.0),
        detector_xml(frame_along(-direction(60, 0), 198.8947 * sight), width=60, height=60, pixel_pitch=0.008),
    )  # fmt: skip
    require_theory(simulate(assemble(text)), seeds=3)


SMALL_SPOT = {"beam_radius": 0.05, "width": 100, "height": 100, "point_sources": 600}


def test_diffraction_makes_tilts_of_a_small_spot_out_of_focus_a_quarter_less_than_rays_do(shipped, simulate):
    """The spot is 2.6 times as wide as what the camera resolves: one frame finds it as well."""
    small = shipped("imaging_defocused", **SMALL_SPOT)
    require_theory(simulate(small), seeds=4)
    wide = expected_sensitivity(shipped("imaging_defocused", beam_radius=1.6))["u"][4]
    assert 0.72 < expected_sensitivity(small)["u"][4] / wide < 0.80


def test_what_diffraction_adds_falls_as_one_over_the_spot_s_radius(shipped):
    """To the 1/w^2 that the spot's own fading adds."""
    tilts = [expected_sensitivity(shipped("imaging_defocused", beam_radius=w))["u"][4] for w in (0.1, 0.2, 0.4)]
    assert (tilts[0] - tilts[1]) / (tilts[1] - tilts[2]) == pytest.approx(2.0, rel=0.15)
