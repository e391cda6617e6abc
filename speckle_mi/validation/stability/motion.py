"""Extremes of motion: from a thousandth of an atom to out of the beam, and back to where it began."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ...geometry.frames import Frame
from ...geometry.pose import Pose
from ...geometry.rotation import rotation_matrix
from .case import BROKEN, LIMIT, Case, Check, compared, same_field, warned, within
from .scenes import WAVELENGTH, Bench, against_exact_sum, exact_laser, exact_sum, pixel_centres
from .surfaces import point_scatterers

TOLERANCE = 1e-4

NOISE_FLOOR_PX = 1e-4
"""Shifts below this many pixels are lost in the correlator's own offset (a finite window is not symmetric)."""

FIELD_NOISE_PX = 1e-5
"""Part of a shift that the fields' rounding makes [px]: their error, below 1e-6, times a speckle of 25 px."""

_IMAGE = Bench(laser_angle=35.0, detector={"width": 256, "height": 256}, target={"point_sources": 300})


def displacements_far_below_an_atom(quick: bool):
    """Shift of a picometre's displacement: theory says 0.9463 times as much, the rest is the noise floor."""
    from ...measurement.correlator import Correlator
    from ...field.simulation import simulate

    assembly, tight = _IMAGE.assembly(), _IMAGE.with_(integrator={"tolerance": 1e-8}).assembly()
    correlator, tight_correlator = (Correlator(simulate(a).intensity) for a in (assembly, tight))
    for displacement in (1e-9, 1e-6) if quick else (1e-9, 1e-8, 1e-7, 1e-6, 1e-5):
        shift = correlator.shift(simulate(assembly, Pose(x=displacement)).intensity)
        expected = 0.9463 * displacement / 0.006
        name = f"shift of {displacement:g} mm [px], floor {NOISE_FLOOR_PX:g}"
        yield compared("tiny motion", name, shift.u_px, expected, NOISE_FLOOR_PX)
        exact = tight_correlator.shift(simulate(tight, Pose(x=displacement)).intensity)
        name = f"shift of {displacement:g} mm [px], against fields of 1e-8"
        yield compared("tiny motion", name, shift.u_px, exact.u_px, FIELD_NOISE_PX)


def rotations(quick: bool):
    for angle in (1e-3, 60.0) if quick else (1e-3, 0.1, 1.0, 10.0, 30.0, 60.0):
        for axis in ("rx", "ry", "rz"):
            bench = Bench(laser={"beam_radius": 0.1})
            found = against_exact_sum(bench, Pose(**{axis: angle}))
            yield same_field("rotation", f"field at {axis} = {angle:g} deg", *found, TOLERANCE)
    frame = Bench().frame(Pose(ry=-60.0))
    yield warned("rotation", "ry = -60 deg: the laser behind the surface [field]", frame, "no light")


def rotation_of_known_points(quick: bool):
    """Points that are turned and moved here, and lit by the laser's definition, against those that the scene moves."""
    points = np.random.default_rng(2).normal(size=(60, 3)) * [0.05, 0.05, 0.01]
    for turn in (
        ((0.0, 60.0, 0.0),) if quick else ((1e-3, 0.0, 0.0), (0.0, 60.0, 0.0), (-60.0, 0.0, 0.0), (10.0, 25.0, 40.0))
    ):
        shift = np.array([0.01, -0.02, 0.3])
        with point_scatterers(points) as path:
            bench = Bench(target={"points": path, "roughness": 0.0})
            assembly, pose = bench.assembly(), Pose(*map(float, shift), *turn)
            field = bench.field(pose)
        moved = Rotation.from_rotvec(turn, degrees=True).apply(points) + shift
        places = pixel_centres(assembly.detector, np.arange(assembly.detector.size))
        reference = exact_sum(moved, exact_laser(assembly.beam, moved), places, WAVELENGTH)
        yield same_field("rotation", f"field of known points at {pose}", field, reference, TOLERANCE)


def motion_larger_than_the_spot(quick: bool):
    """Other scatterers: the patterns are unrelated, and no shift may be reported."""
    from ...measurement.correlator import Correlator
    from ...field.simulation import simulate

    assembly = _IMAGE.assembly()
    correlator = Correlator(simulate(assembly).intensity)
    for displacement in (0.8, -1.5) if quick else (0.8, -0.8, 1.0, -1.5, 1.9):
        shift = correlator.shift(simulate(assembly, Pose(x=displacement)).intensity)
        verdict = LIMIT if not shift.ok and np.isnan(shift.u_px) and shift.message else BROKEN
        name = f"shift of {displacement:g} mm in a spot of 0.24 mm"
        yield Check("large motion", name, shift.status, "no shift", 0.0, 0.0, verdict, shift.message)


def out_of_the_beam(quick: bool):
    small = Bench(target={"width": 0.5, "height": 0.5})
    yield warned("out of the beam", "moved by 5 mm [field]", small.frame(Pose(x=5.0)), "misses the target")
    yield warned("out of the beam", "moved by 1e5 mm [field]", small.frame(Pose(y=1e5)), "misses the target")


def behind_the_detector(quick: bool):
    upright = Bench(laser_angle=0.0)
    yield warned("behind the detector", "target moved 100 mm along z [field]", upright.frame(Pose(z=100.0)), "no light")
    yield warned("behind the detector", "detector turned away [field]", Bench(detector_turn=0.0).frame(), "no light")
    below = Bench(detector_angle=120.0)
    yield warned("behind the detector", "detector below the surface [field]", below.frame(), "no light")


def motion_and_its_inverse(quick: bool):
    """To the last bit where the same pose comes back; to rounding where the motion is undone by another."""
    from ...field.simulation import simulate

    assembly = Bench().assembly()
    first = simulate(assembly).field
    for pose in (Pose(x=0.05), Pose(ry=3.0), Pose(0.01, -0.02, 0.3, 1.0, -2.0, 5.0)):
        simulate(assembly, pose)
        again = simulate(assembly).field
        difference = float(np.abs(again - first).max())
        yield within("inverse motion", f"field after {pose} and back", difference, 0.0, difference, 0.0)
    for name, frame, back in (
        ("x = 0.1 mm", Frame(np.array([0.1, 0.0, 0.0]), np.eye(3)), Pose(x=-0.1)),
        ("rz = 37 deg", Frame(np.zeros(3), rotation_matrix(np.radians([0, 0, 37.0]))), Pose(rz=-37.0)),
    ):
        undone = Bench(target_frame=frame).field(back)
        # The sums over these few scatterers are exact to single precision of the kernel's accumulators.
        yield same_field("inverse motion", f"field of a target at {name}, moved back", undone, first, TOLERANCE)


CASES = (
    Case(displacements_far_below_an_atom),
    Case(rotations),
    Case(rotation_of_known_points),
    Case(motion_larger_than_the_spot),
    Case(out_of_the_beam),
    Case(behind_the_detector),
    Case(motion_and_its_inverse),
)
