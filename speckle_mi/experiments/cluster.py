"""Jobs done by the workers of dask.distributed: processes of this machine, or of any number of machines.

Each worker does one batch at a time, in the Mitsuba variant of the process that asks. Results come back as they are
done and are forgotten there; what a lost worker had not sent back is done by another one.
"""

from __future__ import annotations

import logging
import os
import pickle
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice

import mitsuba as mi

from ..errors import InputError
from ..machine.backend import set_variant
from ..machine.cores import products_on_one_thread
from ..version import __version__
from .jobs import Job, Workplace

BATCH_SECONDS = 0.4
"""Time that a batch is to take: a hundred times what it costs to hand it out."""

FIRST_BATCH, LARGEST_BATCH = 2, 1000
"""Jobs in the first batches, before it is known how long one takes, and at most."""

LARGE_RESULTS = 4
"""Jobs in a batch of those that bring something large besides their result."""

AHEAD = 2
"""Batches a worker that are handed out: the next one is there when one is done."""

SECONDS_FOR_A_WORKER = 60.0
"""Time in which at least one worker must have come."""

_SENT_WITHIN = 5e6
"""Bytes of what a batch has to be sent with that a second of work is worth: a twentieth of a slow network."""


class Cluster:
    """Does jobs on the workers of a scheduler."""

    def __init__(self, client, address: str) -> None:
        self._client, self._address = client, address
        self._seconds_a_job = 0.0

    def results(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, object]]:
        """Jobs with their results, as they are done. Raises ConnectionError where the scheduler is lost."""
        from distributed import as_completed

        source, batches = iter(jobs), {}
        done = as_completed(loop=self._client.loop)

        def hand_out() -> None:
            while len(batches) < AHEAD * max(1, len(self._client.scheduler_info()["workers"])):
                if not (batch := self._next_batch(source)):
                    return
                future = self._client.submit(do_batch, mi.variant(), __version__, batch, pure=False)
                batches[future] = batch
                done.add(future)

        with self._loss_said():
            hand_out()
            while batches:
                future = next(done)
                batch, (seconds, results) = batches.pop(future), future.result()
                future.release()
                self._seconds_a_job = 0.5 * (self._seconds_a_job or seconds / len(batch)) + 0.5 * seconds / len(batch)
                hand_out()
                yield from zip(batch, results, strict=True)

    def workers(self) -> dict[str, int]:
        """Addresses of the workers, with their processes' numbers on their machines."""
        return self._client.run(os.getpid)

    def _next_batch(self, source: Iterator[Job]) -> list[Job]:
        """The next jobs, as many as take about ``BATCH_SECONDS``; longer where it takes long to send what they need."""
        batch = list(islice(source, 1))
        if not batch:
            return batch
        seconds = max(BATCH_SECONDS, len(pickle.dumps(batch[0])) / _SENT_WITHIN)
        count = FIRST_BATCH if not self._seconds_a_job else int(seconds / self._seconds_a_job)
        count = min(max(count, 1), LARGEST_BATCH)
        while len(batch) < (count if batch[-1].besides is None else min(count, LARGE_RESULTS)):
            if not (more := list(islice(source, 1))):
                break
            batch += more
        return batch

    @contextmanager
    def _loss_said(self) -> Iterator[None]:
        from concurrent.futures import CancelledError

        try:
            yield
        except (CancelledError, TimeoutError) as error:
            raise ConnectionError(
                f"{self._address}: the scheduler is lost; what it sent back is kept, start it again and run the same "
                "command"
            ) from error


class _Bench:
    """What a worker keeps from batch to batch."""

    def __init__(self) -> None:
        self.workplace, self.one_at_a_time = Workplace(), threading.Lock()


def do_batch(variant: str, version: str, batch: list[Job]) -> tuple[float, list]:
    """In a worker: seconds that the jobs took, and their results. Raises InputError where it is of another version."""
    from distributed import get_worker

    if version != __version__:
        raise InputError(f"a worker has speckle_mi {__version__}, must have {version} as the process that asks it")
    worker = get_worker()
    with _beginning:
        bench = worker.speckle_mi = getattr(worker, "speckle_mi", None) or _Bench()
    with bench.one_at_a_time, products_on_one_thread():
        if mi.variant() != variant:
            set_variant(variant)
        began = time.perf_counter()
        results = [bench.workplace.result(job) for job in batch]
        return time.perf_counter() - began, results


_beginning = threading.Lock()


@contextmanager
def cluster_at(address: str) -> Iterator[Cluster]:
    """The cluster whose scheduler is at ``tcp://host:port``. Raises OSError where none answers, or has no worker."""
    from distributed import Client

    _silence()
    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f"--scheduler {address}: no scheduler answers there") from error
    try:
        _require_worker(client, address)
        yield Cluster(client, address)
    finally:
        _closed(client)


@contextmanager
def cluster_here(workers: int) -> Iterator[Cluster]:
    """That many worker processes on this machine, which end with the block or with this process."""
    import dask
    from distributed import Client, LocalCluster

    _silence()
    # Each frame takes less memory than the machine has; workers are not to be stopped for what they keep.
    with dask.config.set({"distributed.worker.daemon": True, "distributed.admin.low-level-log-length": 100}):
        with LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", memory_limit=0,
            silence_logs=logging.CRITICAL,
        ) as local:  # fmt: skip
            client = Client(local, set_as_default=False)
            try:
                _require_worker(client, "local")
                yield Cluster(client, local.scheduler_address)
            finally:
                _closed(client)


def _require_worker(client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=SECONDS_FOR_A_WORKER)
    except TimeoutError:
        raise ConnectionError(f"--scheduler {address}: has no worker after {SECONDS_FOR_A_WORKER:g} s") from None


def _closed(client) -> None:
    try:
        client.close(timeout=5)
    except Exception:  # of a scheduler that is lost there is nothing to close
        pass


def _silence() -> None:
    """What a cluster tells of its comings and goings is said once and in our words."""
    for name in ("distributed", "distributed.client", "distributed.nanny", "distributed.comm", "distributed.core",
                 "distributed.worker", "distributed.scheduler", "distributed.batched"):  # fmt: skip
        logging.getLogger(name).setLevel(logging.CRITICAL)
