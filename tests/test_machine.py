"""What the machine offers: cores and memory within the limits of containers, and work shared out to threads."""

from __future__ import annotations

import math
import os
import threading

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from speckle_mi.machine import cgroup
from speckle_mi.machine.cores import on_all_cores, products_on_one_thread, usable_cores
from speckle_mi.machine.memory import excess, usable_memory

GB = 1_000_000_000

# Limits of groups, from trees of files as Linux makes them


def group_files(folder, files: dict[str, str]) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content + "\n")


def process_in(folder, groups: str, *mounts: tuple[str, str, str]):
    """A process's folder in /proc: the groups it is in; mounts: root, where it is mounted, type with its options."""
    lines = [f"31 23 0:28 {root} {folder / place} rw,relatime - {kind}" for root, place, kind in mounts]
    lines.insert(0, "22 1 8:1 / / rw - ext4 /dev/sda rw")
    group_files(folder / "self", {"cgroup": groups, "mountinfo": "\n".join(lines)})
    return folder / "self"


V2 = "cgroup2 cgroup2 rw"


def test_the_tightest_limit_on_the_way_to_the_root_counts(tmp_path):
    group_files(
        tmp_path / "fs",
        {
            "job/cpu.max": "150000 100000",
            "job/memory.max": str(3 * GB),
            "job/step/cpu.max": "max 100000",
            "job/step/memory.max": str(5 * GB),
            "job/step/task/cpu.max": "400000 100000",
            "job/step/task/memory.max": "max",
            "other/cpu.max": "1000 100000",
            "other/memory.max": "1000",
        },
    )
    process = process_in(tmp_path, "0::/job/step/task", ("/", "fs", V2))
    assert cgroup.cpu_limit(process) == 1.5
    assert cgroup.memory_limit(process) == 3 * GB


def test_version_1_has_a_hierarchy_for_each_kind_of_limit(tmp_path):
    group_files(
        tmp_path,
        {
            "cpu,cpuacct/docker/cpu.cfs_quota_us": "50000",
            "cpu,cpuacct/docker/cpu.cfs_period_us": "100000",
            "cpu,cpuacct/docker/abc/cpu.cfs_quota_us": "-1",
            "cpu,cpuacct/docker/abc/cpu.cfs_period_us": "100000",
            "memory/memory.limit_in_bytes": "9223372036854771712",
            "memory/docker/memory.limit_in_bytes": str(2 * GB),
            "memory/docker/abc/memory.limit_in_bytes": "9223372036854771712",
        },
    )
    process = process_in(
        tmp_path,
        "5:memory:/docker/abc\n4:cpu,cpuacct:/docker/abc\n0::/",
        ("/", "cpu,cpuacct", "cgroup cgroup rw,cpu,cpuacct"),
        ("/", "memory", "cgroup cgroup rw,memory"),
    )
    assert cgroup.cpu_limit(process) == 0.5
    assert cgroup.memory_limit(process) == 2 * GB


@pytest.mark.parametrize(
    ("groups", "root"), [("0::/docker/abc", "/docker/abc"), ("0::/docker/abc", "/"), ("0::/../other", "/"), ("0::/", "/")]
)
def test_in_a_container_its_own_group_is_what_is_mounted(tmp_path, groups, root):
    """Paths may be told as they are outside, where nothing of that name can be seen."""
    group_files(tmp_path / "fs", {"cpu.max": "200000 100000", "memory.max": str(GB)})
    process = process_in(tmp_path, groups, (root, "fs", V2))
    assert cgroup.cpu_limit(process) == 2.0
    assert cgroup.memory_limit(process) == GB


def test_without_groups_nothing_is_limited(tmp_path):
    for process in (tmp_path / "nothing", process_in(tmp_path, "0::/", ("/", "empty", V2))):
        assert cgroup.cpu_limit(process) == cgroup.memory_limit(process) == math.inf


def test_cores_and_memory_keep_to_the_limits(tmp_path):
    group_files(tmp_path / "fs", {"cpu.max": "20000 100000", "memory.max": "4096"})
    process = process_in(tmp_path, "0::/", ("/", "fs", V2))
    assert usable_cores(process) == 1
    assert usable_memory(process) == 4096.0
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert 1 <= usable_cores() <= there
    assert usable_cores(tmp_path / "nothing") == there
    assert excess(1.0) == "" and "GB" in excess(1e18)


# Threads


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture
def usual() -> set[int]:
    """Threads that NumPy's products take when nobody limits them."""
    np.ones((2, 2)) @ np.ones((2, 2))
    if (there := blas_threads()) == {1}:
        pytest.skip("NumPy's products have one thread here")
    return there


def test_overlapping_threads_give_numpys_products_their_threads_back(usual):
    """The first in goes first, as when frames of two threads overlap: the last one out restores what was there."""
    first_in, second_in, first_out = threading.Event(), threading.Event(), threading.Event()
    seen = []

    def first() -> None:
        with products_on_one_thread():
            first_in.set()
            second_in.wait(10)
        seen.append(blas_threads())
        first_out.set()

    def second() -> None:
        first_in.wait(10)
        with products_on_one_thread():
            second_in.set()
            first_out.wait(10)
            seen.append(blas_threads())

    threads = [threading.Thread(target=work) for work in (first, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [{1}, {1}]
    assert blas_threads() == usual


def test_an_error_inside_gives_them_back_as_well(usual):
    with pytest.raises(ZeroDivisionError), products_on_one_thread():
        on_all_cores(lambda item: item // 0, range(4))
    assert blas_threads() == usual


def test_work_that_is_shared_out_leaves_no_thread_behind():
    before = threading.active_count()
    assert on_all_cores(lambda item: item * item, range(100)) == [item * item for item in range(100)]
    assert threading.active_count() == before


def test_work_inside_work_is_done_by_the_same_threads():
    names = set()

    def inner(item: int) -> int:
        names.add(threading.current_thread().name)
        return item

    def outer(item: int) -> int:
        return sum(on_all_cores(inner, range(item)))

    with products_on_one_thread() as threads:
        assert on_all_cores(outer, range(20)) == [sum(range(item)) for item in range(20)]
    assert len(names) <= threads.cores


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_process_forked_during_a_frame_works_and_has_its_threads_back(usual):
    inside, forked = threading.Event(), threading.Event()

    def frame() -> None:
        with products_on_one_thread():
            inside.set()
            forked.wait(30)

    other = threading.Thread(target=frame)
    other.start()
    inside.wait(30)
    child = os.fork()
    if child == 0:
        right = blas_threads() == usual and on_all_cores(abs, [-1, -2, -3]) == [1, 2, 3]
        os._exit(0 if right and blas_threads() == usual else 1)
    forked.set()
    other.join()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
