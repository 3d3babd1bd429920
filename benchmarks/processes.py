"""Processes of the program that a benchmark starts."""

import subprocess
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
