"""What a sweep is asked for, and what its frames gave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .slides import Slides

REFERENCE = "reference"
"""``dof`` of the frames at rest in sweep.csv."""


@dataclass(frozen=True)
class SweepSettings:
    """dofs: which motions; displacements: (n,) [mm or deg]; seeds: which surfaces; window: of the correlation [px]."""

    dofs: tuple[str, ...]
    displacements: np.ndarray
    seeds: tuple[int, ...]
    window: int | None


@dataclass(frozen=True)
class FrameRecord:
    """What one frame gave: a row of sweep.csv. Shifts and centres of gravity [um], NaN where not measured.

    sigma_u_um, sigma_v_um: standard uncertainties of the shifts, from the two images alone [um].
    """

    dof: str
    displacement: float
    unit: str
    seed: int
    shift_u_um: float
    shift_v_um: float
    shift_x_um: float
    shift_y_um: float
    ncc: float
    cog_u_um: float
    cog_v_um: float
    contrast: float
    seconds: float
    status: str
    sigma_u_um: float
    sigma_v_um: float


@dataclass
class SweepResult:
    """All frames of a sweep that are finished, and what was noticed on the way.

    by_number: their records by their place in the sweep; axes_as_seen: the detector's axes u, v as the target sees
    them, on which shifts along x and y rest; example: what the detector saw of the first surface at rest; slides: small
    pictures of that surface.
    """

    by_number: dict[int, FrameRecord] = field(default_factory=dict)
    stages: list[dict] = field(default_factory=list)
    numerical_error: float = 0.0
    warnings: dict[str, int] = field(default_factory=dict)
    example: np.ndarray | None = None
    axes_as_seen: dict[str, list[float]] = field(default_factory=dict)
    slides: Slides | None = None

    @property
    def records(self) -> list[FrameRecord]:
        """In the order of the sweep, whoever made the frames and when."""
        return [record for _, record in sorted(list(self.by_number.items()))]

    def note(self, header: Mapping) -> None:
        """Takes account of what one frame's header says. An unknown error (NaN) makes the whole's unknown."""
        self.stages = self.stages or header["plan"]
        self.numerical_error = float(np.maximum(self.numerical_error, header["numerical_error"]))
        for warning in header["warnings"]:
            self.warnings[warning] = self.warnings.get(warning, 0) + 1

    def values(self, dof: str, name: str, settings: SweepSettings) -> np.ndarray:
        """Column ``name`` of a motion's frames as (seeds, displacements), less the reference's for cog columns."""
        seeds = {seed: row for row, seed in enumerate(settings.seeds)}
        places = {displacement: column for column, displacement in enumerate(settings.displacements)}
        table = np.full((len(seeds), len(places)), np.nan)
        origin = np.zeros((len(seeds), 1))
        for record in self.records:
            row = seeds[record.seed]
            if record.dof == dof:
                table[row, places[record.displacement]] = getattr(record, name)
            elif record.dof == REFERENCE and name.startswith("cog_"):
                origin[row] = getattr(record, name)
        return table - origin


def frame_count(settings: SweepSettings) -> int:
    """Frames of a sweep, references included."""
    return frames_of(len(settings.seeds), len(settings.dofs), len(settings.displacements))


def frames_of(seeds: int, dofs: int, steps: int) -> int:
    return seeds * (1 + dofs * steps)
