"""A detector of one pixel far smaller than a speckle sees what any other sees: also beside mirrors, lenses, screens."""

from __future__ import annotations

import numpy as np
import pytest
from exact_optics import bench, element_xml, rendered, tilted
from scene_builder import detector_frame, direction

from speckle_mi.geometry.frames import Frame

K = 2 * np.pi / 632.8e-6
SOURCES = np.array([[0.02, 0.01, 0.0], [-0.05, 0.03, 0.0], [0.01, -0.06, 0.0]])
TOLERANCE = 1e-4

EDGE = 5e-3
"""Wave of an edge 3.5 mm beside the light, relative to it: 1/(pi v sqrt(2)) = 4.4e-3 for v = 51."""


def placed(kind, x, y, z, tilt, **values):
    return element_xml(kind, kind, Frame(np.array([x, y, z], float), tilted(*tilt)), **values)


BESIDE = {
    "mirror": (placed("mirror", 8, 0, 40, (0, -60, 0), diameter=6.0), TOLERANCE),
    "mirror behind": (placed("mirror", -9, 3, 25, (0, 100, 0), diameter=5.0), TOLERANCE),
    "lens": (placed("lens", 12, 0, 30, (0, 0, 0), radius1=50.0, radius2=-50.0, thickness=3.0, diameter=12.0, ior=1.5),
             TOLERANCE),
    "tilted lens": (placed("lens", 0, -9, 45, (20, 0, 0), radius1=30.0, radius2=-30.0, thickness=3.0, diameter=9.0,
                           ior=1.5), TOLERANCE),
    "screen": (placed("aperture", 14, 0, 30, (0, 0, 0), radius=3.0, outer_radius=10.0), EDGE),
}  # fmt: skip


@pytest.mark.parametrize("beside", BESIDE)
@pytest.mark.parametrize("pixels, pitch", [(1, 0.5e-3), (1, 0.05e-3), (2, 0.5e-3)])
def test_direct_light_beside_an_element_is_that_of_free_space(assemble, tmp_path, beside, pixels, pitch):
    element, allowed = BESIDE[beside]
    detector = Frame(np.array([1.0, 0.0, 60.0]), detector_frame(direction(0), 60.0).axes)
    text = bench(tmp_path, SOURCES, detector, [element], pixels=(pixels, pixels), pitch=pitch, tolerance=TOLERANCE)
    assembly, frame, field = rendered(assemble, text)
    path = np.linalg.norm(assembly.detector.points()[:, None] - frame.scatterers.position, axis=2)
    exact = (np.exp(1j * K * path) / path) @ frame.scatterers.amplitude
    assert np.linalg.norm(field - exact) <= allowed * np.linalg.norm(exact)
