"""A study as a list of independent jobs: each a pure function of its content, done anywhere, once.

    work = Work(frames_of, assembly)                  # frames_of(assembly) gives what does one item: a function of it
    jobs = [Job(work, (pose, seed)) for ...]
    with Journal(folder / "jobs") as done:
        for job, result in run(jobs, executor, done):  # those in the journal at once, the others as they come
            ...
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice
from typing import Protocol

from ..machine.backend import kernels_beside
from ..machine.cores import keep_to_one_core, products_on_one_thread
from ..machine.fingerprint import fingerprint
from ..machine.journal import Journal
from ..version import __version__

WORKS_KEPT = 4
"""Works whose preparation a process keeps: jobs of one work mostly follow one another."""

AHEAD = 2
"""Jobs a thread that are begun or wait to be: the next one is there when one is done, and few results wait."""


@dataclass(frozen=True)
class Work:
    """What several jobs have in common.

    begin: a function or class at the top level of a module; ``begin(given)``, called once in every process that does
    such jobs, returns the function that is called with each job's item and returns its result. given: plain data that
    can be pickled, as assemblies are. key: of content and version, the same in every process.
    """

    begin: Callable[[object], Callable[..., object]]
    given: object
    key: str = field(init=False, compare=False)

    def __post_init__(self) -> None:
        named = f"{self.begin.__module__}.{self.begin.__qualname__}"
        object.__setattr__(self, "key", fingerprint(__version__, named, self.given))


@dataclass(frozen=True)
class Job:
    """One call: item is plain data, as a pose, a seed or a mapping of values.

    besides: what the call is to bring besides its result, handed over as a second argument unless it is None; it does
    not change the result, and is no part of the key.
    """

    work: Work
    item: object
    besides: object = None

    @property
    def key(self) -> str:
        """Hash of everything that the result depends on."""
        return fingerprint(self.work.key, self.item)


class Executor(Protocol):
    """Does jobs somewhere."""

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, object]]:
        """Jobs with their results, as they come. Jobs are taken a few ahead, so that there may be any number."""


class InProcess:
    """Does jobs in this process and gives them in their order.

    threads: jobs that are done at a time, each on one core but for the kernels, which take all; what a work has
    prepared is then called from several threads.
    """

    def __init__(self, threads: int = 1) -> None:
        self.workplace, self._threads = Workplace(), threads

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, object]]:
        if self._threads < 2:
            for job in jobs:
                yield job, self.workplace.result(job)
            return
        jobs, ahead = iter(jobs), deque()
        with (
            products_on_one_thread(), kernels_beside(self._threads),
            ThreadPoolExecutor(self._threads, "jobs", keep_to_one_core) as pool,
        ):  # fmt: skip
            try:
                while True:
                    for job in islice(jobs, AHEAD * self._threads - len(ahead)):
                        ahead.append((job, pool.submit(self.workplace.result, job)))
                    if not ahead:
                        return
                    job, result = ahead.popleft()
                    yield job, result.result()
            finally:
                pool.shutdown(cancel_futures=True)


class Workplace:
    """Where a process does jobs: keeps what the last few works have prepared."""

    def __init__(self) -> None:
        self._prepared: dict[str, Callable[..., object]] = {}
        self._lock = threading.Lock()

    def hold(self, work: Work, prepared: Callable[..., object]) -> None:
        """Takes what a work has prepared elsewhere."""
        with self._lock:
            self._prepared[work.key] = prepared

    def result(self, job: Job) -> object:
        """The result of a job."""
        prepared = self.prepared(job.work)
        return prepared(job.item) if job.besides is None else prepared(job.item, job.besides)

    def prepared(self, work: Work) -> Callable[..., object]:
        """What does the jobs of a work."""
        with self._lock:
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
