"""Reads and checks the parameters of a scene: each error names the plugin, the parameter, its value and its range.

A plugin keeps a number as a Dr.Jit array of one float64, so that ``mi.traverse`` can expose it with its full
precision; :func:`value_of` gives it back as a Python float.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import mitsuba as mi
import numpy as np

from ..geometry.pose import FARTHEST
from ..machine.backend import arrays
from .errors import SceneError

_REQUIRED = object()

RIGID_TOLERANCE = 1e-6
"""Largest deviation of a transform's axes from orthonormal, which leaves room for single-precision input."""


def check_number(
    where: str, name: str, value: object, *, unit: str = "", above: float | None = None, at_least: float | None = None,
    below: float | None = None, at_most: float | None = None, infinite: bool = False,
) -> float:
    """``value`` as a float inside the given range, else SceneError naming ``where`` and ``name``."""
    unit = f" {unit}" if unit else ""
    limits = []
    if above is not None:
        limits.append(f"above {above:g}{unit}")
    if at_least is not None:
        limits.append(f"at least {at_least:g}{unit}")
    if below is not None:
        limits.append(f"below {below:g}{unit}")
    if at_most is not None:
        limits.append(f"at most {at_most:g}{unit}")
    wanted = " and ".join(limits) if limits else f"a number{unit and f' in{unit}'}"
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise SceneError(
            f"{where}: parameter {name!r} is {value!r}, must be a number {wanted if limits else ''}".rstrip()
        )
    number = float(value)
    if math.isnan(number) or (math.isinf(number) and not infinite):
        raise SceneError(
            f"{where}: parameter {name!r} is {number}, must be finite" + (f" and {wanted}" if limits else "")
        )
    if infinite and number == math.inf:
        return number
    outside = (
        (above is not None and not number > above)
        or (at_least is not None and not number >= at_least)
        or (below is not None and not number < below)
        or (at_most is not None and not number <= at_most)
    )
    if outside:
        raise SceneError(f"{where}: parameter {name!r} is {number:g}{unit}, must be {wanted}")
    return number


def describe(props: mi.Properties) -> str:
    """How messages call a plugin instance, for example ``rough_target 'target'``."""
    return f"{props.plugin_name()} {props.id()!r}"


def read_number(props: mi.Properties, name: str, default: object = _REQUIRED, **limits) -> float:
    """A float parameter; limits as in :func:`check_number`. A parameter without default is required."""
    if name not in props:
        if default is _REQUIRED:
            raise SceneError(f"{describe(props)}: parameter {name!r} is missing")
        return float(default)
    value = props[name]
    if isinstance(value, str):
        # XML writes infinity in words, which Mitsuba's own <float> does not read.
        try:
            value = float(value)
        except ValueError:
            pass
    return check_number(describe(props), name, value, **limits)


def read_integer(props: mi.Properties, name: str, default: int, *, at_least: int, at_most: int) -> int:
    """An integer parameter between two limits."""
    value = props.get(name, default)
    number = check_number(describe(props), name, value, at_least=at_least, at_most=at_most)
    if number != int(number):
        raise SceneError(f"{describe(props)}: parameter {name!r} is {number:g}, must be a whole number")
    return int(value)


def read_boolean(props: mi.Properties, name: str, default: bool) -> bool:
    """A true/false parameter."""
    value = props.get(name, default)
    if not isinstance(value, bool):
        raise SceneError(f"{describe(props)}: parameter {name!r} is {value!r}, must be true or false")
    return value


def read_choice(props: mi.Properties, name: str, default: str, choices: Iterable[str]) -> str:
    """A string parameter out of a list."""
    value = props.get(name, default)
    if value not in tuple(choices):
        raise SceneError(f"{describe(props)}: parameter {name!r} is {value!r}, must be one of {', '.join(choices)}")
    return value


def read_text(props: mi.Properties, name: str) -> str:
    """A text that is not empty."""
    value = props[name]
    if not isinstance(value, str) or not value.strip():
        raise SceneError(f"{describe(props)}: parameter {name!r} is {value!r}, must be a text that is not empty")
    return value


def read_list(props: mi.Properties, name: str, most: int) -> tuple[float, ...]:
    """A text of up to ``most`` finite numbers between commas or spaces; none where it is absent."""
    if name not in props:
        return ()
    text = read_text(props, name)
    try:
        numbers = tuple(float(part) for part in text.replace(",", " ").split())
    except ValueError:
        numbers = (math.nan,)
    if not all(map(math.isfinite, numbers)):
        raise SceneError(f"{describe(props)}: parameter {name!r} is {text!r}, must be numbers such as '1.2e-5, -3e-8'")
    if len(numbers) > most:
        raise SceneError(f"{describe(props)}: parameter {name!r} has {len(numbers)} numbers, must have at most {most}")
    return numbers


def read_rigid_transform(props: mi.Properties) -> np.ndarray:
    """``to_world`` as a (4, 4) float64 matrix; the identity where it is absent."""
    if "to_world" not in props:
        return np.eye(4)
    return check_rigid(describe(props), np.array(props["to_world"].matrix, dtype=np.float64).reshape(4, 4))


def check_rigid(where: str, matrix: np.ndarray) -> np.ndarray:
    """A (4, 4) matrix that only rotates and translates, its rotation made exactly orthonormal.

    Raises SceneError for scaling, shearing, mirroring and singular transforms.
    """
    if not np.all(np.isfinite(matrix)):
        raise SceneError(f"{where}: 'to_world' holds {matrix[~np.isfinite(matrix)][0]}, must be finite")
    axes = matrix[:3, :3]
    if np.max(np.abs(matrix[:3, 3])) > FARTHEST:
        raise SceneError(
            f"{where}: 'to_world' moves by {np.max(np.abs(matrix[:3, 3])):g} mm, "
            f"must stay within {FARTHEST:g} mm of the origin"
        )
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=RIGID_TOLERANCE):
        raise SceneError(f"{where}: 'to_world' has the last row {matrix[3].tolist()}, must be 0 0 0 1 (no perspective)")
    scales = np.linalg.norm(axes, axis=0)
    if not np.allclose(axes.T @ axes, np.eye(3), atol=RIGID_TOLERANCE):
        raise SceneError(
            f"{where}: 'to_world' scales or shears (lengths of its axes {scales[0]:g}, {scales[1]:g}, {scales[2]:g}), "
            "must only rotate and translate: give sizes by the plugin's own parameters"
        )
    if np.linalg.det(axes) < 0:
        raise SceneError(f"{where}: 'to_world' mirrors (its determinant is negative), must only rotate and translate")
    left, _, right = np.linalg.svd(axes)
    rigid = matrix.copy()
    rigid[:3, :3] = left @ right
    return rigid


def stored(value: float):
    """A number as ``mi.traverse`` exposes it: Float64 of width 1."""
    return arrays().Float64(float(value))


def value_of(array) -> float:
    """The number behind an exposed parameter, which a user may have replaced by a plain number."""
    if isinstance(array, (int, float)):
        return float(array)
    return float(np.asarray(array).reshape(-1)[0])


def integer_of(array) -> int:
    """The whole number behind an exposed parameter."""
    return int(array) if isinstance(array, int) else int(np.asarray(array).reshape(-1)[0])


def describe_shape(shape: mi.Shape) -> str:
    """How messages call a shape of the scene, for example ``Sphere 'ball'``, or as :func:`describe` does."""
    return getattr(shape, "where", None) or f"{shape.class_name()} {shape.id()!r}"
