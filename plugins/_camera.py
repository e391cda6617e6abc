"""The camera of a detector: its parameters read, checked and put together with what is not given."""

from __future__ import annotations

import mitsuba as mi

from speckle_mi.errors import InputError
from speckle_mi.images.camera import Camera
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe, read_integer, read_number

_NUMBERS = {
    "mean_electrons": {"above": 0.0, "at_most": 1e9, "unit": "e-"},
    "exposure": {"above": 0.0, "at_most": 1e6, "unit": "s"},
    "quantum_efficiency": {"above": 0.0, "at_most": 1.0},
    "read_noise": {"at_least": 0.0, "at_most": 1e6, "unit": "e-"},
    "full_well": {"at_least": 1.0, "at_most": 1e9, "unit": "e-"},
    "gain": {"above": 0.0, "at_most": 1e9, "unit": "e-/DN"},
    "black_level": {"at_least": 0.0, "at_most": 65535.0, "unit": "DN"},
    "fill_factor": {"above": 0.0, "at_most": 1.0},
    "prnu": {"at_least": 0.0, "at_most": 1.0},
    "dark_electrons": {"at_least": 0.0, "at_most": 1e9, "unit": "e-"},
}
_WHOLE = {"bit_depth": {"at_least": 1, "at_most": 16}, "noise_seed": {"at_least": 0, "at_most": 2**53}}


def read_camera(props: mi.Properties) -> Camera | None:
    """The camera that a detector's parameters describe, None where there is none of them. Raises SceneError."""
    given = {name: read_number(props, name, **limits) for name, limits in _NUMBERS.items() if name in props}
    given |= {name: read_integer(props, name, 0, **limits) for name, limits in _WHOLE.items() if name in props}
    if not given:
        return None
    try:
        camera = Camera.of(props.id(), **given)
    except InputError as error:
        raise SceneError(f"{describe(props)}: {error}") from None
    if camera.black_level >= camera.white:
        raise SceneError(
            f"{describe(props)}: parameter 'black_level' is {camera.black_level:g} DN, must be below the largest "
            f"number of {camera.bit_depth} bits, {camera.white:g}"
        )
    return camera
