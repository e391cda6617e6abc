"""``python -m speckle_mi.sysinfo``: versions and what of the machine is used."""

from __future__ import annotations

from collections.abc import Sequence

from .command_line import command, parser, print_json


def main(arguments: Sequence[str] | None = None) -> None:
    made = parser("sysinfo", "Prints versions, the LLVM found, variants and cores.", "--json")
    options = made.parse_args(arguments)
    from .machine.system import system_information

    information = system_information()
    print_json(options, information)
    if options.json:
        return
    width = max(map(len, information))
    for name, value in information.items():
        print(f"{name:<{width}}  {value}")


if __name__ == "__main__":
    raise SystemExit(command(main))
