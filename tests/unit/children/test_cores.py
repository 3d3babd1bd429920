import os

import pytest

from app.children import cores
from app.children.cores import (
    ESTIMATE_BYTES,
    usable_cores,
    usable_memory_bytes,
    worker_concurrency,
)
from app.core.settings import MEBIBYTE, Settings

GIBIBYTE = 1024 * MEBIBYTE


@pytest.fixture
def sixteen_cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(16)), raising=False)


def machine(root, files):
    """Files of /proc and /sys below root; a machine of 64 GB."""
    for name, content in {"proc/meminfo": "MemFree: 1 kB\nMemTotal:       67108864 kB\n", **files}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return root


@pytest.mark.parametrize(
    ("quota", "expected"),
    [("400000 100000", 4), ("150000 100000", 1), ("50000 100000", 1), ("max 100000", 16), ("6400000 100000", 16)],
)
def test_quota_of_the_control_group_limits_the_cores_but_leaves_one(tmp_path, sixteen_cores, quota, expected):
    root = machine(tmp_path, {"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/cpu.max": f"{quota}\n"})
    assert usable_cores(root) == expected


@pytest.mark.parametrize(
    ("files", "cores_found", "memory_found"),
    [
        (
            {
                "proc/self/cgroup": "0::/system.slice/tada.service\n",
                "sys/fs/cgroup/system.slice/cpu.max": "200000 100000",  # of a group above
                "sys/fs/cgroup/system.slice/tada.service/cpu.max": "max 100000",
            },
            2,
            64 * GIBIBYTE,
        ),
        (
            {
                "proc/self/cgroup": "5:cpu,cpuacct:/docker/x\n4:memory:/docker/x\n",
                "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "300000\n",
                "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000\n",
                "sys/fs/cgroup/memory/memory.limit_in_bytes": str(2 * GIBIBYTE),
            },
            3,
            2 * GIBIBYTE,
        ),
        (
            {
                "proc/self/cgroup": "5:cpu,cpuacct:/\n4:memory:/\n",
                "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "-1\n",
                "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000\n",
                "sys/fs/cgroup/memory/memory.limit_in_bytes": "9223372036854771712",
            },
            16,
            64 * GIBIBYTE,
        ),
        ({}, 16, 64 * GIBIBYTE),
    ],
    ids=["a group above", "version 1", "version 1 without a limit", "no control groups"],
)
def test_control_groups_limit_cores_and_memory(tmp_path, sixteen_cores, files, cores_found, memory_found):
    root = machine(tmp_path, files)
    assert (usable_cores(root), usable_memory_bytes(root)) == (cores_found, memory_found)


@pytest.mark.parametrize(
    ("cores_usable", "memory_bytes", "changes", "expected"),
    [
        (8, 64 * GIBIBYTE, {}, 8),
        (8, 4 * GIBIBYTE, {}, 6),
        (8, ESTIMATE_BYTES, {}, 1),
        (8, 64 * GIBIBYTE, {"worker_concurrency": 3}, 3),
    ],
)
def test_concurrency_is_the_set_one_or_what_cores_and_memory_carry(
    monkeypatch, cores_usable, memory_bytes, changes, expected
):
    monkeypatch.setattr(cores, "usable_cores", lambda: cores_usable)
    monkeypatch.setattr(cores, "usable_memory_bytes", lambda: memory_bytes)
    assert worker_concurrency(Settings(**changes)) == expected
