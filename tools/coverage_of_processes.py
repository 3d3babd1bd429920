"""Coverage of one process, under the name of the test that it works for: see record_tests.py."""

import atexit
import contextlib
import os
import signal
import subprocess
from pathlib import Path
from types import FrameType
from typing import Never

import coverage

TESTS = "tests"  # folder: which test runs now, by the process id of the test worker
REPORTING = "reporting"  # folder: the process ids that write their coverage when they are asked to
DATA = "data"  # folder: coverage, a file per process
OF_CHILD = "child of "
END_SECONDS = 1.0  # for a process to write its coverage before it is killed
REPOSITORY = Path(__file__).parents[1]


def start_coverage(folder: Path, context: str) -> coverage.Coverage:
    """Measure app/ in this process from now on."""
    recording = coverage.Coverage(
        data_file=str(folder / DATA / "coverage"),
        data_suffix=True,
        include=[str(REPOSITORY / "app" / "*")],
        context=context or None,
        config_file=False,
    )
    recording.set_option("run:disable_warnings", ["no-data-collected", "module-not-measured"])
    recording.start()
    return recording


def start_in_child(folder: Path) -> None:
    """Measure this process if a test started it, and write what was measured however it ends."""
    test = _test_of_process(folder)
    if test is None:
        return
    recording = start_coverage(folder, OF_CHILD + test)
    recorder = os.getpid()

    def save() -> None:
        if os.getpid() == recorder:  # not in a fork of it
            recording.stop()
            recording.save()

    def save_and_die(_number: int, _frame: FrameType | None) -> None:
        save()
        os.kill(os.getpid(), signal.SIGKILL)

    leave = os._exit

    def save_and_leave(status: int) -> Never:
        save()
        leave(status)

    atexit.register(save)
    os._exit = save_and_leave
    signal.signal(signal.SIGUSR2, save_and_die)
    (folder / REPORTING / str(recorder)).touch()
    report_before_killing(folder)


def report_before_killing(folder: Path) -> None:
    """Give processes that this one kills the time to write their coverage; they end by SIGKILL all the same."""
    kill = subprocess.Popen.kill

    def ask_first(process: subprocess.Popen[bytes]) -> None:
        if process.poll() is None and (folder / REPORTING / str(process.pid)).exists():
            process.send_signal(signal.SIGUSR2)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_SECONDS)
        kill(process)

    subprocess.Popen.kill = ask_first  # type: ignore[method-assign, assignment]


def _test_of_process(folder: Path) -> str | None:
    """Return the test that runs in the nearest ancestor which is a test worker."""
    process = os.getpid()
    while process > 1:
        test = folder / TESTS / str(process)
        if test.exists():
            return test.read_text()
        process = _parent_of(process)
    return None


def _parent_of(process: int) -> int:
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return 0
    return int(stat.rpartition(")")[2].split()[1])
