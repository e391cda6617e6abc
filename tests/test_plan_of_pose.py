"""A plan is for a pose: a frame at a displaced pose is that of a scene whose target stands there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from speckle_mi.field.simulation import simulate_frame
from speckle_mi.geometry.pose import Pose
from speckle_mi.plan.cost import LONG, Cost, require_affordable

SMALL = dict(width=24, height=16, pixel_pitch=0.06, point_sources=30)


def standing_at(assembly, pose: Pose):
    """The assembly with its target at rest where the pose takes it."""
    frame = assembly.target.frame.moved(pose)
    return replace(assembly, target=replace(assembly.target, frame=frame))


@pytest.mark.parametrize("pose", [Pose(z=-8.0), Pose(z=-3.0, ry=2.0), Pose(x=0.5, z=4.0)], ids=str)
def test_a_displaced_target_has_the_plan_and_the_bits_of_one_that_stands_there(shipped, pose):
    assembly = shipped("integrated_sensor", **SMALL)
    moved, there = simulate_frame(assembly, pose), simulate_frame(standing_at(assembly, pose))
    assert [stage.kind for stage in moved.stages] == [stage.kind for stage in there.stages]
    assert np.array_equal(moved.image.field, there.image.field)


def test_long_frames_are_begun_only_when_that_is_asked_for():
    require_affordable(Cost(seconds=LONG / 2, memory=1e6), force=False)
    require_affordable(Cost(seconds=2 * LONG, memory=1e6), force=True)
    with pytest.raises(ValueError, match="--force") as caught:
        require_affordable(Cost(seconds=2 * LONG, memory=1e6), force=False)
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="GB"):
        require_affordable(Cost(seconds=1.0, memory=1e15), force=True)
