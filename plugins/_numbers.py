"""The numbers of a plugin that ``mi.traverse`` exposes: read, checked, handed out and written in one way.

A plugin names them with their limits, as :func:`check_number` takes them, and holds each as an attribute of that name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import mitsuba as mi

from speckle_mi.scene.parameters import check_number, read_number, stored, value_of

Limits = Mapping[str, Mapping[str, object]]


def read_numbers(plugin, props: mi.Properties, limits: Limits, defaults: Mapping[str, float] | None = None) -> None:
    """Gives a plugin its numbers; those without a default are required. SceneError for one outside its limits."""
    for name, bounds in limits.items():
        default = (defaults[name],) if defaults and name in defaults else ()
        setattr(plugin, name, stored(read_number(props, name, *default, **bounds)))


def check_numbers(plugin, limits: Limits) -> None:
    """SceneError where a plugin has a number outside its limits."""
    for name, bounds in limits.items():
        check_number(plugin.where, name, value_of(getattr(plugin, name)), **bounds)


def expose(plugin, names: Iterable[str], callback) -> None:
    """Hands a plugin's numbers and then its place to ``mi.traverse``."""
    for name in names:
        callback.put(name, getattr(plugin, name), mi.ParamFlags.NonDifferentiable)
    plugin.placement.traverse(callback)


def in_words(plugin, names: Iterable[str], unit: str = "") -> str:
    """A plugin's numbers as ``to_string`` writes them, ``unit`` behind each."""
    return ", ".join(f"{name} = {value_of(getattr(plugin, name))}{unit}" for name in names)


def has_bsdf(props: mi.Properties) -> bool:
    """Whether the scene gives a shape a BSDF."""
    return any(isinstance(child, mi.BSDF) for _, child in props.objects())
