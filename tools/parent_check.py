"""After a failed run of pytest: whether the tests that failed also fail on the parent commit.

    python tools/parent_check.py

A test that fails there too was at fault before this commit, or is one that sometimes fails without a defect.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

MOST_TESTS = 10
SECONDS = 300
ALL_PASSED, SOME_FAILED = 0, 1  # exit codes of pytest
LAST_FAILED = ("--last-failed", "--last-failed-no-failures", "none", "--collect-only", "-q")


def main() -> None:
    """Print one line per failed test."""
    failed = [
        line for line in run_pytest(LAST_FAILED, Path.cwd()).stdout.splitlines() if "::" in line
    ]
    git = shutil.which("git") or "git"
    with tempfile.TemporaryDirectory(prefix="tada-parent-") as folder:
        parent = Path(folder) / "checkout"
        add = [git, "worktree", "add", "--quiet", "--detach", str(parent), "HEAD^"]
        made = subprocess.run(add, capture_output=True, text=True, check=False)
        if made.returncode != 0:
            print(f"the parent commit cannot be tested: {made.stderr.strip()}")
            return
        try:
            for test in failed[:MOST_TESTS]:
                print(f"{verdict(test, parent)}: {test}", flush=True)
            if len(failed) > MOST_TESTS:
                print(
                    f"{len(failed) - MOST_TESTS} more failed and were not run on the parent commit"
                )
        finally:
            subprocess.run([git, "worktree", "remove", "--force", str(parent)], check=False)


def verdict(test: str, parent: Path) -> str:
    """Return what the parent commit says of a test."""
    try:
        code = run_pytest((test,), parent).returncode
    except subprocess.TimeoutExpired:
        return f"not done on the parent commit after {SECONDS} s"
    if code == ALL_PASSED:
        return "passes on the parent commit"
    return (
        "fails on the parent commit too"
        if code == SOME_FAILED
        else "is no test of the parent commit"
    )


def run_pytest(arguments: Sequence[str], checkout: Path) -> subprocess.CompletedProcess[str]:
    """Run pytest of this environment on the program and the tests of a checkout."""
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    environment.setdefault("TADA_SHARED_DATA", str(Path.cwd().parent / "shared"))
    return subprocess.run(
        [sys.executable, "-m", "pytest", *arguments],
        cwd=checkout,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=SECONDS,
    )


if __name__ == "__main__":
    main()
