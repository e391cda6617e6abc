"""One frame of the convergence study: the way it is made, and the row it becomes."""

from __future__ import annotations

from dataclasses import dataclass, replace

PAPER_RAYS = 1500
"""Rays a source in Opt. Eng. 61(6) 061410 (2022), doi:10.1117/1.OE.61.6.061410."""

MEASURED, LEFT_OUT, DOES_NOT_APPLY = "measured", "left out", "does not apply"


@dataclass(frozen=True)
class Setting:
    """One way of making the frame: method, N1, and its accuracy: tolerance, or rays a source N2."""

    method: str
    point_sources: int
    tolerance: float | None = None
    rays_per_source: int | None = None

    @property
    def accuracy(self) -> str:
        if self.rays_per_source is not None:
            return f"N2 = {self.rays_per_source}" + (" (paper)" if self.rays_per_source == PAPER_RAYS else "")
        return "" if self.tolerance is None else f"{self.tolerance:.0e}"

    def of(self, assembly):
        """The assembly with this method, this N1 and one sample a pixel."""
        asked = {name: value for name in ("tolerance", "rays_per_source") if (value := getattr(self, name)) is not None}
        made = with_point_sources(assembly, self.point_sources).with_options(method=self.method, **asked)
        return replace(made, sub_pixels=1)


def with_point_sources(assembly, count: int):
    """The assembly with ``count`` scatterers expected inside the beam's 1/e^2 footprint (or on the whole target).

    assembly: as it comes from its scene, whose N1 the density is scaled from. A target made of the user's own points
    keeps them.
    """
    target = assembly.target
    density = target.surface.density * count / target.point_sources
    return replace(assembly, target=replace(target, surface=replace(target.surface, density=density)))


@dataclass(frozen=True)
class Row:
    """What one setting gave: a row of converge.csv; None where there is nothing to tell.

    plan: how the field was summed; scatterers: summed, those between once and three times the beam's radius included;
    field_error: relative L2, phase_error_wavelengths: rms where the intensity is above a tenth of its mean, both on the
    sampled pixels; shift_error_um against the most exact frames, shift_theory_error_um against first-order theory;
    seconds_*: of a warm frame, from scatterers to field (quartiles over ``runs``), and of the first one;
    peak_memory_mb: of the process in the first run, added_memory_mb: over what it held before; opening_nodes: on the
    last opening that was summed to.
    """

    scene: str
    plan: str
    method: str
    point_sources: int
    scatterers: int | None
    rays_per_source: int | None
    tolerance: float | None
    status: str
    note: str = ""
    field_error: float | None = None
    phase_error_wavelengths: float | None = None
    shift_u_um: float | None = None
    shift_v_um: float | None = None
    shift_error_um: float | None = None
    shift_theory_error_um: float | None = None
    seconds_median: float | None = None
    seconds_q1: float | None = None
    seconds_q3: float | None = None
    runs: int | None = None
    seconds_first: float | None = None
    peak_memory_mb: float | None = None
    added_memory_mb: float | None = None
    numerical_error: float | None = None
    opening_nodes: int | None = None

    @property
    def accuracy(self) -> str:
        return Setting(self.method, self.point_sources, self.tolerance, self.rays_per_source).accuracy
