"""What a container or a job scheduler lets this process use: limits of Linux control groups, version 1 and 2.

A limit holds for a group and all groups in it: the tightest on the way from the process's own group to the root counts.
https://docs.kernel.org/admin-guide/cgroup-v2.html, https://docs.kernel.org/admin-guide/cgroup-v1/
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

PROCESS = Path("/proc/self")
"""Where the system says which groups the process is in (``cgroup``) and where their files lie (``mountinfo``)."""


def cpu_limit(process: Path = PROCESS) -> float:
    """Processor time per time that the process may take [cores], inf without a limit."""
    limits = [math.inf]
    for version, folder in _groups("cpu", process):
        if version == 2:
            quota, _, period = _content(folder / "cpu.max").partition(" ")
        else:
            quota, period = _content(folder / "cpu.cfs_quota_us"), _content(folder / "cpu.cfs_period_us")
        limits.append(_number(quota) / _number(period))
    return min(limits)


def memory_limit(process: Path = PROCESS) -> float:
    """Memory that the process may take [bytes], inf without a limit."""
    names = {1: "memory.limit_in_bytes", 2: "memory.max"}
    found = (_number(_content(folder / names[version])) for version, folder in _groups("memory", process))
    return min(found, default=math.inf)


def _groups(controller: str, process: Path) -> Iterator[tuple[int, Path]]:
    """Version and folder of the process's group, and of all groups around it, in every hierarchy with a controller."""
    own = {}
    for line in _content(process / "cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        own |= {name: path for name in controllers.split(",")}  # of version 2, one without a name
    for line in _content(process / "mountinfo").splitlines():
        fields, _, others = line.partition(" - ")
        kind, _, options = others.split(" ", 2)
        version = {"cgroup": 1, "cgroup2": 2}.get(kind)
        name = controller if version == 1 else ""
        if version is None or name not in own or (version == 1 and name not in options.split(",")):
            continue
        root, place = fields.split(" ")[3:5]
        inside = _below(PurePosixPath(own[name]), PurePosixPath(root))
        for group in (inside, *inside.parents):
            yield version, Path(place) / group


def _below(path: PurePosixPath, root: PurePosixPath) -> PurePosixPath:
    """A group's path from where its hierarchy is mounted; the mount itself where the path leads elsewhere.

    Inside a container, where paths may be told as they are outside it.
    """
    return path.relative_to(root) if path.is_relative_to(root) and ".." not in path.parts else PurePosixPath()


def _content(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def _number(text: str) -> float:
    """inf where a file says that there is no limit ("max", -1 or about 2^63) or is not there."""
    value = float(text) if text.lstrip("-").isdigit() else math.inf
    return value if 0 < value < 2.0**62 else math.inf
