"""A study as a list of independent jobs: each a pure function of its content, done anywhere, once.

    work = Work(frames_of, assembly)                  # frames_of(assembly) gives what does one item: a function of it
    jobs = [Job(work, (pose, seed)) for ...]
    with Journal(folder / "jobs") as done:
        for job, result in run(jobs, executor, done):  # those in the journal at once, the others as they come
            ...
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

from ..machine.fingerprint import fingerprint
from ..machine.journal import Journal
from ..version import __version__

WORKS_KEPT = 4
"""Works whose preparation a process keeps: jobs of one work mostly follow one another."""


@dataclass(frozen=True)
class Work:
    """What several jobs have in common.

    begin: a function or class at the top level of a module; ``begin(given)``, called once in every process that does
    such jobs, returns the function that is called with each job's item and returns its result. given: plain data that
    can be pickled, as assemblies are. key: of content and version, the same in every process.
    """

    begin: Callable[[object], Callable[[object], object]]
    given: object
    key: str = field(init=False, compare=False)

    def __post_init__(self) -> None:
        named = f"{self.begin.__module__}.{self.begin.__qualname__}"
        object.__setattr__(self, "key", fingerprint(__version__, named, self.given))


@dataclass(frozen=True)
class Job:
    """One call: item is plain data, as a pose, a seed or a mapping of values."""

    work: Work
    item: object

    @property
    def key(self) -> str:
        """Hash of everything that the result depends on."""
        return fingerprint(self.work.key, self.item)


class Executor(Protocol):
    """Does jobs somewhere."""

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, object]]:
        """Jobs with their results, as they come. Jobs are taken a few ahead, so that there may be any number."""


class InProcess:
    """Does jobs one after the other in this process, in their order."""

    def __init__(self) -> None:
        self._bench = Workplace()

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, object]]:
        for job in jobs:
            yield job, self._bench.result(job)


class Workplace:
    """Where a process does jobs: keeps what the last few works have prepared."""

    def __init__(self) -> None:
        self._prepared: dict[str, Callable[[object], object]] = {}

    def result(self, job: Job) -> object:
        """The result of a job."""
        return self.prepared(job.work)(job.item)

    def prepared(self, work: Work) -> Callable[[object], object]:
        """What does the jobs of a work."""
        if work.key not in self._prepared:
            while len(self._prepared) >= WORKS_KEPT:
                self._prepared.pop(next(iter(self._prepared)))
            self._prepared[work.key] = work.begin(work.given)
        return self._prepared[work.key]


def run(
    jobs: Iterable[Job], executor: Executor | None = None, done: Journal | None = None
) -> Iterator[tuple[Job, object]]:
    """Every job with its result: those that ``done`` holds at once, the others as the executor has them.

    executor: default: this process, in the jobs' order. done: an open journal, to which every result is added before it
    is given; results are then plain data, as they are read from it. What a job raises ends the study; a job whose
    failure is a result of the study returns it.
    """
    executor = InProcess() if executor is None else executor
    found: deque[tuple[Job, object]] = deque()

    def missing() -> Iterator[Job]:
        for job in jobs:
            if done is not None and (key := job.key) in done:
                found.append((job, done[key]))
            else:
                yield job

    for job, result in executor.results(missing()):
        while found:
            yield found.popleft()
        yield job, (result if done is None else done.add(job.key, result))
    yield from found
