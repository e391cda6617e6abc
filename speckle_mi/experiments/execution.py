"""Who does the jobs of a study, as it is asked for in words: this process, workers of a cluster, a share of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec

from ..errors import InputError
from .jobs import Executor, InProcess

SCHEDULERS = "local:N (N processes here) or the address of a dask scheduler, such as tcp://host:8786"

MOST_LOCAL = 256


def require_scheduler(text: str | None) -> None:
    """InputError for words that name no scheduler, or where the package for it is not installed."""
    if text is None:
        return
    if _local(text) is None and not re.fullmatch(r"(tcp|tls|ucx|ws|wss)://[^\s/:]+(:\d+)?", text):
        raise InputError(f"--scheduler {text!r}: must be {SCHEDULERS}")
    if find_spec("distributed") is None:
        raise InputError(f"--scheduler {text}: needs dask.distributed, pip install 'speckle_mi[cluster]' brings it")


@contextmanager
def executor_of(scheduler: str | None, threads: int = 1) -> Iterator[Executor]:
    """What :func:`jobs.run` takes: this process with so many ``threads`` (see :class:`InProcess`), or a cluster.

    scheduler: None, ``local:N`` or the address of a scheduler. Raises as :func:`require_scheduler`, OSError where no
    scheduler answers. Workers take the Mitsuba variant that is active in this process.
    """
    require_scheduler(scheduler)
    if scheduler is None:
        yield InProcess(threads)
        return
    from .cluster import cluster_at, cluster_here

    count = _local(scheduler)
    with cluster_at(scheduler) if count is None else cluster_here(count) as executor:
        yield executor


def _local(text: str) -> int | None:
    """N of ``local:N``, None of anything else."""
    match = re.fullmatch(r"local:(\d+)", text)
    if match is None:
        return None
    if not 1 <= int(match[1]) <= MOST_LOCAL:
        raise InputError(f"--scheduler {text}: must be local:1 to local:{MOST_LOCAL}")
    return int(match[1])


@dataclass(frozen=True)
class Shard:
    """One of ``count`` parts of a study's jobs, number 1 to ``count``: the jobs of each follow one another."""

    number: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str | None) -> Shard:
        """From ``"2/8"``; the whole from None. Raises InputError."""
        if text is None:
            return cls()
        match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise InputError(f"--shard {text!r}: must be i/n, the i-th of n parts, such as 2/8")
        return cls(int(match[1]), int(match[2]))

    def takes(self, place: int, total: int) -> bool:
        """Whether the job at ``place`` of ``total``, from 0, is one of this part's."""
        return place * self.count // total == self.number - 1

    @property
    def is_whole(self) -> bool:
        return self.count == 1

    @property
    def journal(self) -> str:
        """Name of the journal that this part adds to."""
        return "jobs" if self.is_whole else f"jobs{self.number}of{self.count}"


WHOLE = Shard()
