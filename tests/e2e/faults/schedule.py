"""Faults by a seed: rounds of every kind that the deployment can have, in a drawn order, several at the same time.

A fault is a function of (deployment, generator, witness) that begins it and returns (seconds, undo): it is undone that
much later while the next ones come. What is drawn depends on the seed only; what it meets, on the moment.
"""

import heapq
import itertools
import os
import signal
import threading
import time
from collections import Counter

from tests.e2e.faults.programs import send

HOUR = 3600
PATIENCE_SECONDS = 5.0  # for a good answer between two faults
FAULTS = {}  # name -> (function, where it can be)
WITH_WORK_ONLY = {  # faults that find nothing to break while nobody works, or no database answers
    *("worker killed", "worker stopped", "worker asked to end"),
    *("estimate's child killed", "estimate's child stopped"),
    "a connection's process in the database killed",
}


def fault(name, where=lambda _: True):
    def keep(function):
        FAULTS[name] = (function, where)
        return function

    return keep


def has_database(deployment):
    return not deployment.is_embedded


def has_store(deployment):
    return deployment.has_s3


class NothingToHitError(Exception):
    """What the fault is to break does not run just now."""


def nothing():
    """A fault that passes by itself: the service manager starts what was killed."""


@fault("server killed")
def kill_api(deployment, rng, witness):
    api = rng.choice(deployment.apis)
    if deployment.is_embedded:
        witness.worker_dies(deployment.worker_pid(rng, witness)[0])
    api.kill(rng.uniform(0.2, 1.5))
    return 0.0, nothing


@fault("server stopped")
def stop_api(deployment, rng, witness):
    return rng.uniform(0.5, 4.0), rng.choice(deployment.apis).pause()


@fault("worker killed")
def kill_worker(deployment, rng, witness):
    pid, program = deployment.worker_pid(rng, witness)
    down = rng.uniform(0.2, 5.0)
    if pid is None:
        raise NothingToHitError
    witness.worker_dies(pid)
    if program is None:
        send(pid, signal.SIGKILL)
    else:
        program.kill(down)
    return 0.0, nothing


@fault("worker stopped")
def stop_worker(deployment, rng, witness):
    pid, _ = deployment.worker_pid(rng, witness)
    seconds = rng.choice((1.0, 9.0))  # less than a lease, and more
    if pid is None:
        raise NothingToHitError
    send(pid, signal.SIGSTOP)
    if seconds > 6.0 and not deployment.is_embedded:  # on SQLite it keeps its jobs
        witness.worker_dies(pid)
    return seconds, lambda: send(pid, signal.SIGCONT)


@fault("worker asked to end")
def end_worker(deployment, rng, witness):
    pid, _ = deployment.worker_pid(rng, witness)
    if pid is None:
        raise NothingToHitError
    witness.worker_dies(pid)
    send(pid, signal.SIGTERM)
    return 0.0, nothing


@fault("estimate's child killed")
def kill_child(deployment, rng, witness):
    """As by the kernel for want of memory; no estimate's children so often that its tries are used up."""
    child = deployment.stop_child(rng, to_kill=True)
    if child is None:
        raise NothingToHitError
    pid, estimate = child
    deployment.children_killed[estimate] += 1
    send(pid, signal.SIGKILL)
    return 0.0, nothing


@fault("estimate's child stopped")
def stop_child(deployment, rng, witness):
    child = deployment.stop_child(rng, to_kill=False)
    if child is None:
        raise NothingToHitError
    pid, _ = child
    return rng.uniform(0.5, 9.0), lambda: send(pid, signal.SIGCONT)


@fault("database killed", has_database)
def kill_database(deployment, rng, witness):
    deployment.database.kill(rng.uniform(0.1, 1.5))
    return 0.0, nothing


@fault("database shut down", has_database)
def shut_database_down(deployment, rng, witness):
    deployment.database.kill(rng.uniform(0.1, 1.5), signal.SIGINT)
    return 0.0, nothing


@fault("database stopped", has_database)
def stop_database(deployment, rng, witness):
    return rng.uniform(0.5, 4.0), deployment.database.pause()


@fault("a connection's process in the database killed", has_database)
def kill_backend(deployment, rng, witness):
    """As by the kernel for want of memory: PostgreSQL then ends all connections and recovers."""
    import psycopg

    with psycopg.connect(deployment.database.url, connect_timeout=5) as connection:
        query = "SELECT pid FROM pg_stat_activity WHERE backend_type = 'client backend' AND pid <> pg_backend_pid()"
        pids = [pid for (pid,) in connection.execute(query)]
    if pids:
        os.kill(rng.choice(sorted(pids)), signal.SIGKILL)
    return 0.0, nothing


@fault("store killed", has_store)
def kill_store(deployment, rng, witness):
    deployment.store.kill(rng.uniform(0.1, 1.0))
    return 0.0, nothing


@fault("store stopped", has_store)
def stop_store(deployment, rng, witness):
    return rng.uniform(0.5, 4.0), deployment.store.pause()


@fault("disk of files full")
def fill_files(deployment, rng, witness):
    disk = deployment.disks["files"]
    disk.fill()

    def free():
        disk.free()
        if deployment.store is not None:  # SeaweedFS' index refuses writes after a full disk until it is started again
            deployment.store.kill(0.1)

    return rng.uniform(0.5, 3.0), free


@fault("disk of database full", lambda deployment: has_database(deployment) and deployment.disks["database"].is_mounted)
def fill_database(deployment, rng, witness):
    disk = deployment.disks["database"]
    disk.fill()
    return rng.uniform(0.5, 3.0), disk.free


@fault("slow disk")
def slow_disk(deployment, rng, witness):
    """Our own fsyncs take longer; database and store come to a stop again and again, as when they wait for a disk."""
    slow = deployment.switches / "slow"
    slow.write_text(f"{rng.uniform(0.1, 0.6):.2f}")
    ending = threading.Event()
    programs = [program for program in (deployment.database, deployment.store) if program is not None]

    def stutter():
        while not ending.wait(0.1):
            resumes = [program.pause() for program in programs]
            ending.wait(0.4)
            for resume in resumes:
                resume()

    stuttering = threading.Thread(target=stutter, daemon=True)
    stuttering.start()

    def undo():
        ending.set()
        stuttering.join()
        slow.unlink(missing_ok=True)

    return rng.uniform(1.0, 3.0), undo


def link_faults(which, where):  # noqa: C901  # a fault a function
    """The faults of a network for all proxies whose names begin so."""

    def links(deployment):
        return [link for name, link in deployment.links.items() if name.startswith(which)]

    @fault(f"{which} connections cut", where)
    def cut(deployment, rng, witness):
        for link in links(deployment):
            link.cut()
        return 0.0, nothing

    @fault(f"{which} connections half closed", where)
    def half_close(deployment, rng, witness):
        for link in links(deployment):
            link.half_close()
        return 0.0, nothing

    @fault(f"{which} answers lost", where)
    def lose_answers(deployment, rng, witness):
        chosen = links(deployment)
        for link in chosen:
            link.loses_answers = True

        def undo():
            for link in chosen:
                link.loses_answers = False
                link.cut()

        return rng.uniform(0.3, 1.5), undo

    @fault(f"{which} network stalls", where)
    def stall(deployment, rng, witness):
        chosen = rng.choice(links(deployment))
        chosen.is_stalled = True
        return rng.uniform(0.5, 4.0), chosen.heal

    @fault(f"{which} network away", where)
    def away(deployment, rng, witness):
        chosen = rng.choice(links(deployment))
        chosen.is_refusing = True
        chosen.cut()
        return rng.uniform(0.5, 3.0), chosen.heal


link_faults("phone", lambda _: True)
link_faults("database", has_database)
link_faults("store", has_store)


def clock_fault(which, where):
    @fault(f"clock of {which} jumps", where)
    def jump(deployment, rng, witness):
        clock = deployment.clocks[which]
        ahead = rng.choice((2, 30, 24 * 400)) * HOUR
        furthest_back = ahead if which == "api" else 20 * HOUR
        clock.jump(ahead if rng.random() < 0.5 else -min(ahead, furthest_back))
        return rng.uniform(1.0, 4.0), lambda: clock.jump(0)  # which is a jump too


clock_fault("api", lambda _: True)
clock_fault("worker", lambda deployment: not deployment.is_embedded)  # else it has the server's clock
clock_fault("database", has_database)


@fault("worker of an older version comes")
def older_worker(deployment, rng, witness):
    """Of a version whose rows mean the same, or of one that may not run ours; it goes again, asked or killed."""
    older = {"FAULT_VERSION": "0.0.1"} | ({"FAULT_PROTOCOL": "0"} if rng.random() < 0.5 else {})
    program = deployment.new_worker("older", **older)
    deployment.manager.keep(program)

    def undo():
        pid = program.pid
        deployment.manager.forget(program)
        if pid is not None:
            witness.worker_dies(pid)
        if rng.random() < 0.5:
            program.kill(0.0)
        else:
            program.end()

    return rng.uniform(4.0, 8.0), undo


class Schedule(threading.Thread):
    """Brings the faults and undoes them. rounds: of every kind that `is_wanted`, a function of its name."""

    def __init__(self, deployment, witness, rng, *, rounds, longest_gap, is_wanted):
        super().__init__(name="faults", daemon=True)
        self._deployment = deployment
        self._witness = witness
        self._rng = rng
        self._rounds = rounds
        self._longest_gap = longest_gap
        self.names = [name for name, (_, where) in FAULTS.items() if is_wanted(name) and where(deployment)]
        self._undo = []
        self._order = itertools.count()
        self._ending = threading.Event()
        self._is_over = threading.Event()
        self._begun = 0
        self.injected = Counter()
        self.without_effect = Counter()
        self.trouble = []

    def progress(self):
        """How much of it has been, 0 to 1."""
        return 1.0 if self._is_over.is_set() else self._begun / (self._rounds * len(self.names))

    def run(self):
        try:
            for _ in range(self._rounds):
                names = list(self.names)
                self._rng.shuffle(names)
                for name in names:
                    self._wait(self._rng.uniform(0.1, self._longest_gap))
                    if self._rng.random() < 0.7:
                        self._wait_for_a_good_answer()
                    if self._ending.is_set():
                        return
                    self._begin(name)
        finally:
            self._wait(None)
            self._is_over.set()

    def stop(self):
        """No further fault; those that hold are undone now."""
        self._ending.set()
        self.join()

    def _wait_for_a_good_answer(self):
        """So that most faults meet traffic, and not only what the faults before them have left of it."""
        heard = self._witness.good_answers()
        deadline = time.monotonic() + PATIENCE_SECONDS
        while self._witness.good_answers() == heard and time.monotonic() < deadline and not self._ending.is_set():
            self._wait(0.1)

    def _begin(self, name):
        function, _ = FAULTS[name]
        self._begun += 1
        self._witness.note(name)
        try:
            seconds, undo = function(self._deployment, self._rng, self._witness)
        except NothingToHitError:
            self.without_effect[name] += 1
            self._witness.passed(name)
            return
        except Exception as error:  # noqa: BLE001  # the database that it asked was away, which is a fault already
            self.trouble.append(f"{name}: {error!r}")
            self._witness.passed(name)
            return
        self.injected[name] += 1
        heapq.heappush(self._undo, (time.monotonic() + seconds, next(self._order), name, undo))

    def _wait(self, seconds):
        """Undo what is due until then; None: until nothing is left."""
        until = None if seconds is None else time.monotonic() + seconds
        while until is None or time.monotonic() < until:
            if not self._undo and until is None:
                return
            due = self._undo[0][0] if self._undo else until
            if time.monotonic() >= due or (self._ending.is_set() and self._undo):
                *_, name, undo = heapq.heappop(self._undo)
                undo()
                self._witness.passed(name)
                continue
            if self._ending.is_set():
                return
            next_look = due if until is None else min(due, until)
            self._ending.wait(max(0.0, next_look - time.monotonic()))
