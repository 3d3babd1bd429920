"""The process that decodes uploaded bytes: `python -m app.children.child TASKS PARENT_PID MEMORY_BYTES`.

It reads requests from standard input and writes messages to the original standard output, one JSON object per line:
{"ready": true} once; then, for each request, {"taken": true}, any number of {"stage": name} and one of {"ok": result},
{"out_of_memory": text} or {"raised": text, "errno": the number if a system call failed}. TASKS is "module:NAME" of
a mapping from a task's name to its function. Output of libraries goes to standard error. The parent (child_pool.py)
watches the clock and kills the child; the kernel enforces a request's `cpu_seconds`. An `is_costly` request runs at a
low priority.
"""

import faulthandler
import functools
import importlib
import json
import math
import os
import resource
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TextIO

from app.core.process_life import die_with_parent

Arguments = Mapping[str, Any]  # JSON, checked by each task
StageListener = Callable[[str], None]
Task = Callable[[Arguments, StageListener], Mapping[str, object]]
Message = Mapping[str, object]

COSTLY_NICENESS = 15  # some 3 % of a core beside an ordinary request, all of it on an idle machine
OPENCV_NO_MEMORY = -4  # cv::Error::StsNoMem


def main(arguments: list[str]) -> None:
    """Serve until standard input ends."""
    tasks_name, parent_pid, memory_bytes = arguments
    die_with_parent(int(parent_pid))
    for number in (signal.SIGINT, signal.SIGTERM):
        # sent to the whole process group; the parent decides when a child ends
        signal.signal(number, signal.SIG_IGN)
    requests, answers = _take_pipes()
    faulthandler.enable(sys.stderr)
    _limit_memory(int(memory_bytes))
    tasks = _load_tasks(tasks_name)
    _send(answers, {"ready": True})
    for line in requests:
        request = json.loads(line)
        _send(answers, {"taken": True})
        _limit_processor_time(float(request["cpu_seconds"]))
        perform = functools.partial(_perform, tasks, request["task"], request["arguments"], answers)
        _send(answers, _at_low_priority(perform) if request["is_costly"] else perform())


def _at_low_priority(perform: Callable[[], Message]) -> Message:
    """Run in a new thread: on Linux each thread has its own priority, and a lowered one cannot be raised again."""

    def lower() -> None:
        if sys.platform != "linux":  # elsewhere the number may be another process's
            return
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), COSTLY_NICENESS)

    with ThreadPoolExecutor(1, initializer=lower) as thread:
        return thread.submit(perform).result()


def _take_pipes() -> tuple[TextIO, TextIO]:
    """Return the pipes under new descriptors, so that libraries which read or print do not touch them."""
    requests = os.fdopen(os.dup(0), "r", encoding="utf-8")
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    os.dup2(2, 1)
    return requests, answers


def _limit_memory(memory_bytes: int) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = memory_bytes if hard == resource.RLIM_INFINITY else min(memory_bytes, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a core dump would contain a photograph


def _limit_processor_time(seconds: float) -> None:
    """Let the kernel end the process by SIGXCPU after that much more processor time, rounded up to whole seconds."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    limit = math.ceil(usage.ru_utime + usage.ru_stime + seconds)
    resource.setrlimit(
        resource.RLIMIT_CPU, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard)
    )


def _load_tasks(name: str) -> Mapping[str, Task]:
    module_name, _, attribute = name.partition(":")
    tasks: Mapping[str, Task] = getattr(importlib.import_module(module_name), attribute)
    if "cv2" in sys.modules:
        # there are many children; more threads would only compete
        sys.modules["cv2"].setNumThreads(1)
    return tasks


def _perform(
    tasks: Mapping[str, Task], name: str, arguments: Mapping[str, object], answers: TextIO
) -> Message:
    try:
        result = tasks[name](arguments, lambda stage: _send(answers, {"stage": stage}))
        # an answer that is not JSON is reported as a fault of the task
        json.dumps(result, allow_nan=False)
    except Exception as error:  # noqa: BLE001  # the worker's edge
        traceback.print_exc()
        message = f"{type(error).__name__}: {error}"
        if _is_out_of_memory(error):
            return {"out_of_memory": message}
        return {"raised": message, "errno": error.errno if isinstance(error, OSError) else None}
    return {"ok": result}


def _is_out_of_memory(error: Exception) -> bool:
    """Also recognise OpenCV's error code, and a std::bad_alloc, which its bindings pass on as text only."""
    if isinstance(error, MemoryError):
        return True
    is_opencv = type(error).__module__.partition(".")[0] == "cv2"
    return is_opencv and (
        getattr(error, "code", None) == OPENCV_NO_MEMORY or "bad_alloc" in str(error)
    )


def _send(answers: TextIO, message: Message) -> None:
    answers.write(json.dumps(message, allow_nan=False) + "\n")
    answers.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
