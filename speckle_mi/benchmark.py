"""``python -m speckle_mi.benchmark``: how fast the sums are, beside peers measured in the same run.

    python -m speckle_mi.benchmark [--quick] [--shifts] [--out FILE.json]

The paper's tilted laser (744 x 480 pixels of 6 um at 60 mm, beam radius 0.12 mm). Ours: the coherent sum ``auto`` at
1e-4 and ``direct``. Peers: the float64 sum vectorised in NumPy, the same compiled by numba on all cores (if numba is
installed), and FINUFFT used plainly with the Fresnel approximation. A peer that would take too long sums a part of the
pixels and is scaled up, which the table marks. Times are medians of warm runs, errors relative L2 against the float64
sum on sampled pixels.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict

from .command_line import add_force, command, parser, print_json, say

SCATTERERS, QUICK_SCATTERERS = (100, 1_000, 10_000, 100_000, 1_000_000), (100, 1_000)
PIXELS, QUICK_PIXELS = (744, 480), (186, 120)

PEER_SECONDS, QUICK_PEER_SECONDS = 2.0, 0.3
"""A peer sums as many pixels as it manages in about this time, and is scaled to all."""


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parser().parse_args(arguments)
    # Not at the top: a command answers interrupts before it imports what takes time.
    from .machine.files import identity_in, refuse_other_settings, require_output
    from .machine.system import system_information
    from .report.terminal import print_machine, terminal

    identity = {"quick": options.quick, "variant": options.variant, **({"shifts": True} if options.shifts else {})}
    if options.out is not None:
        require_output(options.out, ".json")
        refuse_other_settings(options.out, identity_in(options.out), identity, options.force)
    if options.shifts:
        return _compare_shifts(options, identity)
    from .validation.benchmark.specimen import Specimen

    specimen = Specimen.of(_assembly(options))
    console, system = terminal(options.quiet), system_information() | {"numba": _numba_version()}
    print_machine(console, system)
    pixels = list(specimen.grid.shape[::-1])
    _measure(options, specimen, console, {"identity": identity, "pixels": pixels, "system": system})


def _compare_shifts(options, identity: dict) -> None:
    """The measurement of shifts beside public programs."""
    from .machine.files import write_json
    from .machine.system import system_information
    from .report.terminal import print_machine, print_table, terminal
    from .validation.shifts.study import QUICK_PAIRS, QUICK_SIZES, compare_shifts, table, title

    console, system = terminal(options.quiet), system_information()
    print_machine(console, system)
    rows = []
    for row in compare_shifts(**({"sizes": QUICK_SIZES, "pairs": QUICK_PAIRS} if options.quick else {})):
        noise = "no noise" if row.photons is None else f"{row.photons:g} photons"
        say(options, f"window {row.window} px, speckle {row.size:g} px, {noise} ...")
        rows.append(row)
        if options.out:
            write_json(options.out, {"identity": identity, "system": system, "shifts": [asdict(row) for row in rows]})
    heads, cells = table(rows)
    print_table(console, heads, cells, title=title(rows), left=(), group_by=0)
    print_json(options, {"identity": identity, "system": system, "shifts": [asdict(row) for row in rows]})


def _measure(options, specimen, console, content: dict) -> None:
    """Measures part after part; each is shown and kept when it is done: an interrupt loses no more than its own."""
    from .machine.files import write_json
    from .validation.benchmark.pieces import pieces
    from .validation.benchmark.scaling import costs, scaling
    from .validation.benchmark.sums import TOLERANCE, Entry, sums
    from .validation.benchmark.tables import print_costs, print_pieces, print_scaling, print_sums

    def keep(name: str, figures: object) -> None:
        content[name] = figures
        if options.out:
            write_json(options.out, content)

    begin = time.perf_counter()
    counts = QUICK_SCATTERERS if options.quick else SCATTERERS
    content["tolerance"] = TOLERANCE
    entries: list[Entry] = []
    for count in counts:
        say(options, f"sums of {count:,} scatterers ...")
        entries += sums(specimen, count, QUICK_PEER_SECONDS if options.quick else PEER_SECONDS)
        keep("sums", [asdict(entry) for entry in entries])
    print_sums(console, specimen.grid.shape, entries)
    for name, doing, measure, show in (
        ("scaling", "scaling ...", lambda: scaling(specimen, counts), print_scaling),
        ("costs", "costs ...", costs, print_costs),
        ("pieces", "everything around the sums ...", lambda: pieces(specimen, options.quick), print_pieces),
    ):
        say(options, doing)
        figures = measure()
        keep(name, figures)
        show(console, figures)
    print_json(options, content)
    say(options, f"{time.perf_counter() - begin:.0f} s in all")


def _parser():
    from .machine.backend import DEFAULT_VARIANT

    made = parser("benchmark", "Measures speed and error beside peers, in one run.", "--quick --out speed.json")
    made.add_argument("--out", metavar="FILE.json", help="also write the figures as JSON")
    made.add_argument(
        "--quick", action="store_true", help="few scatterers, few pixels: does it work, not how fast is it"
    )
    made.add_argument("--shifts", action="store_true", help="the measurement of shifts beside other programs, alone")
    add_force(made)
    made.add_argument("--variant", default=DEFAULT_VARIANT, help="Mitsuba variant (default: %(default)s)")
    return made


def _assembly(options):
    """The tilted laser, on few pixels if it is to be quick."""
    import mitsuba as mi

    from .machine.backend import set_variant
    from .scene.read import assembly_from_scene
    from .validation.benchmark.specimen import SCENE

    set_variant(options.variant)
    mi.set_log_level(mi.LogLevel.Error)
    width, height = QUICK_PIXELS if options.quick else PIXELS
    return assembly_from_scene(mi.load_string(SCENE, width=str(width), height=str(height)))


def _numba_version() -> str:
    try:
        import numba
    except ImportError:
        return "not installed"
    return numba.__version__


if __name__ == "__main__":
    raise SystemExit(command(main))
