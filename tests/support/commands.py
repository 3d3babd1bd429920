"""`tada ...` as a person types it, inside the test's own process: a process of its own needs two seconds to begin.

That the program runs as a process too is for tests/e2e, and for one test of each group of commands.
"""

import contextlib
import io
import sys
from dataclasses import dataclass

import pytest

from app.cli.main import main


@dataclass(frozen=True)
class Ended:
    """What a command left behind, as subprocess.CompletedProcess tells it."""

    returncode: int
    stdout: str
    stderr: str


def run_tada(*arguments, stdin="", **variables) -> Ended:
    """Run a command with these environment variables on top of our own; an unexpected error is raised."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        for name, value in variables.items():
            patch.setenv(name, str(value))
        patch.setattr(sys, "argv", ["tada", *map(str, arguments)])
        patch.setattr(sys, "stdin", io.StringIO(stdin))
        with pytest.raises(SystemExit) as end:
            main()
    return Ended(end.value.code or 0, out.getvalue(), err.getvalue())
