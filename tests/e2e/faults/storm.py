"""One run: a deployment, its phones, its faults, then the checks; and the table that tells what came of it."""

import contextlib
import pathlib
import random
import signal
import time
from dataclasses import dataclass

from tests.e2e.faults.deployment import Deployment
from tests.e2e.faults.invariants import Checker
from tests.e2e.faults.phones import Journal, Phone, plan_meals, plan_slow_meal
from tests.e2e.faults.programs import send
from tests.e2e.faults.schedule import Schedule
from tests.e2e.faults.witness import Witness

PHONES = 4
LONGEST_STORM_SECONDS = 7200
CALM_SECONDS = 180.0  # after the last fault all meals have their answer by then; far more than it takes
SLOW_SECONDS = 6.0  # of the estimates that a worker dies at
PAIR = pathlib.Path(__file__).parents[3] / "app" / "demo_data"


@dataclass(frozen=True)
class Outcome:
    """What came of a storm. lost, duplicated, others: sentences; empty is good.

    injected: faults by name. kinds: names of the faults that were to come.
    """

    lost: list
    duplicated: list
    others: list
    table: str
    injected: dict
    kinds: list


def storm(folder, database, store, *, seed, meals, rounds, longest_gap, is_wanted, is_small=False):
    """Run it. The seed draws meals and faults; when they meet is up to the machine.

    rounds: of each fault that `is_wanted`, a function of its name. is_small: without real photographs, and without
    the deaths of workers while nothing else is broken.
    """
    real_pair = {slot: (PAIR / f"{slot}.jpg").read_bytes() for slot in ("left", "right")}
    rng = random.Random(seed)
    planned = plan_meals(rng, meals, None if is_small else real_pair)
    with contextlib.ExitStack() as cleanup:
        deployment = Deployment(folder, database, store)
        cleanup.callback(deployment.close)
        tokens = deployment.enrol([f"P{number}" for number in range(PHONES)])
        settings = deployment.settings
        journal = Journal(folder / "timeline.txt")
        cleanup.callback(journal.close)
        witness = Witness(settings.resolved_database_url, journal)
        began = time.monotonic()
        when = {"rounds": rounds, "longest_gap": longest_gap, "is_wanted": is_wanted}
        schedule = Schedule(deployment, witness, random.Random(seed), **when)
        phones = [
            Phone(
                code,
                token,
                deployment.addresses,
                planned[place::PHONES],
                journal,
                random.Random(seed + 1 + place),
                schedule.progress,
            )
            for place, (code, token) in enumerate(tokens.items())
        ]
        witness.start()
        for phone in phones:
            phone.deadline = began + LONGEST_STORM_SECONDS
            phone.start()
        schedule.start()
        try:
            for phone in phones:
                phone.join()
            schedule.join()
        finally:
            schedule.stop()
            deployment.heal()
        stormed = time.monotonic() - began
        checker = Checker(settings, journal)
        calm = wait_for_calm(checker)
        stormy = len(witness.takeovers)
        if not is_small:
            deaths(deployment, phones[0], witness, checker, rng, count=min(4, max(2, rounds // 2)))
        witness.stop()
        ends = {program.name: program.ends for program in [*deployment.apis, *deployment.workers]}
        deployment.manager.close_but(deployment.database, deployment.store)
        try:
            lost, duplicated, others = checker.problems(deployment.logs())
        finally:
            checker.close()
        others += [f"{phone.name}: {phone.trouble!r}" for phone in phones if phone.trouble is not None]
        others += [f"refused: {words}" for words in journal.refused]
        others += [f"the job {job} of a dead worker was never taken over" for job in witness.waiting()]
        if "0 differ" not in (rebuilt := deployment.tada("records", "rebuild", "--check")):
            others.append(f"records are not what their runs say: {rebuilt}")
        table = describe(deployment, journal, witness, schedule, checker, lost, duplicated, stormed, calm, ends, stormy)
        return Outcome(lost, duplicated, others, table, dict(schedule.injected), schedule.names)


def deaths(deployment, phone, witness, checker, rng, *, count):
    """Workers killed and stopped, in turns, while nothing else is broken: how long their jobs wait for another."""
    for number in range(count):
        is_stopped = number % 2 == 1 and not deployment.is_embedded  # on SQLite a stopped worker keeps its jobs
        for api in deployment.apis:
            api.wait_until_ready()
        phone.send(plan_slow_meal(rng, SLOW_SECONDS))
        pid = witness.pid_at_work()
        assert pid is not None, "no worker began with the meal"
        witness.worker_dies(pid)
        send(pid, signal.SIGSTOP if is_stopped else signal.SIGKILL)
        deadline = time.monotonic() + CALM_SECONDS
        while witness.waiting() and time.monotonic() < deadline:
            time.sleep(0.1)
        send(pid, signal.SIGCONT)
        wait_for_calm(checker)


def wait_for_calm(checker):
    """Seconds until no meal waits any more and no workflow is under way, at most CALM_SECONDS."""
    began = time.monotonic()
    while time.monotonic() - began < CALM_SECONDS:
        try:
            if not checker.waiting() and not checker.moving():
                break
        except Exception:  # noqa: BLE001  # the database is just being started
            pass
        time.sleep(0.2)
    return time.monotonic() - began


def describe(deployment, journal, witness, schedule, checker, lost, duplicated, stormed, calm, ends, stormy):
    """The table, as docs/faults.md has it."""
    longest, alone = (
        max((one.seconds for one in some), default=0.0)
        for some in (witness.takeovers[:stormy], witness.takeovers[stormy:])
    )
    disk = "a full tmpfs" if deployment.disks["files"].is_mounted else "fsync that says so (no mount allowed)"
    rows = [(name, count) for name, count in sorted(schedule.injected.items())]
    rows += [
        ("faults injected", schedule.injected.total()),
        ("faults that found nothing to break", schedule.without_effect.total() + len(schedule.trouble)),
        ("estimates whose child was killed", len(deployment.children_killed)),
        ("of these twice", sum(count > 1 for count in deployment.children_killed.values())),
        ("meals failed for passing trouble", len(checker.failed_for_passing_trouble)),
        ("disk full by", disk),
        ("meals acknowledged", len(journal.acknowledged)),
        ("after-meal pairs acknowledged", len(journal.after_acknowledged)),
        ("meals erased", len(journal.erased)),
        ("tries of the phones", journal.tries),
        ("lost", len(lost)),
        ("duplicated", len(duplicated)),
        ("jobs taken over in the storm", stormy),
        ("longest of these takeovers, s", f"{longest:.1f}"),
        ("jobs taken over while nothing else was broken", len(witness.takeovers) - stormy),
        ("longest of these takeovers, s", f"{alone:.1f}"),
        ("longest without a 2xx, s", f"{journal.longest_without_answer:.1f}"),
        ("orphan blobs deleted in the storm", checker.orphans_before),
        ("orphan blobs deleted at the end", checker.orphans),
        ("ends that nobody asked for", sum(len(one) for one in ends.values())),
        ("storm, s", f"{stormed:.0f}"),
        ("from the last fault to the last answer, s", f"{calm:.1f}"),
    ]
    width = max(len(str(name)) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)
