"""Run CPU work on uploaded bytes in child processes with hard limits of time and memory: `ChildPool.run(request)`.

A child is spawned (never forked from a threaded process), stays warm between requests and is replaced after any outcome
but success. However a child ends, the result is a value. Messages are JSON: a process that has decoded hostile bytes is
not trusted with pickle. app/children/child.py is the other end.

The time limit is processor time, which the kernel counts: a busy machine is not the photograph's fault. In addition a
limit by the clock, many times as long, ends a child that does nothing at all.
"""

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from app.children.child import StageListener
from app.children.cores import THREAD_VARIABLES
from app.core.errors import Failure
from app.core.settings import Settings
from app.metrics import instruments

START_SECONDS = 60.0  # to import OpenCV and SciPy on a busy machine
BEGINNINGS = 3  # attempts: a child may die while it waits for a request
USES = 100  # of one child, which is then replaced, so that a memory leak stays small
MAX_ANSWER_BYTES = 64 * 1024 * 1024
MAX_STAGE_LETTERS = 32  # the length of the column meal.stage
KEPT_VARIABLES = (
    "PATH",
    "HOME",
    "TMPDIR",
    "TZ",
    "LANG",
    "LC_ALL",
    "LD_LIBRARY_PATH",
)  # none of the settings, so no password

# limit by the clock, in limits of processor time: a child may get only a tenth of a core
PATIENCE = 10.0

Outcome = Literal["ok", "crashed", "timed_out", "stalled", "killed", "out_of_memory", "raised"]
PASSING: frozenset[Outcome] = frozenset({"timed_out", "stalled", "killed"})  # a retry may succeed

_AGAIN = "Take the two photographs again and send them as a new meal."
_KEPT = "The photographs are kept. Ask the people who run the server to queue the meal again once it has more room."
_BUG = "The photographs are kept. Ask the people who run the server to look at its log and to queue the meal again."
FAILURES: Mapping[Outcome, Failure] = {  # {limit}: the limit that was exceeded
    "crashed": Failure(
        "estimate_crashed", "The estimate broke off while it worked on these photographs.", _AGAIN
    ),
    "timed_out": Failure(
        "estimate_timed_out", "The estimate took more than {limit} of processor time.", _KEPT
    ),
    "stalled": Failure(
        "estimate_timed_out",
        "The estimate did not end within {limit}: the machine is too busy.",
        _KEPT,
    ),
    "killed": Failure(
        "estimate_killed",
        "The estimate was ended from outside, most likely for want of memory.",
        _KEPT,
    ),
    "out_of_memory": Failure(
        "estimate_out_of_memory", "The estimate needed more than {limit} of memory.", _AGAIN
    ),
    "raised": Failure(
        "internal_error", "The server made a mistake while it estimated this meal.", _BUG
    ),
}


@dataclass(frozen=True, slots=True)
class ChildRequest:
    """task: a name in the registry. arguments: JSON; photographs and results are passed as paths of files.

    is_costly: it takes long, or nobody waits for it; it runs at a low priority.
    """

    task: str
    arguments: Mapping[str, object]
    is_costly: bool = False


@dataclass(frozen=True, slots=True)
class ChildResult:
    """The end of a request. result: only of "ok". message: for the log. signal: the one that ended a crashed child.

    limit: the exceeded limit with its unit. errno: of "raised", if a system call failed, for example on a full disk.
    """

    outcome: Outcome
    result: Mapping[str, Any] = field(default_factory=dict)
    message: str = ""
    signal: int | None = None
    limit: str = ""
    errno: int | None = None

    @property
    def failure(self) -> Failure | None:
        """The meal's failure; None for "ok"."""
        if self.outcome == "ok":
            return None
        failure = FAILURES[self.outcome]
        return replace(failure, message=failure.message.format(limit=self.limit))

    @property
    def is_passing(self) -> bool:
        """Whether the same request may succeed later, when the machine is less busy."""
        return self.outcome in PASSING


class ChildPoolClosedError(Exception):
    """The pool was closed while the request waited or ran."""


class ChildCancelledError(Exception):
    """The request was cancelled while a child worked on it."""


class ChildStartError(Exception):
    """A child did not start: the installation is broken or the machine is full. Not a photograph's fault."""


class ChildPool:
    """A limited number of children; `run` waits for a free one. tasks: see child.py."""

    def __init__(
        self, settings: Settings, tasks: str, *, uses: int = USES, children: int = 1
    ) -> None:
        # called with the request's name when it needs a child
        self.on_begin: Callable[[str], object] = lambda _: None
        # called with the request's name when it no longer needs one
        self.on_done: Callable[[str], object] = lambda _: None
        self._settings = settings
        self._tasks = tasks
        self._uses = uses
        self._children = children
        self._free = threading.BoundedSemaphore(children)
        # held while a request collects all places: two would deadlock
        self._gathering = threading.Lock()
        self._lock = threading.Lock()
        self._warm: list[_Child] = []
        self._alive: set[_Child] = set()
        self._busy: dict[str, _Child] = {}  # by the name of the request
        self._cancelled: set[_Child] = set()
        self._is_closed = False
        # the kernel kills a child when the thread that started it ends (process_life.py), so one thread starts them all
        self._starter = ThreadPoolExecutor(1, thread_name_prefix="child-starter")

    def run(
        self,
        request: ChildRequest,
        on_stage: StageListener,
        *,
        seconds: float | None = None,
        patience: float = PATIENCE,
        name: str | None = None,
        is_alone: bool = False,
    ) -> ChildResult:
        """Perform one request.

        seconds: limit of processor time; default: settings.estimate_seconds. patience: the limit by the clock, as a
        multiple of it. name: for `cancel`. is_alone: run while no other child of this pool works.

        Raises ChildPoolClosedError, ChildCancelledError, ChildStartError, and whatever on_stage raises.
        """
        limit = self._settings.estimate_seconds if seconds is None else seconds
        if name is not None:
            self.on_begin(name)
        for _ in range(BEGINNINGS):
            with self._place(is_alone=is_alone):
                result = self._run_in_child(request, on_stage, (limit, patience * limit), name)
            if result is not None:
                if name is not None:
                    self.on_done(name)
                instruments.CHILD_RESULTS.labels(result.outcome).inc()
                return result
        raise ChildStartError("child processes ended before they took the request")

    def cancel(self, name: str) -> bool:
        """Kill the child that works on the named request, so that its `run` raises. Returns False if there is none."""
        with self._lock:
            child = self._busy.get(name)
            if child is not None:
                self._cancelled.add(child)
        if child is not None:
            child.kill()
        return child is not None

    def warm_up(self) -> None:
        """Start all children, so that the first requests do not wait for imports."""
        for _ in range(self._children):
            with contextlib.suppress(RuntimeError):  # the pool was just closed
                self._starter.submit(self._start_one_more).result()

    @property
    def is_idle(self) -> bool:
        """Return whether no child works on a request that has a name, as estimates have."""
        with self._lock:
            return not self._busy

    def close(self) -> None:
        """Kill all children at once; requests that wait for one raise ChildPoolClosedError."""
        with self._lock:
            self._is_closed = True
            idle, self._warm = self._warm, []
            busy = self._alive.difference(idle)
        for child in busy:
            child.kill()  # the thread that waits for its answer discards it
        for child in idle:
            self._discard(child)
        self._starter.shutdown(wait=True)

    @contextlib.contextmanager
    def _place(self, *, is_alone: bool) -> Iterator[None]:
        """Hold one child's place, or all of them."""
        if not is_alone:
            with self._free:
                yield
            return
        with self._gathering, contextlib.ExitStack() as places:
            for _ in range(self._children):
                places.enter_context(self._free)
            yield

    def _run_in_child(
        self,
        request: ChildRequest,
        on_stage: StageListener,
        limits: tuple[float, float],
        name: str | None,
    ) -> ChildResult | None:
        """Run in a warm or a new child, which stays warm after success and is discarded otherwise.

        limits: of processor time and by the clock, s.
        """
        child = self._take()
        is_kept = False
        try:
            child.wait_until_ready()
            with self._named(name, child):
                result = child.perform(request, on_stage, *limits)
            if result is not None and result.outcome == "ok":
                is_kept = child.uses < self._uses and self._keep_warm(child)
            else:
                self._raise_if_we_killed(child)
        except BaseException:
            self._raise_if_we_killed(child)
            raise
        finally:
            if not is_kept:  # otherwise another thread may already have it
                self._discard(child)
        return result

    @contextlib.contextmanager
    def _named(self, name: str | None, child: "_Child") -> Iterator[None]:
        if name is None:
            yield
            return
        with self._lock:
            self._busy[name] = child
        try:
            yield
        finally:
            with self._lock:
                del self._busy[name]

    def _raise_if_we_killed(self, child: "_Child") -> None:
        with self._lock:
            is_closed, is_cancelled = self._is_closed, child in self._cancelled
        if is_closed:
            raise ChildPoolClosedError from None
        if is_cancelled:
            raise ChildCancelledError from None

    def _take(self) -> "_Child":
        while True:
            with self._lock:
                if self._is_closed:
                    raise ChildPoolClosedError
                child = self._warm.pop() if self._warm else None
            if child is None:
                try:
                    return self._starter.submit(self._warm_or_new).result()
                except RuntimeError:  # the pool was just closed
                    raise ChildPoolClosedError from None
            if child.is_alive():
                return child
            self._discard(child)

    def _warm_or_new(self) -> "_Child":
        """Runs in the starter's thread, after any `warm_up`, which may have left a warm child."""
        with self._lock:
            child = self._warm.pop() if self._warm else None
        return child or self._start()

    def _start(self) -> "_Child":
        child = _Child(self._tasks, self._settings.estimate_memory_bytes)
        instruments.CHILDREN_STARTED.inc()
        with self._lock:
            self._alive.add(child)
            is_closed = self._is_closed
        if is_closed:
            self._discard(child)
            raise ChildPoolClosedError
        return child

    def _start_one_more(self) -> None:
        with self._lock:
            has_all = self._is_closed or len(self._alive) >= self._children
        if has_all:
            return
        child = self._start()
        if not self._keep_warm(child):  # whoever takes a warm child waits until it is ready
            self._discard(child)

    def _keep_warm(self, child: "_Child") -> bool:
        with self._lock:
            if not self._is_closed and child not in self._cancelled:
                self._warm.append(child)
            return child in self._warm

    def _discard(self, child: "_Child") -> None:
        child.end()
        with self._lock:
            self._alive.discard(child)
            self._cancelled.discard(child)


class _Child:
    """One process and its pipes. Used by one thread at a time; `kill` may come from another."""

    def __init__(self, tasks: str, memory_bytes: int) -> None:
        self.uses = 0
        self._memory_bytes = memory_bytes
        self._is_ready = False
        self._unread = bytearray()
        environment = {name: os.environ[name] for name in KEPT_VARIABLES if name in os.environ}
        environment |= dict.fromkeys(THREAD_VARIABLES, "1")
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "app.children.child",
                tasks,
                str(os.getpid()),
                str(memory_bytes),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            close_fds=True,
        )

    def is_alive(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    def wait_until_ready(self) -> None:
        """Wait for the end of its imports. Raises ChildStartError."""
        if self._is_ready:
            return
        message = next(self._messages(START_SECONDS), None)
        if message != {"ready": True}:
            # the pipe closes shortly before the process ends
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(1.0)
            raise ChildStartError(f"a child process did not start (status {self._process.poll()})")
        self._is_ready = True

    def perform(
        self, request: ChildRequest, on_stage: StageListener, cpu_seconds: float, seconds: float
    ) -> ChildResult | None:
        """Send the request and wait at most `seconds` for its result; None: the child never took it.

        cpu_seconds: limit of processor time, which the kernel enforces.
        """
        self.uses += 1
        body = {
            "task": request.task,
            "arguments": dict(request.arguments),
            "cpu_seconds": cpu_seconds,
            "is_costly": request.is_costly,
        }
        line = json.dumps(body, allow_nan=False) + "\n"
        stdin = self._process.stdin
        if stdin is None:
            raise ValueError("the child has no pipe")
        # it is dead; reading its messages below tells how it died
        with contextlib.suppress(BrokenPipeError):
            stdin.write(line.encode())
            stdin.flush()
        deadline = time.monotonic() + seconds
        is_taken = False
        for message in self._messages(seconds):
            match message:
                case {"taken": True}:
                    is_taken = True
                case {"stage": str(stage)} if len(stage) <= MAX_STAGE_LETTERS:
                    on_stage(stage)
                case {"ok": dict(result)}:
                    return ChildResult("ok", result)
                case {"out_of_memory": str(text)}:
                    return ChildResult(
                        "out_of_memory", message=text, limit=_in_mebibytes(self._memory_bytes)
                    )
                case {"raised": str(text), "errno": int(errno)}:
                    return ChildResult("raised", message=text, errno=errno)
                case {"raised": str(text)}:
                    return ChildResult("raised", message=text)
                case _:
                    return ChildResult("raised", message="the child process sent what is no answer")
        if time.monotonic() >= deadline and self.is_alive():
            return ChildResult(
                "stalled", message=f"killed after {seconds:g} s", limit=f"{seconds:g} s"
            )
        return self._describe_death(cpu_seconds) if is_taken else None

    def kill(self) -> None:
        """Kill the process; the thread that waits for its answer sees its pipe close."""
        self._process.kill()

    def end(self) -> None:
        """Kill the process if it is running, reap it and close its pipes."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):  # unsent bytes of a broken pipe
                    pipe.close()

    def _describe_death(self, cpu_seconds: float) -> ChildResult:
        status = self._process.wait()
        # not by us, which is "stalled": by the kernel, for lack of memory
        if status == -signal.SIGKILL:
            return ChildResult(
                "killed", message="the child process was killed, most likely by the kernel"
            )
        if status == -signal.SIGXCPU:
            limit = f"{cpu_seconds:g} s"
            return ChildResult(
                "timed_out", message=f"ended after {limit} of processor time", limit=limit
            )
        number = -status if status < 0 else None
        return ChildResult(
            "crashed", message=f"the child process ended with status {status}", signal=number
        )

    def _messages(self, seconds: float) -> Iterator[object]:
        """Yield messages until the time is over or the pipe closes; None for a message that is not JSON."""
        stdout = self._process.stdout
        if stdout is None:
            raise ValueError("the child has no pipe")
        deadline = time.monotonic() + seconds
        with selectors.DefaultSelector() as selector:
            selector.register(stdout, selectors.EVENT_READ)
            while (remaining := deadline - time.monotonic()) > 0:
                line, separator, rest = self._unread.partition(b"\n")
                if separator:
                    self._unread = rest
                    try:
                        yield json.loads(line)
                    except ValueError:
                        yield None
                elif len(self._unread) > MAX_ANSWER_BYTES:
                    yield None
                elif selector.select(remaining):
                    chunk = os.read(stdout.fileno(), 1 << 16)
                    if not chunk:
                        return
                    self._unread += chunk


def _in_mebibytes(count: int) -> str:
    return f"{count // 2**20} MiB"
