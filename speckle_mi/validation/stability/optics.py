"""Extremes of the optics: pupils, Fresnel numbers, foci and caustics, plates, index 1, aspheres, total reflection."""

from __future__ import annotations

import numpy as np

from ...geometry.frames import Frame
from ...scene.write import Plugin, material, on_axis, shape
from .case import BROKEN, LIMIT, Case, Check, compared, declined, same_field, warned, within
from .references import K, off_axis_field, on_axis_integral, through_plate
from .scenes import WAVELENGTH, Bench, aperture, lens, pixel_centres
from .surfaces import point_scatterers

TOLERANCE = 1e-4

ASPHERE_TOLERANCE = 1e-6
"""Asked of the field behind the asphere; the largest error of a pixel may be ten times the L2 norm's."""

THICK = {"radius1": 50.0, "radius2": -50.0, "thickness": 5.0, "diameter": 20.0, "ior": 1.5151}
"""Biconvex lens, f = 49.37 mm."""

BARE_LENS = 0.05
"""Largest error that a lens whose two rims are one pupil may state."""

_PIXEL = {"width": 1, "height": 1}
_UNIFORM = {"beam_radius": np.inf, "wavefront_radius": np.inf}


def _of_a_point(bench: Bench, point=(0.0, 0.0, 0.0)):
    """Assembly and frame of a single scatterer under uniform light, and the field over the scatterer's amplitude."""
    from ...field.simulation import simulate_frame

    with point_scatterers([point]) as path:
        bench = bench.with_(laser_angle=0.0, laser=_UNIFORM, target={"points": path, "roughness": 0.0})
        assembly = bench.assembly()
        frame = simulate_frame(assembly)
    return assembly, frame, frame.image.field / frame.scatterers.amplitude[0]


def pupils(quick: bool):
    """Fields behind round holes from less than a wavelength on, on the axis, against the integral."""
    for radius in (0.0005, 0.1) if quick else (0.0005, 0.001, 0.01, 0.1, 0.5):
        bench = Bench(detector_distance=60.0, detector=_PIXEL, elements=(aperture(25.0, radius=radius),))
        _, _, field = _of_a_point(bench)
        reference = np.array([on_axis_integral(25.0, 35.0, radius)])
        yield same_field("pupil", f"field behind a pupil of {2e3 * radius:g} um", field, reference, TOLERANCE)
    wide = aperture(25.0, radius=50.0, outer_radius=200.0)
    _, _, field = _of_a_point(Bench(elements=(wide,)))
    _, _, free = _of_a_point(Bench())
    yield same_field("pupil", "field behind a pupil of 100 mm: that of free space", field, free, TOLERANCE)


def fresnel_numbers(quick: bool):
    """On the axis, relative to the light without the hole: at an even Fresnel number the axis itself is dark."""
    for number in (0.01, 1.0, 100.0) if quick else (0.01, 0.1, 1.0, 10.0, 100.0, 250.0):
        radius = np.sqrt(number * WAVELENGTH * 15.0)
        bench = Bench(detector_distance=60.0, detector=_PIXEL, elements=(aperture(30.0, radius=float(radius)),))
        _, _, field = _of_a_point(bench)
        reference = on_axis_integral(30.0, 30.0, radius)
        error = abs(field[0, 0] - reference) / max(abs(reference), 1 / 60.0)
        yield within(
            "Fresnel number", f"field on the axis at {number:g}", abs(field[0, 0]), abs(reference), error, TOLERANCE
        )
    for number in (10.0, 1e5) if quick else (0.1, 10.0, 250.0, 400.0, 1e3, 1e4, 1e5):
        yield _beside_the_axis(number)


def _beside_the_axis(number: float) -> Check:
    """The field on pixels beside the axis, on which all of a round edge's waves would meet.

    Beyond a Fresnel number of some hundred the edge's waves are left out: the frame's error says how large they are.
    """
    radius = float(np.sqrt(number * WAVELENGTH * 15.0))
    wide = {"width": 9, "height": 1, "pixel_pitch": 0.11}
    assembly, frame, field = _of_a_point(
        Bench(detector=wide, elements=(aperture(30.0, radius=radius, outer_radius=300.0),))
    )
    beside = np.array([0, 1, 2, 3])
    places = pixel_centres(assembly.detector, beside)[:, 0]
    reference = np.array([off_axis_field(30.0, 30.0, radius, float(abs(x))) for x in places])
    name = f"field beside the axis at {number:g}"
    left_out = [str(stage) for stage in frame.stages if stage.predicted_error is not None]
    if frame.numerical_error <= TOLERANCE or not left_out:
        return same_field("Fresnel number", name, field.ravel()[beside], reference, TOLERANCE)
    error = float(np.linalg.norm(field.ravel()[beside] - reference) / np.linalg.norm(reference))
    verdict = LIMIT if error <= frame.numerical_error else BROKEN
    what, stated = f"{name}, without the edge's wave", frame.numerical_error
    return Check("Fresnel number", what, error, "as stated", error, stated, verdict, "; ".join(left_out))


# Plates and lenses without effect


def plane_parallel_plate(quick: bool):
    plate = lens(20.0, **THICK | {"radius1": 0.0, "radius2": 0.0, "diameter": 60.0})
    wide = {"width": 33, "height": 33, "pixel_pitch": 0.1}
    assembly, _, field = _of_a_point(Bench(detector=wide, elements=(plate,)))
    rho = np.linalg.norm(pixel_centres(assembly.detector, np.arange(field.size))[:, :2], axis=1)
    yield same_field(
        "plate", "field behind a plate, Snell's law", field, through_plate(60.0, 5.0, 1.5151, rho), TOLERANCE
    )


def lenses_without_power(quick: bool):
    """Index 1 is free space, whatever the surfaces; a lens of equal radii has the plate's path on its axis."""
    _, _, free = _of_a_point(Bench())
    shapes = {
        "of two planes": {"radius1": 0.0, "radius2": 0.0},
        "of two spheres": {},
        "a strong asphere": {"radius1": 8.0, "conic1": -3.0, "diameter": 8.0},
    }
    for name, form in shapes.items():
        _, _, field = _of_a_point(Bench(elements=(lens(25.0, **THICK | form | {"ior": 1.0}),)))
        yield same_field("index 1", f"field through a lens {name}", field, free, TOLERANCE)
    _, _, field = _of_a_point(
        Bench(detector=_PIXEL, elements=(lens(25.0, **THICK | {"radius1": 1e9, "radius2": 1e9}),))
    )
    yield same_field(
        "zero power", "field on the axis", field, through_plate(60.0, 5.0, 1.5151, np.zeros(1)), TOLERANCE
    )


def strong_asphere(quick: bool):
    """A hyperboloid of conic -n^2 makes the light of its focus parallel: one phase everywhere behind, path f + n t."""
    n, f, t = 1.5, 10.0, 8.0
    part = lens(f, radius1=(n - 1) * f, radius2=0.0, conic1=-n * n, conic2=0.0, thickness=t, diameter=10.0, ior=n)
    wide = {"width": 33, "height": 33, "pixel_pitch": 0.05}
    bench = Bench(detector_distance=30.0, detector=wide, elements=(part,), integrator={"tolerance": ASPHERE_TOLERANCE})
    _, _, field = _of_a_point(bench)
    path = f + n * t + (30.0 - f - t)
    phase = field * np.exp(-2j * np.pi * ((path / WAVELENGTH) % 1.0))
    yield within(
        "asphere",
        "phase behind a hyperboloid [rad]",
        float(np.mean(np.angle(phase))),
        0.0,
        np.abs(np.angle(phase)).max(),
        10 * ASPHERE_TOLERANCE,
    )
    # Far from the axis the amplitude falls as the hyperboloid takes up less solid angle: exact on the axis.
    yield compared(
        "asphere", "amplitude on the axis, 1/f [1/mm]", abs(field[16, 16]), 1 / f, 10 * ASPHERE_TOLERANCE, relative=True
    )


# Focus


def through_focus(quick: bool):
    """A point imaged through a small stop: the energy is that of the stop's solid angle, and nothing jumps."""
    stop, steps = 1.0, np.linspace(-3.0, 3.0, 5 if quick else 13)
    image = {"width": 97, "height": 97, "pixel_pitch": 0.008}
    energies, peaks = [], []
    for step in steps:
        parts = (aperture(90.0, radius=stop), lens(97.0685, **THICK))
        bench = Bench(detector_distance=199.1 + float(step), detector=image, elements=parts)
        _, _, field = _of_a_point(bench)
        power = np.abs(field) ** 2
        energies.append(float(power.sum()) * 0.008**2)
        peaks.append(float(power.max()))
    solid_angle = 2 * np.pi * (1 - 90.0 / np.hypot(90.0, stop))
    # The detector of 0.77 mm holds all but 1 - 0.084/u of an Airy pattern whose dark ring is 0.04 mm.
    worst = max(energies, key=lambda energy: abs(energy - solid_angle))
    yield compared("through focus", "energy on the detector over solid angle", worst / solid_angle, 1.0, 0.03)
    jumps = np.abs(np.diff(energies)) / solid_angle
    yield within("through focus", "largest step of the energy", jumps.max(), 0.0, jumps.max(), 0.01)
    middle = int(np.argmax(peaks))
    rises = np.all(np.diff(peaks[: middle + 1]) > 0) and np.all(np.diff(peaks[middle:]) < 0)
    yield within(
        "through focus", "brightest pixel rises, then falls", str(bool(rises)), "True", 0.0 if rises else np.inf, 0.0
    )
    # Power P in a round cone of half angle a' makes |E|^2 = P pi a'^2 / lambda^2 in its focus; at 2 f - 2 f, a' = a.
    # The marginal focus lies 0.09 mm before the paraxial one, which takes up to 1 percent.
    focus = np.pi * (stop / 90.0) ** 2 / WAVELENGTH
    yield compared(
        "through focus", "amplitude in the focus, pi a^2 / lambda", np.sqrt(max(peaks)), focus, 0.01, relative=True
    )


def foci_without_a_stop(quick: bool):
    """Geometric light is infinite in a focus: it is refused where nothing limits the light but a whole ball."""
    ball = _ball(6.5)
    near = {"width": 16, "height": 16, "pixel_pitch": 0.003}
    bench = Bench(laser_angle=45.0, laser={"beam_radius": 0.08}, detector_distance=20.2352, detector=near)
    yield declined(
        "caustic",
        "ball lens without a stop, detector in its focus",
        bench.with_(elements=(ball,)).frame,
        "focus",
        "aperture",
    )
    stopped = bench.with_(
        elements=(ball, aperture(10.0, radius=0.4, outer_radius=5.0)), integrator={"diffraction": False}
    )
    yield declined("caustic", "geometric light of a ball lens in its focus", stopped.frame, "focus", "diffraction")
    bare = Bench(detector_distance=199.1, detector=near, elements=(lens(97.0685, **THICK),)).frame()
    light = float(np.sum(bare.image.intensity))
    stated = bare.numerical_error if light > 0 else np.inf
    yield within("caustic", "lens whose own rim is the stop, detector in its focus", light, "light", stated, BARE_LENS)


def caustic_of_a_ball_lens(quick: bool):
    """Through the caustic with a stop: finite everywhere, and the energy is the solid angle's."""
    distances = (
        ((20.0, 0.003), (22.0, 0.006))
        if quick
        else ((18.0, 0.006), (19.5, 0.003), (20.0, 0.003), (20.2352, 0.003), (22.0, 0.006))
    )
    # A stop before the ball, so that the solid angle is known.
    solid_angle = 2 * np.pi * (1 - 3.0 / np.hypot(3.0, 0.3))
    for distance, pitch in distances:
        parts = (aperture(3.0, radius=0.3, outer_radius=5.0), _ball(6.5))
        image = {"width": 64, "height": 64, "pixel_pitch": pitch}
        _, _, field = _of_a_point(Bench(detector_distance=distance, detector=image, elements=parts))
        energy = float(np.sum(np.abs(field) ** 2)) * pitch**2
        # The rest is diffracted beside the detector.
        yield compared("caustic", f"energy over solid angle at {distance:g} mm", energy / solid_angle, 1.0, 0.02)


def _ball(z: float) -> Plugin:
    return shape("sphere", "ball", on_axis(z), [_glass(1.5151)], radius=3.0)


def _glass(index: float) -> Plugin:
    return material("dielectric", int_ior=index, ext_ior=1.0)


# Ways that end


def total_internal_reflection(quick: bool):
    """A cube's side reflects totally: the mirror image of the field behind a plate, seen beyond that side.

    A stop lets only the light through that meets the side x = 5 mm on its way.
    """
    side, index = 5.0, 1.5
    cube = shape("cube", "cube", on_axis(20.0), [_glass(index)], size=(side, side, side))
    plate = lens(
        15.0, **THICK | {"radius1": 0.0, "radius2": 0.0, "thickness": 2 * side, "ior": index, "diameter": 60.0}
    )
    stop = shape("aperture", "stop", Frame(np.array([2.73, 0.0, 10.0]), np.eye(3)), radius=0.05, outer_radius=30.0)
    facing = np.diag([-1.0, 1.0, -1.0])
    bench = Bench(detector={"width": 32, "height": 24, "pixel_pitch": 0.03})
    behind_cube = bench.with_(detector_frame=Frame(np.array([0.0, 0.0, 40.0]), facing), elements=(stop, cube))
    behind_plate = bench.with_(detector_frame=Frame(np.array([2 * side, 0.0, 40.0]), facing), elements=(stop, plate))
    (_, _, reflected), (_, _, straight) = _of_a_point(behind_cube), _of_a_point(behind_plate)
    yield same_field("total reflection", "field behind a cube, mirrored", reflected, straight[:, ::-1], 2 * TOLERANCE)


def rays_that_graze_a_rim(quick: bool):
    """A shadow's edge by geometric optics stands where the straight line over the rim meets the detector."""
    wide = {"width": 401, "height": 1, "pixel_pitch": 0.005}
    stop = aperture(30.0, radius=0.4)
    _, _, field = _of_a_point(Bench(detector=wide, elements=(stop,), integrator={"diffraction": False}))
    lit = np.count_nonzero(np.abs(field)) * 0.005
    yield compared("grazed rim", "width of a geometric shadow's inside [mm]", lit, 2 * 0.4 * 60 / 30, 0.0051)
    exactly = {"width": 2, "height": 1, "pixel_pitch": 1.6}  # both pixels in the middle of the edge
    _, _, field = _of_a_point(Bench(detector=exactly, elements=(stop,)))
    yield compared(
        "grazed rim",
        "field at a shadow's edge, two sides alike",
        abs(field[0, 0]),
        abs(field[0, 1]),
        1e-3,
        relative=True,
    )


def blocked_light(quick: bool):
    wall = shape("disk", "wall", on_axis(30.0), [material("diffuse")], size=(50.0, 50.0, 50.0))
    yield warned("blocked", "a wall before the detector [field]", Bench(elements=(wall,)).frame(), "wall")
    first = aperture(20.0, radius=0.2, name="first", outer_radius=60.0)
    second = shape("aperture", "second", Frame(np.array([9.0, 0, 40.0]), np.eye(3)), radius=0.05, outer_radius=80.0)
    frame = Bench(elements=(first, second), detector={"width": 16, "height": 16}).frame()
    message = "; ".join(frame.warnings)
    yield Check(
        "blocked",
        "two holes out of line",
        float(np.abs(frame.image.field).max()),
        0.0,
        0.0,
        0.0,
        LIMIT if "second" in message or "first" in message else BROKEN,
        message or "no warning",
    )


def lens_at_the_detector(quick: bool):
    """The detector on the back vertex is the limit of the detector near by; inside the glass it is refused."""
    small = {"width": 8, "height": 8}
    touching = Bench(detector_distance=55.0, detector=small, elements=(lens(50.0, **THICK),))
    _, _, at = _of_a_point(touching)
    _, _, near = _of_a_point(touching.with_(detector_distance=55.0 + 1e-6))
    # A nanometre changes the phase by k times a nanometre.
    yield same_field("lens at the detector", "field on the back surface", at * np.exp(1e-6j * K), near, TOLERANCE)
    inside = touching.with_(detector_distance=52.0)
    yield declined("lens at the detector", "detector inside the glass", inside.assembly, "inside", "lens")


CASES: tuple[Case, ...] = tuple(
    Case(run)
    for run in (
        pupils,
        fresnel_numbers,
        plane_parallel_plate,
        lenses_without_power,
        strong_asphere,
        through_focus,
        foci_without_a_stop,
        caustic_of_a_ball_lens,
        total_internal_reflection,
        rays_that_graze_a_rim,
        blocked_light,
        lens_at_the_detector,
    )
)
