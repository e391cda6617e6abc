"""A study's jobs, done by whom it is asked for: all of them, or the part that is this run's of several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..experiments.execution import WHOLE, Shard, executor_of
from ..experiments.jobs import Executor, Job, run
from ..machine.journal import Journal
from ..machine.progress import progress_bars
from .evaluation import Evaluation


class LeftToOthers(Exception):
    """This run's part is done, and ``left`` of ``total`` jobs are others' to do."""

    def __init__(self, left: int, total: int) -> None:
        super().__init__(f"{left} of {total} variants are others' to do")


@dataclass(frozen=True)
class Hands:
    """Who does jobs: executor and journal as of :func:`run`, and which part of them is done here."""

    executor: Executor | None = None
    done: Journal | None = None
    shard: Shard = WHOLE

    def evaluated(
        self, jobs: Sequence[Job], advance: Callable[[], None] = lambda: None, shared: bool = False
    ) -> list[Evaluation]:
        """The results of jobs in their order; advance is called for each.

        shared: whether each part does its own jobs only, instead of all; raises LeftToOthers where some are not done.
        """
        shard = self.shard if shared else WHOLE

        def own() -> Iterator[Job]:
            for place, job in enumerate(jobs):
                if shard.takes(place, len(jobs)):
                    yield job

        found: dict[str, Evaluation] = {}
        for job, result in run(own(), self.executor, self.done):
            found[job.key] = Evaluation.of(result)
            advance()
        keys = [job.key for job in jobs]
        if not shard.is_whole and self.done is not None:
            self.done.read_again()
            found |= {key: Evaluation.of(self.done[key]) for key in keys if key not in found and key in self.done}
        if left := sum(key not in found for key in keys):
            raise LeftToOthers(left, len(keys))
        return [found[key] for key in keys]


ALONE = Hands()


@contextmanager
def hands_at_work(
    scheduler: str | None, folder: Path, shard: Shard, quiet: bool
) -> Iterator[tuple[Hands, object]]:
    """Hands whose results are kept in a folder, and bars of their progress, while a command's study is at work.

    scheduler: as of :func:`executor_of`; quiet: whether the bars are hidden. Raises as that and :class:`Journal` do.
    """
    with (
        executor_of(scheduler) as executor,
        Journal(folder / "jobs", shard.journal) as done,
        progress_bars(quiet) as progress,
    ):
        yield Hands(executor, done, shard), progress
