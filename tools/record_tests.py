"""A pytest plugin that records how long each test takes and, if asked, which lines of app/ it runs.

    pytest -p tools.record_tests --record-times FILE [--record-coverage FOLDER]

FILE has one JSON object per test and phase (setup, call, teardown). In FOLDER every process reports its coverage: the
test workers by the test that runs, and servers, workers and children under the name of the test that started them.
These find this program through a sitecustomize.py on PYTHONPATH, and their test in a file named after the process that
started them or one of its ancestors.
"""

import json
import os
import sys
from pathlib import Path

import pytest

from tools.coverage_of_processes import (
    DATA,
    REPORTING,
    REPOSITORY,
    TESTS,
    report_before_killing,
    start_coverage,
)

SITECUSTOMIZE = """\
from pathlib import Path
from tools.coverage_of_processes import start_in_child
start_in_child(Path({folder!r}))
"""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the two options."""
    parser.addoption("--record-times", metavar="FILE", help="write each test's seconds here")
    parser.addoption("--record-coverage", metavar="FOLDER", help="write coverage by test here")


def pytest_configure(config: pytest.Config) -> None:
    """Record what the command line asks for."""
    is_worker = hasattr(config, "workerinput")
    times, folder = config.getoption("--record-times"), config.getoption("--record-coverage")
    if times and not is_worker:
        config.pluginmanager.register(TimesRecorder(Path(times)))
    if folder:
        _prepare(Path(folder).absolute())
        if is_worker or not config.getoption("numprocesses", None):
            config.pluginmanager.register(CoverageRecorder(Path(folder).absolute()))


def _prepare(folder: Path) -> None:
    for name in (TESTS, REPORTING, DATA):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "sitecustomize.py").write_text(SITECUSTOMIZE.format(folder=str(folder)))
    paths = [str(folder), str(REPOSITORY), os.environ.get("PYTHONPATH", "")]
    os.environ["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    sys.path.insert(0, str(folder))  # the app hands sys.path to its children
    report_before_killing(folder)


class TimesRecorder:
    """Writes one line per phase of a test."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", buffering=1)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write a phase's seconds and outcome."""
        row = {
            "test": report.nodeid,
            "when": report.when,
            "seconds": report.duration,
            "outcome": report.outcome,
        }
        self._file.write(json.dumps(row) + "\n")


class CoverageRecorder:
    """Measures this test worker, by test."""

    def __init__(self, folder: Path) -> None:
        self._running = folder / TESTS / str(os.getpid())
        self._coverage = start_coverage(folder, "")

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Name the test that runs now."""
        self._running.write_text(nodeid)
        self._coverage.switch_context(nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write what was measured."""
        self._coverage.stop()
        self._coverage.save()
