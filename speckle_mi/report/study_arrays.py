"""Studies of many scenes as named arrays: ``results.nc``, with units and the scenes' text inside."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..experiments.expectation import AXES
from ..geometry.pose import DEGREES_OF_FREEDOM, sensitivity_unit
from ..machine.netcdf import NamedArray, write_netcdf
from ..studies.comparison import DesignComparison
from ..studies.design import Design
from ..studies.evaluation import Evaluation
from ..studies.optimisation import Optimum
from ..studies.uncertainty import UncertaintyResult
from ..version import __version__

MATRIX = ("detector", "axis", "motion")
UNITS = {"units": "mm/mm for translations, mm/deg for rotations: see sensitivity_unit"}


def write_uncertainty_arrays(path: str | os.PathLike, result: UncertaintyResult, design: Design) -> None:
    """Samples (their numbers, theory and frames) and, by entry of the matrix, what was made of them."""
    parameters, factors = result.tolerances.parameters, [one.name for one in result.tolerances.factors]
    shape = (len(result.detectors), len(AXES), len(DEGREES_OF_FREEDOM))

    def of_entries(value) -> np.ndarray:
        values = np.full(shape, np.nan)
        for one in result.entries.values():
            values[one.entry.place] = value(one)
        return values

    single = {
        "nominal": lambda one: one.nominal,
        "mean": lambda one: one.mean,
        "standard_uncertainty": lambda one: one.deviation,
        "standard_uncertainty_error": lambda one: one.deviation_error,
        "low": lambda one: one.interval[0],
        "high": lambda one: one.interval[1],
        "linear_uncertainty": lambda one: one.linear_deviation,
        "surface_uncertainty": lambda one: one.surfaces,
        "camera_uncertainty": lambda one: one.camera,
    }
    arrays = _coordinates(result.detectors) | _samples([one.found for one in result.samples], shape, len(result.seeds))
    arrays |= {
        "parameter": NamedArray(("parameter",), parameters),
        "factor": NamedArray(("factor",), factors),
        "surface": NamedArray(("surface",), list(result.seeds) or [-1]),
        "block": NamedArray(("sample",), [one.block for one in result.samples]),
        "row": NamedArray(("sample",), [one.row for one in result.samples]),
        "value": NamedArray(
            ("sample", "parameter"), [list(one.values.values()) for one in result.samples],
            {"units": "as in the scene", "long_name": "number of the scene"},
        ),
        **{name: NamedArray(MATRIX, of_entries(value), UNITS) for name, value in single.items()},
        "linear": NamedArray(
            ("parameter", *MATRIX), [of_entries(lambda one, name=name: one.linear[name]) for name in parameters], UNITS
        ),
        **{
            kind: NamedArray(
                ("factor", *MATRIX),
                [of_entries(lambda one, name=name: getattr(one, kind)[name][0]) for name in factors], {"units": "1"},
            )
            for kind in ("first_order", "total")
        },
    }  # fmt: skip
    write_netcdf(path, arrays, _attributes("uncertainty", {"scene": design}))


def write_comparison_arrays(path: str | os.PathLike, found: DesignComparison) -> None:
    """Figures of every assembly by scene and swept numbers, and the matrices that they are made of."""
    scenes = list(dict.fromkeys(one.candidate.scene for one in found.compared))
    grid = tuple(len(one.values) for one in found.swept)
    dims = ("scene", *(_plain(one.name) for one in found.swept))
    names = list(found.compared[0].figures)
    shape = (len(found.detectors), len(AXES), len(DEGREES_OF_FREEDOM))
    surfaces = max(len(one.measured) for one in found.evaluations)
    held = _samples(found.evaluations, shape, surfaces)

    def on_grid(values) -> np.ndarray:
        values = np.asarray(values)
        return values.reshape(len(scenes), *grid, *values.shape[1:])

    kinds = {
        "value": lambda figure: figure.value,
        "low": lambda figure: figure.interval[0],
        "high": lambda figure: figure.interval[1],
        "expected": lambda figure: figure.theory,
    }
    arrays = _coordinates(found.detectors) | {
        "scene": NamedArray(("scene",), scenes),
        **{_plain(one.name): NamedArray((_plain(one.name),), one.values, {"long_name": one.name})
           for one in found.swept},
        "figure": NamedArray(("figure",), names),
        "figure_unit": NamedArray(("figure",), [one.name.unit or "1" for one in found.compared[0].figures.values()]),
        **{
            kind: NamedArray((*dims, "figure"),
                             on_grid([[value(figure) for figure in one.figures.values()] for one in found.compared]),
                             {"units": "see figure_unit"})
            for kind, value in kinds.items()
        },
        "rank": NamedArray(dims, on_grid([one.rank for one in found.compared])),
        "verdict": NamedArray(dims, on_grid([one.verdict for one in found.compared])),
        **{
            name: NamedArray((*dims, *one.dims[1:]), on_grid(one.values), one.attributes)
            for name, one in held.items()
        },
    }  # fmt: skip
    designs = {one.candidate.scene: one.candidate.design for one in found.compared}
    write_netcdf(path, arrays, _attributes("comparison", designs))


def write_optimum_arrays(path: str | os.PathLike, found: Optimum, design: Design) -> None:
    """Every trial: its numbers, figures, by how much it exceeds limits, and whether it is of the best."""
    names = list(dict.fromkeys(one.text for one in found.goals.figures))
    units = {one.text: one.unit or "1" for one in found.goals.figures}
    best = {id(one) for one in found.front}
    figures = [[one.figures[name].best if name in one.figures else np.nan for name in names] for one in found.trials]
    arrays = {
        "parameter": NamedArray(("parameter",), [one.name for one in found.free]),
        "bounds": NamedArray(("parameter", "end"), [[one.low, one.high] for one in found.free]),
        "end": NamedArray(("end",), ["low", "high"]),
        "figure": NamedArray(("figure",), names),
        "figure_unit": NamedArray(("figure",), [units[name] for name in names]),
        "value": NamedArray(
            ("trial", "parameter"), [list(one.values.values()) for one in found.trials], {"units": "as in the scene"}
        ),
        "result": NamedArray(("trial", "figure"), figures, {"units": "see figure_unit"}),
        "exceeds": NamedArray(
            ("trial",), [one.violation for one in found.trials],
            {"units": "1", "long_name": "sum of what limits are exceeded by, relative to them"},
        ),
        "best": NamedArray(("trial",), [int(id(one) in best) for one in found.trials]),
    }  # fmt: skip
    write_netcdf(path, arrays, _attributes("optimisation", {"scene": design}))


def _coordinates(detectors: Sequence[str]) -> dict[str, NamedArray]:
    return {
        "detector": NamedArray(("detector",), list(detectors)),
        "axis": NamedArray(("axis",), list(AXES)),
        "motion": NamedArray(("motion",), list(DEGREES_OF_FREEDOM)),
        "sensitivity_unit": NamedArray(("motion",), [sensitivity_unit(dof) for dof in DEGREES_OF_FREEDOM]),
    }


def _samples(found: Sequence[Evaluation], shape: tuple[int, int, int], surfaces: int) -> dict[str, NamedArray]:
    """Theory (sample, detector, axis, motion) and measured (sample, surface, ...), NaN where there is none."""
    theory = np.full((len(found), *shape), np.nan)
    measured = np.full((len(found), max(surfaces, 1), *shape), np.nan)
    for number, one in enumerate(found):
        if not one.failed:
            theory[number] = one.theory
            measured[number, : len(one.measured)] = one.measured
    return {
        "theory": NamedArray(("sample", *MATRIX), theory, UNITS),
        "measured": NamedArray(("sample", "surface", *MATRIX), measured, UNITS),
    }


def _plain(name: str) -> str:
    """A name that a dimension can have."""
    return name.replace(".", "_")


def _attributes(kind: str, designs: Mapping[str, Design]) -> dict[str, str]:
    """What a file says of itself: the scenes' text and what was changed in it by ``-D``."""
    texts = {}
    for number, (name, design) in enumerate(designs.items()):
        end = "" if len(designs) == 1 else f"_{number}"
        text = Path(design.path).read_text(encoding="utf-8", errors="replace")
        texts |= {f"scene_text{end}": text, f"scene_name{end}": name if len(designs) > 1 else Path(design.path).stem,
                  f"scene_defaults{end}": json.dumps(dict(design.defaults))}  # fmt: skip
    return {"title": f"speckle_mi {kind}", "source": f"speckle_mi {__version__}", **texts}
