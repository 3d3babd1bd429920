"""Processes of the program that a benchmark starts."""

import os
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

END_SECONDS = 20  # to end in order, before it is killed


def end(process: subprocess.Popen[Any]) -> None:
    """Ask it to end, and see that it does."""
    process.terminate()
    try:
        process.wait(END_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def children_of(pid: int) -> list[int]:
    """The living children that a process has started, by any of its threads."""
    children = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for path in children for child in path.read_text().split()]


def processor_seconds(pids: list[int]) -> float:
    """User and system time of these processes, and of their children that have ended."""
    ticks = 0
    for pid in pids:
        with suppress(OSError):
            fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
            ticks += sum(map(int, fields[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")
