"""How many estimates fit this machine or container at once: `worker_concurrency(settings)`.

One estimate keeps one core busy (one OpenCV thread a child). What counts is what this process may use: its CPU
affinity, the CPU quota and the memory limit of its control group (version 2 or 1) and of those above it.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from app.core.settings import MEBIBYTE, Settings

# Resident, at the most seen: 370 MB for a pair of 12 megapixels, as phones send; 570 MB for one of 48 (docs/jobs.md).
ESTIMATE_BYTES = 512 * MEBIBYTE
SHARE_OF_MEMORY = 0.75  # the rest is for the worker itself, the system, and a database or server beside it
NO_LIMIT = 1 << 60  # version 1 writes a number near 2**63 for it


def worker_concurrency(settings: Settings) -> int:
    """Estimates at the same time in one worker: as set, else as many as cores and memory carry, at least one."""
    if settings.worker_concurrency is not None:
        return settings.worker_concurrency
    return max(1, min(usable_cores(), int(usable_memory_bytes() * SHARE_OF_MEMORY) // ESTIMATE_BYTES))


def usable_cores(root: Path = Path("/")) -> int:
    """Whole cores that this process may keep busy, at least one. root: of /proc and /sys, another in tests."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = [quota for folder in _control_groups(root, "cpu") if (quota := _cpu_quota(folder)) is not None]
    return max(1, int(min([float(cores), *quotas])))


def usable_memory_bytes(root: Path = Path("/")) -> int:
    """Of the machine, or of the control group where that is less. root: of /proc and /sys, another in tests."""
    limits = [_machine_memory_bytes(root)]
    for folder in _control_groups(root, "memory"):
        for name in ("memory.max", "memory.limit_in_bytes"):
            limits += [int(word) for word in _words(folder / name) if word.isdigit() and int(word) < NO_LIMIT]
    return min(limits)


def _control_groups(root: Path, controller: str) -> Iterator[Path]:
    """The folders of this process's control group for a controller, and of those above it."""
    for line in _lines(root / "proc/self/cgroup"):
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if controllers and controller not in controllers.split(","):
            continue
        top = root / "sys/fs/cgroup" / (controller if controllers else "")
        folder = top / path.strip("/")
        while folder.is_relative_to(top):  # in a container the path may be that of the host: the top is there always
            yield folder
            folder = folder.parent


def _cpu_quota(folder: Path) -> float | None:
    """Cores that a control group may use; None: all."""
    words = _words(folder / "cpu.max") or [
        *_words(folder / "cpu.cfs_quota_us"),
        *_words(folder / "cpu.cfs_period_us"),
    ]
    if len(words) != 2 or not all(word.isdigit() for word in words) or int(words[1]) == 0:  # "max", or -1
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
