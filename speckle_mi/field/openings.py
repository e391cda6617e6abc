"""An opening of a way: the nodes that its integral is summed over, and what passes a window by."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..geometry.plane import PlanePoints
from ..plan.way import Channel, Rim
from ..propagation.opening_quadrature import opening_nodes
from ..scene.errors import SceneError

_RING = 0.1
"""Outer part of a window's radius on which is looked how strong the light is that passes it by."""


def nodes_on(channel: Channel, number: int, quadrature: float) -> tuple[PlanePoints, np.ndarray]:
    """Nodes on an opening of the channel and their weights (q,) [mm^2], see ``opening_nodes``; SceneError if too many.

    quadrature: error of an integral over the opening.
    """
    rim, gradient = channel.openings[number], channel.gradients[number]
    try:
        return opening_nodes(rim.plane.outline, rim.plane.frame, gradient.bound, quadrature, gradient.tilt)
    except InputError as error:
        raise SceneError(
            f"opening {rim.name!r}: {error}; "
            "put a smaller stop, or set diffraction to false where there is no focus"
        ) from None


def beside_window(rim: Rim, nodes: PlanePoints, values: np.ndarray, areas: np.ndarray) -> float:
    """Amplitude of the light that passes a window by, relative to that within it.

    From the values (n,) at the nodes beside the window's edge: light that an edge has thrown there falls off in
    amplitude as r^(-3/2) at most, as far as the rim that the window is a part of.
    """
    distance, radius = np.hypot(nodes.a, nodes.b), rim.plane.outline.radius
    power, ring = np.abs(values) ** 2, distance > (1 - _RING) * radius
    at_edge = float(np.average(power[ring], weights=areas[ring]))
    beyond = 2 * np.pi * radius**2 * at_edge * max(1 - radius / rim.whole, 0.0)
    return float(np.sqrt(beyond / max(float(power @ areas), 1e-300)))
