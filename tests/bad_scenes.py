"""A scene with every plugin in it, ways to spoil it, and the line with which it is then refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scene_builder import (
    detector_frame,
    detector_xml,
    direction,
    frame_along,
    integrator_xml,
    laser_xml,
    scene_of,
    target_xml,
)

from speckle_mi.scene.read import assembly_from_scene
from speckle_mi.scene.errors import one_line
from speckle_mi.scene import write

LONGEST_LINE = 400

ABOVE = frame_along(-direction(0), 50 * direction(0), np.array([1.0, 0, 0]))
CAMERA = detector_frame(direction(0), 60.0)


def on_axis(z):
    return write.to_world(write.on_axis(z))


LENS = {"radius1": 50.0, "radius2": -50.0, "conic1": 0.0, "conic2": 0.0, "thickness": 5.0, "diameter": 20.0, "ior": 1.5}
PARTS = {
    "integrator": integrator_xml(),
    "laser": laser_xml(ABOVE),
    "target": target_xml(),
    "detector": detector_xml(CAMERA, width=16, height=8),
    "lens": write.shape("lens", "lens", write.on_axis(25.0), **LENS).xml(),
    "aperture": write.shape("aperture", "aperture", write.on_axis(40.0), radius=0.5, outer_radius=9.0).xml(),
}


def scene_with(**changes):
    """The scene with parts replaced, left out (empty) or added."""
    return scene_of(*(PARTS | changes).values())


def with_parameter(part, kind, name, value):
    """The scene with one parameter of a part set; an earlier one of that name is replaced."""
    text = re.sub(rf'<\w+ name="{name}" value="[^"]*"/>', "", PARTS[part])
    head, end, tail = text.rpartition("</")
    return scene_with(**{part: f'{head}<{kind} name="{name}" value="{value}"/>{end}{tail}'})


def is_clear(line, *words):
    assert "\n" not in line and "Traceback" not in line and len(line) < LONGEST_LINE, line
    for word in words:
        assert word in line, line


def refusal(mitsuba, text):
    """The line with which a scene is refused before anything is computed."""
    with pytest.raises((RuntimeError, ValueError)) as caught:
        assembly_from_scene(mitsuba.load_string(text))
    return one_line(caught.value)
