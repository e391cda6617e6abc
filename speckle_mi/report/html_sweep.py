"""The report of a sweep: what it was asked for and what it found, as one page."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..experiments.layout import Layout
from ..experiments.sweep_result import SweepResult, SweepSettings
from ..machine.files import replacing
from ..machine.run_times import duration
from ..scene.assembly import Assembly
from .drawing import layout_svg
from .html import Section, page, paragraphs, text
from .html_facts import asked, machine, parameters, stages
from .html_figures import decorrelation_figures, shift_figures
from .html_matrix import cross_talk, paper_table, sensitivity_tables
from .html_slides import slides


@dataclass(frozen=True)
class SweepReport:
    """What the page is made of: assemblies, results and summaries by detector; the layout; the command line that
    reproduces it; and the scene's text."""

    assemblies: Mapping[str, Assembly]
    settings: SweepSettings
    results: Mapping[str, SweepResult]
    summaries: Mapping[str, dict]
    layout: Layout
    command: str
    scene: str


def write_report(path: str | os.PathLike, found: SweepReport) -> None:
    """Writes the page, whole or not at all."""
    written = sweep_page(found)
    with replacing(path) as temporary:
        temporary.write_text(written, encoding="utf-8")


def sweep_page(found: SweepReport) -> str:
    """The page as HTML."""
    first = next(iter(found.summaries.values()))
    scene = Path(first["scene"]).name
    sections = [
        Section("Assembly", _drawing(found.layout, scene), "assembly"),
        Section("Plan and parameters", _plan(found), "plan"),
    ]
    for name, summary in found.summaries.items():
        sections += _of_detector(name, summary, found)
    sections.append(Section("Errors and time", _errors(found.summaries), "errors"))
    sections.append(Section("Versions and command", _reproduced(found, first), "command"))
    return page(f"{scene}: speckle displacement", _lead(found, first), sections, {"summary": _carried(found.summaries)})


def _of_detector(name: str, summary: dict, found: SweepReport) -> list[Section]:
    """The sections that every detector has for itself."""
    several = len(found.summaries) > 1
    of, end = (f" of {name}", f"-{name}") if several else ("", "")
    settings, result, curves = found.settings, found.results[name], summary["curves"]
    sections = [
        Section(f"Sensitivity{of}", sensitivity_tables(summary) + paper_table(summary["paper"]), f"sensitivity{end}"),
        Section(f"Theory and cross-talk{of}", cross_talk(summary, settings), f"crosstalk{end}"),
        Section(f"Shifts and residuals{of}", shift_figures(summary["fits"], settings, result), f"shifts{end}"),
        Section(f"Decorrelation{of}", decorrelation_figures(curves, settings, result), f"decorrelation{end}"),
    ]
    if result.slides is not None and result.slides.rest is not None:
        pitch = found.assemblies[name].detector.pitch
        sections.append(Section(f"Speckle and field{of}", slides(result, settings, pitch), f"speckle{end}"))
    return sections


def _lead(found: SweepReport, first: dict) -> str:
    settings, names = found.settings, list(found.summaries)
    detectors = f", detectors {', '.join(names)}" if len(names) > 1 else ""
    ends = settings.displacements.min(), settings.displacements.max()
    width = f"{ends[1] - ends[0]:g}"
    said = (f"The target moved through {', '.join(settings.dofs)} over {width} mm or degrees in "
            f"{len(settings.displacements)} displacements, {len(settings.seeds)} surfaces{detectors}.")  # fmt: skip
    warnings = {warning for summary in found.summaries.values() for warning in summary["warnings"]}
    return paragraphs([said]) + paragraphs([f"Warning: {one}" for one in sorted(warnings)], "warning")


def _drawing(layout: Layout, title: str) -> str:
    return f'<div class="drawing">{layout_svg(layout, title)}</div>'


def _plan(found: SweepReport) -> str:
    frames = len(next(iter(found.results.values())).records)
    defaults = next(iter(found.summaries.values()))["defaults"]
    return (
        stages(found.summaries)
        + "<h3>Parameters</h3>"
        + parameters(found.assemblies, found.layout.facts)
        + "<h3>Asked for</h3>"
        + asked(found.settings, frames, defaults)
    )


def _errors(summaries: Mapping[str, dict]) -> str:
    lines = []
    for name, summary in summaries.items():
        of = f"Detector {name}: " if len(summaries) > 1 else ""
        error = summary["numerical_error"]
        known = f"at most {error:.1e} (relative L2, estimated)" if error == error else "not known"
        lines.append(
            f"{of}Numerical error of the field {known}; {1e3 * summary['seconds_per_frame']:.3g} ms a frame (median); "
            f"{summary['frames_without_shift']} of {summary['frames']} frames without a significant shift."
        )
    lines += [
        f"{duration(next(iter(summaries.values()))['seconds_total'])} in all.",
        "Numerical error is that of the simulation. Bias is the mean over surfaces less first-order theory. Scatter is "
        "the spread of shifts over surfaces: the sensor's own limit, which any correct simulation shows.",
    ]
    return paragraphs(lines)


def _reproduced(found: SweepReport, first: dict) -> str:
    return (
        f"<pre>{text(found.command)}</pre>"
        + machine(first["system"])
        + f'<details><summary>the scene, {text(first["scene"])}</summary><pre class="scene">{text(found.scene)}</pre>'
        "</details>"
    )


def _carried(summaries: Mapping[str, dict]) -> dict:
    """What programs may read: the sensitivities by detector."""
    return {name: summary["sensitivity"] for name, summary in summaries.items()}
