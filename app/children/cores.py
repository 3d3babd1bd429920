"""Determine how many estimates can run at once on this machine or container.

Each computes on one core: libraries have one thread in each process. The limits are those of this process: its CPU
affinity, and the CPU quotas and memory limits of its control group (version 2 or 1) and the groups above it.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from app.core.settings import MEBIBYTE, Settings

# Resident, at the most seen: 300 MB for a pair of 12 megapixels, as phones send; 520 MB for one of 48 (docs/jobs.md).
ESTIMATE_BYTES = 512 * MEBIBYTE
# the rest is for the worker itself, the system, and a database or server beside it
SHARE_OF_MEMORY = 0.75
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
NO_LIMIT = 1 << 60  # version 1 writes a number near 2**63 for it


def worker_concurrency(settings: Settings) -> int:
    """Return the setting, or else as many estimates as cores and memory allow, at least one."""
    if settings.worker_concurrency is not None:
        return settings.worker_concurrency
    return max(
        1, min(usable_cores(), int(usable_memory_bytes() * SHARE_OF_MEMORY) // ESTIMATE_BYTES)
    )


def usable_cores(root: Path = Path("/")) -> int:
    """Return the whole cores that this process may use, at least one. root: of /proc and /sys, another in tests."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    quotas = [
        quota
        for folder in _control_groups(root, "cpu")
        if (quota := _cpu_quota(folder)) is not None
    ]
    return max(1, int(min([float(cores), *quotas])))


def usable_memory_bytes(root: Path = Path("/")) -> int:
    """Return the machine's memory, or the control group's limit if that is less. root: see usable_cores."""
    limits = [_machine_memory_bytes(root)]
    for folder in _control_groups(root, "memory"):
        for name in ("memory.max", "memory.limit_in_bytes"):
            limits += [
                int(word)
                for word in _words(folder / name)
                if word.isdigit() and int(word) < NO_LIMIT
            ]
    return min(limits)


def _control_groups(root: Path, controller: str) -> Iterator[Path]:
    """Yield the folders of this process's control group for a controller and of the groups above it."""
    for line in _lines(root / "proc/self/cgroup"):
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if controllers and controller not in controllers.split(","):
            continue
        top = root / "sys/fs/cgroup" / (controller if controllers else "")
        folder = top / path.strip("/")
        # in a container the path may be the host's; the top always exists
        while folder.is_relative_to(top):
            yield folder
            folder = folder.parent


def _cpu_quota(folder: Path) -> float | None:
    """Return the cores that a control group may use; None: all."""
    words = _words(folder / "cpu.max") or [
        *_words(folder / "cpu.cfs_quota_us"),
        *_words(folder / "cpu.cfs_period_us"),
    ]
    # "max", or -1
    if len(words) != 2 or not all(word.isdigit() for word in words) or int(words[1]) == 0:
        return None
    return int(words[0]) / int(words[1])


def _machine_memory_bytes(root: Path) -> int:
    for line in _lines(root / "proc/meminfo"):
        if line.startswith("MemTotal:"):
            return int(line.split()[1]) * 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _words(path: Path) -> list[str]:
    return " ".join(_lines(path)).split()


def _lines(path: Path) -> list[str]:
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return path.read_text().splitlines()
    return []
