"""Extremes of the surface: smooth to very rough, one and two scatterers, correlation lengths, curved targets."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...machine.interrupt import scratch_folder
from ...scene.write import write_points
from .case import Case, compared, same_field, within
from .scenes import WAVELENGTH, Bench, against_exact_sum

TOLERANCE = 1e-4
_UPRIGHT = Bench(laser_angle=0.0, laser={"wavefront_radius": np.inf})


def roughness(quick: bool):
    for rms in (0.0, 0.01, 1000.0) if quick else (0.0, 0.01, 0.1, 1.0, 30.0, 1000.0):
        bench = Bench(target={"roughness": rms})
        yield same_field("roughness", f"field of a surface of {rms:g} um", *against_exact_sum(bench), TOLERANCE)
        if rms > 0:
            heights = _UPRIGHT.with_(target={"roughness": rms, "point_sources": 2000}).frame().scatterers.position[:, 2]
            # Four standard errors of a standard deviation.
            bound = 4 / np.sqrt(2 * len(heights))
            name = f"rms height of a surface of {rms:g} um [um]"
            yield compared("roughness", name, heights.std() * 1e3, rms, bound, relative=True)


def correlation_length(quick: bool):
    for length in (0.001, 1000.0) if quick else (0.001, 1.0, 50.0, 1000.0, 1e6):
        bench = Bench(target={"correlation_length": length})
        name = f"field of a surface correlated over {length:g} um"
        yield same_field("correlation length", name, *against_exact_sum(bench), TOLERANCE)


def heights_of_a_correlated_surface(quick: bool):
    """rms slope of a Gaussian surface: sqrt(2) sigma / l; seen in the heights of close pairs over many surfaces."""
    bench = _UPRIGHT.with_(target={"roughness": 1.0, "correlation_length": 500.0, "point_sources": 40})
    assembly = bench.assembly()
    from ...scattering.rough_surface import illuminated_scatterers

    mean_square, expected, count = 0.0, 0.0, 60 if quick else 200
    for seed in range(count):
        points = illuminated_scatterers(
            assembly.with_seed(seed).target.surface, assembly.beam, assembly.target.frame
        ).position
        step = points[1:] - points[0]
        mean_square += float(np.mean(step[:, 2] ** 2)) / count
        squared = np.sum(step[:, :2] ** 2, axis=1)
        expected += float(np.mean(2 * 1e-6 * (1 - np.exp(-squared / 0.5**2)))) / count
    # One height pattern a surface: a mean square of some twenty to a hundred independent slopes.
    value, wanted = np.sqrt(mean_square) * 1e3, np.sqrt(expected) * 1e3
    yield compared(
        "correlation length", "rms height difference in the spot, l = 4 w [um]", value, wanted, 0.25, relative=True
    )


def specular_spot_of_a_smooth_surface(quick: bool):
    """Diffraction of a Gaussian spot: sum -> density pi / (1/w^2 - ik/2z) e^{ikz}/z on the axis (paraxial)."""
    bench = _UPRIGHT.with_(
        detector_distance=200.0,
        detector={"width": 1, "height": 1},
        target={"roughness": 0.0, "point_sources": 50_000},
    )
    assembly = bench.assembly()
    from ...field.simulation import simulate

    k, w, z = 2 * np.pi / WAVELENGTH, 0.12, 200.0
    turns = (z + assembly.beam.reference_path) / WAVELENGTH
    exact = assembly.target.surface.density * np.pi / (1 / w**2 - 0.5j * k / z) / z * np.exp(2j * np.pi * (turns % 1.0))
    # Jittered cells of 0.5 um sample the integral to a fraction of their number's root.
    yield same_field("smooth surface", "specular field on the axis", simulate(assembly).field, np.array([exact]), 5e-3)


def partially_developed_speckle(quick: bool):
    """Mean field and contrast where phases scatter by s = 2 k sigma (Goodman, Speckle Phenomena, ch. 3.4).

    Sum a_j e^{i phi_j} with Gaussian phases: mean S1 M1, variances S2 (1 + M2 - 2 M1^2)/2 and S2 (1 - M2)/2 in
    phase and in quadrature, M1 = e^{-s^2/2}, M2 = e^{-2 s^2}, S1 = sum a, S2 = sum a^2; many terms make it Gaussian.
    """
    from ...field.simulation import simulate_frame

    count = 150 if quick else 600
    for rms in (0.03, 0.1):
        bench = _UPRIGHT.with_(
            detector_distance=2000.0,
            laser={"beam_radius": 0.05},
            detector={"width": 1, "height": 1},
            target={"roughness": rms, "point_sources": 60},
        )
        assembly = bench.assembly()
        frames = [simulate_frame(assembly.with_seed(seed)) for seed in range(count)]
        fields = np.array([frame.image.field[0, 0] for frame in frames]) * 2000.0
        weights = [np.abs(frame.scatterers.amplitude) for frame in frames]
        s1, s2 = np.mean([w.sum() for w in weights]), np.mean([np.sum(w**2) for w in weights])
        phase = 4 * np.pi / WAVELENGTH * rms * 1e-3
        m1, m2 = np.exp(-(phase**2) / 2), np.exp(-2 * phase**2)
        real, imaginary = s2 * (1 + m2 - 2 * m1**2) / 2, s2 * (1 - m2) / 2
        mean = (s1 * m1) ** 2 + real + imaginary
        intensity = np.abs(fields) ** 2
        deviation = np.sqrt(4 * (s1 * m1) ** 2 * real + 2 * real**2 + 2 * imaginary**2)
        standard_error = deviation / mean / np.sqrt(count)
        name = f"{rms * 1e3:g} nm rough"
        yield compared("partial speckle", f"mean intensity, {name}", intensity.mean() / mean, 1.0, 4 * standard_error)
        # The contrast's own scatter is below that of the mean by its kurtosis: up to sqrt(2) of it.
        value, wanted = intensity.std() / intensity.mean(), deviation / mean
        yield compared("partial speckle", f"contrast, {name}", value, wanted, 4 * np.sqrt(2 / count) * max(wanted, 0.2))


def one_scatterer(quick: bool):
    """A spherical wave: e^{ikr}/r, in modulus and phase, wherever the point is."""
    for name, point in {"in the middle": (0.0, 0.0, 0.0), "10 mm aside": (10.0, -3.0, 0.5)}.items():
        with point_scatterers([point]) as path:
            bench = Bench(laser={"beam_radius": np.inf}, target=_only(path))
            yield same_field("one scatterer", f"field of a point {name}", *against_exact_sum(bench), TOLERANCE)
            modulus = np.abs(bench.with_(detector={"width": 1, "height": 1}).field()[0, 0])
            distance = np.linalg.norm(np.array([0, 0, 60.0]) - point)
            yield compared(
                "one scatterer", f"modulus 1/r, {name} [1/mm]", modulus, 1 / distance, TOLERANCE, relative=True
            )


def two_scatterers(quick: bool):
    """Fringes of wavelength times distance over separation, from the zeros of the intensity's oscillation."""
    for separation in (0.01, 1.0):
        spacing = WAVELENGTH * 60.0 / separation
        pitch = spacing / 16.3
        with point_scatterers([(-separation / 2, 0, 0), (separation / 2, 0, 0)]) as path:
            bench = Bench(
                laser_angle=0.0,
                laser={"beam_radius": np.inf, "wavefront_radius": np.inf},
                target=_only(path),
                detector={"width": 256, "height": 1, "pixel_pitch": pitch},
            )
            field = bench.field()[0]
        u = (np.arange(256) - 127.5) * pitch
        signal = np.abs(field) ** 2 * (60.0**2 + u**2) / 2 - 1
        rising = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
        zeros = rising - signal[rising] / (signal[rising + 1] - signal[rising])
        # The exact fringes are hyperbolas: path differences at the outermost zeros tell how many lie between.
        u_ends = np.interp(zeros[[0, -1]], np.arange(256), u)
        difference = np.hypot(u_ends + separation / 2, 60.0) - np.hypot(u_ends - separation / 2, 60.0)
        count = (difference[1] - difference[0]) / WAVELENGTH
        # Linear interpolation between 16 pixels a fringe misses a zero by up to 3e-3 of a fringe.
        yield compared("two scatterers", f"fringes counted, {separation:g} mm apart", count, len(zeros) - 1.0, 5e-3)


def curved_target(quick: bool):
    """A mesh of a spherical cap: the sum is exact, the scatterers lie on it but for facets and roughness."""
    radius = 5.0
    with scratch_folder() as folder:
        path = folder / "cap.ply"
        _write_cap(path, radius)
        bench = Bench(
            laser={"beam_radius": 0.3}, target={"filename": str(path), "roughness": 0.5, "point_sources": 200}
        )
        yield same_field("curved target", "field of a spherical cap", *against_exact_sum(bench), TOLERANCE)
        position = bench.frame().scatterers.position
    off = np.linalg.norm(position + [0, 0, radius], axis=1) - radius
    sagitta = 0.05**2 / 8 / radius  # of facets of 50 um
    yield within(
        "curved target",
        "rms height of scatterers [um]",
        off.std() * 1e3,
        0.5,
        abs(off.std() * 1e3 - 0.5),
        0.1 + sagitta * 1e3,
    )


def _write_cap(path: Path, radius: float) -> None:
    side = np.linspace(-1, 1, 41)
    x, y = np.meshgrid(side, side)
    vertices = np.stack([x.ravel(), y.ravel(), np.sqrt(radius**2 - x.ravel() ** 2 - y.ravel() ** 2) - radius], axis=1)
    corner = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + 42], axis=1),
            np.stack([corner, corner + 42, corner + 41], axis=1),
        ]
    )
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {c}" for c in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    lines = [*head, *(f"{a:.9g} {b:.9g} {c:.9g}" for a, b, c in vertices), *(f"3 {a} {b} {c}" for a, b, c in faces)]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


@contextmanager
def point_scatterers(points) -> Iterator[str]:
    """A CSV file of scatterers for the length of a block."""
    with scratch_folder() as folder:
        yield str(write_points(folder / "points.csv", points))


def _only(path: str) -> dict:
    return {"points": path, "roughness": 0.0}


CASES = (
    Case(roughness),
    Case(correlation_length),
    Case(heights_of_a_correlated_surface),
    Case(specular_spot_of_a_smooth_surface),
    Case(partially_developed_speckle),
    Case(one_scatterer),
    Case(two_scatterers),
    Case(curved_target),
)
