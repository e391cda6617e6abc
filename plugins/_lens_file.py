"""A lens's numbers out of a vendor's file: they become the parameters that a scene would give itself."""

from __future__ import annotations

import re

import mitsuba as mi

from speckle_mi.optics.glass import Glass
from speckle_mi.optics.lens_file import MOST_BYTES, LensFile, read_lens
from speckle_mi.scene.errors import SceneError
from speckle_mi.scene.parameters import describe
from speckle_mi.scene.target_files import resolve

_BESIDE = re.compile(r"filename|to_world|reverse|(diameter|ior|glass)\d*")
"""Parameters that a scene may give beside a file: they replace the file's."""

_NUMBERED = re.compile(r"(radius|conic|aspheric|form|thickness)\d*")


def take_lens_file(props: mi.Properties) -> tuple[dict[int, Glass], str]:
    """Gives ``props`` what the file that they name says of the lens; nothing where they name none.

    Returns the glasses behind surfaces 1, 2, ... that the scene does not name itself, and what of the file is left out
    in words. Raises SceneError for a file that is no lens.
    """
    if "filename" not in props:
        return {}, ""
    where, path = describe(props), resolve(props, "filename")
    props["filename"]  # read, whatever comes of it
    for name in props.keys():
        if _NUMBERED.fullmatch(name) and not _BESIDE.fullmatch(name):
            raise SceneError(f"{where}: has 'filename' and {name!r}, must have one of them")
    file = f"{where}: {path.name!r}"
    try:
        with open(path, "rb") as opened:
            lens = read_lens(opened.read(MOST_BYTES + 1))
        _fill(props, lens)
        glasses = {number: lens.glass(number - 1) for number in _unnamed(props, lens)}
    except OSError as error:
        raise SceneError(f"{file} cannot be read: {error.strerror}") from None
    except ValueError as error:
        joint = " " if str(error).startswith(("has ", "is ")) else ": "
        raise SceneError(f"{file}{joint}{error}") from None
    return glasses, f"of {path.name} is left out: {', '.join(lens.left_out)}" if lens.left_out else ""


def _unnamed(props: mi.Properties, lens: LensFile) -> list[int]:
    """Media of the file for which the scene has no index or glass of its own."""
    single = len(lens.media) == 1
    return [
        number
        for number in range(1, len(lens.media) + 1)
        if not any(f"{kind}{number}" in props or (single and kind in props) for kind in ("ior", "glass"))
    ]


def _fill(props: mi.Properties, lens: LensFile) -> None:
    """Radii, conic constants, aspheric coefficients, thicknesses and diameters of a file as parameters."""
    for number, (surface, thickness) in enumerate(zip(lens.surfaces, (*lens.thicknesses, None), strict=True), start=1):
        props[f"radius{number}"] = 1 / surface.curvature if surface.curvature else 0.0
        props[f"conic{number}"] = surface.conic
        if any(surface.aspheric):
            props[f"aspheric{number}"] = ", ".join(map(repr, surface.aspheric))
        if surface.form != "rotational":
            props[f"form{number}"] = surface.form
        if thickness is not None:
            props[f"thickness{number}"] = thickness
    _fill_diameters(props, lens)


def _fill_diameters(props: mi.Properties, lens: LensFile) -> None:
    """Diameters of a file; those of a cylinder lens, whose edge is not level, are the least of all."""
    if "diameter" in props:
        return
    halves = {number: one.clear or one.semi_diameter for number, one in enumerate(lens.surfaces, start=1)}
    for number, half in halves.items():
        if not half > 0 and f"diameter{number}" not in props:
            raise ValueError(
                f"surface {lens.surfaces[number - 1].number} has no semi-diameter (DIAM), must: give 'diameter'"
            )
    if len(set(halves.values())) == 1 or any(one.form != "rotational" for one in lens.surfaces):
        props["diameter"] = 2 * min(halves.values())
        return
    for number, half in halves.items():
        if f"diameter{number}" not in props:
            props[f"diameter{number}"] = 2 * half
