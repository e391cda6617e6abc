"""Apertures and lenses as shapes of a scene: closed meshes of the right size around the analytic surfaces."""

from __future__ import annotations

import numpy as np
import pytest

import speckle_mi  # noqa: F401  (finds LLVM and registers the plugins)

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_mono")

TESSELLATION = 5e-4
"""Relative error of areas and volumes: 96 rings and 512 sectors leave (pi/2/96)^2 at a hemisphere, else far less."""

FACET = np.pi / 512
"""Angle [rad] between a facet and the surface it stands for; a ball's rim is parallel to the rays."""

PLACE = mi.ScalarTransform4f().translate([3, -2, 41]).rotate([0.6, 0.8, 0], 25)

BICONVEX = {"type": "lens", "radius1": 50.0, "radius2": -50.0, "thickness": 5.0, "diameter": 20.0, "ior": 1.5151}
LENSES = {
    "biconvex": BICONVEX,
    "plano-convex": BICONVEX | {"radius1": 0.0},
    "convex-plano": BICONVEX | {"radius2": 0.0},
    "meniscus": BICONVEX | {"radius1": 30.0, "radius2": 40.0},
    "biconcave": BICONVEX | {"radius1": -30.0, "radius2": 40.0},
    "asphere": BICONVEX | {"radius1": 15.0, "conic1": -0.6, "radius2": 0.0},
    "paraboloid": BICONVEX | {"radius1": 20.0, "conic1": -1.0, "conic2": -3.0},
    "ball": BICONVEX | {"radius1": 10.0, "radius2": -10.0, "thickness": 20.0},
    "plate": BICONVEX | {"radius1": 0.0, "radius2": 0.0},
}


def triangles(mesh) -> np.ndarray:
    """Corners (f, 3, 3) in the world [mm]."""
    parameters = mi.traverse(mesh)
    vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    return vertices[np.array(parameters["faces"]).reshape(-1, 3)]


def doubled_areas(corners: np.ndarray) -> np.ndarray:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def volume(corners: np.ndarray) -> float:
    corners = corners - corners.mean(axis=(0, 1))
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def sag(r: np.ndarray, radius: float, conic: float) -> np.ndarray:
    c = 1 / radius if radius else 0.0
    return c * r**2 / (1 + np.sqrt(np.maximum(1 - (1 + conic) * c**2 * r**2, 0)))


def glass_volume(lens: dict) -> float:
    """Volume between the two surfaces [mm^3], by shells."""
    x, w = np.polynomial.legendre.leggauss(200)
    phi = (x + 1) * np.pi / 4
    r = lens["diameter"] / 2 * np.sin(phi)
    back = lens["thickness"] + sag(r, lens["radius2"], lens.get("conic2", 0))
    front = sag(r, lens["radius1"], lens.get("conic1", 0))
    return float(np.sum(w * np.pi / 4 * 2 * np.pi * r * (back - front) * lens["diameter"] / 2 * np.cos(phi)))


@pytest.mark.parametrize("name", LENSES)
def test_lens_mesh_is_closed_and_holds_the_volume_of_its_glass(name):
    corners = triangles(mi.load_dict(LENSES[name] | {"to_world": PLACE}))
    position = np.ascontiguousarray(corners.reshape(-1, 3).astype(np.float32) + np.float32(0.0)).view("V12").ravel()
    _, vertex = np.unique(position, return_inverse=True)
    faces = vertex.reshape(-1, 3)
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    there, back = (np.sort(edges[:, a] << 32 | edges[:, b]) for a, b in ((0, 1), (1, 0)))
    # Closed and oriented: every edge is run through once in either direction.
    assert np.all(np.diff(there) > 0)
    assert np.array_equal(there, back)
    # A positive volume also means outward normals.
    assert volume(corners) == pytest.approx(glass_volume(LENSES[name]), rel=TESSELLATION)


@pytest.mark.parametrize("name", LENSES)
def test_rays_inside_the_diameter_meet_front_and_back_near_the_analytic_surfaces(name):
    lens = mi.load_dict(LENSES[name] | {"to_world": PLACE})
    scene = mi.load_dict({"type": "scene", "lens": lens})
    front, back = lens.surfaces()
    rng = np.random.default_rng(5)
    radius = lens.surfaces()[0].outline.radius
    # The outermost ring just inside the rim, and everywhere between.
    r = radius * np.append(np.sqrt(rng.random(500)), np.full(200, 1 - 1e-6))
    theta = 2 * np.pi * rng.random(r.size)
    x, y = r * np.cos(theta), r * np.sin(theta)
    for surface, side in ((front, -1.0), (back, 1.0)):
        start = np.stack([x, y, np.full(r.size, side * 40.0)], axis=-1)
        origin, direction = surface.frame.to_world(start), -side * surface.frame.axes[:, 2]
        ray = mi.Ray3f(mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(direction.tolist()))
        si = scene.ray_intersect(ray)
        assert np.all(np.array(si.is_valid()))
        hit = surface.frame.to_local(np.array(si.p, dtype=np.float64).T)
        normal = np.array(si.sh_frame.n, dtype=np.float64).T @ surface.frame.axes
        assert np.all(side * normal[:, 2] > -FACET)
        inner = r < 0.98 * radius
        c, k = surface.curvature, surface.conic
        expected = c * r**2 / (1 + np.sqrt(1 - (1 + k) * c**2 * r**2))
        assert np.max(np.abs(hit[inner, 2] - expected[inner])) < 1e-2  # mm, a facet's depth where the slope is steep


@pytest.mark.parametrize(
    "form, area",
    [
        ({"radius": 0.5, "outer_radius": 10.0}, np.pi * (100 - 0.25)),
        ({"radius": 9.0, "outer_radius": 10.0}, np.pi * 19),
        ({"shape": "rectangle", "width": 1.0, "height": 2.0, "outer_radius": 5.0}, np.pi * 25 - 2),
        ({"shape": "rectangle", "width": 0.01, "height": 8.0, "outer_radius": 5.0}, np.pi * 25 - 0.08),
    ],
)
def test_aperture_mesh_is_a_disc_without_its_hole(form, area):
    aperture = mi.load_dict({"type": "aperture", "to_world": PLACE} | form)
    doubled = doubled_areas(triangles(aperture)) @ aperture.element().faces[0].frame.axes
    assert np.all(doubled[:, 2] > 0)  # no face turned or folded over
    assert np.sum(doubled[:, 2]) / 2 == pytest.approx(area, rel=TESSELLATION)
    assert np.max(np.abs(doubled[:, :2])) < 1e-4 * np.max(doubled)


@pytest.mark.parametrize("form", [{"radius": 0.5}, {"shape": "rectangle", "width": 0.02, "height": 3.0}])
def test_no_ray_inside_the_outline_of_an_aperture_is_blocked_and_those_beside_it_are(form):
    aperture = mi.load_dict({"type": "aperture", "to_world": PLACE} | form)
    scene = mi.load_dict({"type": "scene", "stop": aperture})
    opening = aperture.element().faces[0]
    theta = np.linspace(0, 2 * np.pi, 4001)
    edge = np.stack([np.cos(theta), np.sin(theta)])
    if "radius" in form:
        edge *= form["radius"]
    else:
        half = np.array([[form["width"]], [form["height"]]]) / 2
        edge *= 1 / np.max(np.abs(edge) / half, axis=0)
    for scale, blocked in ((1 - 1e-9, False), (1.01, True)):
        local = np.stack([*(scale * edge), np.zeros(theta.size)], axis=-1)
        for slope in (0.0, 0.5):
            direction = opening.frame.axes @ np.array([slope, 0, 1]) / np.hypot(slope, 1)
            origin = opening.frame.to_world(local) - 2 * direction
            ray = mi.Ray3f(mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(direction.tolist()))
            assert np.all(np.array(scene.ray_test(ray)) == blocked)


def test_path_traced_image_through_a_lens_and_a_stop_is_finite():
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 12},
            "lens": BICONVEX | {"to_world": mi.ScalarTransform4f().translate([0, 0, 50])},
            "stop": {"type": "aperture", "radius": 6.0, "to_world": mi.ScalarTransform4f().translate([0, 0, 60])},
            "light": {"type": "constant"},
            "sensor": {
                "type": "perspective",
                "fov": 20,
                "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 150], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
            },
        }
    )
    image = np.array(mi.render(scene, spp=32))
    assert np.all(np.isfinite(image))
    # Lossless glass under even light is invisible, the stop is black.
    assert np.mean(image[11:13, 11:13]) == pytest.approx(1.0, abs=0.05)
    assert np.max(image[:4]) == 0.0


def test_changed_parameters_take_effect():
    lens = mi.load_dict(BICONVEX)
    parameters = mi.traverse(lens)
    parameters["radius1"], parameters["ior"] = 30.0, 1.7
    parameters["to_world"] = mi.Transform4f().translate([0, 0, 7])
    parameters.update()
    front, back = lens.surfaces()
    assert (front.curvature, lens.index, back.frame.origin[2]) == (1 / 30, 1.7, 12.0)
    assert volume(triangles(lens)) == pytest.approx(glass_volume(BICONVEX | {"radius1": 30.0}), rel=TESSELLATION)
    assert float(mi.traverse(lens.bsdf())["eta"]) == pytest.approx(1.7)

    aperture = mi.load_dict({"type": "aperture", "radius": 0.5})
    parameters = mi.traverse(aperture)
    parameters["radius"] = 2.0
    parameters.update()
    assert aperture.element().faces[0].outline.radius == 2.0
    assert np.sum(doubled_areas(triangles(aperture))[:, 2]) / 2 == pytest.approx(np.pi * 96, rel=TESSELLATION)
    parameters["radius"] = 20.0
    with pytest.raises(ValueError, match="'outer_radius' is 10 mm, must be more than 20.0"):
        parameters.update()


@pytest.mark.parametrize(
    "shape, message",
    [
        (BICONVEX | {"radius1": 9.9}, "'diameter' is 20 mm, must be at most 19.8 mm"),
        (BICONVEX | {"radius2": 15.0, "conic2": 3.0}, "at most 15 mm, the widest that 'radius2' = 15 mm"),
        (BICONVEX | {"thickness": 1.0}, "'thickness' 1 mm must be at least 2.02041 mm"),
        (BICONVEX | {"thickness": -1.0}, "'thickness' is -1 mm"),
        (BICONVEX | {"ior": 0.9}, "'ior' is 0.9, must be at least 1"),
        (BICONVEX | {"radius1": float("nan")}, "'radius1' is nan"),
        ({"type": "lens", "thickness": 5.0, "diameter": 20.0}, "'ior' is missing"),
        (BICONVEX | {"radius3": 5.0}, "radius3"),
        (BICONVEX | {"to_world": mi.ScalarTransform4f().scale([1, 1, -1])}, "mirrors"),
        (BICONVEX | {"to_world": mi.ScalarTransform4f().scale(2)}, "scales or shears"),
        ({"type": "aperture"}, "'radius' is missing"),
        ({"type": "aperture", "radius": 0.0}, "'radius' is 0 mm, must be at least 1e-06 mm"),
        ({"type": "aperture", "radius": 1.0, "width": 1.0}, "has 'width', but a circle is given by radius"),
        ({"type": "aperture", "radius": 1.0, "outer_radius": 1.0}, "'outer_radius' is 1 mm, must be more than 1.0"),
        ({"type": "aperture", "shape": "hexagon", "radius": 1.0}, "must be one of circle, rectangle"),
    ],
)
def test_impossible_elements_are_refused(shape, message):
    with pytest.raises(RuntimeError, match=message):
        mi.load_dict(shape)
