"""What a sum is made of, written down so that anybody can check a field."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..geometry.pose import Pose
from ..machine.files import replacing
from ..machine.memory import excess
from ..machine.progress import tell
from .frame import LightOnDetector

BYTES_PER_LAYER = 24
"""Memory of a pixel of one scatterer's field while it is being written: complex128 and its two float32 channels."""


def source_layers(parts: Sequence[LightOnDetector], pose: Pose | None, count: int) -> dict[str, np.ndarray]:
    """Complex fields (rows, columns) of the first ``count`` scatterers alone, by the names of their layers.

    parts: of a frame; of several lasers or lines each has its own, called ``<its name>.source000`` and so on. Raises
    InputError where they take more memory than the machine has.
    """
    from .simulation import Simulation

    counts = [min(count, part.scatterers.count) for part in parts]
    if too_much := excess(sum(counts) * parts[0].assembly.detector.size * BYTES_PER_LAYER):
        raise InputError(f"--per-source {count}: the layers {too_much}")
    layers = {}
    for part, own in zip(parts, counts, strict=True):
        digits, simulation = max(3, len(str(own))), Simulation(replace(part.assembly, further=()))
        prefix = f"{part.assembly.light}." if len(parts) > 1 else ""
        for number in range(own):
            alone = part.scatterers.selected(np.array([number]))
            layers[f"{prefix}source{number:0{digits}d}"] = simulation.field_of(alone, pose)
            tell("layers", len(layers), sum(counts))
    return layers


def settings_of_sources(path: str | os.PathLike) -> object:
    """The settings with which ``--sources`` wrote a file; None where it did not."""
    try:
        with zipfile.ZipFile(path) as archive:
            return json.loads(archive.comment)
    except (OSError, ValueError, zipfile.BadZipFile):
        return None


def write_sources(path: str | os.PathLike, assembly, scatterers, settings: dict | None = None, parts=()) -> None:
    """Writes position, amplitude and pixel geometry, with which the field can be checked independently.

    In free space without a lobe the field is the sum of ``amplitude * exp(i k r) / r`` over ``position`` exactly. The
    settings stand in the archive's comment. parts: of a frame; of several lasers or lines each further one has arrays
    ``position.<name>``, ``amplitude.<name>`` and ``wavelength.<name>``.
    """
    grid, further = assembly.detector, {}
    for part in parts[1:]:
        if name := part.assembly.light:
            further[f"position.{name}"] = part.scatterers.position
            further[f"amplitude.{name}"] = part.scatterers.amplitude
            further[f"wavelength.{name}"] = part.assembly.beam.wavelength
    with replacing(path) as temporary, open(temporary, "w+b") as file:
        np.savez(
            file,
            position=scatterers.position,
            amplitude=scatterers.amplitude,
            pixel_origin=grid.origin,
            u=grid.u,
            v=grid.v,
            pitch=grid.pitch,
            wavelength=assembly.beam.wavelength,
            **further,
        )
        with zipfile.ZipFile(file, "a") as archive:
            archive.comment = json.dumps(settings or {}).encode()
