"""The entries of a sensitivity matrix by name: ``z.u`` is how far the pattern moves along u for a motion along z.

Of several detectors the name begins with the detector's: ``left.z.u``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import InputError
from ..experiments.expectation import AXES
from ..geometry.pose import DEGREES_OF_FREEDOM, sensitivity_unit


@dataclass(frozen=True)
class MatrixEntry:
    """One sensitivity: number of the detector, motion and axis; name: in results and files."""

    detector: int
    dof: str
    axis: str
    name: str

    @property
    def place(self) -> tuple[int, int, int]:
        """In arrays (detectors, axes, motions)."""
        return self.detector, AXES.index(self.axis), DEGREES_OF_FREEDOM.index(self.dof)

    @property
    def unit(self) -> str:
        """mm/mm or mm/deg."""
        return sensitivity_unit(self.dof)


def entries_of(detectors: Sequence[str]) -> list[MatrixEntry]:
    """All entries of some detectors, in the order of the arrays' detectors, motions, axes."""
    return [
        MatrixEntry(number, dof, axis, ".".join([*([detector] if len(detectors) > 1 else []), dof, axis]))
        for number, detector in enumerate(detectors) for dof in DEGREES_OF_FREEDOM for axis in AXES
    ]  # fmt: skip


def entry_named(name: str, detectors: Sequence[str], where: str) -> MatrixEntry:
    """The entry of a name. Raises InputError that begins with ``where``."""
    for entry in entries_of(detectors):
        if entry.name == name:
            return entry
    first = f"one of the detectors {', '.join(detectors)}, " if len(detectors) > 1 else ""
    raise InputError(
        f"{where}: must be {first}one of the motions {', '.join(DEGREES_OF_FREEDOM)} and one of the axes "
        f"{', '.join(AXES)}, with points between, such as {entries_of(detectors)[12].name}"
    )
