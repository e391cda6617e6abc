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
        if thickness is not None:
            props[f"thickness{number}"] = thickness
        if "diameter" in props or f"diameter{number}" in props:
            continue
        half = surface.clear or surface.semi_diameter
        if not half > 0:
            raise ValueError(f"surface {surface.number} has no semi-diameter (DIAM), must have one: give 'diameter'")
        props[f"diameter{number}"] = 2 * half
