"""Tasks for the child process: one for each way to end."""

import errno
import os
import pathlib
import signal
import threading
import time


def _segfault(arguments, on_stage):
    os.kill(os.getpid(), signal.SIGSEGV)


def _hang(arguments, on_stage):
    on_stage("hanging")
    while True:
        time.sleep(1)


def _spin(arguments, on_stage):
    on_stage("spinning")
    while True:
        pass


def _killed_twice(arguments, on_stage):
    """As the kernel does where memory is short, the first two times."""
    tries = sorted(pathlib.Path(arguments["folder"]).glob(f"killed-{arguments['job']}-*"))
    if len(tries) < 2:
        pathlib.Path(arguments["folder"], f"killed-{arguments['job']}-{len(tries)}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {}


def _hold(arguments, on_stage):
    on_stage("holding")
    while not pathlib.Path(arguments["until"]).exists():
        time.sleep(0.02)
    return {}


def _eat_memory(arguments, on_stage):
    blocks = []
    while True:
        blocks.append(bytearray(1024 * 1024 * 1024))


def _raise(arguments, on_stage):
    raise ValueError("a bug of the task")


def _fill_disk(arguments, on_stage):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _print(arguments, on_stage):
    print('{"ok": {"who": "a library"}}', flush=True)  # noqa: T201
    os.write(1, b"C code prints too\n")
    return {"who": "the task"}


def _stages(arguments, on_stage):
    for name in arguments["names"]:
        on_stage(name)
    return {"read": os.read(0, 10).decode()}


def _describe(arguments, on_stage):
    niceness = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    return {"pid": os.getpid(), "environment": sorted(os.environ), "echo": arguments, "niceness": niceness}


def _garble(arguments, on_stage):
    for number in range(3, 64):
        try:
            os.write(number, b"\x80\x04 not json\n")
        except OSError:
            continue
    return {}


def _not_json(arguments, on_stage):
    return {"number": float("nan")}


def _exit(arguments, on_stage):
    os._exit(3)


def _killed(arguments, on_stage):
    os.kill(os.getpid(), signal.SIGKILL)


TASKS = {
    "segfault": _segfault,
    "hang": _hang,
    "spin": _spin,
    "killed_twice": _killed_twice,
    "hold": _hold,
    "eat_memory": _eat_memory,
    "fill_disk": _fill_disk,
    "raise": _raise,
    "print": _print,
    "stages": _stages,
    "describe": _describe,
    "garble": _garble,
    "not_json": _not_json,
    "exit": _exit,
    "killed": _killed,
}
