"""What the commands share: flags, loading a scene, and errors as one line with an exit status."""

from __future__ import annotations

import argparse
import math
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import NoReturn

from .errors import InputError
from .machine import interrupt
from .scene.errors import one_line

DONE, FAULT, BAD_INPUT = 0, 1, 2
"""Exit statuses; one that is interrupted ends with 130."""


def command(main: Callable[[Sequence[str] | None], int | None], arguments: Sequence[str] | None = None) -> int:
    """Runs a command's ``main`` and returns its exit status.

    Bad input (InputError, OSError, too little memory) becomes one line on stderr and status 2, any other error one line
    that says that the fault is ours and status 1; with ``--debug`` the traceback is shown as well. An interrupt ends
    the process with status 130. Without ``arguments`` it is the process's own command and takes those of the process.
    """
    is_own = arguments is None
    with interrupt.answered(afterwards_ignored=is_own):
        return _status(main, sys.argv[1:] if is_own else list(arguments))


def _status(main: Callable[[Sequence[str] | None], int | None], arguments: list[str]) -> int:
    try:
        with warnings.catch_warnings():
            if "--debug" not in arguments:
                warnings.simplefilter("ignore")  # libraries warn of what their callers handle; users cannot act on it
            status = main(arguments) or DONE
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader of our output has gone; nothing more can be said on it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except (InputError, OSError, MemoryError) as error:
        _show_traceback(arguments)
        print(f"error: {one_line(error)}", file=sys.stderr)
        return BAD_INPUT
    except Exception as error:
        _show_traceback(arguments)
        what = f"{type(error).__name__}: {one_line(error)}" if str(error) else type(error).__name__
        print(
            f"internal error: {what} (no fault of your input but of speckle_mi: please report what --debug shows)",
            file=sys.stderr,
        )
        return FAULT


def _show_traceback(arguments: Sequence[str]) -> None:
    if "--debug" in arguments:
        import traceback

        traceback.print_exc()


class _Once(argparse.Action):
    """Stores a flag's value; refuses a second one, which would silently take the place of the first."""

    is_given = False

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        if self.is_given:
            raise argparse.ArgumentError(self, "is given twice, must be given once")
        self.is_given = True
        setattr(namespace, self.dest, values)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are InputErrors of one line, as those of everything after it."""

    def __init__(self, *arguments, **named) -> None:
        super().__init__(*arguments, **named)
        for name in (None, "store"):
            self.register("action", name, _Once)
        self.register("type", int, _whole_number)
        self.register("type", float, _number)

    def parse_args(self, args=None, namespace=None):
        """As argparse; with ``--json`` nothing but JSON is printed."""
        options = super().parse_args(args, namespace)
        options.quiet |= options.json
        return options

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message.removeprefix('argument ')} (see --help)")


def _whole_number(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number") from None


def parser(name: str, description: str, example: str = "") -> argparse.ArgumentParser:
    """Parser for ``python -m speckle_mi.<name>`` with the flags that every command knows.

    Its ``parse_args`` raises InputError. Lines of the description stay as they are. example: what the command may be
    given, shown with its help.
    """
    program = f"python -m speckle_mi.{name}".removesuffix(".")
    made = _Parser(
        prog=program, description=description, allow_abbrev=False, epilog=f"example:\n  {program} {example}".rstrip(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    made.add_argument("--quiet", action="store_true", help="print errors only")
    made.add_argument("--json", action="store_true", help="print what was found as JSON, and nothing else")
    made.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return made


def scene_parser(name: str, description: str, example: str = "") -> argparse.ArgumentParser:
    """:func:`parser` for commands that take a scene."""
    from .machine.backend import DEFAULT_VARIANT

    made = parser(name, description, example)
    made.add_argument("scene", metavar="SCENE", help="Mitsuba XML scene file")
    made.add_argument(
        "-D", dest="defaults", metavar="NAME=VALUE", action="append", default=[],
        help="value of a <default> of the scene (may be repeated; of one name the last counts)",
    )
    made.add_argument("--variant", default=DEFAULT_VARIANT, help="Mitsuba variant (default: %(default)s)")
    return made


def add_detector(made: argparse.ArgumentParser, default: str = "all of them") -> None:
    """The flag of every command that looks at a scene's detectors, for ``assemblies_from_scene``."""
    made.add_argument("--detector", metavar="ID", help=f"id of the one detector to look at (default: {default})")


def add_images(made: argparse.ArgumentParser) -> None:
    """The flag of every command that writes what a camera saves."""
    made.add_argument("--images", choices=("png", "tiff"), help="also write what the detector's camera saves")


def add_force(made: argparse.ArgumentParser) -> None:
    """The flag of every command that writes results."""
    help_text = "overwrite results that were made with other settings; begin frames of more than 10 minutes"
    made.add_argument("--force", action="store_true", help=help_text)


def add_range(made: argparse.ArgumentParser, what: str) -> None:
    """The flag of every command that is about a range of motions, for :func:`require_range`."""
    help_text = f"{what}, mm or deg (default: %(default)s)"
    made.add_argument("--range", type=float, default=0.2, help=help_text)


def add_scheduler(made: argparse.ArgumentParser) -> None:
    """The flag of every study: who does its jobs, for ``execution.executor_of``."""
    made.add_argument(
        "--scheduler", metavar="S",
        help="have the work done by N processes of this machine (local:N), or by the workers of a dask scheduler "
        "(tcp://host:8786); needs the extra 'cluster' (default: this process)",
    )  # fmt: skip


def add_execution(made: argparse.ArgumentParser) -> None:
    """The flags of every study that parts of can be done apart: besides, which one, for ``execution.Shard``."""
    add_scheduler(made)
    made.add_argument(
        "--shard", metavar="I/N",
        help="do the I-th of N parts only, beside others with the same DIR; the last one to end writes the results",
    )  # fmt: skip


SURFACES = 8
"""Surfaces that sensitivities are measured on unless asked otherwise."""


def add_motions(made: argparse.ArgumentParser, what: str) -> None:
    """The flag of every command that is about some of the six motions."""
    from .geometry.pose import DEGREES_OF_FREEDOM

    everything = ",".join(DEGREES_OF_FREEDOM)
    made.add_argument("--dof", default=everything, metavar=everything, help=f"{what} (default: all six)")


def add_surfaces(made: argparse.ArgumentParser) -> None:
    """The flag of every command that measures on several surfaces, for :func:`surfaces_of`."""
    help_text = f"number of surfaces (default: {SURFACES}, or 1 where the scene has its own points)"
    made.add_argument("--seeds", type=int, default=None, help=help_text)


def add_precision(made: argparse.ArgumentParser) -> None:
    """The flag of every command that adds surfaces until intervals are small, for ``Precision.parse``."""
    made.add_argument(
        "--precision", metavar="P",
        help="add surfaces until no 95%% interval along u or v is wider than +- P: 1%% of the largest sensitivity to a "
        "motion of the same kind, 0.01mm/mm, 0.02mm/deg, or several of these with commas",
    )  # fmt: skip


def surfaces_of(assembly, arguments: argparse.Namespace) -> int:
    """How many surfaces are asked for, with --precision at first; the user's own points are one, whatever its seed.

    Raises InputError.
    """
    precision = getattr(arguments, "precision", None)
    if assembly.target.points is None:
        count = SURFACES if arguments.seeds is None else arguments.seeds
        if precision is not None and count < 2:
            raise InputError(f"--seeds {count}: must be at least 2 with --precision, which rests on their scatter")
        return count
    if precision is not None:
        raise InputError(
            f"--precision {precision}: the target's own points are one surface, and no seed makes another: leave it out"
        )
    if arguments.seeds is not None and arguments.seeds > 1:
        raise InputError(
            f"--seeds {arguments.seeds}: must be 1, the target's own points are one surface and no seed makes another"
        )
    return 1


def require_range(arguments: argparse.Namespace) -> None:
    """InputError where the width of a range of motions is none."""
    if not 0 < arguments.range < math.inf:
        raise InputError(f"--range {arguments.range:g}: must be a finite number above 0 (mm or deg)")


def line_of(name: str, given: Sequence[str] | None) -> str:
    """The command line that does the same again."""
    import shlex

    return shlex.join(["python", "-m", f"speckle_mi.{name}", *(given or ())])


def print_json(arguments: argparse.Namespace, content: object) -> None:
    """Prints what was found as JSON where the user asked for it; what is not finite is null."""
    if arguments.json:
        import json

        from .machine.files import plain

        print(json.dumps(plain(content), allow_nan=False), flush=True)


def say(arguments: argparse.Namespace, text: str) -> None:
    """Prints a line unless the user asked for quiet."""
    if not arguments.quiet:
        print(text, flush=True)
