"""Optical paths through lenses against optiland, a ray tracer that shares no code with this one."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import speckle_mi  # noqa: F401  (finds LLVM and registers the plugins)
from speckle_mi.geometry.frames import Frame
from speckle_mi.optics.sequence import Interaction, Sequence
from speckle_mi.optics.surface import Surface
from speckle_mi.optics.trace import trace
from speckle_mi.scene.elements import OUTSIDE

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_mono")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    optic = pytest.importorskip("optiland.optic")
    from optiland.materials import IdealMaterial
    from optiland.rays import RealRays

WAVES = 1e-6  # of a wavelength: largest difference of two paths
END = 40.0  # [mm] from the first vertex to the plane where paths end
WAVELENGTHS = (486.1327, 587.5618, 656.2725)  # [nm]

LENSES = {
    "cemented doublet": {"radius1": 61.0, "radius2": -43.5, "radius3": -124.0, "thickness1": 6.0, "thickness2": 2.5,
                         "glass1": "N-BK7", "glass2": "SCHOTT/F2"},
    "air-spaced doublet": {"radius1": 55.0, "radius2": -80.0, "radius3": -52.0, "radius4": -160.0, "thickness1": 4.0,
                           "thickness2": 1.5, "thickness3": 2.0, "glass1": "N-BK7", "ior2": 1.0, "glass3": "SCHOTT/F2"},
    "even asphere": {"radius1": 30.0, "conic1": -0.6, "aspheric1": "-1.2e-5, 3e-9", "radius2": -90.0,
                     "aspheric2": "2e-6", "thickness": 5.0, "glass": "N-BK7"},
    "cylinder": {"radius1": 40.0, "form1": "cylinder_x", "thickness": 4.0, "glass": "N-BK7"},
}  # fmt: skip


def element(values: dict, reverse: bool, wavelength: float):
    return mi.load_dict({"type": "lens", "diameter": 16.0, "reverse": reverse} | values).element().at(wavelength * 1e-6)


def own_paths(lens, origins, directions) -> tuple[np.ndarray, np.ndarray]:
    """Optical paths (n,) to the plane z = END, and places there (n, 2)."""
    steps, medium = [], OUTSIDE
    for face in range(len(lens.faces)):
        steps.append(lens.interaction(face, medium))
        medium = lens.beyond(face, medium)
    plane = Surface(Frame(np.array([0.0, 0.0, END]), np.eye(3)))
    found = trace(Sequence((*steps, Interaction.through(plane))), origins, directions)
    assert np.all(found.valid)
    return found.optical_path_length, found.points[-1, :, :2]


def prescription(values: dict, media: tuple[float, ...]) -> list[dict]:
    """Surfaces by their numbers, each with the thickness and the index behind it."""
    count = len(media) + 1
    surfaces = []
    for number in range(1, count + 1):
        thickness = values.get(f"thickness{number}", values.get("thickness")) if number < count else 0.0
        surfaces.append({
            "radius": values.get(f"radius{number}", 0.0), "conic": values.get(f"conic{number}", 0.0),
            "aspheric": [float(one) for one in values.get(f"aspheric{number}", "").replace(",", " ").split()],
            "form": values.get(f"form{number}", "rotational"), "thickness": thickness,
            "index": media[number - 1] if number < count else 1.0,
        })  # fmt: skip
    return surfaces


def turned(surfaces: list[dict]) -> list[dict]:
    """The same lens the other way round."""
    gaps = [(one["thickness"], one["index"]) for one in surfaces[:-1]][::-1] + [(0.0, 1.0)]
    return [
        one | {"radius": -one["radius"], "aspheric": [-a for a in one["aspheric"]], "thickness": gap, "index": index}
        for one, (gap, index) in zip(surfaces[::-1], gaps, strict=True)
    ]


def theirs(surfaces: list[dict], origins, directions, wavelength: float) -> tuple[np.ndarray, np.ndarray]:
    """The same paths and places by optiland."""
    lens = optic.Optic()
    lens.add_surface(index=0, thickness=np.inf)
    length = sum(one["thickness"] for one in surfaces)
    for number, one in enumerate(surfaces, start=1):
        radius = one["radius"] or np.inf
        thickness = one["thickness"] if number < len(surfaces) else END - length
        form = {"radius": radius, "conic": one["conic"]}
        if one["aspheric"]:
            form |= {"surface_type": "even_asphere", "coefficients": [0.0, *one["aspheric"]]}
        elif one["form"] == "cylinder_x":
            form = {"surface_type": "biconic", "radius_x": radius, "radius_y": np.inf}
        form |= {"material": IdealMaterial(n=one["index"]), "is_stop": number == 1, "tol": 1e-14}
        lens.add_surface(index=number, thickness=thickness, **form)
    lens.add_surface(index=len(surfaces) + 1)
    lens.set_aperture(aperture_type="EPD", value=10.0)
    lens.set_field_type("angle")
    lens.add_field(y=0)
    lens.add_wavelength(value=wavelength * 1e-3, is_primary=True)
    n = len(origins)
    rays = RealRays(*origins.T, *directions.T, np.ones(n), np.full(n, wavelength * 1e-3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        lens.surface_group.trace(rays)
    return np.asarray(rays.opd), np.stack([rays.x, rays.y], axis=1)


def some_rays(tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (n, 3) of rays from one place 50 mm before the lens, on its axis or off it."""
    source = np.array([50 * np.tan(np.radians(tilt)), 0.6 * 50 * np.tan(np.radians(tilt)), -50.0])
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(-4, 4, 5), np.linspace(-4, 4, 5)))
    directions = np.stack([x, y, np.zeros(25)], axis=1) - source
    return np.tile(source, (25, 1)), directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("name", LENSES)
def test_paths_through_a_lens_are_those_of_optiland(name, reverse):
    for wavelength in WAVELENGTHS:
        lens = element(LENSES[name], reverse, wavelength)
        forward = element(LENSES[name], False, wavelength)
        surfaces = prescription(LENSES[name], forward.media)
        for tilt in (0.0, 4.0):
            rays = some_rays(tilt)
            length, place = own_paths(lens, *rays)
            expected, there = theirs(turned(surfaces) if reverse else surfaces, *rays, wavelength)
            assert np.abs(length - expected).max() < WAVES * wavelength * 1e-6
            assert np.abs(place - there).max() < 1e-9
